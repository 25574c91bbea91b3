"""Normal maps with measured depth (DiLiGenT bear and cow, packaged by Cao et al. 2022).

The depth was seen in perspective and the integrators are orthographic, so heights are compared
after the best scale and plane; the remaining error includes the perspective.
"""

import cv2
import numpy as np
import pytest

from splitknit.imaging.geometry import gradients_from_normals
from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.poisson import piecewise, poisson

pytestmark = pytest.mark.external


def load(folder):
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    bgr = cv2.imread(str(folder / "normal_map.png"), cv2.IMREAD_UNCHANGED)
    normals = (bgr[..., ::-1].astype(np.float32) / 65535) * 2 - 1
    mask = cv2.imread(str(folder / "mask.png"), cv2.IMREAD_GRAYSCALE) > 127
    with np.load(folder / "depth_gt.npz") as data:
        depth = data[data.files[0]]
    return normals, mask & np.isfinite(depth), -depth, np.loadtxt(folder / "K.txt")


def aligned_error(height, truth, mask):
    """Rms of the truth (mm) against scale x height + plane, and the truth's own std after its
    plane."""
    rows, columns = np.nonzero(mask)
    plane = np.column_stack([np.ones(rows.size), rows, columns])
    design = np.column_stack([plane, height[mask]])
    target = truth[mask]
    rest = target - design @ np.linalg.lstsq(design, target, rcond=None)[0]
    own = target - plane @ np.linalg.lstsq(plane, target, rcond=None)[0]
    return float(np.std(rest)), float(np.std(own))


@pytest.mark.parametrize(("name", "most"), [("bear", 0.08), ("cow", 0.25)])
def test_heights_follow_the_measured_depth(data_dir, name, most):
    normals, mask, truth, _ = load(data_dir / "integration" / name)
    slope_x, slope_y = gradients_from_normals(normals, mask)
    error, spread = aligned_error(poisson(slope_x, slope_y, mask), truth, mask)
    assert error < most * spread
    zero_filled, _ = aligned_error(frankot_chellappa(slope_x, slope_y, mask), truth, mask)
    assert error < zero_filled


@pytest.mark.parametrize(("name", "most_mm"), [("bear", 0.11), ("cow", 0.11)])
def test_depth_of_a_surface_with_steps(data_dir, name, most_mm):
    """Mean absolute error; least squares has 0.521 and 0.167 mm, Cao et al. 2022 0.334 and
    0.058."""
    normals, mask, height, matrix = load(data_dir / "integration" / name)
    rows, columns = np.indices(mask.shape)
    focal = matrix[0, 0]
    x, y = (columns - matrix[0, 2]) / focal, (matrix[1, 2] - rows) / matrix[1, 1]
    facing = np.maximum(normals[..., 2] - normals[..., 0] * x - normals[..., 1] * y, 1e-3)
    slope_x = -normals[..., 0] / facing
    slope_y = -normals[..., 1] / facing * focal / matrix[1, 1]
    estimate = np.exp(-piecewise(slope_x, slope_y, mask) / focal)
    depth = -height
    scale = np.nanmedian((depth / estimate)[mask])
    assert np.abs(scale * estimate - depth)[mask].mean() < most_mm
