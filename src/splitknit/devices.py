"""What a camera and a bank of LEDs must do, whoever makes them: a Raspberry Pi's hardware, or the digital twin.

One suite of contract tests (``tests/capture/contract.py``) holds for every implementation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from splitknit.types import PixelArray


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One photograph as the sensor gave it."""

    pixels: PixelArray
    """(H, W, C) integers, C = 1 or 3, linear."""
    exposure_s: float
    gain: float
    black_level: float = 0.0
    """Stored value of no light."""
    at_s: float = 0.0
    """When the exposure ended, on a clock that only runs forward."""


@dataclass(frozen=True, slots=True)
class ExposureRange:
    """What a camera can be set to."""

    shortest_s: float
    longest_s: float
    lowest_gain: float
    highest_gain: float


class Camera(Protocol):
    """A camera whose exposure, gain and white balance stay as they are set.

    Every frame that :meth:`capture` returns was exposed wholly after the call. Also a context manager that closes.
    """

    @property
    def image_size(self) -> tuple[int, int]:
        """Rows, columns of :meth:`capture`."""

    @property
    def exposures(self) -> ExposureRange:
        """What :meth:`lock` accepts."""

    def lock(self, exposure_s: float, gain: float) -> None:
        """Fix exposure and gain for all further frames.

        Raises
        ------
        BadInput
            If they are outside :attr:`exposures`.
        """

    def capture(self) -> Frame:
        """Take one photograph of full size with the locked exposure."""

    def preview(self) -> Frame:
        """Take a small photograph quickly, for focus and exposure, with the same exposure."""

    def close(self) -> None:
        """Give the hardware back; may be called twice."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class LightBank(Protocol):
    """LEDs that are switched one at a time; all are off after construction, an exception, an interrupt and closing.

    Also a context manager that switches all off and closes.
    """

    @property
    def count(self) -> int:
        """Number of LEDs, in the order of the rig file."""

    @property
    def lit(self) -> frozenset[int]:
        """LEDs that are on."""

    @property
    def settle_s(self) -> float:
        """Time that an LED needs from the switch to full brightness; :meth:`on` returns after it."""

    def on(self, led: int) -> None:
        """Switch every other LED off, then `led` on, and wait until it has settled.

        Raises
        ------
        BadInput
            If there is no such LED.
        """

    def on_together(self, leds: Sequence[int]) -> None:
        """Light several LEDs at once: only this call ever does."""

    def off(self) -> None:
        """Switch all LEDs off; may be called at any time."""

    def close(self) -> None:
        """Switch all off and give the hardware back; may be called twice."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def relative_exposure(frame: Frame) -> float:
    """Exposure time times gain, by which light is divided."""
    return float(np.float64(frame.exposure_s) * frame.gain)
