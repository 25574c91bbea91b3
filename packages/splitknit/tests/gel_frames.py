"""Frames of a gel sensor with three coloured lights, rendered from a height, and a shading that was fitted to balls.

The coat is Lambertian under three distant lights with crosstalk between the colours; nothing of the estimate is used.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE = (120, 160)
PITCH_MM = 0.12
_AZIMUTHS = np.deg2rad([90.0, 210.0, 330.0])
_LIGHTS = np.stack([0.8 * np.cos(_AZIMUTHS), 0.8 * np.sin(_AZIMUTHS), np.full(3, 0.6)], axis=1)
_CROSSTALK = np.array([[1.0, 0.1, 0.02], [0.15, 1.0, 0.2], [0.03, 0.2, 1.0]])

Array = NDArray[np.float64]


def places(size: tuple[int, int] = SIZE) -> tuple[Array, Array]:
    y, x = np.mgrid[: size[0], : size[1]].astype(np.float64)
    return x, y


def cap(x: float, y: float, radius: float, contact: float, size: tuple[int, int] = SIZE) -> Array:
    """Height (H, W) in pixels of a ball pressed in until its outline is `contact` wide; slopes end there."""
    across, down = places(size)
    square = (across - x) ** 2 + (down - y) ** 2
    return np.maximum(np.sqrt(np.maximum(radius**2 - square, 0.0)) - np.sqrt(radius**2 - contact**2), 0.0)


def dots(step: float, diameter: float, offset: float = 0.0, size: tuple[int, int] = SIZE) -> NDArray[np.bool_]:
    x, y = ((axis - offset + step / 2) % step - step / 2 for axis in places(size))
    return np.hypot(x, y) < diameter / 2


def shaded(height: Array) -> tuple[Array, Array]:
    """Light (3, H, W), 1 where flat, and dz/dx, dz/dy (2, H, W) of a height in pixels."""
    down, across = np.gradient(height)
    normal = np.stack([-across, down, np.ones_like(across)]) / np.sqrt(1 + across**2 + down**2)
    lit = np.einsum("lk,khw->lhw", _LIGHTS / 0.6, normal)
    return np.einsum("cl,lhw->chw", _CROSSTALK / _CROSSTALK.sum(axis=1, keepdims=True), lit), np.stack([across, -down])


def frame(height: Array, marks: NDArray[np.bool_] | None = None, noise: float = 0.003) -> NDArray[np.uint8]:
    """(H, W, 3) uint8, linear, of a height in pixels; `marks` are printed dots. The light falls off over the field."""
    rows, columns = height.shape
    x, y = places(height.shape)
    field = 0.35 + 0.1 * np.stack([np.cos(a) * (x / columns - 0.5) - np.sin(a) * (y / rows - 0.5) for a in _AZIMUTHS])
    light = field * shaded(height)[0]
    if marks is not None:
        light *= np.where(marks, 0.2, 1.0)
    light = np.stack([cv2.GaussianBlur(one, (0, 0), 0.7) for one in light])
    light += np.random.default_rng(1).normal(0.0, noise, light.shape)
    return np.ascontiguousarray(np.moveaxis(np.rint(255 * np.clip(light, 0, 1)), 0, 2).astype(np.uint8))


def shading(size: tuple[int, int] = SIZE):
    """A :class:`splitknit.photometric.shading.Shading` of this sensor: a cubic, fitted to one ball's slopes."""
    from splitknit.photometric.shading import Shading

    light, slopes = shaded(cap(60, 60, 60, 48, (121, 121)))
    x, y = places((121, 121))
    inside = np.hypot(x - 60, y - 60) < 46
    light += np.random.default_rng(0).normal(0.0, 0.01, light.shape)  # else three images of two slopes leave one free
    v = np.sqrt(np.maximum(light[:, inside], 0.0)) - 1.0
    v, slopes = (np.concatenate([one, np.zeros((len(one), 6000))], axis=1) for one in (v, slopes[:, inside]))  # a plane
    terms = [np.ones_like(v[0]), *v, *(v[i] * v[j] for i in range(3) for j in range(i, 3))]
    terms += [v[i] * v[j] * v[k] for i in range(3) for j in range(i, 3) for k in range(j, 3)]
    weights = np.linalg.lstsq(np.array(terms).T, slopes.T, rcond=None)[0]
    return Shading(
        pitch_mm=PITCH_MM * SIZE[1] / size[1],
        image_size=size,
        direction=_LIGHTS,
        nearness=np.zeros(3),
        ambient=np.zeros(3),
        fall_off=np.zeros((3, 15)),
        relative=False,
        degree=3,
        weights=weights,
        covariance=np.zeros((20, 20)),
        deviation=np.full(4, 0.01),
        max_slope=1.2,
        height_mm_per_slope=0.1,
    )
