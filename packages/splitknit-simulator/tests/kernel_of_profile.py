"""A profile of diffuse light in space: what its transform, which the simulator uses, is tested
against."""

from __future__ import annotations

import numpy as np

from splitknit.model import FloatArray
from splitknit_simulator.light.skin import Profile


def kernel(profile: Profile, pitch_mm: float, radius_mm: float) -> FloatArray:
    """(2n + 1, 2n + 1) fraction of the light that leaves within each pixel, area-sampled; the sum
    is the albedo.

    Light that leaves beyond the kernel is spread over the kernel in proportion. Each pixel is
    averaged over its area on a grid of sub-pixels, exactly in the ring that holds the centre.
    """
    n = int(np.ceil(radius_mm / pitch_mm))
    cumulative = np.concatenate([[0.0], np.cumsum(profile.weights)])
    squared = profile.radii_mm**2
    fine = 8
    offset = ((np.arange((2 * n + 1) * fine) + 0.5) / fine - n - 0.5) * pitch_mm
    result = np.zeros((2 * n + 1, 2 * n + 1))
    density = np.diff(cumulative) / (np.pi * np.diff(squared))
    for row in range(2 * n + 1):
        rr = offset[row * fine : (row + 1) * fine, None] ** 2 + offset[None, :] ** 2
        ring = np.clip(np.searchsorted(squared, rr, side="right") - 1, 0, density.size - 1)
        result[row] = density[ring].reshape(fine, 2 * n + 1, fine).mean(axis=(0, 2)) * pitch_mm**2
    result[n, n] = _centre(profile, pitch_mm)
    return (result * (profile.albedo / float(np.sum(result)))).astype(np.float32)


def _centre(profile: Profile, pitch_mm: float) -> float:
    """Light that leaves within the central pixel: a disc, exactly, and the corners by their
    angle."""
    inner, outer = 0.5 * pitch_mm, 0.5 * np.sqrt(2.0) * pitch_mm
    cumulative = np.concatenate([[0.0], np.cumsum(profile.weights)])
    edges = np.linspace(inner, outer, 201)
    squared = profile.radii_mm**2
    light = np.diff(np.interp(edges**2, squared, cumulative))
    middle = 0.5 * (edges[1:] + edges[:-1])
    inside = 1.0 - 4.0 * np.arccos(inner / middle) / np.pi
    return float(
        np.interp(inner**2, squared, cumulative) + np.sum(light * np.clip(inside, 0.0, 1.0))
    )
