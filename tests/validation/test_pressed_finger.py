"""A finger pressed on glass: where it touches, where its minutiae lie, what pressure does to its ridges."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from script_folder import VALIDATION
from splitknit.errors import BadInput
from splitknit_simulator.finger.finger import SimulatedFinger, draw_finger
from splitknit_simulator.finger.master_print import MasterPrint, MasterPrintSettings, ink_print

sys.path.append(str(VALIDATION / "prints"))
script: Any = importlib.import_module("pressed_finger")
PressedPrint, PressSettings, press_finger = script.PressedPrint, script.PressSettings, script.press_finger

STEADY = PressSettings(turn_sd_deg=0, roll_sd_deg=0, pitch_sd_deg=0, shift_mm=0, stretch=0, patches=0, noise_grey=0)


@pytest.fixture(scope="module")
def finger() -> SimulatedFinger:
    return draw_finger(5, "right_loop", print_settings=MasterPrintSettings(pitch_mm=0.045, iterations=3))


@pytest.fixture(scope="module")
def master(finger: SimulatedFinger) -> MasterPrint:
    return finger.master()


@pytest.fixture(scope="module")
def steady(finger: SimulatedFinger, master: MasterPrint) -> PressedPrint:
    return press_finger(finger, 1, STEADY, master=master)


def test_same_seed_same_bytes(finger: SimulatedFinger, master: MasterPrint) -> None:
    first, again, other = (press_finger(finger, seed, master=master) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.image, again.image)
    np.testing.assert_array_equal(first.minutiae, again.minutiae)
    assert first.image.shape != other.image.shape or np.any(first.image != other.image)


def test_it_shows_the_skin_as_ink_does(steady: PressedPrint, master: MasterPrint) -> None:
    """Without any shift it is the mirrored chart: an ink print of the same master fits it, and not its mirror."""
    ink = ink_print(master).astype(np.float32)
    middle = steady.image.shape[0] // 2, steady.image.shape[1] // 2
    patch = steady.image[middle[0] - 60 : middle[0] + 60, middle[1] - 50 : middle[1] + 50].astype(np.float32)
    assert cv2.matchTemplate(ink, patch, cv2.TM_CCOEFF_NORMED).max() > 0.8
    assert cv2.matchTemplate(ink, np.ascontiguousarray(patch[:, ::-1]), cv2.TM_CCOEFF_NORMED).max() < 0.6


@pytest.mark.parametrize("settings", [STEADY, PressSettings(turn_sd_deg=15, stretch=0.05, noise_grey=0)])
def test_minutiae_lie_where_the_ridges_say(
    finger: SimulatedFinger, master: MasterPrint, settings: PressSettings
) -> None:
    """Pressing a master whose only relief are small dots at its minutiae shows dots where the truth says."""
    dots = np.zeros_like(master.ridge)
    pitch = float(master.u_mm[1] - master.u_mm[0])
    for u, v, _ in master.minutiae:
        place = round((u - master.u_mm[0]) / pitch), round((master.v_mm[0] - v) / pitch)
        cv2.circle(dots, place, 4, 1.0, -1)
    plain = replace(finger, skin=replace(finger.skin, creases=(), pore_depth_um=0.0, depth_variation=0.0))
    pressed = press_finger(plain, 3, settings, master=replace(master, ridge=dots))
    inside = cv2.erode(pressed.contact.astype(np.uint8), np.ones((21, 21), np.uint8)) > 0
    dark = cv2.blur((pressed.image < 150).astype(np.float32), (3, 3)) > 0.5
    at = np.rint(pressed.minutiae[:, :2]).astype(int)
    touching = inside[at[:, 1], at[:, 0]]
    assert touching.sum() > 10
    assert dark[at[touching, 1], at[touching, 0]].all()
    assert (dark & inside).sum() < 0.5 * inside.sum()


def test_directions_follow_the_ridges(finger: SimulatedFinger, master: MasterPrint) -> None:
    """Directions run along the ridges of the print, turned and mirrored as it is."""
    pressed = press_finger(finger, 15, PressSettings(turn_sd_deg=15, noise_grey=0), master=master)  # by 30 deg
    grey = cv2.GaussianBlur(pressed.image.astype(np.float32), (0, 0), 2)
    right, down = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    twice = cv2.GaussianBlur(right * right - down * down, (0, 0), 6), cv2.GaussianBlur(2 * right * down, (0, 0), 6)
    along = np.pi / 2 - 0.5 * np.arctan2(twice[1], twice[0])  # counter-clockwise, across turned to along
    inside = cv2.erode(pressed.contact.astype(np.uint8), np.ones((25, 25), np.uint8)) > 0
    at = np.rint(pressed.minutiae[:, :2]).astype(int)
    keep = inside[at[:, 1], at[:, 0]]
    off = pressed.minutiae[keep, 2] - along[at[keep, 1], at[keep, 0]]
    assert keep.sum() > 8
    assert np.median(np.abs(np.angle(np.exp(2j * off))) / 2) < np.deg2rad(12)


def test_harder_is_larger_and_darker(finger: SimulatedFinger, master: MasterPrint, steady: PressedPrint) -> None:
    soft = press_finger(finger, 1, replace(STEADY, force_n=0.4), master=master)
    hard = press_finger(finger, 1, replace(STEADY, force_n=4.0), master=master)
    assert 1.2 * soft.area_mm2 < steady.area_mm2 < hard.area_mm2 / 1.2
    fractions = [
        float((p.image[p.contact] < 140).mean()) for p in (soft, hard)
    ]  # wider ridges: more of the patch touches
    assert fractions[1] > fractions[0] + 0.05
    assert 60 < steady.area_mm2 < 400
    assert (steady.image[~steady.contact] > 200).mean() > 0.97


def test_noise_and_resolution(finger: SimulatedFinger, master: MasterPrint, steady: PressedPrint) -> None:
    noisy = press_finger(finger, 1, replace(STEADY, noise_grey=9.0), master=master)
    bare = steady.image == 235
    assert noisy.image[bare].astype(float).std() == pytest.approx(9.0, rel=0.1)
    fine = press_finger(finger, 1, replace(STEADY, ppi=1000.0), master=master)
    assert fine.area_mm2 == pytest.approx(steady.area_mm2, rel=0.02)
    assert fine.image.shape[0] == pytest.approx(2 * steady.image.shape[0], abs=3)
    # a finer grid shows the same minutiae at the same places from the middle
    middles = [np.array(p.image.shape[::-1]) / 2 - 0.5 for p in (steady, fine)]
    np.testing.assert_allclose((steady.minutiae[0, :2] - middles[0]) * 2, fine.minutiae[0, :2] - middles[1], atol=1e-6)


def test_settings_are_checked() -> None:
    with pytest.raises(BadInput, match=r"force_n must be from 0\.1 to 20"):
        PressSettings(force_n=0.0)
    with pytest.raises(BadInput, match="shift_mm"):
        PressSettings(shift_mm=2.0)
    assert PressSettings(force_n=4.0).depth_mm == pytest.approx(1.1 * 4**0.4)
