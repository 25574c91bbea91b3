"""The nail's shadows: on the rays from the LEDs through its tip, soft by the LEDs' size, and
nothing else darkened."""

import numpy as np
import pytest

from bench_help import (
    DARK_ROOM,
    POINTS,
    built,
    crossing,
    drawn,
    grey,
    lambert,
    parallel,
    sample,
    seen,
)
from refusals import bad_input
from splitknit.model import Led
from splitknit_simulator.calibration_set.bench import BenchSettings
from splitknit_simulator.calibration_set.flat import CardScene
from splitknit_simulator.calibration_set.solids import NailScene


def fraction_lit(scene, led):
    """Light with the nail over light without it."""
    card = CardScene(
        camera=scene.camera,
        leds=scene.leds,
        bench=scene.bench,
        reflectance=scene.ground,
        tilt_deg=scene.tilt_deg,
    )
    return grey(scene, [led]) / grey(card, [led])


@pytest.mark.parametrize("make", [drawn, built, parallel])
def test_led_tip_and_shadow_lie_on_one_ray(make):
    things = make()
    scene = NailScene(**things, position_mm=(4.0, -3.0), nail_mm=12.0, tilt_deg=(0.4, -0.2))
    normal = np.cross(*[scene.plane.axes[:, k] for k in (0, 1)])
    tip = scene.tip_mm
    assert normal @ tip == pytest.approx(12.0)
    assert np.allclose(tip, (4.0, -3.0, 12.0), atol=0.12)
    for led, shadow in zip(things["leds"], scene.shadow_tips_mm(), strict=True):
        assert abs(normal @ shadow) < 1e-9
        ray, rest = tip - led.position_mm, shadow - tip
        assert np.linalg.norm(np.cross(ray, rest)) < 1e-9 * np.linalg.norm(ray)
    for points, pixels in ((scene.shadow_tips_mm(), scene.shadow_tips_px()), (tip, scene.tip_px())):
        assert np.abs(seen(things["camera"], points) - pixels).max() < 1e-6


@pytest.mark.parametrize("make", [drawn, built])
@pytest.mark.parametrize("led", [0, 3, 12])
def test_the_shadow_in_the_picture_ends_at_its_true_tip(make, led):
    things = make(scale=0.3)
    scene = NailScene(
        **things, position_mm=(-2.0, 1.5), nail_mm=12.0, tilt_deg=(0.3, 0.2), bench=POINTS
    )
    tip = scene.shadow_tips_mm()[led]
    foot = scene.plane.points(*scene.position_mm)
    along = (tip - foot) / np.linalg.norm(tip - foot)
    reach = np.linspace(-0.5, 1.5, 401)
    image = fraction_lit(scene, led)
    profile = sample(image, seen(things["camera"], tip + reach[:, None] * along))
    # the tip is a disc of 0.15 mm: its shadow's end lies that far behind its middle, a little
    # magnified
    assert crossing(profile, reach, 0.5) == pytest.approx(
        0.15 * (1 + 12 / 128), abs=0.5 / things["camera"].px_per_mm
    )
    assert sample(image, scene.shadow_tips_px()[led : led + 1])[0] < 0.02
    across = np.cross(scene.plane.axes[:, 2], along)
    for side in (-1, 1):
        beside = np.linspace(0.0, 0.6, 121)
        profile = sample(image, seen(things["camera"], tip + side * beside[:, None] * across))
        # the shadow's flanks spread towards the nail, so that they are a little wider at the tip's
        # middle
        wide = crossing(profile, beside, 0.5)
        assert 0.15 < wide < 0.25


def test_the_size_of_an_led_softens_the_shadow():
    """A post instead of a cone: its shadow's end is a plain edge, swept by the LED's face."""
    radius = 1.5
    led = Led(band="white", position_mm=(52.5, 0.0, 140.0))
    things = drawn(0.3) | {"leds": (led,)}
    bench = BenchSettings(ambient=0.0, led_radius_mm=radius)
    scene = NailScene(**things, nail_mm=14.0, base_radius_mm=4.0, tip_radius_mm=4.0, bench=bench)
    image = fraction_lit(scene, 0)
    reach = np.linspace(-1.0, 1.0, 801)
    end = scene.shadow_tips_mm()[0] - (4.0 * (1 + 14 / 126), 0, 0)
    profile = sample(image, seen(things["camera"], end - reach[:, None] * (1, 0, 0)))
    slope = np.gradient(profile)
    middle = np.average(reach, weights=slope)
    width = np.sqrt(np.average((reach - middle) ** 2, weights=slope))
    # the face is turned to the origin: its near and far rims, cast by hand over the post's top
    sine, cosine = 52.5 / np.hypot(52.5, 140), 140 / np.hypot(52.5, 140)
    rims = np.array([52.5, 140.0]) + radius * np.array([[cosine, -sine], [-cosine, sine]])
    ends = -rims[:, 0] * 14 / (rims[:, 1] - 14)
    assert abs(middle) < 0.01
    # of a disc's chords: a quarter of its width
    assert width == pytest.approx(abs(np.diff(ends)[0]) / 4, rel=0.06)


def test_the_shading_of_the_cone_follows_its_slope():
    """Half way up, on the side towards the LED and across from it."""
    scene = NailScene(**drawn(0.3), nail_mm=13.0, base_radius_mm=5.0, bench=DARK_ROOM)
    image = grey(scene, [0])
    slope = (5.0 - 0.15) / 13.0
    for side in (1, -1):
        point = np.array([side * (5.0 + 0.15) / 2, 0.0, 6.5])
        normal = np.array([side, 0.0, slope]) / np.hypot(1, slope)
        expected = lambert(scene.leds[0], point, normal, 0.15)
        light = sample(image, seen(scene.camera, point))[0]
        assert light == pytest.approx(expected, rel=0.02, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"nail_mm": 150.0},
            "the nail of 150 mm leaves less than 10 mm below the LEDs .* take a shorter one",
        ),
        ({"leds": (Led(band="white", direction=(0.3, 0.1, 1.0)),)}, "LED 0 is distant light"),
    ],
)
def test_impossible_nails_are_refused(changes, words):
    with bad_input(words):
        NailScene(**drawn() | changes)
