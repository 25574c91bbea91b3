"""The inputs behind the integrator and photometric-stereo rows of docs/experiments/performance.md,
with known truth.

Axes are the library's: x right, y up against the rows, z towards the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

RIDGE_PERIOD = 33.0
RIDGE_AMPLITUDE = 5.0
FINGER_HEIGHT = 300.0


@dataclass(frozen=True, slots=True, eq=False)
class FingerCase:
    """A quarter ellipsoid that the lower border cuts, under concentric ridges."""

    height: NDArray[np.float64]
    """(H, W) in pixels."""
    ridge: NDArray[np.float64]
    """(H, W) the ridges alone."""
    gradient_x: NDArray[np.float64]
    """(H, W) dz/dx, zero outside the mask."""
    gradient_y: NDArray[np.float64]
    """(H, W) dz/dy, y up, zero outside the mask."""
    mask: NDArray[np.bool_]
    normals: NDArray[np.float64]
    """(H, W, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class ShadowCase:
    """A partly shadowed photometric stack of the finger."""

    stack: NDArray[np.float32]
    """(7, H, W)."""
    lights: NDArray[np.float64]
    normals: NDArray[np.float64]
    mask: NDArray[np.bool_]
    shadowed: NDArray[np.bool_]
    """(H, W) pixels that some light does not reach."""


def finger_case(
    rows: int = 1528, columns: int = 936, noise_deg: float = 0.0, seed: int = 0
) -> FingerCase:
    """Build the finger; `noise_deg` perturbs each component of the normals by that many degrees."""
    i, j = np.mgrid[0:rows, 0:columns].astype(np.float64)
    half_width, half_length = 440.0, 1450.0
    # right and up, from the lower border
    across, along = (j - 467.5) / half_width, (1527.0 - i) / half_length
    square = across**2 + along**2
    dome = np.sqrt(np.clip(1 - square, 1e-3, None))
    mask = square < 0.95**2
    x, y = j - columns * 0.5, rows * 0.45 - i  # from the ridges' centre
    radius = np.hypot(x, y) + 1e-9
    wave = 2 * np.pi / RIDGE_PERIOD
    ridge = RIDGE_AMPLITUDE * np.sin(wave * radius)
    steepness = RIDGE_AMPLITUDE * wave * np.cos(wave * radius) / radius
    gradient_x = -FINGER_HEIGHT * across / half_width / dome + steepness * x
    gradient_y = -FINGER_HEIGHT * along / half_length / dome + steepness * y
    normals = np.dstack([-gradient_x, -gradient_y, np.ones_like(gradient_x)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    if noise_deg:
        normals += np.random.default_rng(seed).normal(0, np.deg2rad(noise_deg), normals.shape)
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        nz = np.clip(normals[..., 2], 0.05, None)
        gradient_x, gradient_y = -normals[..., 0] / nz, -normals[..., 1] / nz
    return FingerCase(
        height=FINGER_HEIGHT * dome + ridge,
        ridge=ridge,
        gradient_x=np.where(mask, gradient_x, 0.0),
        gradient_y=np.where(mask, gradient_y, 0.0),
        mask=mask,
        normals=normals,
    )


def shadow_case(seed: int = 0, rows: int = 1528, columns: int = 936) -> ShadowCase:
    """Seven lights at 55 deg elevation on the finger: attached shadows, noise of 0.003, varying
    albedo."""
    finger = finger_case(rows, columns)
    azimuth = np.deg2rad(np.arange(7) * 360 / 7)
    elevation = np.deg2rad(55.0)
    lights = np.column_stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            -np.sin(azimuth) * np.cos(elevation),
            np.full(7, np.sin(elevation)),
        ]
    )
    shading = finger.normals @ lights.T
    albedo = 0.6 + 0.1 * np.sin(np.arange(columns) / 50.0)
    stack = np.clip(shading, 0, None) * albedo[None, :, None] * finger.mask[..., None]
    stack = np.clip(stack + np.random.default_rng(seed).normal(0, 0.003, stack.shape), 0, None)
    return ShadowCase(
        stack=np.ascontiguousarray(stack.transpose(2, 0, 1), dtype=np.float32),
        lights=lights,
        normals=finger.normals,
        mask=finger.mask,
        shadowed=finger.mask & (shading.min(axis=2) <= 0),
    )
