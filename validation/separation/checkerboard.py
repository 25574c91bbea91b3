"""The checkerboard separation against the twin's own direct light, on palms and fingers.

    python validation/separation/checkerboard.py [--smoke]

takes some minutes on one core (``--smoke`` seconds), writes ``checkerboard.json`` beside this file and prints a
Markdown summary. The truth is the maximum minus the minimum over *all* phases of a checkerboard of that check
size, in steps of a pixel; what is judged sees only the shifts that a projector takes. PSNR is given for two peaks: the
white image's 99.9th percentile, and that of the truth itself.

- ``noise_free``: PSNR of direct and global light by check size and shifts; from 25 images also by symmetry, with the
  white image or without.
- ``ideal``: opaque skin, where the pattern is ideal: largest error relative to the brightest pixel.
- ``noise``: shot and read noise of the twin's sensor: raw maximum and minimum, and symmetry, against least squares with
  states known or found in the images, over all lit and dark images or in the middle of the checks.
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
    opaque,
    palm_surface,
    photograph,
    truth_of,
)
from summary import summary

from splitknit.model import Camera, Led
from splitknit.separation.binary import checkerboard
from splitknit.separation.stacks import Separation, StackSettings, estimate_patterns
from splitknit.separation.symmetry import by_symmetry
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.light.separation import Checkerboard, Separated
from splitknit_simulator.light.skin import SkinOptics

HERE = Path(__file__).resolve().parent
CHECKS_MM = (0.11, 0.21, 0.42, 0.85)
STEPS = (5, 7, 9)
"""Odd: an even number of shifts shows every checkerboard twice."""
COAXIAL = Led("white", direction=(0.0, 0.0, 1.0))
WELL, READ_NOISE = 4700.0, 2.5
"""Electrons, as in the twin's sensor; one colour channel of one pixel, exposed to 0.7 of full scale."""
UNBOUNDED = StackSettings(clip_level=None)
"""Simulated radiance does not clip."""


def noise_free(patches: dict[str, Patch], checks: Iterable[float], steps: Iterable[int]) -> list[dict[str, Any]]:
    """PSNR of the separation by check size and number of shifts."""
    rows = []
    for name, patch in patches.items():
        for check in checks:
            truth = truth_of(patch, check)
            mask = inner(patch[0], truth)
            white = np.moveaxis(truth.white, 0, -1)
            for count in steps:
                pattern = Checkerboard(check, steps=count)
                stack = photograph(patch, pattern)
                common: dict[str, Any] = {"mask": mask, "settings": UNBOUNDED}
                common |= {"shifts": pattern.shifts_mm(), "period": 2 * check}
                found = {"maximum - minimum": checkerboard(stack, **common)}
                if count == 5:
                    found["symmetry"] = by_symmetry(stack, **common)
                    found["symmetry, white"] = by_symmetry(stack, white=white, **common)
                for method, parts in found.items():
                    what = {"surface": name, "check_mm": check, "shifts": count**2, "method": method}
                    rows.append({**what, **_judged(parts, truth, mask)})
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


def ideal(patches: dict[str, Patch]) -> list[dict[str, Any]]:
    """Opaque skin: light leaves where it entered, so direct light is all light."""
    rows = []
    for name, patch in patches.items():
        for check, alpha, dark in ((0.21, 0.5, 0.0), (0.42, 0.5, 0.1), (0.42, 0.25, 0.0), (0.42, 0.75, 0.05)):
            truth = truth_of(opaque(patch), check)
            stack = photograph(opaque(patch), Checkerboard(check, alpha=alpha, dark=dark))
            mask = inner(patch[0], truth)
            # squares of a quarter of the plane: a pixel on a steep flank may see too few shifts to be lit throughout
            found = checkerboard(stack, alpha=alpha, dark=dark, mask=mask, settings=UNBOUNDED)
            error = np.abs(found.direct[..., 0] - truth.direct[0])[mask]
            peak = float(truth.direct[0][mask].max())
            what = {"surface": name, "check_mm": check, "alpha": alpha, "dark": dark}
            fraction = float(np.abs(found.global_[..., 0][mask]).max()) / peak
            rows.append({**what, "largest_error": float(error.max()) / peak, "global_share": fraction})
    return rows


def noise(patches: dict[str, Patch], check: float) -> list[dict[str, Any]]:
    """Bias and error of the estimates on a noisy stack of 25 images."""
    rows = []
    for name, patch in patches.items():
        truth = truth_of(patch, check)
        mask = inner(patch[0], truth)
        clean = photograph(patch, Checkerboard(check))
        scale = WELL * 0.7 / np.percentile(truth.white[0][mask], 99.9)
        rng = np.random.default_rng(5)
        spread = np.sqrt(np.maximum(clean * scale, 0) + READ_NOISE**2)
        noisy = ((clean * scale + spread * rng.standard_normal(clean.shape)) / scale).astype(np.float32)
        # states with broad rims are 1 or 0 only well inside a check
        sharp, broad = (known_states(patch, truth, mask, Checkerboard(check, edge_mm=e * check)) for e in (0.0, 0.6))
        real, white = truth.direct[:, mask], truth.white[:, mask]
        estimates = [_estimates(stack, check, mask, sharp, broad) for stack in (clean, noisy)]
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


def _estimates(
    stack: np.ndarray, check_mm: float, mask: np.ndarray, sharp: np.ndarray, broad: np.ndarray
) -> dict[str, Separation]:
    """All estimates from one stack, with the states of sharp checks, and of checks with broad rims."""
    common: dict[str, Any] = {"mask": mask, "settings": UNBOUNDED}
    side = check_mm * PX_PER_MM
    found = estimate_patterns(stack, **common)
    return {
        "maximum - minimum": checkerboard(stack, **common),
        "symmetry": by_symmetry(stack, **common),
        "known states": checkerboard(stack, patterns=sharp, **common),
        "known states, broad rims": checkerboard(stack, patterns=broad, **common),
        "known states, check_px": checkerboard(stack, patterns=sharp, check_px=side, **common),
        "states found": checkerboard(stack, patterns=found, **common),
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
        "ideal": lambda: ideal(patches),
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
