"""Optics of skin: coefficients, random walks, kernels."""

import itertools
import runpy
from pathlib import Path

import numpy as np
import pytest

from kernel_of_profile import kernel as kernel_of
from refusals import bad_input
from splitknit_simulator.light.skin import (
    CHANNELS,
    RADIUS_EDGES,
    Boundary,
    SkinOptics,
    SkinRanges,
    diffuse_transmittance,
    diffusion_profile,
    fresnel,
)

REFERENCE = {
    "red": (3.39, 0.030),
    "green": (4.12, 0.20),
    "blue": (5.18, 0.40),
    "nir": (2.16, 0.020),
}


@pytest.fixture(scope="module")
def maker():
    """Names of the script that makes the table of walks."""
    return runpy.run_path(str(Path(__file__).resolve().parents[5] / "tools" / "make_walk_table.py"))


def test_the_brightness_of_heights_follows_the_reference_walks():
    """Gain over attenuation of ridges of 75 um in our own walks, by scattering; their errors are
    0.04 to 0.12."""
    matt, smooth = Boundary(), Boundary(refraction=1.0)
    for scattering, gain in ((1.08, 0.09), (1.7, 0.51), (2.38, 0.70), (3.39, 0.78), (5.18, 0.82)):
        assert 0.78 * matt.height_signal(scattering) == pytest.approx(gain, abs=0.12)
    for scattering, gain in (
        (2.59, 1.24),
        (2.88, 1.05),
        (4.12, 0.72),
        (5.18, 0.68),
        (7.25, 0.42),
        (10.4, 0.37),
    ):
        assert 0.78 * smooth.height_signal(scattering) == pytest.approx(gain, abs=0.12)
    assert matt.height_signal(0.5) == 0.0


def test_melanin_absorbs_most_in_blue_and_blood_in_green():
    light, dark = SkinOptics(melanin=0.0002), SkinOptics(melanin=0.02)
    rise = {
        c: dark.channel(c).absorption_per_mm - light.channel(c).absorption_per_mm for c in CHANNELS
    }
    assert rise["blue"] > rise["green"] > rise["red"] > rise["nir"] > 0
    pale, flushed = SkinOptics(blood=0.003), SkinOptics(blood=0.012)
    ratio = {
        c: flushed.channel(c).absorption_per_mm / pale.channel(c).absorption_per_mm
        for c in CHANNELS
    }
    assert ratio["green"] > 2 > ratio["red"] > 1


def test_skin_settings_out_of_range_are_refused():
    with bad_input("melanin"):
        SkinOptics(melanin=0.3)
    with bad_input("glare"):
        SkinRanges(glare=(2.0, 1.0))


def test_drawn_skin_stays_in_its_ranges_and_repeats():
    ranges = SkinRanges()
    drawn = [ranges.draw(np.random.default_rng(seed)) for seed in range(40)]
    assert drawn[3] == ranges.draw(np.random.default_rng(3))
    factors = np.array([skin.scattering_factor for skin in drawn])
    assert factors.min() >= 0.7
    assert factors.max() <= 1.4
    assert factors.std() > 0.1


def test_light_inside_is_reflected_totally_and_reciprocity_holds():
    for cosine in (0.0, 0.5):
        assert float(fresnel(np.array(cosine), 1 / 1.42)) == 1.0
    # reciprocity of diffuse light: n^2 (1 - F inside) = 1 - F outside
    assert diffuse_transmittance(1 / 1.42) * 1.42**2 == pytest.approx(
        diffuse_transmittance(), rel=2e-3
    )


def test_reweighted_walks_equal_walks_that_absorb(maker):
    """A walk that dies with the probability of absorption gives the same albedo as the reweighted
    table."""
    rng = np.random.default_rng(2)
    _, lengths = maker["_walk_batch"](20_000, rng)
    survives = rng.standard_exponential(lengths.size) > lengths * (0.4 / 5.18)
    assert survives.sum() / 20_000 == pytest.approx(diffusion_profile(5.18, 0.4).albedo, abs=0.012)


@pytest.mark.parametrize("channel", CHANNELS)
def test_the_modulation_at_the_ridge_period_is_the_measured_one(channel):
    """measurements.md: B 0.22, G 0.15, R 0.08 at one cycle in 33 px."""
    scattering, absorption = REFERENCE[channel]
    profile = diffusion_profile(scattering, absorption)
    left = float(profile.transfer(np.array([75.7 / 33]))[0]) / profile.albedo
    assert left == pytest.approx(
        {"red": 0.08, "green": 0.15, "blue": 0.22, "nir": 0.05}[channel], abs=0.006
    )


@pytest.mark.parametrize("pitch_mm", [1 / 75.7, 1 / 20])
def test_kernel_conserves_energy_and_follows_the_profile(pitch_mm):
    profile = diffusion_profile(5.18, 0.4)
    kernel = kernel_of(profile, pitch_mm, 2.0)
    assert kernel.sum() == pytest.approx(profile.albedo, rel=1e-5)
    np.testing.assert_allclose(kernel, kernel[::-1], rtol=1e-5)
    np.testing.assert_allclose(kernel, kernel.T, rtol=1e-5)
    n = kernel.shape[0] // 2
    distance = np.hypot(*np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))) * pitch_mm
    inside = np.concatenate([[0.0], np.cumsum(profile.weights)])
    for radius in (0.2, 0.5, 1.0):
        fraction = float(np.interp(radius, profile.radii_mm, inside)) / float(
            np.interp(2.0, profile.radii_mm, inside)
        )
        assert kernel[distance < radius].sum() / kernel.sum() == pytest.approx(
            fraction, abs=max(0.02, 0.7 * pitch_mm)
        )
    # the centre pixel against samples of the profile
    rng = np.random.default_rng(0)
    ring = rng.choice(profile.weights.size, 200_000, p=profile.weights / profile.albedo)
    low, high = profile.radii_mm[ring] ** 2, profile.radii_mm[ring + 1] ** 2
    radius, turn = (
        np.sqrt(low + (high - low) * rng.random(ring.size)),
        2 * np.pi * rng.random(ring.size),
    )
    centre = np.maximum(abs(radius * np.cos(turn)), abs(radius * np.sin(turn))) < pitch_mm / 2
    assert kernel[n, n] == pytest.approx(centre.mean() * profile.albedo, rel=0.05)


def test_profile_scales_with_the_mean_free_path():
    near, far = diffusion_profile(4.0, 0.2), diffusion_profile(2.0, 0.1)
    assert far.albedo == pytest.approx(near.albedo, rel=1e-12)
    assert far.radius_mm(0.5) == pytest.approx(2 * near.radius_mm(0.5), rel=1e-9)
    assert near.radii_mm.size == RADIUS_EDGES.size


def test_albedo_falls_with_absorption():
    albedos = [diffusion_profile(4.0, a).albedo for a in (0.01, 0.1, 0.5, 2.0)]
    assert all(a > b for a, b in itertools.pairwise(albedos))
    assert 0.05 < albedos[-1] < albedos[0] < 0.9


def test_absorption_too_weak_for_the_walks_is_refused():
    with bad_input("absorption"):
        diffusion_profile(4.0, 0.001)
