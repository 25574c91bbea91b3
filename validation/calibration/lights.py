"""How well the lights are found on the twin: tables with noise, and photographs from end to end.

    python validation/calibration/lights.py  # 50 rigs as tables, 5 as photographs: some minutes
    python validation/calibration/lights.py --photographs 0  # tables only

Every rig is built anew (``simulate.built_rig``: LEDs 0.7 mm off each way, camera shifted, oblique
and distorted, the base tilted); its camera is taken as calibrated, its LEDs are not known better
than the drawing says. Tips get one pixel of noise, the nail 0.1 mm in each position, both of the
full-scale image. Errors are the angles between the found and the true direction of each LED from
the rig's origin. Results go to ``lights.json`` beside this file.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.model import Rig
from splitknit.nominal import default_rig
from splitknit_rig.calibration.lights import BANDS, Circle, Tip, by_circle
from splitknit_rig.calibration.nail import Nail, by_joint_fit
from splitknit_rig.calibration.shadow import find_nail
from splitknit_simulator.calibration_set.bench import photograph_bench, well_exposed
from splitknit_simulator.calibration_set.solids import NailScene
from splitknit_simulator.rigs import built_rig

Points = NDArray[np.float64]
HERE = Path(__file__).resolve().parent
CIRCLE = Circle(52.5, 140.0)
TWO_PLACES_MM = ((-6.0, -4.0), (6.0, 4.0))
FOUR_PLACES_MM = ((-6.0, -4.0), (6.0, -4.0), (6.0, 4.0), (-6.0, 4.0))
TIP_NOISE_PX = 1.0
"""Standard deviation of a shadow tip's place."""
NAIL_NOISE_MM = 0.1
"""Standard deviation of the nail's place and of its height."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--rigs", type=int, default=50, help="rigs measured by tables (default: 50)"
    )
    parser.add_argument(
        "--photographs", type=int, default=5, help="rigs measured by photographs (default: 5)"
    )
    parser.add_argument(
        "--scale", type=float, default=0.25, help="of the photographs (default: 0.25)"
    )
    parser.add_argument(
        "--nail-mm", type=float, default=13.0, help="height of the nail (default: 13)"
    )
    parser.add_argument("--out", type=Path, default=HERE / "lights.json")
    chosen = parser.parse_args(arguments)
    results = {
        "tip_px": TIP_NOISE_PX,
        "nail_mm": NAIL_NOISE_MM,
        "nail_height_mm": chosen.nail_mm,
        "rigs": chosen.rigs,
    }
    results["cases"] = tables(chosen.rigs, chosen.nail_mm)
    results["circle_less_drawing"] = circle_less_drawing(chosen.nail_mm)
    if chosen.photographs:
        results["photographs"] = {
            "rigs": chosen.photographs,
            "scale": chosen.scale,
            **photographs(chosen.photographs, chosen.scale, chosen.nail_mm),
        }
    chosen.out.write_text(json.dumps(results, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    print(summary(results))
    return 0


def tables(rigs: int, nail_mm: float) -> dict[str, Any]:
    """Figures of every way by its name."""
    errors: dict[str, list[Points]] = {}
    inside: dict[str, list[Points]] = {}
    widths: dict[str, list[Points]] = {}
    for seed in range(rigs):
        rig = built_rig(seed)
        rng = np.random.default_rng([seed, 0x11])
        two, four = (
            noisy_table(rig, places, nail_mm, rng) for places in (TWO_PLACES_MM, FOUR_PLACES_MM)
        )
        known = Nail(height_mm=nail_mm + float(rng.normal(0, NAIL_NOISE_MM)))
        drawn = default_rig()
        exact = noisy_table(drawn, TWO_PLACES_MM, nail_mm, rng)
        plain, _ = by_circle(exact, drawn.camera, CIRCLE)
        _note(errors, "circle, two positions, LEDs as drawn, parallel view", _errors(plain, drawn))
        _note(errors, "nothing measured: LEDs as drawn", _errors(drawn.leds, rig))
        _note(errors, "circle, two positions", _errors(by_circle(two, rig.camera, CIRCLE)[0], rig))
        for name, tips, settings in (
            ("joint fit, two positions", two, Nail()),
            ("joint fit, four positions", four, Nail()),
            ("joint fit, four positions, nail's height known", four, known),
        ):
            fit = by_joint_fit(tips, rig.camera, CIRCLE, settings)
            errors_deg = _errors(fit.leds, rig)
            _note(errors, name, errors_deg)
            interval_deg = np.array([led.interval_deg for led in fit.leds])
            _note(inside, name, errors_deg <= interval_deg)
            _note(widths, name, interval_deg)
    return {
        name: {
            **_figures(np.array(values)),
            "inside_95": float(np.mean(inside[name])) if name in inside else None,
            "interval_deg": float(np.mean(widths[name])) if name in widths else None,
        }
        for name, values in errors.items()
    }


def circle_less_drawing(nail_mm: float, rigs: int = 2000) -> dict[str, Any]:
    """Mean error in degrees of the thesis's construction less that of the drawing, rig by rig."""
    drawn, differences = default_rig().leds, []
    for seed in range(rigs):
        rig = built_rig(seed)
        tips = noisy_table(rig, TWO_PLACES_MM, nail_mm, np.random.default_rng([seed, 0x11]))
        found = by_circle(tips, rig.camera, CIRCLE)[0]
        differences.append(float(_errors(found, rig).mean() - _errors(drawn, rig).mean()))
    reach = 1.96 * float(np.std(differences, ddof=1)) / rigs**0.5
    mean = float(np.mean(differences))
    return {"rigs": rigs, "mean": mean, "mean_interval": [mean - reach, mean + reach]}


def photographs(rigs: int, scale: float, nail_mm: float) -> dict[str, Any]:
    """Photographs of four nail positions under 14 LEDs with the sensor's noise: tips found, LEDs
    fitted."""
    errors, tip_off, nail_off = [], [], []
    for seed in range(rigs):
        rig = built_rig(seed, scale=scale)
        tips: list[Tip] = []
        for nail, place in enumerate(FOUR_PLACES_MM, start=1):
            scene = _scene(rig, place, nail_mm)
            for first, band in ((0, "white"), (7, "nir")):
                leds = range(first, first + 7)
                exposure = well_exposed(scene, [[k] for k in leds])
                images = [
                    photograph_bench(scene, [k], 1000 * seed + k, exposure=exposure, band=band)
                    for k in leds
                ]
                stack = np.stack([image.mean(axis=2) for image in images]).astype(np.float32) / 255
                view = find_nail(stack, rig.camera.px_per_mm, [f"{band} {k}" for k in range(7)])
                tip_off.append(
                    (view.tips_px - scene.shadow_tips_px()[first : first + 7])
                    / rig.camera.px_per_mm
                )
                nail_off.append((view.nail_px - scene.tip_px()) / rig.camera.px_per_mm)
                tips += [
                    _tip(band, k, nail, view.nail_px, tip) for k, tip in enumerate(view.tips_px)
                ]
        fit = by_joint_fit(_sorted(tips), rig.camera, CIRCLE, Nail(sd_mm=0.05))
        errors.append(_errors(fit.leds, rig))
    return {
        **_figures(np.array(errors)),
        "tip_rms_mm": float(np.sqrt(np.mean(np.concatenate(tip_off) ** 2))),
        "nail_rms_mm": float(np.sqrt(np.mean(np.array(nail_off) ** 2))),
    }


def noisy_table(
    rig: Rig, places: Sequence[tuple[float, float]], nail_mm: float, rng: np.random.Generator
) -> list[Tip]:
    """The table that a person would type."""
    tips = []
    for nail, place in enumerate(places, start=1):
        scene = _scene(rig, place, nail_mm)
        seen = scene.tip_px() + rng.normal(0, NAIL_NOISE_MM * rig.camera.px_per_mm, 2)
        for k, tip in enumerate(scene.shadow_tips_px()):
            tips.append(
                _tip(BANDS[k // 7], k % 7, nail, seen, tip + rng.normal(0, TIP_NOISE_PX, 2))
            )
    return _sorted(tips)


def summary(results: dict[str, Any]) -> str:
    """A table in Markdown."""
    lines = [
        "| way | mean | 95 % | worst | worst of a rig's means | inside its interval |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in results["cases"].items():
        fraction = (
            "-"
            if row["inside_95"] is None
            else f"{100 * row['inside_95']:.0f} % of {row['interval_deg']:.2f} deg"
        )
        lines.append(f"| {name} | {_words(row)} | {fraction} |")
    paired = results["circle_less_drawing"]
    low, high = paired["mean_interval"]
    lines.append(
        f"circle less drawing, {paired['rigs']} rigs: {paired['mean']:+.3f}"
        f" [{low:+.3f}, {high:+.3f}] deg"
    )
    if "photographs" in results:
        row = results["photographs"]
        lines.append(f"| photographs, joint fit, four positions | {_words(row)} | - |")
        lines.append(f"tips in photographs: {1000 * row['tip_rms_mm']:.1f} um rms each way, nail "
                     f"{1000 * row['nail_rms_mm']:.1f} um")  # fmt: skip
    return "\n".join(lines)


def _words(row: dict[str, Any]) -> str:
    low, high = row["mean_interval"]
    return (
        f"{row['mean']:.3f} [{low:.3f}, {high:.3f}] | {row['p95']:.2f} | {row['worst']:.2f} |"
        f" {row['worst_rig']:.2f}"
    )


def _figures(errors: Points) -> dict[str, Any]:
    """Of (rigs, LEDs) in degrees; the mean's 95 % interval by resampling whole rigs, whose LEDs err
    together."""
    rng = np.random.default_rng(0)
    by_rig = errors.mean(axis=1)
    means = by_rig[rng.integers(0, len(by_rig), (2000, len(by_rig)))].mean(axis=1)
    return {
        "mean": float(errors.mean()),
        "mean_interval": [float(v) for v in np.quantile(means, (0.025, 0.975))],
        "p95": float(np.quantile(errors, 0.95)),
        "worst": float(errors.max()),
        "worst_rig": float(by_rig.max()),
    }


def _errors(leds: Sequence[Any], rig: Rig) -> Points:
    return _angles(np.array([led.position_mm for led in leds]), rig)


def _angles(positions: Points, rig: Rig) -> Points:
    truth = np.array([led.position_mm for led in rig.leds])
    units = [a / np.linalg.norm(a, axis=1, keepdims=True) for a in (positions, truth)]
    return np.asarray(np.degrees(2 * np.arcsin(np.linalg.norm(units[0] - units[1], axis=1) / 2)))


def _scene(rig: Rig, place: tuple[float, float], nail_mm: float) -> NailScene:
    tilt = rig.provenance.get("base_tilt_deg", (0.0, 0.0))
    return NailScene(
        camera=rig.camera,
        leds=rig.leds,
        position_mm=place,
        nail_mm=nail_mm,
        tilt_deg=(float(tilt[0]), float(tilt[1])),
    )


def _tip(band: str, led: int, nail: int, nail_px: Points, tip_px: Points) -> Tip:
    return Tip(
        band,
        led,
        nail,
        (float(nail_px[0]), float(nail_px[1])),
        (float(tip_px[0]), float(tip_px[1])),
    )


def _sorted(tips: Sequence[Tip]) -> list[Tip]:
    return sorted(tips, key=lambda tip: (BANDS.index(tip.band), tip.led, tip.nail))


def _note(where: dict[str, list[Points]], name: str, values: Points) -> None:
    where.setdefault(name, []).append(values)


if __name__ == "__main__":
    sys.exit(main())
