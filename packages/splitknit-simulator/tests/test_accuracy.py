from dataclasses import replace

import numpy as np
import pytest

import splitknit
import splitknit_simulator
from handmade import finger
from refusals import bad_input
from splitknit.folders import reconstruct_to_folder
from splitknit.imaging.geometry import high_passed
from splitknit_simulator.accuracy import compare


def test_a_result_equal_to_its_truth_has_no_error():
    result, truth = finger()
    figures = compare(result, truth).figures
    assert figures["surface_rms_mm"] == pytest.approx(0.0, abs=1e-6)
    assert figures["ridge_correlation"] == pytest.approx(1.0, abs=1e-6)
    assert figures["ridge_gain"] == pytest.approx(1.0, abs=1e-4)
    assert figures["ridge_rms_um"] == pytest.approx(0.0, abs=0.01)
    assert figures["ridge_good_area"] == 1.0
    assert figures["mask_overlap"] == 1.0
    assert figures["normals_mean_deg"] == pytest.approx(0.0, abs=0.03)


def test_gain_is_the_factor_of_the_relief():
    result, truth = finger()
    flat = replace(result, ridge_mm=result.ridge_mm * np.float32(0.25))
    figures = compare(flat, truth).figures
    assert figures["ridge_gain"] == pytest.approx(0.25, abs=1e-4)
    assert figures["ridge_correlation"] == pytest.approx(1.0, abs=1e-6)
    assert figures["ridge_rms_um"] == pytest.approx(0.75 * figures["ridge_truth_std_um"], rel=0.02)


def test_distance_does_not_count_but_tilt_does():
    result, truth = finger()
    far = replace(result, height_mm=result.height_mm + np.float32(7.0))
    assert compare(far, truth).figures["surface_rms_mm"] == pytest.approx(0.0, abs=1e-5)
    tilt = np.linspace(-0.5, 0.5, result.mask.shape[1], dtype=np.float32)
    comparison = compare(replace(result, height_mm=result.height_mm + tilt), truth)
    inside = np.broadcast_to(tilt, result.mask.shape)[comparison.surface]
    assert comparison.figures["surface_rms_mm"] == pytest.approx(float(inside.std()), rel=1e-4)


@pytest.mark.slow
def test_the_surface_error_leaves_out_the_edge():
    result, truth = finger()
    surface = compare(result, truth).surface
    rows, columns = np.nonzero(surface)
    edge_rows, edge_columns = np.nonzero(~result.mask)
    step = slice(None, None, 97)
    nearest = min(
        float(np.hypot(edge_rows - r, edge_columns - c).min())
        for r, c in zip(rows[step], columns[step], strict=True)
    )
    assert nearest * result.pitch_mm > 0.33
    spoilt = np.where(surface, result.height_mm, result.height_mm + np.float32(1.0))
    assert compare(replace(result, height_mm=spoilt), truth).figures[
        "surface_rms_mm"
    ] == pytest.approx(0.0, abs=1e-6)


def test_ridge_band_stops_at_sixty_degrees():
    result, truth = finger()
    comparison = compare(result, truth)
    slope = np.hypot(*np.gradient(truth["shape_mm"].astype(float), result.pitch_mm))
    slant = np.rad2deg(np.arctan(slope))
    assert np.nanmax(slant[comparison.band]) < 61.5
    beyond = comparison.surface & ~comparison.band
    assert beyond.any()
    assert np.nanmin(slant[beyond]) > 58.5


def test_good_area_is_the_fraction_with_correct_ridges():
    result, truth = finger()
    noise = np.random.default_rng(0).normal(0, 0.03, result.mask.shape).astype(np.float32)
    half = np.where(
        np.arange(result.mask.shape[1]) < result.mask.shape[1] // 2, result.ridge_mm, noise
    )
    area = compare(replace(result, ridge_mm=half.astype(np.float32)), truth).figures[
        "ridge_good_area"
    ]
    assert 0.4 < area < 0.6


def test_a_partial_result_is_compared_where_both_masks_overlap():
    result, truth = finger()
    part = result.mask.copy()
    part[220:] = False
    figures = compare(replace(result, mask=part), truth).figures
    assert figures["mask_overlap"] == pytest.approx(part.sum() / truth["mask"].sum())
    assert figures["mask_on_finger"] == 1.0
    wide = np.ones_like(part)
    assert compare(replace(result, mask=wide), truth).figures["mask_on_finger"] == pytest.approx(
        truth["mask"].mean()
    )
    assert figures["surface_rms_mm"] == pytest.approx(0.0, abs=1e-6)


def test_wrong_truth_is_refused():
    result, truth = finger()
    with bad_input("no 'shape_mm'"):
        compare(result, {k: v for k, v in truth.items() if k != "shape_mm"})
    with bad_input("has the shape"):
        compare(result, {**truth, "height_mm": truth["height_mm"][:-1]})
    with bad_input("no pixel in common"):
        compare(result, {**truth, "mask": np.zeros_like(truth["mask"])})


def test_high_pass_keeps_ridges_and_drops_slopes():
    x = np.arange(300, dtype=np.float32)[None].repeat(80, axis=0)
    ridges = np.sin(2 * np.pi * x / 10).astype(np.float32)
    kept = high_passed(ridges + 0.05 * x, np.ones(x.shape, bool), 8.0)
    assert np.abs(kept[:, 40:-40] - ridges[:, 40:-40]).max() < 0.01


@pytest.mark.parametrize("installed", [True, False])
def test_a_simulated_capture_is_compared_where_the_simulator_is_installed(
    tmp_path, monkeypatch, *, installed
):
    simulated, truth = splitknit_simulator.simulate_capture(1, settings={"scale": 0.06})
    splitknit.write_capture(simulated, tmp_path / "capture", truth)
    if not installed:
        monkeypatch.setattr("splitknit.folders.registered", lambda _: {})
    done = reconstruct_to_folder(tmp_path / "capture", out=tmp_path / "out", preset="ea")
    assert set(done.facts["comparison"]) == ({"ea"} if installed else set())
    assert ("Against the truth (ea): surface rms" in str(done)) == installed
