"""Two results: how the second is moved so that the same skin lies at the same place, and how they differ then."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import CatalogueEntry, Reading, ResultSurface, fields_of, require, sample
from splitknit_match.matching.ridge import ridge_match
from splitknit_match.matching.ridge_band import RidgeBandSettings, band_places, ridge_band
from splitknit_match.matching.template import make_template
from splitknit_match.viewer.marks import Marks

_NEAR_MM = 0.8
_TURNED_RAD = np.deg2rad(30.0)
_PICTURE_PX = 1000
_FIT_MM = 0.08  # distance of the places that are compared: a fifth of a ridge
_MIN_PLACES = 300
_MAX_STEPS, _STILL = 30, 2e-5
_Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The rigid motion that lays the second finger on the first."""

    how: str  # ``photographs`` (both from the same ones), ``ridges``, or ``none``
    rotation: _Values = field(default_factory=lambda: np.eye(3))  # (3, 3)
    shift_mm: _Values = field(default_factory=lambda: np.zeros(3))  # (3,), after the rotation
    similarity: float | None = None  # similarity of the ridges, where they were compared
    overlap_mm2: float | None = None

    @property
    def turn_rad(self) -> float:
        """About the camera's axis, counter-clockwise."""
        return float(np.arctan2(self.rotation[1, 0] - self.rotation[0, 1], self.rotation[0, 0] + self.rotation[1, 1]))

    @property
    def tilt_rad(self) -> float:
        """Angle between the two cameras' axes."""
        return float(np.arccos(np.clip(self.rotation[2, 2], -1.0, 1.0)))

    def moved(self, points_mm: _Values) -> _Values:
        """(N, 3) points of the second finger in the first one's frame."""
        return np.asarray(points_mm @ self.rotation.T + self.shift_mm)

    def read(self, surface: ResultSurface) -> Reading:
        """Heights and relief of the second finger along the camera's axis of the first."""

        def along_axis(x_mm: _Values, y_mm: _Values) -> tuple[_Values, _Values]:
            there = np.stack([x_mm, y_mm, np.zeros(len(x_mm))]) - self.shift_mm[:, None]
            start, axis = self.rotation.T @ there, self.rotation[2]
            step = (np.nanmean(surface.height_mm[::16, ::16]) - start[2]) / axis[2]
            for _ in range(1 if axis[2] == 1.0 else 6):
                place = surface.locate(start[0] + step * axis[0], start[1] + step * axis[1])
                step = (sample(surface.height_mm, place) - start[2]) / axis[2]
            return step, sample(surface.ridge_mm, place)

        return along_axis

    def document(self) -> dict[str, Any]:
        """For the page."""
        return {
            "how": self.how,
            "matrix": np.vstack([np.column_stack([self.rotation, self.shift_mm]), [0, 0, 0, 1]]).ravel().tolist(),
            "turn_rad": self.turn_rad,
            "tilt_rad": self.tilt_rad,
            "similarity": self.similarity,
            "overlap_mm2": self.overlap_mm2,
        }


def align_results(first: CatalogueEntry, a: ResultSurface, second: CatalogueEntry, b: ResultSurface) -> Alignment:
    """Lay the second result on the first.

    Of the same photographs it is turned as the upright frames are, and raised by the mean difference of the heights:
    one camera measures no distance. Else the ridges give the turn and the shift across the camera's axis; from there
    the six numbers of a rigid motion are fitted to heights and relief. Raises BadInput if a result lacks what a ridge
    template needs, or only one has a scale.
    """
    require(a.unit.known == b.unit.known, "one is in mm and one in pixels; give both a scale (`px_per_mm`).")
    photographs = first.report.get("inputs_sha256")
    if photographs and photographs == second.report.get("inputs_sha256") and a.size == b.size:
        rotation = np.eye(3)
        rotation[:2, :2] = a.turn @ b.turn.T
        return _raised(Alignment("photographs", rotation), a, b)
    bands = [_Band(entry.folder) for entry in (first, second)]
    match = ridge_match(bands[0].template, bands[1].template)
    if not match.compared:
        return Alignment("none")
    rotation = _turned(0.0, 0.0, -np.deg2rad(match.rotation_deg))  # here B comes to A
    there = _upright(b, *bands[1].place(match.right_mm, match.up_mm))
    here = _upright(a, *bands[0].place(0.0, 0.0))
    shift = np.append(here - rotation[:2, :2] @ there, 0.0)
    found = Alignment("ridges", rotation, shift, float(match.similarity), float(match.overlap_mm2))
    return _fitted(found, a, b)


def difference(a: ResultSurface, b: ResultSurface, alignment: Alignment) -> tuple[NDArray[np.uint8], dict[str, float]]:
    """How much higher the second finger is than the first, along the camera's axis; in pixels without a scale.

    Returns a picture (h, w) uint8 over the first one's input (0 = unknown, 1 to 255 = -``range_um`` to ``range_um``)
    and ``rms_um``, ``within_um`` (95 % of the area), ``relief_rms_um``, ``area_mm2`` and ``range_um``. Raises BadInput
    if they do not overlap.
    """
    height, width = (min(side, _PICTURE_PX) for side in a.size)
    rows, columns = ((np.arange(n) + 0.5) * side / n - 0.5 for n, side in zip((height, width), a.size, strict=True))
    place = np.stack([axis.ravel() for axis in np.meshgrid(columns - a.corner[1], rows - a.corner[0])])
    known = np.flatnonzero(np.isfinite(sample(a.height_mm, place)))
    here = [sample(values, place[:, known]) for values in (a.x_mm, a.y_mm, a.height_mm, a.ridge_mm)]
    there, relief = alignment.read(b)(here[0], here[1])
    apart, reliefs = a.unit.small_per_mm * (there - here[2]), a.unit.small_per_mm * (relief - here[3])
    both = np.isfinite(apart)
    require(bool(both.any()), "the two surfaces do not overlap.")
    apart, reliefs, known = apart[both], reliefs[both], known[both]
    largest = max(float(np.percentile(np.abs(apart), 98)), 0.1)
    power = 10.0 ** np.floor(np.log10(largest))
    limit = float(power * np.ceil(largest / power * 2) / 2)
    picture = np.zeros(height * width, dtype=np.uint8)
    picture[known] = np.rint(128 + 127 * np.clip(apart / limit, -1, 1))
    figures = {
        "rms_um": float(np.sqrt(np.mean(apart**2))),
        "within_um": float(np.percentile(np.abs(apart), 95)),
        "relief_rms_um": float(np.sqrt(np.mean(reliefs**2))),
        "area_mm2": float(len(known) * (a.size[0] / height) * (a.size[1] / width) * a.pitch_mm**2),
        "range_um": limit,
    }
    return picture.reshape(height, width), figures


def matched_marks(a: Marks, b: Marks, alignment: Alignment) -> list[tuple[int, int]]:
    """Pairs of minutiae that lie within 0.8 mm of each other and point the same way within 30 deg, nearest first."""
    moved, tails = alignment.moved(b.place_mm), alignment.moved(b.tail_mm)
    gaps = np.linalg.norm(a.place_mm[:, None, :2] - moved[None, :, :2], axis=2)
    here, there = (np.arctan2(step[:, 1], step[:, 0]) for step in (a.tail_mm - a.place_mm, tails - moved))
    turns = (here[:, None] - there[None, :] + np.pi) % (2 * np.pi) - np.pi
    rows, columns = np.nonzero((gaps <= _NEAR_MM) & (np.abs(turns) <= _TURNED_RAD))
    kept: dict[int, int] = {}
    for k in np.argsort(gaps[rows, columns], kind="stable").tolist():
        if rows[k] not in kept and columns[k] not in kept.values():
            kept[int(rows[k])] = int(columns[k])
    return list(kept.items())


def _raised(found: Alignment, a: ResultSurface, b: ResultSurface) -> Alignment:
    """Both at the same height on average, over a coarse grid of the first."""
    step = max(1, round(max(a.mask.shape) / 60))
    inside = a.mask[::step, ::step]
    x, y, z = (values[::step, ::step][inside].astype(np.float64) for values in (a.x_mm, a.y_mm, a.height_mm))
    gap = found.read(b)(x, y)[0] - z
    rise = -float(np.nanmean(gap)) if bool(np.isfinite(gap).any()) else 0.0
    return replace(found, shift_mm=found.shift_mm + np.array([0.0, 0.0, rise]))


def _fitted(found: Alignment, a: ResultSurface, b: ResultSurface) -> Alignment:
    """Move the second finger, rigidly, so that heights and relief agree best.

    Gauss-Newton steps on the distances along the normals (Y. Chen and G. Medioni, Image and Vision Computing 10(3),
    1992) and on the relief's differences (B. Lucas and T. Kanade, IJCAI 1981), each divided by its spread, large ones
    weighted down. Where ridges are more than a quarter of a period apart, it stays wrong: `found` must be close.
    """
    step = max(1, round(_FIT_MM / a.pitch_mm))
    x, y, z, ridge = (values[::step, ::step].astype(np.float64) for values in (a.x_mm, a.y_mm, a.height_mm, a.ridge_mm))
    slopes = [np.gradient(values, step * a.pitch_mm, axis=axis) for values in (z, ridge) for axis in (0, 1)]
    known = np.isfinite(slopes[0] + slopes[1])
    slope, relief = (a.turn @ np.stack([slopes[k + 1][known], -slopes[k][known]]) for k in (0, 2))
    x, y, z, ridge = x[known], y[known], z[known], ridge[known]
    flat = 1.0 / np.sqrt(1.0 + (slope**2).sum(axis=0))
    along_normal = np.stack([-slope[0], -slope[1], np.ones(len(x))]) * flat
    along_relief = -np.stack([relief[0], relief[1], np.zeros(len(x))])
    for _ in range(_MAX_STEPS):
        height, other = found.read(b)(x, y)
        both = np.isfinite(height - z)
        if both.sum() < _MIN_PLACES:
            return found
        place = np.stack([x, y, z])[:, both]
        middle = place.mean(axis=1)
        jacobian, residuals = [], []
        for direction, residual in (
            (along_normal[:, both], ((height - z) * flat)[both]),
            (along_relief[:, both], (other - ridge)[both]),
        ):
            spread = 3.0 * float(np.median(np.abs(residual - np.median(residual)))) + 1e-9
            weight = 1.0 / (spread * (1.0 + (residual / spread) ** 2))
            lever = np.cross((place - middle[:, None]).T, direction.T).T
            jacobian.append(np.vstack([lever, direction]) * weight)
            residuals.append(-residual * weight)
        move = np.linalg.lstsq(np.hstack(jacobian).T, np.concatenate(residuals), rcond=None)[0]
        rotation = _turned(*move[:3])
        shift = rotation @ (found.shift_mm - middle) + middle + move[3:]
        found = replace(found, rotation=rotation @ found.rotation, shift_mm=shift)
        if np.abs(move).max() < _STILL:
            break
    return found


def _turned(*vector_rad: float) -> _Values:
    return np.asarray(cv2.Rodrigues(np.array(vector_rad, dtype=np.float64))[0], dtype=np.float64)


class _Band:
    """A result's ridge template, and where its pixels lie in the input."""

    def __init__(self, folder: Path) -> None:
        arrays = fields_of(folder, ("ridge_mm", "shape_mm"))
        mask, ridge, shape = arrays["mask"], arrays["ridge_mm"], arrays["shape_mm"]
        pitch, matrix, size = arrays["pitch_mm"], arrays["input_from_upright"], arrays["upright_size"]
        settings = RidgeBandSettings()
        band = ridge_band(ridge, mask, pitch, shape, matrix, size, settings)
        self.template = make_template(band)
        self.pitch_mm = band.pitch_mm
        known = mask & np.isfinite(ridge) & np.isfinite(shape)
        self._columns, self._rows, _ = band_places(known, shape, matrix, size, pitch_mm=pitch, settings=settings)
        valid = [np.flatnonzero(band.valid.any(axis=axis)) for axis in (0, 1)]
        self._middle = [float(lines[0] + lines[-1]) / 2 if lines.size else 0.0 for lines in valid]

    def place(self, right_mm: float, up_mm: float) -> tuple[float, float]:
        """Column and row in the input of a place given from the template's middle."""
        column, row = self._middle[0] + right_mm / self.pitch_mm, self._middle[1] - up_mm / self.pitch_mm
        there = np.array([[column], [row]])
        return float(sample(self._columns, there)[0]), float(sample(self._rows, there)[0])


def _upright(surface: ResultSurface, column: float, row: float) -> NDArray[np.float64]:
    place = np.array([[column - surface.corner[1]], [row - surface.corner[0]]])
    measured = np.array([sample(surface.x_mm, place)[0], sample(surface.y_mm, place)[0]])
    plan = surface.plan(np.array([column]), np.array([row]))[:, 0]
    return np.where(np.isfinite(measured), measured, plan)
