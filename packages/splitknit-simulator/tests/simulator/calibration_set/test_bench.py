"""Cards and darkness under the rig against closed forms, and what all scenes of the bench share."""

from dataclasses import replace

import numpy as np
import pytest

from bench_help import DARK_ROOM, built, drawn, grey, lambert, seen
from refusals import bad_input
from splitknit_simulator.calibration_set.bench import BenchSettings, photograph_bench, well_exposed
from splitknit_simulator.calibration_set.flat import BoardScene, CardScene
from splitknit_simulator.calibration_set.solids import NailScene, SphereScene
from splitknit_simulator.camera.sensor import SensorSettings


def test_a_tilted_card_under_a_built_rig_agrees_with_its_closed_form():
    things = built()
    scene = CardScene(**things, tilt_deg=(2.0, -3.0), height_mm=1.5, bench=DARK_ROOM)
    light = grey(scene, [0])
    # points of the card, where OpenCV says they appear
    a, b = np.deg2rad([2.0, -3.0])
    angle = np.hypot(a, b)
    k = np.array([[0, 0, b], [0, 0, -a], [-b, a, 0]]) / angle
    turn = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    for u, v in [(0, 0), (-14, 9), (17, -11)]:
        point = turn @ (u, v, 0) + (0, 0, 1.5)
        column, row = np.round(seen(things["camera"], point)[0]).astype(int)
        expected = lambert(things["leds"][0], point, turn[:, 2])
        assert light[row, column] == pytest.approx(expected, rel=2e-3)


def scenes(**things):
    return {
        "card": CardScene(**things),
        "board": BoardScene(**things, rotation_vector=(0.3, 0.2, 0.1)),
        "nail": NailScene(**things, position_mm=(3, 1)),
        "chrome": SphereScene(**things, surround=0.0),
        "matt": SphereScene(**things, chrome=False),
    }


@pytest.mark.parametrize("name", list(scenes(**drawn())))
def test_light_of_leds_adds_over_ambient_light(name):
    scene = scenes(**built())[name]
    room, first, second, both = (scene.light(lit) for lit in ([], [0], [9], [0, 9]))
    assert np.allclose(
        both - room, first + second - 2 * room, atol=1e-5 * max(float(both.max()), 1e-6)
    )
    assert (first >= room - 1e-7).all()
    assert 0 < room.max() < 0.03 * float(np.percentile(first, 99.9))


@pytest.mark.parametrize("name", list(scenes(**drawn())))
def test_an_led_outside_the_rig_is_refused(name):
    for index in (14, -1):
        with bad_input(f"LED {index} is not in the rig"):
            scenes(**drawn())[name].light([index])


def test_leds_that_share_an_exposure_are_lit_together():
    things = drawn()
    first, second, *_ = things["leds"]
    pair = replace(first, also=(second,))
    together = CardScene(camera=things["camera"], leds=(pair, second), bench=DARK_ROOM).light([0])
    assert np.allclose(together, CardScene(**things, bench=DARK_ROOM).light([0, 1]), rtol=1e-5)


def test_defocus_follows_the_thin_lens():
    things = drawn(0.3)
    bench = BenchSettings(aperture_mm=8.0)
    scene = BoardScene(**things, bench=bench, translation_mm=(0, 0, -6))
    row = grey(scene, [])[round(seen(things["camera"], (1.5, 1.5, -6))[0, 1])]
    column = round(seen(things["camera"], (1.5, 0, -6))[0, 0])
    reach = np.arange(column - 12, column + 13)
    slope = np.abs(np.gradient(row)[reach])
    middle = np.average(reach, weights=slope)
    width = np.sqrt(np.average((reach - middle) ** 2, weights=slope))
    disc_mm = 8.0 * 6 / 146
    expected = disc_mm / 4 * things["camera"].matrix[0, 0] / 140
    # gradient and pixel widen it by 0.9 px
    assert width == pytest.approx(np.sqrt(expected**2 + 0.8), rel=0.12)


def test_photographs_depend_on_their_seed():
    scene = CardScene(**built())
    exposure = well_exposed(scene, [[0], [3]])
    first, again, different = (
        photograph_bench(scene, [0], seed, exposure=exposure) for seed in (1, 1, 2)
    )
    assert first.dtype == np.uint8
    assert first.shape == (220, 320, 3)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, different)


def test_photographs_are_light_times_exposure():
    scene = CardScene(**built())
    exposure = well_exposed(scene, [[0]], 0.6)
    quiet = SensorSettings(noise=False, bits=16)
    image = photograph_bench(scene, [0], 1, exposure=exposure, sensor=quiet, band="nir") / 65535
    assert np.abs(image - exposure * scene.light([0])).max() < 1.2 / 1023
    assert np.percentile(image, 99.9) == pytest.approx(0.6, abs=3e-3)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"ambient": -0.1}, "bench.ambient must be from 0 to 1"),
        ({"led_radius_mm": np.nan}, "bench.led_radius_mm must be from 0 to 10"),
    ],
)
def test_bench_settings_out_of_range_are_refused(settings, words):
    with bad_input(words):
        BenchSettings(**settings)
