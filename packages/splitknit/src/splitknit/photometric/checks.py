"""Photographs against each other: how bright each light is, and which photograph does not fit the others.

Each photograph is predicted from the others, by least squares of the lights that reach a pixel. A sound one differs
from that by gloss and noise; a shift, a blur and a double image differ by derivatives of the prediction, which gives
them a size in pixels. The photograph that such a fault explains best is left out, and the rest compared again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np

from splitknit.errors import BadInput, check_lights, check_mask, check_stack
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.photometric.equations import (
    PAIRS,
    back_substitute,
    factorise,
    moment_matrix,
    moment_vector,
    shading,
    unit_normals,
)

Fault = Literal["moved", "blurred", "double", "overexposed", "underexposed", "unlike"]
LEAST = 4
"""Photographs that are left at least: with one less, nothing shows which does not fit."""
_SHADOW = 0.1
"""A light is in shadow where its image is below this part of the brightest one's."""
_MOST_LEVERAGE = 0.9
"""Above it the other lights hardly predict a light."""
_PIXELS = 8_000
"""Pixels of the object that gains and derivatives are fitted to."""
_FEWEST = 400
"""Pixels that a comparison needs."""
_SMOOTH_PX = 1.0
"""Blur (sigma) before derivatives: noise is not to look like sharpness."""
_MARGIN_PX = 7
"""Side of the square that must be lit and inside the mask around a pixel that is compared."""
_SQUARE = np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8)
_LOCAL_PX = 31
"""Side of the square over which the prediction's brightness is that of the photograph: near lights and gloss."""
_PX, _STANDS_OUT = 0.5, 3.5
"""From where a photograph is moved, blurred or double: pixels times the fraction that they explain (up to 0.35 on sound
photographs of a bear and a sphere, 0.8 on rendered objects), and that times the light explained over the median's."""
_GLOSS_PX = 1.5
"""Gloss on ribs changes their contrast as a blur of up to this sigma would."""
_UNLIKE, _UNLIKE_LIGHT, _UNLIKE_DEG = 0.6, 0.1, 0.5
"""Part of all residuals that goes with one photograph, beyond its even part; the residual over the light; the turn."""
_EXPLAINS = 0.85
"""Part of the mean difference that a named fault may leave; else the photograph is unlike the others."""
_CLIPPED = 0.01
_FAINT = 0.12
"""Brightness over the median photograph's below which noise and the steps of the numbers count."""

_BORDER, _LEFT_OUT, _LIT = 0.7, 0.02, 0.1
"""A mask may be inverted that holds the picture's corners and this part of its border, and leaves out this part of it,
lit: brighter than this part of the brightest pixels."""
_TURNS, _TURNS_DEG = 2.5, 5.0
"""Spread of directions (70 % of pixels) of what an inverted mask leaves out: over that of what it holds, and itself."""


@dataclass(frozen=True, slots=True)
class PhotographFault:
    """One photograph that does not fit the others."""

    photograph: int
    kind: Fault
    size: float
    """Pixels of the given stack (of a blur its sigma); of exposures and ``unlike`` a fraction."""
    effect_deg: float
    """By how much the photograph turns the normals, median."""


def light_gains(stack: Any, lights: Any, mask: Any = None, ceilings: Any = None) -> Array:
    """Brightness (L,) of each photograph's light over what `lights` promise, one in the geometric mean.

    Minimises sum |I_k / a_k - l_k . g|^2 over the surface's g at every pixel and the gains a: with the surface
    eliminated, 1 / a is the eigenvector of the smallest eigenvalue of an L x L matrix. Lights in shadow and clipped
    values are left out, gloss loses weight. Ones where four lights or more do not reach enough pixels.

    Source: G. Golub and V. Pereyra, "Separable nonlinear least squares: the variable projection method", Inverse
    Problems 19 (2003). Parameters as of :func:`faulty_photographs`.

    >>> lights = np.array([[0.0, 0.6, 0.8], [0.6, 0.0, 0.8], [-0.6, 0.0, 0.8], [0.0, -0.6, 0.8], [0.0, 0.0, 1.0]])
    >>> y, x = np.mgrid[-9:10, -9:10] / 24.0
    >>> stack = np.einsum("ki,yxi->kyx", lights, np.dstack([x, y, np.sqrt(1 - x**2 - y**2)]))
    >>> np.round(light_gains(stack * np.array([1, 2, 1, 1, 0.5])[:, None, None], lights), 2).tolist()
    [1.0, 2.0, 1.0, 1.0, 0.5]
    """
    images, vectors, inside, levels = _checked(stack, lights, mask, ceilings)
    light = images[:, inside]
    return _gains(light[:, :: max(1, light.shape[1] // _PIXELS)], vectors, levels)


def light_left(stack: Any, lights: Any, mask: Any = None, ceilings: Any = None) -> float:
    """Part of the light that a matt surface under these lights leaves unexplained at 80 % of the values, at most."""
    images, vectors, inside, levels = _checked(stack, lights, mask, ceilings)
    fit = _Compared(images, vectors, inside, levels).looked_at(list(range(len(images))))
    light = images[:, inside][fit.good]
    if not light.size:
        return 1.0
    return float(np.quantile(np.abs(fit.residual[fit.good]), 0.8) / max(float(light.mean()), 1e-12))


def leaves_out_object(stack: Any, lights: Any, mask: Any) -> bool:
    """Whether a mask (H, W) looks inverted: it runs around the picture, and what it leaves out, lit, changes more in
    direction than what it holds. Directions are those of pinv(lights) @ stack, one vector a pixel.
    """
    images, vectors, inside, _ = _checked(stack, lights, mask, None)
    border = np.concatenate([inside[0], inside[-1], inside[:, 0], inside[:, -1]])
    mean = images.mean(axis=0)
    lit = mean > _LIT * np.quantile(mean, 0.995)
    beside, held = lit & ~inside, lit & inside
    corners = inside[:: max(1, len(inside) - 1), :: max(1, inside.shape[1] - 1)]
    if not corners.all() or border.mean() < _BORDER or beside.mean() < _LEFT_OUT:
        return False
    if held.sum() < _LIT * inside.sum():
        return True
    rows, columns = np.nonzero(held)
    light = np.tensordot(np.linalg.pinv(vectors), images, 1)
    unit = light / np.maximum(np.linalg.norm(light, axis=0), 1e-12)
    place = np.stack([rows, columns, np.ones(len(rows))], axis=1)
    trend = place @ np.linalg.lstsq(place, unit[:, held].T, rcond=None)[0]
    level = np.median(unit[:, beside], axis=1, keepdims=True)
    spreads = [
        float(np.degrees(np.quantile(np.linalg.norm(rest, axis=0), 0.7)))
        for rest in (unit[:, held] - trend.T, unit[:, beside] - level)
    ]
    return spreads[1] > max(_TURNS * spreads[0], _TURNS_DEG)


def _gains(light: FloatArray, lights: Array, ceilings: FloatArray) -> Array:
    own = light.astype(np.float64)
    gains = np.maximum(np.quantile(own, 0.9, axis=1) / np.linalg.norm(lights, axis=1), 1e-9)
    gains /= np.exp(np.log(gains).mean())
    products, unit = np.stack([lights[:, i] * lights[:, j] for i, j in PAIRS]), np.ones(light.shape[1])
    for _ in range(12):
        lit = _lit(light, lights * gains[:, None], ceilings)
        lit &= lit.sum(axis=0) >= LEAST
        if lit.any(axis=0).sum() < 100 or not lit.any(axis=1).all():
            return np.ones(len(light))
        over = own / gains[:, None]
        over /= np.maximum(over.mean(axis=0), 1e-12)
        weights = lit.astype(np.float64)
        rest = over - lights @ back_substitute(factorise(products @ weights), lights.T @ (weights * over))
        weights = lit / (1.0 + (rest / max(3.0 * float(np.median(np.abs(rest[lit]))), 1e-6)) ** 2)
        factors, weighted = factorise(products @ weights), weights * over
        power = np.diag((weighted * over).sum(axis=1))
        pulls = (back_substitute(factors, vector[:, None] * unit) for vector in lights)
        left = power - np.stack([(weighted * (lights @ pull)) @ one for pull, one in zip(pulls, weighted, strict=True)])
        root = 1.0 / np.sqrt(np.diag(power))
        vector = np.linalg.eigh(root[:, None] * left * root)[1][:, 0] * root
        step = np.clip(np.abs(vector) / np.abs(vector).max(), 1e-3, None)
        gains /= step
        gains /= np.exp(np.log(gains).mean())
        if float(np.ptp(np.log(step))) < 1e-4:
            break
    return np.asarray(gains)


def faulty_photographs(
    stack: Any, lights: Any, mask: Any = None, ceilings: Any = None, least: int = LEAST
) -> tuple[PhotographFault, ...]:
    """Photographs that do not fit the others, the worst first; an overexposed one may come twice.

    Parameters
    ----------
    stack : (L, H, W)
        Linear light, one image a light, of any material and band; fewer than five are not compared.
    lights : (L, 3)
        Directions towards the lights; their brightness is estimated (:func:`light_gains`).
    mask : (H, W) bool, optional
        The object; everything by default.
    ceilings : float or (L,), optional
        Value from which each image is clipped.
    least : int
        Photographs that must be left when the faulty ones are.

    Raises
    ------
    BadInput
        As :func:`splitknit.photometric.lambertian.lambertian`.

    References
    ----------
    R. D. Cook, "Detection of influential observation in linear regression", Technometrics 19 (1977), for the residual
    of what is left out; B. D. Lucas and T. Kanade, "An iterative image registration technique", IJCAI 1981, for shifts.
    """
    images, vectors, inside, levels = _checked(stack, lights, mask, ceilings)
    if len(images) <= LEAST or inside.sum() < _FEWEST:
        return ()
    clipped = ((images >= levels[:, None, None]) & inside).reshape(len(images), -1).sum(axis=1) / inside.sum()
    gains = light_gains(images, vectors, inside, levels)
    scaled = _Compared(images, vectors * gains[:, None], inside, levels)
    kept, faults = list(range(len(images))), []
    for k in np.flatnonzero(clipped > _CLIPPED).tolist():
        faults.append(PhotographFault(k, "overexposed", float(clipped[k]), scaled.turned_by_clipping(k)))
    dim = gains / np.median(gains)
    for k in np.flatnonzero(dim < _FAINT).tolist():
        if len(kept) > least:
            faults.append(PhotographFault(k, "underexposed", float(dim[k]), scaled.looked_at(kept).turned(k)))
            kept.remove(k)
    while len(kept) > max(least, LEAST):
        fault = scaled.looked_at(kept).worst()
        if fault is None:
            break
        kept.remove(fault.photograph)
        try:
            check_lights(vectors[kept])
        except BadInput:  # without it they determine no normal
            break
        faults.append(fault)
        gains = light_gains(images[kept], vectors[kept], inside, levels[kept])
        scaled.lights[kept] = vectors[kept] * gains[:, None]
    return tuple(faults)


def _checked(stack: Any, lights: Any, mask: Any, ceilings: Any) -> tuple[FloatArray, Array, BoolArray, FloatArray]:
    images = check_stack(stack, least=3)
    inside = check_mask(mask, (images.shape[1], images.shape[2]))
    levels = np.broadcast_to(np.float32(np.inf if ceilings is None else ceilings), (len(images),)).astype(np.float32)
    return images, check_lights(lights, len(images)), inside, levels


def _lit(light: FloatArray, lights: FloatArray, ceilings: FloatArray) -> BoolArray:
    """(L, n) where a light reaches a pixel, and its value is not clipped."""
    relative = light / np.linalg.norm(lights, axis=1).astype(np.float32)[:, None]
    usable = light < ceilings[:, None]
    peak = np.max(relative, axis=0, where=usable, initial=1e-20)
    return np.asarray((relative > _SHADOW * peak) & usable)


class _Compared:
    """Photographs, and what the others predict of each."""

    def __init__(self, images: FloatArray, lights: Array, inside: BoolArray, ceilings: FloatArray) -> None:
        self.images, self.lights, self.inside, self.ceilings = images, lights, inside, ceilings
        self.kept: list[int] = []

    def looked_at(self, kept: list[int]) -> _Compared:
        """The photographs `kept` alone."""
        self.kept = list(kept)
        light = self.images[kept][:, self.inside]
        vectors = self.lights[kept].astype(np.float32)
        lit = _lit(light, vectors, self.ceilings[kept])
        light = np.where(lit, light, 0.0)
        weights = lit.astype(np.float32)
        self.factors = factorise(moment_matrix(vectors, weights))
        self.g = back_substitute(self.factors, moment_vector(light, vectors, weights))
        self.residual = (light - shading(self.g, vectors)) * weights
        ones = np.ones(light.shape[1], dtype=np.float32)
        self.pull = [back_substitute(self.factors, vector[:, None] * ones) for vector in vectors]
        leverage = np.stack([v @ pull for v, pull in zip(vectors, self.pull, strict=True)]) * weights
        self.count = weights.sum(axis=0)
        self.good = lit & (leverage < _MOST_LEVERAGE) & (self.count >= LEAST)
        self.steady = np.ones(self.inside.shape, dtype=bool)  # where a light ends, the prediction has a step
        for one in lit:
            plane = np.zeros(self.inside.shape, dtype=np.uint8)
            plane[self.inside] = one
            self.steady &= cv2.erode(plane, _SQUARE) == cv2.dilate(plane, _SQUARE)
        self.apart = np.where(self.good, self.residual / np.maximum(1 - leverage, 1 - _MOST_LEVERAGE), 0.0)
        return self

    def turned(self, k: int) -> float:
        """Median angle in degrees between the normals with photograph k and without it."""
        at = self.kept.index(k)
        good = self.good[at]
        if not good.any():
            return 0.0
        without = self.g[:, good] - self.pull[at][:, good] * self.apart[at, good]
        return _angle(self.g[:, good], without)

    def turned_by_clipping(self, k: int) -> float:
        """Median angle by which the clipped values of photograph k turn the normals where they are."""
        images, clipped = self.images, (self.images[k] >= self.ceilings[k]) & self.inside
        light = np.minimum(images[:, clipped], self.ceilings[:, None])
        vectors = self.lights.astype(np.float32)
        weights = [_lit(images[:, clipped], vectors, self.ceilings).astype(np.float32), np.ones_like(light)]
        determined = weights[0].sum(axis=0) >= LEAST - 1
        if not determined.any():
            return float("nan")
        light, weights = light[:, determined], [one[:, determined] for one in weights]
        both = [
            back_substitute(factorise(moment_matrix(vectors, one)), moment_vector(light, vectors, one))
            for one in weights
        ]
        return _angle(*both)

    def worst(self) -> PhotographFault | None:
        """The photograph that fits least, if any does not fit."""
        pixels, explained = np.array([self._derivatives(k) for k in range(len(self.kept))]).T
        k = int(np.argmax(explained))
        if pixels[k] > _PX and pixels[k] * explained[k] > _STANDS_OUT * float(np.median(explained)):
            (kind, size), turn_deg = self._named(k), self.turned(self.kept[k])
            unlike = size > 0.5 * _UNLIKE_LIGHT and turn_deg > _UNLIKE_DEG
            if {"unlike": unlike, "blurred": size > _GLOSS_PX}.get(kind, True):
                return PhotographFault(self.kept[k], kind, size, turn_deg)
        own = (self.apart * self.residual).sum(axis=1, where=self.good)
        spare = np.maximum(self.count - 3, 1)
        whole = float((self.residual**2).sum())
        even = 1.0 / max(float(np.mean(spare)), 1.0)
        part = (own / max(whole, 1e-30) - even) / max(1.0 - even, 1e-6)
        k = int(np.argmax(part))
        rms = float(np.sqrt(whole / max(float(spare.sum()), 1.0)))
        level = rms / max(float(np.mean(self.images[self.kept[k]], where=self.inside)), 1e-12)
        turn_deg = self.turned(self.kept[k])
        unlike = part[k] > _UNLIKE and level > _UNLIKE_LIGHT and turn_deg > _UNLIKE_DEG
        return PhotographFault(self.kept[k], "unlike", level, turn_deg) if unlike else None

    def _pair(self, k: int) -> tuple[FloatArray, FloatArray, BoolArray]:
        """A photograph, what the others predict, at its brightness, and where both are known."""
        valid = np.zeros(self.inside.shape, dtype=np.uint8)
        valid[self.inside] = self.good[k]
        image = np.minimum(self.images[self.kept[k]], self.ceilings[self.kept[k]])
        predicted = image.copy()
        predicted[self.inside] -= self.apart[k]
        known = (cv2.erode(valid, _SQUARE, borderValue=0) > 0) & self.steady

        def local(values: FloatArray) -> FloatArray:
            return np.asarray(cv2.stackBlur(values * valid, (_LOCAL_PX, _LOCAL_PX)))

        ratio = np.where(valid > 0, local(image) / np.maximum(local(predicted), 1e-9), 1.0)
        return image, predicted * np.clip(ratio, 0.2, 5.0), known

    def _derivatives(self, k: int) -> tuple[float, float]:
        """Pixels of shift and blur in a photograph's difference to its prediction, times the fraction that they
        explain; and the squared light that they explain, over the squared light."""
        image, predicted, known = self._pair(k)
        if int(known.sum()) < _FEWEST:
            return 0.0, 0.0
        target, model = (cv2.GaussianBlur(one, (0, 0), _SMOOTH_PX) for one in (image, predicted))
        dy, dx = np.gradient(model)
        spread = np.gradient(dy, axis=0) + np.gradient(dx, axis=1)
        some = np.flatnonzero(known)[:: max(1, int(known.sum()) // _PIXELS)]
        terms = np.stack([part.ravel()[some] for part in (model, dx, dy, spread)]).astype(np.float64)
        rest = (target - model).ravel()[some].astype(np.float64)
        weights = np.ones(rest.size)
        for _ in range(6):
            weighted = terms * weights
            both = weighted @ terms.T
            found = np.linalg.solve(both + 1e-12 * np.trace(both) * np.eye(4), weighted @ rest)
            error = rest - found @ terms
            weights = 1.0 / (1.0 + (error / max(3.0 * float(np.median(np.abs(error))), 1e-9)) ** 2)
        gain = float(weights @ (terms[0] * rest)) / max(float(weights @ terms[0] ** 2), 1e-30)
        before, after = (float(weights @ one**2) for one in (rest - gain * terms[0], error))
        level = float(weights.sum()) * max(float(target.ravel()[some].mean()), 1e-12) ** 2
        part = max(1.0 - after / max(before, 1e-30), 0.0)
        size = float(np.sqrt(found[1] ** 2 + found[2] ** 2 + max(found[3], 0.0)))
        return part * size, (before - after) / level

    def _named(self, k: int) -> tuple[Fault, float]:
        """What explains photograph k best: its prediction moved, blurred, or seen twice; and by how many pixels."""
        image, predicted, known = self._pair(k)
        target = cv2.GaussianBlur(image, (0, 0), _SMOOTH_PX)
        reach = np.arange(-8, 9)

        def misfit(model: Any) -> float:
            smooth = cv2.GaussianBlur(model, (0, 0), _SMOOTH_PX)[known]
            return float(np.mean(np.abs(target[known] - smooth)))

        def moved(x: float, y: float) -> FloatArray:
            matrix = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
            size, border = predicted.shape[::-1], cv2.BORDER_REPLICATE
            return np.asarray(cv2.warpAffine(predicted, matrix, size, borderMode=border))

        def best(model: Callable[[float, float], FloatArray]) -> tuple[float, float]:
            tried = [(misfit(model(x, y)), float(np.hypot(x, y)), x, y) for x in reach[::2] for y in reach[::2]]
            _, _, x, y = min(tried)
            tried += [
                (misfit(model(x + u, y + v)), float(np.hypot(x + u, y + v)), x + u, y + v)
                for u in (-1.0, -0.5, 0.0, 0.5, 1.0) for v in (-1.0, -0.5, 0.0, 0.5, 1.0)
            ]  # fmt: skip
            return min(tried)[:2]

        sigmas = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0)
        ways: dict[Fault, tuple[float, float]] = {
            "moved": best(moved),
            "blurred": min((misfit(cv2.GaussianBlur(predicted, (0, 0), one)), one) for one in sigmas),
            "double": best(lambda x, y: 0.5 * (predicted + moved(x, y))),
        }
        kind = min(ways, key=lambda one: ways[one][0])
        left = misfit(predicted)
        if ways[kind][0] > _EXPLAINS * left:
            return "unlike", left / max(float(np.mean(target[known])), 1e-12)
        return kind, ways[kind][1]


def _angle(one: FloatArray, other: FloatArray) -> float:
    cosine = (unit_normals(one)[0] * unit_normals(other)[0]).sum(axis=0)
    return float(np.rad2deg(np.arccos(np.clip(np.median(cosine), -1.0, 1.0))))
