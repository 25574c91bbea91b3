"""Settings of the shape from mirrors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from splitknit.settings import Checked, Limits


@dataclass(frozen=True, slots=True)
class MirrorShapeSettings(Checked):
    """The finger's shape from its outlines in front view and mirrors."""

    _group = "shape.mirror"
    method: Literal["outlines", "thesis"] = "outlines"
    """``outlines`` (the `metric` method), or ``thesis``: mirrors at exactly 45 deg, one ellipse a
    row."""
    squareness: Annotated[float, Limits(-0.2, 0.45)] = 0.16
    """Prior mean of the pad's flatness (kappa), which the fit refines; 0 is an ellipse."""
