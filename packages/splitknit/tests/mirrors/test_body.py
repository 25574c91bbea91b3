"""Sections, the planes that touch them, outlines and mirrors: against what plain geometry says."""

from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit.mirrors.body import Body
from splitknit.mirrors.fit import MAX_SQUARE, Estimate, Fit
from splitknit.mirrors.mirror import MirrorShape
from splitknit.mirrors.outline import finger_axis, medial_line, rows_of
from splitknit.mirrors.reflection import Plane, Pose, Touching, touching
from splitknit.model import Camera, Mirror

CAMERA = Camera(10.0, (400, 300))


def body_of(squareness, shear, half_width=8.0, half_height=6.0):
    """A body whose section is the same all along, but for its tip."""
    splines = np.tile([[1.5], [-4.0], [half_width], [half_height]], (1, 12))
    return Body(
        np.zeros(2), np.array([0.0, 1.0]), 10.0, 25.0, splines, squareness=squareness, shear=shear
    )


BASE = np.array([-15.0])


def section(squareness, shear):
    """The last section, and 4000 points of its upper half and, mirrored, of its lower one."""
    sections = body_of(squareness, shear).sections(BASE)
    w = np.linspace(-np.pi / 2, np.pi / 2, 2000)
    x, z = np.sin(w), np.cos(w) * (1 + squareness * np.sin(w) ** 2)
    points = np.column_stack([np.r_[x, x], np.r_[z, -z]])
    return sections, np.column_stack(
        [1.5 + 8 * points[:, 0] + shear * 6 * points[:, 1], -4 + 6 * points[:, 1]]
    )


@pytest.mark.parametrize("squareness", [0.0, 0.2, MAX_SQUARE])
@pytest.mark.parametrize("shear", [0.0, 0.1])
def test_a_line_touches_the_farthest_point(squareness, shear):
    sections, points = section(squareness, shear)
    for angle in np.linspace(0.05, 2 * np.pi, 23):
        normal = np.array([np.cos(angle), np.sin(angle)])
        touched = np.array(sections.contact(normal[:1], normal[1:])).ravel()
        assert touched @ normal == pytest.approx((points @ normal).max(), abs=2e-3)


def test_an_estimate_is_its_vector():
    start = Estimate(body_of(0.2, 0.05), {"left": Pose(0.01, 0.02, 0.3), "right": Pose()})
    again = start.at(start.vector + 0.5)
    np.testing.assert_allclose(again.vector, start.vector + 0.5)
    assert again.poses["left"].shift_mm == pytest.approx(0.8)
    assert again.body.shear == pytest.approx(0.55)


def test_the_tip_is_round():
    body = Body(
        np.zeros(2),
        np.array([0.0, 1.0]),
        10.0,
        25.0,
        np.tile([[0.0], [-5.0], [8.0], [6.0]], (1, 12)),
    )
    near = body.sections(np.array([10.0 - 0.01, 10.0 - 0.04]))
    # a sphere's cap: half width as the root of the depth
    assert near.a[1] / near.a[0] == pytest.approx(2.0, rel=1e-6)


def ellipse_mask(half_width, slant):
    """A finger of `half_width` mm that leans by `slant`, its tip a half circle at y = 12 mm."""
    y = (199.5 - np.arange(400))[:, None] / 10
    x = (np.arange(300) - 149.5)[None, :] / 10 - slant * y
    cap = np.sqrt(np.clip(1 - (np.clip(y - (12 - half_width), 0, None) / half_width) ** 2, 0, None))
    return (np.abs(x) < half_width * cap) & (y < 12)


def test_rows_measure_the_width_below_a_pixel():
    mask = ellipse_mask(6.03, 0.0)
    rows = rows_of(mask, CAMERA, 1, np.array([0.0, 1.0]))
    middle = np.abs(rows.along_mm + 3) < 5
    assert np.nanmedian(rows.width_mm[middle]) == pytest.approx(12.06, abs=0.06)
    assert rows.tip_mm == pytest.approx(12.0, abs=0.06)


def test_the_axis_of_a_finger_ignores_a_spur():
    mask = ellipse_mask(6.0, np.tan(np.deg2rad(12.0)))
    mask[250:290, 0:120] = True  # a spur: a fold of the sleeve
    axis, rows = finger_axis(mask, CAMERA, 1, np.array([0.0, 1.0]))
    assert np.rad2deg(np.arctan2(axis[0], axis[1])) == pytest.approx(12.0, abs=0.6)
    assert abs(medial_line(rows)[0]) < 5e-3


def test_an_empty_view_is_refused():
    with bad_input("is empty"):
        rows_of(np.zeros((400, 300), dtype=bool), CAMERA, 1, np.array([0.0, 1.0]))


def test_reflected_rays_pass_through_the_point_itself():
    """The mirror image of a point, seen by the camera, lies on the reflected ray through the
    point."""
    mirror = Mirror(
        "right", ((17.0, -15.0, -20.0), (17.0, 15.0, -20.0), (37.0, 15.0, 0.0), (37.0, -15.0, 0.0))
    )
    plane = Plane(mirror.point_mm, mirror.normal).posed(0.03, -0.02, 0.7)
    point = np.array([3.0, 4.0, -2.0])
    image = point - 2 * (point @ plane.normal - plane.offset_mm) * plane.normal
    for camera in (
        CAMERA,
        Camera(10.0, (400, 300), model="perspective", matrix=np.diag([1400.0, 1400.0, 1.0])),
    ):
        near = 1.0 if camera.model == "orthographic" else 1.0 - image[2] / camera.height_mm
        seen = touching(
            camera, image[None, :2] / near, np.array([[0.0, 1.0]]), np.array([[1.0, 0.0]])
        )
        ray = plane.reflect(seen)
        away = point - ray.point[0]
        assert np.linalg.norm(away - (away @ ray.direction[0]) * ray.direction[0]) < 1e-9
        assert isinstance(ray, Touching)
        assert ray.normal[0] @ point == pytest.approx(ray.offset_mm[0])


def test_a_posed_mirror_turns_leans_and_shifts():
    mirror = Mirror(
        "left",
        ((-17.0, -15.0, -20.0), (-17.0, 15.0, -20.0), (-37.0, 15.0, 0.0), (-37.0, -15.0, 0.0)),
    )
    plane = Plane(mirror.point_mm, mirror.normal)
    assert plane.posed(0.0, 0.0, 0.0).normal == pytest.approx(plane.normal)
    moved = plane.posed(0.05, 0.04, 1.5)
    level = [np.arctan2(p.normal[1], p.normal[0]) for p in (plane, moved)]
    assert level[1] - level[0] == pytest.approx(0.05, abs=1e-9)
    assert np.arcsin(moved.normal[2]) - np.arcsin(plane.normal[2]) == pytest.approx(0.04, abs=1e-9)
    assert moved.normal @ mirror.point_mm - moved.offset_mm == pytest.approx(-1.5)


def test_a_view_that_does_not_agree_is_reported():
    misfit = {"front": np.full(9, 0.03), "left": np.full(9, 0.2)}
    fit = Fit(None, {}, misfit, {name: np.ones(9) for name in misfit})  # type: ignore[arg-type]
    (finding,) = MirrorShape(CAMERA, fit, {}, {}, {}).findings
    assert str(finding).startswith("the left view's outline agrees with the others to 0.20 mm only")
    agreeing = replace(fit, misfit_mm={name: np.full(9, 0.03) for name in misfit})
    assert MirrorShape(CAMERA, agreeing, {}, {}, {}).findings == ()
