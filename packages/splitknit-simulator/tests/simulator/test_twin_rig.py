"""Captures with a rig of one's own: perspective camera, lens that darkens, other sizes and
scales."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.model import Camera
from splitknit.nominal import default_rig
from splitknit.observation.observe import observe
from splitknit_simulator.camera.lens import fall_off, pixels_of_points
from splitknit_simulator.camera.sensor import SensorSettings, binning_scale
from splitknit_simulator.finger.finger import FingerPose, draw_finger
from splitknit_simulator.finger.master_print import MasterPrintSettings
from splitknit_simulator.light.skin import SkinOptics
from splitknit_simulator.scene import BackgroundSettings, TwinSettings
from splitknit_simulator.twin import photograph, simulate_capture
from surfaces import perspective_camera, ridged_egg

QUIET = SensorSettings(noise=False, bits=16, raw_bits=16)
SHADING = (-0.35, -0.1)
FINGER = draw_finger(4, print_settings=MasterPrintSettings(proximal_mm=12.0))
PERSPECTIVE = perspective_camera(
    (220, 320), 7.57, 120.0, off=(3.0, -2.0), distortion=(0.2,), shading=SHADING
)


def photographed(surface, rig, settings):
    return photograph(surface, rig, SkinOptics(), np.random.SeedSequence(1), settings=settings)


@pytest.fixture(scope="module")
def perspective():
    rig = default_rig(0.1, 0)
    leds = tuple(
        replace(led, lobe_exponent=3.0, aim=(0.02, 0.0, -1.0)) if k % 2 else led
        for k, led in enumerate(rig.leds)
    )
    rig = replace(rig, camera=PERSPECTIVE, leds=leds)
    settings = TwinSettings(
        rig=rig, pose=FingerPose(insertion_mm=26.0), sensor=QUIET, skin=SkinOptics()
    )
    return rig, settings, *simulate_capture(4, settings=settings, finger=FINGER)


def test_a_perspective_capture_says_what_its_camera_is(perspective):
    rig, _, capture, truth = perspective
    assert capture.rig is rig
    assert capture.shape == truth["mask"].shape == (220, 320)
    assert str(truth["camera_model"]) == "perspective"
    assert float(truth["camera_height_mm"]) == 120.0
    assert_array_equal(truth["camera_matrix"], PERSPECTIVE.matrix)
    assert_array_equal(truth["camera_distortion"], PERSPECTIVE.distortion)
    assert truth["x_mm"].dtype == truth["y_mm"].dtype == np.float32
    inside = truth["mask"]
    column, row = pixels_of_points(
        PERSPECTIVE, *(truth[k][inside].astype(float) for k in ("x_mm", "y_mm", "height_mm"))
    )
    rows, columns = np.nonzero(inside)
    assert max(np.abs(column - columns).max(), np.abs(row - rows).max()) < 1e-3
    assert all(array.dtype != object for array in truth.values())
    assert capture.rig.camera.shading == SHADING


@pytest.mark.slow
def test_the_lens_darkens_every_image_and_reconstruction_undoes_it():
    """Stored values fall with the lens, ambient frame included; divided, they are those of a clear
    lens."""
    egg = ridged_egg((280, 260), 18.9)
    shading = replace(egg.camera, shading=SHADING)
    base = replace(default_rig(0.25, seed=3), camera=egg.camera)
    settings = TwinSettings(
        sensor=QUIET, background=BackgroundSettings(ambient=0.05), skin=SkinOptics()
    )
    (clear, plain), (dim, truth) = (
        photographed(egg, replace(base, camera=camera), settings)
        for camera in (egg.camera, shading)
    )
    gain = float(truth["exposure_white"] / plain["exposure_white"])
    assert gain > 1.02  # the brightest skin is behind the lens as bright as before
    bright = plain["mask"] & (clear.bands["white"].pixels.max(axis=(0, -1)) < 50000)
    for a, b in (
        tuple(c.bands["white"].ambient.pixels for c in (clear, dim)),
        (clear.bands["white"].pixels[2], dim.bands["white"].pixels[2]),
    ):
        ratio = b[bright].astype(float) / a[bright] / gain
        assert_allclose(ratio, np.repeat(fall_off(shading)[bright][:, None], 3, 1), rtol=0.01)
    light, divided = (observe(c).white.stack[1][:, bright] for c in (clear, dim))
    assert_allclose(divided, gain * light, atol=1e-3)
    # the stored glare is in the units of divided images
    assert_allclose(
        truth["glare_white"].astype(float), gain * plain["glare_white"].astype(float), atol=2e-3
    )


def test_the_binning_follows_from_scale_and_image_size():
    assert binning_scale(default_rig(0.25).camera) == pytest.approx(0.25)
    assert binning_scale(default_rig(1 / 3).camera) == pytest.approx(1 / 3, rel=1e-9)
    assert binning_scale(Camera(62.0, (2200, 3200))) == 1.0  # the whole sensor, from further away
    assert binning_scale(Camera(90.0, (2200, 3200))) == 1.0
    assert binning_scale(Camera(31.0, (1100, 1600))) == 0.5
    assert binning_scale(Camera(37.85, (280, 260))) == pytest.approx(0.5)  # a cut-out
    assert binning_scale(Camera(150.0, (280, 260))) == 1.0


def test_noise_falls_with_the_binning():
    noise = []
    egg = ridged_egg((140, 130), 9.45)
    rig = replace(default_rig(0.125), camera=egg.camera)
    for scale in (None, 0.125, 1.0):
        settings = TwinSettings(sensor=SensorSettings(bits=16), sensor_scale=scale)
        capture, truth = photographed(egg, rig, settings)
        nir = capture.bands["nir"].pixels[:, truth["mask"]].astype(float)
        noise.append((nir - nir.mean(axis=-1, keepdims=True)).std())
    assert noise[1] == pytest.approx(noise[0], rel=0.02)
    assert noise[2] > 3.0 * noise[0]


def test_a_sensor_scale_above_one_is_refused():
    with bad_input("sensor_scale"):
        TwinSettings(sensor_scale=1.5)
