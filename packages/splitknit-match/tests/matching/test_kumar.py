"""The preset `kumar`: `ea`, smoothed."""

import numpy as np
import pytest

from refusals import bad_input
from splitknit.imaging.geometry import smoothed
from splitknit.pipeline import reconstruct
from splitknit.presets import PRESETS, preset_settings
from splitknit.settings import override


@pytest.mark.slow
def test_kumar_is_ea_smoothed(twin_capture):
    assert override(PRESETS["kumar"], {"smooth.sigma_mm": 0.0}) == PRESETS["ea"]
    plain, smooth = (reconstruct(twin_capture, preset) for preset in ("ea", "kumar"))
    np.testing.assert_array_equal(smooth.mask, plain.mask)
    inside = plain.mask
    height_mm = smooth.ridge_mm + smooth.shape_mm
    np.testing.assert_allclose(height_mm[inside], smooth.height_mm[inside], atol=1e-5)
    # a Gaussian of 0.05 mm keeps exp(-2 (pi 0.05 / 0.45)^2) of ridges 0.45 mm apart: 0.78
    # beside the outline, the relief of EA is not of ridges
    facing = inside & (plain.normals[..., 2] > 0.9)
    kept = np.std(smooth.ridge_mm[facing]) / np.std(plain.ridge_mm[facing])
    assert 0.6 < kept < 0.9
    assert np.abs(smooth.height_mm - plain.height_mm)[inside].mean() < 0.02


def test_only_the_thesis_s_cases_are_smoothed_by_up_to_1_mm():
    with bad_input("method=thesis"):
        override(preset_settings("metric"), {"smooth.sigma_mm": 0.1})
    with bad_input("must be from 0 to 1"):
        override(preset_settings("ea"), {"smooth.sigma_mm": -0.1})


def test_smoothing_takes_nothing_from_outside_the_mask():
    rng = np.random.default_rng(0)
    mask = np.zeros((60, 70), bool)
    mask[20:45, 15:60] = True
    flat = np.where(mask, 3.0, np.nan).astype(np.float32)
    np.testing.assert_allclose(smoothed(flat, mask, 2.0), np.where(mask, 3.0, 0.0), atol=1e-5)
    rough = np.where(mask, rng.normal(size=mask.shape), np.nan).astype(np.float32)
    assert np.std(smoothed(rough, mask, 2.0)[mask]) < 0.4
