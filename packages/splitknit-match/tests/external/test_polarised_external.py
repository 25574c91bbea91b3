"""A parallel and a crossed series of a finger that was path-traced outside this project."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import splitknit
from script_folder import VALIDATION, scripts_of
from splitknit.cli.main import main
from splitknit.finger.steady import find_steady_finger
from splitknit.observation.films import specular_of
from splitknit.observation.observe import observe
from splitknit.presets import preset_settings

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def capture(data_dir):
    folder = data_dir / "path_traced" / "polarised" / "d17_pol"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    return splitknit.read_capture(folder)


@pytest.fixture(scope="module")
def result(capture):
    return splitknit.reconstruct(capture)


@pytest.mark.parametrize("moved_mm", [(0.0, 0.0), (0.2, -0.1)])
def test_motion_between_the_series_is_measured_to_micrometres(capture, moved_mm):
    """A still finger to 0.004 mm in each shot; a moved one to 0.009 mm, the mean of its shots to
    0.005 mm."""
    px, band = capture.rig.camera.px_per_mm, capture.bands["white_crossed"]
    turn = np.array([[1.0, 0.0, moved_mm[0] * px], [0.0, 1.0, -moved_mm[1] * px]])
    size = capture.shape[::-1]
    pixels = [
        cv2.warpAffine(image, turn, size, flags=cv2.INTER_CUBIC, borderMode=1)
        for image in band.pixels
    ]
    crossed = replace(band, pixels=np.stack(pixels)) if any(moved_mm) else band
    moved = replace(capture, bands=capture.bands | {"white_crossed": crossed})
    lit = observe(moved)
    steady, finger = find_steady_finger(lit, preset_settings("metric"))
    assert (steady is lit) == (not any(moved_mm))
    shift = np.array(finger.facts["motion_white_crossed"]["shift_mm"]) - moved_mm
    assert np.hypot(*shift.T).max() < (0.009 if any(moved_mm) else 0.0045)
    assert np.hypot(*shift.mean(axis=0)) < (0.0055 if any(moved_mm) else 0.0015)
    inside = finger.mask
    specular, still = (
        specular_of(series.without_films().white, inside, px)
        for series in (steady, observe(capture))
    )
    assert np.corrcoef(specular[inside], still[inside])[0, 1] > 0.97


def test_prints_of_specular_light_and_of_relief_match(capture, tmp_path, capsys):
    result = tmp_path / "result"
    splitknit.reconstruct(capture, "snk").save(result, None)
    folders = [str(tmp_path / method) for method in ("specular", "relief")]
    for folder in folders:
        words = ["--method", Path(folder).name, "--out", folder]
        assert main(["print", str(result), *words]) == 0
    assert main(["match", *(f"{folder}/print.png" for folder in folders)]) == 0
    assert "Match, decided" in capsys.readouterr().out


def test_heights_are_measured_where_the_skin_faces_the_camera(result, data_dir):
    """0.9995 and 0.96 below 15 degrees, 0.996 and 0.98 up to 30; without films 0.987 and 0.89,
    0.976 and 0.84."""
    assert result.facts["heights"] == "measured"
    figures = score(result, data_dir)
    assert figures["surface_rms_mm"] < 0.07
    assert figures["ridge_corr"] > 0.96
    assert figures["ridge_corr_0_15"] > 0.998
    assert figures["ridge_rms_um_0_15"] < 1.3
    assert figures["ridge_corr_15_30"] > 0.994
    assert figures["ridge_rms_um_15_30"] < 2.2
    assert 0.94 < figures["ridge_gain_0_15"] < 1.05
    assert 0.94 < figures["ridge_gain_15_30"] < 1.05
    assert figures["error_over_stated"] < 1.2


@pytest.mark.xfail(reason="0.66: the relief network's flanks got better, what is stated did not")
def test_the_uncertainty_is_not_stated_too_large(result, data_dir):
    assert score(result, data_dir)["error_over_stated"] > 0.7


def grey(band):
    luminance = (band.pixels * np.array([0.2126, 0.7152, 0.0722])).sum(-1, keepdims=True)
    return replace(band, pixels=np.rint(luminance).astype(band.pixels.dtype))


def test_heights_of_grey_photographs_are_measured_where_the_skin_faces_the_camera(
    capture, data_dir
):
    """0.996, 0.96 and 1.9 um below 15 degrees; from a relief by colour the heights ended at 0.82,
    0.34 and 14 um."""
    bands = {
        name: grey(band) if band.pixels.shape[-1] == 3 else band
        for name, band in capture.bands.items()
    }
    figures = score(splitknit.reconstruct(replace(capture, bands=bands)), data_dir)
    assert figures["ridge_corr_0_15"] > 0.99
    assert figures["ridge_rms_um_0_15"] < 2.5
    assert figures["ridge_corr_15_30"] > 0.98
    assert figures["ridge_rms_um_15_30"] < 3.5


def score(result, data_dir):
    """Figures against the truth of the path tracer."""
    with np.load(data_dir / "path_traced" / "polarised" / "d17_pol_truth.npz") as file:
        truth = {name: file[name] for name in file.files}
    fields = {name: getattr(result, name) for name in ("height_mm", "mask", "uncertainty_um")}
    with scripts_of(VALIDATION / "path_traced") as script:
        return script("score").score(fields, truth)
