"""Checkerboards drawn here: where corners are, whatever the light, and no board but the one that
was asked for."""

import cv2
import numpy as np
import pytest

from camera_views import seen, turned
from refusals import bad_input
from splitknit_rig.calibration.targets import Board, find_board

SIZE = (400, 560)
LENS = np.array([[1900.0, 0, 279.5], [0, 1900.0, 199.5], [0, 0, 1]])


def picture(board, tilt=20.0, towards=40.0, *, spin=5.0, middle=(0.0, 0.0, 140.0), blur=0.8):
    """(H, W) float picture in 0 to 1 and the corners' true places; black squares in the corners, a
    white rim."""
    sub = 8
    rotation = turned(tilt, towards, spin)
    half = np.array([board.columns - 1, board.rows - 1]) / 2
    scale = 40  # pixels a square of the drawing
    cells = np.indices((board.rows + 3, board.columns + 3)).sum(axis=0) % 2 == 0
    drawing = np.where(cells, 0.05, 0.85)
    drawing[[0, -1]] = 0.85
    drawing[:, [0, -1]] = 0.85
    drawing = np.kron(drawing, np.ones((scale, scale)))
    # corners (i, j) of the board lie at (j + 2) * scale - 0.5 in the drawing
    marks = np.array(
        [[-2, -2], [board.columns, -2], [board.columns, board.rows], [-2, board.rows]], dtype=float
    )
    ends = seen((marks - half) * board.square_mm, rotation, np.array(middle), LENS)
    source = (marks + 2) * scale - 0.5
    warp = cv2.getPerspectiveTransform(
        source.astype(np.float32), ((ends + 0.5) * sub - 0.5).astype(np.float32)
    )
    large = cv2.warpPerspective(
        drawing, warp, (SIZE[1] * sub, SIZE[0] * sub), flags=cv2.INTER_AREA, borderValue=0.02
    )
    image = cv2.resize(large, SIZE[::-1], interpolation=cv2.INTER_AREA)
    truth = seen(board.points_mm - board.points_mm.mean(axis=0), rotation, np.array(middle), LENS)
    return cv2.GaussianBlur(image, (0, 0), blur), truth


def error(corners, truth):
    """Rms distance, whichever corner is the first."""
    assert corners is not None
    return min(
        float(np.sqrt(((corners - there) ** 2).sum(axis=1).mean()))
        for there in (truth, truth[::-1])
    )


@pytest.mark.parametrize(("tilt", "towards"), [(0, 0), (20, 40), (35, 250)])
def test_corners_lie_where_they_are_drawn(tilt, towards):
    board = Board(9, 6, 3.0)
    image, truth = picture(board, tilt, towards)
    assert error(find_board(image, board), truth) < 0.04


def test_light_depth_and_colour_do_not_matter():
    board = Board(9, 6, 3.0)
    image, truth = picture(board)
    shade = np.linspace(0.5, 1, SIZE[1])[None] * np.linspace(1, 0.7, SIZE[0])[:, None]
    noise = np.random.default_rng(0).normal(0, 0.005, image.shape)
    dark = np.clip(0.15 * image * shade + 0.1 * noise, 0, 1)
    assert error(find_board(np.round(65535 * dark).astype(np.uint16), board), truth) < 0.1
    colours = np.clip(image[..., None] * (1.0, 0.8, 0.6) + noise[..., None], 0, 1)
    assert error(find_board(np.round(255 * colours).astype(np.uint8), board), truth) < 0.06
    plain = find_board(image, board)
    assert find_board(255 * image, board) == pytest.approx(plain, abs=1e-3)


@pytest.mark.slow
def test_only_the_board_that_was_asked_for_is_found():
    image, truth = picture(Board(9, 6, 3.0))
    reordered = find_board(image, Board(6, 9, 3.0))  # the same board, its corners in another order
    nearest = np.linalg.norm(reordered[:, None] - truth, axis=2).argmin(axis=1)
    assert sorted(nearest) == list(range(54))
    assert np.abs(reordered - truth[nearest]).max() < 0.1
    assert np.diff(nearest.reshape(9, 6), axis=1).std() == 0
    for size in ((8, 6), (9, 5), (7, 5), (10, 6), (9, 7)):
        assert find_board(image, Board(*size, 3.0)) is None, size


@pytest.mark.slow
def test_a_board_that_is_cut_off_or_absent_is_not_found():
    board = Board(9, 6, 3.0)
    image, _ = picture(board, middle=(9.0, 0.0, 140.0))
    assert find_board(image, board) is None
    noise = cv2.GaussianBlur(np.random.default_rng(1).random(SIZE), (0, 0), 3)
    assert find_board(noise, board) is None


@pytest.mark.parametrize("text", ["9", "9x6x3", "-9x6"])
def test_what_is_no_size(text):
    with bad_input("such as 9x6"):
        Board.named(text, 3.0)


def test_what_is_no_picture():
    board = Board(9, 6, 3.0)
    with bad_input("one brightness all over"):
        find_board(np.ones((50, 50)), board)
    for square in (0.0, np.nan, 1e9):
        with bad_input("side of a square"):
            Board(9, 6, square)
