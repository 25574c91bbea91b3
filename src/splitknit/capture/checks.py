"""What is checked of every shot while the finger still lies there, and the verdict in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.capture.exposure import MEDIAN, clipped_share
from splitknit.capture.focus import grey_light
from splitknit.devices import Frame
from splitknit.errors import require
from splitknit.finger.motion import MIN_RELIABILITY, MotionSettings, shot_motion
from splitknit.finger.regions import blur, dilate, reduce_image
from splitknit.model import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class CheckSettings:
    """Limits of the checks."""

    saturated_share: float = 0.05
    """A shot is overexposed if more of the finger is at full scale (in two channels)."""
    moved_mm: float = 0.13
    """A finger that moved by more between two shots has moved. A changing light looks like up to 0.07 mm of motion.
    Coarse pictures measure less well: at least 1.5 pixels are allowed."""
    drifted_mm: float = 0.12
    """... and by more against all shots of its band, where the light's part is taken off."""
    least_light: float = 0.4
    """An LED did not light if the finger gets less than this share of what the preview promised."""
    least_relative: float = 0.12
    """... or, in the previews, less than this share of the median LED of its band."""
    most_ambient: float = 0.3
    """Light with all LEDs off, relative to the median lit shot, above which the lid is open."""
    retries: int = 2
    """How often a bad shot is taken again."""
    working_px_per_mm: float = 10.0
    """Scale of the copies in which motion is measured."""

    def __post_init__(self) -> None:
        for name in ("saturated_share", "least_light", "least_relative", "most_ambient"):
            require(0 < getattr(self, name) <= 1, f"checks.{name} must lie in (0, 1].")
        for name in ("moved_mm", "drifted_mm", "working_px_per_mm"):
            require(getattr(self, name) > 0, f"checks.{name} must be positive.")
        require(0 <= self.retries <= 20, "checks.retries must be 0 to 20.")


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What the checks keep of a shot: small copies."""

    grey: FloatArray
    """(h, w) light at the working scale, 1 = full scale."""
    details: FloatArray
    """(h, w) its ridges: band-passed relative brightness, zero beside the finger."""
    level: float
    """Median of the finger (or another percentile), 1 = full scale."""
    saturated: float
    """Share of the finger at full scale."""


class Examiner:
    """Looks at shots: knows where the finger is and how dark it is without LEDs."""

    def __init__(self, region: BoolArray, px_per_mm: float, settings: CheckSettings, typical: float = MEDIAN) -> None:
        """Prepare.

        Parameters
        ----------
        region : (h, w) the finger on a grid of any size that covers the whole picture
        px_per_mm : of full-size shots
        settings : limits
        typical : percentile of the finger's pixels that is its level
        """
        self.settings, self._typical = settings, typical
        self.region = region
        self._px_per_mm = px_per_mm
        self._masks: dict[tuple[int, int], tuple[BoolArray, FloatArray]] = {}

    def look(self, frame: Frame) -> Look:
        """Reduce a shot to what the checks need."""
        step = max(1, int(self._px_per_mm / (2.5 * self.settings.working_px_per_mm)))
        full = frame.pixels[::step, ::step]  # a sparse grid first: a Raspberry Pi has little time
        scale = min(1.0, self.settings.working_px_per_mm * step / self._px_per_mm)
        grey = reduce_image(grey_light(full, frame.black_level), scale)
        inside, window = self._mask((grey.shape[0], grey.shape[1]))
        level = float(np.percentile(grey[inside], self._typical))
        px = self.working_px_per_mm(grey.shape[1], frame.pixels.shape[1])
        local = np.maximum(blur(grey, 1.2 * px), np.float32(max(0.1 * level, 1e-6)))
        relative = np.asarray(grey / local, dtype=np.float32)
        details = np.asarray((blur(relative, 0.08 * px) - blur(relative, 0.3 * px)) * window, dtype=np.float32)
        sparse = cv2.resize(self.region.astype(np.uint8), full.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
        return Look(grey, details, level, clipped_share(full, np.asarray(sparse)))

    @property
    def moved_mm(self) -> float:
        """Motion between two shots from which on the finger has moved."""
        return max(self.settings.moved_mm, 1.5 / self._px_per_mm)

    @property
    def drifted_mm(self) -> float:
        """Motion against all shots of a band from which on it has drifted."""
        return max(self.settings.drifted_mm, 1.5 / self._px_per_mm)

    def working_px_per_mm(self, columns: int, full_columns: int) -> float:
        """Scale of a copy with so many columns."""
        return self._px_per_mm * columns / full_columns

    def shift_mm(self, before: Look, after: Look, full_columns: int) -> tuple[float, float] | None:
        """How far the finger moved between two shots (x right, y up), or None if they show different things."""
        (x, y), response = cv2.phaseCorrelate(before.details, after.details)
        if response < 0.2:
            return None
        px = self.working_px_per_mm(before.details.shape[1], full_columns)
        return float(x) / px, -float(y) / px

    def drift(self, looks: Sequence[Look], dark: Look, full_columns: int) -> NDArray[np.float64]:
        """(L,) distance in mm of the finger in each shot of a band from its place in all of them."""
        stack = np.stack([look.grey - dark.grey for look in looks])
        inside, _ = self._mask((stack.shape[1], stack.shape[2]))
        px = self.working_px_per_mm(stack.shape[2], full_columns)
        motion = shot_motion(stack, inside, px, MotionSettings(working_px_per_mm=self.settings.working_px_per_mm))
        length = np.hypot(motion.shift_mm[:, 0], motion.shift_mm[:, 1])
        believed = motion.reliability >= MIN_RELIABILITY
        return np.asarray(np.where(believed, length, 0.0), dtype=np.float64)

    def _mask(self, shape: tuple[int, int]) -> tuple[BoolArray, FloatArray]:
        """The finger on a copy of `shape`, and the window that fades out beside it."""
        if shape not in self._masks:
            share = cv2.resize(self.region.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA)
            inside = np.asarray(share > 0.5)
            px = self.settings.working_px_per_mm
            window = blur(dilate(inside, 0.7 * px).astype(np.float32), 0.5 * px)
            self._masks[shape] = (inside if inside.any() else np.ones(shape, dtype=np.bool_)), window
        return self._masks[shape]


def shrink_region(region: BoolArray, margin_px: float) -> BoolArray:
    """The region without a rim, or as it is where nothing would be left."""
    depth = cv2.distanceTransform(np.pad(region.astype(np.uint8), 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    inner = np.asarray(depth > margin_px)
    return inner if inner.any() else region
