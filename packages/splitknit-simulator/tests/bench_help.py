"""What the tests of the bench's scenes share: two cameras, one light, positions found in
pictures."""

from dataclasses import replace

import cv2
import numpy as np

from splitknit.model import Camera
from splitknit.nominal import nominal_rig
from splitknit_simulator.calibration_set.bench import BenchSettings
from splitknit_simulator.rigs import built_rig

DARK_ROOM = BenchSettings(ambient=0.0)
POINTS = BenchSettings(ambient=0.0, led_radius_mm=0.0)
"""LEDs without size in a dark room: shadows have sharp rims."""


def drawn(scale=0.1, **changes):
    """Camera and LEDs as drawn; `changes` of every LED."""
    rig = nominal_rig(scale)
    return {"camera": rig.camera, "leds": tuple(replace(led, **changes) for led in rig.leds)}


def built(seed=2, scale=0.1):
    rig = built_rig(seed, scale=scale)
    return {"camera": rig.camera, "leds": rig.leds}


def parallel(scale=0.1):
    """An orthographic camera over the LEDs as drawn."""
    rig = nominal_rig(scale)
    camera = Camera(px_per_mm=75.7 * scale, image_size=rig.camera.image_size)
    return {"camera": camera, "leds": rig.leds}


def grey(scene, lit):
    """(H, W) light with the lens's fall-off taken out again."""
    image = scene.light(lit)
    assert image.dtype == np.float32
    assert image.shape == (*scene.camera.image_size, 3)
    assert np.array_equal(image[..., 0], image[..., 2])
    rows, columns = scene.camera.image_size
    row, column = np.indices((rows, columns))
    r2 = ((row - (rows - 1) / 2) ** 2 + (column - (columns - 1) / 2) ** 2) / (
        (rows**2 + columns**2) / 4
    )
    return image[..., 1] / sum(a * r2**k for k, a in enumerate((1.0, *scene.camera.shading)))


def seen(camera, points):
    """Column and row of points (N, 3) by OpenCV: a frame with y down and z away from the camera."""
    points = np.atleast_2d(points).astype(np.float64)
    if camera.model == "orthographic":
        rows, columns = camera.image_size
        return points[:, :2] * (camera.px_per_mm, -camera.px_per_mm) + (
            (columns - 1) / 2,
            (rows - 1) / 2,
        )
    turned = points * (1, -1, -1) + (0, 0, camera.height_mm)
    distortion = np.array(camera.distortion or (0.0,) * 5)
    return cv2.projectPoints(turned, np.zeros(3), np.zeros(3), camera.matrix, distortion)[0][:, 0]


def lambert(led, point, normal=(0, 0, 1), albedo=0.9):
    """Radiance by hand: inverse square, cosine of incidence, lobe, Lambert."""
    towards = np.array(led.position_mm) - point
    r = np.linalg.norm(towards)
    facing = max(float(np.dot(towards / r, normal)), 0.0)
    along = np.dot(-towards / r, led.axis)
    return albedo / np.pi * led.intensity * (100 / r) ** 2 * facing * along**led.lobe_exponent


def sample(image, places):
    """Values of `image` at (N, 2) columns and rows, bilinear."""
    places = np.asarray(places, dtype=np.float32)
    return cv2.remap(
        image.astype(np.float32), places[None, :, 0], places[None, :, 1], cv2.INTER_LINEAR
    )[0]


def crossing(values, places, level):
    """Where along `places` the rising `values` pass `level`."""
    index = int(np.argmax(values > level))
    assert 0 < index < len(values)
    fraction = (level - values[index - 1]) / (values[index] - values[index - 1])
    return places[index - 1] + fraction * (places[index] - places[index - 1])
