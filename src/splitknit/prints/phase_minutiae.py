"""Minutiae as the points about which the phase of the ridges turns.

Where a ridge ends or forks, one side of the point has one ridge more than the other: going once around it, the phase of
the ridges' wave grows or falls by 2 pi. No thinning, no tracing; needs no package beyond numpy and OpenCV.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.geometry import sampled_at
from splitknit.matching.minutiae_record import Minutiae
from splitknit.model import FloatArray
from splitknit.prints.enhance import Enhanced

Array = NDArray[np.float64]
ENDING, BIFURCATION = 1, 2
_CORNERS = ((1, 0), (1, 1), (0, 1), (0, 0))
"""Of a square of pixels, row and column, counter-clockwise as seen."""

_EDGE_MM = 0.6
"""Nearer to the print's outline none is taken: every ridge ends there."""
_SURE = 0.25
"""Confidence of ridges that do not lower the quality of minutiae."""
_MIN_QUALITY = 70
"""Minutiae of less quality are left out."""


@dataclass(frozen=True, slots=True, eq=False)
class _PhaseMinutiae:
    """N minutiae of a print."""

    place_px: Array
    """(N, 2) column and row, 0 at the middle of the first pixel."""
    direction_rad: Array
    """(N,) in [0, 2 pi), counter-clockwise from the right: towards the side that has one more ridge."""
    kind: NDArray[np.uint8]
    """(N,) 1 ridge ending, 2 bifurcation."""
    quality: NDArray[np.uint8]
    """(N,) 0 to 100: how well the print about it follows the wave, and how sure its ridges are."""


def phase_minutiae(
    image: NDArray[np.uint8], enhanced: Enhanced, ppi: float = 500.0, confidence: FloatArray | None = None
) -> _PhaseMinutiae:
    """Find the minutiae of a print whose enhancement is at hand.

    The wave `w` of the ridges has the phase `atan2(-dw/dn / k, w)`, `n` across the ridges and `k` their wave number. It
    is known up to its sign, which is made the same around each square of four pixels; where it turns by 2 pi around
    one, a ridge more begins there. `image`: (h, w) uint8, ridges dark; `enhanced`: of the same print; `confidence`: (h,
    w) 0 to 1, how sure the ridges are: the quality of minutiae is lowered where that is below a quarter. They come by
    rows, then columns. Raises BadInput if the print and its enhancement have different sizes.

    Source: K. Larkin and P. Fletcher, "A coherent framework for fingerprint analysis: are fingerprints holograms?",
    Optics Express 15, 2007.
    """
    require(
        image.shape == enhanced.wave.shape,
        f"the print has {image.shape} pixels, but its enhancement {enhanced.wave.shape}; give those of one print.",
    )
    ridges = -enhanced.wave.astype(np.float64)  # positive on ridges
    along, wave_number = _field(enhanced)
    turns = _turns(ridges, along, wave_number)
    rows, columns = np.nonzero(np.abs(turns) > 0.5)
    place = np.stack([columns + 0.5, rows + 0.5], axis=1)
    inside = np.pad(enhanced.mask.astype(np.uint8), 1)  # beyond the picture is no print
    distance = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1] * (25.4 / ppi)
    like = np.clip(_likeness(image, ridges)[rows, columns], 0, 1)
    if confidence is not None:
        like = like * np.sqrt(np.minimum(confidence[rows, columns] / np.float32(_SURE), 1))
    quality = np.round(100 * like).astype(np.uint8)
    kept = (distance[rows, columns] >= _EDGE_MM) & (quality >= _MIN_QUALITY)
    rows, columns, place, quality = rows[kept], columns[kept], place[kept], quality[kept]
    towards = along[rows, columns] + np.where(turns[rows, columns] > 0, 0.0, np.pi)
    kind = _kinds(ridges, place, towards, wave_number[rows, columns])
    return _PhaseMinutiae(place, np.asarray(towards % (2 * np.pi)), kind, quality)


def by_phase(
    image: NDArray[np.uint8], enhanced: Enhanced, ppi: float = 500.0, confidence: FloatArray | None = None
) -> Minutiae:
    """Minutiae of a print by :func:`phase_minutiae`, on the grid of 500 ppi as mindtct's."""
    found = phase_minutiae(image, enhanced, ppi, confidence)
    scale = 500.0 / ppi
    place = np.rint((found.place_px + 0.5) * scale - 0.5).astype(np.int32)
    size = max(1, round(image.shape[0] * scale)), max(1, round(image.shape[1] * scale))
    column, row = (np.clip(place[:, k], 0, size[1 - k] - 1) for k in (0, 1))
    return Minutiae(column, row, found.direction_rad, found.kind, found.quality, size)


def _field(enhanced: Enhanced) -> tuple[Array, Array]:
    """(h, w) direction along the ridges, counter-clockwise, and wave number in radians a pixel."""
    field, (rows, columns) = enhanced.field, enhanced.wave.shape
    size = field.mask.shape[1] * field.step_px, field.mask.shape[0] * field.step_px
    parts = (
        np.cos(2 * field.orientation_rad),
        np.sin(2 * field.orientation_rad),
        np.where(field.mask, field.frequency_px, np.median(field.frequency_px[field.mask])),
    )
    cosine, sine, frequency = (
        cv2.resize(part.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)[:rows, :columns] for part in parts
    )
    return np.asarray(0.5 * np.arctan2(sine, cosine), dtype=np.float64), 2 * np.pi * frequency.astype(np.float64)


def _turns(ridges: Array, along: Array, wave_number: Array) -> Array:
    """(h - 1, w - 1) turns of the phase, counter-clockwise around each square of four pixels: -1, 0 or 1."""
    down, right = np.gradient(ridges)
    across = np.stack([-np.sin(along), np.cos(along)])  # a quarter turn on from the ridges: right, up
    quadrature = -(right * across[0] - down * across[1]) / wave_number
    height, width = ridges.shape

    def corner(values: Array, which: tuple[int, int]) -> Array:
        row, column = which
        return values[..., row : height - 1 + row, column : width - 1 + column]

    first = corner(across, _CORNERS[0])
    phases = []
    for which in _CORNERS:
        same = np.sign((corner(across, which) * first).sum(axis=0))
        phases.append(np.arctan2(np.where(same < 0, -1.0, 1.0) * corner(quadrature, which), corner(ridges, which)))
    total = np.zeros((height - 1, width - 1))
    for k in range(4):
        step = phases[(k + 1) % 4] - phases[k]
        total += step - 2 * np.pi * np.round(step / (2 * np.pi))
    return np.asarray(np.round(total / (2 * np.pi)))


def _kinds(ridges: Array, place: Array, towards: Array, wave_number: Array) -> NDArray[np.uint8]:
    """A ridge ends where the side with one more has a ridge ahead, it forks where that has a valley."""
    ahead = 0.5 * 2 * np.pi / wave_number
    column, row = place[:, 0] + ahead * np.cos(towards), place[:, 1] - ahead * np.sin(towards)
    ending = sampled_at(ridges.astype(np.float32), column, row, outside=0.0) > 0
    return np.asarray(np.where(ending, ENDING, BIFURCATION), dtype=np.uint8)


def _likeness(image: NDArray[np.uint8], ridges: Array, sigma_px: float = 4.0) -> FloatArray:
    """(h, w) correlation of print and wave, about every pixel."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
    ink = cv2.GaussianBlur(smooth, (0, 0), 2.5 * sigma_px) - smooth
    wave = ridges.astype(np.float32)
    both, own, other = (cv2.GaussianBlur(part, (0, 0), sigma_px) for part in (ink * wave, wave * wave, ink * ink))
    return np.asarray(both / np.sqrt(own * other + np.float32(1e-6)), dtype=np.float32)
