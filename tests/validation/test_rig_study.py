"""The thesis's search of rigs: light in electrons, distances from the truth, a sweep that goes
on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from script_folder import VALIDATION
from splitknit.reconstruction import Reconstruction

FOLDER = VALIDATION / "thesis"


@pytest.fixture(scope="module")
def study(script):
    return script("rig_study")


@pytest.fixture(scope="module")
def rigs(script):
    return script("rig_candidates")


@pytest.fixture(scope="module")
def rig(rigs):
    return rigs.RigCandidate(140.0, 52.5, 1.0, None, 6.0)


@pytest.fixture(scope="module")
def seen(study, rigs, rig):
    """Perspective view of the finger, and its phalange."""
    surface = study.view_of(
        study.FIRST_SEED, rigs.candidate_rig(rig, rigs.BuildSettings(), {"white": 1.0}).camera
    )
    return surface, study.phalange_of(study.FIRST_SEED, surface)


@pytest.fixture(scope="module")
def shot(study, rigs, rig, seen):
    def taken(seed=1, rendered=False, **changes):
        candidate = replace(rig, **changes)
        build = rigs.BuildSettings(half_angle_deg=90.0 if rendered else 30.0)
        power = candidate.power_w / (4 * np.pi)
        lit = power if rendered else rigs.led_intensities(candidate, build, ("white",))["white"]
        built = rigs.candidate_rig(candidate, build, {"white": lit})
        how = {"known_rig": built, "mask": seen[1], "skin": None, "photons": rigs.PhotonSettings()}
        return study.photograph_candidate(
            seen[0], built, **how, seed=np.random.SeedSequence(seed), rendered=rendered
        )

    return taken


def test_a_perfect_surface_is_as_near_as_the_points_are_dense_and_a_bent_one_off_by_its_bend(
    study, seen
):
    surface, mask = seen

    x_mm, y_mm = (axis.astype(np.float32) for axis in surface.sight().at(surface.height_mm)[:2])

    def compared(height):
        result = Reconstruction(
            height_mm=np.where(mask, height, np.nan).astype(np.float32),
            ridge_mm=np.where(mask, surface.height_mm - surface.shape_mm, np.nan).astype(
                np.float32
            ),
            shape_mm=np.where(mask, surface.shape_mm, np.nan).astype(np.float32),
            mask=mask,
            normals=surface.normals,
            albedo=np.ones_like(surface.height_mm),
            pitch_mm=surface.camera.pitch_mm,
            input_from_upright=np.eye(3),
            upright_size=mask.shape,
            preset="ea",
            x_mm=x_mm,
            y_mm=y_mm,
        )
        return study.compare_surfaces(result, surface, mask, study.FIRST_SEED, 10.0)

    perfect = compared(surface.height_mm + 3.0)
    assert (
        perfect["rms_mm"] < 0.08
        and perfect["hausdorff95_mm"] < 0.17
        and perfect["hausdorff_mm"] < 0.3
    )
    assert perfect["normals_deg"] < 0.1 and perfect["ridge_correlation"] == pytest.approx(1.0)
    assert compared(surface.height_mm + np.where(mask, 0.04 * x_mm**2, 0.0))["hausdorff_mm"] > 0.5


def test_more_power_is_a_shorter_exposure(shot):
    bright, dim = shot(), shot(power_w=0.5)
    assert dim.exposures["white"].time_s == pytest.approx(2.0 * bright.exposures["white"].time_s)
    brightest = np.percentile(bright.capture.bands["white"].pixels[..., 1], 99.95) / 65535
    assert brightest == pytest.approx(0.7, abs=0.05)


def test_noise_is_that_of_the_electrons(shot, seen):
    # gain 8: a full-resolution pixel holds an eighth of the electrons; 158 of them make a pixel of
    # 6 px/mm
    first, second = (shot(seed, power_w=0.02) for seed in (1, 2))
    a, b = (
        photograph.capture.bands["white"].pixels[0, :, :, 1].astype(float) / 65535
        for photograph in (first, second)
    )
    where = (a > 0.2) & seen[1]
    electrons = 4700.0 / first.exposures["white"].gain * (75.7 / 6.0) ** 2
    measured = np.std((a - b)[where] / np.sqrt(2 * a[where]))
    assert measured == pytest.approx(1.0 / np.sqrt(electrons), rel=0.08)


def test_a_rendering_programs_exposure_is_fixed(shot):
    # a lamp of 1 W shines with 1 / (4 pi) W/sr from 150 mm onto albedo 0.5
    expected = 0.5 / np.pi / (4 * np.pi) / (0.14**2 + 0.0525**2)
    assert shot(rendered=True).exposures["white"].level == pytest.approx(expected, rel=0.1)
    white = shot(rendered=True, power_w=10.0)
    assert (white.capture.bands["white"].pixels == 255).mean() > 0.05, "ten watts clip"


def test_tremor_is_the_mean_of_the_variance_over_random_phases(study):
    rng, t = np.random.default_rng(0), 0.03
    phases = rng.random(4000)[:, None] * 2 * np.pi
    places = 0.030 * np.sin(2 * np.pi * 9.0 * np.linspace(0, t, 400)[None] + phases)
    assert study.tremor_blur_mm(t) == pytest.approx(np.sqrt(places.var(axis=1).mean()), rel=0.03)


@pytest.mark.slow
def test_a_sweep_goes_on_where_it_was_and_is_compared(script, tmp_path, capsys):
    sweep = script("rigs")
    words = f"--heights 140 --radii 12 52.5 --fingers 1 --scratch {tmp_path}".split()
    assert sweep.main(words) == 0
    first = capsys.readouterr().out
    assert "52.5     1" in first and "h140_r12_" in first
    for file in tmp_path.rglob("*.json"):
        file.chmod(0o400)
    assert sweep.main(words) == 0
    assert capsys.readouterr().out == first
