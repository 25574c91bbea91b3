"""Checkerboards and dots: where OpenCV finds them, how their edges are averaged, how a person holds
a board."""

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from bench_help import built, drawn, grey, parallel, seen
from refusals import bad_input
from splitknit_simulator.calibration_set.bench import edge_coverage, seen_at
from splitknit_simulator.calibration_set.flat import BoardScene, PrintedBoard, board_poses


def held(things, seed=3, **changes):
    pose = board_poses(seed, 1, things["camera"])[0]
    return BoardScene(**things, **pose, **changes)


def corners_in(scene):
    return seen_at(scene.camera, scene.plane.points(*scene.board.corners_mm().T))


def reflectance(scene):
    """What is left of a picture when the light that a card there would receive is taken out."""
    card = BoardScene(
        camera=scene.camera,
        leds=scene.leds,
        bench=scene.bench,
        board=PrintedBoard(paper=1.0, ink=1.0, margin_mm=90.0),
        rotation_vector=scene.rotation_vector,
        translation_mm=scene.translation_mm,
    )
    return grey(scene, [0, 2, 4]) / grey(card, [0, 2, 4])


@pytest.mark.parametrize("turn_deg", [0, 8, 30, 45, 90])
@pytest.mark.parametrize("blur", [0.0, 0.6])
def test_an_edge_is_averaged_over_the_area_of_its_pixels(turn_deg, blur):
    """An edge at any angle through pixels of one unit, against many points in each."""
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    row, column = np.indices((24, 25)).astype(float)
    distance = 0.7 * (c * (column - 12.3) + s * (row - 11.8))
    places = (np.arange(40) + 0.5) / 40 - 0.5
    moved = distance[..., None, None] + 0.7 * (c * places[:, None] + s * places)
    exact = np.mean(ndtr(moved / 0.7 / blur) if blur else moved > 0, axis=(-1, -2))
    fraction = edge_coverage(distance, blur=0.7 * blur)
    # what is least exact is an edge at 45 deg, whose triangle becomes half a box and half a
    # Gaussian
    assert np.abs(fraction - exact).max() < (0.014 if turn_deg % 90 == 0 else 0.03)
    assert abs(np.sum(fraction - exact, axis=1 if turn_deg <= 45 else 0)).max() < 0.02
    if turn_deg == 45 and not blur:
        weight = np.gradient(fraction[12])
        middle = np.average(column[12], weights=weight)
        spread = np.average((column[12] - middle) ** 2, weights=weight) - 1 / 3
        assert spread == pytest.approx((1 + 1) / 12, rel=0.15)


@pytest.mark.parametrize("make", [drawn, built, parallel])
def test_true_corners_agree_with_opencv_s_projection(make):
    things = make()
    scene = held(things)
    turn = cv2.Rodrigues(np.array(scene.rotation_vector))[0]
    down, right = np.mgrid[:7, :10]
    board = np.stack([3.0 * (right - 4.5), 3.0 * (3.0 - down), 0 * right], axis=-1).reshape(-1, 3)
    expected = seen(things["camera"], board @ turn.T + scene.translation_mm)
    assert np.abs(corners_in(scene) - expected).max() < 1e-6


@pytest.mark.parametrize("seed", [1, 2])
def test_opencv_finds_the_corners_within_a_twentieth_of_a_pixel(seed):
    scene = held(built(seed, 0.3), seed)
    light = scene.light([0, 2, 4])[..., 1]
    image = np.clip(light * (250 / light.max()), 0, 255).astype(np.uint8)
    complete, corners = cv2.findChessboardCorners(image, (10, 7))
    assert complete
    stop = (3, 100, 1e-5)
    offset = cv2.cornerSubPix(image, corners, (7, 7), (-1, -1), stop)[:, 0] - corners_in(scene)
    assert np.sqrt(np.mean(np.sum(offset**2, axis=1))) < 0.05
    assert np.abs(offset.mean(axis=0)).max() < 0.012


def test_print_blur_widens_the_edges():
    things = drawn(0.3)
    scene = BoardScene(**things, board=PrintedBoard(print_blur_mm=0.05))
    column, row = seen(things["camera"], (1.5, 1.5, 0))[0]
    reach = round(column) + np.arange(-10, 11)
    slope = np.abs(np.gradient(grey(scene, [])[round(row)][reach]))
    middle = np.average(reach, weights=slope)
    assert middle == pytest.approx(column, abs=0.01)
    # a pixel's own variance is 1/12, and that of differences over two pixels 1/3
    variance = np.average((reach - middle) ** 2, weights=slope) - 1 / 12 - 1 / 3
    assert variance == pytest.approx((0.05 * 75.7 * 0.3) ** 2, rel=0.02)


@pytest.mark.parametrize("make", [drawn, built])
def test_board_poses_tilt_fill_and_stay_inside_the_picture(make):
    camera = make()["camera"]
    poses = board_poses(11, 12, camera)
    assert poses == board_poses(11, 12, camera)
    assert poses[:5] == board_poses(11, 5, camera)
    assert poses[0] != board_poses(12, 1, camera)[0]
    tilts = [
        np.rad2deg(np.arccos(cv2.Rodrigues(np.array(p["rotation_vector"]))[0][2, 2])) for p in poses
    ]
    assert 10 <= min(tilts) < 18
    assert 25 < max(tilts) <= 35
    squares = np.array([(u, v, 0.0) for u in (-16.5, 16.5) for v in (-12.0, 12.0)])
    for pose in poses:
        turn = cv2.Rodrigues(np.array(pose["rotation_vector"]))[0]
        corners = seen(camera, squares @ turn.T + pose["translation_mm"])
        assert (corners >= 0.02 * 220).all()
        assert (corners <= (319 - 0.02 * 220, 219 - 0.02 * 220)).all()
        assert cv2.contourArea(cv2.convexHull(corners.astype(np.float32))) > 0.4 * 220 * 320
        assert abs(pose["translation_mm"][2]) <= 5


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: board_poses(0, 3, drawn()["camera"], PrintedBoard(square_mm=6.0)),
            "not fit .* print a smaller one",
        ),
        (
            lambda: BoardScene(**drawn(), rotation_vector=(3.1, 0, 0)).light([0]),
            "edge-on or from behind",
        ),
        (lambda: BoardScene(**drawn(), translation_mm=(0, 0, 150)), "hold it lower"),
    ],
)
def test_impossible_targets_are_refused(call, words):
    with bad_input(words):
        call()
