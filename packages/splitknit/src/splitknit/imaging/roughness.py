"""Surface texture: height parameters of profiles (ISO 4287)."""

from __future__ import annotations

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.model import Array

_SIGMA = float(np.sqrt(np.log(2.0) / 2.0) / np.pi)
"""Standard deviation over the cut-off of the Gaussian that passes half of a wave as long as the
cut-off. Source: definition of the cut-off."""

CUTOFFS_MM = (0.08, 0.25, 0.8, 2.5, 8.0)
"""Usual cut-offs. Source: ISO 4288:1996, table 1."""


def profile_roughness(
    height_mm: Array, step_mm: float, cutoff_mm: float
) -> tuple[Array, dict[str, float]]:
    """Roughness profile in um, NaN in the run-up and run-out of half a cut-off each, and its
    parameters.

    ``Ra_um`` (mean absolute height), ``Rq_um`` (root mean square), ``Rz_um`` (highest peak to
    lowest pit, mean over the sampling lengths of one cut-off), ``Rt_um`` (the same over all) and
    ``sampling_lengths``, of which ISO 4288 wants five. `height_mm`: (N,), every `step_mm`. Raises
    BadInput if a height is missing, or less than two cut-offs or eight heights a cut-off are known.
    Source: ISO 4287:1997, sections 3.1 and 4; ISO 16610-21:2011, the filter.

    >>> wave = 0.01 * np.sin(2 * np.pi * np.arange(4000) * 0.001 / 0.1)
    >>> _, figures = profile_roughness(wave, 0.001, 0.8)
    >>> round(figures["Ra_um"], 1), round(figures["Rz_um"], 1), figures["sampling_lengths"]
    (6.4, 20.0, 3)
    """
    length_mm = step_mm * (len(height_mm) - 1)
    require(
        np.isfinite(height_mm).all(),
        "the profile has a gap; choose points between which the surface is whole.",
    )
    shortest_mm, longest_mm = 8.0 * step_mm, length_mm / 2.0 + 1e-9
    fitting = [each for each in CUTOFFS_MM if shortest_mm <= each <= longest_mm]
    advice = "choose points farther apart"
    if fitting:
        advice = f"use `cutoff` {min(fitting, key=lambda each: abs(each - cutoff_mm)):g}"
    require(
        shortest_mm <= cutoff_mm <= longest_mm,
        f"this section is {length_mm:.3g} mm long, with a height every {1000 * step_mm:.3g} um, and"
        f" cannot be measured with a cut-off of {cutoff_mm:g} mm: {advice}.",
    )
    along = np.arange(len(height_mm)) * step_mm
    level = height_mm - np.polyval(np.polyfit(along, height_mm, 1), along)
    sigma = _SIGMA * cutoff_mm / step_mm
    mean = cv2.GaussianBlur(level[None], (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)[0]
    rough = 1000.0 * (level - mean)
    kept = (along >= cutoff_mm / 2 - 1e-9) & (along <= length_mm - cutoff_mm / 2 + 1e-9)
    used = rough[kept] - rough[kept].mean()
    count = int(length_mm / cutoff_mm - 1 + 1e-6)
    parts = [
        np.ptp(part)
        for part in np.array_split(used[: round(count * cutoff_mm / step_mm) + 1], count)
    ]
    figures = {
        "Ra_um": np.abs(used).mean(),
        "Rq_um": used.std(),
        "Rz_um": np.mean(parts),
        "Rt_um": np.ptp(used),
    }
    profile = np.full(len(height_mm), np.nan)
    profile[kept] = used
    return profile, {
        **{name: float(value) for name, value in figures.items()},
        "sampling_lengths": count,
    }
