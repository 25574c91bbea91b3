"""Minutiae of a chunk's prints, minutiae in space and surface codes: found once a capture, kept beside the features.

They are made with the reconstruction where a matcher needs them, and else from the surfaces in the store; both give
the same bytes.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from splitknit.batch.chunks import SUFFIX, column_type, load, read_chunk, read_origin, write_chunk, write_timings
from splitknit.batch.execution import peak_memory_mb
from splitknit.batch.objects import Location
from splitknit.batch.surfaces import unpack_surface
from splitknit.errors import BadInput, require
from splitknit.io.png import decode_png
from splitknit.matching.minutiae import extract
from splitknit.matching.minutiae_record import Minutiae, no_minutiae, pack_minutiae, pack_space_minutiae
from splitknit.matching.space_features import space_minutiae, surface_code
from splitknit.matching.surface import MatchingSettings
from splitknit.matching.surface_code import pack_surface_code
from splitknit.model import Surface

PRINTS_VERSION = 2
"""1: with the ends at the outline."""


@dataclass(frozen=True, slots=True)
class MinutiaeTask:
    """A chunk of features whose prints' minutiae are wanted."""

    store: Location
    case: str
    name: str


@dataclass(frozen=True, slots=True)
class MinutiaeDone:
    """What a task did."""

    rows: int
    peak_memory_mb: float

    @property
    def size(self) -> int:
        """Chunks."""
        return 1


def _minutiae_schema() -> Any:
    """Columns of a chunk of minutiae."""
    return load("pyarrow", "batch").schema([(name, column_type(name)) for name in ("capture", "acquired", "minutiae")])


def extract_minutiae(task: MinutiaeTask) -> MinutiaeDone:
    """Find the minutiae of all prints of a chunk and write them under the same name."""
    file = task.store / "features" / task.case / f"{task.name}{SUFFIX}"
    table = read_chunk(file, ["capture", "print"])
    captures = table.column("capture").to_pylist()
    seconds, found = {}, []
    for capture, data in zip(captures, table.column("print").to_pylist(), strict=True):
        started = time.perf_counter()
        found.append(no_minutiae() if data is None else extract(_image(data, f"{file}: {capture}")))
        seconds[capture] = round(time.perf_counter() - started, 3)
    write_timings(task.store / "timings" / task.case / "extraction", task.name, seconds)
    write_minutiae(file, task.store / "minutiae" / task.case, captures, found, ("minutiae", PRINTS_VERSION))
    return MinutiaeDone(len(captures), peak_memory_mb())


def write_minutiae(
    features: Location, folder: Location, captures: Sequence[str], found: Sequence[Minutiae], kind: tuple[str, int]
) -> None:
    """Write a chunk of minutiae, of a kind and its version, under the name of its chunk of `features`."""
    columns = {
        "capture": captures,
        "acquired": [one.acquired for one in found],
        "minutiae": [pack_minutiae(one) for one in found],
    }
    origin = read_origin(features) | {"kind": kind[0], "kind_version": kind[1]}
    write_chunk(folder / features.name, columns, _minutiae_schema(), origin)


def _image(data: bytes, name: str) -> Any:
    pixels = decode_png(data, name)
    require(pixels.shape[2] == 1 and pixels.dtype == np.uint8, f"{name} is not an 8-bit grey image.")
    return pixels[..., 0]


VERSION = 1
SOLIDS: Mapping[str, str] = MappingProxyType({"minutiae3d": "minutiae3d", "surface_codes": "surface_code"})
"""From the folder of the store to the column with the payload."""


@dataclass(frozen=True, slots=True)
class SolidTask:
    """A chunk of features from whose surfaces one kind of features in space is wanted."""

    store: Location
    case: str
    name: str
    kind: str
    """Of :data:`SOLIDS`."""
    matching: MatchingSettings


def solid_payload(kind: str, surface: Surface, matching: MatchingSettings) -> bytes:
    """Bytes of one kind of features of a surface; none where it has too few."""
    if kind == "minutiae3d":
        found = space_minutiae(surface)
        return pack_space_minutiae(found) if found.acquired else b""
    return pack_surface_code(surface_code(surface, matching.surface_code))


def write_solids(
    file: Location, kind: str, captures: Sequence[str], payloads: Sequence[bytes], origin: Mapping[str, Any]
) -> None:
    """Write a chunk of one kind; `origin` is that of the features."""
    column = SOLIDS[kind]
    names = ("capture", "acquired", column)
    schema = load("pyarrow", "batch").schema([(name, column_type(name)) for name in names])
    columns = {"capture": captures, "acquired": [bool(payload) for payload in payloads], column: payloads}
    write_chunk(file, columns, schema, {**origin, "kind": kind, "kind_version": VERSION})


def extract_solids(task: SolidTask) -> MinutiaeDone:
    """Make one kind of features from all surfaces of a chunk and write them under the same name.

    Raises
    ------
    BadInput
        If the store holds no surfaces, or they are damaged.
    """
    file = task.store / "features" / task.case / f"{task.name}{SUFFIX}"
    table = read_chunk(file, ["capture", "area_mm2", "images"])
    seconds, payloads = {}, []
    captures = table.column("capture").to_pylist()
    for row, capture in enumerate(captures):
        started = time.perf_counter()
        payload = table.column("images")[row].as_py()
        if payload is None:
            require(
                table.column("area_mm2")[row].as_py() == 0.0,
                f"'{file}' holds no surfaces: it was made without them; delete it and run the same again.",
            )
            payloads.append(b"")
            continue
        try:
            surface = unpack_surface(payload)
        except BadInput as error:
            raise BadInput(f"'{file}': {error}") from error
        payloads.append(solid_payload(task.kind, surface, task.matching))
        seconds[capture] = round(time.perf_counter() - started, 3)
    write_timings(task.store / "timings" / task.case / f"{task.kind}-making", task.name, seconds)
    target = task.store / task.kind / task.case / f"{task.name}{SUFFIX}"
    write_solids(target, task.kind, captures, payloads, read_origin(file))
    return MinutiaeDone(len(captures), peak_memory_mb())
