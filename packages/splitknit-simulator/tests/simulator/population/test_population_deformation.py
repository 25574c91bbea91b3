"""Skin that moves over the body: bounded, smooth, the same for ridges and landmarks, and really in the pictures."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_simulator.finger.deformation import deformed, draw_deformation
from splitknit_simulator.finger.master_print import MasterPrintSettings, master_print
from splitknit_simulator.population.people import PeopleRanges
from splitknit_simulator.population.sessions import PopulationSettings, SessionRanges, population_capture


@pytest.fixture(scope="module")
def master():
    return master_print("left_loop", 3, MasterPrintSettings(half_width_mm=9, distal_mm=24, proximal_mm=3))


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


def test_shifts_are_alike_over_the_smoothing_length_only(master):
    near, far = [], []
    for seed in range(40):
        d = _deformation(master, seed=seed)
        du, _ = d.shift_at(np.array([-6.0, -3.5, 6.0]), np.array([2.0, 2.0, 20.0]))
        near.append((du[0], du[1]))
        far.append((du[0], du[2]))
    assert np.corrcoef(np.array(near).T)[0, 1] > 0.8
    assert abs(np.corrcoef(np.array(far).T)[0, 1]) < 0.45


def test_no_shift_changes_nothing(master):
    same = deformed(master, _deformation(master, amplitude=0.0))
    np.testing.assert_allclose(same.ridge, master.ridge, atol=1e-5)
    np.testing.assert_allclose(same.minutiae[:, :2], master.minutiae[:, :2], atol=1e-9)


def test_landmarks_move_with_the_ridges(master):
    places = np.array([[-4.0, 6.0], [0.5, 12.0], [5.0, 17.0]])
    bumps = np.zeros_like(master.ridge)
    for u, v in places:
        bumps += np.exp(-0.5 * ((master.u_mm - u) ** 2 + (master.v_mm[:, None] - v) ** 2) / 0.3**2).astype(np.float32)
    heads = np.column_stack([places, np.zeros(3)])
    print_ = replace(master, ridge=bumps, minutiae=heads, cores_mm=((0.5, 12.0),))
    d = _deformation(master, stretch=0.03)
    moved = deformed(print_, d)
    assert np.hypot(*(moved.minutiae[:, :2] - places).T).max() > 0.15
    for u, v in moved.minutiae[:, :2]:
        near = (np.abs(master.u_mm - u) < 1.0) & (np.abs(master.v_mm - v) < 1.0)[:, None]
        weight = np.where(near, moved.ridge, 0.0)
        found = [(weight * axis).sum() / weight.sum() for axis in (master.u_mm[None, :], master.v_mm[:, None])]
        np.testing.assert_allclose(found, [u, v], atol=0.03)
    np.testing.assert_allclose(moved.cores_mm[0], moved.minutiae[1, :2], atol=1e-12)
    assert 0.0 < np.abs(moved.minutiae[:, 2]).max() < 0.2


def test_swollen_skin_is_stretched(master):
    d = _deformation(master, amplitude=0.0, stretch=0.02)
    np.testing.assert_allclose(d.moved(np.array([[5.0, 10.0]])), [[5.1, 10.2]])


def test_what_could_fold_is_refused(master):
    with pytest.raises(BadInput, match="could fold"):
        draw_deformation(np.random.default_rng(0), master, 1.0, 5.0)


def test_the_relief_of_the_pictures_moves_and_the_body_does_not():
    still = SessionRanges(
        yaw_sd_deg=0, pitch_sd_deg=0, roll_sd_deg=0, swelling_sd=0, deformation_mm=(0.0, 0.0), partial_share=0.0
    )
    settings = PopulationSettings(scale=0.15, people=PeopleRanges(habit_roll_sd_deg=0), sessions=still)
    person = settings.person(2)
    loops = {"left_loop", "right_loop", "whorl"}
    name = next(name for name, own in person.fingers.items() if own.finger.pattern in loops and "thumb" not in name)
    master = person.fingers[name].finger.master()
    before = population_capture(settings, person, name, 1, master=master)
    moving = replace(settings, sessions=replace(still, deformation_mm=(0.5, 0.5)))
    after = population_capture(moving, person, name, 1, master=master)
    mask = before.truth["mask"] & after.truth["mask"]
    assert (before.truth["mask"] ^ after.truth["mask"]).sum() < 0.002 * mask.sum()  # ridges on the outline
    np.testing.assert_array_equal(before.truth["shape_mm"][mask], after.truth["shape_mm"][mask])
    assert np.abs(before.truth["relief_um"] - after.truth["relief_um"])[mask].mean() > 3.0
    # the core goes where the stored shift says (the camera sees the middle of the pad undistorted)
    shift = after.truth["deformation_shift_mm"]
    u, v = after.truth["deformation_u_mm"], after.truth["deformation_v_mm"]
    core = np.array(master.cores_mm[0])
    i, j = int(np.argmin(np.abs(v - core[1]))), int(np.argmin(np.abs(u - core[0])))
    px_per_mm = before.capture.rig.camera.px_per_mm
    seen = (after.truth["landmark_cores_px"][0] - before.truth["landmark_cores_px"][0]) / px_per_mm
    np.testing.assert_allclose([seen[0], -seen[1]], shift[:, i, j], atol=0.12)
    assert np.hypot(*seen) > 0.05
    # and the pictures show it: they agree less than two exposures of one capture would
    a, b = (shown.capture.bands["white"].pixels.astype(float).mean(axis=(0, 3)) for shown in (before, after))
    inner = cv2.erode(mask.astype(np.uint8), np.ones((15, 15), np.uint8)).astype(bool)
    a, b = (image - cv2.GaussianBlur(image, (0, 0), 5) for image in (a, b))
    assert np.corrcoef(a[inner], b[inner])[0, 1] < 0.8
