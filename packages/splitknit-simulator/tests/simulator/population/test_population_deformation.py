"""Skin that moves over the body: bounded, smooth, the same for ridges and landmarks, and really in
the pictures."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from refusals import bad_input
from splitknit_simulator.finger.deformation import deformed, draw_deformation
from splitknit_simulator.finger.master_print import MasterPrintSettings, master_print


@pytest.fixture(scope="module")
def master():
    return master_print(
        "left_loop", 3, MasterPrintSettings(half_width_mm=9, distal_mm=24, proximal_mm=3)
    )


def _deformation(master, amplitude=0.4, stretch=0.0, seed=1):
    return draw_deformation(np.random.default_rng(seed), master, amplitude, 5.0, stretch)


def test_a_shift_is_bounded_and_smooth(master):
    for seed in range(5):
        du, dv = _deformation(master, seed=seed).shift_on(master.u_mm, master.v_mm)
        length = np.hypot(du, dv)
        assert 0.2 < length.max() < 0.402
        pitch = master.u_mm[1] - master.u_mm[0]
        strain = max(np.abs(np.gradient(part, pitch)).max() for part in (du, dv))
        assert 0.01 < strain < 0.2  # nothing folds
        step = round(1.0 / pitch)
        apart = np.hypot(du[step:] - du[:-step], dv[step:] - dv[:-step]).max()
        assert apart < 0.2  # over a millimetre; ridges are 0.43 mm apart


def test_a_deformation_of_zero_changes_nothing(master):
    same = deformed(master, _deformation(master, amplitude=0.0))
    assert_allclose(same.ridge, master.ridge, atol=1e-5)
    assert_allclose(same.minutiae[:, :2], master.minutiae[:, :2], atol=1e-9)


def test_landmarks_move_with_the_ridges(master):
    places = np.array([[-4.0, 6.0], [0.5, 12.0], [5.0, 17.0]])
    bumps = np.zeros_like(master.ridge)
    for u, v in places:
        bumps += np.exp(
            -0.5 * ((master.u_mm - u) ** 2 + (master.v_mm[:, None] - v) ** 2) / 0.3**2
        ).astype(np.float32)
    heads = np.column_stack([places, np.zeros(3)])
    print_ = replace(master, ridge=bumps, minutiae=heads, cores_mm=((0.5, 12.0),))
    d = _deformation(master, stretch=0.03)
    moved = deformed(print_, d)
    assert np.hypot(*(moved.minutiae[:, :2] - places).T).max() > 0.15
    for u, v in moved.minutiae[:, :2]:
        near = (np.abs(master.u_mm - u) < 1.0) & (np.abs(master.v_mm - v) < 1.0)[:, None]
        weight = np.where(near, moved.ridge, 0.0)
        centroid = [
            (weight * axis).sum() / weight.sum()
            for axis in (master.u_mm[None, :], master.v_mm[:, None])
        ]
        assert_allclose(centroid, [u, v], atol=0.03)
    assert_allclose(moved.cores_mm[0], moved.minutiae[1, :2], atol=1e-12)
    assert 0.0 < np.abs(moved.minutiae[:, 2]).max() < 0.2


def test_swollen_skin_is_stretched(master):
    d = _deformation(master, amplitude=0.0, stretch=0.02)
    assert_allclose(d.moved(np.array([[5.0, 10.0]])), [[5.1, 10.2]])


def test_a_deformation_that_could_fold_is_refused(master):
    with bad_input("could fold"):
        draw_deformation(np.random.default_rng(0), master, 1.0, 5.0)
