"""Normal maps with measured depth (DiLiGenT bear and cow, packaged by Cao et al. 2022).

The depth was seen in perspective and the integrators are orthographic, so heights are compared
after the best scale and plane; the remaining error includes the perspective.
"""

import cv2
import numpy as np
import pytest

from splitknit.imaging.geometry import gradients_from_normals
from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.poisson import poisson

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
