"""Where a print has ridges, which way they run and how close they lie.

Directions come from the structure tensor at two widths (the narrow one where it is sure of itself:
cores and deltas stay sharp), frequencies from the power spectra of overlapping windows. Everything
lives on nodes a few pixels apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from splitknit.errors import require
from splitknit.imaging.areas import disc
from splitknit.model import BoolArray, FloatArray, GreyArray

NO_RIDGES = "the print has no ridges; check focus and light of the capture."


@dataclass(frozen=True, slots=True, eq=False)
class RidgeField:
    """Ridges of a print, at nodes ``step_px`` apart; node (i, j) is at pixel ``step_px * (i + 0.5)
    - 0.5``."""

    step_px: int
    orientation_rad: FloatArray
    """(n, m) direction of the ridges, counter-clockwise from the right as seen, 0 to pi."""
    coherence: FloatArray
    """(n, m) 0 (no direction) to 1 (one direction)."""
    frequency_px: FloatArray
    """(n, m) ridges per pixel."""
    mask: BoolArray
    """(n, m) where there are ridges."""

    def at_nodes(self, image: FloatArray) -> FloatArray:
        """(n, m) means of an image (h, w) over the nodes' cells; it is 0 beyond its border."""
        n, m = self.mask.shape
        below, beside = n * self.step_px - image.shape[0], m * self.step_px - image.shape[1]
        padded = np.pad(image, ((0, below), (0, beside)))
        return np.asarray(cv2.resize(padded, (m, n), interpolation=cv2.INTER_AREA))

    def period_mm(self, ppi: float) -> FloatArray:
        """(n, m) ridge period, NaN where there are no ridges."""
        return np.where(self.mask, 25.4 / ppi / self.frequency_px, np.nan).astype(np.float32)


def ridge_field(
    image: GreyArray, ppi: float = 500.0, inside: BoolArray | None = None
) -> RidgeField:
    """Find direction, frequency and extent of the ridges of a print (h, w) uint8, ridges dark.

    `inside`: (h, w) bool, where the finger is, if it is known. Raises BadInput if it has no ridges.

    Source: A. Bazen and S. Gerez 2002, Systematic methods for the computation of the directional
    fields and singular points of fingerprints, section 2 (averaged squared gradients). S.
    Chikkerur, A. Cartwright and V. Govindaraju 2007, Fingerprint enhancement using STFT analysis,
    section 3 (frequencies).
    """
    require(min(image.shape) * 25.4 / ppi >= 2.0, "the print must be at least 2 mm wide and high.")
    px = ppi / 25.4
    step = max(2, round(0.2 * px))  # distance between two nodes, rounded to whole pixels
    n, m = (-(-size // step) for size in image.shape)
    below = n * step - image.shape[0]
    beside = m * step - image.shape[1]
    grey = cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REPLICATE).astype(np.float32)
    grey = cv2.GaussianBlur(grey, (0, 0), 0.05 * px).astype(np.float32)
    right = cv2.Scharr(grey, cv2.CV_32F, 1, 0)
    down = cv2.Scharr(grey, cv2.CV_32F, 0, 1)
    xx, xy, yy = (
        cv2.resize(product, (m, n), interpolation=cv2.INTER_AREA)
        for product in (right * right, right * down, down * down)
    )
    tensor = xx + yy, xx - yy, 2.0 * xy
    # sigmas in mm
    narrow, wide = ([_blur(part, length * px / step) for part in tensor] for length in (0.3, 0.8))
    if inside is None:
        inside = np.ones(image.shape, dtype=bool)
    nodes = np.pad(inside, ((0, below), (0, beside))).reshape(n, step, m, step)
    mask = np.asarray(nodes.any(axis=(1, 3)))
    require(mask.any(), NO_RIDGES)
    coherence = np.hypot(narrow[1], narrow[2]) / np.maximum(narrow[0], 1e-6)
    trust = coherence**4
    cosine, sine = (
        trust * fine / np.maximum(narrow[0], 1e-6)
        + (1 - trust) * coarse / np.maximum(wide[0], 1e-6)
        for fine, coarse in zip(narrow[1:], wide[1:], strict=True)
    )
    # the gradient's angle (rows down), turned by a quarter: along the ridge; then counter-clockwise
    # as seen
    orientation = np.mod(-0.5 * np.arctan2(sine, cosine) + 0.5 * np.pi, np.pi)
    frequency, peaked = _frequencies(grey, orientation, step, px, mask)
    mask = mask & peaked
    require(mask.any(), NO_RIDGES)
    return RidgeField(
        step,
        orientation.astype(np.float32),
        np.clip(coherence, 0, 1),
        frequency,
        mask,
    )


def _blur(image: FloatArray, sigma: float) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT))


def overlap_added(tiles: FloatArray, step: int) -> FloatArray:
    """Sum of tiles (n, m, side, side) that lie `step` pixels apart, as far as whole steps go."""
    (n, m), times = tiles.shape[:2], tiles.shape[2] // step
    total = np.zeros(((n + times - 1) * step, (m + times - 1) * step), dtype=np.float32)
    for i, j in product(range(times), repeat=2):
        part = tiles[:, :, i * step : (i + 1) * step, j * step : (j + 1) * step].transpose(
            0, 2, 1, 3
        )
        total[i * step : (i + n) * step, j * step : (j + m) * step] += part.reshape(
            n * step, m * step
        )
    return total


def closed_opened(
    area: BoolArray, closing_px: int, opening_px: int, pad: int, border: int = cv2.BORDER_REPLICATE
) -> BoolArray:
    """(H, W) an area closed and opened with discs of these radii; beyond the image it goes on by
    `pad` pixels."""
    padded = cv2.copyMakeBorder(area.astype(np.uint8), pad, pad, pad, pad, border)
    for kind, radius in ((cv2.MORPH_CLOSE, closing_px), (cv2.MORPH_OPEN, opening_px)):
        padded = cv2.morphologyEx(padded, kind, disc(radius))
    return np.ascontiguousarray(padded[pad:-pad, pad:-pad]).view(np.bool_)


def outline_distance_mm(area: BoolArray, ppi: float) -> FloatArray:
    """(H, W) distance of every pixel of a print's area to its outline or the image's border; 0
    outside."""
    padded = np.pad(area.view(np.uint8), 1)  # beyond the image is not print
    return cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1] * (
        25.4 / ppi
    )


def _frequencies(
    grey: FloatArray, orientation: FloatArray, step: int, px: float, mask: BoolArray
) -> tuple[FloatArray, BoolArray]:
    """Frequency at the nodes (n, m), ridges per pixel, and where a frequency was found nearby.

    Windows around every second node. The strongest frequency across the ridges is refined to the
    centroid of the power within two bins of it: under a Hann window that has no bias, wherever
    between the bins a wave lies.
    """
    least = max(16, round(1.63 * px))  # side of the windows whose spectra give the frequency
    # of small prime factors: quick to transform
    side = next(n for n in range(least, 2 * least) if 30**12 % n == 0)
    pad = side // 2
    wide = cv2.copyMakeBorder(grey, pad, pad + 2 * step, pad, pad + 2 * step, cv2.BORDER_REFLECT)
    rows, columns = (-(-size // 2) for size in mask.shape)
    windows = sliding_window_view(wide, (side, side))[step :: 2 * step, step :: 2 * step][
        :rows, :columns
    ]
    padded = np.pad(mask, ((0, 2 * rows - mask.shape[0]), (0, 2 * columns - mask.shape[1])))
    wanted = padded.reshape(rows, 2, columns, 2).any(axis=(1, 3))
    patches = windows[wanted]
    hann = np.hanning(side + 2)[1:-1].astype(np.float32)
    waves = np.fft.fft2((patches - patches.mean(axis=(1, 2), keepdims=True)) * np.outer(hann, hann))
    power = waves.real**2 + waves.imag**2
    total = power[:, :, : side // 2 + 1].sum(axis=(1, 2))  # every wave is there twice
    power = power.reshape(len(patches), -1)
    ky, kx = np.meshgrid(*(np.fft.fftfreq(side),) * 2, indexing="ij")
    radius = np.hypot(kx, ky).ravel()
    reach = 2.5 / side
    low = 1.0 / (0.9 * px)  # longest ridge period that is accepted
    high = 1.0 / (0.25 * px)  # shortest ridge period that is accepted
    band = (radius > low - reach) & (radius < high + reach)
    x, y = (k.ravel()[band].astype(np.float32) for k in (kx, ky))
    power = power[:, band]
    accepted = (radius[band] > low) & (radius[band] < high) & (x >= 0)
    angle = 2.0 * (orientation[::2, ::2][wanted] + (0.5 * np.pi))[:, None]
    across = 0.5 + 0.5 * np.cos(angle - 2.0 * np.arctan2(-y, x))
    best = np.argmax(power * across * accepted, axis=1)[:, None]
    peak = np.where((np.abs(x - x[best]) < reach) & (np.abs(y - y[best]) < reach), power, 0.0)
    weight = np.maximum(peak.sum(axis=1), 1e-9)
    frequency = np.hypot(peak @ x / weight, peak @ y / weight)
    fraction = weight / np.maximum(total, 1e-9)
    sure = (fraction > 0.1) & (frequency > low) & (frequency < high)
    if not sure.any():
        return np.full(mask.shape, np.nan, dtype=np.float32), np.zeros(mask.shape, dtype=bool)
    trust = np.zeros((rows, columns), dtype=np.float32)
    trust[wanted] = np.where(sure, fraction, 0.0)
    value = np.zeros((rows, columns), dtype=np.float32)
    value[wanted] = frequency
    around = _blur(trust, 1.5)
    smooth = _blur(trust * value, 1.5) / np.maximum(around, 1e-9)
    smooth = np.where(around > 0.01, smooth, np.median(frequency[sure]))
    large = cv2.resize(smooth, (2 * columns, 2 * rows), interpolation=cv2.INTER_LINEAR)
    near = (
        cv2.dilate((around > 0.02).astype(np.uint8), np.ones((3, 3), np.uint8))
        .repeat(2, axis=0)
        .repeat(2, axis=1)
    )
    inside = slice(mask.shape[0]), slice(mask.shape[1])
    return np.ascontiguousarray(large[inside]), near[inside] > 0
