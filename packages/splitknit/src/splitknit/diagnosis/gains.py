"""Brightness of each photograph's light, relative to the stated one."""

from __future__ import annotations

from typing import Any

import numpy as np

from splitknit.checks import check_lights, check_mask, check_stack
from splitknit.imaging.robust import cauchy
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.photometric.equations import PAIRS, back_substitute, factorise

LEAST_PHOTOGRAPHS = 4
"""Min number of photographs that are kept: with fewer, no photograph can be checked against the
others."""
GAINS_PIXELS = 8_000
"""Pixels of the object that gains and derivatives are fitted to, in px. Chosen on: speed."""


def light_gains(stack: Any, lights: Any, mask: Any = None, ceilings: Any = None) -> Array:
    """Brightness (L,) of each photograph's light over what `lights` promise, one in the geometric
    mean.

    Minimises sum |I_k / a_k - l_k . g|^2 over the surface's g at every pixel and the gains a: with
    the surface eliminated, 1 / a is the eigenvector of the smallest eigenvalue of an L x L matrix.
    Lights in shadow and clipped values are left out, gloss loses weight. Ones where four lights or
    more do not reach enough pixels.

    Source: G. Golub and V. Pereyra, "Separable nonlinear least squares: the variable projection
    method", Inverse Problems 19 (2003). Parameters as of :func:`faulty_photographs`.

    >>> across = [[0.6, 0.0, 0.8], [-0.6, 0.0, 0.8]]
    >>> lights = np.array([[0.0, 0.6, 0.8], *across, [0.0, -0.6, 0.8], [0.0, 0.0, 1.0]])
    >>> y, x = np.mgrid[-9:10, -9:10] / 24.0
    >>> stack = np.einsum("ki,yxi->kyx", lights, np.dstack([x, y, np.sqrt(1 - x**2 - y**2)]))
    >>> stack *= np.array([1, 2, 1, 1, 0.5])[:, None, None]
    >>> np.round(light_gains(stack, lights), 2).tolist()
    [1.0, 2.0, 1.0, 1.0, 0.5]
    """
    images, vectors, inside, levels = checked(stack, lights, mask, ceilings)
    light = images[:, inside]
    light = light[:, :: max(1, light.shape[1] // GAINS_PIXELS)]
    values = light.astype(np.float64)
    gains = np.maximum(np.quantile(values, 0.9, axis=1) / np.linalg.norm(vectors, axis=1), 1e-9)
    gains /= np.exp(np.log(gains).mean())
    products = np.stack([vectors[:, i] * vectors[:, j] for i, j in PAIRS])
    ones = np.ones(light.shape[1])
    for _ in range(12):
        lit = lit_values(light, vectors * gains[:, None], levels)
        lit &= lit.sum(axis=0) >= LEAST_PHOTOGRAPHS
        if lit.any(axis=0).sum() < 100 or not lit.any(axis=1).all():
            return np.ones(len(light))
        equal = values / gains[:, None]
        equal /= np.maximum(equal.mean(axis=0), 1e-12)
        weights = lit.astype(np.float64)
        g = back_substitute(factorise(products @ weights), vectors.T @ (weights * equal))
        residual = equal - vectors @ g
        weights = lit * cauchy(residual, max(3.0 * float(np.median(np.abs(residual[lit]))), 1e-6))
        factors = factorise(products @ weights)
        weighted = weights * equal
        power = np.diag((weighted * equal).sum(axis=1))
        pulls = [back_substitute(factors, towards[:, None] * ones) for towards in vectors]
        explained = [
            (weighted * (vectors @ pull)) @ image
            for pull, image in zip(pulls, weighted, strict=True)
        ]
        root = 1.0 / np.sqrt(np.diag(power))
        inverse = (
            np.linalg.eigh(root[:, None] * (power - np.stack(explained)) * root)[1][:, 0] * root
        )
        step = np.clip(np.abs(inverse) / np.abs(inverse).max(), 1e-3, None)
        gains /= step
        gains /= np.exp(np.log(gains).mean())
        if np.ptp(np.log(step)) < 1e-4:
            break
    return np.asarray(gains)


def median_angle_deg(normals: FloatArray, changed: FloatArray) -> float:
    """Median angle between unit normals (n, 3)."""
    cosine = np.median((normals * changed).sum(axis=1))
    return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))


def checked(
    stack: Any, lights: Any, mask: Any, ceilings: Any
) -> tuple[FloatArray, Array, BoolArray, FloatArray]:
    """Images (L, H, W), lights (L, 3), the object (H, W), and the value from which each image is
    clipped (L,)."""
    images = check_stack(stack, least=3)
    inside = check_mask(mask, (images.shape[1], images.shape[2]))
    levels = np.broadcast_to(
        np.float32(np.inf if ceilings is None else ceilings), (len(images),)
    ).astype(np.float32)
    return images, check_lights(lights, len(images)), inside, levels


def lit_values(light: FloatArray, lights: FloatArray, ceilings: FloatArray) -> BoolArray:
    """(L, n) where a light reaches a pixel, and its value is not clipped."""
    relative = light / np.linalg.norm(lights, axis=1).astype(np.float32)[:, None]
    usable = light < ceilings[:, None]
    peak = np.max(relative, axis=0, where=usable, initial=1e-20)
    # a light is in shadow where its image is below this part of the brightest one's
    return np.asarray((relative > 0.1 * peak) & usable)
