"""Glare of a rough dielectric: the textbook's limits, and finding it in images."""

import numpy as np
import pytest

from splitknit.skin.light import ROUGHNESS, fresnel_transmission, glare_strength, microfacet_glare

NORMAL_REFLECTANCE = (0.42 / 2.42) ** 2


def flat(directions):
    """Normals (1, n, 3) and one light that many pixels share."""
    return np.asarray(directions, dtype=np.float32)[None]


def lights_at(*vectors, pixels):
    return np.repeat(np.asarray(vectors, dtype=np.float32)[:, :, None, None], pixels, axis=3)


def direction(polar_deg, azimuth_deg=0.0):
    t, p = np.deg2rad(polar_deg), np.deg2rad(azimuth_deg)
    return np.stack(
        np.broadcast_arrays(np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)), axis=-1
    )


def test_transmission_follows_fresnel():
    # at Brewster's angle only s-polarised light is mirrored, ((n^2 - 1) / (n^2 + 1))^2 of it
    index = 1.42
    mirrored = 0.5 * ((index**2 - 1) / (index**2 + 1)) ** 2
    brewster = np.cos(np.arctan(index))
    assert float(fresnel_transmission(brewster)) == pytest.approx(
        (1 - mirrored) / (1 - NORMAL_REFLECTANCE), abs=1e-5
    )
    assert float(fresnel_transmission(0.3, index=1.0)) == pytest.approx(1.0, abs=1e-6)


def test_the_lobe_of_any_facet_follows_cook_and_torrance():
    """Cook and Torrance with GGX and Smith's shadowing, written out in double precision."""
    rng = np.random.default_rng(4)
    tilts, around = rng.uniform(0, 70, 40), rng.uniform(0, 360, 40)
    light, normal = direction(35.0, 20.0), direction(tilts, around)
    half = light + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    a2 = ROUGHNESS**2
    nl, nv, nh, lh = normal @ light, normal[:, 2], normal @ half, light @ half
    facets = a2 / (np.pi * ((nh * nh) * (a2 - 1) + 1) ** 2)
    unshadowed = [2 / (1 + np.sqrt(1 + a2 * (1 / c**2 - 1))) for c in (nl, nv)]
    g = np.sqrt(1.42**2 - 1 + lh**2)
    reflectance = (
        0.5 * ((g - lh) / (g + lh)) ** 2 * (1 + ((lh * (g + lh) - 1) / (lh * (g - lh) + 1)) ** 2)
    )  # Walter et al., eq. 22
    expected = facets * unshadowed[0] * unshadowed[1] * reflectance / (4 * nv)
    glare = microfacet_glare(flat(normal), lights_at(light, pixels=40))[0, 0]
    lit = nl > 0.05
    np.testing.assert_allclose(glare[lit], expected[lit], rtol=1e-3)
    assert lit.sum() > 20


def test_light_from_behind_gives_no_specular_reflection():
    normals = flat([[0, 0, 1], direction(60.0, 180.0)])
    glare = microfacet_glare(normals, lights_at((0.1, 0, -0.5), (1, 0, 0.2), pixels=2))
    assert glare[0, 0, 0] == 0
    assert glare[1, 0, 1] == 0
    assert glare[1, 0, 0] > 0


def test_specular_reflection_is_linear_in_the_light():
    normals = flat(direction(np.arange(0, 60, 5.0), 40.0))
    light = lights_at(direction(20.0), direction(50.0, 90.0), pixels=12)
    weak, strong = (microfacet_glare(normals, light * np.float32(s)) for s in (1.0, 7.0))
    np.testing.assert_allclose(strong, 7 * weak, rtol=2e-5)
    assert weak.dtype == np.float32


def cap():
    """A cap of 35 deg under seven lights (7, 3, n): matt shading (7, n), specular reflection."""
    x, y = np.meshgrid(np.linspace(-0.55, 0.55, 41), np.linspace(-0.55, 0.55, 41))
    inside = np.hypot(x, y) < 0.55
    x, y = x[inside], y[inside]
    normals = np.stack([x, y, np.sqrt(1 - x * x - y * y)], axis=-1).astype(np.float32)
    towards = (
        direction(np.full(7, 22.0), np.arange(7) * 360 / 7) * (1 + 0.1 * np.arange(7))[:, None]
    )
    lights = np.repeat(towards[:, :, None].astype(np.float32), len(x), axis=2)
    return lights, np.einsum("lin,ni->ln", lights, normals), microfacet_glare(normals, lights)


def test_the_strength_is_found_for_any_albedo():
    lights, matt, lobe = cap()
    albedo = 0.3 + 0.5 * np.random.default_rng(0).random(matt.shape[1]).astype(np.float32)
    assert matt.min() > 0
    strength = glare_strength(albedo * matt + np.float32(1.7) * lobe, lights, lobe)
    assert strength == pytest.approx(1.7, rel=1e-3)


def test_a_matt_surface_has_no_strength_and_it_is_never_negative():
    lights, matt, lobe = cap()
    assert abs(glare_strength(matt, lights, lobe)) < 1e-4
    noise = np.random.default_rng(1).normal(0, 1e-3, matt.shape)
    assert 0 <= glare_strength((matt + noise).astype(np.float32), lights, lobe) < 0.01
    assert glare_strength(matt - lobe, lights, lobe) == 0.0


def test_the_strength_needs_four_lights_and_a_pixel():
    lights, matt, lobe = cap()
    assert glare_strength(matt[:3], lights[:3], lobe[:3]) == 0.0
    assert glare_strength(matt[:, :0], lights[:, :, :0], lobe[:, :0]) == 0.0
