"""The body between its mirrors, by outlines that formulas draw: also where the picture's border
cuts a view."""

from dataclasses import replace

import numpy as np
import pytest

import rolled_scene as scene
from refusals import bad_input
from rolled_scene import body_between_mirrors
from splitknit.mirrors.views import Views
from splitknit_match.rolled.finger import ROLL_OF_SHEAR, _rolled_pad, _shape_of

RIG = scene.rig()
MIRRORS = {mirror.name: mirror for mirror in RIG.mirrors}


@pytest.fixture(scope="module")
def masks():
    return scene.capture()[1]


def views(front, **sides):
    return Views(front, sides, 1)


def rms_mm(body):
    """Distance from the drawn finger, around its straight part."""
    shape = _shape_of(body)
    rows = (shape.chart.length_mm < 4) & (shape.chart.length_mm > -10)
    front = np.abs(np.rad2deg(shape.chart.angle_rad)) < 100
    points = shape.chart.points(shape.radius_mm)[np.ix_(rows, front)]
    return float(np.sqrt((scene.off_surface_mm(points) ** 2).mean()))


def angle_deg(normal, true):
    return float(np.rad2deg(np.arccos(min(1.0, float(normal @ true)))))


def test_the_body_of_three_views_is_the_finger(masks):
    shape = body_between_mirrors(views(**masks), RIG)
    assert shape.cut == ()
    assert shape.useless == ()
    assert rms_mm(shape.body) < 0.2  # an ellipse is drawn, a flatter pad expected
    for name, plane in shape.planes.items():
        assert angle_deg(plane.normal, MIRRORS[name].normal) < 0.5


def test_an_edge_that_is_taken_for_the_holder_behind_it_is_left_out(masks):
    right = masks["right"].copy()
    rows = np.flatnonzero(right.any(axis=1))
    for row in rows[len(rows) // 4 :]:
        first = int(np.argmax(right[row]))
        # by 1.7 mm beyond the side that turns away from the camera
        right[row, first - 30 : first] = True
    shape = body_between_mirrors(views(**masks | {"right": right}), RIG)
    assert rms_mm(shape.body) < 0.2  # 1.9 with all edges
    for name, plane in shape.planes.items():
        assert angle_deg(plane.normal, MIRRORS[name].normal) < 1.0


def test_a_cut_view_still_shows_where_its_mirror_lies(masks):
    mirror = MIRRORS["left"]
    turn = np.deg2rad(1.0)
    turned = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    middle = np.mean(mirror.corners_mm, axis=0)
    corners = (np.array(mirror.corners_mm) - middle) @ turned.T + middle
    wrong = replace(mirror, corners_mm=tuple(map(tuple, corners.tolist())))
    # the picture ends where the pad bulges most
    column = int(np.flatnonzero(masks["left"].any(axis=0))[0]) + round(0.6 * scene.PX)
    camera = replace(RIG.camera, image_size=(scene.SIZE[0], scene.SIZE[1] - 2 * column))
    front, left = (
        np.ascontiguousarray(masks[name][:, column:-column]) for name in ("front", "left")
    )
    rig = replace(RIG, camera=camera, mirrors=(wrong, MIRRORS["right"]))
    shape = body_between_mirrors(views(front, left=left), rig)
    assert shape.cut == ("left",)
    assert angle_deg(shape.planes["left"].normal, mirror.normal) < 0.6
    assert angle_deg(wrong.normal, mirror.normal) > 0.6


def test_a_view_that_ends_beyond_the_rim_of_the_pad_is_refused(masks):
    """The far side alone makes no body."""
    left, mirror = masks["left"].copy(), MIRRORS["left"]
    left[:, : round((scene.SIZE[1] - 1) / 2 - 27.5 * scene.PX)] = False
    near = replace(mirror, corners_mm=tuple((max(x, -27.5), y, z) for x, y, z in mirror.corners_mm))
    with bad_input("cut off at the mirror"):
        body_between_mirrors(views(masks["front"], left=left), replace(RIG, mirrors=(near,)))


def test_a_rolled_finger_is_flat_where_it_rolled_to(masks):
    body = body_between_mirrors(views(**masks), RIG).body
    chart = _shape_of(body).chart
    radius = np.full(chart.shape, 7.0)
    flat, roll = 0.16, 0.1
    more = _rolled_pad(replace(body, squareness=flat, shear=roll / ROLL_OF_SHEAR), chart, radius)
    # of a circle with four flat corners, r (1 + k sin^2(2 w) / 4), turned to the right by the roll
    angle = chart.angle_rad
    turned, still = (7.0 * flat / 4.0 * np.sin(2.0 * (angle - by)) ** 2 for by in (roll, 0.0))
    front = np.abs(np.rad2deg(angle)) < 80
    assert np.abs(more[:, front] - (turned - still)[front]).max() < 0.02
    assert not _rolled_pad(replace(body, shear=0.0), chart, radius).any()
    assert not more[:, np.abs(np.rad2deg(angle)) > 90].any()
