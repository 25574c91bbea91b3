"""Two measurements of one surface, laid on each other: how they differ, by slant and by wavelength.

A bare finger and the same finger coated, pressed on a gel, or cast: the second is nearly free of what light does in
skin, so that what the two differ by is the first one's error, the second one's error, and the protocol's.

- *rigid*: six degrees of freedom. The start comes from the ridges (:mod:`splitknit_match.matching.ridge`); then the
  differences of height are least, those narrower and those wider than a ridge weighted by their own variance.
- *elastic*: both surfaces are unrolled, and B's skin may shift smoothly. Only what is narrower than 2.5 mm is compared.
- *difference*: A minus B along the normal of the smooth surface; *gain*: least-squares factor from B to A (noise of B
  lowers it); *slant*: of A's smooth surface against its camera.
- *intervals*: 95 %, of resampled square blocks (2 mm a side, or the band's longest wavelength).
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from splitknit import Reconstruction, read_result
from splitknit.accuracy import eroded
from splitknit.errors import require
from splitknit.imaging.geometry import bounding_box, height_gradients, smoothed
from splitknit.model import BoolArray, FloatArray, require_scale
from splitknit_match.evaluation.rates import CONFIDENCE
from splitknit_match.matching.elastic import Affine, Agreement, PatchGrid, better_affine, compare_patches, rigid
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.ridge_band import band_places, ridge_band
from splitknit_match.matching.template import make_template

Array = NDArray[np.float64]

STEP_MM = 0.05  # pixels on which is compared, at least
BANDS_MM = {
    "relief": (0.0, 1.7),
    "below 0.25 mm": (0.0, 0.25),
    "0.25 to 0.8 mm": (0.25, 0.8),
    "0.8 to 2.5 mm": (0.8, 2.5),
    "2.5 to 8 mm": (2.5, 8.0),
    "above 8 mm": (8.0, np.inf),
}
"""Shortest and longest wavelength; ``relief``: the ridge band of :mod:`splitknit.accuracy`."""
_SIGMA = float(np.sqrt(np.log(2.0) / 2.0) / np.pi)  # of a Gaussian that halves waves of length one (ISO 16610-61)
SLANTS_DEG = {"0 to 40": (0.0, 40.0), "0 to 20": (0.0, 20.0), "20 to 40": (20.0, 40.0), "40 to 60": (40.0, 60.0)}
ELASTIC_MM = 2.5  # longest wavelength that is compared on skin that may shift
_BLOCK_MM, _FEW, _REPLICATES = 2.0, 6, 1000
_LEAST_SIMILARITY = 0.4  # least similarity of the ridges of one finger; ridges of two fingers have about 0.2
_EDGE_MM = 0.4
_SWEEPS, _SKIN_MM = 6, 1.0  # steps of the elastic fit, and sigma over which skin's shifts are averaged
_STEPS, _ORDER = 25, 9  # steps of the rigid fit; order of the polynomial for the slow shape

PROTOCOLS = json.loads(Path(__file__).with_name("protocols.json").read_text(encoding="ascii"))
"""The protocol's own error: rms in um and gain in each of the bands, of true surfaces alone (``validation/pair``)."""
Fit = Literal["rigid", "elastic"]


@dataclass(frozen=True, slots=True, eq=False)
class PairComparison:
    """How measurement A differs from measurement B of one surface."""

    fit: Fit
    similarity: float  # similarity of the ridges, -1 to 1
    scale: float  # length in A over length in B, by the ridges (unrolled)
    rotation: Array  # (3, 3), and
    shift_mm: Array
    """(3,): A = rotation @ B + shift, both about the middle of their image; of the start where the fit is elastic."""
    strain_mm: float  # rms of the shifts of single patches of skin that are left after a rigid fit
    figures: Mapping[str, Mapping[str, Mapping[str, Any]]]
    """By band and slant: ``correlation``, ``gain``, ``rms_um`` (each an interval, whose ends are None where there are
    too few blocks), ``std_um`` of B, ``area_mm2``."""
    difference_um: FloatArray  # (H, W) A minus B in the band ``relief``, NaN where nothing is compared
    relief_um: FloatArray  # (2, H, W) that band of A and of B
    height_mm: FloatArray  # (2, H, W) of both in A's frame; where the fit is elastic, without their shape
    pitch_mm: float
    notes: tuple[str, ...] = ()


def compare_results(
    a: Reconstruction | str | os.PathLike[str], b: Reconstruction | str | os.PathLike[str], *, fit: Fit = "rigid"
) -> PairComparison:
    """Lay two measurements of one surface on each other and measure how they differ.

    Parameters
    ----------
    a, b : Reconstruction, or path of a result folder or its ``height.npz``
        A is tested, B is the reference (or a phantom's known heights, ``python -m hardware.phantom``).
    fit : ``rigid`` (six degrees of freedom) or ``elastic`` (skin that was pressed or has shifted)

    Returns
    -------
    PairComparison

    Raises
    ------
    BadInput
        If a file cannot be read, a scale is unknown, or the ridges of A and B are not the same.

    References
    ----------
    ISO 16610-61:2015 (areal Gaussian filter); Besl and McKay 1992, A method for registration of 3-D shapes; Kroeger et
    al. 2016, Fast optical flow using dense inverse search (shifts of skin); Politis and Romano 1994 (resampling of
    blocks).

    Examples
    --------
    >>> import splitknit
    >>> import splitknit_match
    >>> found = splitknit_match.compare_results("bare_result", "powder_result")  # doctest: +SKIP
    >>> found.figures["relief"]["0 to 40"]["rms_um"]["value"]  # doctest: +SKIP
    """
    sides = [side if isinstance(side, Reconstruction) else read_result(Path(side)) for side in (a, b)]
    one, two = (_Side(side, max(STEP_MM, *(side.pitch_mm for side in sides))) for side in sides)
    similarity, affine = _ridges_on_each_other(one, two)
    turn, centres = _turn_of(*_matched_points(one, two, affine))
    start = turn.as_matrix()
    rotation, shift = _rigid_fit(one, two, start, centres[0] - start @ centres[1])
    scale = float(np.sqrt(abs(np.linalg.det(affine[:, :2]))))
    if fit == "rigid":
        fields = _rigid_fields(one, two, rotation, shift)
        cut = [_band(part, fields.valid, BANDS_MM["relief"], one.step) for part in fields.heights]
        left = _rms(_shifts(cut[0], cut[1], fields.valid, one.step)[fields.valid]) * one.step
    else:
        fields, left = _elastic_fields(one, two, affine)
    form = _form((fields.heights[0] + fields.heights[1]) * 0.5, fields.valid)
    detail = replace(fields, heights=(fields.heights[0] - form, fields.heights[1] - form))
    bands = {band: limits for band, limits in BANDS_MM.items() if fit == "rigid" or limits[1] <= ELASTIC_MM}
    parts = {band: detail if limits[1] <= ELASTIC_MM else fields for band, limits in bands.items()}
    figures = {band: _by_slant(parts[band], limits, one.step) for band, limits in bands.items()}
    reliefs = [_band(part, fields.valid, BANDS_MM["relief"], one.step) * fields.cosine for part in detail.heights]
    shown = np.where(fields.valid, np.stack(reliefs), np.nan).astype(np.float32) * 1e3
    notes = []
    if one.mask.shape == two.mask.shape and np.array_equal(one.height, two.height):
        notes.append("A and B are the same measurement, to the last digit: that it repeats is not shown.")
    if abs(scale - 1.0) > 0.02:
        notes.append(f"Lengths in A are {100 * (scale - 1):+.1f} % of those in B; check the scale of both.")
    if fit == "rigid" and left > 0.012:
        notes.append(f"Patches of skin have shifted by {1e3 * left:.0f} um; compare with the elastic fit as well.")
    heights = np.where(fields.valid, np.stack(fields.heights), np.nan).astype(np.float32)
    fields_on_a = shown[0] - shown[1], shown, heights
    return PairComparison(fit, similarity, scale, rotation, shift, left, figures, *fields_on_a, one.step, tuple(notes))


class _Side:
    """One result on a grid of `step` mm, seen from straight above, and its ridges, unrolled."""

    def __init__(self, result: Reconstruction, step: float) -> None:
        require_scale(result)
        known = result.mask & np.isfinite(result.height_mm)
        require(known.any(), "a result holds no surface.")
        self.result, self.step = result, step
        rows, columns = result.mask.shape
        middle = (columns - 1) / 2, (rows - 1) / 2
        size = round((rows - 1) * result.pitch_mm / step) + 1, round((columns - 1) * result.pitch_mm / step) + 1
        self.middle = (size[1] - 1) / 2, (size[0] - 1) / 2
        down, right = np.indices(size, dtype=float)
        self.x, self.y = (right - self.middle[0]) * step, (self.middle[1] - down) * step
        place = there = [middle[1] - self.y / result.pitch_mm, middle[0] + self.x / result.pitch_mm]
        if result.x_mm is not None and result.y_mm is not None:  # perspective: rays meet the plane beside the points
            down, right = np.indices(known.shape)
            beside = middle[1] - result.y_mm / result.pitch_mm - down, middle[0] + result.x_mm / result.pitch_mm - right
            for _ in range(4):  # a contraction, by the depth over the distance
                there = [old - _sampled(part, known, there) for old, part in zip(place, beside, strict=True)]
        self.mask = _inside(known, there)
        require(self.mask.any(), "a result holds no surface.")
        height = _sampled(result.height_mm, known, there, step / result.pitch_mm)
        self.height = np.where(self.mask, height, 0.0).astype(np.float32)
        slopes = height_gradients(np.where(self.mask, self.height, np.nan), step)
        x, y = (smoothed(part, self.mask, 0.6 / step) for part in slopes)  # a mean's slope is too flat at the edge
        self.cosine = (1.0 / np.sqrt(1.0 + x * x + y * y)).astype(np.float32)
        self.ridges, self.places = self._unrolled()

    def _unrolled(self) -> tuple[Prepared, FloatArray]:
        """Its ridges, and (3, h, w) columns and rows of the result that they come from, and the cosine of the slant."""
        result = self.result
        shape, frame = result.shape_mm, result.input_from_upright
        relief = result.ridge_mm + shape if result.whole else result.ridge_mm
        band = ridge_band(relief, result.mask, result.pitch_mm, shape, frame, result.upright_size, band_mm=self.step)
        template = make_template(band)
        require(not template.empty, "no ridges were found on a result; compare skin, or a phantom with ridges.")
        known = result.mask & np.isfinite(shape)
        places = band_places(known, shape, frame, result.upright_size, pitch_mm=result.pitch_mm, band_mm=self.step)
        return Prepared(template), np.stack(places)[:, *bounding_box(band.valid)]

    def flat(self) -> tuple[FloatArray, BoolArray, FloatArray]:
        """Relief along the normal on the unrolled grid, mm, where it is known, and the slant in deg."""
        result, cosine = self.result, self.places[2]
        known = result.mask & np.isfinite(result.height_mm)
        relief = np.where(known, result.height_mm, 0.0) - _form(result.height_mm, known)
        relief = relief - smoothed(relief, known, _SIGMA * ELASTIC_MM / result.pitch_mm)
        place = [self.places[1], self.places[0]]
        inside = _inside(eroded(known, 3 * _EDGE_MM / result.pitch_mm), place)  # unrolling errs beside the edge
        flat = _sampled(relief, known, place, self.step / result.pitch_mm) * cosine
        return flat, inside & (cosine > 0.5), np.rad2deg(np.arccos(np.clip(cosine, 0.0, 1.0)))

    def points(self, places: Array) -> Array:
        """(N, 3) points in mm of columns and rows (N, 2) of the unrolled ridges; NaN where there is no surface."""
        column, row = np.clip(np.round(places).astype(int), 0, np.array(self.places.shape[:0:-1]) - 1).T
        result, (rows, columns) = self.result, self.result.mask.shape
        right, down = self.places[0, row, column], self.places[1, row, column]
        at = np.clip(np.round(down).astype(int), 0, rows - 1), np.clip(np.round(right).astype(int), 0, columns - 1)
        x, y = (right - (columns - 1) / 2) * result.pitch_mm, ((rows - 1) / 2 - down) * result.pitch_mm
        if result.x_mm is not None and result.y_mm is not None:
            x, y = result.x_mm[at], result.y_mm[at]
        z = np.where(result.mask[at], result.height_mm[at], np.nan)
        return np.stack([x, y, z], axis=1, dtype=float)


def _form(height: FloatArray, known: BoolArray) -> FloatArray:
    """Polynomial of a surface's slow shape: what is left of it has no slope from which a filter errs at the edge."""
    axes = [np.linspace(-1.0, 1.0, length) for length in height.shape]
    vander = [np.polynomial.legendre.legvander(axis, _ORDER) for axis in axes]
    rows, columns = np.nonzero(known)
    some = slice(None, None, max(1, len(rows) // 20_000))
    rows, columns = rows[some], columns[some]
    design = np.einsum("ni,nj->nij", vander[0][rows], vander[1][columns]).reshape(len(rows), -1)
    factors = np.linalg.lstsq(design, height[rows, columns].astype(float), rcond=1e-8)[0]
    return np.asarray(vander[0] @ factors.reshape(_ORDER + 1, -1) @ vander[1].T, dtype=np.float32)


def _inside(mask: BoolArray, place: Sequence[Array]) -> BoolArray:
    """Whether all four pixels around rows and columns are in the mask."""
    return np.asarray(ndimage.map_coordinates(mask.astype(np.float32), place, order=1) > 0.999)


def _sampled(values: FloatArray, known: BoolArray, place: Sequence[Array], coarser: float = 1.0) -> FloatArray:
    """Cubic spline of `values` at rows and columns; low-passed where the places lie `coarser` pixels apart."""
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    full = values[tuple(nearest)].astype(float)
    if coarser > 1.2:
        full = ndimage.gaussian_filter(full, 0.35 * coarser)
    return np.asarray(ndimage.map_coordinates(full, place, order=3, mode="nearest"), dtype=np.float32)


def _ridges_on_each_other(a: _Side, b: _Side) -> tuple[float, Affine]:
    """Similarity of the ridges, and the affine map (2, 3) of a place in B's unrolled ridges to A's."""
    found = ridge_match(a.ridges, b.ridges)
    seen = f"similarity {found.similarity:.2f}, at least {_LEAST_SIMILARITY:g} is needed"
    cure = "give two measurements of one finger, or of one phantom."
    same = found.similarity >= _LEAST_SIMILARITY
    require(same, f"the ridges of A and B are not the same ({seen}); {cure}")
    one, two = (side.ridges.template.valid.shape for side in (a, b))
    affine = rigid(one, two, np.deg2rad(found.rotation_deg), (found.right_mm / a.step, -found.up_mm / a.step))
    for _ in range(3):
        affine = better_affine(b.ridges.first, _agreement(a, b.ridges.first, affine), affine)
    return found.similarity, affine


def _agreement(a: _Side, patches: PatchGrid, affine: Affine) -> Agreement:
    """How patches of B's ridges fit A's."""
    return compare_patches(patches, a.ridges.band, affine)


def _matched_points(a: _Side, b: _Side, affine: Affine) -> tuple[Array, Array, Array]:
    """(N, 3) points of A and of B in mm where patches of their ridges agree, and (N,) how well they do."""
    grid = b.ridges.patches
    found = _agreement(a, grid, affine)
    places = grid.centres[found.used]
    one = a.points((places - found.shift) @ affine[:, :2].T + affine[:, 2])
    two = b.points(places)
    good = np.isfinite(one).all(axis=1) & np.isfinite(two).all(axis=1) & (found.correlation > 0.2)
    require(int(good.sum()) >= 6, "A and B overlap too little; show more of the same skin in both.")
    return one[good], two[good], found.correlation[good].astype(float)


def _turn_of(one: Array, two: Array, firm: Array) -> tuple[Rotation, Sequence[Array]]:
    """Rotation from B's points (N, 3) to A's, robustly, and the middles of both."""
    weight = firm
    for _ in range(5):
        centres = [np.average(part, axis=0, weights=weight) for part in (one, two)]
        turn = Rotation.align_vectors(one - centres[0], two - centres[1], weights=weight)[0]
        miss = np.linalg.norm(one - centres[0] - turn.apply(two - centres[1]), axis=1)
        weight = firm / (1.0 + (miss / max(float(np.median(miss)), 1e-3)) ** 2)
    return turn, centres


@dataclass(frozen=True, slots=True, eq=False)
class _Fields:
    """Both surfaces on one grid."""

    heights: tuple[FloatArray, FloatArray]  # (H, W) each, mm
    valid: BoolArray
    cosine: FloatArray  # from heights to distances along the normal
    slant_deg: FloatArray


def _rigid_fields(a: _Side, b: _Side, rotation: Array, shift: Array) -> _Fields:
    """A's heights where B's points lie, and those points' heights, in A's frame, on B's grid."""
    points = np.stack([b.x, b.y, b.height], axis=-1) @ rotation.T + shift
    place = [a.middle[1] - points[..., 1] / a.step, a.middle[0] + points[..., 0] / a.step]
    cosine = ndimage.map_coordinates(a.cosine, place, order=1, mode="nearest")
    height = _sampled(a.height, a.mask, place)
    valid = eroded(_inside(a.mask, place) & b.mask, _EDGE_MM / a.step)
    valid &= (cosine > 0.5) & (b.cosine > 0.5)  # up to 60 deg
    require(valid.any(), "A and B have no surface in common that is seen at less than 60 deg.")
    return _Fields((height, points[..., 2].astype(np.float32)), valid, cosine, np.rad2deg(np.arccos(cosine)))


def _rigid_fit(a: _Side, b: _Side, rotation: Array, shift: Array) -> tuple[Array, Array]:
    """Gauss-Newton steps on the differences of height; slow and fast ones count by their own variance."""
    slopes = height_gradients(np.where(a.mask, a.height, np.nan), a.step)
    sigma = _SIGMA * BANDS_MM["relief"][1] / a.step
    for _ in range(_STEPS):
        fields = _rigid_fields(a, b, rotation, shift)
        box = bounding_box(fields.valid)
        valid, cosine = fields.valid[box], fields.cosine[box]
        points = np.stack([b.x[box], b.y[box], b.height[box]], axis=-1) @ rotation.T + shift
        place = [a.middle[1] - points[..., 1] / a.step, a.middle[0] + points[..., 0] / a.step]
        tilt = [-ndimage.map_coordinates(part, place, order=1) for part in slopes]
        normal = np.stack([*tilt, np.ones(valid.shape)], -1)
        centre = points[valid].mean(axis=0)
        columns = np.concatenate([normal, np.cross(points - centre, normal)], axis=-1) * cosine[..., None]
        error = (fields.heights[1] - fields.heights[0])[box] * cosine
        parts = [np.asarray(part, dtype=np.float32) for part in (error, *np.moveaxis(columns, -1, 0))]
        slow = np.stack([smoothed(part, valid, sigma)[valid] for part in parts]).astype(float)
        fast = np.stack([part[valid] for part in parts]) - slow
        spreads = [max(1.4826 * float(np.median(np.abs(part - np.median(part)))), 1e-5) for part in (fast[0], slow[0])]
        # a slow difference counts as often as it is independent: the Gaussian's area over a ridge's
        ratio = min(0.2 * (spreads[0] / spreads[1]) ** 2, 1.0)
        robust = 1.0 / (1.0 + (fast[0] / (2.0 * spreads[0])) ** 2)
        matrix = (fast[1:] * robust) @ fast[1:].T + ratio * slow[1:] @ slow[1:].T
        step = -np.linalg.solve(matrix, (fast[1:] * robust) @ fast[0] + ratio * slow[1:] @ slow[0])
        step *= min(1.0, 0.1 / max(float(np.abs(step).max()), 1e-9))  # zero between a surface and itself
        turn = Rotation.from_rotvec(step[3:]).as_matrix()
        rotation, shift = turn @ rotation, turn @ (shift - centre) + centre + step[:3]
        if float(np.abs(step).max()) < 1e-5:
            break
    return rotation, shift


def _elastic_fields(a: _Side, b: _Side, affine: Affine) -> tuple[_Fields, float]:
    """Reliefs along the normal, unrolled, with B's skin shifted smoothly onto A's, and the rms of that shift in mm."""
    (first, first_on, slant), (second, second_on, _) = a.flat(), b.flat()
    down, right = np.indices(second.shape, dtype=float)

    def place(shift: FloatArray) -> list[Array]:
        column, row = affine[:, :2] @ [(right + shift[..., 0]).ravel(), (down + shift[..., 1]).ravel()] + affine[:, 2:]
        return [row.reshape(second.shape), column.reshape(second.shape)]

    shift = np.zeros((*second.shape, 2), dtype=np.float32)
    for _ in range(_SWEEPS):
        on = _inside(first_on, place(shift)) & second_on
        shift = shift + _shifts(_sampled(first, first_on, place(shift)), second, on, b.step)
    valid = _inside(first_on, place(shift)) & second_on
    angle = ndimage.map_coordinates(slant, place(shift), order=1, mode="nearest")
    fields = _Fields((_sampled(first, first_on, place(shift)), second), valid, np.ones_like(second), angle)
    return fields, _rms(shift[valid]) * b.step


def _shifts(first: FloatArray, second: FloatArray, valid: BoolArray, step: float) -> FloatArray:
    """(H, W, 2) smooth shifts, columns and rows in pixels, of places in B's relief to those in A's."""
    limit = 3.0 * max(_rms(part[valid]) for part in (first, second))
    grey = [
        np.where(valid, 127.5 + 127.5 * np.clip(part / limit, -1.0, 1.0), 127).astype(np.uint8)
        for part in (first, second)
    ]
    still = np.zeros((*valid.shape, 2), dtype=np.float32)
    estimator = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow = np.asarray(estimator.calc(grey[1], grey[0], still), dtype=np.float32)
    return np.stack([smoothed(flow[..., axis], valid, _SKIN_MM / step) for axis in range(2)], axis=-1)


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _band(values: FloatArray, valid: BoolArray, limits: tuple[float, float], step: float) -> FloatArray:
    """Return the waves between two lengths, zero where not valid."""
    fine = smoothed(values, valid, _SIGMA * limits[0] / step) if limits[0] > 0 else values
    coarse = smoothed(values, valid, _SIGMA * limits[1] / step) if np.isfinite(limits[1]) else values[valid].mean()
    return np.where(valid, fine - coarse, 0.0).astype(np.float32)


def _by_slant(fields: _Fields, limits: tuple[float, float], step: float) -> dict[str, dict[str, Any]]:
    a, b = (1e3 * _band(part, fields.valid, limits, step) * fields.cosine for part in fields.heights)
    side = max(_BLOCK_MM, limits[1] if np.isfinite(limits[1]) else limits[0]) / step
    rows, columns = (np.arange(length) // side for length in a.shape)
    block = (rows[:, None] * (columns[-1] + 1) + columns).astype(int)
    found = {}
    for name, (low, high) in SLANTS_DEG.items():
        where = fields.valid & (fields.slant_deg >= low) & (fields.slant_deg < high)
        if int(where.sum()) * step**2 < _BLOCK_MM**2:
            continue
        one, two = a[where].astype(float), b[where].astype(float)
        powers = [np.ones(one.shape), one, two, one * one, two * two, one * two]
        sums = np.stack([np.bincount(block[where], weights=part) for part in powers], axis=1)
        found[name] = _figures(sums[sums[:, 0] > 0].astype(float), step)
    return found


def _figures(sums: Array, step: float) -> dict[str, Any]:
    """Figures of sums (blocks, 6) of 1, a, b, a^2, b^2 and ab, with intervals."""

    def of(total: Array) -> Array:
        count, a, b, aa, bb, ab = total.T
        aa, bb, ab = aa - a * a / count, bb - b * b / count, ab - a * b / count
        rms = np.sqrt(np.maximum(aa + bb - 2 * ab, 0.0) / count)
        correlation, gain = ab / np.sqrt(np.maximum(aa * bb, 1e-30)), ab / np.maximum(bb, 1e-30)
        return np.stack([correlation, gain, rms, np.sqrt(bb / count)])

    value = of(sums.sum(axis=0)[None])[:, 0]
    ends = [[None, None]] * 3
    if len(sums) >= _FEW:
        drawn = np.random.default_rng(0).multinomial(len(sums), np.full(len(sums), 1 / len(sums)), _REPLICATES)
        tail = 50.0 * (1.0 - CONFIDENCE)
        ends = np.percentile(of(drawn @ sums), (tail, 100.0 - tail), axis=1).T.tolist()
    figures: dict[str, Any] = {
        name: {"value": float(value[k]), "low": ends[k][0], "high": ends[k][1]}
        for k, name in enumerate(("correlation", "gain", "rms_um"))
    }
    return figures | {"std_um": float(value[3]), "area_mm2": float(sums[:, 0].sum()) * step**2, "blocks": len(sums)}
