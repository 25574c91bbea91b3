"""The transistor stages that switch the LEDs: values from the parts' data, every margin checked at
its worst corner.

Two stages are offered. In ``sink`` the emitter resistor sets the current: the GPIO's 3.3 V less the
base-emitter voltage stands over it, whatever the supply and the LED's forward voltage do.
Photometric stereo wants just this, the same light every time. In ``switch``, the thesis's stage
(its figure 4.4), the transistor is fully on and a resistor in series with the LED sets the current,
so that supply and forward voltage show in the light.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from types import SimpleNamespace

import numpy as np

from splitknit.errors import require

# Data of the circuit's parts, as their data sheets give it, and the values that resistors are sold
# in.

E24 = (
    1.0, 1.1, 1.2, 1.3, 1.5, 1.6, 1.8, 2.0, 2.2, 2.4, 2.7, 3.0,
    3.3, 3.6, 3.9, 4.3, 4.7, 5.1, 5.6, 6.2, 6.8, 7.5, 8.2, 9.1,
)  # fmt: skip
"""Preferred numbers of IEC 60063 for 5 %; every maker has them at 1 % too."""
RATINGS_W = (0.25, 0.6, 1.0, 2.0, 3.0)  # powers that leaded resistors are sold for


GPIO_HIGH_V = (3.15, 3.40)
"""High level of an output of the Pi's processor: 3.3 V +-3 % less a driver's drop (about 40
ohms)."""
GPIO_LIMIT_A = 0.008
"""Largest current of such an output."""


def _preferred(ohm: float, *, up: bool = True) -> float:
    """The nearest E24 value not below (`up`), or not above, the resistance: of 25.1 ohm 27, or
    24."""
    require(
        bool(np.isfinite(ohm)) and ohm > 0,
        f"a resistance must be a positive number, but it is {ohm} ohms.",
    )
    decade = 10.0 ** np.floor(np.log10(ohm))
    values = [
        float(f"{decade * factor * scale:.3g}") for scale in (0.1, 1.0, 10.0) for factor in E24
    ]
    fitting = [v for v in values if (v >= ohm * (1 - 1e-9) if up else v <= ohm * (1 + 1e-9))]
    return min(fitting) if up else max(fitting)


def _rating_for(power_w: float) -> float:
    """Return the smallest rating that `power_w` uses no more than `_MAX_HEAT` of, or raise
    BadInput."""
    too_much = (
        f"a resistor would turn {power_w:.2g} W into heat, more than {_MAX_HEAT:.0%} of any rating"
    )
    require(power_w <= _MAX_HEAT * RATINGS_W[-1], f"{too_much}; lower the supply.")
    return next(rating for rating in RATINGS_W if power_w <= _MAX_HEAT * rating)


MIN_HEADROOM_V = 0.5  # voltage that a current sink's transistor must keep to be one
FORCED_GAIN = 20.0
"""A switching transistor gets this fraction of its collector current in the base, far more than its
gain requires."""
# fraction of its rating that a part may turn into heat when its LED stays on for ever
_MAX_HEAT = 0.6
_MIN_CURRENT = 0.7  # smallest current in the worst corner, over the wanted one
# from every line to ground: LEDs are off while no Pi is connected or none has been started
_PULL_DOWN_OHM = 100_000.0


@dataclass(frozen=True, slots=True)
class Resistor:
    """One resistor of a stage."""

    role: str  # ``base``, ``emitter``, ``series`` or ``pull_down``
    ohm: float
    rating_w: float
    heat_w: float  # in the worst corner, LED on for ever


@dataclass(frozen=True, slots=True)
class Stage:
    """One LED's stage, and what it does at its corners."""

    band: str
    led: SimpleNamespace
    resistors: tuple[Resistor, ...]
    current_a: tuple[float, float, float]  # current of the LED: smallest, typical, largest
    gpio_a: float  # largest current of the GPIO line, LED supply connected
    gpio_fault_a: float  # the same with the LED supply missing
    transistor_w: float  # largest dissipation
    # largest current of the LED with a transistor that is shorted from collector to emitter
    shorted_a: float


@dataclass(frozen=True, slots=True)
class Channel:
    """One LED's stage on the board."""

    name: str  # name of the LED, such as ``white 3``
    gpio: int
    stage: Stage
    number: int  # from 1, in the order of the rig file


@dataclass(frozen=True, slots=True)
class Circuit:
    """The stages of a rig's LEDs, and their fuse."""

    settings: SimpleNamespace
    channels: tuple[Channel, ...]
    # current that the resettable fuse carries for ever; at twice that, with a few LEDs on together,
    # it opens
    fuse_a: float
    misfit: str  # why the LED board cannot carry this circuit; empty where it can


def design_stage(band: str, settings: SimpleNamespace) -> Stage:
    """Choose the resistors of a band's stage and check all margins at the worst corners; BadInput
    names the margin missed and the remedy. Source: P. Horowitz and W. Hill, The Art of Electronics,
    3rd edition, 2.2.1 and 2.2.6.
    """
    led = settings.white if band == "white" else settings.nir
    stage = (
        _sink(band, led, settings) if settings.topology == "sink" else _switch(band, led, settings)
    )
    _check(stage, settings)
    return stage


def _sink(band: str, led: SimpleNamespace, s: SimpleNamespace) -> Stage:
    t, high = s.transistor, GPIO_HIGH_V
    # with the supply missing, the base feeds the emitter resistor: the base resistor limits what
    # the line gives
    typical_drop = sum(high) / 2 - sum(t.base_v) / 2
    min_total = (high[1] - t.base_v[0]) / (0.9 * GPIO_LIMIT_A)
    base = _preferred(max(min_total - typical_drop / led.current_a, 47.0))
    emitter = _preferred(typical_drop / led.current_a - base / (sum(t.gain) / 2))
    min_v, max_v = s.supply_v * (1 - s.supply_spread), s.supply_v * (1 + s.supply_spread)

    def current(high_v: float, base_v: float, gain: float, spread: float) -> float:
        return (high_v - base_v) / (emitter * (1 + spread) + base / (gain + 1)) * gain / (gain + 1)

    corners = [
        current(*c)
        for c in product(high, t.base_v, t.gain, (-s.resistor_spread, s.resistor_spread))
    ]
    low = min(corners)
    top = max(corners)
    middle = current(sum(high) / 2, sum(t.base_v) / 2, sum(t.gain) / 2, 0.0)
    over_emitter = top * emitter * (1 + s.resistor_spread) * (1 + 1 / t.gain[0])
    spare = min_v - led.forward_v - led.spread_v - over_emitter - MIN_HEADROOM_V
    enough = np.ceil(10 * (min_v - spare) / (1 - s.supply_spread)) / 10
    require(
        spare >= 0,
        f"{s.supply_v:g} V are too little for the {band} LEDs: {min_v - spare:.2g} V are needed for"
        f" LED, transistor and emitter resistor; set circuit.supply_v to {enough:.1f} or more, or"
        " circuit.topology to switch.",
    )
    # what is to spare heats a resistor rather than the transistor
    series = _preferred(spare / top, up=False) if spare / top >= 1.0 else 0.0
    over_led = led.forward_v - led.spread_v
    heat = max(i * (max_v - over_led - i * (emitter + series)) for i in (low, middle, top))
    resistors = _resistors(
        base=(base, 0.0),
        emitter=(emitter, top * top * emitter),
        series=(series, top * top * series),
    )
    line = top / min(t.gain) + high[1] / _PULL_DOWN_OHM
    fault = (high[1] - t.base_v[0]) / ((base + emitter) * (1 - s.resistor_spread))
    shorted = (max_v - over_led) / ((emitter + series) * (1 - s.resistor_spread))
    return Stage(band, led, resistors, (low, middle, top), line, fault, heat, shorted)


def _switch(band: str, led: SimpleNamespace, s: SimpleNamespace) -> Stage:
    t, high = s.transistor, GPIO_HIGH_V
    min_v, max_v = s.supply_v * (1 - s.supply_spread), s.supply_v * (1 + s.supply_spread)
    saturated = sum(t.saturation_v) / 2
    headroom = s.supply_v - led.forward_v - saturated
    require(
        min_v - led.forward_v - led.spread_v - t.saturation_v[1] > 0,
        f"{s.supply_v:g} V are too little for the {band} LEDs of {led.forward_v:g} V; set"
        " circuit.supply_v higher.",
    )
    series = _preferred(headroom / led.current_a)
    base = _preferred((high[0] - t.base_v[1]) / (led.current_a / FORCED_GAIN), up=False)

    def current(supply_v: float, forward_v: float, saturation_v: float, spread: float) -> float:
        return (supply_v - forward_v - saturation_v) / (series * (1 + spread))

    voltages = (led.forward_v - led.spread_v, led.forward_v + led.spread_v)
    spreads = (-s.resistor_spread, s.resistor_spread)
    corners = [current(*c) for c in product((min_v, max_v), voltages, t.saturation_v, spreads)]
    top = max(corners)
    line = (high[1] - t.base_v[0]) / (base * (1 - s.resistor_spread)) + high[1] / _PULL_DOWN_OHM
    resistors = _resistors(base=(base, line * line * base), series=(series, top * top * series))
    heat = top * t.saturation_v[1] + line * t.base_v[1]
    shorted = (max_v - voltages[0]) / (series * (1 - s.resistor_spread))
    return Stage(
        band, led, resistors, (min(corners), headroom / series, top), line, line, heat, shorted
    )


def _resistors(**parts: tuple[float, float]) -> tuple[Resistor, ...]:
    """Resistances that are not zero and their heat, by role, and the pull-down."""
    wanted = {**parts, "pull_down": (_PULL_DOWN_OHM, 0.0)}
    return tuple(
        Resistor(role, ohm, _rating_for(heat), heat) for role, (ohm, heat) in wanted.items() if ohm
    )


def _check(stage: Stage, s: SimpleNamespace) -> None:
    t, led = s.transistor, stage.led
    low, _, top = stage.current_a
    which = f"the {stage.band} stage"
    remedy = "take another LED current or a transistor with less spread."
    if s.topology == "switch":
        remedy = (
            "a higher circuit.supply_v makes it less dependent on the LED's voltage, or set"
            " circuit.topology to "
        )
        remedy += "sink."
    require(
        s.topology == "sink" or 0.5 * t.gain[0] >= FORCED_GAIN,
        f"{which} needs a transistor with a gain of at least {2 * FORCED_GAIN:.0f} to be fully on.",
    )
    drives = (
        f"{which} would drive up to {1000 * top:.0f} mA through an LED of"
        f" {1000 * led.limit_a:.0f} mA"
    )
    require(top <= led.limit_a, f"{drives}: {remedy}")
    falls = f"{which} would fall to {1000 * low:.0f} mA where {1000 * led.current_a:.0f} are wanted"
    require(low >= _MIN_CURRENT * led.current_a, f"{falls}: {remedy}")
    require(top <= 0.5 * t.limit_a, f"{which} needs a transistor for at least {2000 * top:.0f} mA.")
    require(
        stage.transistor_w <= _MAX_HEAT * t.limit_w,
        f"{which} would heat its transistor with {stage.transistor_w:.2f} W, more than"
        f" {_MAX_HEAT:.0%} of the {t.limit_w:g} W it stands; lower circuit.supply_v or take a"
        " larger transistor.",
    )
    for name, amperes in (
        ("", stage.gpio_a),
        (" while the LED supply is missing", stage.gpio_fault_a),
    ):
        require(
            amperes <= GPIO_LIMIT_A,
            f"{which} would draw {1000 * amperes:.1f} mA from a GPIO line{name}, which gives "
            f"{1000 * GPIO_LIMIT_A:.0f} mA; take a transistor with more gain.",
        )
