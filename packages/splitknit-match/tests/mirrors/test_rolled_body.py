"""The body between its mirrors, by outlines that formulas draw: also where the picture's border
cuts a view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rolled_scene as scene
from rolled_scene import body_between_mirrors
from splitknit.errors import BadInput
from splitknit.mirrors.views import Views
from splitknit_match.rolled.finger import _outside, _radius_of, _rolled_pad, _shape_of
from splitknit_match.rolled.parameters import ROLL_OF_SHEAR

RIG = scene.rig()
MIRRORS = {mirror.name: mirror for mirror in RIG.mirrors}


def masks() -> dict[str, np.ndarray]:
    _, found = scene.capture()
    return found


@pytest.fixture(scope="module")
def drawn() -> dict[str, np.ndarray]:
    return masks()


def views(front: np.ndarray, **sides: np.ndarray) -> Views:
    return Views(front, sides, 1)


def off_surface(body) -> np.ndarray:
    """Distance from the drawn finger, mm, around its straight part."""
    shape = _shape_of(body)
    points = shape.chart.points(shape.radius_mm) - np.array([0.0, 2.0, 0.0])
    x, y, z = np.moveaxis(points, -1, 0)
    value = np.sqrt(
        (x / scene.A) ** 2
        + (np.maximum(y, 0) / scene.CAP) ** 2
        + ((z - scene.TOP + scene.B) / scene.B) ** 2
    )
    rows = (shape.chart.length_mm < 4) & (shape.chart.length_mm > -10)
    front = np.abs(np.rad2deg(shape.chart.angle_rad)) < 100
    return ((value - 1.0) * 7.0)[np.ix_(rows, front)]


def test_the_body_is_the_finger(drawn) -> None:
    found = body_between_mirrors(
        views(drawn["front"], left=drawn["left"], right=drawn["right"]), RIG
    )
    assert found.cut == ()
    assert found.useless == ()
    # an ellipse is drawn, a flatter pad expected
    assert np.sqrt((off_surface(found.body) ** 2).mean()) < 0.2
    for name, plane in found.planes.items():
        assert np.rad2deg(np.arccos(min(1.0, float(plane.normal @ MIRRORS[name].normal)))) < 0.5


def test_an_edge_that_is_taken_for_the_holder_behind_it_is_left_out(drawn) -> None:
    spoilt = drawn["right"].copy()
    rows = np.flatnonzero(spoilt.any(axis=1))
    for row in rows[len(rows) // 4 :]:
        first = int(np.argmax(spoilt[row]))
        # by 1.7 mm beyond the side that turns away from the camera
        spoilt[row, first - 30 : first] = True
    found = body_between_mirrors(views(drawn["front"], left=drawn["left"], right=spoilt), RIG)
    assert np.sqrt((off_surface(found.body) ** 2).mean()) < 0.2  # 1.9 with all edges
    for name, plane in found.planes.items():
        assert np.rad2deg(np.arccos(min(1.0, float(plane.normal @ MIRRORS[name].normal)))) < 1.0


def test_a_cut_view_still_tells_where_its_mirror_lies(drawn) -> None:
    mirror = MIRRORS["left"]
    turn = np.deg2rad(1.0)
    turned = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    middle = np.mean(mirror.corners_mm, axis=0)
    corners = tuple(
        tuple(float(v) for v in middle + turned @ (np.array(c) - middle)) for c in mirror.corners_mm
    )
    wrong = replace(mirror, corners_mm=corners)
    # the picture ends where the pad bulges most
    column = int(np.flatnonzero(drawn["left"].any(axis=0))[0]) + round(0.6 * scene.PX)
    camera = replace(RIG.camera, image_size=(scene.SIZE[0], scene.SIZE[1] - 2 * column))
    cut = {
        name: np.ascontiguousarray(mask[:, column : scene.SIZE[1] - column])
        for name, mask in drawn.items()
    }
    found = body_between_mirrors(
        views(cut["front"], left=cut["left"]),
        replace(RIG, camera=camera, mirrors=(wrong, MIRRORS["right"])),
    )
    assert found.cut == ("left",)
    plane = found.planes["left"]
    assert np.rad2deg(np.arccos(min(1.0, float(plane.normal @ mirror.normal)))) < 0.6
    assert np.rad2deg(np.arccos(float(wrong.normal @ mirror.normal))) > 0.6
    # of a view that ends beyond the pad's rim nothing is left but the far side, which alone makes
    # no body
    straight = drawn["left"].copy()
    edge = round((scene.SIZE[1] - 1) / 2 - 27.5 * scene.PX)
    straight[:, :edge] = False
    near = replace(mirror, corners_mm=tuple((max(x, -27.5), y, z) for x, y, z in mirror.corners_mm))
    with pytest.raises(BadInput, match="cut off at the mirror"):
        body_between_mirrors(views(drawn["front"], left=straight), replace(RIG, mirrors=(near,)))


def test_the_radius_is_where_the_body_ends(drawn) -> None:
    body = body_between_mirrors(views(drawn["front"], right=drawn["right"]), RIG).body
    fine = _shape_of(body).chart
    chart = replace(fine, angle_rad=fine.angle_rad[::8], length_mm=fine.length_mm[::8])
    radius = _radius_of(body, chart)
    assert not _outside(body, chart.points(radius - 0.05)).any()
    assert _outside(body, chart.points(radius + 0.05)).all()


def test_a_rolled_finger_is_flat_where_it_rolled_to(drawn) -> None:
    body = body_between_mirrors(
        views(drawn["front"], left=drawn["left"], right=drawn["right"]), RIG
    ).body
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
