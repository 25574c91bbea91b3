"""The shots of another band, brought onto a finger whose surface one band has shown.

Under near-infrared light skin hardly shows its ridges: what is seen of them is mirrored at the surface, and that looks
the same in both bands. So each shot is compared with what the first band's surface and glare, both taken as one matt
surface, would look like under its light, and with the finger's outline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.check import check_mask, check_stack, require
from splitknit.preprocess.regions import dilate, erode
from splitknit.preprocess.registration import RegistrationSettings
from splitknit.preprocess.registration_flow import Array, Family, Flow, finger_family, places_of, still
from splitknit.preprocess.registration_level import Level, aligned, details_of, in_blocks, robust_root, slopes_of
from splitknit.types import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A band whose shots are registered: what the others are compared with."""

    stack: FloatArray
    """(K, H, W) grey, linear."""
    lights: NDArray[np.float64]
    """(K, 3)"""
    flow: Flow
    shots: NDArray[np.intp]
    """(K,) shot of every image."""


@dataclass(frozen=True, slots=True, eq=False)
class BandRegistration:
    """Where the skin lies in every shot of another band."""

    flow: Flow
    likeness: NDArray[np.float64]
    """(L,) correlation of each shot's details with the expected ones, with the motion undone."""
    likeness_before: NDArray[np.float64]
    """(L,) the same as they are."""


def register_band(  # noqa: PLR0917
    seen: Seen,
    stack: FloatArray,
    lights: NDArray[np.float64],
    mask: BoolArray,
    px_per_mm: float,
    settings: RegistrationSettings | None = None,
) -> BandRegistration:
    """Find where the skin that `seen` shows lies in every image of another band.

    Parameters
    ----------
    seen : the registered band
    stack : (L, H, W) float32 linear grey of the other band, each image a shot
    lights : (L, 3) towards the light
    mask : (H, W) bool
    px_per_mm : float
    settings : RegistrationSettings, optional

    Raises
    ------
    BadInput
        If the two bands' images differ in size, or lights and images in number.
    """
    settings = settings or RegistrationSettings()
    stack = check_stack(stack)
    mask = check_mask(mask, (stack.shape[1], stack.shape[2]))
    require(seen.stack.shape[1:] == stack.shape[1:], "the images of both bands must have one size.")
    lights = np.asarray(lights, dtype=np.float64)
    require(lights.shape == (len(stack), 3), f"lights must have the shape ({len(stack)}, 3), not {lights.shape}.")
    shares = lights @ np.linalg.pinv(seen.lights)  # (L, K) of the first band's images in what is expected
    around, skin = dilate(mask, settings.surround_mm * px_per_mm), erode(mask, settings.rim_mm * px_per_mm)
    flow = unmoved = still(len(stack), (mask.shape[0], mask.shape[1]), px_per_mm)
    each = np.arange(len(stack))
    for step, sigma in enumerate((*settings.coarse_mm, *settings.fine_mm)):
        region = skin if step >= len(settings.coarse_mm) and skin.any() else around
        band = (sigma, settings.band_ratio * sigma)
        level = details_of(stack, region, px_per_mm, band, settings.resolution)
        known = details_of(seen.stack, region, px_per_mm, band, settings.resolution)
        expected = np.einsum("lk,khw->lhw", shares.astype(np.float32), aligned(known, seen.flow, seen.shots))
        flow = _followed(level, expected, flow, finger_family(mask, px_per_mm, turns=step > 0), settings.iterations)
    found = (aligned(level, f, each) for f in (flow, unmoved))
    likeness, before = (_likeness(level, expected, images) for images in found)
    return BandRegistration(flow, likeness, before)


def _followed(level: Level, expected: FloatArray, flow: Flow, family: Family, iterations: int) -> Flow:
    """Move every shot, by itself, towards the details that are expected of it, whatever their strength."""
    basis, at_nodes = family.basis(*level.centres()), family.basis(*places_of(flow))
    nodes = flow.nodes_mm.copy()
    most = 1.0 / level.px_per_mm
    each = np.arange(len(nodes))
    for _ in range(iterations):
        images = aligned(level, Flow(nodes), each)
        steps = [_step(level, expected[k], images[k], basis) for k in each]
        moved = np.einsum("km,ncm->kcn", np.clip(steps, -most, most), at_nodes).reshape(nodes.shape)
        nodes += moved
        if float(np.abs(moved).max()) < 5e-4:
            break
    return Flow(nodes)


def _step(level: Level, expected: FloatArray, image: FloatArray, basis: Array) -> Array:
    """(M,) change of one shot's parameters."""
    weight = level.weight
    gain = _gain(weight, expected, image)
    left = image - np.float32(gain) * expected
    root = robust_root(level, np.sqrt(left * left * weight))
    slopes = slopes_of(level, image[None])[0] * root
    columns = in_blocks(np.concatenate([slopes, (expected * root)[None]]), level.block).astype(np.float64)
    error = in_blocks((left * root)[None], level.block)[:, 0].astype(np.float64)
    shifts = np.einsum("bcp,bcm->bpm", columns[:, :2], basis)
    design = np.concatenate([shifts, -columns[:, 2][..., None]], axis=2)
    design = design.reshape(-1, design.shape[2])
    normal = np.einsum("ni,nj->ij", design, design)
    normal += np.diag(1e-6 * np.diag(normal) + 1e-30)
    return np.asarray(-np.linalg.solve(normal, np.einsum("ni,n->i", design, error.ravel()))[:-1])


def _gain(weight: FloatArray, expected: FloatArray, image: FloatArray) -> float:
    power = float((expected * expected * weight).sum(dtype=np.float64))
    return float((expected * image * weight).sum(dtype=np.float64)) / max(power, 1e-30)


def _likeness(level: Level, expected: FloatArray, images: FloatArray) -> NDArray[np.float64]:
    def total(a: FloatArray, b: FloatArray) -> Array:
        return np.asarray((a * b * level.weight).sum(axis=(1, 2), dtype=np.float64))

    return np.asarray(
        total(images, expected) / np.sqrt(np.maximum(total(images, images) * total(expected, expected), 1e-30))
    )
