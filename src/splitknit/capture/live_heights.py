"""Heights of one frame under three colours: light over that of a flat frame, to slopes, bridged over markers, to um."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from splitknit.capture.live import linear_colours
from splitknit.errors import require
from splitknit.finger.orientation import as_it_lies
from splitknit.imaging.geometry import normals_from_gradients, smoothed
from splitknit.integration.poisson import trusted_height
from splitknit.model import BoolArray, FloatArray, PixelArray, Reconstruction
from splitknit.photometric.markers import bridge, find_markers

Slopes = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""From images (3, H, W), linear light over the flat photograph, to dz/dx and dz/dy (2, H, W), y up, and their standard
deviation (H, W)."""

_DARK = 0.004
"""Linear light below which a flat photograph counts as unlit: one step of 8 bits."""
_GRAIN_PX = 2.0
"""Standard deviation of the blur of a flat frame: its noise, and a coat's grain and dust, which move with the gel."""
_EDGE = 0.04
"""Of the frame's sides: the strip whose middle value is zero."""
_SLOW_MM = 0.5
"""Standard deviation of the mean that is no relief in a result."""
_SAME_SHAPE = 0.01
"""By which the ratio of a frame's sides may differ from the calibration's."""


@dataclass(frozen=True, slots=True, eq=False)
class LiveHeights:
    """What was measured of a frame."""

    height_um: FloatArray
    """(H, W), towards the camera; zero is the median along the frame's edge."""
    gradient: FloatArray
    """(2, H, W): dz/dx, dz/dy, y up."""
    deviation: FloatArray
    """(H, W): of a slope."""
    markers: BoolArray
    """(H, W): pixels that markers cover, bridged."""
    albedo: FloatArray
    """(H, W): mean of the colours' light over the flat frame's."""
    pitch_mm: float
    times_ms: dict[str, float]
    """What each stage took."""

    def result(self) -> Reconstruction:
        """The same as a result that :meth:`splitknit.model.Reconstruction.save` writes; its mask leaves out markers."""
        inside = ~self.markers
        height = np.where(inside, self.height_um / np.float32(1000.0), np.float32(np.nan))
        slow = smoothed(height, inside, _SLOW_MM / self.pitch_mm)
        relief = height - slow
        frame = as_it_lies(inside)
        normals = normals_from_gradients(*self.gradient)
        return Reconstruction(
            height_mm=height,
            ridge_mm=relief,
            shape_mm=height - relief,
            mask=inside,
            normals=normals * inside[..., None],
            albedo=np.where(inside, self.albedo, np.float32(np.nan)),
            pitch_mm=self.pitch_mm,
            input_from_upright=frame.input_from_upright,
            upright_size=frame.size,
            preset="live",
            whole=True,
            facts={"material": "opaque", "slopes": "calibrated on balls", "heights": "measured", "separation": "none"},
        )

    def facts(self) -> dict[str, Any]:
        """For the page: names and numbers."""
        facts = {"measured in": f"{sum(self.times_ms.values()):.0f} ms"}
        if self.markers.any():
            facts["markers cover"] = f"{100 * float(self.markers.mean()):.1f} %"
        return {"facts": facts}


class HeightMeter:
    """Measures frames of one camera; give it to :class:`splitknit.capture.live.Live`.

    >>> import numpy as np
    >>> def slopes(images):  # of a sensor whose red and green rise with the slope
    ...     return images[:2] - 1, np.zeros(images.shape[1:], np.float32)
    >>> meter = HeightMeter(slopes, 0.03, (48, 64))
    >>> frame = np.full((48, 64, 3), 100, np.uint8)
    >>> round(float(np.ptp(meter(frame).height_um)), 2)  # the first frame is the flat one
    0.0
    """

    def __init__(
        self, slopes: Slopes, pitch_mm: float, size: tuple[int, int], encoding: str = "linear", marker_px: float = 0.0
    ) -> None:
        """`size`: rows and columns of the calibration, to which frames are scaled; `marker_px`: diameter of the printed
        dots, 0: none."""
        self._slopes, self._pitch_um, self._size = slopes, 1000.0 * pitch_mm, size
        self._encoding, self._marker_px = encoding, marker_px
        self._over_flat: FloatArray | None = None

    def take_flat(self, pixels: PixelArray) -> None:
        """Take a frame (H, W, 3) of the gel with nothing on it, by which others are divided. Raises BadInput if its
        sides have another ratio than the calibration's, or it is dark.
        """
        light, markers = self._light(pixels)
        flat = bridge(light, markers, self._marker_px / 2) if markers.any() else light
        self.divide_by(np.stack([cv2.GaussianBlur(one, (0, 0), _GRAIN_PX) for one in flat]))

    def divide_by(self, flat: FloatArray) -> None:
        """Take linear light (3, H, W) of the gel with nothing on it. Raises BadInput if it is dark."""
        lit = float((flat.min(axis=0) > _DARK).mean())
        require(
            lit > 0.5, f"only {100 * lit:.0f} % of the flat frame is lit in all three colours; switch the light on."
        )
        self._over_flat = np.asarray(1.0 / np.maximum(flat, np.float32(_DARK)), dtype=np.float32)

    def __call__(self, pixels: PixelArray) -> LiveHeights:
        """Measure a frame (H, W, 3) as stored; the first one is the flat one unless one was taken. Raises BadInput as
        :meth:`take_flat`.
        """
        if self._over_flat is None:
            self.take_flat(pixels)
        times, last = {}, time.perf_counter()

        def lap(stage: str) -> None:
            nonlocal last
            times[stage], last = 1e3 * (time.perf_counter() - last), time.perf_counter()

        light, markers = self._light(pixels)
        lap("light and markers")
        assert self._over_flat is not None
        light *= self._over_flat
        gradient, deviation = self._slopes(light)
        albedo = light.mean(axis=0)
        lap("slopes")
        if markers.any():
            gradient = bridge(gradient, markers, self._marker_px / 2)
        trust = ((deviation.min() + np.float32(1e-6)) / (deviation + np.float32(1e-6))) ** 2
        height = trusted_height(gradient[0], gradient[1], trust)
        lap("integration")
        height *= np.float32(self._pitch_um)
        band = [max(1, round(_EDGE * side)) for side in height.shape]
        edges = height[: band[0]], height[-band[0] :], height[:, : band[1]], height[:, -band[1] :]
        height -= np.float32(np.median(np.concatenate([edge.ravel() for edge in edges])))
        lap("zero")
        return LiveHeights(height, gradient, deviation, markers, albedo, self._pitch_um / 1000.0, times)

    def _light(self, pixels: PixelArray) -> tuple[FloatArray, BoolArray]:
        rows, columns = self._size
        given = pixels.shape[:2]
        require(
            abs(given[1] / given[0] * rows / columns - 1) < _SAME_SHAPE,
            f"the calibration is of {columns} x {rows} pixels, but frames have {given[1]} x {given[0]}: other sides, "
            "another scale; calibrate with frames of this camera as it is set now.",
        )
        if given != self._size:
            scaled: Any = cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA)
            pixels = scaled
        light = linear_colours(pixels, self._encoding)
        found = self._marker_px > 0
        return light, find_markers(light, self._marker_px) if found else np.zeros(self._size, np.bool_)
