"""Four fingers of one hand in one view, cut apart, against the same fingers alone in front of the same lights.

    python validation/hand/run.py --out FOLDER [--hands 3] [--px-per-mm 22.7] [--radius-mm 52.5] [--write]

Four fingers (seeds 7001 to 7004, then 7011 to 7014, ...) lie side by side on one camera's grid: each is intersected
with that camera's rays, the surfaces are put into one, and all are photographed together under the thesis's 14 lights,
on a circle of ``--radius-mm``, with one skin, one exposure and one noise. Alone, the same finger in the same pose lies
in the middle before the same lights; beside, it lies where it lies in the view, without its neighbours, and the same
window is cut. Not simulated: shadows and light that fingers cast on each other; how much of the
skin a neighbour would shade under the worst light is computed from the surfaces and reported. Both captures go through
``metric`` (the cut ones by `fingers_apart`, the hand to be found by the tips) and are compared with their truth.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import splitknit
from splitknit.accuracy import compare
from splitknit.finger.hand import fingers_apart
from splitknit.imaging.crop import cropped
from splitknit.model import Rig, default_rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.light.skin import SkinRanges
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.surface import SimulatedSurface
from splitknit_simulator.twin import photograph

VIEW_MM = (46.0, 94.0)
ALONE_MM = (46.0, 34.0)
NAMES = ("right_little", "right_ring", "right_middle", "right_index")
X_MM, YAW_DEG, INSERTION_MM = (-33.0, -11.0, 11.0, 33.0), (5.0, 2.0, -2.0, -5.0), (27.0, 36.0, 39.0, 34.0)
FIGURES = ("surface_rms_mm", "shape_rms_mm", "normals_mean_deg", "ridge_rms_um", "ridge_correlation", "ridge_gain")
KINDS = ("alone", "beside", "cut")


def rig_of(px_per_mm: float, size_mm: tuple[float, float], radius_mm: float) -> Rig:
    """The thesis's lights on a circle of a radius, and a camera of a scale and field."""
    rig = default_rig(1.0, 0)
    rows, columns = (2 * round(side * px_per_mm / 2) for side in size_mm)
    leds = tuple(
        replace(led, position_mm=(radius_mm / 52.5 * led.position_mm[0], radius_mm / 52.5 * led.position_mm[1], 140.0))
        for led in rig.leds
        if led.position_mm is not None
    )
    return replace(rig, camera=replace(rig.camera, px_per_mm=px_per_mm, image_size=(rows, columns)), leds=leds)


def together(surfaces: list[SimulatedSurface]) -> SimulatedSurface:
    """Surfaces on one grid that do not overlap, as one."""
    assert not np.any(np.sum([one.mask for one in surfaces], axis=0) > 1)
    first = surfaces[0]
    fields = ("height_mm", "shape_mm", "normals", "shape_normals", "relief_um", "mask", "pigment")
    arrays = {name: getattr(first, name).copy() for name in fields}
    for other in surfaces[1:]:
        for name, array in arrays.items():
            array[other.mask] = getattr(other, name)[other.mask]
    return replace(first, **arrays, landmarks={}, chart=None)


def shaded(surfaces: list[SimulatedSurface], number: int, rig: Rig, step: int = 8) -> float:
    """Fraction of a finger's pixels that its neighbours hide from the light that they hide most."""
    rows, columns = np.nonzero(surfaces[number].mask[::step, ::step])
    rows, columns = rows * step, columns * step
    scale = rig.camera.px_per_mm
    height = np.nan_to_num(together([s for k, s in enumerate(surfaces) if k != number]).height_mm, nan=-100.0)
    middle = (np.array(height.shape) - 1) / 2
    place = np.stack(
        [(columns - middle[1]) / scale, (middle[0] - rows) / scale, surfaces[number].height_mm[rows, columns]]
    )
    worst = 0.0
    for led in rig.leds:
        towards = np.asarray(led.position_mm)[:, None] - place
        towards /= np.linalg.norm(towards, axis=0)
        hidden = np.zeros(rows.size, dtype=bool)
        for far in np.arange(0.5, 30.0, 0.25):
            x, y, z = place + far * towards
            j, i = np.rint(x * scale + middle[1]).astype(int), np.rint(middle[0] - y * scale).astype(int)
            held = (i >= 0) & (j >= 0) & (i < height.shape[0]) & (j < height.shape[1])
            hidden[held] |= height[i[held], j[held]] > z[held]
        worst = max(worst, float(hidden.mean()))
    return worst


def measured(capture: Any, truth: dict[str, Any]) -> dict[str, Any]:
    """Figures of a reconstruction against its truth."""
    result = splitknit.reconstruct(capture, "metric")
    found = compare(result, truth).figures
    return {name: float(found[name]) for name in FIGURES if name in found} | {
        "crease_found": bool(result.facts["crease_found"]), "area_mm2": float(result.mask.sum() * result.pitch_mm**2),
    }  # fmt: skip


def cut_truth(truth: dict[str, Any], cut: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """What of a view's truth belongs to one finger of it."""
    window = tuple(slice(*cut[name]) for name in ("rows", "columns"))
    own = mask[window]
    fields = {name: truth[name][window].copy() for name in ("height_mm", "shape_mm", "normals", "relief_um")}
    for name, field in fields.items():
        field[~own] = np.nan if name.endswith("_mm") else 0
    return {**truth, **fields, "mask": own}


def hand(number: int, px_per_mm: float, radius_mm: float) -> dict[str, Any]:
    """Figures of four fingers, cut from one view and alone, by finger."""
    seeds = [7001 + 10 * number + k for k in range(4)]
    skin = SkinRanges().draw(np.random.default_rng([number, 0x51]))
    settings = TwinSettings(skin=skin)
    view, alone = (rig_of(px_per_mm, size, radius_mm) for size in (VIEW_MM, ALONE_MM))
    surfaces, result = [], {}
    for k, seed in enumerate(seeds):
        pose = FingerPose(
            yaw_rad=float(np.deg2rad(YAW_DEG[k])), pitch_rad=0.0, roll_rad=0.0, x_mm=X_MM[k],
            insertion_mm=INSERTION_MM[k], height_mm=0.0,
        )  # fmt: skip
        finger = draw_finger(seed)
        surfaces.append(finger_surface(finger, pose, view.camera))
        surface = finger_surface(finger, replace(pose, x_mm=0.0), alone.camera)
        capture, truth = photograph(surface, alone, skin, np.random.SeedSequence([seed, 1]), settings=settings)
        result[NAMES[k]] = {"alone": measured(capture, truth)}
    for k, name in enumerate(NAMES):
        result[name]["shaded"] = shaded(surfaces, k, view)
    capture, truth = photograph(
        together(surfaces), view, skin, np.random.SeedSequence([seeds[0], 2]), settings=settings
    )
    cut = fingers_apart(capture)
    assert tuple(cut) == NAMES, tuple(cut)
    for k, (name, own) in enumerate(cut.items()):
        cut_from = own.rig.provenance["cut_from"]
        result[name]["cut"] = measured(own, cut_truth(truth, cut_from, surfaces[k].mask))
        seed = np.random.SeedSequence([seeds[k], 3])
        beside, whole = photograph(surfaces[k], view, skin, seed, settings=settings)
        window = (slice(*cut_from["rows"]), slice(*cut_from["columns"]))
        result[name]["beside"] = measured(cropped(beside, window), cut_truth(whole, cut_from, surfaces[k].mask))
    return result


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--hands", type=int, default=3)
    parser.add_argument("--px-per-mm", type=float, default=22.7)
    parser.add_argument("--radius-mm", type=float, default=52.5)
    parser.add_argument("--write", action="store_true", help="write results.json beside this file")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for number in range(options.hands):
        file = options.out / f"{number}_{options.px_per_mm:g}_{options.radius_mm:g}.json"
        if not file.is_file():
            made = json.dumps(hand(number, options.px_per_mm, options.radius_mm), indent=1)
            file.write_text(made, encoding="utf-8")
        rows.append(json.loads(file.read_text(encoding="utf-8")))
    table: dict[str, Any] = {"hands": options.hands, "px_per_mm": options.px_per_mm, "radius_mm": options.radius_mm}
    table["shaded_at_most"] = max(one["shaded"] for row in rows for one in row.values())
    rng = np.random.default_rng(0)
    for place, names in {"outer": (NAMES[0], NAMES[3]), "inner": NAMES[1:3], "all": NAMES}.items():
        table[place] = {}
        for figure in FIGURES:
            kinds = np.array([[row[n][kind][figure] for kind in KINDS] for row in rows for n in names])
            change = kinds[:, 2] - kinds[:, 0]
            drawn = change[rng.integers(0, len(change), (2000, len(change)))].mean(axis=1)
            low, high = np.quantile(drawn, (0.025, 0.975))
            means = dict(zip(KINDS, kinds.mean(axis=0).tolist(), strict=True))
            table[place][figure] = means | {"change": [float(change.mean()), float(low), float(high)]}
            words = " ".join(f"{kind} {value:7.3f}" for kind, value in means.items())
            print(f"{place:6} {figure:18} {words} change {change.mean():7.3f} [{low:.3f}, {high:.3f}]")
    print(f"a neighbour would shade at most {100 * table['shaded_at_most']:.2f} % of a finger")
    if options.write:
        name = f"results_{options.radius_mm:g}.json"
        Path(__file__).with_name(name).write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
