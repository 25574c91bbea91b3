"""The finger and its light under a perspective camera."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import ndimage

from splitknit.model import Camera, Led
from splitknit_simulator.camera.lens import pixels_of_points, slopes_of_pixels
from splitknit_simulator.finger.finger import (
    FingerPose,
    PoseRanges,
    draw_finger,
    finger_surface,
    placement_of,
)
from splitknit_simulator.finger.master_print import MasterPrintSettings
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.light.lighting import white_card
from splitknit_simulator.light.renderer import render_ambient, render_band
from splitknit_simulator.light.skin import (
    ChannelOptics,
    Medium,
    diffuse_transmittance,
    diffusion_profile,
    fresnel,
)
from surfaces import perspective_camera, perspective_plane

SHORT = MasterPrintSettings(proximal_mm=12.0)
POSE = FingerPose(
    yaw_rad=0.15, pitch_rad=-0.05, roll_rad=0.2, x_mm=-2.0, insertion_mm=26.0, height_mm=0.4
)
CAMERA = perspective_camera(
    (430, 560), 15.0, 110.0, off=(9.3, -7.8), distortion=(0.4, -2.0, 3e-3, -2e-3, 4.0)
)
CENTRED = perspective_camera((430, 560), 15.0, 140.0)


@pytest.fixture(scope="module")
def finger():
    drawn = draw_finger(2, "left_loop", print_settings=SHORT)
    return replace(drawn, printed=drawn.master())


@pytest.fixture(scope="module")
def seen(finger):
    return finger_surface(finger, POSE, CAMERA)


def _points(surface):
    """(H, W, 3) of the skin."""
    return np.stack(surface.sight().at(surface.height_mm), axis=-1)


def _view(surface):
    """(H, W, 3) unit vectors from the skin to the camera."""
    to = np.array([0.0, 0.0, surface.camera.height_mm]) - _points(surface)
    return to / np.linalg.norm(to, axis=-1, keepdims=True)


def test_every_point_appears_in_its_pixel(seen):
    rows, columns = np.nonzero(seen.mask)
    column, row = pixels_of_points(CAMERA, *_points(seen)[seen.mask].T)
    assert np.abs(column - columns).max() < 1e-3
    assert np.abs(row - rows).max() < 1e-3
    assert np.isnan(_points(seen)[~seen.mask]).all()
    assert not (ndimage.binary_fill_holes(seen.mask) & ~seen.mask).any()
    assert np.array_equal(np.isfinite(seen.shape_mm), seen.mask)


def test_every_point_is_skin_and_nothing_stands_before_it(seen, finger):
    body = FingerBody(finger.shape)
    placement = placement_of(body, POSE, CAMERA)
    pick = seen.mask & ((_view(seen) * seen.normals).sum(-1) > 0.25)
    distance, _, _ = body.distance_and_chart(*placement.to_finger(*_points(seen)[pick].T))
    assert_allclose(1e3 * distance, seen.relief_um[pick], atol=0.03)
    rows, columns = np.nonzero(seen.mask)
    across, up = slopes_of_pixels(CAMERA, columns, rows)
    deepest = 1e-3 * seen.relief_um.min()
    for above in (0.3, 1.0, 3.0):
        z = seen.height_mm[seen.mask].astype(np.float64) + above
        before, _, _ = body.distance_and_chart(
            *placement.to_finger(across * (110.0 - z), up * (110.0 - z), z)
        )
        assert before.min() > deepest
    shape_z = seen.shape_mm[seen.mask].astype(np.float64)
    on_shape = body.distance_and_chart(
        *placement.to_finger(across * (110 - shape_z), up * (110 - shape_z), shape_z)
    )[0]
    assert 1e3 * np.abs(on_shape).max() < 0.01


def test_normals_are_those_of_the_points_and_face_the_camera(seen):
    lengths = np.linalg.norm(seen.normals[seen.mask], axis=1)
    assert_allclose(lengths, 1.0, atol=1e-5)
    assert (_view(seen) * seen.normals).sum(-1)[seen.mask].min() > 5e-4
    rows, columns = np.indices(seen.mask.shape)
    across, up = slopes_of_pixels(CAMERA, columns.ravel(), rows.ravel())
    z = seen.shape_mm.astype(np.float64)
    points = np.stack([across.reshape(z.shape) * (110 - z), up.reshape(z.shape) * (110 - z), z], -1)
    normal = np.cross(np.gradient(points, axis=1), -np.gradient(points, axis=0))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    inside = ndimage.binary_erosion(seen.mask, iterations=4) & (
        (_view(seen) * seen.shape_normals).sum(-1) > 0.6
    )
    cosine = (normal * seen.shape_normals).sum(-1)[inside]
    assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).max() < 0.5


def test_the_pose_is_where_it_says_in_the_picture(finger):
    """Wherever the camera's axis meets the picture."""
    body, pose = FingerBody(finger.shape), FingerPose(insertion_mm=25.0, x_mm=1.0)
    plain = placement_of(body, pose, Camera(15.0, (430, 560))).shift
    assert_allclose(placement_of(body, pose, CENTRED).shift, plain, atol=1e-9)
    beside = perspective_camera((430, 560), 15.0, 110.0, off=(9.3, -7.8))
    assert_allclose(
        placement_of(body, pose, beside).shift - plain, [-9.3 / 15.0, -7.8 / 15.0, 0.0], atol=1e-9
    )
    deep = PoseRanges(insertion_mm=(60.0, 60.0)).draw(np.random.default_rng(0), beside)
    assert deep.insertion_mm == pytest.approx(430 / 15.0 - 0.6)


def test_light_on_a_plane_follows_the_true_points_and_view():
    """Irradiance and emergence of a steep sheet, and its light under the sky, by the book."""
    camera = perspective_camera((160, 240), 4.0, 60.0, off=(11.0, 5.0))
    sheet = perspective_plane(camera, -8.0, slope=-1.5)
    led = Led("white", (40.0, 6.0, 50.0))
    dense = ChannelOptics(scattering_per_mm=3000.0, absorption_per_mm=60.0, relief_gain_per_um=0.0)
    image = render_band(sheet, [led], Medium([dense], 0.2, 1.0))
    to = np.array([40.0, 6.0, 50.0]) - _points(sheet)
    distance = np.linalg.norm(to, axis=-1)
    cosine = (to * sheet.normals).sum(-1) / distance
    leaving = (_view(sheet) * sheet.normals).sum(-1)
    assert leaving.min() < 0.2 and leaving.max() > 0.85
    rough = np.sqrt(leaving**2 + 0.1**2 * (1 - leaving**2))
    albedo = diffusion_profile(3000.0, 60.0).albedo
    expected = 1e4 * cosine / distance**2 * (1 - fresnel(cosine)) * (1 - fresnel(rough)) * albedo
    inner = (slice(8, -8), slice(8, -8))
    assert_allclose(
        image.diffuse[0, 0][inner],
        (expected / (np.pi * diffuse_transmittance()))[inner],
        rtol=0.004,
    )
    sky = render_ambient(sheet, 1.0, Medium([dense], 0.2))
    half = 0.5 * (1.0 + sheet.normals[..., 2])
    assert_allclose(sky[0][inner], (half * albedo * (1 - fresnel(rough)))[inner], rtol=0.006)


def test_a_card_is_lit_where_the_rays_meet_it():
    led = Led("white", (30.0, -10.0, 90.0), lobe_exponent=4.0)
    card = white_card(CAMERA, led, -12.0, step=4)
    columns, rows = np.array([40, 300, 500]), np.array([390, 200, 30])
    across, up = slopes_of_pixels(CAMERA, columns, rows)
    to = np.stack([30.0 - 122.0 * across, -10.0 - 122.0 * up, np.full(3, 102.0)], -1)
    distance = np.linalg.norm(to, axis=-1)
    lobe = (
        to @ np.array([30.0, -10.0, 90.0]) / distance / np.linalg.norm([30.0, -10.0, 90.0])
    ) ** 4
    expected = 1e4 * 102.0 / distance**3 * lobe / np.pi
    assert_allclose(card[rows, columns], expected, rtol=2e-3)


def test_the_beam_falls_off_about_its_aim():
    """cos^m of the angle to the aim, whatever direction the origin has."""
    position, aim = np.array([40.0, 10.0, 100.0]), np.array([-0.1, 0.25, -1.0])
    camera = Camera(2.0, (161, 241))
    even = Led("white", tuple(position))
    aimed = replace(even, lobe_exponent=12.0, aim=tuple(aim))
    fraction = white_card(camera, aimed, step=1) / white_card(camera, even, step=1)
    hit = position - position[2] / aim[2] * aim  # where the beam's axis meets the plane
    row, column = np.unravel_index(np.argmax(fraction), fraction.shape)
    assert (column - 120) / 2.0 == pytest.approx(hit[0], abs=0.5)
    assert (80 - row) / 2.0 == pytest.approx(hit[1], abs=0.5)
    x, y = (np.arange(241) - 120)[None, :] / 2.0, (80 - np.arange(161))[:, None] / 2.0
    away = np.stack(
        np.broadcast_arrays(x - position[0], y - position[1], np.array([[-position[2]]])), -1
    )
    cosine = away @ aim / np.linalg.norm(away, axis=-1) / np.linalg.norm(aim)
    assert_allclose(fraction, cosine**12, rtol=1e-4, atol=1e-5)
    to_origin = replace(even, lobe_exponent=12.0)
    same = replace(to_origin, aim=tuple(-0.01 * position))
    assert_allclose(white_card(camera, same), white_card(camera, to_origin), rtol=1e-6)
