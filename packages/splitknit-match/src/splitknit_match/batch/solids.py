"""What the matcher of minutiae reads beside the features of a chunk: minutiae of its prints, found once a capture."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from splitknit import decode_png, require
from splitknit_match.batch.chunks import SUFFIX, column_type, load, read_chunk, read_origin, write_chunk, write_timings
from splitknit_match.batch.execution import TaskDone
from splitknit_match.batch.objects import Location
from splitknit_match.matching.minutiae import extract
from splitknit_match.matching.minutiae_record import no_minutiae, pack_minutiae

_VERSION = 2
"""Version of the content. Minutiae of version 1 included ends at the outline."""


@dataclass(frozen=True, slots=True)
class ExtractionTask:
    """A chunk of features beside which minutiae are wanted."""

    store: Location
    case: str
    name: str


def extract_features(task: ExtractionTask) -> TaskDone:
    """Find the minutiae of all captures of a chunk and write them under the same name."""
    file = task.store / "features" / task.case / f"{task.name}{SUFFIX}"
    names = ("capture", "acquired", "minutiae")
    columns: dict[str, list[object]] = {name: [] for name in names}
    seconds, started = {}, time.perf_counter()
    table = read_chunk(file, ["capture", "print"])
    for capture, data in zip(table.column("capture").to_pylist(), table.column("print").to_pylist(), strict=True):
        found = no_minutiae()
        if data is not None:
            name = f"{file}: {capture}"
            pixels = decode_png(data, name)
            require(pixels.shape[2] == 1 and pixels.dtype == np.uint8, f"{name} is not an 8-bit grey image.")
            found = extract(np.asarray(pixels[..., 0], dtype=np.uint8))
        for name, value in zip(names, (capture, found.acquired, pack_minutiae(found)), strict=True):
            columns[name].append(value)
        seconds[capture] = round(time.perf_counter() - started, 3)
        started = time.perf_counter()
    write_timings(task.store / "timings" / task.case / "extraction", task.name, seconds)
    schema = load("pyarrow", "batch").schema([(name, column_type(name)) for name in names])
    origin = {**read_origin(file), "kind": "minutiae", "kind_version": _VERSION}
    write_chunk(task.store / "minutiae" / task.case / file.name, columns, schema, origin)
    return TaskDone(1)
