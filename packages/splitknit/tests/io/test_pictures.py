import cv2
import numpy as np
import pytest

from handmade import finger
from splitknit.io.pictures import colour, on_paper, to_frame, upright_frame
from splitknit.report.figures import small_fields, view_from_above


@pytest.mark.parametrize("longest", [90, 200, 500])
def test_the_upright_frame_averages_the_input_pixels(longest):
    """The finger has a yaw of 12 deg."""
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
    # input pixels; the library samples at 32nds
    assert np.abs(values[v, u].T - named[:2]).max() < 0.1
    step = frame.input_from_picture[:2, 0]
    # columns run across the turned finger
    assert np.rad2deg(np.arctan2(-step[1], step[0])) == pytest.approx(12.0)


def test_the_finger_tip_is_at_the_top_of_the_frame():
    result, _ = finger()
    _, weight = to_frame(result.shape_mm, result.mask, upright_frame(result, 200))
    width = (weight > 0.5).sum(axis=1)
    rows = np.flatnonzero(width)
    assert width[rows[0] + 3] < 0.6 * width[rows[-1] - 3]


def test_a_field_that_counts_nowhere_has_no_weight():
    """Such as the ridge band of a finger that is too steep everywhere."""
    result, _ = finger()
    frame = upright_frame(result, 200)
    values, weight = to_frame(result.ridge_mm, np.zeros_like(result.mask), frame)
    assert not values.any() and not weight.any()


def test_colours_are_ordered_in_brightness():
    values = np.linspace(-1, 1, 64, dtype=np.float32)[None]
    grey = cv2.cvtColor(colour(values, -1, 1), cv2.COLOR_RGB2GRAY)[0].astype(int)
    assert (np.diff(grey) >= -1).all()
    assert grey[-1] - grey[0] > 150
    white = colour(np.zeros((1, 1), np.float32), -1, 1, diverging=True)
    assert white.min() > 240


def test_pictures_are_white_outside_the_finger():
    picture = np.zeros((2, 2, 3), np.uint8)
    weight = np.array([[0.0, 1.0], [0.5, 1.0]], np.float32)
    assert on_paper(picture, weight)[..., 0].tolist() == [[255, 0], [128, 0]]


def test_the_view_from_above_is_lit_from_the_upper_left():
    result, _ = finger()
    above = view_from_above(small_fields(result, upright_frame(result, 240))).astype(int)
    middle = slice(above.shape[0] // 2, above.shape[0] // 2 + 40)
    assert above[0, 0].min() > 240
    left, right = above[middle, 40:90].mean(), above[middle, -90:-40].mean()
    assert left > 1.1 * right  # lit from the upper left
