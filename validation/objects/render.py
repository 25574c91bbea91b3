"""Rendered objects under distant lights, with their truth: photographs that the estimate's code has
no part in.

Heights are analytic; light is a cosine times the albedo, a little Blinn-Phong gloss, attached and
cast shadows, two samples a pixel and axis, the lens's blur, shot and read noise, and the steps of 8
or 16 bits. FAULTS spoil one photograph as a stand, a focus ring or an exposure time would.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SHAPES = ("ball", "vase", "bumps", "relief", "stone", "dish")
PX_PER_MM = 16.0
PITCH_MM = 1 / (2 * PX_PER_MM)
"""Of the heights: two of them a pixel and axis."""


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """What was photographed, and under what."""

    images: NDArray[np.uint16]
    """(L, H, W) linear, full scale 65535."""
    lights: Array
    """(L, 3) unit vectors."""
    intensities: Array
    mask: NDArray[np.bool_]
    height_mm: Array
    normals: Array
    px_per_mm: float = PX_PER_MM


def height_of(shape: str, side: int, rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
    """Height in mm and mask (2 side, 2 side) of one of SHAPES, y up."""
    axis = (np.arange(2 * side) + 0.5) / (2 * PX_PER_MM)
    half = axis[-1] / 2
    x, y = np.meshgrid(axis - half, half - axis)
    radius = np.hypot(x, y)
    reach = 0.86 * half
    if shape == "ball":
        inside = radius < reach
        height = np.sqrt(np.maximum(1.25 * reach**2 - radius**2, 0.01))
        bumps = 0.05 * (np.sin(2 * np.pi * x / 2.4) * np.sin(2 * np.pi * y / 2.4))
        height += bumps + 0.03 * np.sin(2 * np.pi * (x + 0.3 * y) / 1.0) * (y > 0)
    elif shape == "vase":
        width = reach * (0.55 + 0.18 * np.sin(1.6 * y / half + rng.uniform(0, 6)))
        inside = (np.abs(x) < 0.92 * width) & (np.abs(y) < reach)
        height = np.sqrt(np.maximum(width**2 - x**2, 0.01)) + 0.04 * np.sin(2 * np.pi * y / 1.3)
    elif shape == "bumps":
        inside = (np.abs(x) < reach) & (np.abs(y) < reach)
        height = 0.28 * np.cos(2 * np.pi * x / 3.1) * np.cos(2 * np.pi * y / 2.7)
    elif shape == "relief":
        inside = radius < reach
        noise = cv2.GaussianBlur(rng.standard_normal(x.shape), (0, 0), 9)
        height = 0.12 * np.tanh(2 * noise / noise.std()) + 0.02 * x
    elif shape == "stone":
        rough = sum(s * _smooth(rng, x.shape, 2 * PX_PER_MM * s) for s in (2.0, 0.8, 0.3))
        inside = radius < reach * (0.85 + 0.1 * np.sin(3 * np.arctan2(y, x)))
        height = 0.75 * np.sqrt(np.maximum(1.3 * reach**2 - radius**2, 0.01)) + 0.1 * rough
    else:
        inside = radius < reach
        height = 0.05 * radius**2 - 0.15 * np.exp(-(((radius - 0.5 * reach) / 0.5) ** 2))
    return height, inside


def _smooth(rng: np.random.Generator, shape: tuple[int, ...], sigma: float) -> Array:
    field = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), sigma)
    return field / field.std()


def rendered(
    seed: int, *, shape: str | None = None, lights: int = 8, side: int = 220, strengths: float = 0.0
) -> Rendered:
    """One object; `strengths`: spread of the lights' brightness, 0: all are equal."""
    rng = np.random.default_rng(seed)
    shape = shape or SHAPES[seed % len(SHAPES)]
    height, inside = height_of(shape, side, rng)
    normals = normals_of(height)
    slant = np.deg2rad(rng.uniform(25, 50) + rng.uniform(-6, 6, lights))
    azimuth = 2 * np.pi * (
        np.arange(lights) + rng.uniform(-0.2, 0.2, lights)
    ) / lights + rng.uniform(0, 6)
    units = np.column_stack(
        [np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.cos(slant)]
    )
    albedo = 0.6 * np.ones_like(height)
    if rng.random() < 0.6:
        albedo *= np.exp(rng.uniform(0.03, 0.3) * _smooth(rng, height.shape, rng.uniform(3, 25)))
    gloss, shine = (
        (rng.uniform(0.02, 0.15), rng.uniform(8, 40)) if rng.random() < 0.5 else (0.0, 1.0)
    )
    bits, noise = (8, 0.004) if rng.random() < 0.5 else (16, rng.uniform(0.001, 0.006))
    intensity = np.exp(strengths * rng.standard_normal(lights)) if strengths else np.ones(lights)
    images = []
    for unit, strength in zip(units, intensity, strict=True):
        cosine = np.maximum(normals @ unit, 0.0)
        middle = unit + np.array([0, 0, 1])
        light = (
            albedo * cosine
            + gloss * np.maximum(normals @ (middle / np.linalg.norm(middle)), 0.0) ** shine
        )
        light *= _lit(height, inside, unit)
        light = np.where(inside, light, 0.05 * unit[2])
        light = cv2.GaussianBlur(light, (0, 0), 1.2)
        images.append(strength * _halved(light))
    stack = np.stack(images)
    stack *= 0.8 / np.quantile(stack, 0.999)
    stack += rng.standard_normal(stack.shape) * noise * np.sqrt(np.maximum(stack, 0.02))
    top = 2**bits - 1
    stored = np.rint(np.clip(np.rint(stack * top) / top, 0, 1) * 65535).astype(np.uint16)
    return Rendered(stored, units, intensity, *truth_of(height, inside, normals))


def normals_of(height: Array) -> Array:
    """(2 side, 2 side, 3) of a height, y up."""
    dy, dx = np.gradient(height, PITCH_MM)
    normals = np.dstack([-dx, dy, np.ones_like(height)])
    return normals / np.linalg.norm(normals, axis=2, keepdims=True)


def truth_of(
    height: Array, inside: NDArray[np.bool_], normals: Array
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Mask, height and normals on the camera's pixels."""
    normals = _halved(normals)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return _halved(inside.astype(np.float32)) > 0.99, height[::2, ::2], normals


def _halved(image: Array) -> Array:
    size = image.shape[1] // 2, image.shape[0] // 2
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def _lit(height: Array, inside: NDArray[np.bool_], unit: Array) -> Array:
    """Where no part of the object stands before the light: a march of shifted copies."""
    # OpenCV 4.13 shifts float64 the other way
    heights = np.where(inside, height, -1e3).astype(np.float32)
    shadow = np.zeros(height.shape, bool)
    across = np.hypot(unit[0], unit[1])
    rise = unit[2] / across * PITCH_MM
    for step in range(2, int((height[inside].max() - height[inside].min()) / rise) + 2, 2):
        move = np.float32([[1, 0, -step * unit[0] / across], [0, 1, step * unit[1] / across]])
        caster = cv2.warpAffine(
            heights, move, height.shape[::-1], flags=cv2.INTER_NEAREST, borderValue=-1e3
        )
        shadow |= caster > height + step * rise
    return 1.0 - cv2.GaussianBlur(shadow.astype(np.float64), (0, 0), 1.0)


FAULTS = ("blurred", "moved", "double", "overexposed", "underexposed")


def spoilt(
    images: NDArray[np.uint16], k: int, fault: str, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """The photographs, of which one is spoilt."""
    result = images.copy()
    image = images[k].astype(np.float32)
    angle = rng.uniform(0, 2 * np.pi)
    move = np.float32([[1, 0, 4 * np.cos(angle)], [0, 1, 4 * np.sin(angle)]])
    if fault == "blurred":
        image = cv2.GaussianBlur(image, (0, 0), 3.0)
    elif fault in ("moved", "double"):
        moved = cv2.warpAffine(image, move, image.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
        image = moved if fault == "moved" else 0.5 * (image + moved)
    elif fault == "overexposed":
        image = np.minimum(2.2 * image, 65535.0)
    else:
        image = np.rint(image / 20 / 257) * 257 + 0.0
    result[k] = np.rint(image).astype(np.uint16)
    return result
