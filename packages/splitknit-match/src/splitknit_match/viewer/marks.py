"""A result's print, and its minutiae: where they lie in the print, and on the surface."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from splitknit import ResultSurface, print_of, read_below, sample

if TYPE_CHECKING:
    from splitknit_match.matching.minutiae_record import Minutiae
    from splitknit_match.records.minutiae_record import FingerView


_TAIL_MM = 0.6
_KINDS = ("other", "ending", "bifurcation")
_Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Minutiae, in the print's and in the surface's frame."""

    x_px: NDArray[np.float64]  # (N,) column in the print as it is stored
    y_px: NDArray[np.float64]  # (N,) row
    direction_rad: NDArray[np.float64]  # (N,) counter-clockwise from the right, as seen in the print
    kind: tuple[str, ...]
    quality: NDArray[np.int64]  # (N,) 0 to 100
    place_mm: NDArray[np.float64]  # (N, 3) on the surface; NaN where there is none
    tail_mm: NDArray[np.float64]  # (N, 3) a little further along the direction, on the surface

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


def marks_of(folder: Path, surface: ResultSurface) -> Marks:
    """Return the minutiae of a result's print: those of its ``minutiae.iso``, or those found in it now. Raises BadInput
    if there is no print, its record cannot be read, or nothing here can find minutiae.
    """
    file = print_of(folder)
    rows, columns = file.image.shape
    ppi = file.resolution_ppi or 500.0
    found, x_px, y_px = _recorded(folder, (rows, columns)) or _found(file.image, ppi)
    direction = np.asarray(found.direction_rad, dtype=np.float64)
    mm = 25.4 / ppi
    # the print is mirrored: its right is the finger's left
    left_mm, up_mm = (x_px - (columns - 1) / 2) * mm, ((rows - 1) / 2 - y_px) * mm
    place = _on_surface(surface, -left_mm, up_mm)
    tail = _on_surface(surface, -(left_mm + _TAIL_MM * np.cos(direction)), up_mm + _TAIL_MM * np.sin(direction))
    kind = tuple(_KINDS[int(each)] for each in found.type)
    return Marks(x_px, y_px, direction, kind, np.asarray(found.quality, dtype=np.int64), place, tail)


def _recorded(folder: Path, size: tuple[int, int]) -> tuple[FingerView, _Values, _Values] | None:
    """Minutiae of the record that was written with the print, if there is one of this print; columns and rows in it."""
    from splitknit_match.records.minutiae_files import decode_minutiae_record

    if not (folder / "minutiae.iso").is_file():
        return None
    view = decode_minutiae_record(read_below(folder, "minutiae.iso", 10_000_000), "minutiae.iso").views[0]
    return (view, view.x_px.astype(np.float64), view.y_px.astype(np.float64)) if view.size == size else None


def _found(image: NDArray[np.uint8], ppi: float) -> tuple[Minutiae, _Values, _Values]:
    from splitknit_match.matching.minutiae import extract  # large, and not everywhere

    found = extract(image, ppi)
    stored = image.shape[1] / max(1, found.size[1])
    x, y = ((np.asarray(axis, dtype=np.float64) + 0.5) * stored - 0.5 for axis in (found.x_px, found.y_px))
    return found, x, y


def _on_surface(surface: ResultSurface, right_mm: _Values, up_mm: _Values) -> _Values:
    """(N, 3) points of the surface at places given from the middle of the upright frame, NaN beside the finger."""
    rows, columns = surface.upright_size
    column = (columns - 1) / 2 + np.asarray(right_mm) / surface.pitch_mm
    row = (rows - 1) / 2 - np.asarray(up_mm) / surface.pitch_mm
    place = (surface.input_from_upright @ np.stack([column, row, np.ones(len(column))]))[:2]
    place = place - np.array(surface.corner[::-1], dtype=np.float64)[:, None]
    return np.stack([sample(field, place) for field in (surface.x_mm, surface.y_mm, surface.height_mm)], axis=1)


def _finite(point: NDArray[np.float64]) -> list[float] | None:
    return [float(value) for value in point] if bool(np.isfinite(point).all()) else None
