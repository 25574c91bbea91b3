"""The least-squares problem of a pixel of two-layer skin: its equations, and that its minimum is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from skin_ball import EQUAL, THIN, ball, ring
from splitknit.photometric.hanrahan_krueger_fit import Pixels, directions, fitted, reflected


def problem(stack, lights, settings, kind=np.float64):
    images = stack.reshape(len(stack), -1).astype(kind)
    g = (np.linalg.pinv(lights) @ images).astype(kind)
    albedo = np.linalg.norm(g, axis=0)
    unit = (lights / np.linalg.norm(lights, axis=1, keepdims=True)).astype(kind)
    strength = np.linalg.norm(lights, axis=1, keepdims=True).astype(kind)
    exposure = float(np.pi * np.median(albedo) / (settings.base_reflectance * settings.layers.refractive_index**2))
    trust = np.ones_like(images) / (settings.noise * albedo)
    return Pixels(images, trust, unit[..., None], strength, albedo, exposure, settings), g


def residuals(theta, pixels, i):
    """The very cost, written plainly for scipy."""
    one, settings = pixels.take(np.array([i])), pixels.settings
    normal, _, _ = directions(theta[:, None])
    fraction, depth = 1 / (1 + np.exp(-theta[3:4])), np.exp(theta[4:5])
    to_light = one.lights[:, :, 0] @ normal
    value = reflected(
        to_light, normal[2], one.lights[:, 2], one.albedo * np.exp(theta[2]), fraction, depth, one.exposure,
        settings.layers,
    ).value  # fmt: skip
    typical = settings.layers.epidermis_fraction
    held = [
        (theta[3] - np.log(typical / (1 - typical))) / settings.spread_share,
        (theta[4] - np.log(settings.layers.epidermis_depth)) / settings.spread_depth,
    ]
    return np.concatenate([((one.strengths * value - one.images) * one.trust)[:, 0], held])


def some_pixels(count=40, settings=None):
    lights = ring() * np.linspace(0.9, 1.1, 7)[:, None]
    settings = settings or replace(EQUAL, layers=THIN, base_reflectance=0.1, noise=0.005)
    stack, _, mask = ball(lights, noise=0.004, reflectance=0.1, edge=0.75)
    chosen = np.random.default_rng(5).choice(np.flatnonzero(mask), count, replace=False)
    return problem(stack.reshape(7, -1)[:, chosen], lights, settings)


def test_normal_equations_are_those_of_the_residuals():
    pixels, g = some_pixels(8)
    theta = pixels.start(g / np.linalg.norm(g, axis=0)) + np.array([0.02, -0.03, 0.05, -0.4, 0.3])[:, None]
    found = pixels.equations(theta)
    for i in range(8):
        columns = []
        for k in range(5):
            step = 1e-6 * np.eye(5)[k]
            two = (residuals(theta[:, i] + step, pixels, i), residuals(theta[:, i] - step, pixels, i))
            columns.append((two[0] - two[1]) / 2e-6)
        jacobian, residual = np.stack(columns, axis=1), residuals(theta[:, i], pixels, i)
        assert found.cost[i] == pytest.approx(residual @ residual, rel=1e-9)
        assert np.allclose(found.gradient[:, i], jacobian.T @ residual, rtol=1e-5, atol=1e-5)
        upper = (jacobian.T @ jacobian)[np.triu_indices(5)]
        assert np.allclose(found.moments[:, i], upper, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_minimum_is_that_of_scipy(kind):
    pixels, g = some_pixels()
    start = pixels.start(g / np.linalg.norm(g, axis=0))
    if kind is np.float32:
        single = Pixels(
            *(getattr(pixels, n).astype(kind) for n in ("images", "trust", "lights", "strengths", "albedo")),
            pixels.exposure, pixels.settings,
        )  # fmt: skip
        normals, minimum = fitted(single, g.astype(kind))
        assert minimum.parameters.dtype == kind
    else:
        normals, minimum = fitted(pixels, g)
    for i in range(start.shape[1]):
        reference = least_squares(residuals, start[:, i], args=(pixels, i), method="lm", xtol=1e-10)
        assert minimum.cost[i] == pytest.approx(2 * reference.cost, rel=2e-3, abs=1e-3)
        wanted = directions(reference.x[:, None])[0][:, 0]
        assert np.degrees(np.arccos(min(float(wanted @ normals[:, i]), 1.0))) < 0.1


@pytest.mark.parametrize("near", [False, True])
def test_some_pixels_are_the_same_problem_as_all(near):
    pixels, g = some_pixels(12)
    if near:
        turned = np.random.default_rng(1).normal(0, 0.05, (7, 3, 12)) + pixels.lights
        strength = np.random.default_rng(2).uniform(0.8, 1.2, (7, 12))
        pixels = replace(pixels, lights=turned / np.linalg.norm(turned, axis=1, keepdims=True), strengths=strength)
    theta = pixels.start(g / np.linalg.norm(g, axis=0))
    kept = np.array([1, 4, 5, 11])
    all_of_them, some = pixels.equations(theta), pixels.take(kept).equations(theta[:, kept])
    assert np.array_equal(some.cost, all_of_them.cost[kept])
    assert np.array_equal(some.gradient, all_of_them.gradient[:, kept])
    assert np.array_equal(some.moments, all_of_them.moments[:, kept])


def test_steps_stay_where_the_model_is_defined():
    pixels, _ = some_pixels(4)
    theta = np.tile(np.array([0.9, 0.0, 0.0, 2.0, 1.0])[:, None], (1, 4))
    step = np.array([[0.2, 50.0, 0.0, 0.1], [0.3, 0.0, 0.0, 0.0], [0, 0, 9, 0], [0, 0, -90, 0], [0, 0, 60, 0]])
    for _ in range(40):
        theta = pixels.moved(theta, step)
        assert directions(theta)[0][2].min() > 0.01
        assert np.abs(theta[2]).max() <= 4 and np.abs(theta[3]).max() <= 9 and theta[4].max() <= 5
    assert np.array_equal(pixels.moved(theta[:, 3:], 0 * step[:, 3:]), theta[:, 3:])
