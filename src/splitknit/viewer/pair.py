"""Two results beside each other: how the second is moved so that the same skin lies at the same place."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.matching.ridge import ridge_match
from splitknit.matching.ridge_band import RidgeBandSettings, band_places, ridge_band
from splitknit.matching.template import make_template
from splitknit.viewer.catalogue import Entry
from splitknit.viewer.marks import Marks
from splitknit.viewer.measure import locate, sample
from splitknit.viewer.surface import Surface, read_members

_NEAR_MM = 0.8
_TURNED_RAD = np.deg2rad(30.0)


@dataclass(frozen=True, slots=True)
class Alignment:
    """How the second finger is laid on the first, seen from the camera."""

    how: str
    """``photographs`` (both from the same ones), ``ridges``, or ``none``."""
    turn_rad: float = 0.0
    """Counter-clockwise, about the camera's axis, before the shift."""
    right_mm: float = 0.0
    up_mm: float = 0.0
    raise_mm: float = 0.0
    similarity: float | None = None
    """Of the ridges, where they were compared."""
    overlap_mm2: float | None = None

    def moved(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, 3) points of the second finger in the first one's frame."""
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(points_mm @ turn.T + np.array([self.right_mm, self.up_mm, self.raise_mm]))

    def document(self) -> dict[str, Any]:
        """For the page."""
        return asdict(self)


def align(first: Entry, a: Surface, second: Entry, b: Surface) -> Alignment:
    """Lay the second result on the first.

    Raises
    ------
    BadInput
        If a result lacks what a ridge template needs.
    """
    if _same_photographs(first, second) and a.size == b.size:
        both = a.turn @ b.turn.T
        found = Alignment("photographs", float(np.arctan2(both[1, 0], both[0, 0])))
        return _raised(found, a, b)
    bands = [_Band(entry.folder) for entry in (first, second)]
    match = ridge_match(bands[0].template, bands[1].template)
    if not match.compared:
        return Alignment("none", similarity=None)
    turn = -float(np.deg2rad(match.rotation_deg))  # A is turned by it to lie on B; here B comes to A
    there = _upright(b, *bands[1].place(match.right_mm, match.up_mm))
    here = _upright(a, *bands[0].place(0.0, 0.0))
    cos, sin = np.cos(turn), np.sin(turn)
    shift = here - np.array([cos * there[0] - sin * there[1], sin * there[0] + cos * there[1]])
    found = Alignment(
        "ridges", turn, float(shift[0]), float(shift[1]), 0.0, float(match.similarity), float(match.overlap_mm2)
    )
    return _raised(found, a, b)


def matched_marks(a: Marks, b: Marks, alignment: Alignment) -> list[tuple[int, int]]:
    """Pairs of minutiae that lie within 0.8 mm of each other and point the same way within 30 deg, nearest first."""
    moved, tails = alignment.moved(b.place_mm), alignment.moved(b.tail_mm)
    gaps = np.linalg.norm(a.place_mm[:, None, :2] - moved[None, :, :2], axis=2)
    turns = (_angles(a.tail_mm - a.place_mm)[:, None] - _angles(tails - moved)[None, :] + np.pi) % (2 * np.pi) - np.pi
    fits = (gaps <= _NEAR_MM) & (np.abs(turns) <= _TURNED_RAD)
    pairs, used_a, used_b = [], set(), set()
    rows, columns = np.nonzero(fits)
    for k in np.argsort(gaps[rows, columns], kind="stable"):
        i, j = int(rows[k]), int(columns[k])
        if i not in used_a and j not in used_b:
            pairs.append((i, j))
            used_a.add(i)
            used_b.add(j)
    return pairs


def _angles(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.arctan2(steps[:, 1], steps[:, 0]))


def _same_photographs(first: Entry, second: Entry) -> bool:
    mine, other = (entry.report.get("inputs_sha256") for entry in (first, second))
    return bool(mine) and mine == other


def _raised(found: Alignment, a: Surface, b: Surface) -> Alignment:
    """Both at the same height on average, over a coarse grid of the first."""
    step = max(1, round(0.5 / a.pitch_mm))
    inside = a.mask[::step, ::step]
    x, y, z = (f[::step, ::step][inside].astype(np.float64) for f in (a.x_mm, a.y_mm, a.height_mm))
    cos, sin = np.cos(found.turn_rad), np.sin(found.turn_rad)
    dx, dy = x - found.right_mm, y - found.up_mm
    other = sample(b.height_mm, locate(b, cos * dx + sin * dy, cos * dy - sin * dx))
    known = np.isfinite(other)
    rise = float(np.mean(z[known] - other[known])) if bool(known.any()) else 0.0
    return Alignment(found.how, found.turn_rad, found.right_mm, found.up_mm, rise, found.similarity, found.overlap_mm2)


class _Band:
    """A result's ridge template, and where its pixels lie in the input."""

    def __init__(self, folder: Path) -> None:
        needed = ("ridge_mm", "shape_mm", "mask", "pitch_mm", "input_from_upright", "upright_size")
        arrays = read_members(folder / "height.npz", needed)
        mask = arrays["mask"].astype(np.bool_)
        pitch, matrix = float(arrays["pitch_mm"]), arrays["input_from_upright"].astype(np.float64)
        rows, columns = (int(side) for side in arrays["upright_size"])
        settings = RidgeBandSettings()
        ridge, shape = (arrays[name].astype(np.float32) for name in ("ridge_mm", "shape_mm"))
        band = ridge_band(ridge, mask, pitch, shape, matrix, (rows, columns), settings)
        self.template = make_template(band)
        self.pitch_mm = band.pitch_mm
        known = mask & np.isfinite(ridge) & np.isfinite(shape)
        self._columns, self._rows, _ = band_places(known, shape, matrix, (rows, columns), pitch, settings)
        valid = [np.flatnonzero(band.valid.any(axis=axis)) for axis in (0, 1)]
        self._middle = [float(lines[0] + lines[-1]) / 2 if lines.size else 0.0 for lines in valid]

    def place(self, right_mm: float, up_mm: float) -> tuple[float, float]:
        """Column and row in the input of a place given from the template's middle."""
        column, row = self._middle[0] + right_mm / self.pitch_mm, self._middle[1] - up_mm / self.pitch_mm
        there = np.array([[column], [row]])
        return float(sample(self._columns, there)[0]), float(sample(self._rows, there)[0])


def _upright(surface: Surface, column: float, row: float) -> NDArray[np.float64]:
    """(x, y) of a place of the input."""
    place = np.array([[column - surface.corner[1]], [row - surface.corner[0]]])
    seen = np.array([sample(surface.x_mm, place)[0], sample(surface.y_mm, place)[0]])
    plan = surface.plan(np.array([column]), np.array([row]))[:, 0]
    return np.where(np.isfinite(seen), seen, plan)
