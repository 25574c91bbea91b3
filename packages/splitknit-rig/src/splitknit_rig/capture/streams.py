"""Cameras of other makers behind one small protocol: UVC by OpenCV, GenICam by harvesters (imported here alone).

A stream gives frames one after the other; :class:`StreamCamera` makes a :class:`splitknit.devices.CameraDevice` of it,
whose frames were exposed after the call and as locked. How that is known differs, and each frame is marked with it:

- *triggered*: the exposure begins when it is asked for, so after the LED was switched (GenICam's software trigger);
- *tagged*: the frame carries its exposure time, gain and start, as the Raspberry Pi's do;
- *blind*: the frame carries none of these (UVC). Then as many frames are discarded as can wait in buffers.

None of this has been run on hardware: tests drive simulated streams and substitutes of the two libraries.
"""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput, Closing, ExposureRange, Frame, PixelArray, decode_table, importing, require

_MAX_FRAMES = 30  # frames that are thrown away, at most, while waiting for a good one
_BLIND_FRAMES = 5  # frames of a blind stream that are thrown away: four that wait in buffers and the one in the sensor
_LATE_FRAMES = 4  # and further ones after a new exposure
_PREVIEW_COLUMNS = 800  # width of a preview, about
_LONGEST_S = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class _Grab:
    """One frame of a stream and what is known of it."""

    pixels: PixelArray  # (H, W, C) integers, C = 1 or 3, linear
    arrived_s: float  # when the program had it, on the clock of the stream
    began_s: float | None = None  # when its exposure began, at the earliest; None: not known
    exposure_s: float | None = None  # as the camera reports it; None: not reported
    gain: float | None = None


class Stream(Protocol):
    """What a camera must do to be used here."""

    image_size: tuple[int, int]
    """Rows, columns."""
    exposures: ExposureRange
    """What :meth:`set` accepts."""

    def set(self, exposure_s: float, gain: float) -> None:
        """Set exposure time and gain, within :attr:`exposures`, for frames that come sooner or later."""

    def grab(self) -> _Grab:
        """Return the next frame; one that is triggered, where the camera can be."""

    def now_s(self) -> float:
        """Return the time on the stream's clock, which only runs forward."""
        return time.monotonic()

    def close(self) -> None:
        """Give the hardware back; may be called twice."""


class StreamCamera(Closing):
    """A :class:`splitknit.devices.CameraDevice` on a stream."""

    def __init__(self, stream: Stream) -> None:
        """Take the stream, which is closed with the camera."""
        self._stream, self._closed, self._late = stream, False, 0
        self._wanted = 0.0, 0.0
        self.image_size, self.exposures = stream.image_size, stream.exposures
        reach = self.exposures
        self.lock(min(max(0.01, reach.shortest_s), reach.longest_s), reach.lowest_gain)

    def lock(self, exposure_s: float, gain: float, band: str = "white") -> None:
        """See :class:`splitknit.devices.CameraDevice`; white balance stays as the camera has it."""
        self.exposures.check(exposure_s, gain)
        require(band in ("white", "nir"), f"the bands are white and nir, not '{band}'.")
        self._stream.set(exposure_s, gain)
        self._wanted, self._late = (exposure_s, gain), _LATE_FRAMES

    def capture(self) -> Frame:
        """See :class:`splitknit.devices.CameraDevice`."""
        require(not self._closed, "the camera is closed; open it again.")
        since_s, blind = self._stream.now_s(), _BLIND_FRAMES + self._late
        exposure_s, gain = self._wanted
        for discarded in range(_MAX_FRAMES):
            last = self._stream.grab()
            in_time = last.began_s >= since_s if last.began_s is not None else discarded >= blind
            as_locked = _near(last.exposure_s, exposure_s, 0.02) and _near(last.gain, gain, 0.05)
            if in_time and as_locked:
                self._late = 0
                return Frame(
                    pixels=last.pixels,
                    exposure_s=last.exposure_s or exposure_s,
                    gain=last.gain or gain,
                    black_level=0.0,
                    at_s=last.arrived_s if last.began_s is None else max(last.arrived_s, since_s),
                    discarded=discarded,
                )
        raise BadInput(
            f"the camera did not take its settings: {exposure_s:g} s at gain {gain:g} were asked for, but after "
            f"{_MAX_FRAMES} frames it reports {last.exposure_s} s at gain {last.gain}; plug it in again, and close "
            "other programs that use it."
        )

    def preview(self) -> Frame:
        """See :class:`splitknit.devices.CameraDevice`."""
        frame = self.capture()
        return replace(frame, pixels=preview_pixels(frame.pixels))

    def close(self) -> None:
        """See :class:`splitknit.devices.CameraDevice`."""
        if not self._closed:
            self._closed = True
            self._stream.close()


def preview_pixels(pixels: PixelArray) -> PixelArray:
    """(h, w, C) an image of about 800 columns: the means of whole blocks of (H, W, C)."""
    rows, columns, channels = pixels.shape
    factor = max(1, round(columns / _PREVIEW_COLUMNS))
    size = (columns // factor, rows // factor)
    small: Any = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return np.asarray(small.reshape(*size[::-1], channels))


def _near(reported: float | None, wanted: float, relative: float) -> bool:
    return reported is None or abs(reported - wanted) <= relative * wanted + 4e-5


# OpenCV names a pattern by its second row and column: blue green / green red is "BayerRG", and RGB its order
BAYER: Mapping[str, int] = {
    "BGGR": cv2.COLOR_BayerRG2RGB,
    "GBRG": cv2.COLOR_BayerGR2RGB,
    "GRBG": cv2.COLOR_BayerGB2RGB,
    "RGGB": cv2.COLOR_BayerBG2RGB,
}
"""By the colours of the first two pixels of the first two rows."""


def developed(
    raw: NDArray[np.uint16], bits: int, black: int, order: str, gains: tuple[float, float] = (1.0, 1.0)
) -> NDArray[np.uint16]:
    """White-balanced linear colours (H, W, 3) uint16, or grey (H, W, 1), of `raw` values (H, W) of `bits`. `black`:
    value of no light, of 16 bits, which stays; `order`: one of :data:`BAYER`, else grey; `gains`: of red, blue.
    """
    shift = 16 - bits
    if order not in BAYER:
        grey = np.left_shift(raw, shift, dtype=np.uint16)
        return np.asarray(np.where(raw >= (1 << bits) - 1, 65535, grey), dtype=np.uint16)[..., None]
    colours = np.asarray(cv2.cvtColor(np.ascontiguousarray(raw), BAYER[order]), dtype=np.uint16)
    levels = (np.arange(1 << bits, dtype=np.float64) * (1 << shift)) - black
    result = np.empty_like(colours)
    for c, gain in enumerate((gains[0], 1.0, gains[1])):
        table = np.clip(np.rint(levels * gain + black), 0, 65535)
        table[-1] = 65535  # what the sensor clips is clipped in every channel
        result[..., c] = table.astype(np.uint16)[np.minimum(colours[..., c], (1 << bits) - 1)]
    return result


class _Uvc(Stream):
    """A webcam by OpenCV, on Video4Linux: exposure times in 0.1 ms, gain at its smallest, 8 bits."""

    def __init__(self, capture: Any, number: int, size: tuple[int, int] | None) -> None:
        self._capture = capture
        device = Path(f"/dev/video{number}")
        require(
            bool(capture.isOpened()),
            f"camera {number} may not be used ('{device}'); add yourself to its group, video, and log in again."
            if device.exists() and not os.access(device, os.R_OK | os.W_OK)
            else f"no UVC camera {number} was found, or another program uses it; 'v4l2-ctl --list-devices' lists "
            "cameras (number: pi.number, or the source of the live view).",
        )
        if size is not None:
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[0])
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[1])
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, 1)  # Video4Linux's manual mode
        capture.set(cv2.CAP_PROP_AUTO_WB, 0)
        capture.set(cv2.CAP_PROP_GAIN, 0)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        capture.set(cv2.CAP_PROP_GAMMA, 100)
        # a camera without the control keeps its own curve, which is about that of sRGB
        linear = capture.get(cv2.CAP_PROP_GAMMA) == 100
        table = decode_table(np.dtype(np.uint8), "linear" if linear else "srgb")
        self._table = np.rint(table * 65535).astype(np.uint16)
        rows, columns = capture.get(cv2.CAP_PROP_FRAME_HEIGHT), capture.get(cv2.CAP_PROP_FRAME_WIDTH)
        self.image_size, self.exposures = (round(rows), round(columns)), ExposureRange(1e-4, _LONGEST_S, 1.0, 1.0)

    def set(self, exposure_s: float, gain: float) -> None:
        steps = max(round(exposure_s * 1e4), 1)
        self._capture.set(cv2.CAP_PROP_EXPOSURE, steps)
        taken = self._capture.get(cv2.CAP_PROP_EXPOSURE)
        require(
            abs(taken - steps) <= max(1, 0.02 * steps),
            f"the UVC camera does not let its exposure be set ({steps} x 0.1 ms were asked for, it reports {taken:g}); "
            "photometric stereo needs a camera with manual exposure.",
        )

    def grab(self) -> _Grab:
        good, pixels = self._capture.read()
        require(bool(good), "the UVC camera gave no picture; plug it in again, and close other programs that use it.")
        colours = cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
        return _Grab(self._table[colours], self.now_s())

    def close(self) -> None:
        self._capture.release()


def _opened(number: int) -> Any:
    """OpenCV's camera; what it prints where there is none is left to the sentence of the caller."""
    log: Any = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        return cv2.VideoCapture(number)
    finally:
        log.setLogLevel(level)


def open_uvc(number: int, make: Callable[[int], Any] = _opened, size: tuple[int, int] | None = None) -> Stream:
    """Open webcam `number` of the system; it may give another size than is asked for. BadInput if there is none."""
    return _Uvc(make(number), number, size)


_FORMATS = tuple(
    f"{kind}{bits}" for bits in (16, 12, 10, 8) for kind in ("BayerRG", "BayerBG", "BayerGR", "BayerGB", "Mono")
)
"""Pixel formats of GenICam that are read, the best first."""


class _GenICam(Stream):
    """An industrial camera by harvesters: software trigger, manual exposure and gain."""

    def __init__(self, harvester: Any, acquirer: Any) -> None:
        self._harvester, self._acquirer = harvester, acquirer
        self._nodes = nodes = acquirer.remote_device.node_map
        for name, value in (
            ("ExposureAuto", "Off"), ("GainAuto", "Off"), ("BalanceWhiteAuto", "Off"), ("GammaEnable", False),
            ("AcquisitionMode", "Continuous"), ("TriggerSelector", "FrameStart"),
        ):  # fmt: skip
            if hasattr(nodes, name):
                getattr(nodes, name).value = value
        offered = [name for name in _FORMATS if name in nodes.PixelFormat.symbolics]
        require(len(offered) > 0, "the GenICam camera offers no pixel format of " + ", ".join(sorted(_FORMATS)) + ".")
        nodes.PixelFormat.value = offered[0]
        nodes.TriggerMode.value, nodes.TriggerSource.value = "On", "Software"
        self._order = {"RG": "RGGB", "BG": "BGGR", "GR": "GRBG", "GB": "GBRG"}.get(offered[0][5:7], "")
        self._bits = int(re.sub(r"\D", "", offered[0]))
        self.image_size = int(nodes.Height.value), int(nodes.Width.value)
        times, gains = nodes.ExposureTime, nodes.Gain
        low, high = (10 ** (decibels / 20) for decibels in (max(gains.min, 0.0), gains.max))
        self.exposures = ExposureRange(times.min * 1e-6, min(times.max * 1e-6, _LONGEST_S), low, high)
        acquirer.start()

    def set(self, exposure_s: float, gain: float) -> None:
        self._nodes.ExposureTime.value = exposure_s * 1e6
        self._nodes.Gain.value = 20 * math.log10(gain)

    def grab(self) -> _Grab:
        began = self.now_s()
        self._nodes.TriggerSoftware.execute()
        try:
            with self._acquirer.fetch(timeout=_LONGEST_S + 2.0) as buffer:
                component = buffer.payload.components[0]
                values = np.array(component.data).reshape(component.height, component.width)
        except Exception as error:  # harvesters and every maker's producer have errors of their own
            raise BadInput(
                f"the GenICam camera gave no picture after its trigger ({' '.join(str(error).split())}); check cable "
                "and supply."
            ) from error
        pixels = developed(values.astype(np.uint16), self._bits, 0, self._order)
        exposure_s = float(self._nodes.ExposureTime.value) * 1e-6
        return _Grab(pixels, self.now_s(), began, exposure_s, 10 ** (float(self._nodes.Gain.value) / 20))

    def close(self) -> None:
        acquirer, self._acquirer = self._acquirer, None
        if acquirer is not None:
            try:
                acquirer.stop()
                acquirer.destroy()
            finally:
                self._harvester.reset()


def open_genicam(number: int) -> Stream:
    """Open an industrial camera by the GenTL producers that GENICAM_GENTL64_PATH names."""
    with importing("harvesters, which drives GenICam cameras, is not installed; install the extra genicam."):
        from harvesters.core import Harvester  # type: ignore[import-not-found]  # optional
    folders = [Path(folder) for folder in os.environ.get("GENICAM_GENTL64_PATH", "").split(os.pathsep) if folder]
    producers = sorted(file for folder in folders for file in folder.glob("*.cti"))
    require(
        len(producers) > 0,
        "no GenTL producer was found; install the camera maker's software, which sets GENICAM_GENTL64_PATH.",
    )
    harvester = Harvester()
    try:
        for file in producers:
            harvester.add_file(str(file))
        harvester.update()
        count = len(harvester.device_info_list)
        words = f"there is no GenICam camera {number}; {count} were found: check cable, supply and pi.number."
        require(number < count, words)
        return _GenICam(harvester, harvester.create(number))
    except BaseException:
        harvester.reset()
        raise
