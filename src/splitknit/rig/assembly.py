"""All parts of a rig: what they are called, how often they are printed and which way up, and how they go together."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from splitknit.errors import BadInput
from splitknit.rig.dimension_checks import check_dimensions
from splitknit.rig.dimensions import RigDimensions

STACK = ("base", "cylinder", "frame", "box", "lid")
"""The rig with the camera above, from below upwards."""
STACK_BELOW = ("window_base", "cylinder", "frame", "box", "lid")
"""With the camera below this stack is turned over: the lid is the foot."""


@dataclass(frozen=True, slots=True, eq=False)
class PartKind:
    """What is known of a part before it is drawn."""

    name: str
    title: str
    module: str
    """Of :mod:`splitknit.rig`, with a function ``NAME_part``."""
    quantity: int = 1
    face_down: bool = False
    """Printed with its upper face on the bed."""
    colour: str = "black"
    needed: bool = True
    """Part of the rig; else an alternative or an extra."""
    remedy: str = ""
    """What is on purpose, or what to do while printing."""


KINDS: tuple[PartKind, ...] = (
    PartKind("base", "Base with finger groove", "parts_base"),
    PartKind(
        "cylinder",
        "Cylinder with the finger's opening",
        "parts_tube",
        remedy="The semicircular opening stands in a wall of one thickness: its crown closes over the last few "
        "millimetres as a bridge and needs no support.",
    ),
    PartKind("frame", "LED and camera frame", "parts_tube"),
    PartKind("box", "Circuit box", "parts_tube"),
    PartKind("lid", "Lid", "parts_tube"),
    PartKind("window_base", "Window base, for the camera below", "parts_base", needed=False),
    PartKind("mirror_holder", "Mirror holder at 45 deg (left, right, tip)", "parts_base", quantity=3, needed=False),
    PartKind(
        "calibration_disc",
        "Calibration disc, recessed dots",
        "parts_calibration",
        face_down=True,
        colour="white",
        remedy="Face on the bed. Either fill the dots with black paint, or print the first layers, up to the dots' "
        "depth, in white and go on in black.",
    ),
    PartKind(
        "calibration_disc_flat",
        "Calibration disc, flush dots (with the pegs of calibration_dots)",
        "parts_calibration",
        face_down=True,
        colour="white",
        needed=False,
    ),
    PartKind("calibration_dots", "Black dots for the flat disc", "parts_calibration", needed=False),
    PartKind(
        "nail",
        "Nail cone",
        "parts_calibration",
        remedy="Its tip is as thin as the nozzle on purpose. Print with a brim, slowly, beside another part so that "
        "each layer cools.",
    ),
)
_MAKERS = {"calibration_disc": "disc", "calibration_disc_flat": "flat_disc", "calibration_dots": "dots"}


@dataclass(frozen=True, slots=True, eq=False)
class RigPart:
    """One part, drawn in its place in the rig's frame."""

    kind: PartKind
    solid: Any
    """A solid of build123d."""


def require_build123d() -> None:
    """Refuse with one sentence where build123d is not installed."""
    try:
        import build123d  # noqa: F401, PLC0415 - large, and only parts need it
    except ImportError as error:
        raise BadInput("drawing parts needs build123d; in splitknit's folder: make install EXTRAS=rig.") from error


def build_parts(dimensions: RigDimensions, progress: Callable[[str, float], None] | None = None) -> tuple[RigPart, ...]:
    """Draw every part.

    Parameters
    ----------
    dimensions : RigDimensions
    progress : called with the part's name and the share that is done

    Raises
    ------
    BadInput
        If build123d is missing or the rig cannot be built.
    """
    check_dimensions(dimensions)
    require_build123d()
    parts = []
    for done, kind in enumerate(KINDS):
        if progress is not None:
            progress(kind.name, done / len(KINDS))
        parts.append(RigPart(kind, _maker(kind)(dimensions)))
    return tuple(parts)


def _maker(kind: PartKind) -> Callable[[RigDimensions], Any]:
    module = importlib.import_module(f"splitknit.rig.{kind.module}")
    maker: Callable[[RigDimensions], Any] = getattr(module, f"{_MAKERS.get(kind.name, kind.name)}_part")
    return maker
