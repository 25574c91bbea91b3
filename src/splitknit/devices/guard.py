"""What keeps LEDs from staying lit, for every bank of them."""

from __future__ import annotations

import atexit
import os
import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import FrameType, TracebackType
from typing import Self

from splitknit.errors import require


class Closing(ABC):
    """What is given back at the end of a ``with`` block."""

    @abstractmethod
    def close(self) -> None:
        """Give the hardware back; may be called twice."""

    def __enter__(self) -> Self:
        """Return it."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()


class GuardedLights(Closing):
    """What every :class:`splitknit.devices.LightBank` shares, whatever switches its LEDs: none stays lit.

    All LEDs are switched off when the bank is made, when its ``with`` block ends in whatever way, when the process
    exits, and before SIGTERM or SIGHUP end it (only where nobody else handles these). SIGKILL and a power failure are
    the circuit's business: its transistors pull the lines down.

    A maker's ``__init__`` calls this one last, when its LEDs can be switched.
    """

    def __init__(self, count: int, settle_s: float) -> None:
        """Switch all LEDs off and stand guard."""
        require(count >= 1, f"a bank of LEDs needs at least one, but has {count}.")
        require(0 <= settle_s <= 10, f"settle_s must be 0 to 10 s, but it is {settle_s:g}.")
        self._count, self._settle_s = count, settle_s
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
    def count(self) -> int:
        """See :class:`splitknit.devices.LightBank`."""
        return self._count

    @property
    def lit(self) -> frozenset[int]:
        """See :class:`splitknit.devices.LightBank`."""
        return frozenset(self._lit)

    @property
    def settle_s(self) -> float:
        """See :class:`splitknit.devices.LightBank`."""
        return self._settle_s

    def on(self, led: int) -> None:
        """See :class:`splitknit.devices.LightBank`."""
        self.on_together((led,))

    def on_together(self, leds: Sequence[int]) -> None:
        """See :class:`splitknit.devices.LightBank`."""
        require(not self._closed, "the bank of LEDs is closed; open it again.")
        wanted = sorted(set(leds))
        for led in wanted:
            require(
                0 <= led < self._count,
                f"there is no LED {led}; the bank has {self._count}, 0 to {self._count - 1}.",
            )
        require(len(wanted) > 0, "name at least one LED, or switch all off.")
        self._dark(keep=frozenset(wanted))  # before the next is lit: never two at once
        for led in wanted:
            if led not in self._lit:
                self._lit.add(led)  # first: an interrupt here must find it listed
                self._switch(led, True)
        self._wait(self._settle_s)

    def off(self) -> None:
        """See :class:`splitknit.devices.LightBank`."""
        if self._closed:
            return
        were_lit = bool(self._lit)
        self._dark()
        if were_lit:
            self._wait(self._settle_s)

    def close(self) -> None:
        """See :class:`splitknit.devices.LightBank`."""
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


_DEADLY = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
_open_banks: list[GuardedLights] = []


def _watch(bank: GuardedLights) -> None:
    """Have `bank` switched off before a signal ends the process."""
    _open_banks.append(bank)
    if threading.current_thread() is threading.main_thread():
        for number in _DEADLY:
            if signal.getsignal(number) == signal.SIG_DFL:
                signal.signal(number, _off_then_die)


def _unwatch(bank: GuardedLights) -> None:
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
