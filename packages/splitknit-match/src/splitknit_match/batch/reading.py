"""What a matcher reads of the store: templates, prints' minutiae and surfaces, of single captures.

Each process keeps the small ones; a surface is unpacked when it is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from splitknit import BadInput
from splitknit.errors import naming, require
from splitknit.model import Surface
from splitknit_match.batch.chunks import read_chunk
from splitknit_match.batch.surfaces import unpack_surface
from splitknit_match.matching.surface import surface_images
from splitknit_match.matching.thesis import FingerImages


@dataclass(frozen=True, slots=True)
class Place:
    """Where a capture lies in the store."""

    file: Path
    row: int


def small_column(place: Place, column: str) -> Any:
    """Value of a column of which a process may keep every chunk that it reads."""
    return _column(place.file, column, _version(place.file))[place.row]


def surface_of(place: Place) -> Surface | None:
    """The surface, to the last bit; None where the capture could not be acquired."""
    payload = _surfaces(place.file, _version(place.file))[place.row]
    if not payload:
        fault = f"'{place.file}' holds no surfaces: it was made without them"
        require(small_column(place, "area_mm2") == 0.0, f"{fault}; delete it and run the same again with them.")
        return None
    return naming(f"'{place.file}'", lambda: unpack_surface(payload))


def images_of(place: Place) -> FingerImages | None:
    """Channels for the thesis's matcher, exactly those of the reconstruction; None where there is no surface."""
    surface = surface_of(place)
    return None if surface is None else surface_images(surface)


def stored_places(files: Sequence[Path]) -> Mapping[str, Place]:
    """Where each capture lies; of one that lies in two chunks, the first."""
    found: dict[str, Place] = {}
    for file in files:
        for row, name in enumerate(read_chunk(file, ["capture"])["capture"].tolist()):
            found.setdefault(name, Place(file, row))
    return found


def drop_cached() -> None:
    """Let go of all that this process keeps."""
    _column.cache_clear()
    _surfaces.cache_clear()


def _version(file: Path) -> int:
    """Distinguish a file that was made anew from what is kept of the old one."""
    try:
        return file.stat().st_mtime_ns
    except OSError as error:
        raise BadInput(f"'{file}' cannot be read: {error.strerror or error}.") from error


@lru_cache(maxsize=512)
def _column(file: Path, column: str, version: int) -> list[Any]:
    return list(read_chunk(file, [column])[column].tolist())


@lru_cache(maxsize=1)
def _surfaces(file: Path, version: int) -> list[bytes]:
    return list(read_chunk(file, ["images"])["images"].tolist())
