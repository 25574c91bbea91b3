"""Where one ridge band may lie on another: correlations of both on a coarse grid, under many
rotations.

Source: Kuglin and Hines 1975, The phase correlation image alignment method; Ito et al. 2004, A
fingerprint matching algorithm using phase-only correlation (band limit, rotation search).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.geometry import gaussian_mean
from splitknit.model import Array, FloatArray
from splitknit_match.matching.elastic import Affine, rigid, spectrum_of
from splitknit_match.matching.ridge_band import RidgeBand
from splitknit_match.threads import made_once

Spectra = NDArray[np.complex64]

_ROTATION_STEP_DEG = 5.0  # step between two rotations whose directions of ridges are compared
_HALF_TURN = round(180 / _ROTATION_STEP_DEG)
"""Steps of half a turn. What is turned by half a turn more is the same upside down: its spectrum is
conjugate, and the peak of a correlation with it lies one pixel further on both axes. Source:
derived."""
_POSE_STEP_DEG = 4.0  # step between two rotations of a small print


@dataclass(frozen=True, slots=True)
class _Peak:
    """One alignment of A on B."""

    height: float
    angle_deg: float
    """A is turned by it about its centre, counter-clockwise."""
    right_mm: float
    """Then its centre lies so far right of B's centre."""
    down_mm: float

    def affine(self, a: RidgeBand, b: RidgeBand) -> Affine:
        """Position in B to position in A."""
        return rigid(a, b, float(np.deg2rad(self.angle_deg)), self.right_mm, self.down_mm)

    def near(self, peak: _Peak) -> bool:
        """Whether it is nearly the same alignment."""
        turn = abs((self.angle_deg - peak.angle_deg + 180) % 360 - 180)
        apart = np.hypot(self.right_mm - peak.right_mm, self.down_mm - peak.down_mm)
        # alignments of a small print at nearly one rotation lie at least so far apart
        return bool(turn <= 1.5 * _POSE_STEP_DEG and apart <= 0.6)


_COARSE_PITCH_MM = 0.15  # side of a pixel of the coarse grid
COARSE_GRID_PX = (216, 216)
"""Rows and columns of the coarse grid; of a finger that is larger the centre is used."""
BLOCKS = (27, 24)  # rows and columns of the grid of blocks


class CoarseViews:
    """A ridge band on the coarse grids, as spectra and pictures, each made when first used."""

    def __init__(self, band: RidgeBand) -> None:
        """Nothing is computed yet."""
        self.band = band
        self._ridges: dict[int, Spectra] = {}

    def ridges(self, number: int = 0) -> Spectra:
        """Ridges turned by `number` half steps (less half a turn), 190 kB each."""
        number %= 2 * _HALF_TURN
        if number not in self._ridges:
            self._ridges[number] = self._ridge_view(_angle_deg(number))
        return self._ridges[number]

    @made_once
    def poses(self) -> FloatArray:
        """(2, A, side, side) ridges and where there are any, turned by the steps of a small
        print."""
        side = int(np.ceil(np.hypot(*self.band.valid.shape) / self._step)) + 2
        angles = np.deg2rad(_POSE_STEP_DEG) * np.arange(round(360 / _POSE_STEP_DEG))
        return self._pictures(angles, (side, side))

    @made_once
    def upright(self) -> FloatArray:
        """(2, rows, columns) the same without rotation."""
        rows, columns = (int(np.ceil(side / self._step)) for side in self.band.valid.shape)
        return self._pictures(np.zeros(1), (rows, columns))[:, 0]

    @made_once
    def _soft(self) -> FloatArray:
        """The band with less of what the coarse grid cannot hold."""
        return gaussian_mean(self.band.value, 0.4 * _COARSE_PITCH_MM / self.band.pitch_mm)

    @property
    def _step(self) -> float:
        return _COARSE_PITCH_MM / self.band.pitch_mm

    def _pictures(self, angles_rad: Array, size: tuple[int, int]) -> FloatArray:
        pictures = self._soft, self.band.valid.astype(np.float32)
        return np.stack(
            [[_turned(part, angle, self._step, size) for angle in angles_rad] for part in pictures]
        )

    @made_once
    def directions(self) -> Spectra:
        """Spectra (3, A, rows, columns // 2 + 1) of blocks, turned by the steps of half a turn.

        Cosine and sine of the doubled directions, of length at most about one, and the fraction
        that is valid.
        """
        value, valid = self.band.value, self.band.valid
        across = cv2.Sobel(value, cv2.CV_32F, 1, 0)
        up = -cv2.Sobel(value, cv2.CV_32F, 0, 1)
        # side of the square over which a direction is averaged
        window = (round(1.05 / self.band.pitch_mm),) * 2
        xx, yy, xy, fraction = (
            cv2.blur(part, window, borderType=cv2.BORDER_CONSTANT)
            for part in (across * across, up * up, across * up, valid.astype(np.float32))
        )
        power = (xx + yy)[valid]
        middle = [(power.size - 1) // 2, power.size // 2]
        # the median: numpy's own loads numpy.ma, 20 ms
        typical = float(np.partition(power, middle)[middle].mean())
        total = np.maximum(xx + yy, max(0.3 * typical, 1e-12))
        field = np.stack([(xx - yy) / total, 2 * xy / total, fraction], axis=-1, dtype=np.float32)
        turned = np.empty((_HALF_TURN, *BLOCKS, 3), dtype=np.float32)
        for blocks, angle in zip(
            turned, np.deg2rad(_ROTATION_STEP_DEG * np.arange(_HALF_TURN, dtype=float)), strict=True
        ):
            cos, sin = np.cos(2 * angle), np.sin(2 * angle)
            # side of a block that has one direction
            view = _turned(field, angle, 1.5 / self.band.pitch_mm, BLOCKS)
            blocks[:] = cv2.transform(view, np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]))
        return spectrum_of(np.moveaxis(turned, -1, 0))

    def _ridge_view(self, angle_deg: float) -> Spectra:
        """Whitened spectrum (rows, columns // 2 + 1) of the band, turned; its centre is the grid's
        centre.

        Correlated with itself, it has a peak of 1.
        """
        spectrum = spectrum_of(
            _turned(self._soft, np.deg2rad(angle_deg), self._step, COARSE_GRID_PX)
        )
        magnitude = np.abs(spectrum)
        floor = max(0.05 * float(magnitude.max()), 1e-12)
        # power of the magnitude that each spectrum is divided by: 0 correlates, 1 keeps phase alone
        result = spectrum * (_ridge_pass() / np.maximum(magnitude, floor) ** 0.5)
        # twice the power of the half plane, but for its first column, where ridges have little
        power = 2 * float((np.abs(result) ** 2).sum())
        result *= np.float32(np.sqrt(COARSE_GRID_PX[0] * COARSE_GRID_PX[1] / max(power, 1e-30)))
        return result


_ROTATIONS = 6
"""Rotations that are tried on the ridges, each there and half a step on, to the side of the better
neighbour. Chosen on: real prints (FVC2002 DB1_B). Range: 6 to 8."""
_UPRIGHT_ROTATIONS = 3
"""Upright rotations that are tried in any case: most fingers lie upright, and where little
overlaps, directions alone find them too seldom."""
_UPRIGHT_STEPS = 6  # steps to each side of no rotation that count as upright
_CANDIDATES = 2
"""Peaks of a correlation that are looked at closely; 3 do as well."""
_MIN_HEIGHT = 0.7
"""Peaks lower than this fraction of the highest are not looked at. Chosen on: speed (2,024 pairs:
ten led to another score, by at most 0.04, and none changed a rate)."""


def likely_alignments(a: CoarseViews, b: CoarseViews) -> list[Affine]:
    """Best alignments of A on B, best first, at most one a rotation: by directions, then by
    correlation."""
    upright_b = b.directions[:, :1]
    products = a.directions.conj() * upright_b, a.directions * upright_b
    scores = np.concatenate([_direction_agreement(product) for product in products])
    upright = np.arange(-_UPRIGHT_STEPS, _UPRIGHT_STEPS + 1)
    best = np.concatenate(
        [
            np.argsort(-scores, kind="stable")[:_ROTATIONS],
            upright[np.argsort(-scores[upright], kind="stable")[:_UPRIGHT_ROTATIONS]] % len(scores),
        ]
    )
    better_side = np.where(np.roll(scores, -1)[best] >= np.roll(scores, 1)[best], 1, -1)
    half_steps = sorted(
        {*(2 * best).tolist(), *((2 * best + better_side) % (2 * len(scores))).tolist()}
    )
    peaks = sorted(
        (_peak(a, b.ridges(), number) for number in half_steps), key=lambda peak: -peak.height
    )
    return [
        peak.affine(a.band, b.band)
        for peak in peaks[:_CANDIDATES]
        if peak.height >= _MIN_HEIGHT * peaks[0].height
    ]


def _angle_deg(number: int) -> float:
    """Rotation of a number of half steps."""
    return number * _ROTATION_STEP_DEG / 2


def _peak(a: CoarseViews, ridges: Spectra, number: int) -> _Peak:
    """Largest correlation of A, turned by `number` half steps, with B's spectrum."""
    upside_down = number >= 2 * _HALF_TURN
    product = a.ridges(number) * (ridges if upside_down else ridges.conj())
    correlation = np.fft.irfft2(product, s=COARSE_GRID_PX)
    place = np.array(np.unravel_index(correlation.argmax(), COARSE_GRID_PX))
    # of what is not upside down the spectrum is conjugate: its correlation is mirrored
    centre = np.array(COARSE_GRID_PX) // 2
    down, right = ((place + 1 if upside_down else -place) + centre) % COARSE_GRID_PX - centre
    return _Peak(
        float(correlation.max()),
        _angle_deg(number),
        float(right * _COARSE_PITCH_MM),
        float(down * _COARSE_PITCH_MM),
    )


def _direction_agreement(products: Spectra) -> FloatArray:
    """(A,) largest agreement of directions over all shifts, over the root of the overlap; from (3,
    A, ...)."""
    agreement, overlap = np.fft.irfft2(np.stack([products[0] + products[1], products[2]]), s=BLOCKS)
    overlap = np.maximum(overlap, 0.2 * overlap.max())
    return np.asarray((agreement / np.sqrt(overlap)).reshape(len(overlap), -1).max(axis=1))


POSES = 8  # alignments of a small print that are looked at closely
_OVERLAP_ROTATIONS = 3
"""Rotations for which the overlap of a small print is computed once. Chosen on: speed."""


def every_pose(a: CoarseViews, b: CoarseViews) -> list[Affine]:
    """Alignments of a small B on A: every rotation and shift, by correlation over the root of the
    overlap."""
    poses, still = b.poses, a.upright
    size = (
        cv2.getOptimalDFTSize(poses.shape[2] + still.shape[1]),
        cv2.getOptimalDFTSize(poses.shape[3] + still.shape[2]),
    )
    target = spectrum_of(still, size).conj()
    # both grids have their centres at (side - 1) / 2: where the centres fall together is not a
    # shift
    offset = (np.array(still.shape[1:]) - poses.shape[2:]) / 2
    scale = (size[0] * size[1]) ** 0.5

    def correlation(kind: int, number: int) -> FloatArray:
        product = spectrum_of(poses[kind, number], size) * target[kind]
        return np.asarray(scale * np.fft.irfft2(product, s=size, norm="ortho"))

    peaks = []
    for number in range(poses.shape[1]):
        if number % _OVERLAP_ROTATIONS == 0:
            # a smaller overlap of a small print counts as if it were this large
            root = np.sqrt(np.maximum(correlation(1, number), 6.0 / _COARSE_PITCH_MM**2))
        height = correlation(0, number) / root
        for _ in range(2):
            row, column = np.unravel_index(height.argmax(), size)
            place = np.array([row, column])
            # shifts of B's grid beyond its own size lie to the left and above
            place = np.where(place >= poses.shape[2:], place - size, place)
            down, right = (place + offset) * _COARSE_PITCH_MM
            peaks.append(
                _Peak(
                    float(height[row, column]), number * _POSE_STEP_DEG, -float(right), -float(down)
                )
            )
            height[max(0, row - 2) : row + 3, max(0, column - 2) : column + 3] = -np.inf
    kept: list[_Peak] = []
    for peak in sorted(peaks, key=lambda peak: -peak.height):
        if not any(peak.near(better) for better in kept):
            kept.append(peak)
        if len(kept) == POSES:
            break
    return [inverse(peak.affine(b.band, a.band)) for peak in kept]


def inverse(affine: Affine) -> Affine:
    """The same map the other way round."""
    back = np.linalg.inv(affine[:, :2])
    return np.hstack([back, -(back @ affine[:, 2])[:, None]])


def _turned(
    picture: FloatArray, angle_rad: float, step_px: float, size: tuple[int, int]
) -> FloatArray:
    """`picture`, turned counter-clockwise about its centre, on a grid of `size` whose steps are
    `step_px`."""
    # the content turns counter-clockwise as seen (rows run down): fetch from the clockwise place
    cos, sin = step_px * np.cos(angle_rad), step_px * np.sin(angle_rad)
    x, y = (size[1] - 1) / 2, (size[0] - 1) / 2
    source = np.array(
        [
            [cos, -sin, (picture.shape[1] - 1) / 2 - cos * x + sin * y],
            [sin, cos, (picture.shape[0] - 1) / 2 - sin * x - cos * y],
        ]
    )
    return np.asarray(
        cv2.warpAffine(picture, source, size[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    )


_CYCLES_PER_MM = (1.2, min(3.8, 0.5 / _COARSE_PITCH_MM))
"""Frequencies of ridges: periods of 0.3 (the grid's finest) to 0.83 mm."""


@cache
def _ridge_pass() -> FloatArray:
    """(rows, columns // 2 + 1) 1 at the frequencies of ridges, 0 elsewhere."""
    down = np.fft.fftfreq(COARSE_GRID_PX[0], _COARSE_PITCH_MM)[:, None]
    cycles = np.hypot(down, np.fft.rfftfreq(COARSE_GRID_PX[1], _COARSE_PITCH_MM))
    return np.asarray((cycles > _CYCLES_PER_MM[0]) & (cycles < _CYCLES_PER_MM[1]), dtype=np.float32)
