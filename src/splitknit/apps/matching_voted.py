"""The method ``voted`` of ``splitknit match``: minutiae on which the sets of images that leave one out agree."""

from __future__ import annotations

from typing import Any

from splitknit.apps.matching_inputs import Side, naming
from splitknit.errors import BadInput
from splitknit.io import read_capture
from splitknit.matching.leave_one_out import voted_minutiae
from splitknit.matching.minutiae import minutiae_match
from splitknit.matching.minutiae_record import Minutiae
from splitknit.matching.surface import MatchingSettings
from splitknit.pipeline import preset_settings


def compare_voted(a: Side, b: Side, preset: str, settings: MatchingSettings) -> dict[str, Any]:
    """Facts of a comparison by voted minutiae: similarity, and what each side's images hold.

    Raises
    ------
    BadInput
        If a side is no capture, or nbis-py is not installed.
    """
    for side in (a, b):
        if side.kind != "capture":
            raise BadInput(
                f"{side.path} is a {side.kind} without the images that it was made of, which the method voted needs; "
                "name the capture itself, or compare with the method minutiae."
            )
    sides = [_voted(side, preset, settings) for side in (a, b)]
    facts = [{"minutiae": one.count, "acquired": one.acquired, "enhanced": False} for one in sides]
    return {
        "similarity": minutiae_match(*sides),
        "similarity_with_ridges": None,
        "fmr": None,
        "fmr_missing": "rates were measured on minutiae of relief prints, not on voted ones",
        "compared": all(one.acquired for one in sides),
        "sides": facts,
    }


def _voted(side: Side, preset: str, settings: MatchingSettings) -> Minutiae:
    capture = read_capture(side.path)
    return naming(
        side.path, lambda: voted_minutiae(capture, preset_settings(preset), settings.leave_one_out, settings.voted)
    )
