"""The checkerboard separation against the twin's own direct light, on palms and fingers.

    python validation/separation/checkerboard.py

takes some minutes on one core, writes ``checkerboard.json`` beside this file and prints a
Markdown summary. The truth is the maximum minus the minimum over *all* phases of a checkerboard of
that check size, in steps of a pixel; what is judged sees only the shifts that a projector takes.
PSNR is given for two peaks: the white image's 99.9th percentile, and that of the truth itself.

- ``noise_free``: PSNR of direct and global light by check size and shifts.
- ``noise``: shot and read noise of the twin's sensor: raw maximum and minimum against least squares
  with states known or found in the images, over all lit and dark images or in the middle of the
  checks.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from patches import (
    PATCH_SIZE,
    PX_PER_MM,
    Patch,
    decibels,
    draw_patches,
    inner,
    known_states,
    noisy_images,
    photograph,
    truth_of,
)

from patterns import Separation, checkerboard, estimate_patterns
from projector import Checkerboard, Separated

HERE = Path(__file__).resolve().parent
CHECKS_MM = (0.11, 0.21, 0.42, 0.85)
SHIFT_COUNTS = (5, 7, 9)
"""Odd: an even number of shifts shows every checkerboard twice."""


def noise_free(
    patches: dict[str, Patch], checks: Iterable[float], steps: Iterable[int]
) -> list[dict[str, Any]]:
    """PSNR of the separation by check size and number of shifts."""
    rows = []
    for name, patch in patches.items():
        for check in checks:
            truth = truth_of(patch, check)
            mask = inner(patch[0], truth)
            for count in steps:
                stack = photograph(patch, Checkerboard(check, steps=count))
                parts = checkerboard(stack, mask=mask, clip_level=None)
                what = {
                    "surface": name,
                    "check_mm": check,
                    "shifts": count**2,
                    "method": "maximum - minimum",
                }
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
                    "bias_by_noise": [
                        float((loud - quiet)[c].mean() / real[c].mean()) for c in range(3)
                    ],
                    "bias": [float((loud - real)[c].mean() / real[c].mean()) for c in range(3)],
                    "rms": [
                        float(np.sqrt(np.mean((loud - real)[c] ** 2)) / real[c].mean())
                        for c in range(3)
                    ],
                }
            )
            print(f"  {name} {method}: {rows[-1]['direct_db']}", flush=True)
    return rows


def _estimates(
    stack: np.ndarray, check_mm: float, mask: np.ndarray, states: np.ndarray
) -> dict[str, Separation]:
    """All estimates from one stack, with the states of its pixels."""
    common: dict[str, Any] = {"mask": mask, "clip_level": None}
    side = check_mm * PX_PER_MM
    estimated = estimate_patterns(stack, **common)
    return {
        "maximum - minimum": checkerboard(stack, **common),
        "known states": checkerboard(stack, patterns=states, **common),
        "known states, check_px": checkerboard(stack, patterns=states, check_px=side, **common),
        "states found, check_px": checkerboard(stack, patterns=estimated, check_px=side, **common),
    }


def summary(results: dict[str, Any]) -> str:
    """The figures that ``docs/experiments/separation.md`` has."""
    lines = []
    for check in sorted({row["check_mm"] for row in results["noise_free"]}):
        for shifts in sorted({row["shifts"] for row in results["noise_free"]}):
            group = [
                r["direct_db"]
                for r in results["noise_free"]
                if (r["check_mm"], r["shifts"]) == (check, shifts)
            ]
            least = [min(row[peak] for row in group) for peak in ("white_peak", "own_peak")]
            lines.append(
                f"{check} mm, {shifts} images: {least[0]:.1f} dB or more, own peak {least[1]:.1f}"
            )
    for method in dict.fromkeys(row["method"] for row in results["noise"]):
        group = [row for row in results["noise"] if row["method"] == method]
        levels = [row["direct_db"]["own_peak"] for row in group]
        bias = [100 * value for row in group for value in row["bias_by_noise"]]
        level = f"{min(levels):.1f} to {max(levels):.1f} dB (own peak)"
        lines.append(f"noise, {method}: {level}, by noise {min(bias):+.1f} to {max(bias):+.1f} %")
    return "\n".join(lines)


def main() -> None:
    """Run everything and store it."""
    patches = draw_patches()
    results: dict[str, Any] = {
        "px_per_mm": PX_PER_MM,
        "size": list(PATCH_SIZE),
        "noise_free": noise_free(patches, CHECKS_MM, SHIFT_COUNTS),
        "noise": noise(patches, 0.42),
        "psnr_peak": (
            "white_peak: 99.9th percentile of the white image; own_peak: of the true part itself"
        ),
    }
    (HERE / "checkerboard.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    print(summary(results))


if __name__ == "__main__":
    main()
