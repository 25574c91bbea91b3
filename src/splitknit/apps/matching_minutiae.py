"""The method ``minutiae`` of ``splitknit match``: the prints of both sides, their minutiae, and what bozorth3 says."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.apps.fmr_tables import fmr_table
from splitknit.apps.matching_inputs import Side, naming, read_print
from splitknit.errors import BadInput
from splitknit.matching import ridge_match
from splitknit.matching.minutiae import NFIQ2_FAILED, extract, minutiae_match, nfiq2
from splitknit.matching.score import joined_similarity
from splitknit.recipe.matchable import surface_print

_FMR_TABLE = "match_fmr_minutiae.json"
"""Made by validation/match/impostors_minutiae.py."""
_PPI = 500.0


def compare_minutiae(a: Side, b: Side) -> dict[str, Any]:
    """Facts of a comparison by minutiae: similarity, false match rate, and what each side's print holds.

    Surfaces are compared by their relief prints as they are, prints from files after enhancement.

    Raises
    ------
    BadInput
        If a side is a template of ridges, or nbis-py is not installed.
    """
    found, facts = [], []
    for side in (a, b):
        image, ppi, pressed = _print_of(side)
        minutiae = naming(side.path, lambda: extract(image, ppi, enhance=pressed))  # noqa: B023
        quality = nfiq2(image, ppi)
        found.append(minutiae)
        facts.append(
            {
                "minutiae": minutiae.count,
                "nfiq2": None if quality == NFIQ2_FAILED else quality,
                "acquired": minutiae.acquired,
                "enhanced": pressed,
            }
        )
    compared = all(one.acquired for one in found)
    similarity = minutiae_match(*found)
    rate, why = _rate(a, b, similarity, compared)
    return {
        "similarity": similarity,
        "similarity_with_ridges": _joined(a, b, similarity) if compared else None,
        "fmr": rate,
        "fmr_missing": why,
        "compared": compared,
        "sides": facts,
    }


def minutiae_false_match_rate(similarity: float) -> float | None:
    """Rate at which other (simulated) fingers' relief prints reach this similarity; None without a table."""
    table = fmr_table(_FMR_TABLE)
    return None if table is None else table(similarity)


def _joined(a: Side, b: Side, similarity: float) -> float | None:
    """Minutiae and ridges as one score, for which the templates of the ridges are at hand."""
    if a.template is None or b.template is None:
        return None
    found = ridge_match(a.template, b.template)
    return joined_similarity(similarity, found.similarity if found.compared else float("nan"))


def _rate(a: Side, b: Side, similarity: float, compared: bool) -> tuple[float | None, str | None]:
    """False match rate, or why there is none."""
    if not compared:
        return None, "nothing was compared"
    if a.surface is None or b.surface is None:
        return None, "rates were measured on relief prints of surfaces, not on prints from files"
    rate = minutiae_false_match_rate(similarity)
    return rate, None if rate is not None else "no rates were measured"


def _print_of(side: Side) -> tuple[NDArray[np.uint8], float, bool]:
    """The print of a side, its resolution, and whether it comes from a file."""
    if side.surface is not None:
        return naming(side.path, partial(surface_print, side.surface, _PPI)), _PPI, False
    if side.kind != "print":
        raise BadInput(
            f"{side.path} is a {side.kind} of ridges, which keeps no minutiae; name a capture, a result or a print."
        )
    return (*read_print(side.path), True)
