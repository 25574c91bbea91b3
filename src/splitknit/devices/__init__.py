"""What a camera and a bank of LEDs must do, whoever makes them: a Raspberry Pi's hardware, or the digital twin.

One suite of contract tests (``tests/capture/contract.py``) holds for every implementation. What keeps LEDs from staying
lit is written once, in :class:`splitknit.devices.guard.GuardedLights`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from splitknit.errors import require
from splitknit.model import PixelArray


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
    """Frames that the camera gave before this one and that were thrown away: stale, or not yet as locked."""


@dataclass(frozen=True, slots=True)
class ExposureRange:
    """What a camera can be set to."""

    shortest_s: float
    longest_s: float
    lowest_gain: float
    highest_gain: float

    def check(self, exposure_s: float, gain: float) -> None:
        """Refuse an exposure outside the range.

        Raises
        ------
        BadInput
            Naming the quantity and the range.
        """
        slack = 1e-9
        require(
            bool(np.isfinite(exposure_s))
            and self.shortest_s * (1 - slack) <= exposure_s <= self.longest_s * (1 + slack),
            f"the camera exposes for {1e3 * self.shortest_s:g} to {1e3 * self.longest_s:g} ms, "
            f"but {1e3 * exposure_s:g} ms were asked for.",
        )
        require(
            bool(np.isfinite(gain)) and self.lowest_gain * (1 - slack) <= gain <= self.highest_gain * (1 + slack),
            f"the camera's gain is {self.lowest_gain:g} to {self.highest_gain:g}, but {gain:g} was asked for.",
        )


class Camera(Protocol):
    """A camera whose exposure, gain and white balance stay as they are set.

    Every frame that :meth:`capture` and :meth:`preview` return was exposed wholly after the call, with what was locked.
    Also a context manager that closes.
    """

    @property
    def image_size(self) -> tuple[int, int]:
        """Rows, columns of :meth:`capture`."""

    @property
    def exposures(self) -> ExposureRange:
        """What :meth:`lock` accepts."""

    def lock(self, exposure_s: float, gain: float, band: str = "white") -> None:
        """Fix exposure, gain and white balance for all further frames.

        Parameters
        ----------
        exposure_s, gain : within :attr:`exposures`
        band : ``white`` or ``nir``, whose LEDs a white card is white under

        Raises
        ------
        BadInput
            If they are outside :attr:`exposures`, or there is no such band.
        """

    def capture(self) -> Frame:
        """Take one photograph of full size with the locked exposure."""

    def preview(self) -> Frame:
        """Take a small photograph of the whole field quickly, for exposure, with the same exposure."""

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
            If there is no such LED, or the bank is closed.
        """

    def on_together(self, leds: Sequence[int]) -> None:
        """Light several LEDs at once: only this call ever does."""

    def off(self) -> None:
        """Switch all LEDs off and wait until they are dark; may be called at any time."""

    def close(self) -> None:
        """Switch all off and give the hardware back; may be called twice."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def relative_exposure(frame: Frame) -> float:
    """Exposure time times gain, by which light is divided."""
    return float(np.float64(frame.exposure_s) * frame.gain)
