"""Coloured LEDs of the twin: three share an exposure, and the sensor mixes what they send."""

from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit.model import COLOURS
from splitknit.nominal import CROSSTALK, default_rig, shared_exposures
from splitknit.observation.observe import observe
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.rigs import coloured_rig
from splitknit_simulator.scene import TwinSettings, exposures_of
from splitknit_simulator.twin import simulate_capture


@pytest.mark.parametrize("exposures", [1, 2, 3])
def test_each_place_has_one_colour_and_colours_stand_around(exposures):
    triples = shared_exposures(exposures)
    count = 3 * exposures
    assert sorted(place for triple in triples for place in triple) == list(range(count))
    angle = 2 * np.pi * np.array(triples) / count
    middle = np.abs(np.exp(1j * angle).mean(axis=0))  # of a colour
    assert exposures == 1 or middle.max() < 1e-9
    assert np.abs(np.exp(1j * angle).mean(axis=1)).max() < 0.6  # of an exposure


def test_the_rig_is_the_thesis_s_but_for_its_white_leds():
    rig, plain = coloured_rig(0.2, 0), default_rig(0.2, 0)
    assert [led.colour for led in rig.leds[:6]] == ["red", "blue", "green", "red", "blue", "green"]
    assert rig.leds[6:] == plain.leds[7:]
    assert rig.camera.crosstalk is not None
    np.testing.assert_array_equal(rig.camera.crosstalk, CROSSTALK)
    assert exposures_of(list(rig.leds[:6])) == [(0, 1, 2), (3, 4, 5)]


def test_four_exposures_of_coloured_leds_are_refused():
    with bad_input("one to three exposures"):
        coloured_rig(0.2, exposures=4)


@pytest.mark.slow
def test_an_exposure_is_the_mixture_of_its_colours():
    """Without noise: the channels hold what each LED alone gives in its own colour, mixed as the
    filters mix it."""
    sensor = SensorSettings(noise=False, bits=16, raw_bits=16)
    rig = coloured_rig(0.05, 0)
    capture, truth = simulate_capture(3, "whorl", TwinSettings(rig=rig, sensor=sensor))
    band = capture.bands["white"]
    assert band.pixels.shape[0] == 2
    assert len(observe(capture).white.lights) == truth["glare_white"].shape[0] == 6
    assert band.ambient is not None
    mixed = np.zeros((*capture.shape, 3))
    for k in band.leds[1]:
        led = rig.leds[k]
        alone, facts = simulate_capture(
            3,
            "whorl",
            TwinSettings(rig=replace(rig, leds=(replace(led, colour=""),)), sensor=sensor),
        )
        own, c = alone.bands["white"], COLOURS.index(led.colour)
        assert own.ambient is not None
        seen = (own.pixels[0].astype(float) - own.ambient.pixels)[..., c] / float(
            facts["exposure_white"]
        )
        mixed += seen[..., None] * np.array(CROSSTALK)[:, c]
    stored = (band.pixels[1].astype(float) - band.ambient.pixels) / float(truth["exposure_white"])
    unclipped = band.pixels[1].max(axis=2) < 65000
    assert unclipped.mean() > 0.98
    np.testing.assert_allclose(stored[unclipped], mixed[unclipped], atol=0.005 * mixed.max())
