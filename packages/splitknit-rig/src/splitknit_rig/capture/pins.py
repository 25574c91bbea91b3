"""GPIO lines of the Raspberry Pi that switch the LEDs, and that turn the film in front of the
camera.

Lines are named by their BCM numbers, as gpiozero does. The map of a built rig is in its rig file::

    "provenance": {"pins": {"white": [17, 27, 22, 13, 19, 26, 21], "nir": [18, 23, 24, 25, 12, 16,
    20]}}

Of the 28 lines of the 40-pin header the default leaves free: 0 and 1 (ID EEPROM), 2 and 3 (I2C,
with fixed pull-ups), 14 and 15 (UART), 7 to 11 (SPI), and 4 to 6, because lines 0 to 8 are pulled
*up* until a program takes them: an LED there would glow while the Pi boots. What is left are
exactly 14 lines that are pulled down at power-on.

A rig with polarising films says so beside its pins, as one of::

    "films": {"kind": "servo", "servo": 4, "pulses_ms": [2.0, 1.0]}
    "films": {"kind": "hand"}
    "films": {"kind": "neighbours", "crossed": [14, 15, 16, 17, 18, 19, 20]}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from splitknit import Rig
from splitknit.errors import require

WHITE_PINS = (17, 27, 22, 13, 19, 26, 21)
"""BCM lines of white LEDs 0 to 6 (header pins 11, 13, 15, 33, 35, 37, 40).

Source: definition of the LED board.
"""
NIR_PINS = (18, 23, 24, 25, 12, 16, 20)
"""BCM lines of NIR LEDs 0 to 6 (header pins 12, 16, 18, 22, 32, 36, 38).

Source: definition of the LED board.
"""
# lines of the first LED board
DEFAULT_PINS: Mapping[str, tuple[int, ...]] = {"white": WHITE_PINS, "nir": NIR_PINS}
SECOND_PINS = (9, 10, 11, 14, 15, 5, 6)
"""BCM lines of a second LED board, for side lights or for white LEDs with crossed film (header pins
21, 19, 23, 8, 10, 29, 31): SPI, UART, and two that are pulled up and need a stronger pull-down. SPI
and the serial console must be off.

Source: definition of the LED board.
"""
SERVO_PIN = 4
"""BCM line of the analyser's servo (header pin 7). It is pulled up at power-on, which is not a
pulse to a servo.

Source: definition of the LED board.
"""
PULSES_MS = (2.0, 1.0)
"""Pulses of the servo, parallel and crossed: a quarter turn to the left from above, where the shaft
points down.

Source: usual pulses of small servos.
"""
PULLED_UP = range(9)
"""Lines that are pulled up until a program takes them.

Source: pulls of the Raspberry Pi's GPIO lines at power-on.
"""
USABLE = range(2, 28)
"""Lines that a rig may use; 0 and 1 belong to the ID EEPROM.

Source: the Raspberry Pi's header of 40 pins.
"""


def pins_of(rig: Rig) -> tuple[int, ...]:
    """BCM lines of the rig's LEDs: LED k of a band is on the band's k-th line. Raises BadInput for
    a map with too few lines, a line twice, or one that cannot be used.
    """
    by_band = rig.provenance.get("pins", {"white": WHITE_PINS + SECOND_PINS, "nir": NIR_PINS})
    form = (
        'provenance.pins of the rig file must be like {"white": [7 numbers], "nir": [7 numbers]}.'
    )
    require(isinstance(by_band, Mapping), form)
    pins: list[int] = []
    for index, (band, k) in enumerate(_numbered(rig)):
        lines = by_band.get(band)
        require(
            isinstance(lines, Sequence)
            and not isinstance(lines, str)
            and all(type(line) is int and line in USABLE for line in lines),
            f"provenance.pins.{band} of the rig file must be a list of GPIO numbers (BCM, 2 to 27);"
            " hardware/files/board/rig.json has it.",
        )
        assert lines is not None
        require(
            k < len(lines),
            f"provenance.pins.{band} of the rig file has {len(lines)} lines, but LED {index} is"
            f" {band} LED number {k}; add its line.",
        )
        pins.append(lines[k])
    for pin in pins:
        require(
            pins.count(pin) == 1,
            f"provenance.pins of the rig file gives GPIO {pin} to two LEDs; correct it.",
        )
    return tuple(pins)


@dataclass(frozen=True, slots=True)
class RigFilms:
    """Linear films in front of the white LEDs and, as the analyser, in front of the camera."""

    # ``servo``, ``hand`` (what turns the analyser), or ``neighbours`` (the crossed series has its
    # own LEDs)
    kind: str
    # the rig's LEDs of the crossed series, in the order of the parallel one
    crossed: tuple[int, ...]
    servo: int = SERVO_PIN
    pulses_ms: tuple[float, float] = PULSES_MS


def rig_films(rig: Rig) -> RigFilms | None:
    """Films of a rig from its file's ``provenance.films``; None if it has none. Raises BadInput if
    their kind is unknown."""
    films = rig.provenance.get("films")
    if films is None:
        return None
    kind = films.get("kind") if isinstance(films, Mapping) else None
    require(
        kind in ("servo", "hand", "neighbours"),
        'provenance.films of the rig file must have the kind "servo", "hand" or "neighbours"; '
        "'python -m hardware.circuit' writes it.",
    )
    white = tuple(k for k, led in enumerate(rig.leds) if led.band == "white")
    if kind == "neighbours":
        crossed = films.get("crossed")
        require(
            isinstance(crossed, Sequence)
            and all(type(led) is int and led in white for led in crossed)
            and 2 * len(set(crossed)) == 2 * len(crossed) == len(white),
            f"provenance.films.crossed of the rig file must list half of its {len(white)} white"
            " LEDs, those with crossed film, in the order of the others.",
        )
        return RigFilms(str(kind), tuple(crossed))
    servo, pulses_ms = films.get("servo", SERVO_PIN), films.get("pulses_ms", PULSES_MS)
    require(
        type(servo) is int and servo in USABLE and (kind == "hand" or servo not in pins_of(rig)),
        "provenance.films.servo of the rig file must be a GPIO number (BCM, 2 to 27) that no LED"
        f" has, not {servo!r}.",
    )
    require(
        isinstance(pulses_ms, Sequence)
        and len(pulses_ms) == 2
        and all(type(pulse) in (int, float) and 0.3 <= pulse <= 3.0 for pulse in pulses_ms)
        and pulses_ms[0] != pulses_ms[1],
        "provenance.films.pulses_ms of the rig file must be two different numbers of 0.3 to 3, the"
        f" servo's pulses in the parallel and in the crossed position, not {pulses_ms!r}.",
    )
    return RigFilms(str(kind), white, servo, (float(pulses_ms[0]), float(pulses_ms[1])))


def led_names(rig: Rig) -> tuple[str, ...]:
    """Names of the rig's LEDs for people: band, and number within the band as in the files'
    names."""
    return tuple(f"{band} {k}" for band, k in _numbered(rig))


def _numbered(rig: Rig) -> list[tuple[str, int]]:
    """Band of each LED, and its number within the band."""
    bands = [led.band for led in rig.leds]
    return [(band, bands[:index].count(band)) for index, band in enumerate(bands)]
