"""Data of the circuit's parts, as their data sheets give it, and the values that resistors are sold in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.errors import require

E24 = (
    1.0,
    1.1,
    1.2,
    1.3,
    1.5,
    1.6,
    1.8,
    2.0,
    2.2,
    2.4,
    2.7,
    3.0,
    3.3,
    3.6,
    3.9,
    4.3,
    4.7,
    5.1,
    5.6,
    6.2,
    6.8,
    7.5,
    8.2,
    9.1,
)
"""Preferred numbers of IEC 60063 for 5 %; every maker has them at 1 % too."""
RATINGS_W = (0.25, 0.6, 1.0, 2.0, 3.0)
"""Powers that leaded resistors are sold for."""


@dataclass(frozen=True, slots=True)
class LedPart:
    """A light-emitting diode at the current it is meant for."""

    name: str
    """What parts list and netlist call it."""
    forward_v: float
    """Typical forward voltage."""
    spread_v: float
    """Half the range of the forward voltage over a lot and over temperature."""
    current_a: float
    """The current that is wanted."""
    limit_a: float
    """Largest continuous current."""


@dataclass(frozen=True, slots=True)
class Transistor:
    """An NPN transistor."""

    name: str
    """What parts list, netlist and drawing call it."""
    gain: tuple[float, float]
    """Smallest and largest DC current gain near 100 mA."""
    base_v: tuple[float, float]
    """Smallest and largest base-emitter voltage near 100 mA, over 10 to 60 degrees Celsius."""
    saturation_v: tuple[float, float]
    """Smallest and largest collector-emitter voltage when it is fully on at 100 mA and a tenth of that in the base."""
    limit_a: float
    """Largest continuous collector current."""
    limit_w: float
    """Dissipation at 50 degrees Celsius around it."""


@dataclass(frozen=True, slots=True)
class Gpio:
    """An output of the Raspberry Pi's processor."""

    high_v: tuple[float, float]
    """Smallest and largest voltage of a high output at the currents drawn here."""
    limit_a: float
    """Largest current of one output."""


WHITE_LED = LedPart("white, 0.5 W", 4.0, 0.2, 0.1, 0.12)
NIR_LED = LedPart("850 nm", 1.6, 0.15, 0.1, 0.12)
BC337 = Transistor("BC337-40", (250.0, 630.0), (0.66, 0.85), (0.05, 0.25), 0.8, 0.5)
RASPBERRY_PI = Gpio((3.15, 3.40), 0.008)
"""3.3 V +-3 %, less what a driver of 8 mA drops (about 40 ohms at a few mA)."""


def preferred(ohm: float, *, up: bool = True) -> float:
    """Return the nearest E24 value that is not below (`up`), or not above, `ohm`.

    Raises
    ------
    BadInput
        If `ohm` is not positive.

    Examples
    --------
    >>> preferred(25.1), preferred(25.1, up=False)
    (27.0, 24.0)
    """
    require(bool(np.isfinite(ohm)) and ohm > 0, f"a resistance must be a positive number, but it is {ohm} ohms.")
    decade = 10.0 ** np.floor(np.log10(ohm))
    values = [float(f"{decade * factor * scale:.3g}") for scale in (0.1, 1.0, 10.0) for factor in E24]
    fitting = [v for v in values if (v >= ohm * (1 - 1e-9) if up else v <= ohm * (1 + 1e-9))]
    return min(fitting) if up else max(fitting)


def rating_for(power_w: float, margin: float) -> float:
    """Return the smallest rating that `power_w` uses no more than the share `margin` of.

    Raises
    ------
    BadInput
        If no leaded resistor is large enough.
    """
    for rating in RATINGS_W:
        if power_w <= margin * rating:
            return rating
    require(
        False,
        f"a resistor would turn {power_w:.2g} W into heat, more than {margin:.0%} of any rating; lower the supply.",
    )
    raise AssertionError
