"""Which line switches which LED."""

from dataclasses import replace

import pytest

from refusals import bad_input
from splitknit.nominal import default_rig
from splitknit_rig.capture.pins import DEFAULT_PINS, led_names, pins_of


def with_pins(pins):
    return replace(default_rig(), provenance={"pins": pins})


def test_default_lines_are_fourteen_pulled_down_and_free():
    lines = pins_of(default_rig())
    assert len(set(lines)) == 14
    assert lines == DEFAULT_PINS["white"] + DEFAULT_PINS["nir"]
    assert set(lines).isdisjoint({*range(9), 9, 10, 11, 14, 15})  # pulled up, SPI, UART


def test_the_rig_file_assigns_the_lines():
    rig = with_pins({"white": [4, 5, 6, 7, 8, 9, 10], "nir": [21, 22, 23, 24, 25, 26, 27]})
    assert pins_of(rig) == (4, 5, 6, 7, 8, 9, 10, 21, 22, 23, 24, 25, 26, 27)
    mixed = replace(rig, leds=(rig.leds[7], rig.leds[0], rig.leds[8]))
    assert pins_of(mixed) == (21, 4, 22)
    assert led_names(mixed) == ("nir 0", "white 0", "nir 1")


@pytest.mark.parametrize(
    ("pins", "words"),
    [
        ({"white": [4, 5, 6]}, "3 lines.*LED 3 is white LED number 3"),
        ({"white": [4] * 7, "nir": [21, 22, 23, 24, 25, 26, 27]}, "GPIO 4 to two LEDs"),
        ({"white": [0, 1, 2, 3, 4, 5, 6], "nir": [21, 22, 23, 24, 25, 26, 27]}, "white.*2 to 27"),
        ({"white": "17"}, "white.*list"),
        ({"white": [17.0] * 7}, "white.*list"),
        ([17, 18], "provenance.pins"),
    ],
)
def test_wrong_lines_are_refused(pins, words):
    with bad_input(words):
        pins_of(with_pins(pins))
