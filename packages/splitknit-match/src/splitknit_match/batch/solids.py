"""What a matcher reads beside the features of a chunk: minutiae, voted minutiae, minutiae in space, surface codes.

All are found once a capture and kept under the name of the chunk of features. Features in space are made with the
reconstruction where a matcher needs them, and else from the surfaces in the store; both give the same bytes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from splitknit import BadInput, Surface, decode_png, read_capture, require
from splitknit_match.batch.chunks import SUFFIX, column_type, load, read_chunk, read_origin, write_chunk, write_timings
from splitknit_match.batch.execution import TaskDone
from splitknit_match.batch.objects import Location, captures_at_hand
from splitknit_match.batch.reading import Place, surface_of
from splitknit_match.batch.settings import Case
from splitknit_match.matching.minutiae import extract
from splitknit_match.matching.minutiae_record import Minutiae, no_minutiae, pack_minutiae, pack_space_minutiae
from splitknit_match.matching.space_features import space_minutiae, surface_code
from splitknit_match.matching.surface import MatchingSettings
from splitknit_match.matching.surface_code import pack_surface_code
from splitknit_match.matching.voted_minutiae import voted_minutiae

SOLIDS: Mapping[str, str] = MappingProxyType({"minutiae3d": "minutiae3d", "surface_codes": "surface_code"})
"""Features in space: from the folder of the store to the column with the payload."""
_VERSIONS = {"minutiae": 2}
"""Version of a kind's content, 1 where it is not listed. Minutiae of version 1 included ends at the outline."""
_TIMINGS = {"minutiae": "extraction", "voted": "voting"}  # folders of timings; of the others the kind with ``-making``


@dataclass(frozen=True, slots=True)
class ExtractionTask:
    """A chunk of features beside which features of another kind are wanted."""

    store: Location
    population: Location
    case: Case
    name: str
    kind: str  # ``minutiae``, ``voted``, or one of :data:`SOLIDS`: the folder of the store
    matching: MatchingSettings


_Found = tuple[str, bool, bytes]  # a capture, whether it was acquired, and the payload


def extract_features(task: ExtractionTask) -> TaskDone:
    """Find the features of one kind of all captures of a chunk and write them under the same name. Raises BadInput if
    the store holds no surfaces where they are needed, or they are damaged.
    """
    case = task.case.name
    file = task.store / "features" / case / f"{task.name}{SUFFIX}"
    makers: dict[str, Callable[[ExtractionTask, Location], Iterator[_Found]]]
    makers = {"minutiae": _from_prints, "voted": _from_images}
    found, seconds, started = [], {}, time.perf_counter()
    for one in makers.get(task.kind, _from_surfaces)(task, file):
        found.append(one)
        seconds[one[0]] = round(time.perf_counter() - started, 3)
        started = time.perf_counter()
    write_timings(task.store / "timings" / case / _TIMINGS.get(task.kind, f"{task.kind}-making"), task.name, seconds)
    write_extracted(task.store / task.kind / case / file.name, task.kind, found, read_origin(file))
    return TaskDone(1)


def write_extracted(file: Location, kind: str, found: Sequence[_Found], origin: Mapping[str, Any]) -> None:
    """Write a chunk of one kind; `origin` is that of its chunk of features."""
    names = ("capture", "acquired", SOLIDS.get(kind, "minutiae"))
    schema = load("pyarrow", "batch").schema([(name, column_type(name)) for name in names])
    columns = {name: [one[k] for one in found] for k, name in enumerate(names)}
    write_chunk(file, columns, schema, {**origin, "kind": kind, "kind_version": _VERSIONS.get(kind, 1)})


def solid_payload(kind: str, surface: Surface, matching: MatchingSettings) -> bytes:
    """Bytes of one kind of features of a surface; none where it has too few."""
    if kind == "minutiae3d":
        found = space_minutiae(surface)
        return pack_space_minutiae(found) if found.acquired else b""
    return pack_surface_code(surface_code(surface, matching.surface_code))


def _from_prints(task: ExtractionTask, file: Location) -> Iterator[_Found]:
    table = read_chunk(file, ["capture", "print"])
    for capture, data in zip(table.column("capture").to_pylist(), table.column("print").to_pylist(), strict=True):
        found = no_minutiae()
        if data is not None:
            name = f"{file}: {capture}"
            pixels = decode_png(data, name)
            require(pixels.shape[2] == 1 and pixels.dtype == np.uint8, f"{name} is not an 8-bit grey image.")
            found = extract(np.asarray(pixels[..., 0], dtype=np.uint8))
        yield capture, found.acquired, pack_minutiae(found)


def _from_images(task: ExtractionTask, file: Location) -> Iterator[_Found]:
    """Minutiae on which the sets of images that leave one out agree; none where nothing is left."""
    table = read_chunk(file, ["capture", "acquired"])
    captures = table.column("capture").to_pylist()
    acquired = dict(zip(captures, table.column("acquired").to_pylist(), strict=True))
    with captures_at_hand(task.population, [capture for capture in captures if acquired[capture]]) as folders:
        for capture in captures:
            found = _voted(next(folders) / capture, task) if acquired[capture] else no_minutiae()
            yield capture, found.acquired, pack_minutiae(found)


def _voted(folder: Path, task: ExtractionTask) -> Minutiae:
    capture = read_capture(folder)
    try:
        return voted_minutiae(capture, task.case.settings(), task.matching.leave_one_out, task.matching.voted)
    except BadInput as error:
        if "nbis-py" in str(error):  # not the capture's fault
            raise
        return no_minutiae()


def _from_surfaces(task: ExtractionTask, file: Location) -> Iterator[_Found]:
    for row, capture in enumerate(read_chunk(file, ["capture"]).column("capture").to_pylist()):
        surface = surface_of(Place(file, row))
        payload = b"" if surface is None else solid_payload(task.kind, surface, task.matching)
        yield capture, bool(payload), payload
