"""What one rig measures of one finger: light in electrons, and the distance from the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.model import Reconstruction
from splitknit.rig.candidates import FIRST_SEED, BuildSettings, RigCandidate, Study, candidate_rig
from splitknit.rig.evaluate_rig import (
    _compare_surfaces,
    _measure,
    _phalange,
    _places,
    _printed,
    _rigs,
    _truth,
    _view_of,
    evaluate_candidate,
)
from splitknit.rig.photography import LAMPS, PhotonSettings, intensity_w_sr, photograph_candidate

RIG = RigCandidate(140.0, 52.5, 1.0, None, 6.0)
STUDY = Study(fingers=1)
SEED = FIRST_SEED


@pytest.fixture(scope="module")
def seen():
    """Perspective view of the finger, and its phalange."""
    surface = _view_of(SEED, _rigs(RIG, STUDY)[0].camera)
    return surface, _phalange(SEED, surface)


def _shot(seen, candidate=RIG, seed=1, photons=None, rendered=False):
    surface, mask = seen
    photons = photons or PhotonSettings()
    build = BuildSettings(half_angle_deg=90.0) if rendered else BuildSettings()
    power = candidate.power_w / (4 * np.pi)
    intensity = power if rendered else intensity_w_sr(candidate.power_w, LAMPS["white"], build.lobe_exponent)
    rig = candidate_rig(candidate, build, {"white": intensity})
    return photograph_candidate(
        surface,
        rig,
        known_rig=rig,
        mask=mask,
        skin=None,
        photons=photons,
        seed=np.random.SeedSequence(seed),
        rendered=rendered,
    )


def _result(height, surface, mask, **changes):
    return Reconstruction(
        height_mm=np.where(mask, height, np.nan).astype(np.float32),
        ridge_mm=np.where(mask, surface.height_mm - surface.shape_mm, np.nan).astype(np.float32),
        shape_mm=np.where(mask, surface.shape_mm, np.nan).astype(np.float32),
        mask=mask,
        normals=surface.normals,
        albedo=np.ones_like(surface.height_mm),
        pitch_mm=surface.camera.pitch_mm,
        input_from_upright=np.eye(3),
        upright_size=mask.shape,
        preset="ea",
        **changes,
    )


def test_the_finger_lies_in_the_same_place_under_every_camera(seen):
    other = candidate_rig(replace(RIG, px_per_mm=9.3), BuildSettings(), {"white": 1.0}, "orthographic").camera
    edges = []
    for one in (seen[0], _view_of(SEED, other)):
        x, y = _places(one)
        assert np.nanmax(one.shape_mm) == pytest.approx(0.0, abs=0.01)
        high = one.mask & (one.shape_mm > -2.0)
        edges.append((y[high].max(), x[high].min(), x[high].max()))
    assert edges[0] == pytest.approx(edges[1], abs=0.2), "one pixel"


def test_a_perfect_surface_is_as_near_as_the_points_are_dense(seen):
    surface, mask = seen
    lifted = _result(surface.height_mm + 3.0, surface, mask, x_mm=surface.x_mm, y_mm=surface.y_mm)
    found = _compare_surfaces(lifted, surface, mask, SEED, 10.0)
    assert found["rms_mm"] < 0.08 and found["hausdorff95_mm"] < 0.17 and found["hausdorff_mm"] < 0.3
    assert found["normals_deg"] < 0.1 and found["ridge_correlation"] == pytest.approx(1.0)


def test_a_bent_surface_is_off_by_what_it_is_bent(seen):
    surface, mask = seen
    x, _ = _places(surface)
    bent = surface.height_mm + np.where(mask, 0.04 * x * x, 0.0)
    result = _result(bent, surface, mask, x_mm=surface.x_mm, y_mm=surface.y_mm)
    found = _compare_surfaces(result, surface, mask, SEED, 10.0)
    flat = _printed(surface, mask)
    error = (0.04 * x * x)[flat]
    largest = np.abs(error - error.mean()).max()
    assert 0.6 * largest < found["hausdorff_mm"] < largest + 0.05, "the nearest point is nearer than the one above"
    # parallel rays misplace the sides: the same heights, read straight from above, are another surface
    straight = _compare_surfaces(_result(surface.height_mm, surface, mask), surface, mask, SEED, 10.0)
    assert straight["rms_mm"] > 0.05
    assert straight["normals_deg"] < 0.1


def test_truth_holds_the_print_within_the_phalange():
    points = _truth(SEED, 6.0)
    assert points.phalange.shape == (points.print.size, 3)
    assert 0.4 < points.print.mean() < 0.95
    assert np.isfinite(points.phalange).all()


def test_more_power_is_a_shorter_exposure(seen):
    bright, dim = _shot(seen), _shot(seen, replace(RIG, power_w=0.5))
    assert dim.exposures["white"].time_s == pytest.approx(2.0 * bright.exposures["white"].time_s)
    assert bright.exposures["white"].level == pytest.approx(0.7)
    brightest = np.percentile(bright.capture.bands["white"].pixels[..., 1], 99.95) / 65535
    assert brightest == pytest.approx(0.7, abs=0.05)


def test_noise_is_that_of_the_electrons(seen):
    # gain 8: a full-resolution pixel holds an eighth of the electrons; 158 of them make a pixel of 6 px/mm
    weak = replace(RIG, power_w=0.02)
    first, second = (_shot(seen, weak, seed) for seed in (1, 2))
    gain = first.exposures["white"].gain
    assert gain == pytest.approx(8.0) or gain > 4.0
    a, b = (one.capture.bands["white"].pixels[0, :, :, 1].astype(float) / 65535 for one in (first, second))
    where = (a > 0.2) & seen[1]
    electrons = 4700.0 / gain * (75.7 / 6.0) ** 2
    measured = np.std((a - b)[where] / np.sqrt(2 * a[where]))
    assert measured == pytest.approx(1.0 / np.sqrt(electrons), rel=0.08)


def test_a_rendering_programs_exposure_is_fixed(seen):
    one = _shot(seen, rendered=True)
    # a lamp of 1 W shines with 1 / (4 pi) W/sr from 150 mm onto albedo 0.5
    expected = 0.5 / np.pi / (4 * np.pi) / (0.14**2 + 0.0525**2)
    assert one.exposures["white"].level == pytest.approx(expected, rel=0.1)
    white = _shot(seen, replace(RIG, power_w=10.0), rendered=True)
    assert (white.capture.bands["white"].pixels == 255).mean() > 0.05, "ten watts clip"
    assert white.capture.encoding == "srgb" and white.capture.bands["white"].pixels.dtype == np.uint8


def test_measuring_again_gives_the_same_figures():
    first, second = _measure(RIG, STUDY, SEED), _measure(RIG, STUDY, SEED)
    assert first == second
    assert 0.2 < first["rms_mm"] < 2.0 and first["rms_mm"] < first["hausdorff95_mm"] < first["hausdorff_mm"]
    masked = _measure(RIG, replace(STUDY, method="ea-poisson"), SEED)
    assert masked["rms_mm"] < 0.7 * first["rms_mm"], "Frankot-Chellappa on a zero-filled rectangle bends the finger"


def test_a_broken_candidate_is_a_result(monkeypatch):
    import splitknit.rig.evaluate_rig as module

    def breaks(*unused, **named):
        raise ZeroDivisionError("somewhere deep")

    monkeypatch.setattr(module, "reconstruct", breaks)
    record = evaluate_candidate(RIG, STUDY)
    assert record["status"] == "failed" and record["reason"] == "ZeroDivisionError: somewhere deep"
    assert record["mean"] is None and record["constraints"]
    refused = evaluate_candidate(replace(RIG, radius_mm=15.0), STUDY)
    assert refused["status"] == "refused" and "free" in refused["reason"]
