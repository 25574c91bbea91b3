"""How sharp the finger is in a picture, free of brightness and noise: a number that peaks when the focus is right."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_image, check_mask, require
from splitknit.model import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class FocusSettings:
    """How focus is measured and when a live measurement ends."""

    detail_mm: float = 0.02
    """Standard deviation of the smoothing before the Laplacian: a pixel and a half of the full frame. Finer is more
    sensitive to focus and to noise. At least 0.7 pixels are smoothed."""
    patience: int = 8
    """A live measurement ends after so many in a row that do not rise above the best so far by `rise`."""
    rise: float = 0.02
    """Relative."""
    most: int = 400
    """Measurements at most."""
    least_snr: float = 0.1
    """Below this the finger shows no detail above the noise: the picture is refused as out of focus."""
    least_px_per_mm: float = 18.0
    """Coarser pictures are not refused: ridges are so small in them that they pass for noise."""

    def __post_init__(self) -> None:
        require(0.002 <= self.detail_mm <= 1, "focus.detail_mm must be 0.002 to 1 mm.")
        require(self.patience >= 1 and self.most >= 1, "focus.patience and focus.most must be at least 1.")
        require(0 <= self.rise < 1 and self.least_snr >= 0, "focus.rise must be 0 to 1, focus.least_snr not negative.")


@dataclass(frozen=True, slots=True)
class Focus:
    """One measurement."""

    sharpness: float
    """Standard deviation of the detail, relative to brightness, in per cent; the noise's part is taken off."""
    snr: float
    """Variance of the detail over that of the noise."""


def measure_focus(
    image: NDArray[np.floating], region: BoolArray, px_per_mm: float, settings: FocusSettings | None = None
) -> Focus:
    """Measure the focus of one picture.

    The variance of the Laplacian of Gaussian of the relative brightness inside the region, less what the noise
    contributes. The noise is found at the finest scale: the skin, whose light is blurred over tenths of a millimetre,
    has next to nothing there.

    Parameters
    ----------
    image : (H, W) linear light
    region : (H, W) the finger, without its outline
    px_per_mm : of the image

    Returns
    -------
    Focus

    Raises
    ------
    BadInput
        If shapes differ or the region is empty.

    References
    ----------
    Pech-Pacheco, J. L. et al., "Diatom autofocusing in brightfield microscopy", ICPR 2000 (variance of the Laplacian).
    Immerkaer, J., "Fast noise variance estimation", Computer Vision and Image Understanding 64, 1996 (the mask of the
    noise).
    """
    settings = settings or FocusSettings()
    light = check_image(image)
    inside = check_mask(region, (light.shape[0], light.shape[1]))
    sigma = max(settings.detail_mm * px_per_mm, 0.7)
    local = cv2.GaussianBlur(light, (0, 0), 6.0 * sigma)
    floor = np.float32(max(0.05 * float(np.mean(light[inside], dtype=np.float64)), 1e-9))
    relative = np.asarray(light / np.maximum(local, floor), dtype=np.float32)
    inside = inside & (local > 2 * floor)  # the finger's unlit flank is noise alone
    if not inside.any():
        return Focus(0.0, 0.0)
    detail = cv2.Laplacian(cv2.GaussianBlur(relative, (0, 0), sigma), cv2.CV_32F) * np.float32(sigma**2)
    finest = cv2.filter2D(relative, cv2.CV_32F, _NOISE_MASK)
    # robust, because glare and hairs are sharp at every scale
    noise = (1.4826 * float(np.median(np.abs(finest[inside])))) ** 2 / float((_NOISE_MASK**2).sum())
    of_noise = noise * _response_to_noise(sigma)
    total = (1.4826 * float(np.median(np.abs(detail[inside] - np.median(detail[inside]))))) ** 2
    signal = max(total - of_noise, 0.0)
    return Focus(sharpness=float(100.0 * np.sqrt(signal)), snr=float(signal / max(of_noise, 1e-12)))


_NOISE_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
"""Difference of two Laplacians: blind to planes, quadratics along the axes and edges along them."""


def _response_to_noise(sigma: float) -> float:
    """Variance that white noise of variance one has after the filter."""
    size = int(np.ceil(6 * sigma)) * 2 + 9
    impulse = np.zeros((size, size), dtype=np.float32)
    impulse[size // 2, size // 2] = 1.0
    kernel = cv2.Laplacian(cv2.GaussianBlur(impulse, (0, 0), sigma), cv2.CV_32F) * np.float32(sigma**2)
    return float((kernel.astype(np.float64) ** 2).sum())


@dataclass(slots=True)
class FocusWatch:
    """Follows live measurements and says when they have stopped rising."""

    settings: FocusSettings = field(default_factory=FocusSettings)
    best: float = 0.0
    measured: int = 0
    ended: bool = False
    """Whether it is enough."""
    _idle: int = 0

    def add(self, focus: Focus) -> bool:
        """Note a measurement; true when it is enough."""
        self.measured += 1
        if focus.sharpness > self.best * (1.0 + self.settings.rise):
            self._idle = 0
        else:
            self._idle += 1
        self.best = max(self.best, focus.sharpness)
        self.ended = self._idle >= self.settings.patience or self.measured >= self.settings.most
        return self.ended


def grey_light(pixels: NDArray[np.unsignedinteger], black_level: float = 0.0) -> FloatArray:
    """(H, W) mean of the channels of stored (H, W, C) integers, 1 = full scale."""
    full = float(np.iinfo(pixels.dtype).max)
    mean = pixels[..., 0].astype(np.float32)
    for c in range(1, pixels.shape[2]):
        mean += pixels[..., c]
    mean /= np.float32(pixels.shape[2])
    mean -= np.float32(black_level)
    mean *= np.float32(1.0 / full)
    return mean
