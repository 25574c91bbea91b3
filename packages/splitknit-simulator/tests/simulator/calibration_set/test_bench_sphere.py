"""Balls under the rig: highlights where light is mirrored, shading by Lambert's law, shadows,
outlines."""

import cv2
import numpy as np
import pytest

from bench_help import DARK_ROOM, POINTS, built, drawn, grey, lambert, parallel, seen
from refusals import bad_input
from splitknit.model import Led
from splitknit_simulator.calibration_set.bench import seen_at
from splitknit_simulator.calibration_set.flat import CardScene
from splitknit_simulator.calibration_set.solids import SphereScene
from splitknit_simulator.camera.lens import px_per_mm_at, slopes_of_pixels

NO_WALLS = {"surround": 0.0, "ground": 0.0, "bench": DARK_ROOM}


@pytest.mark.parametrize("make", [drawn, built, parallel])
def test_highlights_obey_the_law_of_reflection(make):
    things = make()
    scene = SphereScene(**things, position_mm=(6.0, -3.0), tilt_deg=(0.4, 0.2))
    points = scene.highlights_mm()
    for led, point in zip(things["leds"], points, strict=True):
        normal = (point - scene.middle_mm) / 8.0
        assert np.linalg.norm(normal) == pytest.approx(1)
        camera = (0, 0, things["camera"].height_mm) - point
        eye, light = (
            way / np.linalg.norm(way)
            for way in ((0, 0, 1) if make is parallel else camera, led.position_mm - point)
        )
        assert np.allclose(2 * (normal @ eye) * normal - eye, light, atol=1e-9)
    assert (
        np.abs(seen(things["camera"], points) - seen_at(scene.camera, scene.highlights_mm())).max()
        < 1e-6
    )


def upright(scale):
    """LEDs that look straight down: the ball sees their faces and beams from beside."""
    return drawn(scale, aim=(0.0, 0.0, -1.0))


@pytest.mark.slow
@pytest.mark.parametrize("make", [drawn, built, parallel, upright])
def test_a_chrome_ball_shows_every_led_at_its_place_and_strength(make):
    things = make(scale=0.2)
    scene = SphereScene(**things, position_mm=(-5.0, 2.0), **NO_WALLS)
    row, column = np.indices(scene.camera.image_size)
    for index in (0, 4, 9):
        image = grey(scene, [index])
        weight = image / image.sum()
        centroid = np.array([(weight * column).sum(), (weight * row).sum()])
        assert np.abs(centroid - seen_at(scene.camera, scene.highlights_mm())[index]).max() < 0.05
        # a small mirror ball sends what it receives evenly into all directions, E R^2 / 4; at the
        # distances d and D of LED and camera (none for parallel rays) its picture is smaller by 1 +
        # R / 2d + R / 2D
        led, point = scene.leds[index], scene.highlights_mm()[index]
        d = np.linalg.norm(led.position_mm - point)
        along = np.dot((point - led.position_mm) / d, led.axis)
        smaller = 1 + 4 / d + (0 if make is parallel else 4 / (scene.camera.height_mm - point[2]))
        expected = (
            0.6 * led.intensity * 1e4 * along**led.lobe_exponent * (8.0 / (2 * d) / smaller) ** 2
        )
        assert image.sum() / px_per_mm_at(scene.camera, point[2]) ** 2 == pytest.approx(
            expected, rel=0.03
        )


def test_a_matt_ball_follows_lambert_s_law():
    things = parallel(0.2)
    scene = SphereScene(
        **things, chrome=False, position_mm=(2.0, 1.0), radius_mm=9.0, bench=DARK_ROOM
    )
    image = grey(scene, [5])
    led = things["leds"][5]
    pitch = things["camera"].pitch_mm
    for column, row in [(340, 200), (350, 240), (300, 205), (390, 215), (430, 160)]:
        x, y = (column - 319.5) * pitch, (219.5 - row) * pitch
        rise = np.sqrt(81 - (x - 2) ** 2 - (y - 1) ** 2)
        normal = np.array([x - 2, y - 1, rise]) / 9
        expected = lambert(led, (x, y, 9 + rise), normal, 0.5)
        assert image[row, column] == pytest.approx(expected, rel=1e-4, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("make", [drawn, built, parallel])
@pytest.mark.parametrize("chrome", [True, False])
def test_the_outline_bounds_the_ball(make, chrome):
    """In the room's light a ball differs from its base by its reflectance alone."""
    things = make(scale=0.2)
    changes = {
        "surround": 0.0,
        "ground": 0.9,
        "reflectance": 0.1,
        "position_mm": (4.0, 3.0),
        "tilt_deg": (0.3, 0.1),
    }
    scene = SphereScene(**things, chrome=chrome, **changes)
    image = grey(scene, []) / scene.ambient_light
    outline = scene.outline_px().astype(np.float32)
    row, column = np.indices(image.shape)
    signed = np.array(
        [
            cv2.pointPolygonTest(outline, (float(c), float(r)), True)
            for r, c in zip(row.flat, column.flat, strict=True)
        ]
    ).reshape(image.shape)
    assert image[signed > 1.0].max() < 0.11
    assert image[signed < -1.0].min() > 0.899
    if not chrome:
        ball = (0.9 - image) / 0.8
        assert ball.sum() == pytest.approx(cv2.contourArea(outline), rel=2e-3)


@pytest.mark.parametrize("make", [drawn, built])
def test_the_shadow_is_where_the_ball_hides_the_led(make):
    things = make(scale=0.15)
    scene = SphereScene(**things, chrome=False, position_mm=(3.0, 0.0), ground=0.8, bench=POINTS)
    card = CardScene(**things, reflectance=0.8, bench=POINTS)
    camera = things["camera"]
    rows, columns = camera.image_size
    sx, sy = slopes_of_pixels(camera, np.arange(columns)[None, :], np.arange(rows)[:, None])
    ground = np.stack([sx, sy, 0 * sx], axis=-1) * camera.height_mm
    eye = np.array([0, 0, camera.height_mm])

    def angle(a, b):
        return np.arccos(
            np.sum(a * b, axis=-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
        )

    middle = scene.middle_mm - ground
    half = np.arcsin(8 / np.linalg.norm(middle, axis=-1))
    visible = angle(middle, eye - ground) > half + 0.02
    for index in (1, 8):
        fraction = grey(scene, [index]) / grey(card, [index])
        margin = angle(middle, things["leds"][index].position_mm - ground) - half
        assert fraction[visible & (margin < -0.02)].max() < 1e-3
        assert fraction[visible & (margin > 0.02)].min() > 0.999
        assert (visible & (margin < -0.02)).sum() > 500


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"radius_mm": 40.0}, "a ball of 80 mm reaches more than half way .* take a smaller one"),
        ({"leds": (Led(band="white", direction=(0.3, 0.1, 1.0)),)}, "LED 0 is distant light"),
    ],
)
def test_impossible_balls_are_refused(changes, words):
    with bad_input(words):
        SphereScene(**drawn() | changes)
