"""The shots of another band, brought onto a finger whose surface one band has shown.

Under near-infrared light skin hardly shows its ridges: what is seen of them is mirrored at the surface, and that looks
the same in both bands. So each shot is compared with what the first band's surface and glare, both taken as one matt
surface, would look like under its light, and with the finger's outline.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, check_stack, require
from splitknit.finger.regions import dilate, erode
from splitknit.finger.registration import (
    BAND_RATIO,
    COARSE_MM,
    FINE_MM,
    RIM_MM,
    SETTLED_MM,
    SETTLED_PX,
    SURROUND_MM,
    WORKING_PX_PER_MM,
    RegistrationSettings,
)
from splitknit.finger.registration_flow import (
    Array,
    Family,
    Flow,
    Level,
    check_light_vectors,
    details_of,
    finger_family,
    gram,
    lights_on,
    places_of,
    robust_weight,
    still,
)
from splitknit.model import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A band whose shots are registered: what the others are compared with."""

    stack: FloatArray
    """(K, H, W) grey, linear."""
    lights: NDArray[np.float64]
    """(K, 3) or (K, 3, h, w)"""
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
    lights : (L, 3) towards the light, or (L, 3, h, w) if those of `seen` are such
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
    check_light_vectors(lights, len(stack))
    check_light_vectors(seen.lights, len(seen.stack))
    around, skin = dilate(mask, SURROUND_MM * px_per_mm), erode(mask, RIM_MM * px_per_mm)
    flow = unmoved = still(len(stack), (mask.shape[0], mask.shape[1]), px_per_mm)
    for step, sigma in enumerate((*COARSE_MM, *FINE_MM)):
        region = skin if step >= len(COARSE_MM) and skin.any() else around
        band = (sigma, BAND_RATIO * sigma)
        level, known = (
            details_of(images, region, px_per_mm, band, WORKING_PX_PER_MM) for images in (stack, seen.stack)
        )
        expected = _expected(seen, level, known, lights, mask.shape, px_per_mm)
        flow = _followed(level, expected, flow, finger_family(mask, px_per_mm, turns=step > 0), settings.iterations)
    found = (level.seen(f.at(*level.places()).astype(np.float32))[:, 0] for f in (flow, unmoved))
    likeness, before = (_likeness(level.weight, expected, images) for images in found)
    return BandRegistration(flow, likeness, before)


def _expected(  # noqa: PLR0917
    seen: Seen, level: Level, known: Level, lights: Array, shape: tuple[int, ...], px_per_mm: float
) -> FloatArray:
    """(L, N) details under `lights` of the surface that the `known` details of the first band give."""
    taken = replace(known, columns=level.columns, rows=level.rows, weight=level.weight)
    shifts = seen.flow.at(*level.places())[seen.shots].astype(np.float32)
    details = taken.seen(shifts)[:, 0]
    before, now = (lights_on(part, level, shape, px_per_mm) for part in (seen.lights, lights))
    before = np.moveaxis(before.astype(np.float64), 2, 0)  # (N or 1, K, 3)
    normal = before.transpose(0, 2, 1) @ before
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    observed = (before * details.T[:, :, None]).sum(axis=1)
    surface = np.linalg.solve(np.broadcast_to(normal, (len(observed), 3, 3)), observed[..., None])[..., 0].T
    return np.asarray((now * surface).sum(axis=1), dtype=np.float32)


def _followed(level: Level, expected: FloatArray, flow: Flow, family: Family, iterations: int) -> Flow:
    """Move every shot, by itself, towards the details that are expected of it, whatever their strength."""
    x, y = level.places()
    first, basis = flow.at(x, y), family.basis(x, y)
    found = np.zeros((len(first), basis.shape[2]))
    most, least = 1.0 / level.px_per_mm, max(SETTLED_MM, SETTLED_PX / level.px_per_mm)
    for k in range(len(first)):
        alone = replace(level, images=level.images[k : k + 1])
        for _ in range(iterations):
            shifts = first[k] + np.einsum("m,ncm->cn", found[k], basis)
            step = np.clip(
                _step(level, expected[k], alone.seen(shifts[None].astype(np.float32))[0], basis), -most, most
            )
            found[k] += step
            if float(np.abs(step).max()) < least:
                break
    moved = np.einsum("km,ncm->kcn", found, family.basis(*places_of(flow)))
    return Flow(flow.nodes_mm + moved.reshape(flow.nodes_mm.shape))


def _step(level: Level, expected: FloatArray, seen: FloatArray, basis: Array) -> Array:
    """(M,) change of one shot's parameters; `seen` (3, N) are its details and their derivatives."""
    gain = _gain(level.weight, expected, seen[0])
    left = seen[0] - np.float32(gain) * expected
    root = np.sqrt(robust_weight(level, np.sqrt(left * left * level.weight)))
    shifts = seen[1] * basis[:, 0].T + seen[2] * basis[:, 1].T
    normal = gram(np.asarray(np.concatenate([shifts, -expected[None], left[None]]) * root, dtype=np.float32))
    force, normal = normal[:-1, -1], normal[:-1, :-1]
    normal = normal + np.diag(1e-6 * np.diag(normal) + 1e-30)
    return np.asarray(-np.linalg.solve(normal, force)[:-1])


def _gain(weight: FloatArray, expected: FloatArray, image: FloatArray) -> float:
    power = float((expected * expected * weight).sum(dtype=np.float64))
    return float((expected * image * weight).sum(dtype=np.float64)) / max(power, 1e-30)


def _likeness(weight: FloatArray, expected: FloatArray, images: FloatArray) -> NDArray[np.float64]:
    def total(a: FloatArray, b: FloatArray) -> Array:
        return np.asarray((a * b * weight).sum(axis=1, dtype=np.float64))

    return np.asarray(
        total(images, expected) / np.sqrt(np.maximum(total(images, images) * total(expected, expected), 1e-30))
    )
