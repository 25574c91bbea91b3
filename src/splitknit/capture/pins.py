"""Which GPIO line of the Raspberry Pi switches which LED.

Lines are named by their BCM numbers, as gpiozero does. The map of a built rig is in its rig file::

    "provenance": {"pins": {"white": [17, 27, 22, 13, 19, 26, 21], "nir": [18, 23, 24, 25, 12, 16, 20]}}

Of the 28 lines of the 40-pin header the default leaves free: 0 and 1 (ID EEPROM), 2 and 3 (I2C, with fixed pull-ups),
14 and 15 (UART), 7 to 11 (SPI), and 4 to 6, because lines 0 to 8 are pulled *up* until a program takes them: an LED
there would glow while the Pi boots. What is left are exactly 14 lines that are pulled down at power-on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from splitknit.errors import require
from splitknit.model import Rig

WHITE_PINS = (17, 27, 22, 13, 19, 26, 21)
"""BCM lines of white LEDs 0 to 6 (header pins 11, 13, 15, 33, 35, 37, 40)."""
NIR_PINS = (18, 23, 24, 25, 12, 16, 20)
"""BCM lines of NIR LEDs 0 to 6 (header pins 12, 16, 18, 22, 32, 36, 38)."""
DEFAULT_PINS: Mapping[str, tuple[int, ...]] = {"white": WHITE_PINS, "nir": NIR_PINS}
USABLE = range(2, 28)
"""Lines that a rig may use; 0 and 1 belong to the ID EEPROM."""


def pins_of(rig: Rig) -> tuple[int, ...]:
    """BCM lines of the rig's LEDs, in the order of the rig file.

    LED number k of a band has the k-th line of that band, from the rig file or else by default.

    Raises
    ------
    BadInput
        If the map has too few lines, a line twice, or one that cannot be used.
    """
    given = rig.provenance.get("pins", DEFAULT_PINS)
    require(
        isinstance(given, Mapping),
        'provenance.pins of the rig file must be like {"white": [7 numbers], "nir": [7 numbers]}.',
    )
    pins: list[int] = []
    for index, (band, k) in enumerate(_numbered(rig)):
        lines = given.get(band)
        require(
            isinstance(lines, Sequence)
            and not isinstance(lines, str)
            and all(type(line) is int and line in USABLE for line in lines),
            f"provenance.pins.{band} of the rig file must be a list of GPIO numbers (BCM, 2 to 27); "
            "'splitknit rig circuit' writes it.",
        )
        assert lines is not None
        require(
            k < len(lines),
            f"provenance.pins.{band} of the rig file has {len(lines)} lines, but LED {index} is {band} LED "
            f"number {k}; add its line.",
        )
        pins.append(lines[k])
    for pin in pins:
        require(pins.count(pin) == 1, f"provenance.pins of the rig file gives GPIO {pin} to two LEDs; correct it.")
    return tuple(pins)


def led_names(rig: Rig) -> tuple[str, ...]:
    """Names of the rig's LEDs for people: band, and number within the band as in the files' names."""
    return tuple(f"{band} {k}" for band, k in _numbered(rig))


def _numbered(rig: Rig) -> list[tuple[str, int]]:
    """Band of each LED, and its number within the band."""
    bands = [led.band for led in rig.leds]
    return [(band, bands[:index].count(band)) for index, band in enumerate(bands)]
