"""Minutiae as the points about which the phase of the ridges turns.

Where a ridge ends or forks, one side of the point has one ridge more than the other: going once
around it, the phase of the ridges' wave grows or falls by 2 pi. No thinning, no tracing; needs no
package beyond numpy and OpenCV.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.geometry import sampled_at
from splitknit.model import Array, FloatArray, GreyArray
from splitknit_match.prints.enhance import Enhanced
from splitknit_match.prints.ridge_field import outline_distance_mm
from splitknit_match.records.minutiae_record import BIFURCATION, ENDING, Minutiae

_CORNERS = ((1, 0), (1, 1), (0, 1), (0, 0))
"""Corners of a square of pixels, row and column, counter-clockwise as displayed. Source:
definition."""
PHASE_EDGE_MM = 0.6  # nearer to the print's outline no minutia is taken: every ridge ends there
WAVE_LIKENESS = 0.7  # minutiae about which the print follows the wave less are left out


def by_phase(
    image: GreyArray, enhanced: Enhanced, ppi: float = 500.0, confidence: FloatArray | None = None
) -> Minutiae:
    """Find the minutiae of a print whose enhancement is at hand, on the grid of 500 ppi as
    mindtct's.

    The wave `w` of the ridges has the phase `atan2(-dw/dn / k, w)`, `n` across the ridges and `k`
    their wave number. It is known up to its sign, which is made the same around each square of four
    pixels; where it turns by 2 pi around one, a ridge more begins there, in whose direction the
    minutia points. Its quality is the probability in % that another print of the finger, where it
    shows the place, has the minutia too: it rises with how well the print follows the wave about
    it, and with the distances to the outline and to the nearest opposite minutia.

    `image`: (h, w) uint8, ridges dark; `enhanced`: of the same print; `confidence`: (h, w) 0 to 1,
    how sure the ridges are: below a quarter it lowers the likeness. They come by rows, then
    columns. Raises BadInput if the print and its enhancement have different sizes.

    Source: K. Larkin and P. Fletcher, "A coherent framework for fingerprint analysis: are
    fingerprints holograms?", Optics Express 15, 2007.
    """
    ridges = -enhanced.wave.astype(float)  # positive on ridges
    along, wave_number = _field(enhanced)
    turns, waves = _turns(ridges, along, wave_number)
    rows, columns = np.nonzero(np.abs(turns) > 0.5)
    distance = outline_distance_mm(enhanced.mask, ppi)[rows, columns]
    like = np.clip(_likeness(image, ridges)[rows, columns], 0, 1)
    if confidence is not None:
        # ridges of a lower confidence lower the quality of minutiae
        like = like * np.sqrt(np.minimum(confidence[rows, columns] / 0.25, 1))
    kept = (distance >= PHASE_EDGE_MM) & (np.round(100 * like) >= 100 * WAVE_LIKENESS)
    rows = rows[kept]
    columns = columns[kept]
    zeros = _zeros(np.stack([wave[rows, columns] for wave in waves]))
    place = np.stack([columns + 0.5, rows + 0.5], axis=1) + zeros
    towards = along[rows, columns] + np.where(turns[rows, columns] > 0, 0.0, np.pi)
    kind = _kinds(ridges, place, towards, wave_number[rows, columns])
    terms = _terms(like[kept], distance[kept], place * (25.4 / ppi), towards)
    quality = np.round(100 / (1 + np.exp(-terms @ np.array(_AGAIN)))).astype(np.uint8)
    scale = 500.0 / ppi
    size = max(1, round(image.shape[0] * scale)), max(1, round(image.shape[1] * scale))
    pixel = np.rint((place + 0.5) * scale - 0.5).astype(np.int32)
    column, row = np.clip(pixel, 0, np.array(size[::-1]) - 1).T
    return Minutiae(column, row, towards % (2 * np.pi), kind, quality, size)


_APART_MM = 2.0  # the distance to the nearest opposite minutia adds nothing beyond this
_AGAIN = (-1.824, -0.332, 0.531, 0.814)
"""Logistic regression behind the quality of a minutia: offset, and weights of the logarithm of what
is missing to full likeness, of the distance to the outline, and of that to the nearest opposite
minutia. Chosen on: real prints (30 fingers of six sensors, validation/records/quality.py)."""


def _terms(like: FloatArray, edge_mm: FloatArray, place_mm: Array, towards: Array) -> Array:
    """(N, 4) terms of the regression for each minutia."""
    apart = np.full(len(like), _APART_MM)
    for k, (place, turn) in enumerate(zip(place_mm, towards, strict=True)):
        # those that differ in direction by more than 120 deg
        opposite = place_mm[np.cos(towards - turn) < -0.5]
        apart[k] = min([_APART_MM, *np.hypot(*(opposite - place).T)])
    # closer to full likeness, or more than 4 mm from the outline, nothing is added
    missing = np.log(np.maximum(1 - like.astype(float), 0.003))
    return np.stack([np.ones(len(like)), missing, np.minimum(edge_mm, 4.0), apart], axis=1)


def _field(enhanced: Enhanced) -> tuple[Array, Array]:
    """(h, w) direction along the ridges, counter-clockwise, and wave number in radians a pixel."""
    field = enhanced.field
    rows, columns = enhanced.wave.shape
    typical = np.median(field.frequency_px[field.mask])
    frequency = np.where(field.mask, field.frequency_px, typical)
    parts = np.dstack(
        [np.cos(2 * field.orientation_rad), np.sin(2 * field.orientation_rad), frequency]
    )
    size = field.mask.shape[1] * field.step_px, field.mask.shape[0] * field.step_px
    fine = cv2.resize(parts.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)[
        :rows, :columns
    ]
    cosine, sine, frequency = cv2.split(fine)
    return 0.5 * np.arctan2(sine, cosine).astype(float), 2 * np.pi * frequency.astype(float)


def _turns(ridges: Array, along: Array, wave_number: Array) -> tuple[Array, list[Any]]:
    """(h - 1, w - 1) turns of the phase, counter-clockwise around each square of four pixels: -1, 0
    or 1.

    And the wave at each of the four corners, (h - 1, w - 1) complex, imaginary a quarter turn on.
    """
    down, right = np.gradient(ridges)
    # a quarter turn on from the ridges: right, up
    across = np.stack([-np.sin(along), np.cos(along)])
    quadrature = -(right * across[0] - down * across[1]) / wave_number
    height, width = ridges.shape

    def corner(values: Array, row: int, column: int) -> Array:
        return values[..., row : height - 1 + row, column : width - 1 + column]

    first = corner(across, *_CORNERS[0])
    waves = []
    for place in _CORNERS:
        opposite = (corner(across, *place) * first).sum(axis=0) < 0
        turned = np.where(opposite, -1.0, 1.0) * corner(quadrature, *place)
        waves.append(corner(ridges, *place) + 1j * turned)
    following = [*waves[1:], waves[0]]
    steps = [np.angle(b * a.conj()) for a, b in zip(waves, following, strict=True)]
    return np.round(np.sum(steps, axis=0) / (2 * np.pi)), waves


def _zeros(values: NDArray[np.complex128]) -> Array:
    """(N, 2) how far right and down of a square's middle its wave vanishes, fitted by a plane to
    the four corners (4, N)."""
    down, right = (np.array(_CORNERS) - 0.5).T @ values
    middle = values.mean(axis=0)
    determinant = (right * down.conj()).imag
    flat = np.abs(determinant) < 1e-12  # no direction in which both grow
    offset = np.stack([-(middle * down.conj()).imag, (middle * right.conj()).imag], axis=1)
    offset /= np.where(flat, 1.0, determinant)[:, None]
    return np.where(flat[:, None], 0.0, np.clip(offset, -0.5, 0.5))


def _kinds(ridges: Array, place: Array, towards: Array, wave_number: Array) -> GreyArray:
    """A ridge ends where the side with one more has a ridge ahead, it forks where that has a
    valley."""
    ahead = 0.5 * 2 * np.pi / wave_number
    column, row = place[:, 0] + ahead * np.cos(towards), place[:, 1] - ahead * np.sin(towards)
    ending = sampled_at(ridges.astype(np.float32), column, row, outside=0.0) > 0
    return np.where(ending, ENDING, BIFURCATION).astype(np.uint8)


def _likeness(image: GreyArray, ridges: Array, sigma_px: float = 4.0) -> FloatArray:
    """(h, w) correlation of print and wave, about every pixel."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
    ink = cv2.GaussianBlur(smooth, (0, 0), 2.5 * sigma_px) - smooth
    wave = ridges.astype(np.float32)
    both, of_wave, of_ink = (
        cv2.GaussianBlur(part, (0, 0), sigma_px) for part in (ink * wave, wave * wave, ink * ink)
    )
    return np.asarray(both / np.sqrt(of_wave * of_ink + 1e-6))
