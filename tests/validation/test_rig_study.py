"""The thesis's study of rigs: light in electrons, distances from the truth against brute force, and its charts."""

from __future__ import annotations

import importlib
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.errors import BadInput
from splitknit.model import Reconstruction
from splitknit.report.charts import standalone
from splitknit_rig.rig.candidates import (
    LAMPS,
    BuildSettings,
    PhotonSettings,
    RigCandidate,
    candidate_rig,
    intensity_w_sr,
)
from splitknit_rig.rig.optimise import FIRST_SEED as SEED

RIG = RigCandidate(140.0, 52.5, 1.0, None, 6.0)


@pytest.fixture(scope="module")
def thesis():
    """The script validation/rig/thesis_study.py."""
    with scripts_of(VALIDATION / "rig") as script:
        yield script("thesis_study")


@pytest.fixture(scope="module")
def plots(thesis):
    """The script validation/rig/plots.py."""
    return importlib.import_module("plots")


@pytest.fixture(scope="module")
def seen(thesis):
    """Perspective view of the finger, and its phalange."""
    surface = thesis._view_of(SEED, thesis._rigs(RIG, thesis.ThesisStudy(fingers=1))[0].camera)
    return surface, thesis._phalange(SEED, surface)


def _shot(thesis, seen, candidate=RIG, seed=1, rendered=False):
    surface, mask = seen
    build = BuildSettings(half_angle_deg=90.0) if rendered else BuildSettings()
    power = candidate.power_w / (4 * np.pi)
    intensity = power if rendered else intensity_w_sr(candidate.power_w, LAMPS["white"], build.lobe_exponent)
    rig = candidate_rig(candidate, build, {"white": intensity})
    return thesis.photograph_candidate(
        surface,
        rig,
        known_rig=rig,
        mask=mask,
        skin=None,
        photons=PhotonSettings(),
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


def test_the_finger_lies_in_the_same_place_under_every_camera(thesis, seen):
    other = candidate_rig(replace(RIG, px_per_mm=9.3), BuildSettings(view="orthographic"), {"white": 1.0}).camera
    edges = []
    for one in (seen[0], thesis._view_of(SEED, other)):
        x, y = thesis._places(one)
        assert np.nanmax(one.shape_mm) == pytest.approx(0.0, abs=0.01)
        high = one.mask & (one.shape_mm > -2.0)
        edges.append((y[high].max(), x[high].min(), x[high].max()))
    assert edges[0] == pytest.approx(edges[1], abs=0.2), "one pixel"


def test_a_perfect_surface_is_as_near_as_the_points_are_dense(thesis, seen):
    surface, mask = seen
    lifted = _result(surface.height_mm + 3.0, surface, mask, x_mm=surface.x_mm, y_mm=surface.y_mm)
    found = thesis._compare_surfaces(lifted, surface, mask, SEED, 10.0)
    assert found["rms_mm"] < 0.08 and found["hausdorff95_mm"] < 0.17 and found["hausdorff_mm"] < 0.3
    assert found["normals_deg"] < 0.1 and found["ridge_correlation"] == pytest.approx(1.0)


def test_a_bent_surface_is_off_by_what_it_is_bent(thesis, seen):
    surface, mask = seen
    x, _ = thesis._places(surface)
    bent = surface.height_mm + np.where(mask, 0.04 * x * x, 0.0)
    result = _result(bent, surface, mask, x_mm=surface.x_mm, y_mm=surface.y_mm)
    found = thesis._compare_surfaces(result, surface, mask, SEED, 10.0)
    flat = thesis._printed(surface, mask)
    error = (0.04 * x * x)[flat]
    largest = np.abs(error - error.mean()).max()
    assert 0.6 * largest < found["hausdorff_mm"] < largest + 0.05, "the nearest point is nearer than the one above"
    # parallel rays misplace the sides: the same heights, read straight from above, are another surface
    straight = thesis._compare_surfaces(_result(surface.height_mm, surface, mask), surface, mask, SEED, 10.0)
    assert straight["rms_mm"] > 0.05
    assert straight["normals_deg"] < 0.1


def test_truth_holds_the_print_within_the_phalange(thesis):
    points = thesis._truth(SEED, 6.0)
    assert points.phalange.shape == (points.print.size, 3)
    assert 0.4 < points.print.mean() < 0.95
    assert np.isfinite(points.phalange).all()


def test_more_power_is_a_shorter_exposure(thesis, seen):
    bright, dim = _shot(thesis, seen), _shot(thesis, seen, replace(RIG, power_w=0.5))
    assert dim.exposures["white"].time_s == pytest.approx(2.0 * bright.exposures["white"].time_s)
    assert bright.exposures["white"].level == pytest.approx(0.7)
    brightest = np.percentile(bright.capture.bands["white"].pixels[..., 1], 99.95) / 65535
    assert brightest == pytest.approx(0.7, abs=0.05)


def test_noise_is_that_of_the_electrons(thesis, seen):
    # gain 8: a full-resolution pixel holds an eighth of the electrons; 158 of them make a pixel of 6 px/mm
    weak = replace(RIG, power_w=0.02)
    first, second = (_shot(thesis, seen, weak, seed) for seed in (1, 2))
    gain = first.exposures["white"].gain
    assert gain == pytest.approx(8.0) or gain > 4.0
    a, b = (one.capture.bands["white"].pixels[0, :, :, 1].astype(float) / 65535 for one in (first, second))
    where = (a > 0.2) & seen[1]
    electrons = 4700.0 / gain * (75.7 / 6.0) ** 2
    measured = np.std((a - b)[where] / np.sqrt(2 * a[where]))
    assert measured == pytest.approx(1.0 / np.sqrt(electrons), rel=0.08)


def test_a_rendering_programs_exposure_is_fixed(thesis, seen):
    one = _shot(thesis, seen, rendered=True)
    # a lamp of 1 W shines with 1 / (4 pi) W/sr from 150 mm onto albedo 0.5
    expected = 0.5 / np.pi / (4 * np.pi) / (0.14**2 + 0.0525**2)
    assert one.exposures["white"].level == pytest.approx(expected, rel=0.1)
    white = _shot(thesis, seen, replace(RIG, power_w=10.0), rendered=True)
    assert (white.capture.bands["white"].pixels == 255).mean() > 0.05, "ten watts clip"
    assert white.capture.encoding == "srgb" and white.capture.bands["white"].pixels.dtype == np.uint8


@pytest.mark.slow
def test_measuring_again_gives_the_same_figures(thesis):
    study = thesis.ThesisStudy(fingers=1)
    first, second = thesis._measure(RIG, study, SEED), thesis._measure(RIG, study, SEED)
    assert first == second
    assert 0.2 < first["rms_mm"] < 2.0 and first["rms_mm"] < first["hausdorff95_mm"] < first["hausdorff_mm"]
    masked = thesis._measure(RIG, replace(study, method="ea-poisson"), SEED)
    assert masked["rms_mm"] < 0.7 * first["rms_mm"], "Frankot-Chellappa on a zero-filled rectangle bends the finger"


def test_tremor_blurs_more_the_longer_and_never_beyond_its_amplitude(thesis):
    times = np.linspace(1e-4, 0.055, 20)
    blurs = [thesis._tremor_blur_mm(float(t)) for t in times]
    assert np.all(np.diff(blurs) > 0) and blurs[0] < 1e-4
    assert max(thesis._tremor_blur_mm(float(t)) for t in np.linspace(0, 2, 200)) <= 0.030 / np.sqrt(2) + 1e-9
    # the mean of the variance over random phases, by sampling
    rng, t = np.random.default_rng(0), 0.03
    phases = rng.random(4000)[:, None] * 2 * np.pi
    places = 0.030 * np.sin(2 * np.pi * 9.0 * np.linspace(0, t, 400)[None] + phases)
    assert thesis._tremor_blur_mm(t) == pytest.approx(np.sqrt(places.var(axis=1).mean()), rel=0.03)


def _brute(first, second):
    apart = np.linalg.norm(first[:, None] - second[None], axis=2)
    return apart.min(axis=1), apart.min(axis=0)


@pytest.mark.parametrize("seed", range(5))
def test_distances_are_those_of_every_pair(thesis, seed):
    rng = np.random.default_rng(seed)
    first, second = rng.random((70, 3)), rng.random((90, 3)) + 0.2
    there, back = thesis._both_ways(first, second)
    expected = _brute(first, second)
    np.testing.assert_allclose(there, expected[0])
    np.testing.assert_allclose(back, expected[1])
    found = thesis._surface_distances(there, back)
    assert found["hausdorff_mm"] == pytest.approx(max(expected[0].max(), expected[1].max()))
    assert found["hausdorff95_mm"] == pytest.approx(max(np.percentile(expected[0], 95), np.percentile(expected[1], 95)))
    assert found["rms_mm"] == pytest.approx(np.sqrt(0.5 * np.mean(expected[0] ** 2) + 0.5 * np.mean(expected[1] ** 2)))


def test_distance_looks_both_ways(thesis):
    plane = np.stack([*np.meshgrid(np.arange(5.0), np.arange(5.0)), np.zeros((5, 5))], axis=-1).reshape(-1, 3)
    spike = np.concatenate([plane, [[2.0, 2.0, 3.0]]])
    there, back = thesis._both_ways(plane, spike)
    assert there.max() == 0.0
    assert thesis._surface_distances(there, back)["hausdorff_mm"] == 3.0
    assert thesis._surface_distances(back, there)["hausdorff_mm"] == 3.0
    assert thesis._surface_distances(there, there)["hausdorff_mm"] == 0.0


def test_a_lifted_surface_is_as_far_as_it_was_lifted(thesis):
    rng = np.random.default_rng(3)
    surface = np.concatenate([rng.random((400, 2)) * 10, np.zeros((400, 1))], axis=1)
    found = thesis._surface_distances(*thesis._both_ways(surface, surface + np.array([0.0, 0.0, 0.01])))
    assert found["hausdorff_mm"] == pytest.approx(0.01)
    assert found["rms_mm"] == pytest.approx(0.01)


def test_points_that_are_none_are_refused(thesis):
    points = np.zeros((4, 3))
    for wrong in (np.zeros((0, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan)):
        with pytest.raises(BadInput, match="second"):
            thesis._both_ways(points, wrong)
    with pytest.raises(BadInput, match="no distances"):
        thesis._surface_distances(np.zeros(0), np.zeros(3))


def test_heat_map_says_why_a_rig_is_missing(plots):
    cells = [
        plots.Cell(50.0, 100.0, 1.0, "", best=True),
        plots.Cell(50.0, 140.0, 2.0, "", thesis=True, as_good=True),
        plots.Cell(20.0, 100.0, None, "glare"),
    ]
    drawn = standalone(plots.heat_map(cells, "radius", "height", "mm", title="error <of> rigs")).decode()
    ElementTree.fromstring(drawn)
    assert "glare" in drawn and "url(#stripes)" in drawn and "2.00 •" in drawn and "&lt;of&gt;" in drawn
    assert drawn.count('stroke-dasharray="4 3"') == 1
