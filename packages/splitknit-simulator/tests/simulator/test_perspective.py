"""The finger and its light under a perspective camera."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy import ndimage

from splitknit.errors import BadInput
from splitknit.model import Camera, Led
from splitknit_simulator.camera.lens import pixels_of_points, slopes_of_pixels
from splitknit_simulator.finger.finger import (
    FingerPose,
    PoseRanges,
    SimulatedFinger,
    draw_finger,
    finger_surface,
    placement_of,
)
from splitknit_simulator.finger.master_print import MasterPrint, MasterPrintSettings
from splitknit_simulator.finger.raycast import _Rays
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.light.lighting import cut_out, light_on, white_card
from splitknit_simulator.light.renderer import render_ambient, render_band
from splitknit_simulator.light.separation import Checkerboard, pattern_states, separate_truth
from splitknit_simulator.light.skin import (
    ChannelOptics,
    Medium,
    SkinOptics,
    diffuse_transmittance,
    diffusion_profile,
    fresnel,
)
from splitknit_simulator.surface import SimulatedSurface
from surfaces import perspective_camera, perspective_plane, ridged_egg

SHORT = MasterPrintSettings(proximal_mm=12.0)
POSE = FingerPose(yaw_rad=0.15, pitch_rad=-0.05, roll_rad=0.2, x_mm=-2.0, insertion_mm=26.0, height_mm=0.4)
CAMERA = perspective_camera((430, 560), 15.0, 110.0, off=(9.3, -7.8), distortion=(0.4, -2.0, 3e-3, -2e-3, 4.0))
CENTRED = perspective_camera((430, 560), 15.0, 140.0)


@pytest.fixture(scope="module")
def finger() -> SimulatedFinger:
    return draw_finger(2, "left_loop", print_settings=SHORT)


@pytest.fixture(scope="module")
def master(finger: SimulatedFinger) -> MasterPrint:
    return finger.master()


@pytest.fixture(scope="module")
def seen(finger: SimulatedFinger, master: MasterPrint) -> SimulatedSurface:
    return finger_surface(replace(finger, printed=master), POSE, CAMERA)


def _points(surface: SimulatedSurface) -> np.ndarray:
    """(H, W, 3) of the skin."""
    assert surface.x_mm is not None and surface.y_mm is not None
    return np.stack([surface.x_mm, surface.y_mm, surface.height_mm], -1).astype(np.float64)


def _view(surface: SimulatedSurface) -> np.ndarray:
    """(H, W, 3) unit vectors from the skin to the camera."""
    to = np.array([0.0, 0.0, surface.camera.height_mm]) - _points(surface)
    return to / np.linalg.norm(to, axis=-1, keepdims=True)


def test_every_point_appears_in_its_pixel(seen: SimulatedSurface) -> None:
    rows, columns = np.nonzero(seen.mask)
    column, row = pixels_of_points(CAMERA, *_points(seen)[seen.mask].T)
    assert np.abs(column - columns).max() < 1e-3
    assert np.abs(row - rows).max() < 1e-3
    assert np.isnan(_points(seen)[~seen.mask]).all()
    assert not (ndimage.binary_fill_holes(seen.mask) & ~seen.mask).any()
    assert np.array_equal(np.isfinite(seen.shape_mm), seen.mask)


def test_every_point_is_skin_and_nothing_stands_before_it(seen: SimulatedSurface, finger: SimulatedFinger) -> None:
    body = FingerBody(finger.shape)
    placement = placement_of(body, POSE, CAMERA)
    pick = seen.mask & ((_view(seen) * seen.normals).sum(-1) > 0.25)
    distance, _, _ = body.distance_and_chart(*placement.to_finger(*_points(seen)[pick].T))
    np.testing.assert_allclose(1e3 * distance, seen.relief_um[pick], atol=0.03)
    rows, columns = np.nonzero(seen.mask)
    across, up = slopes_of_pixels(CAMERA, columns, rows)
    deepest = 1e-3 * seen.relief_um.min()
    for above in (0.3, 1.0, 3.0):
        z = seen.height_mm[seen.mask].astype(np.float64) + above
        before, _, _ = body.distance_and_chart(*placement.to_finger(across * (110.0 - z), up * (110.0 - z), z))
        assert before.min() > deepest
    shape_z = seen.shape_mm[seen.mask].astype(np.float64)
    on_shape = body.distance_and_chart(*placement.to_finger(across * (110 - shape_z), up * (110 - shape_z), shape_z))[0]
    assert 1e3 * np.abs(on_shape).max() < 0.01


def test_normals_are_those_of_the_points_and_face_the_camera(seen: SimulatedSurface) -> None:
    assert seen.x_mm is not None and seen.y_mm is not None
    lengths = np.linalg.norm(seen.normals[seen.mask], axis=1)
    np.testing.assert_allclose(lengths, 1.0, atol=1e-5)
    assert (_view(seen) * seen.normals).sum(-1)[seen.mask].min() > 5e-4
    rows, columns = np.indices(seen.mask.shape)
    across, up = slopes_of_pixels(CAMERA, columns.ravel(), rows.ravel())
    z = seen.shape_mm.astype(np.float64)
    points = np.stack([across.reshape(z.shape) * (110 - z), up.reshape(z.shape) * (110 - z), z], -1)
    normal = np.cross(np.gradient(points, axis=1), -np.gradient(points, axis=0))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    inside = ndimage.binary_erosion(seen.mask, iterations=4) & ((_view(seen) * seen.shape_normals).sum(-1) > 0.6)
    cosine = (normal * seen.shape_normals).sum(-1)[inside]
    assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).max() < 0.5


def test_from_very_far_it_is_the_orthographic_picture(finger: SimulatedFinger, master: MasterPrint) -> None:
    far = perspective_camera((300, 260), 10.0, 1e8)
    plain = finger_surface(replace(finger, printed=master), POSE, Camera(10.0, (300, 260)))
    spread = finger_surface(replace(finger, printed=master), POSE, far)
    assert (plain.mask != spread.mask).sum() <= 2
    both = plain.mask & spread.mask & (plain.normals[..., 2] > 0.3)
    np.testing.assert_allclose(spread.height_mm[both], plain.height_mm[both], atol=5e-4)
    np.testing.assert_allclose(spread.shape_mm[both], plain.shape_mm[both], atol=5e-4)
    np.testing.assert_allclose(spread.relief_um[both], plain.relief_um[both], atol=0.5)
    np.testing.assert_allclose(spread.normals[both], plain.normals[both], atol=2e-2)
    np.testing.assert_allclose(spread.landmarks["tip_px"], plain.landmarks["tip_px"], atol=0.1)
    np.testing.assert_allclose(spread.landmarks["cores_px"], plain.landmarks["cores_px"], atol=0.01)
    skin, led = SkinOptics(), Led("white", (52.5, 0.0, 140.0))
    optics = [skin.channel("green")]
    one, other = (
        render_band(s, [led], Medium(optics, 0.25, 1.0)) for s in (plain, spread)
    )  # fmt: skip
    where = both[one.window]
    for a, b in ((one.diffuse[0, 0], other.diffuse[0, 0]), (one.glare[0], other.glare[0])):
        assert np.abs(a - b)[where].mean() < 2e-3 * a[where].mean()


def test_the_sides_move_inwards(finger: SimulatedFinger, master: MasterPrint) -> None:
    """What lies below the finger plane appears nearer to the axis: by 0.2 to 0.4 mm at the sides."""
    pose = FingerPose(insertion_mm=26.0)
    plain = finger_surface(replace(finger, printed=master), pose, Camera(15.0, (430, 560)))
    spread = finger_surface(replace(finger, printed=master), pose, CENTRED)
    assert 0.92 * plain.mask.sum() < spread.mask.sum() < 0.97 * plain.mask.sum()
    row = 250
    edges = [np.flatnonzero(s.mask[row])[[0, -1]] for s in (plain, spread)]
    inwards = np.array([edges[1][0] - edges[0][0], edges[0][1] - edges[1][1]]) / 15.0
    assert (inwards > 0.15).all() and (inwards < 0.45).all()


def test_beside_the_axis_it_looks_below_the_finger(finger: SimulatedFinger, master: MasterPrint) -> None:
    """A near camera sees skin of the side towards it that no orthographic camera sees: normals that point down."""
    camera = perspective_camera((300, 420), 10.0, 30.0)
    pose = FingerPose(x_mm=18.0, insertion_mm=20.0)
    surface = finger_surface(replace(finger, printed=master), pose, camera)
    down = surface.mask & (surface.shape_normals[..., 2] < -0.05)
    assert down.sum() > 200
    assert np.flatnonzero(surface.mask.any(axis=0))[0] > 270  # and nothing beside the finger
    assert (_view(surface) * surface.normals).sum(-1)[surface.mask].min() > 5e-4
    body = FingerBody(finger.shape)
    placement = placement_of(body, pose, camera)
    distance, _, _ = body.distance_and_chart(*placement.to_finger(*_points(surface)[down].T))
    np.testing.assert_allclose(1e3 * distance, surface.relief_um[down], atol=0.03)
    # the outline is where the smooth body, seen from the camera's centre, turns away
    rim = surface.mask & ~ndimage.binary_erosion(surface.mask) & (np.indices(surface.mask.shape)[1] < 345)
    rim[-4:] = False
    assert np.median((_view(surface) * surface.shape_normals).sum(-1)[rim]) < 0.15


def test_what_only_touches_a_ridge_is_turned_to_the_viewer() -> None:
    slopes = (np.array([0.2, 0.2, 0.0]), np.array([0.0, 0.0, -0.3]))
    rays = _Rays(np.zeros(3), np.zeros(3), slopes)
    normals = np.array([[0.0, 0.0, 1.0], [0.99, 0.0, np.sqrt(1 - 0.99**2)], [0.0, -0.96, 0.28]])
    given = normals.copy()
    rays.turn_to_view(normals)
    np.testing.assert_array_equal(normals[0], given[0])
    view = np.array([-0.2, 0.0, 1.0]) / np.sqrt(1.04), np.array([0.0, 0.3, 1.0]) / np.sqrt(1.09)
    np.testing.assert_allclose([normals[1] @ view[0], normals[2] @ view[1]], 1e-3, rtol=0.01)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    parallel = _Rays(np.zeros(3), np.zeros(3))
    parallel.turn_to_view(given)
    np.testing.assert_array_equal(given[2], [0.0, -0.96, 0.28])


def test_landmarks_are_pixels_of_the_lens(seen: SimulatedSurface, finger: SimulatedFinger, master: MasterPrint) -> None:
    body = FingerBody(finger.shape)
    placement = placement_of(body, POSE, CAMERA)
    named = np.concatenate([master.cores_mm, master.deltas_mm])
    pixels = np.concatenate([seen.landmarks["cores_px"], seen.landmarks["deltas_px"]])
    shown = np.isfinite(pixels).all(axis=1)
    assert shown.any()
    points = np.stack([
        cv2.remap(np.nan_to_num(p), *pixels[shown].astype(np.float32).T[:, :, None], cv2.INTER_LINEAR)[:, 0]
        for p in np.moveaxis(_points(seen), -1, 0)
    ])  # fmt: skip
    _, u, v = body.distance_and_chart(*placement.to_finger(*points))
    np.testing.assert_allclose(np.stack([u, v], 1), named[shown], atol=0.03)
    tip = seen.landmarks["tip_px"]
    assert seen.mask[round(tip[1]) + 2, round(tip[0])] and not seen.mask[round(tip[1]) - 3, round(tip[0])]


def test_workers_do_not_change_the_result(finger: SimulatedFinger, master: MasterPrint, seen: SimulatedSurface) -> None:
    again = finger_surface(replace(finger, printed=master), POSE, CAMERA, workers=1)
    for name in ("height_mm", "normals", "x_mm", "y_mm"):
        assert getattr(again, name).tobytes() == getattr(seen, name).tobytes()


def test_the_pose_is_where_it_says_in_the_picture(finger: SimulatedFinger) -> None:
    """The finger keeps its place in the picture, wherever the camera's axis meets it."""
    body, pose = FingerBody(finger.shape), FingerPose(insertion_mm=25.0, x_mm=1.0)
    plain = placement_of(body, pose, Camera(15.0, (430, 560))).shift
    np.testing.assert_allclose(placement_of(body, pose, CENTRED).shift, plain, atol=1e-9)
    beside = perspective_camera((430, 560), 15.0, 110.0, off=(9.3, -7.8))
    np.testing.assert_allclose(
        placement_of(body, pose, beside).shift - plain, [-9.3 / 15.0, -7.8 / 15.0, 0.0], atol=1e-9
    )
    deep = PoseRanges(insertion_mm=(60.0, 60.0)).draw(np.random.default_rng(0), beside)
    assert deep.insertion_mm == pytest.approx(430 / 15.0 - 0.6)


def test_light_on_a_plane_follows_the_true_points_and_view() -> None:
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
    np.testing.assert_allclose(
        image.diffuse[0, 0][inner], (expected / (np.pi * diffuse_transmittance()))[inner], rtol=0.004
    )
    sky = render_ambient(sheet, 1.0, Medium([dense], 0.2))
    half = 0.5 * (1.0 + sheet.normals[..., 2])
    np.testing.assert_allclose(sky[0][inner], (half * albedo * (1 - fresnel(rough)))[inner], rtol=0.006)


def test_a_mirror_shows_the_light_where_angles_are_equal() -> None:
    """On a level sheet: at the fraction camera / (camera + light) of the way, heights above the sheet."""
    sheet = perspective_plane(perspective_camera((160, 240), 4.0, 60.0, off=(11.0, 5.0)), -8.0)
    _, sharp = light_on(cut_out(sheet), Led("white", (40.0, 6.0, 50.0)), 0.02, 0.0)
    row, column = np.unravel_index(np.argmax(sharp), sharp.shape)
    fraction = 68.0 / (68.0 + 58.0)
    np.testing.assert_allclose(_points(sheet)[row, column, :2], [40.0 * fraction, 6.0 * fraction], atol=0.4)


def test_diffusion_has_the_pitch_of_the_fingers_distance() -> None:
    """The same sheet of skin, nearer: light spreads over more pixels, and the modulation left is that of its mm."""
    assert cut_out(perspective_plane(perspective_camera((60, 80), 10.0, 50.0), -30.0)).px_per_mm == pytest.approx(6.25)
    assert cut_out(perspective_plane(perspective_camera((60, 80), 10.0, 50.0), 25.0)).px_per_mm == pytest.approx(20.0)
    assert cut_out(ridged_egg(size=(60, 60), px_per_mm=4.0)).px_per_mm == 4.0


def test_a_card_is_lit_where_the_rays_meet_it() -> None:
    led = Led("white", (30.0, -10.0, 90.0), lobe_exponent=4.0)
    card = white_card(CAMERA, led, -12.0, step=4)
    columns, rows = np.array([40, 300, 500]), np.array([390, 200, 30])
    across, up = slopes_of_pixels(CAMERA, columns, rows)
    to = np.stack([30.0 - 122.0 * across, -10.0 - 122.0 * up, np.full(3, 102.0)], -1)
    distance = np.linalg.norm(to, axis=-1)
    lobe = (to @ np.array([30.0, -10.0, 90.0]) / distance / np.linalg.norm([30.0, -10.0, 90.0])) ** 4
    expected = 1e4 * 102.0 / distance**3 * lobe / np.pi
    np.testing.assert_allclose(card[rows, columns], expected, rtol=2e-3)


def test_the_beam_falls_off_about_its_aim() -> None:
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
    away = np.stack(np.broadcast_arrays(x - position[0], y - position[1], np.array([[-position[2]]])), -1)
    cosine = away @ aim / np.linalg.norm(away, axis=-1) / np.linalg.norm(aim)
    np.testing.assert_allclose(fraction, cosine**12, rtol=1e-4, atol=1e-5)
    to_origin = replace(even, lobe_exponent=12.0)
    same = replace(to_origin, aim=tuple(-0.01 * position))
    np.testing.assert_allclose(white_card(camera, same), white_card(camera, to_origin), rtol=1e-6)


def test_what_perspective_cannot_have_is_refused(seen: SimulatedSurface) -> None:
    led = Led("white", (52.5, 0.0, 140.0))
    with pytest.raises(BadInput, match="orthographic"):
        separate_truth(seen, led, SkinOptics(), check_mm=1.0)
    with pytest.raises(BadInput, match="orthographic"):
        pattern_states(seen, led, Checkerboard(1.0))
    with pytest.raises(BadInput, match="x_mm"):
        replace(seen, x_mm=None, y_mm=None)
    with pytest.raises(BadInput, match="x_mm"):
        replace(seen, camera=Camera(15.0, (430, 560)))
