"""Coarse alignment of two ridge bands: phase correlation over shift, one rotation after another.

Rotations are first ranked by how well the directions of the ridges agree (a small complex field, two angles for one
direction); the best few are then tried on the ridges themselves, whitened within their band, so that the peak is where
ridges, not borders or contrast, agree. The rotated views of one side are made once and serve any number of comparisons.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from splitknit.matching.ridge_band import blur
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits

Spectra = NDArray[np.complex64]


_STEP_DEG = 2.5
"""Between two rotations."""
_ROTATIONS = 6
"""How many are tried on the ridges, after a ranking by their directions."""
_PITCH_MM = 0.15
"""Side of a pixel of the coarse grid."""
_PLANE_PX = (270, 243)
"""Rows and columns of the coarse grid; of a finger that is larger the middle is used."""
_BLOCK_PX = 7
"""Pixels of the coarse grid, each way, that share one direction."""
_CANDIDATES = 2
"""Peaks that are looked at closely."""


@dataclass(frozen=True, slots=True)
class PhaseSettings(Checked):
    """The coarse search."""

    limit_deg: Annotated[float, Limits(0, 45)] = 30.0
    """Largest rotation tried."""
    whitening: Annotated[float, Limits(0, 1)] = 0.5
    """Power of the magnitude that each spectrum is divided by: 0 correlates, 1 keeps phase alone."""

    def angles_deg(self) -> NDArray[np.float64]:
        """Rotations tried, zero among them."""
        count = int(np.floor(self.limit_deg / _STEP_DEG + 1e-9))
        return _STEP_DEG * np.arange(-count, count + 1, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Peak:
    """One alignment of A on B."""

    angle_deg: float
    """A is turned by it about its middle, counter-clockwise."""
    right_mm: float
    """Then its middle lies so far right of B's middle."""
    down_mm: float
    height: float
    """Of the correlation, relative to complete agreement."""


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """One finger under some rotations, as spectra."""

    ridges: Spectra
    """(A, rows, columns // 2 + 1) whitened; correlated with itself, one has a peak of 1."""
    directions: Spectra
    """(A, blocks down, blocks across) of the field of doubled directions."""


def views(value: FloatArray, pitch_mm: float, angles_deg: NDArray[np.float64], settings: PhaseSettings) -> Views:
    """Spectra of a ridge band (H, W) for some rotations (A,); its middle is brought to the grid's middle."""
    plane = _PLANE_PX
    factor = _PITCH_MM / pitch_mm
    soft = blur(value, 0.4 * factor)  # less of what the coarse grid cannot hold
    centre = (value.shape[1] - 1) / 2, (value.shape[0] - 1) / 2
    middle = (plane[1] - 1) / 2, (plane[0] - 1) / 2
    turned = np.empty((len(angles_deg), *plane), dtype=np.float32)
    for k, angle in enumerate(np.deg2rad(angles_deg)):
        cos, sin = factor * np.cos(angle), factor * np.sin(angle)
        # the content turns counter-clockwise as seen (rows run down): fetch from the clockwise place
        source = np.array(
            [
                [cos, -sin, centre[0] - cos * middle[0] + sin * middle[1]],
                [sin, cos, centre[1] - sin * middle[0] - cos * middle[1]],
            ]
        )
        turned[k] = cv2.warpAffine(soft, source, plane[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    directions = np.stack([_directions(picture, _BLOCK_PX) for picture in turned])
    return Views(_whitened(scipy.fft.rfft2(turned), settings), np.asarray(scipy.fft.fft2(directions)))


def peaks(rotated: Views, fixed: Views, settings: PhaseSettings) -> list[Peak]:
    """Best alignments, best first, at most one a rotation.

    Parameters
    ----------
    rotated : A, once for each of `settings.angles_deg()`
    fixed : B, once
    """
    angles = settings.angles_deg()
    agreement = scipy.fft.ifft2(rotated.directions.conj() * fixed.directions).real
    ranked = np.argsort(-agreement.reshape(len(angles), -1).max(axis=1), kind="stable")[:_ROTATIONS]
    rows, columns = _PLANE_PX
    correlation = scipy.fft.irfft2(rotated.ridges[ranked].conj() * fixed.ridges, s=_PLANE_PX)
    places = correlation.reshape(len(ranked), -1).argmax(axis=1)
    found = []
    for picture, place, angle in zip(correlation, places.tolist(), angles[ranked].tolist(), strict=True):
        row, column = divmod(place, columns)
        down = row if row <= rows // 2 else row - rows
        right = column if column <= columns // 2 else column - columns
        height = float(picture[row, column])
        found.append(Peak(angle, right * _PITCH_MM, down * _PITCH_MM, height))
    found.sort(key=lambda peak: -peak.height)
    return found[:_CANDIDATES]


def _whitened(spectrum: Spectra, settings: PhaseSettings) -> Spectra:
    plane, pitch = _PLANE_PX, _PITCH_MM
    cycles = np.hypot(np.fft.fftfreq(plane[0], pitch)[:, None], np.fft.rfftfreq(plane[1], pitch)[None, :])
    ridges = ((cycles > 1.2) & (cycles < min(3.8, 0.5 / pitch))).astype(np.float32)  # periods of 0.26 to 0.83 mm
    size = np.abs(spectrum)
    floor = np.maximum(0.05 * size.max(axis=(1, 2), keepdims=True), np.float32(1e-12))
    result = spectrum * (ridges / np.maximum(size, floor) ** settings.whitening)
    # twice the power of the half plane, but for its first column, where ridges have little
    power = 2 * (np.abs(result) ** 2).sum(axis=(1, 2), keepdims=True)
    result *= np.sqrt(plane[0] * plane[1] / np.maximum(power, 1e-30)).astype(np.float32)
    return np.asarray(result, dtype=np.complex64)


def _directions(picture: FloatArray, block: int) -> Spectra:
    """Doubled directions, as complex numbers of length at most about one, of blocks of `picture`."""
    across = cv2.Sobel(picture, cv2.CV_32F, 1, 0)
    up = -cv2.Sobel(picture, cv2.CV_32F, 0, 1)
    size = picture.shape[1] // block, picture.shape[0] // block
    cut = slice(0, size[1] * block), slice(0, size[0] * block)

    def mean(part: FloatArray) -> FloatArray:
        return np.asarray(cv2.resize(np.ascontiguousarray(part[cut]), size, interpolation=cv2.INTER_AREA))

    xx, yy, xy = mean(across * across), mean(up * up), mean(across * up)
    total = xx + yy
    inside = total > 0
    typical = float(np.median(total[inside])) if bool(inside.any()) else 1.0
    return np.asarray((xx - yy + 2j * xy) / np.maximum(total, 0.3 * typical), dtype=np.complex64)


def band_of(value: FloatArray, valid: BoolArray) -> FloatArray:
    """Ridge band with the steps of its levels smoothed away, zero outside."""
    return np.where(valid, blur(value, 0.6), np.float32(0.0)).astype(np.float32)
