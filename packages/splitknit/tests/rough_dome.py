"""Photographs of a rough dome under eight lights, and what spoils one of them."""

import cv2
import numpy as np

COUNT = 8


def scene(seed=0, side=110):
    """Photographs (8, H, W) of a matt rough dome with pale and dark patches, its lights and its
    mask."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[1 : -1 : side * 1j, -1 : 1 : side * 1j]
    height = np.sqrt(2.2 - x**2 - y**2) + 0.03 * np.sin(9 * x) * np.sin(8 * y)
    dy, dx = np.gradient(height, 2 / (side - 1))
    normals = np.dstack([-dx, dy, np.ones_like(dx)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    azimuth = 2 * np.pi * (np.arange(COUNT) + rng.uniform(-0.2, 0.2, COUNT)) / COUNT
    lights = np.column_stack([0.6 * np.cos(azimuth), 0.6 * np.sin(azimuth), np.full(COUNT, 0.8)])
    patches = cv2.GaussianBlur(rng.standard_normal((side, side)), (0, 0), 3)
    stack = (0.6 + 0.5 * patches) * np.maximum(np.einsum("ki,yxi->kyx", lights, normals), 0)
    return (
        (stack + rng.normal(0, 0.002, stack.shape)).astype(np.float32),
        lights,
        np.hypot(x, y) < 0.9,
    )


def spoilt(image, kind):
    moved = np.roll(image, (2, 3), (0, 1))
    ways = {
        "moved": moved,
        "double": (image + moved) / 2,
        "blurred": cv2.GaussianBlur(image, (0, 0), 2.5),
        "overexposed": np.minimum(2.2 * image, 0.7),
        "underexposed": image / 20,
        "unlike": np.where(np.arange(image.shape[1]) > 55, image, 0.5 * image),
    }
    return ways[kind]
