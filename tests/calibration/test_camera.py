"""Zhang's fit: what it finds, what it holds, whom it believes, and what it refuses."""

import numpy as np
import pytest

from camera_views import BOARD, MATRIX, SIZE, seen, turned, views
from refusals import bad_input
from splitknit_rig.calibration.camera import fit_camera, fit_lens


def test_a_long_lens_is_found_and_its_distortion_held():
    calibration = fit_camera(views(0), BOARD, SIZE)
    lens = calibration.lens
    assert lens.matrix[0, 0] == pytest.approx(2650, rel=1e-3)
    assert lens.matrix[0, 0] == lens.matrix[1, 1]
    assert np.abs(lens.matrix[:2, 2] - MATRIX[:2, 2]).max() < 3
    assert lens.rms_px == pytest.approx(0.02 * np.sqrt(2), rel=0.05)
    assert lens.distortion == (0, 0, 0, 0, 0)
    assert set(lens.fixed) == {"k1", "k2", "p1 and p2", "k3", "fx / fy"}
    assert "+-" in lens.fixed["k2"]
    assert "not tried" in lens.fixed["k3"]
    assert lens.fitted == ("cx", "cy")
    assert calibration.findings == ()
    assert calibration.variety_deg > 30
    assert len(calibration.used) == len(lens.view_rms_px) == 10


@pytest.mark.parametrize(
    ("distortion", "fitted"),
    [((0.15, 0, 0, 0, 0), ("k1",)), ((-0.3, 0, 0.004, -0.002, 0), ("k1", "p1", "p2"))],
)
def test_terms_that_the_photographs_show_are_fitted(distortion, fitted):
    lens = fit_camera(views(1, 12, distortion=distortion, noise_px=0.01), BOARD, SIZE).lens
    assert lens.fitted == (*fitted, "cx", "cy")
    assert lens.matrix[0, 0] == pytest.approx(2650, rel=1e-3)
    for term, value in zip(("k1", "k2", "p1", "p2", "k3"), distortion, strict=True):
        if term in fitted:
            estimate = lens.distortion[("k1", "k2", "p1", "p2", "k3").index(term)]
            assert abs(estimate - value) < 4 * lens.deviations[term]


@pytest.mark.slow
def test_standard_deviations_are_what_repetition_gives():
    exact = views(3, 8, noise_px=0)
    rng = np.random.default_rng(7)
    fits = [
        fit_lens(BOARD.points_mm, [v + rng.normal(0, 0.05, v.shape) for v in exact], SIZE)
        for _ in range(10)
    ]
    values = np.array([[fit.matrix[0, 0], *fit.matrix[:2, 2]] for fit in fits])
    deviation = np.mean([[fit.deviations[k] for k in ("fx", "cx", "cy")] for fit in fits], axis=0)
    ratio = values.std(axis=0, ddof=1) / deviation
    assert np.all((ratio > 0.5) & (ratio < 2))  # 10 draws: each to 24 %
    assert 0.7 < np.exp(np.log(ratio).mean()) < 1.4
    assert np.all(np.abs(values.mean(axis=0) - (2650, 405, 268)) < 4 * deviation / np.sqrt(10))


@pytest.mark.slow
def test_a_bad_photograph_is_left_out_and_named():
    sets = views(4, 12)
    rng = np.random.default_rng(0)
    sets[5] = sets[5] + rng.normal(0, 0.3, sets[5].shape)
    sets[9] = sets[9] + rng.normal(0, 1.0, sets[9].shape)
    names = [f"photo{k}.png" for k in range(12)]
    calibration = fit_camera(sets, BOARD, SIZE, names)
    assert list(calibration.rejected) == ["photo9.png", "photo5.png"]
    assert calibration.rejected["photo9.png"] == pytest.approx(1.4, rel=0.2)
    assert calibration.rejected["photo5.png"] == pytest.approx(0.42, rel=0.2)
    assert len(calibration.used) == 10
    assert calibration.lens.matrix[0, 0] == pytest.approx(2650, rel=2e-3)
    kept = fit_lens(BOARD.points_mm, sets, SIZE)
    assert abs(kept.matrix[0, 0] - 2650) > abs(calibration.lens.matrix[0, 0] - 2650)


def test_the_same_photograph_twice_counts_once():
    sets = views(5, 6)
    twice = [*sets, sets[2] + 0.05, sets[0][::-1]]
    calibration = fit_camera(twice, BOARD, SIZE, list("abcdefgh"))
    assert calibration.repeated == {"g": "c", "h": "a"}
    assert calibration.used == tuple("abcdef")
    with bad_input(r"only 4 of 8 photographs .* can be used \(4 of them twice\)"):
        fit_camera([*sets[:4], *sets[:4]], BOARD, SIZE)


def test_boards_parallel_to_the_sensor_are_refused():
    for seed in range(3):
        with bad_input("parallel"):
            fit_camera(views(seed, tilts=(0, 0)), BOARD, SIZE)
    with bad_input(r"nearly parallel .*focal length and distance cannot be separated"):
        fit_camera(views(8, tilts=(0, 2), noise_px=0.1), BOARD, SIZE)


def test_boards_in_one_corner_are_warned_about():
    marks = BOARD.points_mm - BOARD.points_mm.mean(axis=0)
    sets = [0.5 * seen(marks, turned(10 + 3 * k, 70 * k), (0, 0, 140.0)) for k in range(8)]
    calibration = fit_camera(sets, BOARD, SIZE)
    assert calibration.coverage < 0.4
    assert "uncovered-picture" in [finding.code for finding in calibration.findings]


def test_stretched_photographs_are_refused():
    sets = [v * (1.05, 1.0) for v in views(11)]
    with bad_input(r"no squares \(fx / fy = 1\.05"):
        fit_camera(sets, BOARD, SIZE)
    lens = fit_camera([v * (1.005, 1.0) for v in views(11)], BOARD, SIZE).lens
    assert lens.matrix[0, 0] / lens.matrix[1, 1] == pytest.approx(1.005, abs=5e-4)
    assert "aspect" in lens.fitted


def test_what_is_no_set_of_corners_is_refused():
    sets = views(13, 6)
    with bad_input(r"only 4 of 4 photographs .* but 5 are needed"):
        fit_camera(sets[:4], BOARD, SIZE)
