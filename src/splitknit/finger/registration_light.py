"""What surfaces may show under lights that differ from place to place."""

from __future__ import annotations

import numpy as np

from splitknit.errors import require
from splitknit.finger.registration_flow import Array
from splitknit.finger.registration_level import Level, at_samples
from splitknit.model import FloatArray


def check_light_vectors(lights: Array, count: int) -> None:
    """Refuse light vectors that are neither (L, 3) nor (L, 3, h, w)."""
    fits = lights.shape[:2] == (count, 3) and lights.ndim in (2, 4)
    require(fits, f"lights must have the shape ({count}, 3) or ({count}, 3, h, w), but they have {lights.shape}.")


def lights_on(lights: Array, level: Level, shape: tuple[int, ...], px_per_mm: float) -> FloatArray:
    """(L, 3, N) light vectors at the pixels of a level of images of `shape`; (L, 3, 1) where all have the same."""
    if lights.ndim == 2:
        return lights[..., None].astype(np.float32)
    return at_samples(lights.astype(np.float32), level, ((shape[1] - 1) / px_per_mm, (shape[0] - 1) / px_per_mm))


def shown_by_surfaces(lights: FloatArray) -> FloatArray:
    """Orthonormal brightnesses (L, 3, N) that span what matt surfaces may show under `lights` (L, 3, N)."""
    axes = lights.astype(np.float64)
    for k in range(3):
        for other in range(k):
            axes[:, k] -= (axes[:, k] * axes[:, other]).sum(axis=0) * axes[:, other]
        axes[:, k] /= np.maximum(np.sqrt((axes[:, k] ** 2).sum(axis=0)), 1e-12)
    return axes.astype(np.float32)


def beyond_surface(images: FloatArray, axes: FloatArray) -> FloatArray:
    """What no matt surface shows of `images` (L, N): without their parts along `axes` (L, 3, N) or (L, 3, 1)."""
    along = (axes * images[:, None]).sum(axis=0)
    return np.asarray(images - (axes * along).sum(axis=1), dtype=np.float32)
