"""Parts as triangles and as STEP files."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.rig.assembly import RigPart
from splitknit.rig.stl import Triangles

TOLERANCE_MM = 0.01
"""Between a curved face and its triangles: far below what a printer holds."""
TOLERANCE_RAD = 0.2
_TIMESTAMP = "2000-01-01T00:00:00"
"""In the header of every STEP file, so that the same rig gives the same bytes."""


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
    from build123d import export_step  # noqa: PLC0415 - large, and only parts need it

    export_step(_labelled(part), str(path), timestamp=_TIMESTAMP)
    _renumber(path)


def write_assembly(path: Path, parts: Sequence[RigPart], *, below: bool = False) -> None:
    """Write parts in their places; `below` turns the whole rig over, camera lowest."""
    from build123d import Compound, Rot, export_step  # noqa: PLC0415 - large, and only parts need it

    placed = [_labelled(part) for part in parts]
    if below:
        placed = [_relabelled(Rot(180, 0, 0) * shape, shape) for shape in placed]
    assembly = Compound(label="rig", children=placed)
    export_step(assembly, str(path), timestamp=_TIMESTAMP)
    _renumber(path)


def _renumber(path: Path) -> None:
    """Number the uses of parts from 1: the writer goes on counting for as long as the program runs."""
    count = itertools.count(1)

    def numbered(found: re.Match[bytes]) -> bytes:
        rest = b"".join(line.strip() for line in found.group(2).splitlines())
        return found.group(1) + str(next(count)).encode("ascii") + rest

    text = path.read_bytes()
    use = re.compile(rb"(= NEXT_ASSEMBLY_USAGE_OCCURRENCE\(')\d+(',.*?;)", re.DOTALL)
    path.write_bytes(use.sub(numbered, text))


def _labelled(part: RigPart) -> Any:
    """The solid under its name; without a colour, as colours are written in an order that changes."""
    part.solid.label = part.kind.name
    return part.solid


def _relabelled(shape: Any, source: Any) -> Any:
    shape.label = source.label
    return shape


def half_of(part: RigPart) -> Triangles:
    """Return the part without its half at x > 0, to look into it, (N, 3, 3) float32."""
    from build123d import Pos, Solid  # noqa: PLC0415 - large, and only parts need it

    size = 2000.0
    rest = part.solid.cut(Pos(0.0, -size / 2, -size / 2) * Solid.make_box(size, size, size))
    pieces = [triangles_of(RigPart(part.kind, solid)) for solid in rest.solids()]
    return np.concatenate(pieces)
