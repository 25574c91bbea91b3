"""All parts of a rig, how they go together, and their files: triangles (STL) and STEP."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import FloatArray, Progress, importing, no_progress
from splitknit_rig.rig.dimension_checks import check_dimensions
from splitknit_rig.rig.dimensions import RigDimensions

STACK = ("base", "cylinder", "frame", "box", "lid")  # the rig with the camera above, from below upwards
STACK_BELOW = ("window_base", "cylinder", "frame", "box", "lid")
"""With the camera below this stack is turned over: the lid is the foot."""


@dataclass(frozen=True, slots=True, eq=False)
class PartKind:
    """What is known of a part before it is drawn."""

    name: str
    title: str
    quantity: int = 1
    face_down: bool = False  # printed with its upper face on the bed
    colour: str = "black"
    needed: bool = True  # part of the rig; else an alternative or an extra
    remedy: str = ""  # what is on purpose, or what to do while printing


KINDS: tuple[PartKind, ...] = (
    PartKind("base", "Base with finger groove"),
    PartKind(
        "cylinder",
        "Cylinder with the finger's opening",
        remedy="The semicircular opening stands in a wall of one thickness: its crown closes over the last few "
        "millimetres as a bridge and needs no support.",
    ),
    PartKind("frame", "LED and camera frame"),
    PartKind("box", "Circuit box"),
    PartKind("lid", "Lid"),
    PartKind("window_base", "Window base, for the camera below", needed=False),
    PartKind("mirror_holder", "Mirror holder at 45 deg (left, right, tip)", quantity=3, needed=False),
    PartKind(
        "calibration_disc",
        "Calibration disc, recessed dots",
        face_down=True,
        colour="white",
        remedy="Face on the bed. Either fill the dots with black paint, or print the first layers, up to the dots' "
        "depth, in white and go on in black.",
    ),
    PartKind(
        "calibration_disc_flat",
        "Calibration disc, flush dots (with the pegs of calibration_dots)",
        face_down=True,
        colour="white",
        needed=False,
    ),
    PartKind("calibration_dots", "Black dots for the flat disc", needed=False),
    PartKind(
        "nail",
        "Nail cone",
        remedy="Its tip is as thin as the nozzle on purpose. Print with a brim, slowly, beside another part so that "
        "each layer cools.",
    ),
)
FILM_KINDS = (
    PartKind("analyser_plate", "Plate before the lens, on which the analyser turns"),
    PartKind("analyser", "Analyser: ring with lever, film before the lens"),
    PartKind("film_ring", "Ring of films below the LEDs"),
)
"""Parts of a rig with films, from below upwards between cylinder and frame."""

SIDE_KIND = PartKind("side_lamp", "Lamp of a side light", remedy="Its slit is for film: up in the rig, taped over.")


def kinds_of(dimensions: RigDimensions) -> tuple[PartKind, ...]:
    """Kinds of parts that are drawn; an analyser that does not turn is not a part of its own."""
    films, lamps = dimensions.films, len(dimensions.sides)
    kinds = [k for k in FILM_KINDS if films is not None and (k.name != "analyser" or films.kind != "neighbours")]
    return (*KINDS, *kinds, *([replace(SIDE_KIND, quantity=lamps)] if lamps else ()))


@dataclass(frozen=True, slots=True, eq=False)
class RigPart:
    """One part, drawn in its place in the rig's frame."""

    kind: PartKind
    solid: Any  # a solid of build123d
    places: tuple[Any, ...] = ()  # where it is put in the rig, several times; empty: it is drawn in its place


def require_build123d() -> None:
    """Refuse with one sentence where build123d is not installed."""
    with importing("drawing parts needs build123d; in splitknit's folder: make install EXTRAS=cad."):
        import build123d  # noqa: F401 - large, and only parts need it


def build_parts(dimensions: RigDimensions, progress: Progress = no_progress) -> tuple[RigPart, ...]:
    """Draw every part; BadInput if build123d is missing or the rig cannot be built."""
    check_dimensions(dimensions)
    require_build123d()
    from splitknit_rig.rig.parts import MAKERS, side_places  # needs build123d

    parts, kinds = [], kinds_of(dimensions)
    for done, kind in enumerate(kinds):
        progress(kind.name, done / len(kinds))
        places = tuple(side_places(dimensions)) if kind.name == "side_lamp" else ()
        parts.append(RigPart(kind, MAKERS[kind.name](dimensions), places))
    return tuple(parts)


Triangles = FloatArray
"""(N, 3, 3): corners of each triangle, counter-clockwise seen from outside; x, y, z in mm."""
TOLERANCE_MM = 0.01  # between a curved face and its triangles: far below what a printer holds
TOLERANCE_RAD = 0.2
_TIMESTAMP = "2000-01-01T00:00:00"  # in the header of every STEP file, so that the same rig gives the same bytes


def triangles_of(part: RigPart) -> Triangles:
    """Return the part's surface in the rig's frame, (N, 3, 3) float32."""
    vertices, faces = part.solid.tessellate(TOLERANCE_MM, TOLERANCE_RAD)
    points = np.array([(point.X, point.Y, point.Z) for point in vertices], dtype=np.float64)
    points = np.round(points, 5).astype(np.float32)  # faces meet at the same numbers
    corners = points[np.array(faces, dtype=np.int64)]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    whole = ~((a == b).all(axis=1) | (b == c).all(axis=1) | (c == a).all(axis=1))
    return np.asarray(corners[whole], dtype=np.float32)


def as_printed(part: RigPart, triangles: Triangles) -> Triangles:
    """Return the triangles as they lie on the bed: middle at x = y = 0, lowest point at z = 0."""
    turned = triangles * np.array([1.0, -1.0, -1.0], dtype=np.float32) if part.kind.face_down else triangles
    low, high = turned.reshape(-1, 3).min(axis=0), turned.reshape(-1, 3).max(axis=0)
    origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]], dtype=np.float32)
    return np.asarray(turned - origin, dtype=np.float32)


def write_step(path: Path, part: RigPart) -> None:
    """Write one part, in the rig's frame."""
    from build123d import export_step  # large, and only parts need it

    part.solid.label = part.kind.name  # without a colour, as colours are written in an order that changes
    export_step(part.solid, str(path), timestamp=_TIMESTAMP)
    _renumber(path)


def write_assembly(path: Path, parts: Sequence[RigPart], *, below: bool = False) -> None:
    """Write parts in their places; `below` turns the whole rig over, camera lowest."""
    from build123d import Compound, Rot, export_step  # large, and only parts need it

    shapes = []
    for part in parts:
        for shape in placed(part):
            shapes.append(Rot(180, 0, 0) * shape if below else shape)
            shapes[-1].label = part.kind.name
    assembly = Compound(label="rig", children=shapes)
    export_step(assembly, str(path), timestamp=_TIMESTAMP)
    _renumber(path)


def placed(part: RigPart) -> list[Any]:
    """Solids of a part in the rig's frame."""
    return [place * part.solid for place in part.places] or [part.solid]


def _renumber(path: Path) -> None:
    """Number the uses of parts from 1: the writer goes on counting for as long as the program runs."""
    count = itertools.count(1)

    def numbered(found: re.Match[bytes]) -> bytes:
        rest = b"".join(line.strip() for line in found.group(2).splitlines())
        return found.group(1) + str(next(count)).encode("ascii") + rest

    text = path.read_bytes()
    use = re.compile(rb"(= NEXT_ASSEMBLY_USAGE_OCCURRENCE\(')\d+(',.*?;)", re.DOTALL)
    path.write_bytes(use.sub(numbered, text))


def half_of(solid: Any) -> Any:
    """Return a solid without its half at x > 0, to look into it."""
    from build123d import Pos, Solid  # large, and only parts need it

    size = 2000.0
    return solid.cut(Pos(0.0, -size / 2, -size / 2) * Solid.make_box(size, size, size))
