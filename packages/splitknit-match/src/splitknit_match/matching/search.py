"""Search of one finger among very many: codes of fixed length, and a glance at the ridges of the best."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from splitknit import Checked, FloatArray, Limits, require
from splitknit_match.matching.code import ProbeSettings, laid_on
from splitknit_match.matching.elastic import compare_patches
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template

EXHAUSTIVE = 2000
"""In a gallery of no more fingers all are compared by their ridges."""
PRESSED_MM = 2.0
"""Prints are searched with shifts up to this: about the standard deviation of where a finger is put on a sensor."""
_BLOCK = 1024
"""Codes that are widened to float32 at a time: what a core's cache holds."""


@dataclass(frozen=True, slots=True)
class SearchSettings(Checked):
    """How a gallery is searched."""

    candidates: Annotated[int, Limits(1)] = 50
    """Number of fingers selected by their codes whose ridges are compared."""
    shortlist: Annotated[int, Limits(1, 10_000)] = 500
    """Number of fingers that the shards select for the next stage, where a gallery has shards."""
    probe: ProbeSettings = field(default_factory=ProbeSettings)
    """How fingers are moved for the codes; for prints the shift is at least `PRESSED_MM`."""

    def variants_of(self, probe: Template) -> ProbeSettings:
        """How a probe is laid: a print, which has minutiae, lies further off than a finger before a camera."""
        one = self.probe
        if probe.minutiae is None:
            return one
        return replace(one, right_mm=max(one.right_mm, PRESSED_MM), down_mm=max(one.down_mm, PRESSED_MM))


def nearest_codes(codes: NDArray[np.int8], variants: FloatArray, k: int) -> tuple[list[int], FloatArray]:
    """Places and scores of the `k` codes (N, K) most similar to one of a probe's variants (V, K).

    Best first, equal ones in their order; scores from -1 to about 1. All are looked at.
    """
    require(k >= 1, f"k must be at least 1, but it is {k}.")
    best = np.empty(len(codes), dtype=np.float32)
    left = np.ascontiguousarray(variants, dtype=np.float32)
    for start in range(0, len(best), _BLOCK):
        part = codes[start : start + _BLOCK].astype(np.float32)
        best[start : start + _BLOCK] = (left @ part.T).max(axis=0)
    order = np.argsort(-best, kind="stable")[:k]
    return order.tolist(), best[order]


def glance(probe: Prepared, other: Prepared, settings: ProbeSettings, variant: int) -> float:
    """How well patches of the probe's ridges are found in the other finger, laid as its code fits best.

    Returns agreement times the root of the number of patches; -1 for a failure to acquire. `variant`: number of the
    probe's variant that fits best. Raises BadInput if the templates have different pitches.
    """
    if other.template.empty:
        return -1.0
    require(
        probe.template.pitch_mm == other.template.pitch_mm,
        f"templates have pitches of {probe.template.pitch_mm:g} and {other.template.pitch_mm:g} mm; make both new.",
    )
    turn, right, down = (float(values[variant]) for values in settings.variants())
    start = laid_on(probe.template, other.template, turn, right, down)
    seen = compare_patches(probe.first, other.value, other.template.valid, start)
    return float(seen.mean * np.sqrt(len(seen.used)))
