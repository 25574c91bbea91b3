"""Live: the newest frame of a camera, a film or a folder of photographs, and what is measured of it.

One thread reads frames as they come and keeps the last; another measures whatever is newest when it is free. Frames
that come in between are dropped and counted, so that what is shown is never late by more than one measurement. What is
measured under three colours are heights: light over that of a flat frame, to slopes, bridged over markers, to um.
"""

from __future__ import annotations

import itertools
import json
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import cv2
import numpy as np

from splitknit import (
    BadInput,
    BoolArray,
    FloatArray,
    PixelArray,
    Query,
    Reconstruction,
    Reply,
    as_it_lies,
    bridge,
    decode_table,
    find_markers,
    json_reply,
    normals_from_gradients,
    read_image,
    require,
    smoothed,
    srgb_code,
    static_file,
    static_files,
    trusted_height,
)
from splitknit_rig.capture.streams import open_uvc

T = TypeVar("T")
FILM_FPS = 10.0  # at which a folder of photographs is played
_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
_FASTEST_FPS = 120.0
_UNSEEN_S = 5.0  # after so long without anybody looking nothing is measured


@dataclass(frozen=True, slots=True, eq=False)
class FrameSource:
    """Where frames come from."""

    name: str
    frames: Iterator[PixelArray]  # (H, W, 3) as stored, red, green, blue; without end
    encoding: str  # ``linear`` or ``srgb``
    period_s: float = 0.0  # between frames; 0 where the camera sets the pace
    close: Callable[[], None] = field(default=lambda: None)  # gives the camera back


def open_frames(
    source: str, encoding: str = "linear", size: tuple[int, int] | None = None, exposure_s: float | None = None
) -> FrameSource:
    """Open a camera by its number, or a folder of photographs or a film, which are played over and over.

    `encoding`: how files store light, ``linear`` or ``srgb``; `size` (rows, columns), `exposure_s`: to set on a camera.
    Raises BadInput if there is no such camera, it may not be used, or nothing there can be read.

    >>> import numpy as np, tempfile, pathlib
    >>> from splitknit.io.images import write_image
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> write_image(folder / "1.png", np.full((6, 8, 3), 7, np.uint8))
    >>> source = open_frames(str(folder))
    >>> next(source.frames).shape
    (6, 8, 3)
    """
    decode_table(np.dtype(np.uint8), encoding)  # refuses others
    if source.isascii() and source.isdigit() and len(source) < 4:
        stream = open_uvc(int(source), size=size)
        if exposure_s is not None:
            stream.set(exposure_s, 1.0)
        frames = (stream.grab().pixels for _ in itertools.count())
        return FrameSource(f"camera {source}", frames, "linear", close=stream.close)
    path = Path(source).expanduser()
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in _IMAGES and file.is_file())
        require(len(files) > 0, f"'{path}' holds no photographs ({', '.join(_IMAGES)}).")
        return FrameSource(path.name, map(_colours, itertools.cycle(files)), encoding, 1.0 / FILM_FPS)
    require(path.is_file(), f"'{source}' is neither a camera's number nor a folder of photographs nor a film.")
    return _open_film(path, encoding)


def _colours(file: Path) -> PixelArray:
    pixels = read_image(file)
    return pixels if pixels.shape[2] == 3 else pixels[:, :, [0, 0, 0]]


def _open_film(path: Path, encoding: str) -> FrameSource:
    film = cv2.VideoCapture(str(path))
    good, first = film.read()
    require(bool(good), f"'{path}' is not a film that can be read; frames as PNG files in a folder will do.")
    rate = film.get(cv2.CAP_PROP_FPS)

    def play(picture: Any) -> Iterator[PixelArray]:
        while True:
            yield np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
            good, picture = film.read()
            if not good:
                film.set(cv2.CAP_PROP_POS_FRAMES, 0)
                good, picture = film.read()
                require(bool(good), f"'{path}' cannot be played again from its start.")

    period_s = 1.0 / rate if 0 < rate <= _FASTEST_FPS else 1.0 / FILM_FPS
    return FrameSource(path.name, play(first), encoding, period_s, film.release)


def linear_colours(pixels: PixelArray, encoding: str) -> FloatArray:
    """Linear light (3, H, W) float32 in [0, 1] of a stored frame (H, W, 3).

    >>> import numpy as np
    >>> linear_colours(np.full((2, 4, 3), 255, np.uint8), "srgb").shape
    (3, 2, 4)
    """
    table = decode_table(pixels.dtype, encoding)
    if pixels.dtype == np.uint8:
        return np.stack([cv2.LUT(plane, table) for plane in cv2.split(pixels)])
    return np.stack([table[plane] for plane in cv2.split(pixels)])


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame(Generic[T]):
    """A frame and what was measured of it."""

    number: int  # number of the frame, from 1
    pixels: PixelArray
    measured: T
    dropped: int  # frames that came since the one measured before, and were not
    per_second: float  # frames measured, of late


class Live(Generic[T]):
    """Measures the newest frame of a source, again and again, in two threads; a context manager.

    >>> import itertools
    >>> import numpy as np
    >>> source = FrameSource("still", itertools.repeat(np.zeros((2, 2, 3), np.uint8)), "linear", 0.01)
    >>> with Live(source, lambda pixels: int(pixels.max())) as live:
    ...     live.newest(0, 5.0).measured
    0
    """

    def __init__(self, source: FrameSource, measure: Callable[[PixelArray], T]) -> None:
        """Take a source, which is closed at the end, and what is to be done with a frame (H, W, 3)."""
        self.source, self._measure = source, measure
        self._changed = threading.Condition()
        self._read: tuple[int, PixelArray] | None = None
        self._done: LiveFrame[T] | None = None
        self._problem: Exception | None = None
        self._ended = self._held = False
        self._asked_s, self._times = time.monotonic(), [time.monotonic()]
        self._threads = [
            threading.Thread(target=self._guarded, args=(work,)) for work in (self._reading, self._working)
        ]

    def __enter__(self) -> Live[T]:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *unused: object) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()
        self.source.close()

    def newest(self, after: int, patience_s: float) -> LiveFrame[T] | None:
        """The newest measured frame beyond number `after`; None if none is in time. Raises BadInput if frames end."""
        with self._changed:
            self._asked_s = time.monotonic()
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._problem or (self._done and self._done.number > after), patience_s)
            if self._problem is not None:
                raise BadInput(f"{self.source.name}: {self._problem}") from self._problem
            return self._done if self._done is not None and self._done.number > after else None

    def hold(self, held: bool) -> None:
        """Stop measuring, or go on: the newest frame stays what it is."""
        with self._changed:
            self._held = held
            self._changed.notify_all()

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception as error:  # whatever it is, the page reports it
            with self._changed:
                self._problem, self._ended = error, True
                self._changed.notify_all()

    def _reading(self) -> None:
        due = time.monotonic()
        for pixels in self.source.frames:
            with self._changed:
                self._read = (self._read[0] if self._read else 0) + 1, pixels
                self._changed.notify_all()
                due = max(due + self.source.period_s, time.monotonic() - 1.0)
                if self._changed.wait_for(lambda: self._ended, max(due - time.monotonic(), 0.0)):
                    return

    def _working(self) -> None:
        number = 0
        while True:
            with self._changed:
                self._changed.wait_for(partial(self._waiting, number))
                if self._ended or self._read is None:
                    return
                last, (number, pixels) = number, self._read
            found = self._measure(pixels)
            self._times = [*self._times[-20:], time.monotonic()]
            rate = (len(self._times) - 1) / max(self._times[-1] - self._times[0], 1e-6)
            with self._changed:
                self._done = LiveFrame(number, pixels, found, number - last - 1, rate)
                self._changed.notify_all()

    def _waiting(self, last: int) -> bool:
        """Whether the end, or a frame after `last`, waits for the one who works."""
        seen = time.monotonic() - self._asked_s < _UNSEEN_S
        return self._ended or (seen and not self._held and self._read is not None and self._read[0] > last)


# Heights of one frame under three colours.

Slopes = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""From images (3, H, W), light over the flat one, to dz/dx and dz/dy (2, H, W), y up, and their deviation (H, W)."""
_DARK = 0.004  # linear light below which a flat photograph counts as unlit: one step of 8 bits
_GRAIN_PX = 2.0
"""Standard deviation of the blur of a flat frame: its noise, and a coat's grain and dust, which move with the gel."""
_EDGE = 0.04
"""Width of the strip along the frame's border whose median height is zero, as a fraction of the frame's sides."""
_SLOW_MM = 0.5  # standard deviation of the mean that is not relief in a result
_SAME_SHAPE = 0.01  # by which the ratio of a frame's sides may differ from the calibration's


@dataclass(frozen=True, slots=True, eq=False)
class LiveHeights:
    """What was measured of a frame."""

    height_um: FloatArray  # (H, W), towards the camera; zero is the median along the frame's edge
    gradient: FloatArray  # (2, H, W): dz/dx, dz/dy, y up
    deviation: FloatArray  # (H, W): of a slope
    markers: BoolArray  # (H, W): pixels that markers cover, bridged
    albedo: FloatArray  # (H, W): mean of the colours' light over the flat frame's
    pitch_mm: float
    times_ms: dict[str, float]  # what each stage took

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
    """Measures frames of one camera; give it to :class:`splitknit_rig.capture.live.Live`.

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
        """`size`: rows and columns of the calibration; `marker_px`: diameter of the printed dots, 0: none."""
        self._slopes, self._pitch_um, self._size = slopes, 1000.0 * pitch_mm, size
        self._encoding, self._marker_px = encoding, marker_px
        self._over_flat: FloatArray | None = None

    def take_flat(self, pixels: PixelArray) -> None:
        """Take a frame (H, W, 3) of the empty gel. BadInput if it is dark or its sides' ratio not the calibration's."""
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
        """Measure a frame (H, W, 3) as stored; the first is the flat one unless one was taken. See `take_flat`."""
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


# What the live page is answered: the newest frame, its heights, and what its buttons do.


_PATIENCE_S = 2.0  # a request for a newer frame is answered after so long at the latest, without one
_JPEG_QUALITY = 85
_MARKED = (255, 0, 200)  # colour over markers, RGB


class LiveService:
    """Answers about one live stream, also to several threads. `live` measures
    :class:`splitknit_rig.capture.live.LiveHeights`, or is None without a calibration; `facts` describe it; `actions`
    are the page's buttons by name: of the newest frame to one sentence.
    """

    def __init__(
        self, live: Live[Any], facts: dict[str, Any], actions: dict[str, Callable[[LiveFrame[Any]], str]]
    ) -> None:
        """Take the stream, which the caller starts and ends."""
        self._live, self._facts, self._actions = live, facts, actions
        levels = np.arange(256) / 255.0
        self._eye = np.rint(255 * (srgb_code(levels) if live.source.encoding == "linear" else levels)).astype(np.uint8)

    def answer(self, path: str, query: Query) -> Reply:
        """Answer a request to read. Raises BadInput if there is nothing at `path`, or the stream has ended."""
        if path in static_files():
            return static_file(path)
        match path:
            case "":
                return static_file("live.html")
            case "api/live":
                return json_reply({**self._facts, "source": self._live.source.name, "actions": sorted(self._actions)})
            case "api/live/frame":
                after = query.get("after", "0")
                require(after.isascii() and after.isdigit() and len(after) < 16, "after= takes a frame's number.")
                return self._frame(self._live.newest(int(after), _PATIENCE_S))
        raise BadInput("there is nothing at this address.")

    def act(self, path: str, query: Query) -> Reply:
        """Do what a button of the page stands for. Raises BadInput if there is none, or it cannot be done."""
        name = path.removeprefix("api/live/")
        if name == "hold":
            self._live.hold(query.get("on") == "1")
            return json_reply({"done": "frozen" if query.get("on") == "1" else "live"})
        require(path.startswith("api/live/") and name in self._actions, "there is no such action.")
        frame = self._live.newest(0, _PATIENCE_S)
        require(frame is not None, "there is no frame yet; try again.")
        assert frame is not None
        return json_reply({"done": self._actions[name](frame)})

    def _frame(self, frame: LiveFrame[Any] | None) -> Reply:
        """Facts in the header X-Frame; heights in um, (H, W) little-endian float32, if measured; photograph, JPEG."""
        if frame is None:
            return Reply("application/octet-stream", 0, [b""])
        found = frame.measured
        heights = np.empty((0, 0)) if found is None else found.height_um
        facts = {"number": frame.number, "dropped": frame.dropped, "per_second": round(frame.per_second, 1)}
        facts |= {"rows": heights.shape[0], "columns": heights.shape[1], **({} if found is None else found.facts())}
        content = heights.astype("<f4").tobytes() + self._photograph(frame)
        # in pieces it is not compressed: on the loopback address that costs more than it saves
        return Reply("application/octet-stream", len(content), [content], {"X-Frame": json.dumps(facts)})

    def _photograph(self, frame: LiveFrame[Any]) -> bytes:
        small: Any = frame.pixels
        if small.dtype != np.uint8:
            small = cv2.convertScaleAbs(small, alpha=1 / 257)
        if frame.measured is not None:
            markers = frame.measured.markers
            small = cv2.resize(small, markers.shape[::-1], interpolation=cv2.INTER_AREA)
            small[markers] = _MARKED
        small = cv2.LUT(small, self._eye)
        picture: Any = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
        return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
