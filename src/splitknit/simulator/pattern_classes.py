"""Classes of prints by digit and hand, in the frequencies that people have."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import ndtr

Five = tuple[float, float, float, float, float]

DIGITS = ("thumb", "index", "middle", "ring", "little")
SIDES = ("right", "left")

ARCHES: Mapping[str, Five] = {"right": (0.03, 0.17, 0.07, 0.02, 0.01), "left": (0.05, 0.17, 0.08, 0.03, 0.02)}
"""Share of arches by digit, thumb to little finger (Galton 1892, chapter VIII, 5000 digits of 500 persons)."""
WHORLS: Mapping[str, Five] = {"right": (0.44, 0.30, 0.15, 0.45, 0.13), "left": (0.30, 0.28, 0.16, 0.31, 0.08)}
"""Share of whorls; the rest are loops (the same table)."""
RADIAL: Five = (0.01, 0.39, 0.04, 0.02, 0.01)
"""Share of the loops that open to the thumb's side: 39 % on fore-fingers (Galton), rare elsewhere."""
TENTED, TWIN = 0.44, 0.18
"""Tented ones among arches and twin loops among whorls, as in :data:`splitknit.simulator.finger.FREQUENCIES`."""


def class_shares(side: str, digit: str) -> dict[str, float]:
    """Share of every class among the prints of a digit; they sum to one."""
    k = DIGITS.index(digit)
    arch, whorl = ARCHES[side][k], WHORLS[side][k]
    radial, ulnar = ("left_loop", "right_loop") if side == "right" else ("right_loop", "left_loop")
    loop = 1.0 - arch - whorl
    return {
        "arch": arch * (1.0 - TENTED),
        "tented_arch": arch * TENTED,
        radial: loop * RADIAL[k],
        ulnar: loop * (1.0 - RADIAL[k]),
        "whorl": whorl * (1.0 - TWIN),
        "twin_loop": whorl * TWIN,
    }


def pattern_class(rng: np.random.Generator, score: float, side: str, digit: str) -> str:
    """Class of a print in the digit's frequencies: arches where a standard normal `score` is low, whorls where high.

    Scores that are alike in a person's fingers make their classes alike. On the print of a right hand the little
    finger's side is to the right: ulnar loops open there.

    References
    ----------
    Galton 1892, Finger prints, chapter VIII, table I.
    """
    k = DIGITS.index(digit)
    quantile = float(ndtr(score))
    details = rng.random(2)
    if quantile < ARCHES[side][k]:
        return "tented_arch" if details[0] < TENTED else "arch"
    if quantile > 1.0 - WHORLS[side][k]:
        return "twin_loop" if details[0] < TWIN else "whorl"
    radial = bool(details[1] < RADIAL[k])
    return "right_loop" if radial != (side == "right") else "left_loop"
