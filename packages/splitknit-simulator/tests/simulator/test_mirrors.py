"""Mirrors beside the simulated finger: where they stand, what they show, how they light."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from refusals import bad_input
from splitknit.model import Mirror
from splitknit_simulator.camera.lens import pixels_of_points
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.finger.finger import FingerPose, draw_finger
from splitknit_simulator.finger.master_print import MasterPrintSettings
from splitknit_simulator.finger.raycast import Placement, rays_of
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.light.skin import SkinOptics
from splitknit_simulator.mirror_view import as_built
from splitknit_simulator.rigs import MirrorSettings, mirror_rig
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

ALL = ("left", "right", "tip")
FINGER = draw_finger(4, print_settings=MasterPrintSettings(proximal_mm=12.0))
QUIET = SensorSettings(noise=False, bits=16, raw_bits=16)
POSE = FingerPose(yaw_rad=0.05, roll_rad=0.1, insertion_mm=29.5)


def settings(names=ALL, scale=0.12, **views):
    chosen = MirrorSettings(
        names=names, nir=False, truth_pitch_mm=0.3, ridges_to_deg=180.0, **views
    )
    return TwinSettings(scale=scale, mirrors=chosen, pose=POSE, skin=SkinOptics(), sensor=QUIET)


@pytest.fixture(scope="module")
def captures():
    kinds = {
        "orthographic": settings(),
        "perspective": settings(model="perspective"),
        "faint": settings(reflectance=1e-6),
    }
    return {
        kind: (chosen, *simulate_capture(4, settings=chosen, finger=FINGER))
        for kind, chosen in kinds.items()
    }


@pytest.fixture(params=["orthographic", "perspective"])
def taken(request, captures):
    return captures[request.param]


@pytest.fixture
def taken_once(captures):
    return captures["orthographic"]


def test_the_default_mirrors_fit_the_picture():
    rig = mirror_rig(MirrorSettings(names=ALL), 0.3)
    rows, columns = rig.camera.image_size
    for mirror in rig.mirrors:
        column, row = pixels_of_points(rig.camera, *np.array(mirror.corners_mm).T)
        assert column.min() > 0 and column.max() < columns - 1
        assert row.min() > 0 and row.max() < rows - 1


def test_true_mirrors_are_near_the_drawn_ones_and_seeded():
    views = MirrorSettings(names=ALL)
    rig = mirror_rig(views, 0.3)
    turns, shifts = [], []
    for seed in range(200):
        for drawn, true in zip(rig.mirrors, as_built(rig.mirrors, views, seed), strict=True):
            turns.append(np.degrees(np.arccos(np.clip(drawn.normal @ true.normal, -1, 1))))
            shifts.append(true.point_mm - drawn.point_mm)
    assert np.abs(shifts).max() <= 2.0 and np.std(shifts) == pytest.approx(0.7, abs=0.03)
    assert max(turns) <= 3.0 * np.sqrt(2) and np.sqrt(np.mean(np.square(turns))) == pytest.approx(
        np.sqrt(2), abs=0.1
    )
    first, second = (as_built(rig.mirrors, views, 7) for _ in range(2))
    assert first == second != as_built(rig.mirrors, views, 8)
    exact = as_built(rig.mirrors, replace(views, turn_sd_deg=0.0, shift_sd_mm=0.0), 7)
    np.testing.assert_allclose(exact[0].corners_mm, rig.mirrors[0].corners_mm, atol=1e-12)


def reflected(mirror, points):
    """Points (..., 3) behind a mirror."""
    return points - 2 * ((points - mirror.point_mm) @ mirror.normal)[..., None] * mirror.normal


def traced(truth, camera, name, count=40):
    """Rays of some of a view's pixels, reflected one by one and followed in small steps to the
    smooth finger."""
    body = FingerBody(FINGER.shape)
    rotation, shift = truth["body_rotation"], truth["body_shift_mm"]
    point, normal = truth[f"mirror_{name}_point_mm"], truth[f"mirror_{name}_normal"]
    rows, columns = np.nonzero(truth[f"view_{name}_mask"])
    # not at the very outline, where a hundredth of a pixel decides
    chosen = np.random.default_rng(1).choice(rows.size, count, replace=False)
    result = []
    for row, column in zip(rows[chosen], columns[chosen], strict=True):
        rays = rays_of(camera, np.array([row]), np.array([column]))
        start, below = (np.array(rays.at(np.array([z]))).ravel() for z in (100.0, 0.0))
        way = (below - start) / np.linalg.norm(below - start)
        at_mirror = start + way * float((point - start) @ normal) / float(way @ normal)
        turned = way - 2 * float(way @ normal) * normal
        # fine steps up to the first point inside
        along = np.arange(0.0, 90.0, 0.02)
        places = (at_mirror + along[:, None] * turned - shift) @ rotation
        inside = body.value_and_gradient(*places.T)[0] < 0
        assert inside.any(), (name, row, column)
        distance = along[np.argmax(inside)]
        result.append((row, column, at_mirror, turned, distance))
    return result


def test_a_pixel_in_a_mirror_shows_the_point_that_its_reflected_ray_meets(taken):
    chosen, capture, truth = taken
    assert chosen.mirrors.model == capture.rig.camera.model
    for name in ALL:
        apart = []
        for row, column, at_mirror, turned, distance in traced(truth, capture.rig.camera, name):
            met = at_mirror + turned * distance
            mirror = Mirror(name, tuple(map(tuple, truth[f"mirror_{name}_corners_mm"])))
            behind = reflected(mirror, met)
            apart.append(float(truth[f"view_{name}_shape_mm"][row, column]) - behind[2])
        assert np.median(np.abs(apart)) < 0.03
        assert np.quantile(np.abs(apart), 0.9) < 0.05


def places_in_view(truth, camera, name):
    """(N, 3) points of the skin that a view shows, as they lie behind the mirror, and their
    pixels."""
    rows, columns = np.nonzero(truth[f"view_{name}_mask"])
    z = truth[f"view_{name}_height_mm"][rows, columns].astype(float)
    if f"view_{name}_x_mm" in truth:
        x, y = (truth[f"view_{name}_{axis}_mm"][rows, columns].astype(float) for axis in "xy")
    else:
        x = (columns - (camera.image_size[1] - 1) / 2) / camera.px_per_mm
        y = ((camera.image_size[0] - 1) / 2 - rows) / camera.px_per_mm
    return np.stack([x, y, z], axis=1), rows, columns


def test_points_in_a_mirror_lie_on_the_finger(taken):
    _, capture, truth = taken
    body = FingerBody(FINGER.shape)
    placement = Placement(truth["body_rotation"], truth["body_shift_mm"])
    for name in ALL:
        points, rows, columns = places_in_view(truth, capture.rig.camera, name)
        mirror = Mirror(name, tuple(map(tuple, truth[f"mirror_{name}_corners_mm"])))
        real = reflected(mirror, points)
        distance, *_ = body.distance_and_chart(*placement.to_finger(*real.T))
        relief = 1e-3 * truth[f"view_{name}_relief_um"][rows, columns]
        assert np.abs(distance - relief).max() < 2e-3
        seen = truth[f"view_{name}_normals"][rows, columns].astype(float)
        normals = seen - 2 * np.outer(seen @ mirror.normal, mirror.normal)
        _, gx, gy, gz = body.value_and_gradient(*placement.to_finger(*real.T))
        smooth = placement.normal_to_camera(gx, gy, gz)
        assert np.median((normals * smooth).sum(axis=1)) > 0.95
        # the mirror's face is on the way: the finger is before it, its image behind
        assert ((real - mirror.point_mm) @ mirror.normal).min() > 0.3


def test_the_truth_of_the_body_agrees_with_the_front_view(taken_once):
    _, capture, truth = taken_once
    points, normals = (
        truth[k].reshape(-1, 3).astype(float) for k in ("body_points_mm", "body_normals")
    )
    column, row = pixels_of_points(capture.rig.camera, *points.T)
    i, j = np.rint(row).astype(int), np.rint(column).astype(int)
    seen = (normals[:, 2] > 0.7) & (i >= 0) & (i < truth["mask"].shape[0])
    seen &= np.hypot(row - i, column - j) < 0.15
    apart = truth["height_mm"][i[seen], j[seen]] - points[seen, 2]
    assert seen.sum() > 100
    assert np.nanmedian(np.abs(apart)) < 0.02
    chart = truth["chart_mm"][i[seen], j[seen]] - truth["body_chart_mm"].reshape(-1, 2)[seen]
    assert np.nanmedian(np.abs(chart)) < 0.05
    theta, y = truth["body_theta_rad"], truth["body_y_mm"]
    assert truth["body_points_mm"].shape == (y.size, theta.size, 3)
    assert np.abs(theta + theta[::-1]).max() < 1e-12 and np.diff(y) == pytest.approx(0.3)


def test_mirrors_that_reflect_nothing_do_not_change_the_front_view(captures):
    faint, capture, truth = captures["faint"]
    alone = replace(faint, rig=replace(capture.rig, mirrors=()), mirrors=MirrorSettings())
    plain, plain_truth = simulate_capture(4, settings=alone, finger=FINGER)
    mask = truth["mask"]
    assert np.array_equal(mask, plain_truth["mask"])
    np.testing.assert_array_equal(truth["height_mm"], plain_truth["height_mm"])
    ours, theirs = (c.bands["white"].pixels[:, mask].astype(float) for c in (capture, plain))
    assert np.abs(ours - theirs).max() <= 4.0  # of 65535
    for name in ALL:
        inner = ndimage.binary_erosion(truth[f"view_{name}_mask"], iterations=2)
        assert capture.bands["white"].pixels[:, inner].max() < 10


def test_mirrored_leds_light_the_sides(captures):
    (_, lit, truth), (_, unlit, dark) = captures["orthographic"], captures["faint"]
    light, less = (
        c.bands["white"].pixels.astype(float) / t["exposure_white"]
        for c, t in ((lit, truth), (unlit, dark))
    )
    mask, normals = truth["mask"], truth["normals"]
    # a single steep pixel of a pore rings by less than a hundredth where the skin is laid out:
    # means of 3 x 3
    more = ndimage.uniform_filter(np.where(mask[..., None], light - less, 0.0), (1, 3, 3, 1))
    assert more.min() > -1e-3 * less[:, mask].max()
    for axis, sign in ((0, 1), (0, -1), (1, 1)):
        side, middle = mask & (sign * normals[..., axis] > 0.85), mask & (normals[..., 2] > 0.995)
        assert light[:, side].mean() > 1.5 * less[:, side].mean()
        assert light[:, middle].mean() < 1.2 * less[:, middle].mean()


def test_skin_seen_in_front_and_in_a_mirror_differs_by_the_reflectance(taken):
    _, capture, truth = taken
    pixels = capture.bands["white"].pixels[..., 0].astype(float)
    front = truth["mask"] & (truth["normals"][..., 2] > 0.4)
    tree = cKDTree(truth["chart_mm"][front])
    for name in ("left", "right"):
        mask = truth[f"view_{name}_mask"] & (truth[f"view_{name}_normals"][..., 2] > 0.4)
        apart, nearest = tree.query(truth[f"view_{name}_chart_mm"][mask])
        same = apart < 0.12
        assert same.sum() > 60
        for light in pixels:
            here, there = light[mask][same], light[front][nearest[same]]
            bright = there > 0.2 * there.max()
            # Fresnel, glare, neighbours
            assert np.median(here[bright] / there[bright]) == pytest.approx(0.9, abs=0.15)


def test_a_capture_has_the_drawn_mirrors_and_its_truth_the_true_ones(taken_once):
    chosen, capture, truth = taken_once
    assert (
        [mirror.name for mirror in capture.rig.mirrors] == list(truth["mirror_names"]) == list(ALL)
    )
    assert capture.rig.mirrors == mirror_rig(chosen.mirrors, chosen.scale).mirrors
    for mirror in capture.rig.mirrors:
        apart = np.abs(
            np.array(mirror.corners_mm) - truth[f"mirror_{mirror.name}_corners_mm"]
        ).max()
        assert 0.05 < apart < 5.0
        assert truth[f"view_{mirror.name}_mask"].sum() > 300
        assert not (truth[f"view_{mirror.name}_mask"] & truth["mask"]).any()
    assert set(capture.bands) == {"white"}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"names": ("up",)}, "left, right and tip"),
        ({"names": ("tip", "tip")}, "each once"),
        ({"reflectance": 1.5}, "mirrors.reflectance"),
        ({"model": "fisheye"}, "perspective"),
    ],
)
def test_impossible_mirror_settings_are_refused(change, says):
    with bad_input(says):
        MirrorSettings(**change)


def test_fingers_that_mirrors_cannot_show_are_refused():
    beside = replace(settings(), pose=replace(POSE, x_mm=-14.0))
    with bad_input("touches the left mirror"):
        simulate_capture(4, settings=beside, finger=FINGER)
    far = settings(names=("right",), px_per_mm=130.0)
    with bad_input("outside the picture"):
        simulate_capture(4, settings=replace(far, pose=FingerPose(insertion_mm=9.0)), finger=FINGER)
    rig = mirror_rig(MirrorSettings(names=("right",)), 0.1)
    with bad_input("no left mirror"):
        simulate_capture(4, settings=replace(settings(names=("left",)), rig=rig), finger=FINGER)
