"""Arrays are in mm, of an assumed scale where nobody measured it; files are then in pixels."""

from dataclasses import replace

import pytest
from numpy.testing import assert_allclose, assert_array_equal

import splitknit
import splitknit_simulator
from splitknit.io.npz import read_npz
from splitknit.model import Led, Rig, camera_without_scale, vector_at_origin
from splitknit.units import MILLIMETRES, pixels


def unscaled(capture):
    """The same photographs, by a camera whose scale nobody has measured, under distant lights."""
    leds = tuple(
        Led(led.band, direction=tuple(vector_at_origin(led).tolist())) for led in capture.rig.leds
    )
    return replace(capture, rig=Rig(camera_without_scale(capture.shape), leds), material="opaque")


@pytest.mark.slow
def test_a_file_of_unknown_scale_is_in_pixels(tmp_path):
    capture = unscaled(splitknit_simulator.simulate_capture(1, settings={"scale": 0.08})[0])
    result = splitknit.reconstruct(capture, "ea")
    assert not result.scale_known and result.pitch_mm == capture.rig.camera.pitch_mm
    stated = replace(capture.rig.camera, scale_known=True)
    known = splitknit.reconstruct(replace(capture, rig=replace(capture.rig, camera=stated)), "ea")
    assert_array_equal(result.height_mm, known.height_mm)
    result.save(tmp_path / "result", capture)
    arrays = read_npz(tmp_path / "result" / "height.npz", ("height_px", "height_mm", "pitch_mm"))
    assert set(arrays) == {"height_px"}
    assert_allclose(arrays["height_px"], result.height_mm / result.pitch_mm, rtol=1e-6)
    again = splitknit.read_result(tmp_path / "result")
    assert again.unit == pixels(1.0)
    assert_array_equal(again.height_mm, arrays["height_px"])
    again.save(tmp_path / "again", capture)
    kept = read_npz(tmp_path / "again" / "height.npz", ("height_px",))
    assert_array_equal(kept["height_px"], arrays["height_px"])


def test_facts_in_pixels_have_names_of_pixels():
    facts = {
        "white": {"motion_mm": [0.5, None], "sharpness": 2.0},
        "scattering_per_mm": {"red": 3.0},
        "rms_um": 20.0,
        "area_mm2": 1.0,
        "assumed_px_per_mm": 10.0,
        "count_mm": 3,
    }
    assert MILLIMETRES.converted(facts) is facts
    assert pixels(0.5).converted(facts) == {
        "white": {"motion_px": [1.0, None], "sharpness": 2.0},
        "scattering_per_px": {"red": 1.5},
        "rms_px": 0.04,
        "area_px2": 4.0,
        "assumed_px_per_mm": 10.0,
        "count_px": 3,
    }
