"""The matchers of a batch: each makes a side ready once, and compares two sides. What is ready is kept in two bounded
stores: the sides of a block's database, and one query.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from splitknit_match.batch.population import Blocks
from splitknit_match.batch.reading import Place, images_of, small_column
from splitknit_match.matching.minutiae import EDGE_MM, minutiae_match
from splitknit_match.matching.minutiae_record import unpack_minutiae
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.surface import MatchingSettings
from splitknit_match.matching.template import unpack
from splitknit_match.matching.thesis import ATTRIBUTES, ThesisSettings, finger_features, thesis_match
from splitknit_match.matching.thesis_code import CodeSide, code_match, code_side

Values = Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Matcher:
    """One method of comparing two captures."""

    name: str
    columns: tuple[str, ...]  # beside the similarity
    source: str  # folder of the store that it reads
    blocks: Blocks
    document: Any  # all settings
    database: Callable[[Place], Any]  # one side, ready, or None where it could not be acquired
    query: Callable[[Place], Any]  # the other side
    compare: Callable[[Any, Any], Values]  # ``similarity`` and the columns

    def blocks_for(self, impostors: float) -> Blocks:
        """Blocks of about as many comparisons where only a fraction of the impostors is compared."""
        return Blocks(self.blocks.database, round(self.blocks.query / max(impostors, 0.02)))


def matcher(name: str, settings: MatchingSettings) -> Matcher:
    """The matcher of that name."""
    own: dict[str, Callable[[], Matcher]] = {
        "ridge": _by_ridges,
        "thesis": lambda: _by_thesis(settings.thesis),
        "thesis-code": _by_thesis_code,
        "minutiae": _by_minutiae,
    }
    return own[name]()


def _values(found: Any, columns: tuple[str, ...]) -> Values:
    """``similarity`` and the columns of a result that has fields of these names."""
    return {name: float(getattr(found, name)) for name in ("similarity", *columns)}


def _by_ridges() -> Matcher:
    """Ridge templates; a side that is ready takes up to 9 MB."""
    columns = ("correlation", "overlap_mm2", "rotation_deg")

    def ready(place: Place) -> Prepared | None:
        payload = small_column(place, "template")
        return Prepared(unpack(payload)) if payload else None

    def compare(a: Prepared, b: Prepared) -> Values:
        return _values(ridge_match(a, b), columns)

    return Matcher("ridge", columns, "features", Blocks(48, 43), {}, ready, ready, compare)


def _by_thesis(settings: ThesisSettings) -> Matcher:
    """The thesis's matcher without its gate, of all attributes; a side of the database takes 1.9 MB at 30 px/mm."""
    every = replace(settings, gate=0.0, attributes=tuple(ATTRIBUTES))
    columns = ("ratio", "shift_px", *(f"dissimilarity_{name}" for name in ATTRIBUTES))

    def ready(place: Place) -> Any:
        images = images_of(place)
        return None if images is None else (replace(images, channels={}), finger_features(images, every))

    def compare(a: Any, b: Any) -> Values:
        images, features = a
        found = thesis_match(images, b, every, features)
        chosen = [found.dissimilarity[name] for name in settings.attributes]
        dissimilarity = {f"dissimilarity_{name}": value for name, value in found.dissimilarity.items()}
        similarity = 1.0 - sum(chosen) / len(chosen)
        return {"similarity": similarity, "ratio": found.ratio, "shift_px": float(found.shift_px), **dissimilarity}

    document = {"thesis": every, "similarity_of": list(settings.attributes)}
    return Matcher("thesis", columns, "features", Blocks(128, 16), document, ready, images_of, compare)


def _by_thesis_code() -> Matcher:
    """The matcher of the thesis author's program; a side of the database takes 4 MB at 30 px/mm."""
    columns = ("ratio", "shift_px", *(f"score_{name}" for name in ATTRIBUTES))

    def ready(place: Place) -> CodeSide | None:
        images = images_of(place)
        return None if images is None else code_side(images)

    def compare(a: CodeSide, b: CodeSide) -> Values:
        found = code_match(a, b)
        scores = {f"score_{name}": score for name, score in found.scores.items()}
        return {"similarity": found.similarity, "ratio": found.ratio, "shift_px": float(found.shift_px), **scores}

    return Matcher("thesis-code", columns, "features", Blocks(128, 16), {}, ready, ready, compare)


def _by_minutiae() -> Matcher:
    """Minutiae of prints, compared by bozorth3."""

    def ready(place: Place) -> Any:
        found = unpack_minutiae(small_column(place, "minutiae"))
        return found if found.acquired else None

    def compare(a: Any, b: Any) -> Values:
        score = minutiae_match(a, b)
        return {"similarity": score, "bozorth3": score}

    document = {"extraction": "mindtct", "comparison": "bozorth3", "edge_mm": EDGE_MM}
    return Matcher("minutiae", ("bozorth3",), "minutiae", Blocks(128, 8), document, ready, ready, compare)


class _Ready(threading.local):
    """Sides of the database that this thread has ready: those of one block."""

    def __init__(self) -> None:
        self.key: Any = None
        self.sides: OrderedDict[str, Any] = OrderedDict()

    def of(self, key: Any, capture: str, matcher: Matcher, place: Place) -> Any:
        """The side of `capture`; all that is kept of another `key` is let go."""
        if key != self.key:
            self.key = key
            self.sides.clear()
        if capture not in self.sides:
            self.sides[capture] = matcher.database(place)
        return self.sides[capture]

    def forget(self) -> None:
        """Let go of all that is kept."""
        self.key = None
        self.sides.clear()


READY = _Ready()
