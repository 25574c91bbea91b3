"""The renders of a finger between three mirrors, made in Blender by the thesis's author."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from splitknit.capture import Band, Capture
from splitknit.io.images import read_image
from splitknit.mirrors.captured import seen_in_mirrors
from splitknit.model import Camera, Led, Mirror, Rig
from splitknit.observation.observe import observe

pytestmark = [pytest.mark.external, pytest.mark.slow]

FOCAL_PX, PX_PER_MM = 6800.0, 20.0
"""From the mirrors' corners, which are squares at 45 deg; the scale is that of a finger 16 mm
broad."""
LOW_MM, CLOSER = -14.8, 1.0664
"""Height of the mirrors' inner edges below the pad's top, and how much larger their outer edges
look than the inner."""
CORNERS_PX = {
    "left": ((1200.0, 752.8), (1798.8, 752.8), (1818.7, 284.6), (1180.2, 284.6)),
    "right": ((1200.2, 1246.2), (1798.9, 1246.2), (1818.7, 1714.3), (1180.1, 1714.3)),
    "tip": ((1854.0, 709.2), (1854.0, 1305.2), (2327.0, 1325.4), (2327.0, 690.0)),
}
"""Column and row of the mirrors' corners in the picture, the two of the inner edge first; the tip
points right."""


def rig_of(lights):
    """The rig, read off the picture."""
    distance = FOCAL_PX / PX_PER_MM
    matrix = np.array([[FOCAL_PX, 0.0, 1499.5], [0.0, FOCAL_PX, 999.5], [0.0, 0.0, 1.0]])
    camera = Camera(PX_PER_MM, (2000, 3000), distance, "perspective", matrix)
    high = distance - (distance - LOW_MM) / CLOSER

    def placed(column, row, z):
        near = (distance - z) / FOCAL_PX
        return (column - 1499.5) * near, (999.5 - row) * near, z

    mirrors = tuple(
        Mirror(
            name,
            tuple(placed(*corner, LOW_MM if k < 2 else high) for k, corner in enumerate(corners)),
            0.88,
        )
        for name, corners in CORNERS_PX.items()
    )
    leds = tuple(
        Led("white", position_mm=(float(x), float(y), float(z))) for x, y, z in 1000.0 * lights
    )
    return Rig(camera, leds, mirrors=mirrors)


@pytest.fixture(scope="module")
def capture(data_dir):
    folder = data_dir / "blender_finger" / "with_mirrors"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    images = np.stack([read_image(folder / f"light_{k:02d}.png") for k in range(7)])
    rig = rig_of(np.loadtxt(folder / "lights.txt"))
    band = Band("white", images, tuple((k,) for k in range(7)), np.ones(7), np.zeros(7))
    return Capture(
        rig, {"white": band}, encoding="srgb", material="opaque", tip_direction_deg=-90.0
    )


@pytest.fixture(scope="module")
def seen(capture):
    return seen_in_mirrors(observe(capture))


def reprojected(seen, name, points):
    """Column and row at which the camera sees points (n, 3), in a mirror where the fit has it or
    (``front``) itself."""
    if name != "front":
        mirror = next(m for m in seen.rig.mirrors if m.name == name)
        plane = seen.shape.plane(mirror)
        points = points - 2 * np.outer(points @ plane.normal - plane.offset_mm, plane.normal)
    near = (FOCAL_PX / PX_PER_MM - points[:, 2]) / FOCAL_PX
    return np.column_stack([1499.5 + points[:, 0] / near, 999.5 - points[:, 1] / near])


def test_silhouettes_of_the_result_agree_with_the_picture(seen):
    """The visible surface, moved into each view by plain geometry, ends where the picture's finger
    does."""
    assert set(seen.views.mirrors) == {"left", "right", "tip"}
    window = slice(600, 1400), slice(1100, 1900)
    x, y, z = seen.shape.points(*window)
    inside = np.isfinite(z)
    points = np.column_stack([x[inside], y[inside], z[inside]]).astype(float)
    width_px = 16.0 * PX_PER_MM
    binning = seen.views.binning
    masks = {"front": seen.views.front, **seen.views.mirrors}
    worst = {}
    for name, outward in (("front", (-1, 1)), ("left", (-1,)), ("right", (1,))):
        pixels = reprojected(seen, name, points)
        mask = masks[name]
        away = []
        # the tip points right: the finger's sides run along the columns
        for column in range(1260, 1740, 20):
            here = np.abs(pixels[:, 0] - column) < 1.0
            rows = (np.flatnonzero(mask[:, column // binning]) + 0.5) * binning - 0.5
            for side in outward:
                ours = side * np.max(side * pixels[here, 1])
                away.append(abs(ours - side * np.max(side * rows)) / width_px)
        worst[name] = (float(np.median(away)), float(np.max(away)))
        assert worst[name][0] < 0.01 and np.quantile(away, 0.95) < 0.02, (name, worst)


def test_whole_outlines_are_fitted_within_a_hundredth_of_the_width(seen):
    rms = seen.shape.facts["outline_rms_mm"]
    assert all(rms[name] < 0.01 * 16.0 for name in ("front", "left", "right"))
    poses = seen.shape.facts["poses"]
    # they stand at right angles
    assert all(abs(poses[name]["turn_deg"]) < 1.0 for name in ("left", "right"))


def test_the_finger_is_distinguished_from_its_mirror_images(capture, seen):
    mask = (
        cv2.resize(seen.views.front.astype(np.uint8), (3000, 2000), interpolation=cv2.INTER_NEAREST)
        > 0
    )
    assert (
        mask[1000, 1500] and not mask[520, 1500] and not mask[1480, 1500] and not mask[1000, 2100]
    )


def test_one_mirror_is_enough_for_a_shape(capture):
    rig = replace(capture.rig, mirrors=capture.rig.mirrors[:1])
    alone = seen_in_mirrors(observe(replace(capture, rig=rig)))
    assert alone.shape.facts["mirrors"] == ["left"]
    assert alone.shape.facts["outline_rms_mm"]["left"] < 0.1
