"""Enhancement of prints by Gabor filters that follow the ridges.

At every node (a few pixels apart) one complex Gabor coefficient is computed with the node's own direction and
frequency: no filter bank, nothing quantised. Between nodes the print is the mean of the four plane waves around,
weighted bilinearly. That is what filtering every pixel with its own filter gives (a test compares), at a fraction of
the work: the demodulated ridges are smooth over a filter's width.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray
from splitknit_match.prints.ridge_field import RidgeField, overlap_added, ridge_field

_SIGMA_PERIODS = 0.5
"""Standard deviation of a Gabor filter, in local ridge periods."""
_CONTRAST = 2.0
"""Steepness of the grey curve; 0.5 is soft, 3 is nearly black and white."""
_FLOOR = 0.15
"""Ridges weaker than this fraction of the print's median are not raised further."""
_NO_RIDGES = "the print has no ridges; check focus and light of the capture."


@dataclass(frozen=True, slots=True, eq=False)
class Enhanced:
    """An enhanced print."""

    image: NDArray[np.uint8]
    """(h, w) ridges dark, background white."""
    wave: FloatArray
    """(h, w) the ridges as a wave about zero, negative on ridges, about one in amplitude; 0 outside the mask."""
    mask: BoolArray
    """(h, w) where there are ridges."""
    field: RidgeField


def gabor_enhance(image: NDArray[np.uint8], ppi: float = 500.0, inside: BoolArray | None = None) -> Enhanced:
    """Enhance a print (h, w) uint8, ridges dark; nothing is printed beside `inside` (h, w), where that is known.

    Raises BadInput if the image is of another kind, or has no ridges. Source: L. Hong, Y. Wan and A. Jain 1998,
    Fingerprint image enhancement: algorithm and performance evaluation, section 2.6.
    """
    found = ridge_field(image, ppi, inside)
    coefficients = node_amplitudes(image, found, _SIGMA_PERIODS)
    amplitude = np.abs(coefficients)
    around = np.asarray(cv2.GaussianBlur(amplitude, (0, 0), 2.5), dtype=np.float32)
    typical = float(np.median(around[found.mask]))
    require(typical > 0.05, _NO_RIDGES)
    coefficients = (coefficients / np.maximum(around, np.float32(_FLOOR * typical))).astype(np.complex64)
    found = replace(found, mask=found.mask & (around > np.float32(_FLOOR * typical)))
    require(bool(found.mask.any()), _NO_RIDGES)
    wave = _plane_waves(coefficients, found, image.shape[:2])
    return _finished(wave, found, inside)


def _finished(wave: FloatArray, found: RidgeField, inside: BoolArray | None = None) -> Enhanced:
    """Grey values of a wave inside the print's mask, and `inside` where that is given."""
    shape = wave.shape[0], wave.shape[1]
    step = found.step_px
    large = (found.mask.shape[1] * step, found.mask.shape[0] * step)
    smooth = cv2.GaussianBlur(found.mask.astype(np.float32), (0, 0), 1.5, borderType=cv2.BORDER_REPLICATE)
    soft = cv2.resize(smooth, large, interpolation=cv2.INTER_LINEAR)[: shape[0], : shape[1]]
    if inside is not None:
        soft = soft * cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 1.0)
    mask = soft > 0.5
    grey = 0.5 - 0.5 * np.tanh(_CONTRAST * wave)  # dark = 1 on ridges
    image = np.round(255.0 * (1.0 - grey * np.clip(4.0 * soft - 1.5, 0.0, 1.0))).astype(np.uint8)
    return Enhanced(image, np.where(mask, wave, 0.0).astype(np.float32), mask, found)


def _wave_vectors(found: RidgeField) -> tuple[FloatArray, FloatArray]:
    """Radians per column and per row, across the ridges."""
    across = found.orientation_rad - (np.pi / 2)
    turn = np.float32(2 * np.pi) * found.frequency_px
    return turn * np.cos(across), -turn * np.sin(across)  # rows run downwards


def node_amplitudes(
    image: NDArray[np.uint8] | FloatArray, found: RidgeField, sigma_periods: float
) -> NDArray[np.complex64]:
    """Fit one plane wave, with a node's own direction and frequency, at every node of an image (h, w).

    Returns (n, m) complex64: amplitude and phase at the node, in the image's unit; zero outside the field's mask.
    `sigma_periods`: standard deviation of the window in which a wave is fitted, in local ridge periods.
    """
    step, (n, m) = found.step_px, found.mask.shape
    frequency = found.frequency_px[found.mask]
    sigma = np.float32(sigma_periods) / frequency
    reach = int(np.ceil(2.5 * float(np.percentile(sigma, 90))))
    middle = 0.5 * (step - 1)  # of a node's cell
    offset = np.arange(-reach, reach + 2 if step % 2 == 0 else reach + 1, dtype=np.float32)
    offset = offset - np.float32(middle - int(middle))
    size = offset.size
    first = reach - int(middle)
    padded = cv2.copyMakeBorder(
        image, first, n * step + size - image.shape[0], first, m * step + size - image.shape[1], cv2.BORDER_REFLECT
    ).astype(np.float32)
    windows = sliding_window_view(padded, (size, size))[::step, ::step][:n, :m]
    kx, ky = (part[found.mask] for part in _wave_vectors(found))
    rows, columns = np.nonzero(found.mask)
    result = np.zeros((n, m), dtype=np.complex64)

    def work(part: slice) -> None:
        patch = windows[rows[part], columns[part]]
        envelope = np.exp(-0.5 * (offset / sigma[part, None]) ** 2)
        across, down = kx[part, None] * offset, ky[part, None] * offset
        # real arithmetic twice is faster than complex: patch (N, s, s) times (N, s, 2), then times (N, s)
        wave = np.stack([envelope * np.cos(across), -envelope * np.sin(across)], axis=2)
        plain = envelope / envelope.sum(axis=1, keepdims=True)
        mean = np.einsum("nis,ni->ns", np.matmul(patch, plain[..., None]), plain)  # takes out the local mean
        along = np.matmul(patch, wave)
        along = along - mean[:, None] * wave.sum(axis=1)[:, None]
        cos, sin = envelope * np.cos(down), -envelope * np.sin(down)
        real = np.einsum("ni,ni->n", along[..., 0], cos) - np.einsum("ni,ni->n", along[..., 1], sin)
        imaginary = np.einsum("ni,ni->n", along[..., 0], sin) + np.einsum("ni,ni->n", along[..., 1], cos)
        norm = np.float32(2.0) / envelope.sum(axis=1) ** 2
        result[rows[part], columns[part]] = (real + 1j * imaginary) * norm

    chunks = [slice(k, k + 1024) for k in range(0, rows.size, 1024)]
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(work, chunks))
    return result


def _plane_waves(coefficients: NDArray[np.complex64], found: RidgeField, shape: tuple[int, ...]) -> FloatArray:
    """Bilinear mean of the plane waves of the four nodes around every pixel (h, w)."""
    step = found.step_px
    # a node's wave covers the two cells beside it along each axis
    offset = np.arange(2 * step, dtype=np.float32) - np.float32(step - 0.5)
    tent = np.float32(1.0) - np.abs(offset) / np.float32(step)
    kx, ky = _wave_vectors(found)
    kx, ky = np.where(found.mask, kx, 0.0), np.where(found.mask, ky, 0.0)
    x = (tent * np.exp(1j * kx[..., None] * offset)).astype(np.complex64)
    y = (tent * np.exp(1j * ky[..., None] * offset)).astype(np.complex64) * coefficients[..., None]
    # real part of the outer product, (n, 2 s, m, 2 s)
    tiles = np.einsum("nmi,nmj->nimj", y.real, x.real) - np.einsum("nmi,nmj->nimj", y.imag, x.imag)
    wave = overlap_added(tiles.transpose(0, 2, 1, 3), step)
    start = step - step // 2
    return wave[start : start + shape[0], start : start + shape[1]]


# Ridges as black and white, and as lines one pixel wide.


def ridge_mask(enhanced: Enhanced, min_px: int = 12) -> BoolArray:
    """(h, w) bool, true on ridges: where the wave is negative; specks and holes below `min_px` pixels are dropped."""
    ridges = enhanced.mask & (enhanced.wave < 0)
    ridges &= ~_small(ridges, min_px)
    return np.asarray(ridges | (_small(~ridges, min_px) & enhanced.mask))


def as_print(ridges: BoolArray) -> NDArray[np.uint8]:
    """(h, w) uint8: ridges 0, all else 255."""
    return np.where(ridges, np.uint8(0), np.uint8(255))


def thin(shape: BoolArray) -> BoolArray:
    """Thin a shape to lines one pixel wide that hang together as it does.

    Raises BadInput if `shape` is not a boolean image.

    `shape`: (h, w) bool.

    Source: T. Zhang and C. Suen 1984, A fast parallel algorithm for thinning digital patterns. Pixels are looked up by
    the code of their eight neighbours; at the end corners of staircases are taken off, so that lines are one pixel
    wide.
    """
    array = np.asarray(shape)
    if array.ndim != 2 or array.dtype != np.bool_:
        raise BadInput(f"what is thinned must be a boolean image (h, w), but it is {array.shape} {array.dtype}.")
    image = np.pad(array, 1).astype(np.uint8)
    first, second, corners = _tables()
    while True:
        before = int(image.sum())
        for table in (first, second):
            image &= table[_codes(image)]
        if int(image.sum()) == before:
            break
    for table in corners:  # one after the other: neighbours of one kind never touch
        image &= table[_codes(image)]
    return image[1:-1, 1:-1] > 0


def _small(shape: BoolArray, min_px: int) -> BoolArray:
    """Pieces of `shape` of less than `min_px` pixels."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(shape.astype(np.uint8), connectivity=4)
    few = stats[:, cv2.CC_STAT_AREA] < min_px
    few[0] = False
    return np.asarray(few[labels]) if count > 1 else np.zeros_like(shape)


def _codes(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Bit k is set where neighbour k is set: north first, then clockwise (the paper's P2 to P9)."""
    code = np.zeros_like(image)
    inner = code[1:-1, 1:-1]
    h, w = image.shape
    for bit, (dy, dx) in enumerate(((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))):
        inner |= image[1 + dy : h - 1 + dy, 1 + dx : w - 1 + dx] << bit
    return code


@lru_cache(maxsize=1)
def _tables() -> tuple[NDArray[np.uint8], NDArray[np.uint8], tuple[NDArray[np.uint8], ...]]:
    """By code: 1 where the pixel stays, for both half-steps and for the four kinds of corners."""
    first, second = np.ones(256, dtype=np.uint8), np.ones(256, dtype=np.uint8)
    corners = tuple(np.ones(256, dtype=np.uint8) for _ in range(4))
    for code in range(256):
        n, ne, e, se, s, sw, w, nw = ((code >> bit) & 1 for bit in range(8))
        ring = [n, ne, e, se, s, sw, w, nw, n]
        rises = sum(1 for a, b in pairwise(ring) if (a, b) == (0, 1))
        if 2 <= sum(ring[:-1]) <= 6 and rises == 1:
            if n * e * s == 0 and e * s * w == 0:
                first[code] = 0
            if n * e * w == 0 and n * s * w == 0:
                second[code] = 0
        for table, (a, b, far, side_a, side_b) in zip(
            corners, ((n, e, sw, nw, se), (e, s, nw, ne, sw), (s, w, ne, se, nw), (w, n, se, sw, ne)), strict=True
        ):
            # two neighbours that touch each other diagonally: the pixel between them is not needed
            if a and b and n + e + s + w == 2 and not (far or side_a or side_b):
                table[code] = 0
    return first, second, corners
