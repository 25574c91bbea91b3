"""A result's print, and its minutiae: where they lie in the print, and on the surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.io.prints import PrintFile, read_print_png
from splitknit.viewer.catalogue import open_below, read_below
from splitknit.viewer.measure import sample
from splitknit.viewer.surface import ShownSurface


@lru_cache(maxsize=8)
def print_of(folder: Path) -> PrintFile:
    """Read a result's ``print.png``.

    Raises
    ------
    BadInput
        If there is none, it is a link, or it cannot be read.
    """
    open_below(folder, "print.png").close()
    return read_print_png(folder / "print.png")


_TAIL_MM = 0.6
_KINDS = ("other", "ending", "bifurcation")
_Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Minutiae, in the print's and in the surface's frame."""

    x_px: NDArray[np.float64]
    """(N,) column in the print as it is stored."""
    y_px: NDArray[np.float64]
    """(N,) row."""
    direction_rad: NDArray[np.float64]
    """(N,) counter-clockwise from the right, as seen in the print."""
    kind: tuple[str, ...]
    quality: NDArray[np.int64]
    """(N,) 0 to 100."""
    place_mm: NDArray[np.float64]
    """(N, 3) on the surface; NaN where there is none."""
    tail_mm: NDArray[np.float64]
    """(N, 3) a little further along the direction, on the surface."""

    def document(self) -> list[dict[str, Any]]:
        """For the page."""
        rounded = np.round(self.place_mm, 4), np.round(self.tail_mm, 4)
        return [
            {
                "x_px": float(self.x_px[k]),
                "y_px": float(self.y_px[k]),
                "direction_rad": round(float(self.direction_rad[k]), 4),
                "kind": self.kind[k],
                "quality": int(self.quality[k]),
                "place_mm": _finite(rounded[0][k]),
                "tail_mm": _finite(rounded[1][k]),
            }
            for k in range(len(self.kind))
        ]


def marks_of(folder: Path, surface: ShownSurface) -> Marks:
    """Return the minutiae of a result's print: those of its ``minutiae.iso``, or those found in it now.

    Raises
    ------
    BadInput
        If there is no print, its record cannot be read, or nothing here can find minutiae.
    """
    file = print_of(folder)
    rows, columns = file.image.shape
    ppi = file.resolution_ppi or 500.0
    x_px, y_px, direction, kind, quality = _recorded(folder, (rows, columns)) or _found(file.image, ppi)
    mm = 25.4 / ppi
    # the print is mirrored: its right is the finger's left
    left_mm, up_mm = (x_px - (columns - 1) / 2) * mm, ((rows - 1) / 2 - y_px) * mm
    place = _on_surface(surface, -left_mm, up_mm)
    tail = _on_surface(surface, -(left_mm + _TAIL_MM * np.cos(direction)), up_mm + _TAIL_MM * np.sin(direction))
    return Marks(x_px, y_px, direction, tuple(_KINDS[int(each)] for each in kind), quality, place, tail)


_Columns = tuple[_Values, _Values, _Values, NDArray[np.int64], NDArray[np.int64]]
"""Column and row in the print, direction (rad), type, quality."""


def _recorded(folder: Path, size: tuple[int, int]) -> _Columns | None:
    """Minutiae of the record that was written with the print, if there is one of this print."""
    from splitknit.io.minutiae_files import decode_minutiae_record

    if not (folder / "minutiae.iso").is_file():
        return None
    view = decode_minutiae_record(read_below(folder, "minutiae.iso", 10_000_000), "minutiae.iso").views[0]
    if view.size != size:
        return None
    return _columns(view.x_px, view.y_px, view.direction_rad, view.type, view.quality)


def _found(image: NDArray[np.uint8], ppi: float) -> _Columns:
    from splitknit.matching.minutiae import extract  # large, and not everywhere

    found = extract(image, ppi)
    stored = image.shape[1] / max(1, found.size[1])
    x, y = ((np.asarray(axis) + 0.5) * stored - 0.5 for axis in (found.x_px, found.y_px))
    return _columns(x, y, found.direction_rad, found.type, found.quality)


def _columns(*fields: NDArray[Any]) -> _Columns:
    x, y, direction = (np.asarray(field, dtype=np.float64) for field in fields[:3])
    kind, quality = (np.asarray(field, dtype=np.int64) for field in fields[3:])
    return x, y, direction, kind, quality


def _on_surface(
    surface: ShownSurface, right_mm: NDArray[np.float64], up_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(N, 3) points of the surface at places given from the middle of the upright frame, NaN beside the finger."""
    rows, columns = surface.upright_size
    column = (columns - 1) / 2 + np.asarray(right_mm) / surface.pitch_mm
    row = (rows - 1) / 2 - np.asarray(up_mm) / surface.pitch_mm
    place = (surface.input_from_upright @ np.stack([column, row, np.ones(len(column))]))[:2]
    place = place - np.array(surface.corner[::-1], dtype=np.float64)[:, None]
    return np.stack([sample(field, place) for field in (surface.x_mm, surface.y_mm, surface.height_mm)], axis=1)


def _finite(point: NDArray[np.float64]) -> list[float] | None:
    return [float(value) for value in point] if bool(np.isfinite(point).all()) else None
