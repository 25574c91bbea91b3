"""The matchers of a batch: each makes a side ready once, and compares two sides.

What is ready is kept in two bounded stores: the sides of a block's database, and one query. A process that goes on with
the same database finds it ready.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, ClassVar

from splitknit.batch.population import Blocks
from splitknit.batch.reading import Place, images_of, small_column
from splitknit.matching.minutiae import EDGE_MM, minutiae_match
from splitknit.matching.minutiae3d import PreparedMinutiae3D, PreparedTetrahedra, minutiae3d_match, tetrahedra_match
from splitknit.matching.minutiae_record import unpack_minutiae, unpack_space_minutiae
from splitknit.matching.ridge import Prepared, RidgeMatchSettings, ridge_match
from splitknit.matching.space_features import SLOPE_SIGMA_MM
from splitknit.matching.surface import MatchingSettings
from splitknit.matching.surface_code import PreparedSurface, surface_code_match, unpack_surface_code
from splitknit.matching.template import unpack
from splitknit.matching.thesis import ATTRIBUTES, ThesisSettings, finger_features, thesis_match

Values = Mapping[str, float]


class Matcher(ABC):
    """One method of comparing two captures."""

    name: ClassVar[str]
    columns: ClassVar[tuple[str, ...]]
    """Beside the similarity."""
    source: ClassVar[str] = "features"
    """Folder of the store that it reads."""
    blocks: ClassVar[Blocks]

    def blocks_for(self, impostors: float) -> Blocks:
        """Blocks of about as many comparisons where only a fraction of the impostors is compared."""
        return Blocks(self.blocks.database, round(self.blocks.query / max(impostors, 0.02)))

    @abstractmethod
    def database(self, place: Place) -> Any:
        """One side, ready, or None where it could not be acquired."""

    def query(self, place: Place) -> Any:
        """The other side."""
        return self.database(place)

    @abstractmethod
    def compare(self, a: Any, b: Any) -> Values:
        """``similarity`` and the columns."""

    def values(self, found: Any) -> Values:
        """``similarity`` and the columns, where a method's result has fields of these names."""
        return {name: float(getattr(found, name)) for name in ("similarity", *self.columns)}

    @abstractmethod
    def document(self) -> Any:
        """All settings."""


class _RidgeMatcher(Matcher):
    """Ridge templates; a side that is ready takes up to 9 MB."""

    name = "ridge"
    columns = ("correlation", "overlap_mm2", "rotation_deg")
    blocks = Blocks(48, 43)

    def __init__(self, settings: RidgeMatchSettings) -> None:
        self.settings = settings

    def database(self, place: Place) -> Prepared | None:
        payload = small_column(place, "template")
        return Prepared(unpack(payload), self.settings) if payload else None

    def compare(self, a: Prepared, b: Prepared) -> Values:
        return self.values(ridge_match(a, b))

    def document(self) -> Any:
        return self.settings


class _ThesisMatcher(Matcher):
    """The thesis's matcher without its gate, of all attributes; a side of the database takes 1.9 MB at 30 px/mm."""

    name = "thesis"
    columns = ("ratio", "shift_px", *(f"dissimilarity_{name}" for name in ATTRIBUTES))
    blocks = Blocks(128, 16)

    def __init__(self, settings: ThesisSettings) -> None:
        self.attributes = settings.attributes
        self.settings = replace(settings, gate=0.0, attributes=tuple(ATTRIBUTES))

    def database(self, place: Place) -> Any:
        images = images_of(place)
        return None if images is None else (replace(images, channels={}), finger_features(images, self.settings))

    def query(self, place: Place) -> Any:
        return images_of(place)

    def compare(self, a: Any, b: Any) -> Values:
        images, features = a
        found = thesis_match(images, b, self.settings, features)
        chosen = [found.dissimilarity[name] for name in self.attributes]
        return {
            "similarity": 1.0 - sum(chosen) / len(chosen),
            "ratio": found.ratio,
            "shift_px": float(found.shift_px),
            **{f"dissimilarity_{name}": value for name, value in found.dissimilarity.items()},
        }

    def document(self) -> Any:
        return {"thesis": self.settings, "similarity_of": list(self.attributes)}


class _MinutiaeMatcher(Matcher):
    """Minutiae by mindtct, compared by bozorth3."""

    name = "minutiae"
    columns = ("bozorth3",)
    source = "minutiae"
    blocks = Blocks(128, 8)

    def database(self, place: Place) -> Any:
        found = unpack_minutiae(small_column(place, "minutiae"))
        return found if found.acquired else None

    def compare(self, a: Any, b: Any) -> Values:
        score = minutiae_match(a, b)
        return {"similarity": score, "bozorth3": score}

    def document(self) -> Any:
        return {"extraction": "mindtct", "edge_mm": EDGE_MM, "comparison": "bozorth3"}


class _VotedMatcher(_MinutiaeMatcher):
    """Minutiae on which the sets of images that leave one out agree, compared by bozorth3."""

    name = "voted"
    source = "voted"

    def __init__(self, settings: MatchingSettings) -> None:
        self.settings = settings

    def document(self) -> Any:
        own = {"leave_one_out": self.settings.leave_one_out, "voted": self.settings.voted}
        return {"extraction": "mindtct", "comparison": "bozorth3", **own}


def matcher(name: str, settings: MatchingSettings) -> Matcher:
    """The matcher of that name."""

    if name in SOLID_MATCHERS:
        return SOLID_MATCHERS[name](settings)
    if name == _VotedMatcher.name:
        return _VotedMatcher(settings)
    if name == _RidgeMatcher.name:
        return _RidgeMatcher(settings.ridge)
    return _ThesisMatcher(settings.thesis) if name == _ThesisMatcher.name else _MinutiaeMatcher()


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

# The matchers of a batch that compare features in space: minutiae, by pairs and by tetrahedra, and surface codes.


class _SpaceMatcher(Matcher):
    """Minutiae in space; a side that is ready takes up to 1 MB."""

    source = "minutiae3d"
    blocks = Blocks(128, 16)
    settings: Any

    def document(self) -> Any:
        return {"extraction": "mindtct", "edge_mm": EDGE_MM, "slope_mm": SLOPE_SIGMA_MM, self.name: self.settings}


class _Minutiae3DMatcher(_SpaceMatcher):
    """Aligned by reference pairs."""

    name = "minutiae3d"
    columns = ("agreeing",)

    def __init__(self, settings: MatchingSettings) -> None:
        self.settings = settings.minutiae3d

    def database(self, place: Place) -> Any:
        found = unpack_space_minutiae(small_column(place, "minutiae3d"))
        return PreparedMinutiae3D(found, self.settings) if found.acquired else None

    def compare(self, a: Any, b: Any) -> Values:
        return self.values(minutiae3d_match(a, b))


class _TetrahedraMatcher(_SpaceMatcher):
    """Aligned by tetrahedra."""

    name = "tetrahedra"
    columns = ("agreeing", "alike")

    def __init__(self, settings: MatchingSettings) -> None:
        self.settings = settings.tetrahedra

    def database(self, place: Place) -> Any:
        found = unpack_space_minutiae(small_column(place, "minutiae3d"))
        return PreparedTetrahedra(found, self.settings) if found.acquired else None

    def compare(self, a: Any, b: Any) -> Values:
        found = tetrahedra_match(a, b)
        return {"similarity": found.similarity, "agreeing": float(found.agreeing), "alike": float(found.proposals)}


class _SurfaceCodeMatcher(Matcher):
    """Finger surface codes; a side that is ready takes up to 15 MB."""

    name = "surface-code"
    columns = ("distance", "overlap_mm2", "rotation_deg")
    source = "surface_codes"
    blocks = Blocks(48, 43)

    def __init__(self, settings: MatchingSettings) -> None:
        self.code, self.settings = settings.surface_code, settings.surface_match

    def database(self, place: Place) -> Any:
        found = unpack_surface_code(small_column(place, "surface_code"))
        return None if found.empty else PreparedSurface(found, self.settings)

    def compare(self, a: Any, b: Any) -> Values:
        return self.values(surface_code_match(a, b))

    def document(self) -> Any:
        return {"surface_code": self.code, "surface_match": self.settings}


SOLID_MATCHERS: Mapping[str, Callable[[MatchingSettings], Matcher]] = MappingProxyType(
    {kind.name: kind for kind in (_Minutiae3DMatcher, _TetrahedraMatcher, _SurfaceCodeMatcher)}
)
