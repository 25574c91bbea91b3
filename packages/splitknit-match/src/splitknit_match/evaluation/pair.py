"""Two measurements of one surface, laid on each other: how they differ, by slant and by wavelength.

A bare finger and the same finger coated, pressed on a gel, or cast: the second is nearly free of
what light does in skin, so that what the two differ by is the first one's error, the second one's
error, and the protocol's.

- *rigid*: six degrees of freedom. The start comes from the ridges
  (:mod:`splitknit_match.matching.ridge`); then the differences of height are least, those narrower
  and those wider than a ridge weighted by their own variance.
- *elastic*: both surfaces are unrolled, and B's skin may shift smoothly. Only what is narrower than
  2.5 mm is compared.
- *difference*: A minus B along the normal of the smooth surface; *gain*: least-squares factor from
  B to A (noise of B lowers it); *slant*: of A's smooth surface against its camera.
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
from splitknit.errors import require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.imaging.geometry import (
    Floats,
    bounding_box,
    eroded,
    height_gradients,
    pixels_above,
    smoothed,
)
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.reconstruction import require_scale
from splitknit_match.evaluation.rates import CONFIDENCE
from splitknit_match.matching.elastic import Affine, better_affine, compare_patches, rigid
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.ridge_band import band_places, ridge_band
from splitknit_match.matching.template import make_template

BANDS_MM = {
    "relief": (0.0, 1.7),
    "below 0.25 mm": (0.0, 0.25),
    "0.25 to 0.8 mm": (0.25, 0.8),
    "0.8 to 2.5 mm": (0.8, 2.5),
    "2.5 to 8 mm": (2.5, 8.0),
    "above 8 mm": (8.0, np.inf),
}
"""Shortest and longest wavelength; ``relief``: the ridge band of the accuracy."""
SLANTS_DEG = {
    "0 to 40": (0.0, 40.0),
    "0 to 20": (0.0, 20.0),
    "20 to 40": (20.0, 40.0),
    "40 to 60": (40.0, 60.0),
}
_SIGMA = float(np.sqrt(np.log(2.0) / 2.0) / np.pi)
"""Sigma of a Gaussian that halves waves of length one. Source: ISO 16610-61."""

PROTOCOLS = json.loads(Path(__file__).with_name("protocols.json").read_text(encoding="ascii"))
"""The protocol's own error: rms in um and gain in each of the bands, of true surfaces alone
(``validation/pair``)."""
Fit = Literal["rigid", "elastic"]


@dataclass(frozen=True, slots=True, eq=False)
class PairComparison:
    """How measurement A differs from measurement B of one surface."""

    fit: Fit
    similarity: float  # similarity of the ridges, -1 to 1
    scale: float  # length in A over length in B, by the ridges (unrolled)
    rotation: Array
    """(3, 3) of the rigid fit, whatever `fit`: A = rotation @ B + shift, both about the middle of
    their image."""
    shift_mm: Array
    """(3,) of the rigid fit."""
    strain_mm: float  # rms of the shifts of single patches of skin that are left after a rigid fit
    figures: Mapping[str, Mapping[str, Mapping[str, Any]]]
    """By band and slant: ``correlation``, ``gain``, ``rms_um`` (each an interval, whose ends are
    None where there are too few blocks), ``std_um`` of B, ``area_mm2``."""
    relief_um: FloatArray  # (2, H, W) A and B in the band ``relief``, NaN where nothing is compared
    # (2, H, W) of both in A's frame; where the fit is elastic, without their shape
    height_mm: FloatArray
    pitch_mm: float
    findings: tuple[Finding, ...] = ()
    """What a reader has to know, worst first."""


_ELASTIC_MM = 2.5  # longest wavelength that is compared on skin that may shift


def compare_results(
    a: Reconstruction | str | os.PathLike[str],
    b: Reconstruction | str | os.PathLike[str],
    *,
    fit: Fit = "rigid",
) -> PairComparison:
    """Lay two measurements of one surface on each other and measure how they differ.

    Parameters
    ----------
    a, b : Reconstruction, or path of a result folder or its ``height.npz``
        A is tested, B is the reference (or a phantom's known heights, ``python -m
        hardware.phantom``).
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
    ISO 16610-61:2015 (areal Gaussian filter); Besl and McKay 1992, A method for registration of 3-D
    shapes; Kroeger et al. 2016, Fast optical flow using dense inverse search (shifts of skin);
    Politis and Romano 1994 (resampling of blocks).

    Examples
    --------
    >>> import splitknit
    >>> import splitknit_match
    >>> comparison = splitknit_match.compare_results(  # doctest: +SKIP
    ...     "bare_result", "powder_result"
    ... )
    >>> comparison.figures["relief"]["0 to 40"]["rms_um"]["value"]  # doctest: +SKIP
    """
    results = [
        side if isinstance(side, Reconstruction) else read_result(Path(side)) for side in (a, b)
    ]
    # smallest pitch on which surfaces are compared
    step = max(0.05, *(result.pitch_mm for result in results))
    tested, reference = (_Side(result, step) for result in results)
    similarity, affine = _ridges_on_each_other(tested, reference)
    rotation, shift, fields = _rigid_fit(tested, reference, *_start(tested, reference, affine))
    if fit == "rigid":
        relief_a, relief_b = (
            _band(height, fields.valid, BANDS_MM["relief"], step) for height in fields.heights
        )
        strain_mm = _rms(_shifts(relief_a, relief_b, fields.valid, step)[fields.valid]) * step
    else:
        fields, strain_mm = _elastic_fit(tested, reference, affine)
    form = _form((fields.heights[0] + fields.heights[1]) * 0.5, fields.valid)
    detail = replace(fields, heights=(fields.heights[0] - form, fields.heights[1] - form))
    figures = {}
    for band, limits in BANDS_MM.items():
        if limits[1] <= _ELASTIC_MM:
            figures[band] = _by_slant(detail, limits, step)
        elif fit == "rigid":
            figures[band] = _by_slant(fields, limits, step)
    relief = [
        _band(height, fields.valid, BANDS_MM["relief"], step) * fields.cosine
        for height in detail.heights
    ]
    scale = float(np.sqrt(abs(np.linalg.det(affine[:, :2]))))
    findings = []
    if tested.mask.shape == reference.mask.shape and np.array_equal(
        tested.height, reference.height
    ):
        words = "A and B are the same measurement, to the last digit: that it repeats is not shown."
        findings.append(Finding("same-measurement", words, Severity.DOUBT))
    if abs(scale - 1.0) > 0.02:
        words = (
            f"Lengths in A are {100 * (scale - 1):+.1f} % of those in B; check the scale of both."
        )
        findings.append(Finding("unequal-scales", words, Severity.DOUBT))
    if fit == "rigid" and strain_mm > 0.012:
        words = (
            f"Patches of skin have shifted by {1e3 * strain_mm:.0f} um; compare with the elastic"
            " fit as well."
        )
        findings.append(Finding("shifted-skin", words))
    return PairComparison(
        fit,
        similarity,
        scale,
        rotation,
        shift,
        strain_mm,
        figures,
        relief_um=np.where(fields.valid, np.stack(relief), np.nan).astype(np.float32) * 1e3,
        height_mm=np.where(fields.valid, np.stack(fields.heights), np.nan).astype(np.float32),
        pitch_mm=step,
        findings=worst_first(findings),
    )


_MIN_COSINE = 0.5  # surface seen at more than 60 deg is not compared
_EDGE_MM = 0.4  # surface nearer to its edge is not compared


class _Side:
    """One result on a grid of `step` mm, seen from straight above, and its ridges, unrolled."""

    def __init__(self, result: Reconstruction, step: float) -> None:
        require_scale(result)
        known = result.mask & np.isfinite(result.height_mm)
        require(known.any(), "a result holds no surface.")
        self.result, self.step, self.known = result, step, known
        self.pixel = result.pitch_mm
        rows, columns = known.shape
        self.centre = (rows - 1) / 2, (columns - 1) / 2
        size = (
            round((rows - 1) * self.pixel / step) + 1,
            round((columns - 1) * self.pixel / step) + 1,
        )
        self.middle = (size[0] - 1) / 2, (size[1] - 1) / 2
        row, column = np.indices(size, dtype=float)
        self.x, self.y = (column - self.middle[1]) * step, (self.middle[0] - row) * step
        column, row = self._pixel(self.x, self.y)
        if result.x_mm is not None and result.y_mm is not None:
            point = self._pixel(result.x_mm, result.y_mm)
            column, row = pixels_above(point, known, column, row)
        source = [row, column]
        self.mask = _inside(known, source)
        require(self.mask.any(), "a result holds no surface.")
        height = _sampled(result.height_mm, known, source, step / self.pixel)
        self.height = np.where(self.mask, height, 0.0).astype(np.float32)
        self.slopes = height_gradients(np.where(self.mask, self.height, np.nan), step)
        # a mean's slope is too flat at edges
        x, y = (smoothed(slope, self.mask, 0.6 / step) for slope in self.slopes)
        self.cosine = (1.0 / np.sqrt(1.0 + x * x + y * y)).astype(np.float32)
        shape, frame = result.shape_mm, (result.input_from_upright, result.upright_size)
        relief = result.ridge_mm + shape if result.whole else result.ridge_mm
        band = ridge_band(relief, result.mask, self.pixel, shape, *frame, band_mm=step)
        template = make_template(band)
        require(
            not template.empty,
            "no ridges were found on a result; compare skin, or a phantom with ridges.",
        )
        self.ridges = Prepared(template)
        places = band_places(
            result.mask & np.isfinite(shape), shape, *frame, pitch_mm=self.pixel, band_mm=step
        )
        self.columns, self.rows, self.unrolled_cosine = (
            part[bounding_box(band.valid)] for part in places
        )
        """(h, w) where the unrolled ridges lie in the result, and the cosine of their slant."""

    def _pixel(self, x_mm: Floats, y_mm: Floats) -> tuple[Floats, Floats]:
        """Columns and rows under parallel rays."""
        return self.centre[1] + x_mm / self.pixel, self.centre[0] - y_mm / self.pixel

    def flat(self) -> tuple[FloatArray, BoolArray, FloatArray]:
        """Relief along the normal on the unrolled grid, mm, where it is known, and the slant in
        deg."""
        height, cosine = self.result.height_mm, self.unrolled_cosine
        relief = np.where(self.known, height, 0.0) - _form(height, self.known)
        relief = relief - smoothed(relief, self.known, _SIGMA * _ELASTIC_MM / self.pixel)
        place = [self.rows, self.columns]
        # unrolling errs beside the edge
        inside = _inside(eroded(self.known, 3 * _EDGE_MM / self.pixel), place)
        flat = _sampled(relief, self.known, place, self.step / self.pixel) * cosine
        return (
            flat,
            inside & (cosine > _MIN_COSINE),
            np.rad2deg(np.arccos(np.clip(cosine, 0.0, 1.0))),
        )

    def points(self, positions: FloatArray) -> Array:
        """(N, 3) points in mm of columns and rows (N, 2) of the unrolled ridges; NaN where there is
        no surface."""
        column, row = _pixels(positions.T, self.rows.shape[::-1])
        source = self.rows[row, column], self.columns[row, column]
        pixel = _pixels(source, self.known.shape)
        if self.result.x_mm is not None and self.result.y_mm is not None:
            x, y = self.result.x_mm[pixel], self.result.y_mm[pixel]
        else:
            x, y = (
                (source[1] - self.centre[1]) * self.pixel,
                (self.centre[0] - source[0]) * self.pixel,
            )
        z = np.where(self.result.mask[pixel], self.result.height_mm[pixel], np.nan)
        return np.stack([x, y, z], axis=1, dtype=float)


def _pixels(
    places: Sequence[Any] | FloatArray, size: Sequence[int]
) -> tuple[NDArray[np.int64], ...]:
    """Nearest pixels along each axis of a picture of some size."""
    pairs = zip(places, size, strict=True)
    return tuple(np.clip(np.round(place).astype(int), 0, length - 1) for place, length in pairs)


_ORDER = 9  # order of the polynomial for the slow shape


def _form(height: FloatArray, known: BoolArray) -> FloatArray:
    """Polynomial of a surface's slow shape: what is left of it has no slope from which a filter
    errs at the edge."""
    across, along = (
        np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, length), _ORDER)
        for length in height.shape
    )
    rows, columns = np.nonzero(known)
    every = max(1, len(rows) // 20_000)
    rows, columns = rows[::every], columns[::every]
    design = np.einsum("ni,nj->nij", across[rows], along[columns]).reshape(len(rows), -1)
    factors = np.linalg.lstsq(design, height[rows, columns].astype(float), rcond=1e-8)[0]
    return np.asarray(across @ factors.reshape(_ORDER + 1, -1) @ along.T, dtype=np.float32)


def _inside(mask: BoolArray, place: Sequence[FloatArray]) -> BoolArray:
    """Whether all four pixels around rows and columns are in the mask."""
    return ndimage.map_coordinates(mask.astype(np.float32), place, order=1) > 0.999


def _sampled(
    values: FloatArray, known: BoolArray, place: Sequence[FloatArray], coarser: float = 1.0
) -> FloatArray:
    """Cubic spline of `values` at rows and columns; low-passed where the places lie `coarser`
    pixels apart."""
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    full = values[tuple(nearest)].astype(float)
    if coarser > 1.2:
        full = ndimage.gaussian_filter(full, 0.35 * coarser)
    return np.asarray(
        ndimage.map_coordinates(full, place, order=3, mode="nearest"), dtype=np.float32
    )


_MIN_SIMILARITY = 0.4
"""Least similarity of the ridges of one finger; ridges of two fingers have about 0.2."""


def _ridges_on_each_other(a: _Side, b: _Side) -> tuple[float, Affine]:
    """Similarity of the ridges, and the affine map (2, 3) of a position in B's unrolled ridges to
    A's."""
    match = ridge_match(a.ridges, b.ridges)
    require(
        match.similarity >= _MIN_SIMILARITY,
        f"the ridges of A and B are not the same (similarity {match.similarity:.2f}, at least"
        f" {_MIN_SIMILARITY:g} is needed); give two measurements of one finger, or of one phantom.",
    )
    affine = rigid(
        a.ridges.band, b.ridges.band, np.deg2rad(match.rotation_deg), match.right_mm, -match.up_mm
    )
    for _ in range(3):
        affine = better_affine(
            b.ridges.first, compare_patches(b.ridges.first, a.ridges.band, affine), affine
        )
    return match.similarity, affine


def _start(a: _Side, b: _Side, affine: Affine) -> tuple[Array, Array]:
    """Rotation (3, 3) and shift (3,) in mm that take B to A, robustly, from the patches whose
    ridges agree."""
    agreement = compare_patches(b.ridges.patches, a.ridges.band, affine)
    positions = b.ridges.patches.centres[agreement.used]
    in_a = a.points((positions - agreement.shift) @ affine[:, :2].T + affine[:, 2])
    in_b = b.points(positions)
    good = (
        np.isfinite(in_a).all(axis=1)
        & np.isfinite(in_b).all(axis=1)
        & (agreement.correlation > 0.2)
    )
    require(int(good.sum()) >= 6, "A and B overlap too little; show more of the same skin in both.")
    in_a, in_b = in_a[good], in_b[good]
    weight = firm = agreement.correlation[good].astype(float)
    for _ in range(5):
        centre_a, centre_b = (np.average(points, axis=0, weights=weight) for points in (in_a, in_b))
        turn = Rotation.align_vectors(in_a - centre_a, in_b - centre_b, weights=weight)[0]
        residual = np.linalg.norm(in_a - centre_a - turn.apply(in_b - centre_b), axis=1)
        weight = firm / (1.0 + (residual / max(float(np.median(residual)), 1e-3)) ** 2)
    rotation = turn.as_matrix()
    return rotation, centre_a - rotation @ centre_b


@dataclass(frozen=True, slots=True, eq=False)
class _Fields:
    """Both surfaces on one grid."""

    heights: tuple[FloatArray, FloatArray]  # (H, W) each, mm
    valid: BoolArray
    cosine: FloatArray  # from heights to distances along the normal
    slant_deg: FloatArray


def _moved(a: _Side, b: _Side, rotation: Array, shift: Array) -> tuple[Array, list[Array]]:
    """(H, W, 3) B's points in A's frame, and rows and columns of A where they lie."""
    points = np.stack([b.x, b.y, b.height], axis=-1) @ rotation.T + shift
    return points, [a.middle[0] - points[..., 1] / a.step, a.middle[1] + points[..., 0] / a.step]


def _rigid_fields(a: _Side, b: _Side, points: Array, place: Sequence[Array]) -> _Fields:
    """A's heights where B's points lie, and those points' heights, in A's frame, on B's grid."""
    cosine = ndimage.map_coordinates(a.cosine, place, order=1, mode="nearest")
    height = _sampled(a.height, a.mask, place)
    valid = eroded(_inside(a.mask, place) & b.mask, _EDGE_MM / a.step)
    valid &= (cosine > _MIN_COSINE) & (b.cosine > _MIN_COSINE)
    require(valid.any(), "A and B have no surface in common that is seen at less than 60 deg.")
    return _Fields(
        (height, points[..., 2].astype(np.float32)), valid, cosine, np.rad2deg(np.arccos(cosine))
    )


def _rigid_fit(a: _Side, b: _Side, rotation: Array, shift: Array) -> tuple[Array, Array, _Fields]:
    """Gauss-Newton steps on the differences of height; slow and fast ones count by their own
    variance."""
    sigma = _SIGMA * BANDS_MM["relief"][1] / a.step
    for _ in range(25):  # steps of the rigid fit, at most
        points, place = _moved(a, b, rotation, shift)
        fields = _rigid_fields(a, b, points, place)
        box = bounding_box(fields.valid)
        valid, cosine, points = fields.valid[box], fields.cosine[box], points[box]
        tilt = [
            -ndimage.map_coordinates(slope, [part[box] for part in place], order=1)
            for slope in a.slopes
        ]
        normal = np.stack([*tilt, np.ones(valid.shape)], -1)
        centre = points[valid].mean(axis=0)
        jacobian = (
            np.concatenate([normal, np.cross(points - centre, normal)], axis=-1) * cosine[..., None]
        )
        error = (fields.heights[1] - fields.heights[0])[box] * cosine
        parts = np.stack([error, *np.moveaxis(jacobian, -1, 0)]).astype(np.float32)
        slow = np.stack([smoothed(part, valid, sigma)[valid] for part in parts]).astype(float)
        fast = parts[:, valid] - slow
        spread_fast, spread_slow = (
            max(1.4826 * float(np.median(np.abs(part[0] - np.median(part[0])))), 1e-5)
            for part in (fast, slow)
        )
        # a slow difference counts as often as it is independent: the Gaussian's area over a ridge's
        ratio = min(0.2 * (spread_fast / spread_slow) ** 2, 1.0)
        robust = 1.0 / (1.0 + (fast[0] / (2.0 * spread_fast)) ** 2)
        normal_matrix = (fast[1:] * robust) @ fast[1:].T + ratio * slow[1:] @ slow[1:].T
        step = -np.linalg.solve(
            normal_matrix, (fast[1:] * robust) @ fast[0] + ratio * slow[1:] @ slow[0]
        )
        # zero between a surface and itself
        step *= min(1.0, 0.1 / max(float(np.abs(step).max()), 1e-9))
        turn = Rotation.from_rotvec(step[3:]).as_matrix()
        rotation, shift = turn @ rotation, turn @ (shift - centre) + centre + step[:3]
        if float(np.abs(step).max()) < 1e-5:
            break
    return rotation, shift, _rigid_fields(a, b, *_moved(a, b, rotation, shift))


_SWEEPS = 6  # steps of the elastic fit


def _elastic_fit(a: _Side, b: _Side, affine: Affine) -> tuple[_Fields, float]:
    """Reliefs along the normal, unrolled, with B's skin shifted smoothly onto A's, and the rms of
    that shift in mm."""
    (relief_a, known_a, slant), (relief_b, known_b, _) = a.flat(), b.flat()
    row, column = np.indices(relief_b.shape, dtype=float)
    shift = np.zeros((*relief_b.shape, 2), dtype=np.float32)
    for sweep in range(_SWEEPS + 1):
        position = np.stack([column + shift[..., 0], row + shift[..., 1]], axis=-1).reshape(-1, 2).T
        place = (affine[:, :2] @ position + affine[:, 2:])[::-1].reshape(2, *relief_b.shape)
        moved = _sampled(relief_a, known_a, place)
        valid = _inside(known_a, place) & known_b
        if sweep < _SWEEPS:
            shift = shift + _shifts(moved, relief_b, valid, b.step)
    slant_deg = ndimage.map_coordinates(slant, place, order=1, mode="nearest")
    return (
        _Fields((moved, relief_b), valid, np.ones_like(relief_b), slant_deg),
        _rms(shift[valid]) * b.step,
    )


def _shifts(
    relief_a: FloatArray, relief_b: FloatArray, valid: BoolArray, step: float
) -> FloatArray:
    """(H, W, 2) smooth shifts, columns and rows in pixels, of places in B's relief to those in
    A's."""
    limit = 3.0 * max(_rms(relief[valid]) for relief in (relief_a, relief_b))
    grey_a, grey_b = (
        np.where(valid, 127.5 + 127.5 * np.clip(relief / limit, -1.0, 1.0), 127).astype(np.uint8)
        for relief in (relief_a, relief_b)
    )
    still = np.zeros((*valid.shape, 2), dtype=np.float32)
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(grey_b, grey_a, still)
    # sigma over which skin's shifts are averaged
    return np.stack(
        [smoothed(part, valid, 1.0 / step) for part in np.moveaxis(np.asarray(flow), -1, 0)],
        axis=-1,
    )


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _band(
    values: FloatArray, valid: BoolArray, limits: tuple[float, float], step: float
) -> FloatArray:
    """Return the waves between two lengths, zero where not valid."""
    fine = smoothed(values, valid, _SIGMA * limits[0] / step) if limits[0] > 0 else values
    coarse = (
        smoothed(values, valid, _SIGMA * limits[1] / step)
        if np.isfinite(limits[1])
        else values[valid].mean()
    )
    return np.where(valid, fine - coarse, 0.0).astype(np.float32)


_BLOCK_MM = 2.0  # side of the blocks that are resampled


def _by_slant(
    fields: _Fields, limits: tuple[float, float], step: float
) -> dict[str, dict[str, Any]]:
    """Figures of a band of wavelengths, by slant."""
    a, b = (
        1e3 * _band(height, fields.valid, limits, step) * fields.cosine for height in fields.heights
    )
    side = max(_BLOCK_MM, limits[1] if np.isfinite(limits[1]) else limits[0]) / step
    rows, columns = (np.arange(length) // side for length in a.shape)
    block = (rows[:, None] * (columns[-1] + 1) + columns).astype(int)
    figures = {}
    for name, (low, high) in SLANTS_DEG.items():
        where = fields.valid & (fields.slant_deg >= low) & (fields.slant_deg < high)
        if int(where.sum()) * step**2 >= _BLOCK_MM**2:
            x, y = a[where].astype(float), b[where].astype(float)
            moments = np.ones(x.shape), x, y, x * x, y * y, x * y
            sums = np.stack(
                [np.bincount(block[where], weights=moment) for moment in moments], axis=1
            )
            figures[name] = _figures(sums[sums[:, 0] > 0].astype(float), step)
    return figures


def _figures(sums: Array, step: float) -> dict[str, Any]:
    """Figures of sums (blocks, 6) of 1, a, b, a^2, b^2 and ab, with intervals."""
    value = _statistics(sums.sum(axis=0))
    ends = [[None, None]] * 4
    if len(sums) >= 6:  # with fewer blocks a figure has no interval
        # replicates of the bootstrap of blocks
        drawn = np.random.default_rng(0).multinomial(
            len(sums), np.full(len(sums), 1 / len(sums)), 1000
        )
        tail = 50.0 * (1.0 - CONFIDENCE)
        ends = np.percentile(_statistics(drawn @ sums), (tail, 100.0 - tail), axis=1).T.tolist()
    figures = {
        name: {"value": float(value[k]), "low": ends[k][0], "high": ends[k][1]}
        for k, name in enumerate(("correlation", "gain", "rms_um"))
    }
    return figures | {
        "std_um": float(value[3]),
        "area_mm2": float(sums[:, 0].sum()) * step**2,
        "blocks": len(sums),
    }


def _statistics(sums: Array) -> Array:
    """(4, ...) correlation, gain, rms of A - B and standard deviation of B, from sums (..., 6)."""
    count, a, b, aa, bb, ab = sums.T
    aa, bb, ab = aa - a * a / count, bb - b * b / count, ab - a * b / count
    rms = np.sqrt(np.maximum(aa + bb - 2 * ab, 0.0) / count)
    return np.stack(
        [
            ab / np.sqrt(np.maximum(aa * bb, 1e-30)),
            ab / np.maximum(bb, 1e-30),
            rms,
            np.sqrt(bb / count),
        ]
    )
