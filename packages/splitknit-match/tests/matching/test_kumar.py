"""Kumar's case and features: what differs from EA, minutiae on the surface, codes of known surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.imaging.geometry import smoothed
from splitknit.model import Capture, Surface, default_rig
from splitknit.pipeline import reconstruct
from splitknit.presets import PRESETS, preset_settings
from splitknit.settings import override
from splitknit.steps import Memory
from splitknit_match.matching.space_features import space_minutiae, surface_code
from splitknit_match.matching.surface_code import GRAY, SurfaceCodeSettings
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface


@pytest.mark.slow
def test_kumar_is_ea_smoothed(twin_capture: Capture, twin_memory: Memory) -> None:
    assert override(PRESETS["kumar"], {"smooth.sigma_mm": 0.0}) == PRESETS["ea"]
    plain, smooth = (reconstruct(twin_capture, preset, memory=twin_memory) for preset in ("ea", "kumar"))
    np.testing.assert_array_equal(smooth.mask, plain.mask)
    inside = plain.mask
    np.testing.assert_allclose((smooth.ridge_mm + smooth.shape_mm)[inside], smooth.height_mm[inside], atol=1e-5)
    # a Gaussian of 0.05 mm keeps exp(-2 (pi 0.05 / 0.45)^2) of ridges 0.45 mm apart: 0.78
    facing = inside & (plain.normals[..., 2] > 0.9)  # beside the outline, the relief of EA is not of ridges
    kept = np.std(smooth.ridge_mm[facing]) / np.std(plain.ridge_mm[facing])
    assert 0.6 < kept < 0.9
    assert np.abs(smooth.height_mm - plain.height_mm)[inside].mean() < 0.02


def test_smoothing_is_of_the_thesis_s_cases_only() -> None:
    with pytest.raises(BadInput, match="method=thesis"):
        override(preset_settings("metric"), {"smooth.sigma_mm": 0.1})
    with pytest.raises(BadInput, match="must be from 0 to 1"):
        override(preset_settings("ea"), {"smooth.sigma_mm": -0.1})


def test_nothing_leaks_in_from_outside_the_mask() -> None:
    rng = np.random.default_rng(0)
    mask = np.zeros((60, 70), bool)
    mask[20:45, 15:60] = True
    flat = np.where(mask, 3.0, np.nan).astype(np.float32)
    np.testing.assert_allclose(smoothed(flat, mask, 2.0), np.where(mask, 3.0, 0.0), atol=1e-5)
    rough = np.where(mask, rng.normal(size=mask.shape), np.nan).astype(np.float32)
    assert np.std(smoothed(rough, mask, 2.0)[mask]) < 0.4


@pytest.fixture(scope="module")
def perfect() -> Surface:
    """The true surface of a turned finger, which lies off the middle."""
    camera = default_rig(0.27).camera
    pose = FingerPose(insertion_mm=27.0, yaw_rad=0.2, roll_rad=0.1, x_mm=1.5)
    seen = finger_surface(draw_finger(731, "right_loop"), pose, camera)
    from splitknit.finger.orientation import find_upright

    upright = find_upright(seen.mask)
    ridge = (seen.height_mm - seen.shape_mm).astype(np.float32)
    return Surface(
        ridge, seen.shape_mm, seen.normals, seen.mask, camera.pitch_mm, upright.input_from_upright, upright.size
    )


def test_minutiae_lie_on_the_surface_and_run_in_it(perfect: Surface) -> None:
    pytest.importorskip("nbis")
    found = space_minutiae(perfect)
    assert found.count > 30
    rows, columns = perfect.mask.shape
    turn = perfect.input_from_upright[:2, :2] / np.sqrt(np.linalg.det(perfect.input_from_upright[:2, :2]))
    right, down = turn @ (found.position_mm[:, :2] * [1.0, -1.0]).T  # from the upright frame back to the input's
    column, row = right / perfect.pitch_mm + (columns - 1) / 2, down / perfect.pitch_mm + (rows - 1) / 2
    at = np.rint(row).astype(int), np.rint(column).astype(int)
    assert perfect.mask[at].all()
    np.testing.assert_allclose(found.position_mm[:, 2], perfect.shape_mm[at], atol=0.2)
    ahead = found.direction * [1.0, -1.0, 1.0]
    ahead[:, :2] = ahead[:, :2] @ turn.T
    ahead[:, 1] *= -1
    steep = np.abs((ahead * perfect.normals[at]).sum(axis=1))  # the normals have the ridges' flanks too
    assert np.median(steep) < 0.2


def test_codes_of_known_surfaces() -> None:
    """A crest is a ridge, a trough a valley; the code lies on the upright grid, tip up."""
    pitch = 0.03
    column = np.mgrid[:400, :300][1]
    wave = (0.03 * np.cos(2 * np.pi * column * pitch / 0.6)).astype(np.float32)
    flat = np.zeros_like(wave)
    mask = np.ones(wave.shape, bool)
    mask[:30] = False
    normals = np.zeros((*wave.shape, 3), np.float32)
    made = surface_code(
        Surface(wave, flat, normals, mask, pitch, np.eye(3), (400, 300)), SurfaceCodeSettings(least_area_mm2=0)
    )
    assert made.code.shape == (120, 90)
    assert not made.mask[:9].any()
    assert made.mask[12:-3, 3:-3].all()
    place = (np.arange(90) - 44.5) * 0.1 + 149.5 * pitch
    phase = np.cos(2 * np.pi * place / 0.6)
    assert set(made.code[60, (phase > 0.75) & made.mask[60]].tolist()) == {int(GRAY[6])}
    assert set(made.code[60, (phase < -0.75) & made.mask[60]].tolist()) == {int(GRAY[2])}
