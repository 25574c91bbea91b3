"""The shots of a moving finger, brought onto one of them: shift and turn.

Every shot is lit from elsewhere, so two shots of a still finger differ, and a method that compares them takes light for
motion. But what all shots of a matt surface may show together is known: at every pixel their brightnesses are a
combination of the three components of the light vectors, whatever the surface is. What is left after the best such
combination has been taken off is motion (or specular reflection, which colours separate before). All shots are moved
at once until the rest is minimal: the surface itself is never needed, it is eliminated pixel by pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, check_stack, require
from splitknit.finger.regions import dilate, erode
from splitknit.finger.registration_flow import (
    Array,
    Basis,
    Flow,
    Level,
    beyond_surface,
    check_light_vectors,
    details_of,
    gram,
    lights_on,
    places_of,
    rigid_shifts,
    robust_weight,
    shown_by_surfaces,
    still,
)
from splitknit.model import BoolArray, FloatArray

SETTLED_MM, SETTLED_PX = 5e-4, 0.02
"""Shots that move by less than the larger of the two are settled; images are resampled to 1/32 px."""
ITERATIONS = 20
"""Maximum refinements in each band."""
COARSE_MM = (0.5, 0.3, 0.15)
"""Fine ends (sigma) of the band-pass filters in which the outline counts too, coarse to fine."""
FINE_MM = (0.08,)
"""Fine ends of the filters in which only the skin counts."""
BAND_RATIO = 3.2
"""Coarse end of each filter over its fine end."""
WORKING_PX_PER_MM = 12.5
"""Scale of the copies that are compared in the finest band."""
SURROUND_MM = 0.7
"""Width of the background around the finger that is used, for the sake of its silhouette."""
RIM_MM = 0.8
"""Width of the finger's edge that is left out of the fine bands."""
BLOCK_MM = 0.6
"""Pitch at which the light of near LEDs is computed."""


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Where the skin of the reference shot lies in every shot."""

    flow: Flow
    before: NDArray[np.float64]
    """(L,) details of each image that no matt surface explains, as they are, over its details (rms)."""
    after: NDArray[np.float64]
    """(L,) the same with the motion undone."""


def register_shots(
    stack: FloatArray,
    lights: NDArray[np.float64],
    mask: BoolArray,
    px_per_mm: float,
    *,
    reference: int,
    shots: NDArray[np.intp] | None = None,
) -> Registration:
    """Find where the skin of shot `reference` lies in every other shot.

    Raises BadInput with fewer than five images, or where shapes do not fit. Source: Golub, G. and Pereyra, V., "The
    differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate", SIAM J. Numer.
    Anal. 10(2), 1973 (the surface is eliminated from the least squares).

    `stack`: (L, H, W) float32 linear, at least five images, best without glare (:func:`without_glare`); `lights`: (L,
    3) towards the light, its length the relative strength, or, under near LEDs, (L, 3, h, w) on nodes that lie evenly
    over the image, first and last pixel included; `mask`: (H, W) bool, the finger, roughly; `reference`: shot onto
    which the others are brought; `shots`: (L,) shot of every image, where several lights share one; None = every image
    is a shot.
    """
    stack = check_stack(stack, least=5)
    mask = check_mask(mask, (stack.shape[1], stack.shape[2]))
    count = len(stack)
    lights = np.asarray(lights, dtype=np.float64)
    check_light_vectors(lights, count)
    shots = np.arange(count) if shots is None else np.asarray(shots)
    require(shots.shape == (count,), f"shots must have the shape ({count},), but they have {shots.shape}.")
    number = int(shots.max()) + 1
    require(0 <= reference < number, f"the reference must be one of {number} shots, but it is {reference}.")
    around, skin = dilate(mask, SURROUND_MM * px_per_mm), erode(mask, RIM_MM * px_per_mm)
    flow = unmoved = still(number, (mask.shape[0], mask.shape[1]), px_per_mm)
    for step, sigma in enumerate((*COARSE_MM, *FINE_MM)):
        fine = step >= len(COARSE_MM)
        region = skin if fine and skin.any() else around
        band = (sigma, BAND_RATIO * sigma)
        level = details_of(stack, region, px_per_mm, band, WORKING_PX_PER_MM)
        here = lights_on(lights, level, mask.shape, px_per_mm)
        problem = _Problem(level, shown_by_surfaces(here), shots, reference)
        flow = problem.settled(flow, rigid_shifts(mask, px_per_mm, turns=step > 0))
    return Registration(flow, problem.unexplained(unmoved), problem.unexplained(flow))


def without_glare(colours: FloatArray) -> FloatArray:
    """(L, H, W) light that came through the skin, from linear colours (3, L, H, W): specular light is white."""
    return np.asarray(colours[0] - colours[2], dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Details of one size: which images belong together, and what they may show."""

    level: Level
    axes: FloatArray
    """(L, 3, N) or (L, 3, 1): orthonormal brightnesses that span what a matt surface may show."""
    shots: NDArray[np.intp]
    """(L,)"""
    reference: int

    def settled(self, flow: Flow, basis_at: Basis) -> Flow:
        """Move the shots by Gauss-Newton steps within a basis of shifts until they hardly move."""
        x, y = self.level.places()
        first = flow.at(x, y)
        free = [k for k in range(len(first)) if k != self.reference]
        basis = basis_at(x, y)
        parameters = np.zeros((len(free), basis.shape[2]))
        most, least = 1.0 / self.level.px_per_mm, max(SETTLED_MM, SETTLED_PX / self.level.px_per_mm)
        for _ in range(ITERATIONS):
            shifts = first.copy()
            shifts[free] += np.einsum("km,ncm->kcn", parameters, basis)
            sampled = self.level.sampled(shifts[self.shots].astype(np.float32))
            step = np.clip(self._step(sampled, basis, free), -most, most)
            parameters += step
            if float(np.abs(step).max()) < least:
                break
        nodes = flow.nodes_mm.copy()
        moved = np.einsum("km,ncm->kcn", parameters, basis_at(*places_of(flow)))
        nodes[free] += moved.reshape(len(free), *nodes.shape[1:])
        return Flow(nodes)

    def unexplained(self, flow: Flow) -> NDArray[np.float64]:
        """(L,) rms of what no surface explains over the rms of each image's details."""
        images = self.level.sampled(flow.at(*self.level.places())[self.shots].astype(np.float32))[:, 0]
        residual = beyond_surface(images, self.axes)
        error, power = ((part * part * self.level.weight).sum(axis=1, dtype=np.float64) for part in (residual, images))
        return np.asarray(np.sqrt(error / np.maximum(power, 1e-30)))

    def _step(self, sampled: FloatArray, basis: Array, free: list[int]) -> Array:
        """(F, M) change of the parameters of the free shots: the normal equations."""
        residual = beyond_surface(sampled[:, 0], self.axes)
        root = np.sqrt(robust_weight(self.level, np.sqrt((residual * residual).sum(axis=0) * self.level.weight)))
        width, number, total = basis.shape[2], len(free), root.size
        right, down = (np.ascontiguousarray(basis[:, c].T, dtype=np.float32) for c in range(2))
        matrix, force = np.zeros((number, width, number, width)), np.zeros((number, width))
        shown = np.zeros((3, number, width, total), dtype=np.float32)
        for image, shot in enumerate(self.shots):
            if shot == self.reference:
                continue
            k = free.index(int(shot))
            columns = (sampled[image, 1] * right + sampled[image, 2] * down) * root
            matrix[k, :, k] += gram(columns)
            force[k] += np.einsum("mn,n->m", columns, residual[image] * root)
            shown[:, k] += columns * self.axes[image][:, None]
        for part in shown:
            matrix -= gram(part.reshape(number * width, total)).reshape(matrix.shape)
        flat = matrix.reshape(number * width, number * width)
        flat = flat + 1e-6 * float(np.diag(flat).mean()) * np.eye(len(flat))
        return np.asarray(-np.linalg.solve(flat, force.ravel()).reshape(number, width))
