"""What a camera and a bank of LEDs must do, whoever makes them: a Raspberry Pi's hardware, or the
digital twin.

One suite of contract tests (``packages/splitknit/tests/contract.py``) holds for every
implementation. What keeps LEDs from staying lit is written once, in :class:`LightBank`.
"""

from __future__ import annotations

import atexit
import os
import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import Any, Self

import numpy as np

from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.model import PixelArray, Rig


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One photograph as the sensor gave it."""

    pixels: PixelArray
    """(H, W, C) integers, C = 1 or 3, linear, full scale is that of the integers."""
    exposure_s: float
    gain: float
    black_level: float = 0.0
    """Stored value of no light."""
    at_s: float = 0.0
    """When the exposure of the last row ended, on a clock that only runs forward."""
    discarded: int = 0
    """Frames that the camera gave before this one and that were thrown away: stale, or not yet as
    locked."""


@dataclass(frozen=True, slots=True)
class ExposureRange:
    """What a camera can be set to."""

    shortest_s: float
    longest_s: float
    lowest_gain: float
    highest_gain: float

    def check(self, exposure_s: float, gain: float) -> None:
        """Refuse an exposure outside the range. Raises BadInput, naming the quantity and the
        range."""
        low = 1e3 * self.shortest_s
        high = 1e3 * self.longest_s
        fits = (1 - 1e-9) * low <= 1e3 * exposure_s <= (1 + 1e-9) * high
        require(
            fits,
            f"the camera exposes for {low:g} to {high:g} ms, but {1e3 * exposure_s:g} ms were asked"
            " for.",
        )
        low = self.lowest_gain
        high = self.highest_gain
        fits = (1 - 1e-9) * low <= gain <= (1 + 1e-9) * high
        require(fits, f"the camera's gain is {low:g} to {high:g}, but {gain:g} was asked for.")


class Closing(ABC):
    """What is given back at the end of a ``with`` block."""

    @abstractmethod
    def close(self) -> None:
        """Give the hardware back; may be called twice."""

    def __enter__(self) -> Self:
        """Return it."""
        return self

    def __exit__(self, *unused: object) -> None:
        """Close."""
        self.close()


class CameraDevice(Closing):
    """A camera whose exposure, gain and white balance stay as set; a context manager that closes.
    Every frame of :meth:`capture` and :meth:`preview` was exposed wholly after the call, with what
    was locked.
    """

    image_size: tuple[int, int]
    """Rows, columns of :meth:`capture`."""
    exposures: ExposureRange
    """What :meth:`lock` accepts."""

    @abstractmethod
    def lock(self, exposure_s: float, gain: float, band: str = "white") -> None:
        """Fix exposure, gain (within :attr:`exposures`) and white balance: a white card is white
        under the LEDs of `band`, ``white`` or ``nir``. Raises BadInput for others.
        """

    @abstractmethod
    def capture(self) -> Frame:
        """Take one photograph of full size with the locked exposure."""

    @abstractmethod
    def preview(self) -> Frame:
        """Take a small photograph of the whole field quickly, for exposure, with the same
        exposure."""


class LightBank(Closing):
    """LEDs, switched one at a time: all off when it is made, its ``with`` block ends, the process
    exits, and before SIGTERM or SIGHUP (where nobody else handles these) end it. SIGKILL and power
    failures are the circuit's: its transistors pull the lines down. The ``__init__`` of a subclass
    calls this one last.
    """

    def __init__(self, count: int, settle_s: float) -> None:
        """Switch all LEDs off and stand guard."""
        require(count >= 1, f"a bank of LEDs needs at least one, but has {count}.")
        require(0 <= settle_s <= 10, f"settle_s must be 0 to 10 s, but it is {settle_s:g}.")
        self.count = count
        """LEDs, in the order of the rig file."""
        self.settle_s = settle_s
        """Time that an LED needs from the switch to full brightness; :meth:`on` returns after
        it."""
        self._lit: set[int] = set(range(count))  # for all we know
        self._closed = False
        atexit.register(self.close)
        _watch(self)
        try:
            self._dark()
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def _switch(self, led: int, lit: bool) -> None:
        """Switch one LED."""

    @abstractmethod
    def _wait(self, seconds: float) -> None:
        """Let time pass."""

    @abstractmethod
    def _release(self) -> None:
        """Give the hardware back; called once, with all LEDs off."""

    @property
    def lit(self) -> frozenset[int]:
        """LEDs that are on."""
        return frozenset(self._lit)

    def on(self, led: int) -> None:
        """Switch every other LED off, then `led` on, and wait until it has settled. BadInput
        without it, or closed."""
        self.on_together((led,))

    def on_together(self, leds: Sequence[int]) -> None:
        """Light several LEDs at once: only this call ever does."""
        require(not self._closed, "the bank of LEDs is closed; open it again.")
        wanted = sorted(set(leds))
        for led in wanted:
            require(
                0 <= led < self.count,
                f"there is no LED {led}; the bank has {self.count}, 0 to {self.count - 1}.",
            )
        require(len(wanted) > 0, "name at least one LED, or switch all off.")
        self._dark(keep=frozenset(wanted))  # before the next is lit: never two at once
        for led in wanted:
            if led not in self._lit:
                self._lit.add(led)  # first: an interrupt here must find it listed
                self._switch(led, True)
        self._wait(self.settle_s)

    def shine(self, led: int, seconds: float) -> None:
        """Light one LED for a time, then switch all off: after an interrupt too."""
        try:
            self.on(led)
            self._wait(seconds)
        finally:
            self.off()

    def off(self) -> None:
        """Switch all LEDs off and wait until they are dark; may be called at any time."""
        if self._closed:
            return
        were_lit = bool(self._lit)
        self._dark()
        if were_lit:
            self._wait(self.settle_s)

    def close(self) -> None:
        """Switch all off and give the hardware back; may be called twice."""
        if self._closed:
            return
        try:
            self._dark()
        finally:
            self._closed = True
            atexit.unregister(self.close)
            _unwatch(self)
            self._release()

    def _dark(self, keep: frozenset[int] = frozenset()) -> None:
        """Switch off all LEDs but `keep`: every one of them is tried, even where another fails."""
        failure: Exception | None = None
        for led in sorted(self._lit - keep):
            try:
                self._switch(led, False)
                self._lit.discard(led)
            except Exception as error:  # the others matter more
                failure = failure or error
        if failure is not None:
            raise failure


Turn = Callable[[str], None]
"""Turns the film before the camera: to ``parallel`` or ``crossed``."""


@dataclass(frozen=True, slots=True, eq=False)
class Opened:
    """Devices that are ready, and what is known about them."""

    name: str  # ``pi`` or ``twin``
    camera: CameraDevice
    lights: LightBank
    rig: Rig
    settings: Mapping[str, Any]  # of the devices, by their names, for ``session.json``
    truth: Mapping[str, Any] | None = None  # what the twin knows of the finger
    findings: tuple[Finding, ...] = ()
    turn: Turn | None = None  # turns the analyser, where the devices can


def relative_exposure(frame: Frame) -> float:
    """Exposure time times gain, by which light is divided."""
    return float(np.float64(frame.exposure_s) * frame.gain)


_DEADLY = (signal.SIGTERM, signal.SIGHUP)
_open_banks: list[LightBank] = []


def _watch(bank: LightBank) -> None:
    """Have `bank` switched off before a signal ends the process."""
    _open_banks.append(bank)
    if threading.current_thread() is threading.main_thread():
        for number in _DEADLY:
            if signal.getsignal(number) == signal.SIG_DFL:
                signal.signal(number, _off_then_die)


def _unwatch(bank: LightBank) -> None:
    if bank in _open_banks:
        _open_banks.remove(bank)
    if not _open_banks and threading.current_thread() is threading.main_thread():
        for number in _DEADLY:
            if signal.getsignal(number) is _off_then_die:
                signal.signal(number, signal.SIG_DFL)


def _off_then_die(number: int, frame: FrameType | None) -> None:
    try:
        for bank in tuple(_open_banks):
            bank.close()
    finally:
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
