"""Photographs against each other: which of them does not fit the others.

Each photograph is predicted from the others, by least squares of the lights that reach a pixel. A
sound one differs from that by gloss and noise; a shift, a blur and a double image differ by
derivatives of the prediction, which gives them a size in pixels. The photograph that such a fault
explains best is left out, and the rest compared again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

import cv2
import numpy as np

from splitknit.checks import check_lights
from splitknit.diagnosis.samples import (
    LEAST_PHOTOGRAPHS,
    in_blocks,
    median_angle_deg,
)
from splitknit.errors import BadInput
from splitknit.findings import Finding
from splitknit.finger.locate import Finger
from splitknit.imaging.robust import cauchy
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.light import Light
from splitknit.photometric.equations import (
    back_substitute,
    factorise,
    moment_matrix,
    moment_vector,
    shading,
    unit_normals,
)
from splitknit.photometric.forward import unequal

GLOSSY_LEFT = 0.1
"""Unexplained fraction of the light (:attr:`_Comparison.left`) above which gloss, whose highlight
moves, causes the misfit: 0.13 and more on metal where a sound photograph seemed blurred or shifted,
up to 0.04 on matt objects, 0.09 on lacquer. Source: validation/objects (glossy)."""
_COMPARED_SQUARE_PX = 7
"""Side of the square that must be lit and inside the mask around a pixel that is compared."""
_SQUARE = np.ones((_COMPARED_SQUARE_PX, _COMPARED_SQUARE_PX), np.uint8)
Fault = Literal["moved", "blurred", "double", "overexposed", "underexposed", "unlike"]


@dataclass(frozen=True, slots=True)
class PhotographFault:
    """One photograph that does not fit the others."""

    photograph: int
    kind: Fault
    size: float
    """Pixels of the given stack (of a blur its sigma); of exposures and ``unlike`` a fraction."""
    effect_deg: float
    """By how much the photograph turns the normals, median; 0 of clipped values, which are not
    used."""


_FEWEST_COMPARED = 400  # pixels that a comparison needs, in px
_FITTED = 8000  # pixels to which derivatives are fitted, in px: speed


def faulty_photographs(
    images: FloatArray, lights: Array, inside: BoolArray, ceilings: Any = np.inf
) -> tuple[PhotographFault, ...]:
    """Photographs that do not fit the others, the worst first; an overexposed one may come twice.

    Parameters
    ----------
    images : (L, H, W)
        Linear light, one image a light, of any material and band; fewer than five are not compared.
    lights : (L, 3)
        Directions towards the lights; their brightness is estimated
        (:func:`splitknit.photometric.forward.unequal`).
    inside : (H, W)
        The object.
    ceilings : float or (L,)
        Value from which each image is clipped.

    Raises
    ------
    BadInput
        If the lights are too few, duplicate or coplanar.

    References
    ----------
    R. D. Cook, "Detection of influential observation in linear regression", Technometrics 19
    (1977), for the residual of what is left out; B. D. Lucas and T. Kanade, "An iterative image
    registration technique", IJCAI 1981, for shifts.
    """
    vectors = check_lights(lights, len(images))
    levels = np.broadcast_to(np.float32(ceilings), len(images))
    if len(images) <= LEAST_PHOTOGRAPHS or inside.sum() < _FEWEST_COMPARED:
        return ()

    def compared(kept: list[int]) -> _Comparison:
        return _Comparison(images[kept], (vectors * gains[:, None])[kept], inside, levels[kept])

    def glossy_without(k: int, evidence: float = 0.0) -> bool:
        left = compared([other for other in kept if other != k]).left
        return left > GLOSSY_LEFT and evidence < _BESIDE_GLOSS * left

    clipped = (images >= levels[:, None, None])[:, inside].mean(axis=1)
    # fraction of the object that is clipped in one photograph from which it is overexposed
    faults = [
        PhotographFault(k, "overexposed", float(clipped[k]), 0.0)
        for k in range(len(images))
        if clipped[k] > 0.01
    ]
    light = np.where(images < levels[:, None, None], images, 0.0)[:, inside]
    gains = np.exp(unequal(light, vectors.astype(np.float32)).gains)
    dim = gains / np.median(gains)
    kept = list(range(len(images)))
    # brightness over the median photograph's below which noise and the steps of the numbers count
    for k in np.flatnonzero(dim < 0.12).tolist():
        if len(kept) > LEAST_PHOTOGRAPHS and not glossy_without(k):
            turned = compared(kept).turned_deg(kept.index(k))
            faults.append(PhotographFault(k, "underexposed", float(dim[k]), turned))
            kept.remove(k)
    while len(kept) > LEAST_PHOTOGRAPHS:
        fault, evidence = compared(kept).worst()
        if fault is None or glossy_without(kept[fault.photograph], evidence):
            break
        k = kept.pop(fault.photograph)
        try:
            check_lights(vectors[kept])
        except BadInput:  # without it they determine no normal
            break
        faults.append(replace(fault, photograph=k))
        gains[kept] = np.exp(unequal(light[kept], vectors[kept].astype(np.float32)).gains)
    return tuple(faults)


_MOST_LEVERAGE = 0.9  # leverage of a light above which the other lights hardly predict it
_LOCAL_PX = 31
"""Side of the square over which the prediction's brightness is that of the photograph: near lights
and gloss."""
_FAULT_PX = 0.5
"""Pixels times the fraction that they explain from which a photograph is moved, blurred or double:
up to 0.35 on sound photographs of a bear and a sphere, 0.8 on rendered objects. Chosen on: real
photographs (a bear and a sphere, 19 draws of 5 to 24 lights; then simulated objects). Range: 0.35
to 0.8."""
_STANDS_OUT = 3.5
"""A photograph is moved, blurred or double if these pixels times the light that they explain are
more than so many medians of all photographs' explained light. Chosen on: real photographs (a bear
and a sphere, 19 draws of 5 to 24 lights)."""
_BESIDE_GLOSS = 500.0
"""The same over the unexplained light, where gloss causes misfit: 8 to 125 on a photographed coin
and rendered gloss and metal, 220 where the coin had one spoilt, of another one; 1400 and more on a
fossil with one spoilt. Chosen on: validation/objects."""
_MANY = 16  # lights, of which one that ends hardly moves what the others predict
_UNLIKE_PART = 0.6
"""Fraction of all residuals that goes with one photograph, beyond its even part, from which it is
unlike the rest. Chosen on: real photographs (a bear and a sphere, 19 draws of 5 to 24 lights)."""
_UNLIKE_LIGHT = 0.1
"""Residual over the light of a photograph that is unlike the rest, at least. Chosen on: real
photographs (a bear and a sphere, 19 draws of 5 to 24 lights)."""
_UNLIKE_DEG = 0.5
"""Turn of the normals by a photograph that is unlike the rest, at least. Chosen on: real
photographs (a bear and a sphere, 19 draws of 5 to 24 lights)."""
_DOUBLE_LEAVES = 0.9
"""A double image is named if it leaves less than this fraction of what a shift leaves unexplained;
else a shift. Chosen on: simulated objects (4 domes under 5 to 8 lights). Range: 0.85 to 0.9."""


def _lit_values(light: FloatArray, lights: FloatArray, ceilings: FloatArray) -> BoolArray:
    """(L, n) where a light reaches a pixel, and its value is not clipped."""
    relative = light / np.linalg.norm(lights, axis=1).astype(np.float32)[:, None]
    usable = light < ceilings[:, None]
    peak = np.max(relative, axis=0, where=usable, initial=1e-20)
    # a light is in shadow where its image is below this part of the brightest one's
    return np.asarray((relative > 0.1 * peak) & usable)


class _Comparison:
    """K photographs (K, H, W), and what the rest predict of each at the n pixels of the object."""

    def __init__(
        self, images: FloatArray, lights: Array, inside: BoolArray, ceilings: FloatArray
    ) -> None:
        self.images = np.minimum(images, ceilings[:, None, None])
        self.inside = inside
        light = images[:, inside]
        vectors = lights.astype(np.float32)
        lit = _lit_values(light, vectors, ceilings)
        weights = lit.astype(np.float32)
        factors = factorise(moment_matrix(vectors, weights))
        self.g = back_substitute(
            factors, moment_vector(np.where(lit, light, 0.0), vectors, weights)
        )
        self.residual = (np.where(lit, light, 0.0) - shading(self.g, vectors)) * weights
        ones = np.ones(light.shape[1], dtype=np.float32)
        self.pull = np.stack(
            [back_substitute(factors, vector[:, None] * ones) for vector in vectors]
        )
        leverage = (
            np.stack([vector @ pull for vector, pull in zip(vectors, self.pull, strict=True)])
            * weights
        )
        self.count = weights.sum(axis=0)
        self.good = lit & (leverage < _MOST_LEVERAGE) & (self.count >= LEAST_PHOTOGRAPHS)
        # difference of each photograph to its prediction by the rest (Cook 1977)
        self.deleted = np.where(
            self.good, self.residual / np.maximum(1 - leverage, 1 - _MOST_LEVERAGE), 0.0
        )
        # where one of few lights ends, the prediction has a step
        self.steady = np.ones(inside.shape, dtype=bool)
        for each in lit if len(lit) < _MANY else ():
            plane = np.zeros(inside.shape, dtype=np.uint8)
            plane[inside] = each
            self.steady &= cv2.erode(plane, _SQUARE) == cv2.dilate(plane, _SQUARE)

    @property
    def left(self) -> float:
        """Light that a matt surface under these lights leaves unexplained at 80 % of the values, at
        most, as a fraction."""
        mean = float(self.images[:, self.inside][self.good].mean()) if self.good.any() else 0.0
        left = np.abs(self.residual[self.good])
        return float(np.quantile(left, 0.8) / max(mean, 1e-12)) if mean else 1.0

    def turned_deg(self, k: int) -> float:
        """Median angle between the normals with photograph k and without it."""
        good = self.good[k]
        if not good.any():
            return 0.0
        without = self.g[:, good] - self.pull[k][:, good] * self.deleted[k, good]
        return median_angle_deg(unit_normals(self.g[:, good])[0].T, unit_normals(without)[0].T)

    def worst(self) -> tuple[PhotographFault | None, float]:
        """The photograph that fits least, if any does not fit, and how far it stands out."""
        pixels, explained = np.array([self._derivatives(k) for k in range(len(self.images))]).T
        k = int(np.argmax(explained))
        evidence = float(pixels[k] * explained[k] / max(np.median(explained), 1e-30))
        if pixels[k] > _FAULT_PX and evidence > _STANDS_OUT:
            kind, size = self._named(k)
            turned_deg = self.turned_deg(k)
            unlike = size > 0.5 * _UNLIKE_LIGHT and turned_deg > _UNLIKE_DEG
            # gloss on ribs changes their contrast as a blur of up to this sigma would
            if {"unlike": unlike, "blurred": size > 1.5}.get(kind, True):
                return PhotographFault(k, kind, size, turned_deg), evidence
        influence = (self.deleted * self.residual).sum(axis=1, where=self.good)
        spare = np.maximum(self.count - 3, 1)
        total = float((self.residual**2).sum())
        even = 1.0 / max(float(np.mean(spare)), 1.0)
        beyond = (influence / max(total, 1e-30) - even) / max(1.0 - even, 1e-6)
        k = int(np.argmax(beyond))
        rms = float(np.sqrt(total / max(float(spare.sum()), 1.0)))
        level = rms / max(float(np.mean(self.images[k], where=self.inside)), 1e-12)
        turned_deg = self.turned_deg(k)
        unlike = beyond[k] > _UNLIKE_PART and level > _UNLIKE_LIGHT and turned_deg > _UNLIKE_DEG
        return PhotographFault(k, "unlike", level, turned_deg) if unlike else None, 0.0

    def _pair(self, k: int) -> tuple[FloatArray, FloatArray, BoolArray]:
        """A photograph, smoothed, what the rest predict, at its brightness, and where both are
        known."""
        image = self.images[k]
        valid = np.zeros(self.inside.shape, dtype=np.uint8)
        valid[self.inside] = self.good[k]
        predicted = image.copy()
        predicted[self.inside] -= self.deleted[k]
        near, near_predicted = (
            cv2.stackBlur(each * valid, (_LOCAL_PX, _LOCAL_PX)) for each in (image, predicted)
        )
        ratio = np.where(valid > 0, near / np.maximum(near_predicted, 1e-9), 1.0)
        known = (cv2.erode(valid, _SQUARE, borderValue=0) > 0) & self.steady
        return _smooth(image), predicted * np.clip(ratio, 0.2, 5.0), known

    def _derivatives(self, k: int) -> tuple[float, float]:
        """Pixels of shift and blur in a photograph's difference to its prediction, times the
        fraction that they explain; and the squared light that they explain, over the squared light.
        """
        target, predicted, known = self._pair(k)
        if known.sum() < _FEWEST_COMPARED:
            return 0.0, 0.0
        model = _smooth(predicted)
        dy, dx = np.gradient(model)
        laplacian = np.gradient(dy, axis=0) + np.gradient(dx, axis=1)
        every = max(1, int(known.sum()) // _FITTED)
        terms = np.stack([model, dx, dy, laplacian])[:, known][:, ::every]
        terms = terms.astype(np.float64)
        light = target[known][::every]
        difference = light - terms[0]
        weights = np.ones(difference.size)
        for _ in range(6):
            normal = (terms * weights) @ terms.T
            solution = np.linalg.lstsq(normal, (terms * weights) @ difference, rcond=1e-12)[0]
            error = difference - solution @ terms
            weights = cauchy(error, max(3.0 * float(np.median(np.abs(error))), 1e-9))
        gain = float(weights @ (terms[0] * difference)) / max(float(weights @ terms[0] ** 2), 1e-30)
        before = float(weights @ (difference - gain * terms[0]) ** 2)
        after = float(weights @ error**2)
        level = float(weights.sum()) * max(float(light.mean()), 1e-12) ** 2
        size = float(np.sqrt(solution[1] ** 2 + solution[2] ** 2 + max(solution[3], 0.0)))
        return max(1.0 - after / max(before, 1e-30), 0.0) * size, (before - after) / level

    def _named(self, k: int) -> tuple[Fault, float]:
        """What explains photograph k best: its prediction moved, blurred, or seen twice; and by how
        many pixels."""
        target, predicted, known = self._pair(k)

        def misfit(model: Any) -> float:
            return float(np.mean(np.abs(target[known] - _smooth(model)[known])))

        def moved(x: float, y: float) -> FloatArray:
            matrix = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
            size = predicted.shape[::-1]
            return np.asarray(
                cv2.warpAffine(predicted, matrix, size, borderMode=cv2.BORDER_REPLICATE)
            )

        def best(model: Callable[[float, float], FloatArray]) -> tuple[float, float]:
            coarse = product(range(-8, 9, 2), repeat=2)
            _, _, x, y = min((misfit(model(x, y)), float(np.hypot(x, y)), x, y) for x, y in coarse)
            fine = (
                (x + right, y + down)
                for right, down in product((-1.0, -0.5, 0.0, 0.5, 1.0), repeat=2)
            )
            return min((misfit(model(*shift)), float(np.hypot(*shift))) for shift in fine)

        sigmas = np.arange(1.0, 6.5, 0.5)
        misfits: dict[Fault, tuple[float, float]] = {
            "moved": best(moved),
            "blurred": min(
                (misfit(cv2.GaussianBlur(predicted, (0, 0), sigma)), sigma) for sigma in sigmas
            ),
            "double": best(lambda x, y: 0.5 * (predicted + moved(x, y))),
        }
        kind = min(misfits, key=lambda each: misfits[each])
        if kind == "double" and misfits[kind][0] > _DOUBLE_LEAVES * misfits["moved"][0]:
            kind = "moved"  # a small shift looks like twice as far a double image
        least, size = misfits[kind]
        unexplained = misfit(predicted)
        # fraction of the mean difference that a named fault may leave; else the photograph is
        # unlike the rest
        if least > 0.85 * unexplained:
            return "unlike", unexplained / max(float(np.mean(target[known])), 1e-12)
        return kind, size


def _smooth(image: FloatArray) -> FloatArray:
    # blur (sigma) before derivatives: noise is not to look like sharpness
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0))


def left_out(band: Light, finger: Finger) -> tuple[Light, list[Finding]]:
    """A band of an opaque object without the photographs that do not fit the others, and notes on
    them."""
    values = band.photographs * finger.inside.size
    # values of all photographs that are compared with each other, at most; larger ones are binned
    binning = max(1, int(np.ceil(np.sqrt(values / 4_000_000))))
    light, inside, _ = in_blocks(band, finger.wider, finger.window, binning)
    if len(band.lights) != band.photographs or band.polarised or not inside.any():
        return band, []  # they are not comparable
    stack = light.grey
    levels = band.clips_at
    lights = band.rig.light_vectors()
    faults = faulty_photographs(stack, lights, inside, levels)
    effect = "it was left out, and would have turned the normals by {:.2g} deg (median)"
    notes = [_fault_finding(band, fault, binning, effect) for fault in faults]
    out = {fault.photograph for fault in faults if fault.kind != "overexposed"}
    return band.of_images([k for k in range(len(stack)) if k not in out]) if out else band, notes


def _fault_finding(band: Light, fault: PhotographFault, binning: int, effect: str) -> Finding:
    """What is wrong with a photograph, and its `effect`."""
    name = band.image_names[fault.photograph]
    px = f"{binning * fault.size:.2g} px"
    percent = f"{100 * fault.size:.2g} %"
    words = {
        "overexposed": f"is overexposed: {percent} of the surface is clipped, which is not used",
        "moved": f"is shifted by {px} against the others",
        "blurred": f"is blurred by {px} (sigma) against the others",
        "double": f"shows everything twice, {px} apart",
        "underexposed": f"has {percent} of the others' light",
        "unlike": f"does not fit the others: it is {percent} off what they predict",
    }[fault.kind]
    if fault.kind != "overexposed":
        words += f"; {effect.format(fault.effect_deg)}"
    return Finding(
        f"{fault.kind}-photograph",
        f"{name} {words}.",
        files=(name,),
        effect_deg=fault.effect_deg or None,
    )
