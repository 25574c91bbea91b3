"""The shots of a moving finger, brought onto one of them: shift and turn.

Every shot is lit from elsewhere, so two shots of a still finger differ, and a method that compares
them takes light for motion. But what all shots of a matt surface may show together is known: at
every pixel their brightnesses are a combination of the three components of the light vectors,
whatever the surface is. What is left after the best such combination has been taken off is motion
(or specular reflection, which colours separate before). All shots are moved at once until the rest
is minimal: the surface itself is never needed, it is eliminated pixel by pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.finger.regions import blur, dilate, erode
from splitknit.imaging.geometry import bounding_box, sampled_at
from splitknit.imaging.robust import deviation, huber
from splitknit.model import Array, BoolArray, FloatArray

# Where the skin of one shot lies in the others: shifts and turns, and the details of images that
# show them.


TURN_MM = 8.0
"""A turn's parameter is the shift that it causes at this distance. Chosen on: simulated fingers
(seeds 9101 to 9104). Range: 4 to 16 (validation/parameters)."""


@dataclass(frozen=True, slots=True, eq=False)
class Flow:
    """Shift and turn of every shot against the reference."""

    moves_mm: Array
    """(L, 3): right, down the rows, and the shift that a turn causes at a distance of `TURN_MM`."""
    centre_mm: Array
    """(2,) place about which the shots turn, right of and below the first pixel."""

    def basis(self, x_mm: Array, y_mm: Array) -> Array:
        """(N, 2, 3) shift at places (N,), right of and below the first pixel, for a unit of every
        move."""
        unit = np.ones_like(x_mm)
        zero = np.zeros_like(x_mm)
        right = [unit, zero, -(y_mm - self.centre_mm[1]) / TURN_MM]
        down = [zero, unit, (x_mm - self.centre_mm[0]) / TURN_MM]
        return np.stack([np.stack(right, axis=-1), np.stack(down, axis=-1)], axis=1)

    def at(self, x_mm: Array, y_mm: Array) -> Array:
        """(L, 2, N) shifts at places (N,)."""
        return np.asarray(np.einsum("km,ncm->kcn", self.moves_mm, self.basis(x_mm, y_mm)))

    def affine(self, shot: int, px_per_mm: float) -> Array:
        """(2, 3) matrix from columns and rows of the reference to those of a shot."""
        corner = self.at(np.zeros(1), np.zeros(1))[shot, :, 0]
        turn = self.moves_mm[shot, 2] / TURN_MM
        return np.column_stack([[1.0, turn], [-turn, 1.0], corner * px_per_mm])


def still(count: int, mask: BoolArray, px_per_mm: float) -> Flow:
    """A flow without motion for `count` shots of the finger under `mask` (H, W), about whose middle
    they turn."""
    rows, columns = bounding_box(mask)
    middle = np.array([part.start + part.stop - 1 for part in (columns, rows)])
    return Flow(np.zeros((count, 3)), 0.5 * middle / px_per_mm)


# Details of one size in all shots, at the pixels that matter, and the shifts they imply.

STEPS = 32.0
"""Places within a pixel at which OpenCV interpolates; a shift in steps of these would not settle.
Source: OpenCV, ``INTER_TAB_SIZE``."""


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """Details of one size."""

    images: tuple[FloatArray, ...]
    """L of (h, w, 3): details, and their derivatives to the right and down the rows, a mm."""
    columns: FloatArray
    """(N,) of the pixels that are used."""
    rows: FloatArray
    """(N,)"""
    weight: FloatArray
    """(N,)"""
    px_per_mm: float

    def places(self) -> tuple[Array, Array]:
        """x and y (N,) of the pixels in mm from the first pixel."""
        return self.columns.astype(np.float64) / self.px_per_mm, self.rows.astype(
            np.float64
        ) / self.px_per_mm

    def sampled(self, shifts_mm: FloatArray) -> FloatArray:
        """(L, 3, N) details and derivatives of image l at the pixels shifted by `shifts_mm[l]`, of
        (L, 2, N)."""
        count = self.columns.size
        values = np.empty((len(self.images), 3, count), dtype=np.float32)
        size = self.px_per_mm
        for k, (image, shift) in enumerate(zip(self.images, shifts_mm, strict=True)):
            columns = self.columns + shift[0] * size
            rows = self.rows + shift[1] * size
            near = [np.rint(places * STEPS) / STEPS for places in (columns, rows)]
            values[k] = sampled_at(image, near[0], near[1], cv2.INTER_CUBIC).T
            # details vary with the shift without steps: what lies between follows from the slopes
            values[k, 0] += (
                values[k, 1] * (columns - near[0]) + values[k, 2] * (rows - near[1])
            ) / size
        return values


BAND_RATIO = 3.2
"""Coarse end of each filter over its fine end. Chosen on: simulated fingers (seeds 9101 to 9104).
Range: 2.24 to 4.48 (validation/parameters)."""
REGISTRATION_PX_PER_MM = 12.5
"""Scale of the copies that are compared in the finest band. Chosen on: simulated fingers (seeds
9101 to 9104). Range: 8.75 to 12.5 (validation/parameters)."""


def details_of(stack: FloatArray, region: BoolArray, px_per_mm: float, sigma_mm: float) -> Level:
    """Band-passed copies of (L, H, W), fine end `sigma_mm`, weighted by one over the square of the
    brightness in `region` (H, W).
    """
    finest = min(px_per_mm, REGISTRATION_PX_PER_MM, 1.0 / sigma_mm)
    # copies are not reduced by less than this: it would blur some pixels more than others
    finest = px_per_mm if finest * 1.1 > px_per_mm else finest
    size = tuple(max(8, round(n * finest / px_per_mm)) for n in (region.shape[1], region.shape[0]))
    px = px_per_mm * size[0] / region.shape[1]
    small = [np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA)) for image in stack]
    inside = cv2.resize(region.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    level = blur(np.mean(small, axis=0), 1.0 * px)
    floor = 0.15 * float(np.median(level[inside])) if inside.any() else 0.0
    rows, columns = np.nonzero(inside)
    # pixels of a level that are used, at least, evenly spread; all where it has fewer
    every = max(1, rows.size // 16_000)
    rows = rows[every // 2 :: every]
    columns = columns[every // 2 :: every]
    weight = 1.0 / np.maximum(level[rows, columns], max(floor, 1e-9)) ** 2
    fine = (blur(image, sigma_mm * px) - blur(image, BAND_RATIO * sigma_mm * px) for image in small)
    images = tuple(_with_slopes(image, px) for image in fine)
    return Level(
        images, columns.astype(np.float32), rows.astype(np.float32), weight.astype(np.float32), px
    )


def _with_slopes(image: FloatArray, px_per_mm: float) -> FloatArray:
    """(h, w, 3) an image and its derivatives to the right and down the rows, a mm."""
    half = 0.5 * px_per_mm
    right = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1, scale=half, borderType=cv2.BORDER_REPLICATE)
    down = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=1, scale=half, borderType=cv2.BORDER_REPLICATE)
    return np.dstack([image, right, down])


_COARSE_BANDS_MM = (0.5, 0.3, 0.15)
"""Fine ends (sigma) of the band-pass filters in which the outline counts too, coarse to fine.
Chosen on: simulated fingers (seeds 9101 to 9104). Range: 0.5 to 2 times these values
(validation/parameters)."""
_FINE_BANDS_MM = (0.08,)
"""Fine ends of the filters in which only the skin counts. Chosen on: simulated fingers (seeds 9101
to 9104). Range: 0.7 to 1 times these values (validation/parameters)."""
SURROUND_MM = 0.7
"""Width of the background around the finger that is used, for the sake of its silhouette. Chosen
on: simulated fingers (seeds 9101 to 9104). Range: 0.35 to 1.4 (validation/parameters)."""
_RIM_MM = 0.8
"""Width of the finger's edge that is left out of the fine bands. Chosen on: simulated fingers
(seeds 9101 to 9104). Range: 0.4 to 1.6 (validation/parameters)."""


def bands_of(mask: BoolArray, px_per_mm: float) -> Iterator[tuple[float, BoolArray, bool]]:
    """Bands in which the shots of the finger under `mask` are compared, coarse to fine: fine end
    (sigma, mm), pixels, and whether turns are sought.
    """
    around = dilate(mask, SURROUND_MM * px_per_mm)
    skin = erode(mask, _RIM_MM * px_per_mm)
    for step, sigma_mm in enumerate((*_COARSE_BANDS_MM, *_FINE_BANDS_MM)):
        fine = step >= len(_COARSE_BANDS_MM)
        yield sigma_mm, skin if fine and skin.any() else around, step > 0


REGISTRATION_ITERATIONS = 20
"""Maximum refinements in each band. Chosen on: speed. Range: 10 to 40 (validation/parameters)."""


def settled(  # noqa: PLR0917
    level: Level,
    flow: Flow,
    shots: NDArray[np.intp],
    free: Sequence[int],
    step_of: Callable[[FloatArray, Array], Array],
    turns: bool,
) -> Flow:
    """Move the shots `free` by Gauss-Newton steps until they hardly move.

    `step_of`: change (F, M) of their parameters, from details and their derivatives (L, 3, N) as
    they lie now and the shift (N, 2, M) for a unit of each parameter.
    """
    places = level.places()
    basis = flow.basis(*places)[..., : 3 if turns else 2]
    largest_mm = 1.0 / level.px_per_mm
    # shots that move by less, in mm or pixels, are settled: images are resampled to 1/32 px
    settled_mm = max(5e-4, 0.02 / level.px_per_mm)
    moves = flow.moves_mm.copy()
    for _ in range(REGISTRATION_ITERATIONS):
        shifts = replace(flow, moves_mm=moves).at(*places)
        sampled = level.sampled(shifts[shots].astype(np.float32))
        step = np.clip(step_of(sampled, basis), -largest_mm, largest_mm)
        moves[free, : basis.shape[2]] += step
        if np.abs(step).max() < settled_mm:
            break
    return replace(flow, moves_mm=moves)


def robust_weight(level: Level, error: FloatArray) -> FloatArray:
    """(N,) weight of every pixel, less where its weighted `error` (N,) is beyond the usual."""
    return np.asarray(level.weight * huber(error, 1.5 * deviation(error) + 1e-12))


# What surfaces may show under lights that differ from place to place.


def lights_on(lights: Array, level: Level, shape: tuple[int, ...], px_per_mm: float) -> FloatArray:
    """(L, 3, N) light vectors at the pixels of a level of images of `shape`."""
    height, width = lights.shape[2:]  # of nodes that lie evenly over the image, ends included
    x, y = level.places()
    columns = (x * (width - 1) / max((shape[1] - 1) / px_per_mm, 1e-9)).astype(np.float32)
    rows = (y * (height - 1) / max((shape[0] - 1) / px_per_mm, 1e-9)).astype(np.float32)
    flat = np.ascontiguousarray(lights, dtype=np.float32).reshape(-1, height, width)
    return np.stack([sampled_at(part, columns, rows) for part in flat]).reshape(-1, 3, x.size)


def surface_axes(lights: FloatArray) -> FloatArray:
    """Orthonormal brightnesses (L, 3, N) that span what matt surfaces may show under `lights` (L,
    3, N)."""
    return np.moveaxis(np.linalg.qr(np.moveaxis(lights, 2, 0))[0], 0, 2)


def beyond_surface(images: FloatArray, axes: FloatArray) -> FloatArray:
    """What no matt surface shows of `images` (L, N): without their parts along `axes` (L, 3, N)."""
    along = (axes * images[:, None]).sum(axis=0)
    return np.asarray(images - (axes * along).sum(axis=1))


# All shots at once, the surface eliminated.


class Registration(NamedTuple):
    """Where the skin of the reference shot lies in every shot."""

    flow: Flow
    before: Array
    """(L,) details of each image that no matt surface explains, as they are, over its details
    (rms)."""
    after: Array
    """(L,) the same with the motion undone."""


def register_shots(
    stack: FloatArray,
    lights: Array,
    mask: BoolArray,
    px_per_mm: float,
    *,
    reference: int,
    shots: NDArray[np.intp] | None = None,
) -> Registration:
    """Find where the skin of shot `reference` lies in every other shot.

    Source: Golub, G. and Pereyra, V., "The differentiation of pseudo-inverses and nonlinear least
    squares problems whose variables separate", SIAM J. Numer. Anal. 10(2), 1973 (the surface is
    eliminated from the least squares). `stack`: (L, H, W) float32 linear, at least five images,
    best without glare (:func:`without_glare`); `lights`: (L, 3, h, w) towards the light, its length
    the relative strength, on nodes that lie evenly over the image, first and last pixel included;
    `mask`: (H, W) bool, the finger, roughly; `reference`: shot onto which the others are brought;
    `shots`: (L,) shot of every image, where several lights share one; None = every image is a shot.
    """
    shots = np.arange(len(stack)) if shots is None else shots
    flow = unmoved = still(int(shots.max()) + 1, mask, px_per_mm)
    free = [k for k in range(len(flow.moves_mm)) if k != reference]
    for sigma_mm, region, turns in bands_of(mask, px_per_mm):
        level = details_of(stack, region, px_per_mm, sigma_mm)
        axes = surface_axes(lights_on(lights, level, mask.shape, px_per_mm))
        step_of = partial(_step, level, axes, shots, free)
        flow = settled(level, flow, shots, free, step_of, turns)

    def unexplained(flow: Flow) -> Array:
        images = level.sampled(flow.at(*level.places())[shots].astype(np.float32))[:, 0]
        residual = beyond_surface(images, axes)
        error, power = (
            (part * part * level.weight).sum(axis=1, dtype=np.float64)
            for part in (residual, images)
        )
        return np.asarray(np.sqrt(error / np.maximum(power, 1e-30)))

    return Registration(flow, unexplained(unmoved), unexplained(flow))


def without_glare(colours: FloatArray) -> FloatArray:
    """(L, H, W) light that came through the skin, from linear colours (3, L, H, W): specular light
    is white."""
    return np.asarray(colours[0] - colours[2])


def _step(  # noqa: PLR0917
    level: Level,
    axes: FloatArray,
    shots: NDArray[np.intp],
    free: list[int],
    sampled: FloatArray,
    basis: Array,
) -> Array:
    """(F, M) change of the parameters of the free shots: the normal equations."""
    residual = beyond_surface(sampled[:, 0], axes)
    root = np.sqrt(robust_weight(level, np.sqrt((residual * residual).sum(axis=0) * level.weight)))
    width = basis.shape[2]
    number = len(free)
    right, down = (np.ascontiguousarray(basis[:, c].T, dtype=np.float32) for c in range(2))
    matrix = np.zeros((number, width, number, width))
    force = np.zeros((number, width))
    along_axes = np.zeros((3, number, width, root.size), dtype=np.float32)
    for image, shot in enumerate(shots):
        if shot not in free:
            continue
        k = free.index(int(shot))
        columns = (sampled[image, 1] * right + sampled[image, 2] * down) * root
        matrix[k, :, k] += columns @ columns.T
        force[k] += columns @ (residual[image] * root)
        along_axes[:, k] += columns * axes[image][:, None]
    flat = matrix.reshape(number * width, number * width)
    for part in along_axes.reshape(3, number * width, root.size):
        flat = flat - part @ part.T
    flat = flat + 1e-6 * float(np.diag(flat).mean()) * np.eye(len(flat))
    return np.asarray(-np.linalg.solve(flat, force.ravel()).reshape(number, width))
