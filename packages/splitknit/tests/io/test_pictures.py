from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from handmade import finger
from splitknit.io.pictures import PictureFrame, colour, on_paper, to_frame, upright_frame
from splitknit.report.figures import _SmallFields, _top_view, oblique_view, small_fields


@pytest.mark.parametrize("longest", [90, 200, 500])
def test_frame_is_upright_and_averages(longest: int) -> None:
    """Every picture pixel holds the mean of the place that its frame names, in a finger at a yaw of 12 deg."""
    result, _ = finger()
    frame = upright_frame(result, longest)
    assert max(frame.size) <= longest
    rows, columns = np.mgrid[0 : result.mask.shape[0], 0 : result.mask.shape[1]].astype(np.float32)
    values, weight = to_frame(np.stack([columns, rows], axis=-1), result.mask, frame)
    assert (weight[0] == 0).all()
    assert (weight[:, 0] == 0).all()
    v, u = np.nonzero(weight > 0.999)
    assert v.size > 0.5 * weight.size
    named = frame.input_from_picture @ np.stack([u, v, np.ones(u.size)])
    assert np.abs(values[v, u].T - named[:2]).max() < 0.1  # input pixels; the library samples at 32nds
    step = frame.input_from_picture[:2, 0]
    assert np.rad2deg(np.arctan2(-step[1], step[0])) == pytest.approx(12.0)  # columns run across the turned finger


def test_tip_is_at_the_top() -> None:
    result, _ = finger()
    _, weight = to_frame(result.shape_mm, result.mask, upright_frame(result, 200))
    width = (weight > 0.5).sum(axis=1)
    rows = np.flatnonzero(width)
    assert width[rows[0] + 3] < 0.6 * width[rows[-1] - 3]


def test_colours_are_ordered_in_brightness() -> None:
    values = np.linspace(-1, 1, 64, dtype=np.float32)[None]
    grey = cv2.cvtColor(colour(values, -1, 1), cv2.COLOR_RGB2GRAY)[0].astype(int)
    assert (np.diff(grey) >= -1).all()
    assert grey[-1] - grey[0] > 150
    white = colour(np.zeros((1, 1), np.float32), -1, 1, diverging=True)
    assert white.min() > 240


def test_paper_shows_outside() -> None:
    picture = np.zeros((2, 2, 3), np.uint8)
    weight = np.array([[0.0, 1.0], [0.5, 1.0]], np.float32)
    assert on_paper(picture, weight)[..., 0].tolist() == [[255, 0], [128, 0]]


def _fields(height: NDArray[np.float32], weight: NDArray[np.float32]) -> _SmallFields:
    normals = np.broadcast_to(np.float32([0, 0, 1]), (*height.shape, 3))
    return _SmallFields(PictureFrame(np.eye(3), height.shape, 0.1), weight, height, height * 0, height, normals)


def _bump() -> _SmallFields:
    """A plane with a wall of 3 mm to the right of the middle column, ten pixels before the front edge."""
    height = np.zeros((120, 80), np.float32)
    height[100:110, 40:60] = 3.0
    return _fields(height, np.ones(height.shape, np.float32))


def test_what_is_in_front_hides_what_is_behind() -> None:
    """Seen at 60 deg, a wall of 3 mm rises by 26 pixels on the screen and hides the plane behind it."""
    view = oblique_view(_bump(), tilt_deg=60.0).astype(int)
    flat = oblique_view(_fields(np.zeros((120, 80), np.float32), _bump().weight), tilt_deg=60.0)
    assert abs(view.shape[0] - flat.shape[0]) <= 3  # the wall does not reach above the far edge
    changed = np.abs(view[: flat.shape[0]] - flat.astype(int)[: view.shape[0]]).max(axis=2) > 25
    rows, columns = np.nonzero(changed[8:-8, 14:-14])
    assert 20 <= np.ptp(rows) <= 40
    assert columns.min() > 20  # only to the right


def test_a_picture_grows_with_the_surface_s_width_not_with_its_heights() -> None:
    """A wall of a kilometre, as a failed integration made one."""
    bump = _bump()
    view = oblique_view(_fields(bump.height_mm * np.float32(3e5), bump.weight), tilt_deg=60.0)
    assert view.shape[0] < 3 * bump.weight.shape[0]


def test_a_gap_between_two_parts_stays_empty() -> None:
    """Columns that show nothing, between others that do."""
    bump = _bump()
    weight = bump.weight.copy()
    weight[:, 30:50] = 0.0
    view = oblique_view(_fields(bump.height_mm * 0, weight), tilt_deg=60.0)
    columns = (view.min(axis=2) < 235).any(axis=0)
    shown = np.flatnonzero(columns)
    assert np.diff(shown).max() > 18  # of 20, whose edges are smooth


def test_holes_of_a_ragged_surface_do_not_stand_out_as_spikes() -> None:
    """A plane 5 mm below zero, the height that is kept where nothing was measured."""
    weight = _bump().weight.copy()
    plane = _fields(np.full(weight.shape, -5.0, np.float32), weight)
    whole = oblique_view(plane, tilt_deg=60.0)
    weight[20:100:12, 15:65:12] = 0.0
    torn = oblique_view(_fields(plane.height_mm * (weight > 0), weight), tilt_deg=60.0)
    assert abs(torn.shape[0] - whole.shape[0]) <= 2


def test_views_show_the_finger_and_the_light() -> None:
    result, _ = finger()
    surface = small_fields(result, upright_frame(result, 240)).exaggerated(2.0)
    above = _top_view(surface).astype(int)
    middle = slice(above.shape[0] // 2, above.shape[0] // 2 + 40)
    assert above[0, 0].min() > 240
    left, right = above[middle, 40:90].mean(), above[middle, -90:-40].mean()
    assert left > 1.1 * right  # lit from the upper left
    side = oblique_view(surface, turn_deg=40.0, tilt_deg=60.0)
    assert side[0, 0].min() > 240
    assert 0.3 < (side.max(axis=2) < 235).mean() < 0.9


def test_steeper_view_is_flatter() -> None:
    result, _ = finger()
    surface = small_fields(result, upright_frame(result, 240))
    low, high = (oblique_view(surface, tilt_deg=tilt).shape[0] for tilt in (75.0, 20.0))
    assert low < 0.8 * high
