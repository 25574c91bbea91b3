"""Mirrors beside the simulated finger: where they stand, what they show, how they light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from splitknit.errors import BadInput
from splitknit.model import Camera, Led, Mirror
from splitknit_simulator.camera.lens import pixels_of_points
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.finger.master_print import MasterPrintSettings
from splitknit_simulator.finger.raycast import Placement, rays_of
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.finger.skin_map import skin_map
from splitknit_simulator.light.lighting import cut_out
from splitknit_simulator.light.skin import SkinOptics, fresnel
from splitknit_simulator.mirror_scene import _light_through
from splitknit_simulator.mirror_twin import _bare_behind, _section_points
from splitknit_simulator.mirror_view import _Gate, _Reflection, as_built, lights_of, outline_coverage
from splitknit_simulator.rigs import (
    MirrorSettings,
    _MirrorParts,
    _nominal_mirrors,
    holder_profile,
    holder_quad,
    mirror_rig,
)
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.surface import SimulatedSurface
from splitknit_simulator.twin import simulate_capture

ALL = ("left", "right", "tip")
FINGER = draw_finger(4, print_settings=MasterPrintSettings(proximal_mm=12.0))
QUIET = SensorSettings(noise=False, bits=16, raw_bits=16)
POSE = FingerPose(yaw_rad=0.05, roll_rad=0.1, insertion_mm=29.5)


def settings(names=ALL, scale=0.12, **views):
    chosen = MirrorSettings(names=names, nir=False, truth_pitch_mm=0.3, ridges_to_deg=180.0, **views)
    return TwinSettings(scale=scale, mirrors=chosen, pose=POSE, skin=SkinOptics(), sensor=QUIET)


@pytest.fixture(scope="module")
def captures():
    kinds = {
        "orthographic": settings(),
        "perspective": settings(model="perspective"),
        "faint": settings(reflectance=1e-6),
    }
    return {kind: (chosen, *simulate_capture(4, settings=chosen, finger=FINGER)) for kind, chosen in kinds.items()}


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


def test_a_reflection_is_its_own_inverse_and_keeps_the_plane():
    mirror = mirror_rig(MirrorSettings(names=("right",)), 0.3).mirrors[0]
    once = _Reflection.of(mirror)
    points = np.random.default_rng(0).normal(size=(50, 3)) * 20
    np.testing.assert_allclose(once.points(once.points(points)), points, atol=1e-12)
    corners = np.array(mirror.corners_mm)
    np.testing.assert_allclose(once.points(corners), corners, atol=1e-12)
    led = Led("white", position_mm=(10.0, 0.0, 140.0), lobe_exponent=2.0, intensity=2.0)
    image = once.led(led, 0.9)
    assert image.intensity == pytest.approx(1.8)
    assert image.lobe_exponent == 2.0 and image.reflected
    # its beam goes to the image of what it was aimed at
    to_origin = once.points(np.zeros(3)) - np.array(image.position_mm)
    np.testing.assert_allclose(image.axis, to_origin / np.linalg.norm(to_origin), atol=1e-12)


def test_light_passes_a_gate_where_the_led_is_seen_through_it():
    gate = _Gate(np.array([[-1.0, -2, 5], [1, -2, 5], [1, 2, 5], [-1, 2, 5]]))
    led = Led("white", position_mm=(0.0, 0.0, 10.0))
    x = np.array([0.0, 1.9, 2.1, 2.0, 0.0, 0.0])
    y = np.array([0.0, 0.0, 0.0, 0.0, 3.9, 4.1])
    fraction = gate.fraction(x, y, np.zeros(6), led, 0.05)
    assert fraction == pytest.approx([1, 1, 0, 0.5, 1, 0], abs=1e-6)
    assert gate.fraction(x, y, np.full(6, 6.0), led, 0.05).max() == 0.0  # the gate lies behind
    soft = gate.fraction(np.linspace(1.5, 2.5, 11), np.zeros(11), np.zeros(11), led, 1.0)
    assert np.all(np.diff(soft) < 0) and soft[5] == pytest.approx(0.5)
    sun = Led("white", direction=(0.0, 0.0, 1.0))
    assert gate.fraction(np.array([0.9, 1.1]), np.zeros(2), np.zeros(2), sun, 1.0) == pytest.approx([1, 0], abs=1e-6)


def test_true_mirrors_are_near_the_drawn_ones_and_seeded():
    views = MirrorSettings(names=ALL)
    rig = mirror_rig(views, 0.3)
    turns, shifts = [], []
    for seed in range(200):
        for drawn, true in zip(rig.mirrors, as_built(rig.mirrors, views, seed), strict=True):
            turns.append(np.degrees(np.arccos(np.clip(drawn.normal @ true.normal, -1, 1))))
            shifts.append(true.point_mm - drawn.point_mm)
    assert np.abs(shifts).max() <= 2.0 and np.std(shifts) == pytest.approx(0.7, abs=0.03)
    assert max(turns) <= 3.0 * np.sqrt(2) and np.sqrt(np.mean(np.square(turns))) == pytest.approx(np.sqrt(2), abs=0.1)
    first, second = (as_built(rig.mirrors, views, 7) for _ in range(2))
    assert first == second != as_built(rig.mirrors, views, 8)
    exact = as_built(rig.mirrors, replace(views, turn_sd_deg=0.0, shift_sd_mm=0.0), 7)
    np.testing.assert_allclose(exact[0].corners_mm, rig.mirrors[0].corners_mm, atol=1e-12)


def traced(truth, camera, name, count=40):
    """Rays of some of a view's pixels, reflected one by one and followed in small steps to the smooth finger."""
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


def test_a_pixel_in_a_mirror_shows_what_its_reflected_ray_meets(taken):
    chosen, capture, truth = taken
    assert chosen.mirrors.model == capture.rig.camera.model
    for name in ALL:
        apart = []
        for row, column, at_mirror, turned, distance in traced(truth, capture.rig.camera, name):
            met = at_mirror + turned * distance
            mirror = Mirror(name, tuple(map(tuple, truth[f"mirror_{name}_corners_mm"])))
            behind = _Reflection.of(mirror).points(met)
            apart.append(float(truth[f"view_{name}_shape_mm"][row, column]) - behind[2])
        assert np.median(np.abs(apart)) < 0.03
        assert np.quantile(np.abs(apart), 0.9) < 0.05


def places_in_view(truth, camera, name):
    """(N, 3) points of the skin that a view shows, as they lie behind the mirror, and their pixels."""
    rows, columns = np.nonzero(truth[f"view_{name}_mask"])
    z = truth[f"view_{name}_height_mm"][rows, columns].astype(float)
    if f"view_{name}_x_mm" in truth:
        x, y = (truth[f"view_{name}_{axis}_mm"][rows, columns].astype(float) for axis in "xy")
    else:
        x = (columns - (camera.image_size[1] - 1) / 2) / camera.px_per_mm
        y = ((camera.image_size[0] - 1) / 2 - rows) / camera.px_per_mm
    return np.stack([x, y, z], axis=1), rows, columns


def test_what_a_mirror_shows_lies_on_the_finger(taken):
    _, capture, truth = taken
    body = FingerBody(FINGER.shape)
    placement = Placement(truth["body_rotation"], truth["body_shift_mm"])
    for name in ALL:
        points, rows, columns = places_in_view(truth, capture.rig.camera, name)
        mirror = Mirror(name, tuple(map(tuple, truth[f"mirror_{name}_corners_mm"])))
        back = _Reflection.of(mirror)
        real = back.points(points)
        distance, *_ = body.distance_and_chart(*placement.to_finger(*real.T))
        relief = 1e-3 * truth[f"view_{name}_relief_um"][rows, columns]
        assert np.abs(distance - relief).max() < 2e-3
        normals = back.vectors(truth[f"view_{name}_normals"][rows, columns].astype(float))
        _, gx, gy, gz = body.value_and_gradient(*placement.to_finger(*real.T))
        smooth = placement.normal_to_camera(gx, gy, gz)
        assert np.median((normals * smooth).sum(axis=1)) > 0.95
        # the mirror's face is on the way: the finger is before it, its image behind
        assert ((real - mirror.point_mm) @ mirror.normal).min() > 0.3


def test_silhouettes_of_views_and_of_the_body_agree(taken):
    _, capture, truth = taken
    camera = capture.rig.camera
    for name in ("left", "right"):
        mirror = Mirror(name, tuple(map(tuple, truth[f"mirror_{name}_corners_mm"])))
        body = truth["body_shape_mm"].astype(float).reshape(-1, 3)
        column, row = pixels_of_points(camera, *_Reflection.of(mirror).points(body).T)
        mask = truth[f"view_{name}_mask"]
        rows = np.flatnonzero(mask.sum(axis=1) > 40)[3::8]
        assert rows.size > 5
        upper = "max" if name == "right" else "min"  # the pad's side, away from the lip
        for r in rows:
            near = np.abs(row - r) < 0.7
            seen = np.flatnonzero(mask[r])
            assert getattr(seen, upper)() == pytest.approx(getattr(column[near], upper)(), abs=2.0)


def test_the_truth_all_around_agrees_with_the_front(taken_once):
    _, capture, truth = taken_once
    points, normals = (truth[k].reshape(-1, 3).astype(float) for k in ("body_points_mm", "body_normals"))
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


def test_sections_lie_on_the_body():
    for seed in (1, 5, 9):
        body = FingerBody(draw_finger(seed).shape)
        y, theta = np.meshgrid(np.linspace(-6, body.shape.length_mm - 1e-3, 60), np.linspace(-np.pi, np.pi, 80))
        value, *_ = body.value_and_gradient(*_section_points(body, y.ravel(), theta.ravel()))
        assert np.abs(value).max() < 1e-10


def test_mirrors_that_reflect_nothing_leave_the_front_as_it_is(captures):
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


def test_images_of_leds_light_the_sides(captures):
    (_, lit, truth), (_, unlit, dark) = captures["orthographic"], captures["faint"]
    light, less = (
        c.bands["white"].pixels.astype(float) / t["exposure_white"] for c, t in ((lit, truth), (unlit, dark))
    )
    mask, normals = truth["mask"], truth["normals"]
    # a single steep pixel of a pore rings by less than a hundredth where the skin is laid out: means of 3 x 3
    more = ndimage.uniform_filter(np.where(mask[..., None], light - less, 0.0), (1, 3, 3, 1))
    assert more.min() > -1e-3 * less[:, mask].max()
    for axis, sign in ((0, 1), (0, -1), (1, 1)):
        side, middle = mask & (sign * normals[..., axis] > 0.85), mask & (normals[..., 2] > 0.995)
        assert light[:, side].mean() > 1.5 * less[:, side].mean()
        assert light[:, middle].mean() < 1.2 * less[:, middle].mean()


def test_skin_that_is_seen_twice_is_as_bright_in_the_mirror_as_in_front(taken):
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
            assert np.median(here[bright] / there[bright]) == pytest.approx(0.9, abs=0.15)  # Fresnel, glare, neighbours


def test_light_by_way_of_a_mirror_falls_as_the_inverse_square_of_the_whole_way():
    mirror = Mirror("right", ((10.0, -50, -40), (10.0, 50, -40), (60.0, 50, 10), (60.0, -50, 10)), reflectance=0.8)
    led = Led("white", position_mm=(20.0, 0.0, 140.0))
    camera = mirror_rig(MirrorSettings(names=("right",)), 0.1).camera
    size = camera.image_size
    i, j = size[0] // 2, size[1] // 2
    mask = np.zeros(size, dtype=bool)
    mask[i, j] = True
    normals = np.zeros((*size, 3), dtype=np.float32)
    normals[i, j] = (1.0, 0.0, 0.0)  # a facet that faces the mirror and stands along the light of the LED itself
    flat = np.where(mask, np.float32(-5.0), np.float32(np.nan))
    surface = SimulatedSurface(
        camera, flat, flat, normals, normals, np.zeros(size, np.float32), mask, np.ones(size, np.float32)
    )
    patch = cut_out(surface)
    direct, both = (
        _light_through(patch, lights, 0.3)[0].max() for lights in (lights_of(led, ()), lights_of(led, (mirror,)))
    )
    image = np.array([190.0, 0.0, -30.0])  # of (20, 0, 140) in x - z = 50
    place = np.array([(j - (size[1] - 1) / 2) / camera.px_per_mm, ((size[0] - 1) / 2 - i) / camera.px_per_mm, -5.0])
    way = image - place
    cosine = way[0] / np.linalg.norm(way)
    expected = 0.8 * 1e4 / (way @ way) * cosine * (1 - fresnel(np.array(cosine)))
    assert both - direct == pytest.approx(float(expected), rel=1e-4)
    # a smaller mirror in the same plane, beside the way of the light
    aside = replace(mirror, corners_mm=tuple((x, y + 80.0, z) for x, y, z in mirror.corners_mm))
    missed = _light_through(patch, lights_of(led, (aside,)), 0.3)[0].max()
    assert missed == pytest.approx(direct)


def test_a_square_tip_has_no_second_body_beside_it():
    square = draw_finger(2, print_settings=MasterPrintSettings(proximal_mm=12.0))
    assert square.shape.tip_squareness > 0.2
    camera = mirror_rig(MirrorSettings(), 0.06).camera
    surface = finger_surface(square, POSE, camera)
    rows, columns = np.nonzero(surface.mask)
    x = (columns - (camera.image_size[1] - 1) / 2) / camera.px_per_mm
    assert np.abs(x).max() < 13.0
    assert surface.landmarks["tip_px"][1] == pytest.approx(rows.min(), abs=1.0)
    assert rows.min() > 0.4 * camera.image_size[0]


def test_a_capture_has_the_drawn_mirrors_and_its_truth_the_true_ones(taken_once):
    chosen, capture, truth = taken_once
    assert [mirror.name for mirror in capture.rig.mirrors] == list(truth["mirror_names"]) == list(ALL)
    assert capture.rig.mirrors == _nominal_mirrors(chosen.mirrors, capture.rig.camera)
    for mirror in capture.rig.mirrors:
        apart = np.abs(np.array(mirror.corners_mm) - truth[f"mirror_{mirror.name}_corners_mm"]).max()
        assert 0.05 < apart < 5.0
        assert truth[f"view_{mirror.name}_mask"].sum() > 300
        assert not (truth[f"view_{mirror.name}_mask"] & truth["mask"]).any()
    assert set(capture.bands) == {"white"}


def test_the_same_bytes_whatever_the_number_of_workers(taken_once):
    chosen, capture, truth = taken_once
    other, other_truth = simulate_capture(
        4, settings=replace(chosen, render=replace(chosen.render, workers=1)), finger=FINGER
    )
    np.testing.assert_array_equal(capture.bands["white"].pixels, other.bands["white"].pixels)
    for name, values in truth.items():
        np.testing.assert_array_equal(values, other_truth[name])


def test_the_lip_hides_the_lowest_part_of_a_finger_that_lies_low():
    exact = settings(scale=0.08, names=("left", "right"), turn_sd_deg=0.0, shift_sd_mm=0.0)
    low = replace(exact, pose=replace(POSE, height_mm=-5.0))
    capture, truth = simulate_capture(4, settings=low, finger=FINGER)
    camera, parts = capture.rig.camera, low.mirrors.parts
    end = holder_profile(parts)["lip"][1]
    for name, inner, outer in (("left", "max", "min"), ("right", "min", "max")):
        mirror = Mirror(name, tuple(map(tuple, truth[f"mirror_{name}_corners_mm"])))
        edge = _Reflection.of(mirror).points(holder_quad(parts, name, camera, end, end))
        face, _ = pixels_of_points(camera, *np.array(mirror.corners_mm).T)
        image, rows = pixels_of_points(camera, *edge.T)
        seen = truth[f"view_{name}_mask"][int(rows.min()) + 3 : int(rows.max()) - 3]
        columns = np.flatnonzero(seen.any(axis=0))
        assert getattr(columns, inner)() == pytest.approx(getattr(image, outer)(), abs=2.0)
        assert abs(getattr(face, inner)() - getattr(image, outer)()) > 3.0
        assert face.min() - 1 <= columns.min() and columns.max() <= face.max() + 1


def test_an_outline_covers_as_much_of_each_pixel_as_it_does():
    camera = Camera(px_per_mm=10.0, image_size=(40, 60))
    x, y = 1.23, -0.41
    corners = np.array([(x - 1, y - 0.5, 0), (x + 1, y - 0.5, 0), (x + 1, y + 0.5, 0), (x - 1, y + 0.5, 0)])
    cover = outline_coverage(camera, corners)
    assert cover.fraction.sum() == pytest.approx(200.0, rel=0.03)
    rows, columns = (np.arange(part.start, part.stop) for part in cover.window)
    total = cover.fraction.sum()
    assert (cover.fraction.sum(axis=0) @ columns) / total == pytest.approx(29.5 + 10 * x, abs=0.15)
    assert (cover.fraction.sum(axis=1) @ rows) / total == pytest.approx(19.5 - 10 * y, abs=0.15)
    outside = outline_coverage(camera, corners + np.array([50.0, 0.0, 0.0]))
    assert outside.fraction.size == 0 or outside.fraction.max() == 0.0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"names": ("up",)}, "left, right and tip"),
        ({"names": ("tip", "tip")}, "each once"),
        ({"reflectance": 1.5}, "mirrors.reflectance"),
        ({"model": "fisheye"}, "perspective"),
    ],
)
def test_impossible_settings_are_refused(change, says):
    with pytest.raises(BadInput, match=says):
        MirrorSettings(**change)


def test_scenes_that_cannot_be_are_refused():
    close = settings(parts=_MirrorParts(widest_mm=2.0, pad_height_mm=4.0))
    with pytest.raises(BadInput, match="touches the left mirror"):
        simulate_capture(4, settings=close, finger=FINGER)
    far = settings(names=("right",), px_per_mm=130.0)
    with pytest.raises(BadInput, match="outside the picture"):
        simulate_capture(4, settings=replace(far, pose=FingerPose(insertion_mm=9.0)), finger=FINGER)
    rig = mirror_rig(MirrorSettings(names=("right",)), 0.1)
    with pytest.raises(BadInput, match="no left mirror"):
        simulate_capture(4, settings=replace(settings(names=("left",)), rig=rig), finger=FINGER)


def test_the_back_of_a_finger_has_no_ridges():
    body, map_ = FingerBody(FINGER.shape), skin_map(FINGER.master(), FINGER.skin)
    bare = _bare_behind(map_, body, 112.0)
    for degrees, ridged in ((0.0, True), (70.0, True), (150.0, False), (180.0, False), (-70.0, True), (-150.0, False)):
        y = np.linspace(5.0, 15.0, 400)
        _, u, v = body.distance_and_chart(*_section_points(body, y, np.full(400, np.deg2rad(degrees))))
        relief = bare.displacement(u, v)
        if ridged:
            np.testing.assert_allclose(relief, map_.displacement(u, v), atol=1e-9)
            assert np.ptp(relief) > 0.02
        else:
            assert np.abs(relief).max() < 1e-6
    assert _bare_behind(map_, body, 180.0) is map_
