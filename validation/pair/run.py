"""What the pair protocol can tell: ``python validation/pair/run.py [FINGER ...] [--truth-only]
[--out FILE.json]``.

A simulated finger is measured bare and then, laid down anew, under powder, pressed on a gel, or as
a cast. First the true surfaces alone are registered and compared: what they differ by is the
protocol's own error, whatever measures them. Then the same is done with what ``metric`` makes of
photographs of both. About two minutes of processor time a finger; a run goes on where it stopped.
``--table`` prints the tables (as in ``tables/``) behind docs/experiments/real-skin.md.

Powder, gel and cast are models, and not the reconstruction's: a map of thickness over the skin,
waves that the gel follows the less the shorter they are, skin that shifts.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from splitknit.capture import Band, Capture
from splitknit.model import Rig
from splitknit.nominal import default_rig
from splitknit.pipeline import reconstruct
from splitknit.reconstruction import Reconstruction
from splitknit_match.evaluation.pair import BANDS_MM, SLANTS_DEG, PairComparison, compare_results
from splitknit_simulator.camera.sensor import SensorSettings, record
from splitknit_simulator.finger.deformation import deformed, draw_deformation
from splitknit_simulator.finger.finger import (
    PoseRanges,
    SimulatedFinger,
    draw_finger,
    finger_surface,
)
from splitknit_simulator.finger.ridges import smooth_noise
from splitknit_simulator.finger.skin_map import SkinMap, skin_map
from splitknit_simulator.light.lighting import cut_out, irradiance, white_card
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.light.skin import SkinRanges
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.surface import SimulatedSurface
from splitknit_simulator.twin import photograph

RESULTS = Path(__file__).with_name("results.json")
SEEDS = (8801, 8802, 8803, 8804, 8805)
SCALE = 0.35
"""26 pixels a millimetre."""
GRAIN_MM = 0.015
"""Over which grains of powder bridge what is narrower (standard deviation)."""
POWDER_NOISE = ((0.4, 0.6), (0.3, 0.1))
"""Relative standard deviation of the powder's thickness, and its length in mm: clumps, and strokes
of the brush."""
VALLEY_EXCESS = 0.4
"""How much thicker than the mean powder lies in valleys, and thinner on ridges."""
GEL_SIGMA_MM = 0.03
"""Standard deviation of the Gaussian by which a gel blurs the skin."""
GEL_REACH_MM = 0.06
"""Depth down to which a gel follows valleys."""
GEL_RIDGE_GAIN = 0.85
"""Height of ridges below a gel over their own: it presses them flatter."""
PITCH_MM = 0.03
"""Pitch of the gel's picture."""


def truth_of(surface: SimulatedSurface, name: str) -> Reconstruction:
    """The true surface as a result."""
    seen = np.where(surface.mask, np.float32(1), np.float32(np.nan))
    height, shape = surface.height_mm * seen, surface.shape_mm * seen
    return Reconstruction(
        height,
        height - shape,
        shape,
        surface.mask,
        surface.normals,
        seen,
        surface.camera.pitch_mm,
        np.eye(3),
        surface.mask.shape,
        name,
    )


def displaced(skin: SkinMap, change: Any) -> SkinMap:
    """Skin whose displacement (H, W) in mm is what `change` makes of it."""
    rows, columns = skin.coefficients.shape
    u = skin.u0_mm + skin.pitch_mm * np.arange(columns)
    v = skin.v0_mm - skin.pitch_mm * np.arange(rows)
    here = skin.displacement(*np.meshgrid(u, v))
    return replace(skin, coefficients=ndimage.spline_filter(change(here), order=3, mode="mirror"))


def powdered(skin: SkinMap, mean_um: float, rng: np.random.Generator) -> SkinMap:
    """Skin under powder: uneven, thicker in valleys than on ridges, smooth over a grain."""

    def change(height: Any) -> Any:
        local = height - ndimage.gaussian_filter(height, 0.3 / skin.pitch_mm)
        spread = max(float(np.std(local)), 1e-6)
        uneven = sum(
            s * smooth_noise(rng, height.shape, length / skin.pitch_mm)
            for s, length in POWDER_NOISE
        )
        thickness = (
            1e-3
            * mean_um
            * np.clip(1.0 + uneven, 0.2, 2.5)
            * (1.0 - VALLEY_EXCESS * np.clip(local / spread, -2, 2))
        )
        return ndimage.gaussian_filter(height + thickness, GRAIN_MM / skin.pitch_mm)

    return displaced(skin, change)


def on_gel(finger: SimulatedFinger, rng: np.random.Generator) -> Reconstruction:
    """The finger pressed on a flat gel, its relief as the gel takes it, on the chart of the
    skin."""
    moved = deformed(finger.master(), draw_deformation(rng, finger.master(), 0.35, 5.0, 0.015))
    skin = skin_map(moved, replace(finger.skin, creases=()))
    x = np.arange(-7.5, 7.5, PITCH_MM)
    y = np.arange(8.5, -8.5, -PITCH_MM)
    turn = np.deg2rad(rng.uniform(-8, 8))
    u = np.cos(turn) * x - np.sin(turn) * y[:, None] + rng.uniform(-1, 1)
    v = np.sin(turn) * x + np.cos(turn) * y[:, None] + 12.0 + rng.uniform(-1, 1)
    relief = GEL_RIDGE_GAIN * skin.displacement(u, v)
    reached = GEL_REACH_MM * np.tanh(relief / GEL_REACH_MM)
    relief = ndimage.gaussian_filter(reached, GEL_SIGMA_MM / PITCH_MM).astype(np.float32)
    mask = np.hypot(x / 6.5, y[:, None] / 7.8) < 1.0
    seen = np.where(mask, np.float32(1), np.float32(np.nan))
    plane = (0.01 * x + 0.02 * y[:, None]).astype(np.float32)
    normals = np.zeros((*mask.shape, 3), dtype=np.float32)
    return Reconstruction(
        (relief + plane) * seen,
        relief * seen,
        plane * seen,
        mask,
        normals,
        seen,
        PITCH_MM,
        np.eye(3),
        mask.shape,
        "gel",
    )


def opaque_capture(surface: SimulatedSurface, rig: Rig, rng: np.random.SeedSequence) -> Capture:
    """Photographs of the finger as a matt, opaque thing, with the sensor's noise, before black."""
    bands = {}
    for name in ("white", "nir"):
        members = [k for k, led in enumerate(rig.leds) if led.band == name]
        leds = [rig.leds[k] for k in members]
        patch = cut_out(surface)
        window = patch.window
        light = np.stack([irradiance(led, patch.points, patch.normal) for led in leds])
        light = np.where(patch.mask, light * np.float32(0.5 / np.pi), 0.0).astype(np.float32)
        level = np.float32(0.7 / np.percentile(light[light > 0], 99.9))
        images = []
        for k, seed in enumerate(rng.spawn(len(leds))):
            frame = np.where(
                surface.mask, np.float32(0), 0.006 * white_card(rig.camera, leds[k], -10.0)
            )
            frame[window] += light[k]
            stored = record(
                np.repeat(level * frame[..., None], 3, axis=2), name, seed, SensorSettings(), SCALE
            )
            images.append(stored)
        count = len(images)
        bands[name] = Band(
            name, np.stack(images), tuple((k,) for k in members), np.ones(count), np.zeros(count)
        )
    return Capture(rig=rig, bands=bands, material="opaque")


def figures(pair: PairComparison) -> dict[str, Any]:
    """What is kept of a comparison."""
    kept = {
        band: {
            slant: (
                {name: round(row[name]["value"], 4) for name in ("correlation", "gain", "rms_um")}
                | {"std_um": round(row["std_um"], 2)}
            )
            for slant, row in rows.items()
        }
        for band, rows in pair.figures.items()
    }
    return {
        "strain_um": round(1e3 * pair.strain_mm, 1),
        "scale": round(pair.scale, 4),
        "bands": kept,
    }


def measured(number: int) -> dict[str, Any]:
    """All comparisons of one finger."""
    finger = draw_finger(number)
    rig = default_rig(SCALE, number)
    master = finger.master()
    finger = replace(finger, printed=master)
    draws = [np.random.default_rng([number, 61, k]) for k in range(8)]
    poses = [PoseRanges().draw(draws[k], rig.camera) for k in (0, 1)]
    skin = skin_map(master, finger.skin)
    shifted = deformed(master, draw_deformation(draws[2], master, 0.05))
    coats = {f"powder {mean:g} um": powdered(skin, mean, draws[3]) for mean in (5, 10, 20)}
    own_skin = skin_map(shifted, finger.skin)

    def surface(k: int, map_: SkinMap) -> SimulatedSurface:
        return finger_surface(finger, poses[k], rig.camera, skin=map_, workers=1)

    bare = surface(0, skin)
    second_press = surface(1, skin)
    true = truth_of(bare, "bare")
    coated = {name: surface(1, coat) for name, coat in coats.items()}
    moved = truth_of(surface(1, powdered(own_skin, 10, draws[4])), "moved")
    gel = on_gel(finger, draws[5])
    cast = truth_of(surface(1, own_skin), "cast")
    cast = replace(
        cast, pitch_mm=cast.pitch_mm * 0.998, height_mm=cast.height_mm * np.float32(0.998)
    )
    rows = {"laid down anew": compare_results(true, truth_of(second_press, "anew"))}
    rows |= {
        name: compare_results(true, truth_of(coated_surface, name))
        for name, coated_surface in coated.items()
    }
    rows["powder 10 um, skin shifted by 0.05 mm"] = compare_results(true, moved)
    rows["powder 10 um, skin shifted by 0.05 mm, elastic"] = compare_results(
        true, moved, fit="elastic"
    )
    rows["gel"] = compare_results(true, gel, fit="elastic")
    rows["cast"] = compare_results(true, cast)
    rows["cast, elastic"] = compare_results(true, cast, fit="elastic")
    results = {"truth": {name: figures(pair) for name, pair in rows.items()}}
    seed = np.random.SeedSequence([number, 62])
    settings = TwinSettings(scale=SCALE, render=RenderSettings(workers=1))
    optics = SkinRanges().draw(draws[6])
    result = reconstruct(photograph(bare, rig, optics, seed.spawn(1)[0], settings=settings)[0])
    second = reconstruct(opaque_capture(coated["powder 10 um"], rig, seed.spawn(1)[0]))
    covered = truth_of(coated["powder 10 um"], "coated")
    results["metric"] = {
        "bare, against its truth": figures(compare_results(result, true)),
        "powder 10 um, against its truth": figures(compare_results(second, covered)),
        "bare, against powder 10 um": figures(compare_results(result, second)),
        "bare, against gel": figures(compare_results(result, gel, fit="elastic")),
    }
    return results


def table(results: Mapping[str, Any], part: str, slant: str) -> list[str]:
    """Means over the fingers, as Markdown: rms in um and gain of every band."""
    rows = [finger_rows[part] for finger_rows in results.values() if part in finger_rows]
    lines = [
        f"| {slant} deg, {len(rows)} fingers | {' | '.join(BANDS_MM)} |",
        f"|{' --- |' * (1 + len(BANDS_MM))}",
    ]
    for name in rows[0] if rows else ():
        cells = []
        for band in BANDS_MM:
            values = [
                finger_rows[name]["bands"][band][slant]
                for finger_rows in rows
                if slant in finger_rows[name]["bands"].get(band, {})
            ]
            rms, gain = ([value[figure] for value in values] for figure in ("rms_um", "gain"))
            cells.append(
                f"{np.sqrt(np.mean(np.square(rms))):.1f} ({np.mean(gain):.2f})" if values else "-"
            )
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is not yet measured, or print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("fingers", type=int, nargs="*", default=SEEDS)
    parser.add_argument("--table", action="store_true", help="print the tables of an earlier run")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    results = json.loads(options.out.read_text()) if options.out.is_file() else {}
    if not options.table:
        for number in options.fingers:
            if "metric" in results.get(str(number), {}):
                continue
            results[str(number)] = measured(number)
            options.out.write_text(json.dumps(results, indent=1) + "\n")
            print(f"finger {number} done", file=sys.stderr, flush=True)
    for part in ("truth", "metric"):
        for slant in SLANTS_DEG:
            print("\n".join(table(results, part, slant)), end="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
