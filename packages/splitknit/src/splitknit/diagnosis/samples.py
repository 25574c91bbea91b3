"""A sample of the photographs' pixels, enough to check them against their lights."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.pixels import Window, bin_mean
from splitknit.imaging.view import View, view_of
from splitknit.integration.poisson import poisson
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.light import Light
from splitknit.photometric.equations import length
from splitknit.photometric.near_light import pseudo_normals


class Blocks(NamedTuple):
    """A band's light in blocks of pixels."""

    light: Light
    inside: BoolArray
    """(h, w) blocks that lie inside a mask."""
    view: View

    def lights(self, height_mm: FloatArray) -> FloatArray:
        """Light vectors (L, 3, h, w) on a surface, in the pixels' own frames."""
        return self.view.turned(light_vectors_at(self.light.rig, *self.view.points(height_mm)))


SKIN_MM = 1.0  # mean height of the skin above the finger plane, about
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


def in_blocks(band: Light, mask: BoolArray, window: Window, step: int) -> Blocks:
    """The light of a window in blocks of `step` pixels a side, and which lie inside a mask."""
    inside = bin_mean(mask[window].astype(np.float32), step) > 0.99
    view = view_of(band.built.camera, *window, binning=step, along_rays=True)
    return Blocks(band.at(step, window), inside, view)


def coarse_surface(stack: FloatArray, blocks: Blocks) -> FloatArray:
    """Height (h, w) in mm by near-light photometric stereo of a matt thing."""
    light, inside, view = blocks
    height_mm = np.full(inside.shape, SKIN_MM, dtype=np.float32)
    for _ in range(2):
        g = np.moveaxis(pseudo_normals(stack, light.rig, height_mm, inside, view=view), -1, 0)
        p, q = -g[:2] / np.maximum(g[2], 0.15 * length(g) + 1e-9)
        height_mm = np.nan_to_num(poisson(p, q, inside) * light.pitch_mm) + np.float32(SKIN_MM)
    return height_mm


def median_angle_deg(normals: FloatArray, changed: FloatArray) -> float:
    """Median angle between unit normals (n, 3)."""
    cosine = np.median((normals * changed).sum(axis=1))
    return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
