"""LEDs on GPIO lines, each through its transistor, by gpiozero."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from splitknit.devices.guard import GuardedLights

SETTLE_S = 0.02
"""Far above what an LED (microseconds), its phosphor (under a millisecond) and its supply (milliseconds) need."""


class PiLightBank(GuardedLights):
    """LEDs on GPIO lines, active high, off from the moment on which the lines become outputs."""

    def __init__(
        self,
        pins: Sequence[int],
        make_line: Callable[..., Any],
        *,
        settle_s: float = SETTLE_S,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Take the lines.

        Parameters
        ----------
        pins : BCM numbers in the order of the rig file's LEDs
        make_line : ``gpiozero.DigitalOutputDevice``, or what behaves like it
        settle_s : time from the switch to full brightness
        sleep : lets time pass
        """
        self._lines: list[Any] = []
        self._sleep = sleep
        try:
            for pin in pins:
                self._lines.append(make_line(pin, active_high=True, initial_value=False))
            super().__init__(len(self._lines), settle_s)
        except BaseException:
            self._release()
            raise

    def _switch(self, led: int, lit: bool) -> None:
        if lit:
            self._lines[led].on()
        else:
            self._lines[led].off()

    def _wait(self, seconds: float) -> None:
        self._sleep(seconds)

    def _release(self) -> None:
        lines, self._lines = self._lines, []
        for line in lines:
            line.close()  # gpiozero makes it an input: the base resistor's pull-down holds the LED off
