"""Figures of many fingers: means with intervals, quartiles, the worst, and how many meet what is
asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Range = tuple[float, float]
RESAMPLES = 4000


@dataclass(frozen=True, slots=True)
class Row:
    """One figure: what it is called, what is asked of it, and which way is better."""

    words: str
    unit: str
    digits: int
    least: Range | None = None
    """Range that is asked for at least."""
    aim: Range | None = None
    """Range that is aimed for."""
    better: str = "low"
    """``low``, ``high``, or ``one`` (as near to 1 as can be)."""

    def cost(self, value: float) -> float:
        """Zero is perfect, more is worse."""
        if self.better == "one":
            return abs(float(np.log(max(value, 1e-6))))
        return value if self.better == "low" else -value


ROWS: dict[str, Row] = {
    "surface_rms_mm": Row("whole surface, rms", "mm", 3, (0, 0.13), (0, 0.09)),
    "ridge_correlation": Row("ridge band, correlation", "", 3, (0.85, 1), (0.97, 1), "high"),
    "ridge_gain": Row("ridge band, gain", "", 2, (0.6, 1.4), (0.9, 1.1), "one"),
    "ridge_good_area": Row(
        "area with local correlation > 0.8", "", 3, (0.90, 1), (0.95, 1), "high"
    ),
    "height_band_correlation": Row(
        "ridge band of the whole height, correlation", "", 3, (0.85, 1), (0.97, 1), "high"
    ),
    "height_band_gain": Row(
        "ridge band of the whole height, gain", "", 2, (0.6, 1.4), (0.9, 1.1), "one"
    ),
    "height_band_good_area": Row(
        "the same, area with local correlation > 0.8", "", 3, (0.90, 1), (0.95, 1), "high"
    ),
    "ridge_rms_um": Row("ridge band, rms error", "um", 1),
    "shape_rms_mm": Row("shape without ridges, rms", "mm", 3),
    "normals_mean_deg": Row("normals, mean angle", "deg", 1),
    "mask_on_finger": Row("fraction of the mask on the finger", "", 4, better="high"),
    "yaw_error_deg": Row("yaw, error", "deg", 2),
    "crease_right": Row("first crease found rightly", "", 3, better="high"),
    "crease_error_mm": Row("first crease, distance from the true one", "mm", 2),
    "uncertainty_ratio": Row("ridge error over its stated uncertainty", "", 2, better="one"),
    "within_one_sigma": Row("ridge error within one stated sigma", "", 2, better="one"),
}


def summarise(measured: Sequence[Mapping[str, Any]], presets: Sequence[str]) -> dict[str, Any]:
    """Statistics of every preset and figure over all captures; intervals resample fingers (seeds),
    not captures."""
    return {preset: _of_preset(measured, preset) for preset in presets}


def _of_preset(measured: Sequence[Mapping[str, Any]], preset: str) -> dict[str, Any]:
    tried = [(m["seed"], m["presets"][preset]) for m in measured if preset in m["presets"]]
    done = [(seed, result) for seed, result in tried if "figures" in result]
    figures = {}
    for name, row in ROWS.items():
        values = [
            (seed, result["figures"][name]) for seed, result in done if name in result["figures"]
        ]
        if values:
            figures[name] = _statistics(values, row, len(tried))
    return {
        "captures": len(tried),
        "refused": [result["refused"] for _, result in tried if "refused" in result],
        "seconds_median": float(np.median([result["seconds"] for _, result in done]))
        if done
        else None,
        "figures": figures,
    }


def _statistics(values: Sequence[tuple[int, float]], row: Row, tried: int) -> dict[str, Any]:
    numbers = np.array([value for _, value in values])
    low, middle, high = (float(q) for q in np.percentile(numbers, (25, 50, 75)))
    statistics = {
        "n": len(numbers),
        "mean": float(numbers.mean()),
        "interval": list(interval(values)),
        "median": middle,
        "quartiles": [low, high],
        "worst": float(max(numbers, key=row.cost)),
    }
    for name, wanted in (("least", row.least), ("aim", row.aim)):
        if wanted is not None:  # a refused capture meets nothing
            good = np.sum((numbers >= wanted[0]) & (numbers <= wanted[1]))
            statistics[f"meets_{name}"] = float(good) / tried
    return statistics


def interval(
    values: Sequence[tuple[int, float]],
    statistic: Callable[[Any], Any] = np.mean,
    fraction: float = 0.95,
    seed: int = 0,
) -> Range:
    """Percentile bootstrap of a statistic of (finger, value) pairs; fingers are drawn with all
    their captures."""
    groups: dict[int, list[float]] = {}
    for finger, value in values:
        groups.setdefault(finger, []).append(value)
    members = [np.array(group) for group in groups.values()]
    rng = np.random.default_rng(seed)
    draws = rng.integers(0, len(members), (RESAMPLES, len(members)))
    statistics = [float(statistic(np.concatenate([members[k] for k in draw]))) for draw in draws]
    tail = 50.0 * (1.0 - fraction)
    low, high = np.percentile(statistics, (tail, 100.0 - tail))
    return float(low), float(high)
