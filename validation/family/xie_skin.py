"""Two-layer skin painted by the book, for tests of its inversion: vectors, angles and amplitudes, no code of the fit's.

P. Hanrahan and W. Krueger, "Reflection from layered surfaces due to subsurface scattering", SIGGRAPH 1993.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Skin:
    """Layers of one finger: what is the same everywhere, and how much the rest differs from place to place."""

    index: float = 1.4
    upper_g: float = 0.79
    lower_g: float = 0.81
    lower_share: float = 21.7 / 22.0
    base: float = 0.45
    fraction: float = 50.0 / 53.8
    depth: float = 0.08 * 53.8
    share_spread: float = 1.0
    """Standard deviation of the logit of the upper layer's scattering fraction."""
    depth_spread: float = 0.7
    """Standard deviation of the logarithm of its depth."""
    patch_mm: float = 0.5
    """Size of the places that differ."""


def layers(skin: Skin, shape: tuple[int, int], px_per_mm: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Scattering fraction and depth of the upper layer at every pixel."""
    fields = []
    for _ in range(2):
        field = cv2.GaussianBlur(rng.normal(size=shape), (0, 0), skin.patch_mm * px_per_mm)
        fields.append(field / field.std())
    logit = np.log(skin.fraction / (1 - skin.fraction)) + skin.share_spread * fields[0]
    return 1 / (1 + np.exp(-logit)), skin.depth * np.exp(skin.depth_spread * fields[1])


def paint(normals: Array, lights: Array, skin: Skin, fraction: Array, depth: Array) -> Array:
    """Images (L, H, W) of reflectance: 1 is a white card that faces a light of strength one."""
    view = np.array([0.0, 0.0, 1.0])
    view_angle = np.arccos(np.clip(normals @ view, 1e-3, 1))
    out = _bent(view, normals, skin.index)
    images = []
    for light in lights:
        strength = np.linalg.norm(light)
        cosine = normals @ (light / strength)
        angle = np.arccos(np.clip(cosine, 1e-3, 1))
        into = _bent(light / strength, normals, skin.index)
        turn = np.pi - np.arccos(np.clip((into * out).sum(axis=-1), -1, 1))
        c_in, c_out = (into * normals).sum(axis=-1), (out * normals).sum(axis=-1)
        lost = np.exp(-depth / c_in - depth / c_out)
        once = fraction * _phase(turn, skin.upper_g) * (1 - lost) + skin.lower_share * _phase(turn, skin.lower_g) * lost
        once = once * np.pi / (c_in + c_out) / skin.index**2
        passed = _passed(angle, skin.index) * _passed(view_angle, skin.index) / _passed(np.array(1e-4), skin.index) ** 2
        images.append(np.where(cosine > 0, strength * cosine * passed * (skin.base + once), 0.0))
    return np.stack(images)


def _bent(direction: Array, normals: Array, index: float) -> Array:
    """Unit vectors inside, towards where the ray comes from."""
    along = (normals @ direction)[..., None] * normals
    sideways = (direction - along) / index
    return sideways + np.sqrt(1 - (sideways**2).sum(axis=-1, keepdims=True)) * normals


def _phase(angle: Array, g: float) -> Array:
    """Henyey and Greenstein, per steradian."""
    return (1 - g**2) / (1 + g**2 - 2 * g * np.cos(angle)) ** 1.5 / (4 * np.pi)


def _passed(angle: Array, index: float) -> Array:
    """Fresnel: 1 minus the mean of the squared sine and tangent laws, which say 0 / 0 straight down."""
    angle = np.maximum(angle, 1e-4)
    inside = np.arcsin(np.sin(angle) / index)
    across = np.sin(angle - inside) / np.sin(angle + inside)
    along = np.tan(angle - inside) / np.tan(angle + inside)
    return 1 - (across**2 + along**2) / 2
