"""Enhancement in short windows: each is filtered in its own spectrum, by what its surroundings say of the ridges.

The print is cut into overlapping windows. A window's spectrum is multiplied by a radial band about the local frequency
and by a fan about the local direction, which is wide where directions disagree (cores, deltas); the windows are put
together again.

References
----------
S. Chikkerur, A. Cartwright and V. Govindaraju 2007, Fingerprint enhancement using STFT analysis, sections 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import scipy.fft
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray
from splitknit.prints.enhance import Enhanced, finished
from splitknit.prints.ridge_field import RidgeField, RidgeFieldSettings, ridge_field
from splitknit.prints.ridges import MM_PER_INCH


@dataclass(frozen=True, slots=True)
class StftSettings:
    """How windows are filtered."""

    window_mm: float = 1.63
    """Side of a window."""
    radial_width: float = 0.5
    """Half width of the radial band, relative to the local frequency."""
    narrow_deg: float = 25.0
    """Half width of the fan where ridges run one way."""
    wide_deg: float = 80.0
    """Half width of the fan where they run every way."""
    contrast: float = 2.0
    """Steepness of the grey curve."""
    floor: float = 0.15
    """Ridges weaker than this share of the print's median are not raised further."""
    field: RidgeFieldSettings = field(default_factory=RidgeFieldSettings)

    def __post_init__(self) -> None:
        require(np.isfinite(self.window_mm) and self.window_mm > 0.5, "stft.window_mm must be more than 0.5.")
        require(0.1 <= self.radial_width <= 1, "stft.radial_width must lie between 0.1 and 1.")
        require(
            5 <= self.narrow_deg <= self.wide_deg <= 90, "stft.narrow_deg and wide_deg must lie in [5, 90], in order."
        )
        require(np.isfinite(self.contrast) and self.contrast > 0, "stft.contrast must be a positive number.")
        require(0 < self.floor <= 1, "stft.floor must lie between 0 and 1.")


def stft_enhance(
    image: NDArray[np.uint8],
    ppi: float = 500.0,
    settings: StftSettings | None = None,
    inside: BoolArray | None = None,
) -> Enhanced:
    """Enhance a print.

    Parameters
    ----------
    image : (h, w) uint8
        Ridges dark.
    ppi : float
        Pixels per inch.
    settings : StftSettings, optional
    inside : (h, w) bool, optional
        Where the finger is, if it is known: nothing is printed beside it.

    Raises
    ------
    BadInput
        If the image is of another kind, or has no ridges.
    """
    settings = settings or StftSettings()
    found = ridge_field(image, ppi, settings.field, inside)
    wave = _filtered(image, found, ppi / MM_PER_INCH, settings)
    sigma = settings.window_mm * ppi / MM_PER_INCH / 4
    level = np.sqrt(np.maximum(cv2.GaussianBlur(wave * wave, (0, 0), sigma), np.float32(1e-12)) * 2)
    large = cv2.resize(found.mask.astype(np.uint8), None, fx=found.step_px, fy=found.step_px) > 0
    typical = float(np.median(level[large[: image.shape[0], : image.shape[1]]]))
    require(typical > 0.05, "the print has no ridges; check focus and light of the capture.")
    wave = wave / np.maximum(level, np.float32(settings.floor * typical))
    padded = cv2.copyMakeBorder(
        level, 0, large.shape[0] - level.shape[0], 0, large.shape[1] - level.shape[1], cv2.BORDER_REPLICATE
    )
    at_nodes = cv2.resize(padded, (found.mask.shape[1], found.mask.shape[0]), interpolation=cv2.INTER_AREA)
    found = replace(found, mask=found.mask & (at_nodes > np.float32(2.0 * settings.floor * typical)))
    require(bool(found.mask.any()), "the print has no ridges; check focus and light of the capture.")
    return finished(wave.astype(np.float32), found, settings.contrast, inside)


def _filtered(image: NDArray[np.uint8], found: RidgeField, px: float, settings: StftSettings) -> FloatArray:
    """(h, w) sum of the filtered windows."""
    side = scipy.fft.next_fast_len(max(16, round(settings.window_mm * px)), real=True)
    hop = side // 4
    n, m = (-(-size // hop) + 3 for size in image.shape)
    pad = 3 * hop
    wide = cv2.copyMakeBorder(
        image, pad, n * hop + side - image.shape[0], pad, m * hop + side - image.shape[1], cv2.BORDER_REFLECT
    ).astype(np.float32)
    windows = sliding_window_view(wide, (side, side))[::hop, ::hop][:n, :m]
    # ridges at the windows' middles, on the field's nodes
    rows, columns = ((np.arange(count) * hop - pad + 0.5 * (side - 1) + 0.5) / found.step_px - 0.5 for count in (n, m))
    i = np.clip(np.rint(rows).astype(np.intp), 0, found.mask.shape[0] - 1)
    j = np.clip(np.rint(columns).astype(np.intp), 0, found.mask.shape[1] - 1)
    near = cv2.dilate(found.mask.astype(np.uint8), np.ones((2 * (side // found.step_px // 2) + 1,) * 2, np.uint8)) > 0
    wanted = near[i[:, None], j[None]]
    orientation, frequency, width = (part[i[:, None], j[None]][wanted] for part in _context(found, settings))
    analysis = np.sqrt(np.hanning(side + 1)[:-1]).astype(np.float32)
    taper = analysis[:, None] * analysis
    patches = windows[wanted]
    patches = (patches - patches.mean(axis=(1, 2), keepdims=True)) * taper
    spectrum = scipy.fft.rfft2(patches, workers=2)
    ky, kx = np.meshgrid(
        scipy.fft.fftfreq(side).astype(np.float32), scipy.fft.rfftfreq(side).astype(np.float32), indexing="ij"
    )
    radius = np.hypot(kx, ky)
    double = 2.0 * np.arctan2(-ky, kx)
    across = 2.0 * orientation + np.float32(np.pi)
    cosine = np.cos(across)[:, None, None] * np.cos(double) + np.sin(across)[:, None, None] * np.sin(double)
    off = 0.5 * np.arccos(np.clip(cosine, -1.0, 1.0))  # angle to the wave vector, 0 to a quarter turn
    fan = np.where(off < width[:, None, None], np.cos(0.5 * np.pi * off / width[:, None, None]) ** 2, np.float32(0.0))
    step = (radius - frequency[:, None, None]) / (np.float32(settings.radial_width) * frequency[:, None, None])
    band = np.float32(1.0) / (np.float32(1.0) + step**4)
    patches = scipy.fft.irfft2(spectrum * (fan * band), s=(side, side), workers=2) * taper
    sums = np.zeros(wide.shape, dtype=np.float32)
    tiles = np.zeros((n, m, side, side), dtype=np.float32)
    tiles[wanted] = patches
    quarter = side // hop
    for a in range(quarter):
        for b in range(quarter):
            part = tiles[:, :, a * hop : (a + 1) * hop, b * hop : (b + 1) * hop].transpose(0, 2, 1, 3)
            sums[a * hop : (a + n) * hop, b * hop : (b + m) * hop] += part.reshape(n * hop, m * hop)
    # squared tapers at a quarter's hop add up to 2 along each axis
    return sums[pad : pad + image.shape[0], pad : pad + image.shape[1]] / np.float32(4.0)


def _context(found: RidgeField, settings: StftSettings) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions, frequencies and half widths of the fan (rad), from each node's surroundings."""
    double = np.exp(2j * found.orientation_rad) * found.mask
    parts = [
        cv2.GaussianBlur(np.ascontiguousarray(part, dtype=np.float32), (0, 0), 1.5)
        for part in (double.real, double.imag)
    ]
    share = np.maximum(cv2.GaussianBlur(found.mask.astype(np.float32), (0, 0), 1.5), np.float32(1e-3))
    agree = np.clip(np.hypot(*parts) / share, 0.0, 1.0)
    narrow, wide = np.deg2rad(settings.narrow_deg), np.deg2rad(settings.wide_deg)
    width = (wide + (narrow - wide) * agree**2).astype(np.float32)
    orientation = (0.5 * np.arctan2(parts[1], parts[0])).astype(np.float32)
    return orientation, found.frequency_px, width
