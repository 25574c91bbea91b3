"""The checkerboard separation against the twin's own direct light, on palms and fingers.

    python validation/separation/checkerboard.py [--smoke]

takes some minutes on one core (``--smoke`` seconds), writes ``checkerboard.json`` beside this file and prints a
Markdown summary. The truth is the maximum minus the minimum over *all* phases of a checkerboard of that check
size, in steps of a pixel; what is judged sees only the shifts that a projector takes. PSNR is given for two peaks: the
white image's 99.9th percentile, and that of the truth itself.

- ``noise_free``: PSNR of direct and global light by check size and shifts.
- ``noise``: shot and read noise of the twin's sensor: raw maximum and minimum against least squares with states known
  or found in the images, over all lit and dark images or in the middle of the checks.
- ``ratio``: direct light over surface reflection by check size, a whole finger and a palm under the seven white LEDs.
- ``centred``: the fast truth against the one over all phases; with the projector at its LED, and in the camera's axis.

``--only PART ...`` measures some of them anew and keeps the rest.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from patches import (
    LEDS,
    PX_PER_MM,
    SIZE,
    Patch,
    decibels,
    draw_palm,
    draw_patches,
    inner,
    known_states,
    noisy_images,
    palm_surface,
    photograph,
    truth_of,
)

from splitknit.model import Camera, Led
from splitknit.separation.binary import checkerboard
from splitknit.separation.stacks import Separation, estimate_patterns
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.light.separation import Checkerboard, Separated
from splitknit_simulator.light.skin import SkinOptics

HERE = Path(__file__).resolve().parent
CHECKS_MM = (0.11, 0.21, 0.42, 0.85)
STEPS = (5, 7, 9)
"""Odd: an even number of shifts shows every checkerboard twice."""
COAXIAL = Led("white", direction=(0.0, 0.0, 1.0))
"""Simulated radiance does not clip."""


def noise_free(patches: dict[str, Patch], checks: Iterable[float], steps: Iterable[int]) -> list[dict[str, Any]]:
    """PSNR of the separation by check size and number of shifts."""
    rows = []
    for name, patch in patches.items():
        for check in checks:
            truth = truth_of(patch, check)
            mask = inner(patch[0], truth)
            for count in steps:
                pattern = Checkerboard(check, steps=count)
                stack = photograph(patch, pattern)
                common: dict[str, Any] = {"mask": mask, "clip_level": None}
                common |= {"shifts": pattern.shifts_mm(), "period": 2 * check}
                what = {"surface": name, "check_mm": check, "shifts": count**2, "method": "maximum - minimum"}
                rows.append({**what, **_judged(checkerboard(stack, **common), truth, mask)})
                print(f"  {name} {check} mm {count**2} shifts: {rows[-1]['direct_db']}", flush=True)
    return rows


def _judged(parts: Separation, truth: Separated, mask: np.ndarray) -> dict[str, Any]:
    """Direct and global light as found against the truth."""
    direct, global_ = parts.direct[mask].T, parts.global_[mask].T
    real, rest, white = truth.direct[:, mask], truth.global_[:, mask], truth.white[:, mask]
    return {
        "check_px": truth.check_mm * PX_PER_MM,
        "direct_db": decibels(direct - real, real, white),
        "channels_db": [decibels(direct[c] - real[c], real[c], white[c]) for c in range(len(real))],
        "global_db": decibels(global_ - rest, rest, white),
        "mean_error": float((direct - real).mean() / real.mean()),
        "direct_share": float(real.mean() / white.mean()),
    }


def noise(patches: dict[str, Patch], check: float) -> list[dict[str, Any]]:
    """Bias and error of the estimates on a noisy stack of 25 images."""
    rows = []
    for name, patch in patches.items():
        truth = truth_of(patch, check)
        mask = inner(patch[0], truth)
        clean = photograph(patch, Checkerboard(check))
        noisy = noisy_images(clean, truth, mask)
        states = known_states(patch, truth, mask, Checkerboard(check))
        real, white = truth.direct[:, mask], truth.white[:, mask]
        estimates = [_estimates(stack, check, mask, states) for stack in (clean, noisy)]
        for method in estimates[0]:
            quiet, loud = (parts[method].direct[mask].T for parts in estimates)
            rows.append(
                {
                    "surface": name,
                    "check_mm": check,
                    "method": method,
                    "direct_db": decibels(loud - real, real, white),
                    "noise_free_db": decibels(quiet - real, real, white),
                    "bias_by_noise": [float((loud - quiet)[c].mean() / real[c].mean()) for c in range(3)],
                    "bias": [float((loud - real)[c].mean() / real[c].mean()) for c in range(3)],
                    "rms": [float(np.sqrt(np.mean((loud - real)[c] ** 2)) / real[c].mean()) for c in range(3)],
                }
            )
            print(f"  {name} {method}: {rows[-1]['direct_db']}", flush=True)
    return rows


def _estimates(stack: np.ndarray, check_mm: float, mask: np.ndarray, states: np.ndarray) -> dict[str, Separation]:
    """All estimates from one stack, with the states of its pixels."""
    common: dict[str, Any] = {"mask": mask, "clip_level": None}
    side = check_mm * PX_PER_MM
    found = estimate_patterns(stack, **common)
    return {
        "maximum - minimum": checkerboard(stack, **common),
        "known states": checkerboard(stack, patterns=states, **common),
        "known states, check_px": checkerboard(stack, patterns=states, check_px=side, **common),
        "states found, check_px": checkerboard(stack, patterns=found, check_px=side, **common),
    }


def ratios(smoke: bool) -> list[dict[str, Any]]:
    """Direct light over surface reflection for the default skin, summed over a surface and the white LEDs."""
    camera = Camera(20.0 if smoke else PX_PER_MM, (200, 200) if smoke else (1060, 720))
    finger = finger_surface(draw_finger(500, "whorl"), FingerPose(insertion_mm=26.0), camera, workers=1)
    rows = []
    for name, surface in (("finger", finger), ("palm", palm_surface(draw_palm(500), camera))):
        for check in CHECKS_MM:
            total = np.zeros((2, 3))
            for led in LEDS[:7]:
                truth = truth_of((surface, led, SkinOptics()), check, phases="centred")
                total += truth.direct.sum(axis=(1, 2), dtype=np.float64), np.full(3, truth.glare.sum(dtype=np.float64))
            rows.append({"surface": name, "check_mm": check, "direct_over_glare": (total[0] / total[1]).tolist()})
    return rows


def centred(patches: dict[str, Patch], checks: Iterable[float]) -> list[dict[str, Any]]:
    """The fast truth against the full one."""
    rows = []
    for name, (surface, led, skin) in patches.items():
        for check in checks:
            row: dict[str, Any] = {"surface": name, "check_mm": check}
            for place, projector in (("led", led), ("coaxial", COAXIAL)):
                full, fast = (truth_of((surface, projector, skin), check, phases=kind) for kind in ("all", "centred"))
                mask = inner(surface, full)
                real, difference = full.direct[:, mask], (fast.direct - full.direct)[:, mask]
                row[f"{place}_rms"] = float(np.sqrt(np.mean(difference**2)) / real.mean())
                row[f"{place}_mean"] = float(difference.mean() / real.mean())
                row[f"{place}_db"] = decibels(difference, real, full.white[:, mask])
            rows.append(row)
            print(f"  {name} {check} mm centred: {row}", flush=True)
    return rows


def summary(results: dict[str, Any]) -> str:
    """The figures that ``docs/experiments/separation.md`` has."""
    lines = []
    for check in sorted({row["check_mm"] for row in results["noise_free"]}):
        for shifts in sorted({row["shifts"] for row in results["noise_free"]}):
            group = [r["direct_db"] for r in results["noise_free"] if (r["check_mm"], r["shifts"]) == (check, shifts)]
            least = [min(row[peak] for row in group) for peak in ("white_peak", "own_peak")]
            lines.append(f"{check} mm, {shifts} images: {least[0]:.1f} dB or more, own peak {least[1]:.1f}")
    for method in dict.fromkeys(row["method"] for row in results["noise"]):
        group = [row for row in results["noise"] if row["method"] == method]
        levels = [row["direct_db"]["own_peak"] for row in group]
        bias = [100 * value for row in group for value in row["bias_by_noise"]]
        level = f"{min(levels):.1f} to {max(levels):.1f} dB (own peak)"
        lines.append(f"noise, {method}: {level}, by noise {min(bias):+.1f} to {max(bias):+.1f} %")
    for row in results["ratio"]:
        over = ", ".join(f"{value:.2f}" for value in row["direct_over_glare"])
        lines.append(f"{row['surface']}, {row['check_mm']} mm: direct over surface reflection {over}")
    for row in results["centred"]:
        lines.append(f"{row['surface']}, {row['check_mm']} mm, the fast truth: {100 * row['led_rms']:.2f} % rms")
    return "\n".join(lines)


def main() -> None:
    """Run everything and store it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--smoke", action="store_true", help="small crops, one check size, nothing stored")
    parser.add_argument("--only", nargs="+", help="parts to measure")
    parser.add_argument("--out", type=Path, default=HERE / "checkerboard.json")
    arguments = parser.parse_args()
    start = time.monotonic()
    patches = draw_patches(arguments.smoke)
    checks = (0.21,) if arguments.smoke else CHECKS_MM
    one = {name: patch for name, patch in patches.items() if name.endswith("0")}
    parts: dict[str, Callable[[], list[dict[str, Any]]]] = {
        "noise_free": lambda: noise_free(patches, checks, STEPS[:1] if arguments.smoke else STEPS),
        "noise": lambda: noise(patches, checks[-1] if arguments.smoke else 0.42),
        "ratio": lambda: ratios(arguments.smoke),
        "centred": lambda: centred(one, checks[:3]),
    }
    results: dict[str, Any] = {"px_per_mm": PX_PER_MM, "size": list(SIZE)}
    if arguments.only:
        results |= json.loads(arguments.out.read_text(encoding="utf-8"))
    results |= {name: part() for name, part in parts.items() if name in (arguments.only or parts)}
    results["psnr_peak"] = "white_peak: 99.9th percentile of the white image; own_peak: of the true part itself"
    if not arguments.smoke:
        arguments.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    print(summary(results))
    print(f"{time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
