"""The methods of ``splitknit match`` that compare surfaces in space, after Kumar and Kwong and after Lin and Kumar."""

from __future__ import annotations

from functools import partial
from typing import Any

from splitknit.apps.matching_inputs import MatchingSettings, Side, Surface, naming
from splitknit.errors import BadInput
from splitknit.matching.minutiae3d import minutiae3d_match, tetrahedra_match
from splitknit.matching.surface_code import surface_code_match
from splitknit.recipe.space_minutiae import space_minutiae
from splitknit.recipe.surface_codes import surface_code


def compare_in_space(a: Side, b: Side, method: str, settings: MatchingSettings) -> dict[str, Any]:
    """Facts of a comparison by ``minutiae3d``, ``surface-code`` or ``tetrahedra``.

    Raises
    ------
    BadInput
        If a side is a template or a print, which have no surface, or nbis-py is not installed and minutiae are wanted.
    """
    surfaces = [_surface(side, method) for side in (a, b)]
    compare = _by_codes if method == "surface-code" else partial(_by_minutiae, method)
    return {"fmr": None, **compare((a, b), surfaces, settings)}


def _surface(side: Side, method: str) -> Surface:
    if side.surface is None:
        raise BadInput(
            f"{side.path} is a {side.kind}; the method {method} compares surfaces: name a capture or a result."
        )
    return side.surface


def _by_minutiae(
    method: str, sides: tuple[Side, Side], surfaces: list[Surface], settings: MatchingSettings
) -> dict[str, Any]:
    left, right = (
        naming(side.path, partial(space_minutiae, surface)) for side, surface in zip(sides, surfaces, strict=True)
    )
    facts: dict[str, Any] = {}
    if method == "tetrahedra":
        by_shape = tetrahedra_match(left, right, settings.tetrahedra)
        similarity, agreeing, compared = by_shape.similarity, by_shape.agreeing, by_shape.compared
        facts["tetrahedra"] = by_shape.tetrahedra
    else:
        by_pairs = minutiae3d_match(left, right, settings.minutiae3d)
        similarity, agreeing, compared = by_pairs.similarity, by_pairs.agreeing, by_pairs.compared
    own = [{"minutiae": one.count, "acquired": one.acquired} for one in (left, right)]
    return {"similarity": similarity, "compared": compared, "agreeing": agreeing, **facts, "sides": own}


def _by_codes(sides: tuple[Side, Side], surfaces: list[Surface], settings: MatchingSettings) -> dict[str, Any]:
    left, right = (
        naming(side.path, partial(surface_code, surface, settings.surface_code))
        for side, surface in zip(sides, surfaces, strict=True)
    )
    found = surface_code_match(left, right, settings.surface_match)
    return {
        "similarity": found.similarity,
        "compared": found.compared,
        "distance": found.distance,
        "overlap_mm2": found.overlap_mm2,
        "alignment": {"rotation_deg": found.rotation_deg},
        "sides": [{"code_mm2": one.area_mm2, "acquired": not one.empty} for one in (left, right)],
    }
