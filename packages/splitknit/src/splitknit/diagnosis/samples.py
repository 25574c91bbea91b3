"""A sample of the photographs' pixels, enough to check them against their lights."""

from __future__ import annotations

from typing import Any

import numpy as np

from splitknit.checks import check_lights, check_mask, check_stack
from splitknit.imaging.pixels import Window
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.light import Light

LEAST_PHOTOGRAPHS = 4
"""Photographs that are left at least: with one less, nothing shows which does not fit."""


def sampled_light(light: Light) -> tuple[FloatArray, Array, Window]:
    """Grey linear light (L, h, w) at some pixels, its lights (L, 3), and which pixels these are."""
    # images of at least so many pixels a side are enough to detect in which frame the lights were
    # measured
    every = max(1, max(light.shape) // 300)
    lights = light.rig.light_vectors()
    some = (slice(None, None, every), slice(None, None, every))
    return light.sampled(every).grey, lights, some


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
