"""A finger under a perspective camera whose axis misses the image's middle, and whose lens bends
and darkens."""

from dataclasses import replace

import numpy as np
import pytest

from splitknit.model import Camera
from splitknit.nominal import default_rig
from splitknit.pipeline import reconstruct
from splitknit_simulator.finger.finger import FingerPose
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

SCALE = 0.12


@pytest.fixture(scope="module")
def photographed():
    rig = default_rig(SCALE, 0)
    rows, columns = rig.camera.image_size
    focal = rig.camera.px_per_mm * 140.0
    matrix = np.array([[focal, 0, columns / 2 + 5.0], [0, focal, rows / 2 - 4.0], [0, 0, 1]])
    camera = Camera(
        rig.camera.px_per_mm,
        (rows, columns),
        140.0,
        "perspective",
        matrix,
        (-0.4, 0.0, 0.0, 0.0, 0.0),
        (-0.15, -0.05),
    )
    settings = TwinSettings(
        scale=SCALE, rig=replace(rig, camera=camera), pose=FingerPose(insertion_mm=26.0, x_mm=2.0)
    )
    return simulate_capture(5, settings=settings)


@pytest.fixture(scope="module")
def reconstructed(photographed):
    return reconstruct(photographed[0], settings={"metric.rounds": 1})


def misplaced(result, capture, truth):
    """Mean error across (mm), and error of the height's scale."""
    seen = result.mask & truth["mask"] & np.isfinite(truth["height_mm"])
    height, true = result.height_mm[seen], truth["height_mm"][seen]
    if result.x_mm is None:
        rows, columns = capture.shape
        x = np.broadcast_to(
            (np.arange(columns) - (columns - 1) / 2) * result.pitch_mm, (rows, columns)
        )[seen]
    else:
        x = result.x_mm[seen]
        assert np.isnan(result.x_mm[~result.mask]).all()
    error = height - true - (height - true).mean()
    scale = float((error * (true - true.mean())).sum() / ((true - true.mean()) ** 2).sum())
    return float(np.abs(x - truth["x_mm"][seen]).mean()), scale


@pytest.mark.slow
def test_points_of_a_perspective_camera_lie_at_their_true_places(photographed, reconstructed):
    flat = reconstruct(photographed[0], settings={"metric.rounds": 1, "camera": "orthographic"})
    across, scale = misplaced(reconstructed, *photographed)
    across_flat, scale_flat = misplaced(flat, *photographed)
    assert across < 0.05
    assert across_flat > 0.15
    # on z = -x^2 / 2R a step of a pixel on the plane is one of 1 + 3 x^2 / (2 R D) on the skin: 6 %
    # at 7 mm
    assert scale - scale_flat == pytest.approx(0.06, abs=0.02)


@pytest.mark.slow
def test_lens_shading_is_divided_out(photographed, reconstructed):
    (capture, truth), kept = photographed, reconstructed
    camera = capture.rig.camera
    assert camera.shading == (-0.15, -0.05)
    clear = replace(capture.rig, camera=replace(camera, shading=()))
    lost = reconstruct(replace(capture, rig=clear), settings={"metric.rounds": 1})
    rows, columns = np.nonzero(kept.mask)
    far = np.hypot(rows - capture.shape[0] / 2, columns - capture.shape[1] / 2)
    ratio = lost.albedo[kept.mask] / kept.albedo[kept.mask]
    assert np.median(ratio[far > np.quantile(far, 0.8)]) < 0.97 * np.median(
        ratio[far < np.quantile(far, 0.2)]
    )
    assert truth["mask"].any()
