"""Robust weights: shadows and highlights out, clean pixels untouched."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.imaging import chunks
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.robust import robust


def ring(count=7, elevation_deg=55.0):
    azimuth, elevation = 2 * np.pi * np.arange(count) / count, np.deg2rad(elevation_deg)
    return np.column_stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.full(count, np.sin(elevation)),
        ]
    )


def sphere(lights, gloss=0.0, noise=0.0, seed=0, sharpness=80, *, size=120):
    """Stack, normals and mask of a sphere with attached shadows, a highlight lobe and noise; albedo
    0.6."""
    i, j = np.mgrid[0:size, 0:size]
    x, y = (2 * j - size + 1) / size, (size - 1 - 2 * i) / size
    mask = x**2 + y**2 < 0.85
    normals = np.dstack([x, y, np.sqrt(np.clip(1 - x**2 - y**2, 1e-3, 1))])
    half = lights + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    shading = normals @ lights.T
    shine = gloss * np.clip(normals @ half.T, 0, 1) ** sharpness * (shading > 0)
    stack = 0.6 * np.clip(shading, 0, None) + shine
    stack += np.random.default_rng(seed).normal(0, noise, stack.shape)
    return np.clip(stack, 0, None).transpose(2, 0, 1).astype(np.float32), normals, mask


def error_deg(got, normals, mask):
    return np.degrees(np.arccos(np.clip((got * normals).sum(axis=-1), -1, 1)))[mask]


def test_shadows_are_left_out():
    lights = ring()
    stack, normals, mask = sphere(lights, noise=0.002)
    plain = error_deg(lambertian(stack, lights, mask)[0], normals, mask)
    kept = error_deg(robust(stack, lights, mask)[0], normals, mask)
    shadowed = (normals @ lights.T).min(axis=-1)[mask] < 0
    assert shadowed.mean() > 0.1
    assert kept[shadowed].mean() < 0.5
    assert plain[shadowed].mean() > 2
    assert kept[~shadowed].mean() < 1.02 * plain[~shadowed].mean()


@pytest.mark.parametrize(("count", "least"), [(12, 2.5), (24, 4.0)])
def test_highlights_lose_weight(count, least):
    lights = ring(count)
    stack, normals, mask = sphere(lights, gloss=0.5, noise=0.002)
    plain = error_deg(lambertian(stack, lights, mask)[0], normals, mask).mean()
    kept = error_deg(robust(stack, lights, mask)[0], normals, mask).mean()
    assert plain > least * kept


def test_lit_lights_in_one_plane_do_not_decide_alone():
    """Noise of 2 % must not turn a normal that three lights in one plane leave open; the shadowed
    ones close it."""
    lights = np.array(
        [[-0.5, 0.0, 1.0], [0.0, 0.01, 1.0], [0.5, 0.0, 1.0], [0.0, 0.8, 0.6], [0.0, -0.8, 0.6]]
    )
    stack = np.array([1.0, 1.02, 1.0, 0.028, 0.03], dtype=np.float32)[:, None, None]
    normals, albedo = robust(stack, lights)
    assert normals[0, 0, 2] > 0.95
    assert albedo[0, 0] < 1.1


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_lit_lights_that_determine_no_normal_decide_before_shadowed_ones(scale):
    """Two lit lights, and five in shadow that a matt surface would not leave quite black."""
    lights = ring()
    stack = scale * np.array([0.9, 0.5, 0, 0, 0, 0, 0])[:, None, None]
    normals, albedo = robust(stack, lights)
    fit = lights @ normals[0, 0] * albedo[0, 0] / scale
    assert np.abs(fit[:2] - [0.9, 0.5]).max() < 0.01


@pytest.mark.parametrize("wrong", [[0.3, 0.05, 0, 0, 0, 0, 0, 0, 0.02], [-0.05, *[0] * 8]])
def test_a_glossy_or_dim_pixel_has_the_fixed_point_of_cauchy_weights(wrong):
    """In double precision: half the weight at a residual of 3 % of the albedo, or 6 % below."""
    lights = ring(9)
    light = lights @ [0.1, 0.2, 0.97] + wrong
    g = np.linalg.lstsq(lights, light)[0]
    for _ in range(200):
        residual = (light - lights @ g) / (0.03 * np.linalg.norm(g))
        weights = 1 / (1 + np.maximum(residual, -residual / 2) ** 2)
        g = np.linalg.solve((lights.T * weights) @ lights, lights.T @ (weights * light))
    normals, albedo = robust(light[:, None, None], lights)
    assert np.abs(normals[0, 0] * albedo[0, 0] - g).max() < 1e-3


def test_a_clean_pixel_with_a_shadow_keeps_the_fit_of_its_lit_lights():
    lights = ring()
    light = np.append(lights[:6] @ [0.3, 0.1, 0.9] * [1.01, 1, 0.99, 1, 1.01, 1], 0.0)
    normals, albedo = robust(light[:, None, None], lights)
    expected = np.linalg.lstsq(lights[:6], light[:6])[0]
    assert np.abs(normals[0, 0] * albedo[0, 0] - expected).max() < 1e-5


def test_seven_lights_with_gloss_are_better_than_least_squares():
    lights = ring(7)
    stack, normals, mask = sphere(lights, gloss=0.3, noise=0.002)
    plain = error_deg(lambertian(stack, lights, mask)[0], normals, mask).mean()
    assert error_deg(robust(stack, lights, mask)[0], normals, mask).mean() < 0.8 * plain


def test_clean_pixels_keep_the_least_squares_fit():
    lights = ring()
    stack, normals, mask = sphere(lights, noise=0.001)
    lit = mask & ((normals @ lights.T).min(axis=-1) > 0.2)
    plain, albedo = lambertian(stack, lights, lit)
    kept, kept_albedo = robust(stack, lights, lit)
    assert np.abs(kept - plain)[lit].max() < 1e-5
    assert np.abs(kept_albedo - albedo)[lit].max() < 1e-5


def test_a_pixel_with_two_lit_lights_stays_finite():
    stack = np.zeros((5, 1, 2), dtype=np.float32)
    stack[:2, 0, 0] = [0.4, 0.3]
    normals, albedo = robust(stack, ring(5))
    assert np.isfinite(normals).all()
    assert np.isfinite(albedo).all()
    assert np.allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-4)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_units_of_images_and_lights_do_not_matter(scale):
    lights = ring(9)
    stack, _, mask = sphere(lights, gloss=0.3, noise=0.002)
    normals, albedo = robust(stack, lights, mask)
    by_image, image_albedo = robust(stack * np.float32(scale), lights, mask)
    by_light, light_albedo = robust(stack, lights * scale, mask)
    for rescaled in (by_image, by_light):
        assert np.mean(error_deg(rescaled, normals, mask)) < 0.02
    assert np.allclose(image_albedo[mask] / scale, albedo[mask], rtol=1e-2)
    assert np.allclose(light_albedo[mask] * scale, albedo[mask], rtol=1e-2)


def test_bytes_do_not_depend_on_the_chunks(monkeypatch):
    lights = ring(9)
    stack, _, mask = sphere(lights, gloss=0.3, noise=0.002)
    first = robust(stack, lights, mask)[0].tobytes()
    monkeypatch.setattr(chunks.os, "cpu_count", lambda: 1)
    assert robust(stack, lights, mask)[0].tobytes() == first
    monkeypatch.setattr(chunks, "_pixels_per_chunk", lambda lights: 700)
    assert robust(stack, lights, mask)[0].tobytes() == first


@pytest.mark.parametrize(
    ("stack", "lights", "message"),
    [
        (np.ones((3, 2, 2)), [[1, 0, 1], [0, 0, 1], [-1, 0, 1.0]], "coplanar"),
        (np.ones((7, 2, 2)), ring(6), "6 lights for 7 images"),
        (np.ones((2, 2, 2)), ring(3)[:2], "stack must hold at least 3"),
    ],
)
def test_bad_input_is_refused(stack, lights, message):
    with pytest.raises(BadInput, match=message):
        robust(stack, lights)
