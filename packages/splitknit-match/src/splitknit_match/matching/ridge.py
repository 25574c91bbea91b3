"""Comparison of two ridge templates: coarse alignment, an affine refinement, local correlation, one similarity.

A higher similarity means more similar fingers; 1 is the same picture. Comparing A with B gives what B with A gives.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cache, cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.geometry import gaussian_mean
from splitknit.model import BoolArray, FloatArray
from splitknit_match.matching.elastic import (
    STEP_MM,
    Affine,
    Agreement,
    PatchGrid,
    better_affine,
    compare_patches,
    patch_grid,
    rigid,
    spectrum_of,
)
from splitknit_match.matching.minutia_pairs import Cylinders, minutia_cylinders
from splitknit_match.matching.template import Template, pack

Spectra = NDArray[np.complex64]

_STEP_DEG = 5.0
"""Between two rotations whose directions of ridges are compared."""
_ROTATIONS = 6
"""How many of all are tried on the ridges, each there and half a step on, to the side of the better neighbour."""
_UPRIGHT_ROTATIONS, _UPRIGHT_STEPS = 3, 6
"""How many of the steps to each side of no rotation are tried in any case: most fingers lie upright, and where little
overlaps, directions alone find them too seldom."""
_PITCH_MM = 0.15
"""Side of a pixel of the coarse grid."""
_PLANE_PX = (216, 216)
"""Rows and columns of the coarse grid; of a finger that is larger the middle is used."""
_MIDDLE = np.array(_PLANE_PX) // 2
_BLOCK_MM, _BLOCKS = 1.5, (27, 24)
"""Side of a block that has one direction, and rows and columns of the grid of blocks."""
_WINDOW_MM = 1.05
"""Side of the square over which a direction is averaged."""
_CANDIDATES = 2
"""Peaks that are looked at closely."""
_LOW = 0.7
"""Peaks lower than this fraction of the highest are not: of 2,024 pairs tried, ten of those led to another score, by at
most 0.04, and none changed a rate."""
_WHITENING = 0.5
"""Power of the magnitude that each spectrum is divided by: 0 correlates, 1 keeps phase alone."""
_HALF = round(180 / _STEP_DEG)
"""Steps of half a turn. What is turned by half a turn more is the same upside down: its spectrum is conjugate, and the
peak of a correlation with it lies one pixel further on both axes."""


@dataclass(frozen=True, slots=True)
class _Peak:
    """One alignment of A on B."""

    angle_deg: float
    """A is turned by it about its middle, counter-clockwise."""
    right_mm: float
    """Then its middle lies so far right of B's middle."""
    down_mm: float
    height: float
    """Height of the correlation's peak, relative to complete agreement."""


class _RotatedViews:
    """A ridge band (H, W) under all rotations, as spectra: its directions at once, its ridges when first asked for.

    The latter take up to 7 MB, as whole numbers of 16 bits.
    """

    def __init__(self, value: FloatArray, valid: BoolArray, pitch_mm: float) -> None:
        """Take the band; its middle becomes the middle of the grids."""
        self._soft, self._pitch_mm = _softened(value, pitch_mm), pitch_mm
        self.directions = _block_directions(value, valid, pitch_mm, _STEP_DEG * np.arange(_HALF, dtype=float))
        count = 2 * _HALF
        self._ridges = np.zeros((count, _PLANE_PX[0], 2 * (_PLANE_PX[1] // 2 + 1)), dtype=np.int16)
        self._unit = np.zeros(count, dtype=np.float32)

    def ridges(self, number: int) -> tuple[Spectra, float]:
        """Spectrum, turned by `number` half steps (less half a turn), and its unit."""
        k = number % len(self._unit)
        if self._unit[k] == 0:
            view = _ridge_view(self._soft, self._pitch_mm, _angle_deg(k)).view(np.float32)
            unit = np.float32(max(float(np.abs(view).max()), 1e-30) / np.iinfo(np.int16).max)
            self._ridges[k] = np.round(view / unit)
            self._unit[k] = unit  # last: another thread may look here
        return self._ridges[k].astype(np.float32).view(np.complex64), float(self._unit[k])


def _angle_deg(number: int) -> float:
    """Rotation that is tried on the ridges."""
    return number * _STEP_DEG / 2


def _block_directions(value: FloatArray, valid: BoolArray, pitch_mm: float, angles_deg: NDArray[np.float64]) -> Spectra:
    """Spectra (3, A, rows, columns // 2 + 1) of blocks of a ridge band (H, W), turned by some angles (A,).

    Cosine and sine of the doubled directions, of length at most about one, and the fraction that is valid.
    """
    across = cv2.Sobel(value, cv2.CV_32F, 1, 0)
    up = -cv2.Sobel(value, cv2.CV_32F, 0, 1)
    side = (round(_WINDOW_MM / pitch_mm),) * 2

    def mean(part: FloatArray) -> FloatArray:
        return np.asarray(cv2.blur(part, side, borderType=cv2.BORDER_CONSTANT))

    xx, yy, xy = mean(across * across), mean(up * up), mean(across * up)
    total = np.maximum(xx + yy, max(0.3 * _median((xx + yy)[valid]), 1e-12))
    parts = [(xx - yy) / total, 2 * xy / total, mean(valid.astype(np.float32))]
    field = np.stack(parts, axis=-1, dtype=np.float32)
    turned = np.empty((len(angles_deg), *_BLOCKS, 3), dtype=np.float32)
    for k, angle in enumerate(np.deg2rad(angles_deg)):
        cos, sin = np.cos(2 * angle), np.sin(2 * angle)
        fetched = _fetched(field, float(angle), _BLOCK_MM / pitch_mm, _BLOCKS)
        turned[k] = cv2.transform(fetched, np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]))
    return spectrum_of(np.moveaxis(turned, -1, 0))


def _median(values: FloatArray) -> float:
    """numpy's loads its masked arrays first, which takes longer than a comparison."""
    middle = (len(values) - 1) // 2, len(values) // 2
    return float(np.partition(values, middle)[list(middle)].mean())


def _softened(value: FloatArray, pitch_mm: float) -> FloatArray:
    """A ridge band (H, W) with less of what the coarse grid cannot hold."""
    return gaussian_mean(value, 0.4 * _PITCH_MM / pitch_mm)


def _ridge_view(soft: FloatArray, pitch_mm: float, angle_deg: float) -> Spectra:
    """Whitened spectrum (rows, columns // 2 + 1) of a soft band (H, W), turned; its middle is the grid's middle.

    Correlated with itself, it has a peak of 1.
    """
    turned = _fetched(soft, float(np.deg2rad(angle_deg)), _PITCH_MM / pitch_mm, _PLANE_PX)
    return _whitened(spectrum_of(turned))


def _fetched(picture: FloatArray, angle_rad: float, step_px: float, size: tuple[int, int]) -> FloatArray:
    """`picture`, turned counter-clockwise about its middle, on a grid of `size` whose steps are `step_px`."""
    # the content turns counter-clockwise as seen (rows run down): fetch from the clockwise place
    cos, sin = step_px * np.cos(angle_rad), step_px * np.sin(angle_rad)
    centre = (picture.shape[1] - 1) / 2, (picture.shape[0] - 1) / 2
    middle = (size[1] - 1) / 2, (size[0] - 1) / 2
    source = np.array(
        [
            [cos, -sin, centre[0] - cos * middle[0] + sin * middle[1]],
            [sin, cos, centre[1] - sin * middle[0] - cos * middle[1]],
        ]
    )
    return np.asarray(cv2.warpAffine(picture, source, size[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP))


def peaks(rotated: _RotatedViews, directions: Spectra, ridges: Spectra) -> list[_Peak]:
    """Best alignments of A on B, best first, at most one a rotation.

    `directions`, `ridges`: of B, not turned, from :func:`_block_directions` and :func:`_ridge_view`.
    """
    scores = np.concatenate(
        [_agreement(rotated.directions.conj() * directions), _agreement(rotated.directions * directions)]
    )
    upright = np.arange(-_UPRIGHT_STEPS, _UPRIGHT_STEPS + 1)
    best = np.concatenate(
        [
            np.argsort(-scores, kind="stable")[:_ROTATIONS],
            upright[np.argsort(-scores[upright], kind="stable")[:_UPRIGHT_ROTATIONS]] % (2 * _HALF),
        ]
    )
    aside = np.where(np.roll(scores, -1)[best] >= np.roll(scores, 1)[best], 1, -1)
    numbers = sorted({*(2 * best).tolist(), *((2 * best + aside) % (4 * _HALF)).tolist()})
    both = ridges.conj(), ridges
    found = [_peak(*rotated.ridges(number), both, number) for number in numbers]
    found.sort(key=lambda peak: -peak.height)
    return [peak for peak in found[:_CANDIDATES] if peak.height >= _LOW * found[0].height]


def _peak(turned: Spectra, unit: float, ridges: tuple[Spectra, Spectra], number: int) -> _Peak:
    """Largest correlation of one view of A with B, whose spectrum comes conjugate and as it is."""
    flipped = number >= 2 * _HALF
    turned *= ridges[flipped]
    correlation = np.fft.irfft2(turned, s=_PLANE_PX)
    place = np.array(divmod(int(correlation.argmax()), _PLANE_PX[1]))
    height = float(correlation[tuple(place)]) * unit
    # of what is not upside down the spectrum is conjugate: its correlation is mirrored
    down, right = (((place + 1 if flipped else -place) + _MIDDLE) % _PLANE_PX - _MIDDLE).tolist()
    return _Peak(_angle_deg(number), right * _PITCH_MM, down * _PITCH_MM, height)


def _agreement(products: Spectra) -> NDArray[np.float32]:
    """(A,) largest agreement of directions over all shifts, over the root of the overlap; from (3, A, ...)."""
    both = np.fft.irfft2(np.stack([products[0] + products[1], products[2]]), s=_BLOCKS)
    overlap = np.maximum(both[1], 0.2 * both[1].max())
    return np.asarray((both[0] / np.sqrt(overlap)).reshape(both.shape[1], -1).max(axis=1))


def _whitened(spectrum: Spectra) -> Spectra:
    size = np.abs(spectrum)
    floor = max(0.05 * float(size.max()), 1e-12)
    result = spectrum * (_ridge_pass() / np.maximum(size, floor) ** _WHITENING)
    # twice the power of the half plane, but for its first column, where ridges have little
    power = 2 * float((np.abs(result) ** 2).sum())
    result *= np.float32(np.sqrt(_PLANE_PX[0] * _PLANE_PX[1] / max(power, 1e-30)))
    return result


@cache
def _ridge_pass() -> FloatArray:
    """(rows, columns // 2 + 1) 1 at the frequencies of ridges, periods of 0.26 to 0.83 mm, 0 elsewhere."""
    down, right = np.fft.fftfreq(_PLANE_PX[0], _PITCH_MM), np.fft.rfftfreq(_PLANE_PX[1], _PITCH_MM)
    cycles = np.hypot(down[:, None], right)
    return np.asarray((cycles > 1.2) & (cycles < min(3.8, 0.5 / _PITCH_MM)), dtype=np.float32)


_REFINEMENTS = 2
"""Affine fits to the patches' shifts."""
_MIN_OVERLAP_MM2 = 60.0
"""Where less skin overlaps, and it is not all that the smaller template has, the similarity is lowered."""

_FIRST_MM = (2.4, 0.8)
"""Step and search of the patches that refine the coarse alignment."""
_CLOSE_MM = (1.2, 0.4)
"""Of those that bend a small print."""
_POSE_STEP_DEG, _POSES, _APART_MM = 4.0, 8, 0.6
"""Of a small print: between two turns, how many alignments go on, and how far apart those of like turns lie."""
_MIN_PAIRED = 3
"""Minutiae of a small print that are compared; of others ten."""
_OVERLAPS = 3
"""Turns that share what overlaps."""
_LEAST_POSE_MM2 = 6.0
"""What overlaps less counts as if it were so much."""


@dataclass(frozen=True, slots=True)
class RidgeMatch:
    """How similar two fingers are, and how they were laid on each other."""

    similarity: float
    """At most 1; other fingers give about 0.2; -1 where a finger could not be acquired."""
    correlation: float
    """Mean local correlation over the overlap."""
    overlap_mm2: float
    """Skin compared."""
    rotation_deg: float
    """By which A is turned, counter-clockwise as the camera sees it."""
    right_mm: float
    """From the middle of B's template to the middle of A's."""
    up_mm: float
    compared: bool
    """False where one side is a failure to acquire."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A template with all that comparisons need and that does not depend on the other side, made when first used."""

    template: Template

    @cached_property
    def key(self) -> bytes:
        """By which sides are ordered, so that the result does not depend on the order of arguments."""
        return hashlib.sha256(pack(replace(self.template, minutiae=None))).digest()

    @cached_property
    def value(self) -> FloatArray:
        """(H, W) ridge band with the steps of its levels smoothed away, zero outside."""
        smooth = gaussian_mean(self.template.value(), 0.6)
        return np.where(self.template.valid, smooth, 0.0).astype(np.float32)

    @property
    def shown(self) -> tuple[FloatArray, BoolArray]:
        """Its ridges, and where there are any."""
        return self.value, self.template.valid

    @cached_property
    def rotated(self) -> _RotatedViews:
        """Views under all rotations."""
        return _RotatedViews(self.value, self.template.valid, self.template.pitch_mm)

    @cached_property
    def directions(self) -> Spectra:
        """Directions without rotation."""
        return _block_directions(self.value, self.template.valid, self.template.pitch_mm, np.zeros(1))

    @cached_property
    def ridges(self) -> Spectra:
        """Ridges without rotation."""
        soft = _softened(self.value, self.template.pitch_mm)
        return _ridge_view(soft, self.template.pitch_mm, 0.0)

    @cached_property
    def turned(self) -> NDArray[np.float32]:
        """(2, A, side, side) ridges and where there are any on the coarse grid, turned by steps of a small print."""
        side = int(np.ceil(np.hypot(*self.template.valid.shape) / self._step)) + 2
        angles = np.deg2rad(_POSE_STEP_DEG) * np.arange(round(360 / _POSE_STEP_DEG))
        return self._on_grid(angles.tolist(), (side, side))

    @cached_property
    def still(self) -> NDArray[np.float32]:
        """(2, rows, columns) of the same, as it lies."""
        rows, columns = (int(np.ceil(side / self._step)) for side in self.template.valid.shape)
        return self._on_grid([0.0], (rows, columns))[:, 0]

    @property
    def _step(self) -> float:
        return _PITCH_MM / self.template.pitch_mm

    def _on_grid(self, angles_rad: list[float], size: tuple[int, int]) -> NDArray[np.float32]:
        pictures = _softened(self.value, self.template.pitch_mm), self.template.valid.astype(np.float32)
        return np.stack(
            [np.stack([_fetched(part, angle, self._step, size) for angle in angles_rad]) for part in pictures]
        )

    @cached_property
    def close(self) -> PatchGrid:
        """Patches that bend a small print."""
        return patch_grid(self.value, self.template.valid, self.template.pitch_mm, *_CLOSE_MM)

    @cached_property
    def cylinders(self) -> Cylinders | None:
        """Cylinders of its minutiae; None where there are too few."""
        found = self.template.minutiae
        if found is None or found.count < _MIN_PAIRED:
            return None
        return minutia_cylinders(found, self.template.valid, self.template.pitch_mm)

    @cached_property
    def first(self) -> PatchGrid:
        """Patches for the refinement."""
        return patch_grid(self.value, self.template.valid, self.template.pitch_mm, *_FIRST_MM)

    @cached_property
    def patches(self) -> PatchGrid:
        """Patches for the score."""
        return patch_grid(self.value, self.template.valid, self.template.pitch_mm)


def prepared(side: Template | Prepared) -> Prepared:
    """A side of a comparison with all that it needs."""
    return side if isinstance(side, Prepared) else Prepared(side)


def ridge_match(a: Template | Prepared, b: Template | Prepared) -> RidgeMatch:
    """Compare two templates; prepare one that is compared more than once.

    The `similarity` is the mean, over the patches of the overlap, of the local correlation at the shift that the
    neighbouring patches support, times sqrt(min(1, overlap / least)) with least = min(60 mm2, half of the smaller
    template). Raises BadInput if the templates have different pitches.

    Source: Kuglin and Hines 1975, The phase correlation image alignment method; Ito et al. 2004, A fingerprint matching
    algorithm using phase-only correlation (band limit, rotation search); Bazen et al. 2000, A correlation-based
    fingerprint verification system (local patches).
    """
    left, right = prepared(a), prepared(b)
    if left.template.empty or right.template.empty:
        return RidgeMatch(-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, compared=False)
    require(
        left.template.pitch_mm == right.template.pitch_mm,
        f"templates have pitches of {left.template.pitch_mm:g} and {right.template.pitch_mm:g} mm; make both new.",
    )
    swapped = left.key > right.key
    result, affine = lay(right, left) if swapped else lay(left, right)
    return placed(result, affine, left, right, swapped)


def placed(found: RidgeMatch, affine: Affine, left: Prepared, right: Prepared, swapped: bool) -> RidgeMatch:
    """`found` with how `left` lies on `right`; `swapped`: the affine map is of the other direction."""
    pitch = left.template.pitch_mm
    if swapped:
        affine = inverse(affine)
    # affine: place in b to place in a; where a's middle lies in b
    angle = float(np.arctan2(affine[1, 0] - affine[0, 1], affine[0, 0] + affine[1, 1]))
    shape, other = left.template.valid.shape, right.template.valid.shape
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    there = np.linalg.solve(affine[:, :2], middle - affine[:, 2])
    offset = (there - np.array([(other[1] - 1) / 2, (other[0] - 1) / 2])) * pitch
    return replace(found, rotation_deg=float(np.rad2deg(angle)), right_mm=float(offset[0]), up_mm=float(-offset[1]))


def lay(a: Prepared, b: Prepared) -> tuple[RidgeMatch, Affine]:
    """Compare `a` with `b`, in this order, and the affine map from b's places to a's."""
    starts = starts_by_ridges(a, b)
    found = [(start, compare_patches(b.first, a.value, a.template.valid, start)) for start in starts]
    start, best = max(found, key=lambda one: one[1].evidence)
    affine = refined(a, b, start, best)
    return scored(a, b, compare_patches(b.patches, a.value, a.template.valid, affine)), affine


def starts_by_ridges(a: Prepared, b: Prepared) -> list[Affine]:
    """Alignments to begin with, by correlation."""
    pitch, shapes = a.template.pitch_mm, (a.template.valid.shape, b.template.valid.shape)
    return [
        rigid(*shapes, float(np.deg2rad(one.angle_deg)), (one.right_mm / pitch, one.down_mm / pitch))
        for one in peaks(a.rotated, b.directions, b.ridges)
    ]


def every_pose(a: Prepared, b: Prepared) -> list[Affine]:
    """Alignments of a small B on A to begin with: every turn and shift, by correlation over the root of the overlap."""
    turned, still = b.turned, a.still
    rows, columns = (cv2.getOptimalDFTSize(turned.shape[2] + side) for side in still.shape[1:])
    size = rows, columns
    target = spectrum_of(still, size).conj()
    # both grids have their middles at (side - 1) / 2: where the middles fall together is not a shift
    offset = np.array([(s - t) / 2 for s, t in zip(still.shape[:0:-1], turned.shape[:1:-1], strict=True)])
    scale = (size[0] * size[1]) ** 0.5
    found, root = [], np.ones(size, dtype=np.float32)

    def correlated(what: int, number: int) -> FloatArray:
        product = spectrum_of(turned[what, number], size) * target[what]
        return np.asarray(scale * np.fft.irfft2(product, s=size, norm="ortho"))

    for number in range(turned.shape[1]):
        if number % _OVERLAPS == 0:
            root = np.sqrt(np.maximum(correlated(1, number), _LEAST_POSE_MM2 / _PITCH_MM**2))
        height = correlated(0, number) / root
        for _ in range(2):
            row, column = divmod(int(height.argmax()), size[1])
            there = np.array([column, row])
            # shifts of B's grid beyond its own size lie to the left and above
            there = np.where(there >= np.array(turned.shape[:1:-1]), there - np.array(size[::-1]), there)
            found.append((float(height[row, column]), number * _POSE_STEP_DEG, (there + offset) * _PITCH_MM))
            height[max(0, row - 2) : row + 3, max(0, column - 2) : column + 3] = -np.inf
    kept: list[tuple[float, float, NDArray[np.float64]]] = []
    for one in sorted(found, key=lambda one: -one[0]):
        if all(
            abs((one[1] - other[1] + 180) % 360 - 180) > 1.5 * _POSE_STEP_DEG
            or np.hypot(*(one[2] - other[2])) > _APART_MM
            for other in kept
        ):
            kept.append(one)
        if len(kept) == _POSES:
            break
    pitch, shapes = a.template.pitch_mm, (b.template.valid.shape, a.template.valid.shape)
    return [inverse(rigid(*shapes, float(np.deg2rad(angle)), tuple(-shift / pitch))) for _, angle, shift in kept]


def inverse(affine: Affine) -> Affine:
    """The same map the other way round."""
    back = np.linalg.inv(affine[:, :2])
    return np.hstack([back, -(back @ affine[:, 2])[:, None]])


def refined(a: Prepared, b: Prepared, start: Affine, found: Agreement) -> Affine:
    """Affine map that follows the shifts of large patches."""
    affine = better_affine(b.first, found, start)
    for _ in range(_REFINEMENTS - 1):
        again = compare_patches(b.first, a.value, a.template.valid, affine)
        affine = better_affine(b.first, again, affine)
    return affine


def scored(a: Prepared, b: Prepared, final: Agreement) -> RidgeMatch:
    """Similarity by the patches of an alignment."""
    overlap = float(final.weight.sum()) * STEP_MM**2
    smaller = min(a.template.area_mm2, b.template.area_mm2)
    least = max(min(_MIN_OVERLAP_MM2, 0.5 * smaller), 1e-9)
    correlation = final.mean
    similarity = correlation * float(np.sqrt(min(1.0, overlap / least)))
    return RidgeMatch(similarity, correlation, overlap, 0.0, 0.0, 0.0, compared=True)
