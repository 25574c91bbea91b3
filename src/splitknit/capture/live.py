"""Live: the newest frame of a camera, a film or a folder of photographs, and what is measured of it.

One thread reads frames as they come and keeps the last; another measures whatever is newest when it is free. Frames
that come in between are dropped and counted, so that what is shown is never late by more than one measurement.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import cv2
import numpy as np

from splitknit.capture.streams import open_uvc
from splitknit.errors import BadInput, require
from splitknit.imaging.band import decode_table
from splitknit.io.images import read_image
from splitknit.model import FloatArray, PixelArray

T = TypeVar("T")

FILM_FPS = 10.0
"""At which a folder of photographs is played."""
_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
_FASTEST_FPS = 120.0
_UNSEEN_S = 5.0
"""After so long without anybody looking nothing is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameSource:
    """Where frames come from."""

    name: str
    frames: Iterator[PixelArray]
    """(H, W, 3) as stored, red, green, blue; without end."""
    encoding: str
    """``linear`` or ``srgb``."""
    period_s: float = 0.0
    """Between frames; 0 where the camera sets the pace."""
    close: Callable[[], None] = field(default=lambda: None)
    """Gives the camera back."""


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
    require(bool(good), f"'{path}' is no film that can be read; frames as PNG files in a folder will do.")
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

    number: int
    """Of frames read, from 1."""
    pixels: PixelArray
    measured: T
    dropped: int
    """Frames that came since the one measured before, and were not."""
    per_second: float
    """Frames measured, of late."""


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
        """Return the newest measured frame whose number exceeds `after`; None if none comes in time. Raises BadInput,
        with the reason, if frames end.
        """
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
