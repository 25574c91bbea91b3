"""Minutiae of a chunk's prints: found once a capture, kept beside the features."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.batch.chunks import SUFFIX, column_type, load, read_chunk, read_origin, write_chunk, write_timings
from splitknit.batch.execution import peak_memory_mb
from splitknit.errors import require
from splitknit.io.png import decode_png
from splitknit.matching.minutiae import extract
from splitknit.matching.minutiae_record import Minutiae, no_minutiae, pack_minutiae

VERSION = 2
"""1: with the ends at the outline."""


@dataclass(frozen=True, slots=True)
class MinutiaeTask:
    """A chunk of features whose prints' minutiae are wanted."""

    store: Path
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
    write_minutiae(file, task.store / "minutiae" / task.case, captures, found, ("minutiae", VERSION))
    return MinutiaeDone(len(captures), peak_memory_mb())


def write_minutiae(
    features: Path, folder: Path, captures: Sequence[str], found: Sequence[Minutiae], kind: tuple[str, int]
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
