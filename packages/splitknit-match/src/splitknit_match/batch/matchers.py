"""The matchers of a batch: each prepares a side once, and compares two sides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.io.images import decode_image
from splitknit.registry import own_object
from splitknit_match.batch.store import Place
from splitknit_match.matching.methods import OwnMatcher
from splitknit_match.matching.minutiae_match import minutiae_match
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.surface import surface_images
from splitknit_match.matching.template import unpack
from splitknit_match.matching.thesis import (
    ATTRIBUTES,
    FingerImages,
    ImageMatch,
    ThesisSettings,
    finger_features,
    thesis_match,
)
from splitknit_match.matching.thesis_code import CodeSide, code_match, code_side
from splitknit_match.prints.minutiae import EDGE_MM
from splitknit_match.records.minutiae_record import Minutiae, unpack_minutiae

Values = dict[str, float]
_RIDGE = ("correlation", "overlap_mm2", "rotation_deg")
_SHIFT = ("ratio", "shift_px")
_THESIS = ThesisSettings(gate=0.0, attributes=tuple(ATTRIBUTES))
"""All distances of the thesis, without a gate: what is reported is chosen later. Source:
definition."""


@dataclass(frozen=True, slots=True, eq=False)
class Matcher:
    """One method of comparing two captures."""

    columns: tuple[str, ...]  # beside the similarity
    fingers: int  # sides of the database that are prepared at once
    document: Any  # all settings
    database: Callable[[Place], Any]  # one side, or None where it could not be acquired
    query: Callable[[Place], Any]
    compare: Callable[[Any, Any], Values]  # ``similarity`` and the columns
    source: str = "features"  # folder of the store that it reads


def _ridges(place: Place) -> Prepared | None:
    payload = place.value("template")
    return Prepared(unpack(payload)) if payload else None


def _by_ridges(a: Prepared, b: Prepared) -> Values:
    match = ridge_match(a, b)
    return {name: float(getattr(match, name)) for name in ("similarity", *_RIDGE)}


def _images(place: Place) -> FingerImages | None:
    surface = place.surface()
    return None if surface is None else surface_images(surface)


def _features(place: Place) -> Any:
    images = _images(place)
    if images is None:
        return None
    return replace(images, channels={}), finger_features(images, _THESIS)


def _by_thesis(a: Any, b: FingerImages) -> Values:
    images, features = a
    match = thesis_match(images, b, _THESIS, features)
    chosen = [match.dissimilarity[name] for name in ThesisSettings().attributes]
    own = {f"dissimilarity_{name}": value for name, value in match.dissimilarity.items()}
    return _laid(match, 1.0 - sum(chosen) / len(chosen)) | own


def _laid(match: ImageMatch, similarity: float) -> Values:
    return {"similarity": similarity, "ratio": match.ratio, "shift_px": float(match.shift_px)}


def _codes(place: Place) -> CodeSide | None:
    images = _images(place)
    return None if images is None else code_side(images)


def _by_code(a: CodeSide, b: CodeSide) -> Values:
    match = code_match(a, b)
    own = {f"score_{name}": 1.0 - distance for name, distance in match.distances.items()}
    return _laid(match, match.similarity) | own


def _stored_minutiae(place: Place) -> Minutiae | None:
    minutiae = unpack_minutiae(place.value("minutiae"))
    return minutiae if minutiae.acquired else None


def _print(place: Place) -> NDArray[np.uint8] | None:
    data = place.value("print")
    return np.asarray(decode_image(data, "the print")[..., 0]) if data else None


def matcher_of(name: str) -> Matcher:
    """A matcher of :data:`MATCHERS`, or somebody's own. Raises BadInput if there is none."""
    if name in MATCHERS:
        return MATCHERS[name]
    compare: OwnMatcher = own_object("matcher", name, MATCHERS)
    return Matcher(
        (),
        128,
        {"matcher": name},
        _print,
        _print,
        lambda a, b: {"similarity": float(compare(a, b))},
    )


MATCHERS = {
    # a side takes up to 9 MB
    "ridge": Matcher(_RIDGE, 48, {}, _ridges, _ridges, _by_ridges),
    # without its gate; 1.9 MB at 30 px/mm
    "thesis": Matcher(
        (*_SHIFT, *(f"dissimilarity_{name}" for name in ATTRIBUTES)),
        128,
        {"thesis": _THESIS, "similarity_of": list(ThesisSettings().attributes)},
        _features,
        _images,
        _by_thesis,
    ),
    # that of the thesis author's program; 4 MB
    "thesis-code": Matcher(
        (*_SHIFT, *(f"score_{name}" for name in ATTRIBUTES)), 128, {}, _codes, _codes, _by_code
    ),
    "minutiae": Matcher(
        (),
        128,
        {"extraction": "mindtct", "comparison": "agreeing minutiae", "edge_mm": EDGE_MM},
        _stored_minutiae,
        _stored_minutiae,
        lambda a, b: {"similarity": minutiae_match(a, b)},
        "minutiae",
    ),
}
