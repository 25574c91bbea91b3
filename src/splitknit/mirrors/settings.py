"""How the finger's shape is read off one image with mirrors."""

from __future__ import annotations

from dataclasses import dataclass, field

from splitknit.errors import require


@dataclass(frozen=True, slots=True)
class ViewSettings:
    """How the views are told apart."""

    px_per_mm: float = 22.0
    """Scale of the copy on which the outlines are found."""
    reach_mm: float = 3.0
    """A mirror's picture is looked for this far beyond its nominal outline."""

    def __post_init__(self) -> None:
        for name in ("px_per_mm", "reach_mm"):
            require(getattr(self, name) > 0, f"shape.mirror.views.{name} must be positive.")


@dataclass(frozen=True, slots=True)
class MirrorShapeSettings:
    """The finger's shape from its outlines in front view and mirrors."""

    method: str = "outlines"
    """``outlines`` (ours), or ``thesis``: mirrors at exactly 45 deg, one ellipse a row."""
    section: str = "oval"
    """``oval``: ellipses with a flatter pad, as flat as is found; or ``ellipse``."""
    squareness: float = 0.16
    """Flatness of the pad that is expected: 0 is an ellipse."""
    squareness_spread: float = 0.08
    """Standard deviation of that expectation; slopes of the skin and a mirror beyond the tip say more."""
    angle_deg: float = 1.5
    """Standard deviation of the mirrors' angles about their nominal ones."""
    offset_mm: float = 1.5
    """Standard deviation of the mirrors' places about their nominal ones."""
    outline_mm: float = 0.05
    """Standard deviation of a point of an outline."""
    slope_error: float = 0.1
    """Standard deviation of a measured slope of the skin; skin that scatters light looks flatter than it is."""
    knots: int = 11
    """Spans of the splines along the finger."""
    rounds: int = 9
    """Corrections."""
    row_mm: float = 0.15
    """Distance of the rows in which the outlines are measured."""
    misfit_mm: float = 0.6
    """Views that agree no better than this (rms) are not of one finger."""
    slopes: bool = True
    """Let the skin's slopes in white light tell the form and the roll of the sections."""
    detail_mm: float = 5.0
    """What is finer than this is taken from white light, where the preset undoes the skin's blur."""
    views: ViewSettings = field(default_factory=ViewSettings)
    """How the views are told apart."""

    def __post_init__(self) -> None:
        require(
            self.method in ("outlines", "thesis"),
            f"shape.mirror.method must be outlines or thesis, not '{self.method}'.",
        )
        require(
            self.section in ("oval", "ellipse"), f"shape.mirror.section must be oval or ellipse, not '{self.section}'."
        )
        require(-0.2 <= self.squareness <= 0.45, "shape.mirror.squareness must lie between -0.2 and 0.45.")
        for name in (
            "squareness_spread",
            "angle_deg",
            "offset_mm",
            "outline_mm",
            "slope_error",
            "row_mm",
            "misfit_mm",
            "detail_mm",
        ):
            require(getattr(self, name) > 0, f"shape.mirror.{name} must be positive.")
        require(4 <= self.knots <= 40, "shape.mirror.knots must lie between 4 and 40.")
        require(1 <= self.rounds <= 50, "shape.mirror.rounds must lie between 1 and 50.")
