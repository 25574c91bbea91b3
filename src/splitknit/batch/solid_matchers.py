"""The matchers of a batch that compare features in space: minutiae, by pairs and by tetrahedra, and surface codes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from splitknit.batch.matchers import Matcher, Values
from splitknit.batch.pairs import Blocks
from splitknit.batch.reading import Place, small_column
from splitknit.matching.minutiae3d import PreparedMinutiae3D, minutiae3d_match
from splitknit.matching.minutiae3d_record import unpack_space_minutiae
from splitknit.matching.minutiae_edge import EDGE_MM
from splitknit.matching.surface_code import unpack_surface_code
from splitknit.matching.surface_code_match import PreparedSurface, surface_code_match
from splitknit.matching.tetrahedra import PreparedTetrahedra, tetrahedra_match
from splitknit.recipe.matchable import MatchingSettings
from splitknit.recipe.space_minutiae import SLOPE_SIGMA_MM


class Minutiae3DMatcher(Matcher):
    """Minutiae in space, aligned by reference pairs."""

    name = "minutiae3d"
    columns = ("agreeing",)
    source = "minutiae3d"
    blocks = Blocks(128, 16)

    def __init__(self, settings: MatchingSettings) -> None:  # noqa: D107
        self.settings = settings.minutiae3d

    def database(self, place: Place) -> Any:  # noqa: D102
        found = unpack_space_minutiae(small_column(place, "minutiae3d"))
        return PreparedMinutiae3D(found, self.settings) if found.acquired else None

    def compare(self, a: Any, b: Any) -> Values:  # noqa: D102
        found = minutiae3d_match(a, b)
        return {"similarity": found.similarity, "agreeing": float(found.agreeing)}

    def document(self) -> Any:  # noqa: D102
        return {"extraction": "mindtct", "edge_mm": EDGE_MM, "slope_mm": SLOPE_SIGMA_MM, self.name: self.settings}


class TetrahedraMatcher(Matcher):
    """Minutiae in space, aligned by tetrahedra; a side that is ready takes 1 MB."""

    name = "tetrahedra"
    columns = ("agreeing", "alike")
    source = "minutiae3d"
    blocks = Blocks(128, 16)

    def __init__(self, settings: MatchingSettings) -> None:  # noqa: D107
        self.settings = settings.tetrahedra

    def database(self, place: Place) -> Any:  # noqa: D102
        found = unpack_space_minutiae(small_column(place, "minutiae3d"))
        return PreparedTetrahedra(found, self.settings) if found.acquired else None

    def compare(self, a: Any, b: Any) -> Values:  # noqa: D102
        found = tetrahedra_match(a, b)
        return {"similarity": found.similarity, "agreeing": float(found.agreeing), "alike": float(found.tetrahedra)}

    def document(self) -> Any:  # noqa: D102
        return {"extraction": "mindtct", "edge_mm": EDGE_MM, "slope_mm": SLOPE_SIGMA_MM, self.name: self.settings}


class SurfaceCodeMatcher(Matcher):
    """Finger surface codes; a side that is ready takes up to 15 MB."""

    name = "surface-code"
    columns = ("distance", "overlap_mm2", "rotation_deg")
    source = "surface_codes"
    blocks = Blocks(48, 43)

    def __init__(self, settings: MatchingSettings) -> None:  # noqa: D107
        self.code, self.settings = settings.surface_code, settings.surface_match

    def database(self, place: Place) -> Any:  # noqa: D102
        found = unpack_surface_code(small_column(place, "surface_code"))
        return None if found.empty else PreparedSurface(found, self.settings)

    def compare(self, a: Any, b: Any) -> Values:  # noqa: D102
        found = surface_code_match(a, b)
        return {
            "similarity": found.similarity,
            "distance": found.distance,
            "overlap_mm2": found.overlap_mm2,
            "rotation_deg": found.rotation_deg,
        }

    def document(self) -> Any:  # noqa: D102
        return {"surface_code": self.code, "surface_match": self.settings}


SOLID_MATCHERS: Mapping[str, Callable[[MatchingSettings], Matcher]] = MappingProxyType(
    {kind.name: kind for kind in (Minutiae3DMatcher, TetrahedraMatcher, SurfaceCodeMatcher)}
)
