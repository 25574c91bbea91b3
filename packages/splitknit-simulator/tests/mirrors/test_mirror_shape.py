"""The finger's shape from the outlines of its views: against the truth, with mirrors off their place, and refused."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mirrored import Scene, scene, turned
from splitknit.errors import BadInput
from splitknit.mirrors.body import Slopes
from splitknit.mirrors.mirror import mirror_shape
from splitknit.mirrors.settings import MirrorShapeSettings
from splitknit.mirrors.views import Views
from splitknit_simulator.finger.finger import FingerPose


@pytest.fixture(scope="module")
def finger() -> Scene:
    return scene(9002)


def only(views: Views, *names: str) -> Views:
    return replace(views, mirrors={name: views.mirrors[name] for name in names})


def test_one_mirror_gives_the_shape(finger: Scene) -> None:
    shape = mirror_shape(only(finger.views, "left"), finger.rig)
    assert finger.rms_mm(shape) < 0.2
    pose = shape.facts["poses"]["left"]
    assert abs(pose["turn_deg"]) < 0.3 and abs(pose["lean_deg"]) < 1.0  # the mirror stands where the rig file says
    x, y, z = shape.points(slice(None), slice(None))
    inside = np.isfinite(z)
    assert 0.9 < inside.sum() / finger.mask.sum() < 1.02
    assert np.allclose(np.diff(x[0]), 1 / finger.rig.camera.px_per_mm, rtol=1e-3) and y[0, 0] > y[-1, 0]


@pytest.mark.parametrize(("turn", "lean", "shift"), [(3.0, 0.0, 2.0), (-2.0, -2.2, -2.0)])
def test_a_mirror_off_its_place_is_found(finger: Scene, turn: float, lean: float, shift: float) -> None:
    """The rig file is wrong by up to 3 deg and 2 mm; the view is the true mirror's."""
    wrong = replace(finger.rig, mirrors=tuple(turned(mirror, turn, lean, shift) for mirror in finger.rig.mirrors))
    for names in (("left",), ("left", "right")):
        shape = mirror_shape(only(finger.views, *names), wrong)
        assert finger.rms_mm(shape) < 0.25
        for name in names:
            assert shape.facts["poses"][name]["turn_deg"] == pytest.approx(-turn, abs=0.3)


def test_the_thesis_is_misled_by_what_ours_finds(finger: Scene) -> None:
    thesis = MirrorShapeSettings(method="thesis")
    first = mirror_shape(only(finger.views, "left"), finger.rig, thesis)
    assert finger.rms_mm(first) < 0.35
    assert first.facts["section"] == "ellipse"
    assert np.isfinite(first.points(slice(None), slice(None))[2]).sum() > 0.85 * finger.mask.sum()


def test_a_mirror_beyond_the_tip_joins(finger: Scene) -> None:
    shape = mirror_shape(finger.views, finger.rig)
    assert set(shape.facts["poses"]) == {"left", "right", "tip"}
    assert finger.rms_mm(shape) < 0.2
    with pytest.raises(BadInput, match="only the mirror beyond the tip"):
        mirror_shape(only(finger.views, "tip"), finger.rig)


def test_slopes_tell_the_roll() -> None:
    """A rolled finger: its outlines look like an upright one's; true slopes of the skin make the difference."""
    rolled = scene(9002, ("left",), FingerPose(roll_rad=0.14, insertion_mm=28.5))
    plain = mirror_shape(rolled.views, rolled.rig)
    pitch = 1 / rolled.rig.camera.px_per_mm
    right, down = np.gradient(rolled.shape_mm, axis=1) / pitch, np.gradient(rolled.shape_mm, axis=0) / pitch
    known = np.isfinite(right) & np.isfinite(down)
    rows, columns = (part[::37] for part in np.nonzero(known))
    height, width = rolled.rig.camera.image_size
    places = np.column_stack([(columns - (width - 1) / 2) * pitch, ((height - 1) / 2 - rows) * pitch])
    slopes = Slopes(places, right[rows, columns].astype(float), -down[rows, columns].astype(float))
    told = mirror_shape(rolled.views, rolled.rig, slopes_on=lambda _: slopes)
    assert rolled.rms_mm(told) < 0.75 * rolled.rms_mm(plain)
    assert told.facts["section_seen_by"] == "slopes"


def test_a_partly_missing_inner_outline_costs_little(finger: Scene) -> None:
    """The groove hides a part of the nail's side."""
    mask = finger.views.mirrors["left"].copy()
    rows, columns = np.nonzero(mask)
    hidden = (np.arange(mask.shape[1]) > np.quantile(columns, 0.9))[None, :] & (
        (np.arange(mask.shape[0]) > np.quantile(rows, 0.35)) & (np.arange(mask.shape[0]) < np.quantile(rows, 0.6))
    )[:, None]
    views = Views(finger.views.front, {"left": mask & ~hidden}, 1)
    whole = mirror_shape(only(finger.views, "left"), finger.rig)
    held = mirror_shape(views, finger.rig)
    assert finger.rms_mm(held) < finger.rms_mm(whole) + 0.1


def test_views_of_two_fingers_are_refused(finger: Scene) -> None:
    """The mirror shows a finger at another place along the mirror, or one of another thickness."""
    other = np.roll(finger.views.mirrors["left"], 60, axis=0)
    other[:60] = False
    with pytest.raises(BadInput, match="do not fit one finger"):
        mirror_shape(Views(finger.views.front, {"left": other}, 1), finger.rig)
    mask = finger.views.mirrors["left"]
    middle = int(np.flatnonzero(mask.any(axis=0)).mean())
    size = (mask.shape[1], mask.shape[0])
    thin = cv2.warpAffine(mask.astype(np.uint8), np.array([[0.3, 0.0, 0.7 * middle], [0.0, 1.0, 0.0]]), size) > 0
    with pytest.raises(BadInput, match="times as thick as it is broad"):
        mirror_shape(Views(finger.views.front, {"left": thin}, 1), finger.rig)


def test_a_view_cut_off_at_its_mirrors_edge_is_refused_or_left_out(finger: Scene) -> None:
    mask = finger.views.mirrors["left"].copy()
    columns = np.flatnonzero(mask.any(axis=0))
    mask[:, : columns[0] + 20] = False  # the pad is away from the finger: on the left of the left mirror
    cut = Views(finger.views.front, {"left": mask}, 1)
    for settings in (MirrorShapeSettings(), MirrorShapeSettings(method="thesis")):
        with pytest.raises(BadInput, match="left mirror is cut off"):
            mirror_shape(cut, finger.rig, settings)
    both = Views(finger.views.front, {"left": mask, "right": finger.views.mirrors["right"]}, 1)
    shape = mirror_shape(both, finger.rig)
    assert shape.facts["views_cut_off"] == ["left"] and shape.facts["mirrors"] == ["right"]


def test_a_perspective_camera_sees_the_same_finger() -> None:
    seen = scene(9002, ("left",), model="perspective")
    assert seen.rig.camera.model == "perspective"
    assert seen.rms_mm(mirror_shape(seen.views, seen.rig)) < 0.2


def test_the_same_views_give_the_same_shape(finger: Scene) -> None:
    views = only(finger.views, "left")
    first, second = (mirror_shape(views, finger.rig) for _ in range(2))
    window = slice(200, 300), slice(100, 200)
    assert first.points(*window)[2].tobytes() == second.points(*window)[2].tobytes()
