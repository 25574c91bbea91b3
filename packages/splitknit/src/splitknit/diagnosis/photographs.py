"""Photographs against each other: which of them does not fit the others.

Each photograph is predicted from the others, by least squares of the lights that reach a pixel. A sound one differs
from that by gloss and noise; a shift, a blur and a double image differ by derivatives of the prediction, which gives
them a size in pixels. The photograph that such a fault explains best is left out, and the rest compared again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np

from splitknit.diagnosis.frames import SPOILT_DEG
from splitknit.diagnosis.gains import LEAST, PIXELS, checked, light_gains, lit_values
from splitknit.diagnosis.samples import sampled_light
from splitknit.errors import BadInput, check_lights
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.imaging.band import bin_mean, linear_stack, saturation_levels
from splitknit.model import Array, Band, BoolArray, Capture, FloatArray
from splitknit.photometric.equations import (
    back_substitute,
    factorise,
    moment_matrix,
    moment_vector,
    shading,
    unit_normals,
)

OVEREXPOSED = (
    "{:.1f} % of the surface is overexposed in all photographs but two or fewer: its slopes there are unknown; "
    "photograph it again with a shorter exposure."
)
Fault = Literal["moved", "blurred", "double", "overexposed", "underexposed", "unlike"]
_MOST_LEVERAGE = 0.9
"""Above it the other lights hardly predict a light."""
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
_COMPARED_VALUES = 4_000_000
"""Values of all photographs that are compared with each other, at most; larger ones are binned."""
_FEW_CLIPPED = 0.002
NOTED_DEG = 0.5
"""A fault of one photograph of skin is noted if it turns the surface by more."""


@dataclass(frozen=True, slots=True)
class PhotographFault:
    """One photograph that does not fit the others."""

    photograph: int
    kind: Fault
    size: float
    """Pixels of the given stack (of a blur its sigma); of exposures and ``unlike`` a fraction."""
    effect_deg: float
    """By how much the photograph turns the normals, median; 0 of clipped values, which are not used."""


def light_left(stack: Any, lights: Any, mask: Any = None, ceilings: Any = None) -> float:
    """Part of the light that a matt surface under these lights leaves unexplained at 80 % of the values, at most."""
    images, vectors, inside, levels = checked(stack, lights, mask, ceilings)
    fit = _Compared(images, vectors, inside, levels).looked_at(list(range(len(images))))
    light = images[:, inside][fit.good]
    if not light.size:
        return 1.0
    return float(np.quantile(np.abs(fit.residual[fit.good]), 0.8) / max(float(light.mean()), 1e-12))


def faulty_photographs(stack: Any, lights: Any, mask: Any = None, ceilings: Any = None) -> tuple[PhotographFault, ...]:
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

    Raises
    ------
    BadInput
        As :func:`splitknit.photometric.lambertian.lambertian`.

    References
    ----------
    R. D. Cook, "Detection of influential observation in linear regression", Technometrics 19 (1977), for the residual
    of what is left out; B. D. Lucas and T. Kanade, "An iterative image registration technique", IJCAI 1981, for shifts.
    """
    images, vectors, inside, levels = checked(stack, lights, mask, ceilings)
    if len(images) <= LEAST or inside.sum() < _FEWEST:
        return ()
    clipped = ((images >= levels[:, None, None]) & inside).reshape(len(images), -1).sum(axis=1) / inside.sum()
    gains = light_gains(images, vectors, inside, levels)
    scaled = _Compared(images, vectors * gains[:, None], inside, levels)
    kept, faults = list(range(len(images))), []
    for k in np.flatnonzero(clipped > _CLIPPED).tolist():
        faults.append(PhotographFault(k, "overexposed", float(clipped[k]), 0.0))
    dim = gains / np.median(gains)
    for k in np.flatnonzero(dim < _FAINT).tolist():
        if len(kept) > LEAST:
            faults.append(PhotographFault(k, "underexposed", float(dim[k]), scaled.looked_at(kept).turned(k)))
            kept.remove(k)
    while len(kept) > LEAST:
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
        lit = lit_values(light, vectors, self.ceilings[kept])
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
        some = np.flatnonzero(known)[:: max(1, int(known.sum()) // PIXELS)]
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


def compared_pixels(band: Band, finger: Finger) -> tuple[int, BoolArray] | None:
    """By how much photographs are reduced to be compared, and the object there; None where they are not comparable."""
    rows, columns = finger.window
    values = len(band.pixels) * (rows.stop - rows.start) * (columns.stop - columns.start)
    binning = max(1, int(np.ceil(np.sqrt(values / _COMPARED_VALUES))))
    inside = bin_mean(finger.inside.astype(np.float32), binning) > 0.99
    comparable = len(band.lights) == len(band.pixels) and band.crossed is None and not band.polarisation
    return (binning, inside) if comparable and inside.any() else None


def left_out(
    capture: Capture, band: Band, finger: Finger, binning: int, inside: BoolArray
) -> tuple[Band, list[Finding], list[Any]]:
    """A band of an opaque thing without the photographs that do not fit the others; notes on them; and their names,
    faults and turns of the normals.
    """
    stack = linear_stack(band, capture.encoding, "grey", finger.window, binning)
    levels = saturation_levels(band, capture.encoding)
    lights = capture.rig.select(band.lights).light_vectors()
    faults = faulty_photographs(stack, lights, inside, levels)
    turned = "it was left out, and would have turned the normals by {:.2g} deg (median)"
    notes = [_fault_finding(band, fault, binning, turned) for fault in faults]
    clipped = (stack >= levels[:, None, None]).sum(axis=0)[inside] > len(stack) - 3
    if clipped.mean() > _FEW_CLIPPED:
        notes.append(Finding("overexposed-surface", OVEREXPOSED.format(100 * clipped.mean())))
    facts = [[band.image_names[fault.photograph], fault.kind, round(fault.effect_deg, 2)] for fault in faults]
    out = {fault.photograph for fault in faults if fault.kind != "overexposed"}
    kept = [k for k in range(len(stack)) if k not in out]
    return band.of_images(kept) if out else band, notes, facts


def faulty_photograph(capture: Capture, band: Band, finger: Finger) -> Finding | None:
    """The photograph of skin that fits the others least, if it turns the surface."""
    stack, vectors, some = sampled_light(capture, band)
    faults = faulty_photographs(stack, vectors, finger.wider[some], saturation_levels(band, capture.encoding))
    # highlights are overexposed, and no method takes them for skin
    bad = [fault for fault in faults if fault.kind != "overexposed" and fault.effect_deg > NOTED_DEG]
    if not bad:
        return None
    fault = max(bad, key=lambda each: each.effect_deg)
    finding = _fault_finding(band, fault, some[0].step, "it turns the surface by {:.1f} deg (median); capture it again")
    return replace(finding, severity=Severity.SPOILS if fault.effect_deg > SPOILT_DEG else Severity.DOUBT)


def _fault_finding(band: Band, fault: PhotographFault, binning: int, effect: str) -> Finding:
    """What is wrong with a photograph, and its `effect`."""
    name = band.image_names[fault.photograph]
    px, percent = f"{binning * fault.size:.2g} px", f"{100 * fault.size:.2g} %"
    what = {
        "overexposed": f"is overexposed: {percent} of the surface is clipped, which is not used",
        "moved": f"is shifted by {px} against the others",
        "blurred": f"is blurred by {px} (sigma) against the others",
        "double": f"shows everything twice, {px} apart",
        "underexposed": f"has {percent} of the others' light",
        "unlike": f"does not fit the others: it is {percent} off what they predict",
    }[fault.kind]
    words = f"{name} {what}" if fault.kind == "overexposed" else f"{name} {what}; {effect.format(fault.effect_deg)}"
    return Finding(f"{fault.kind}-photograph", f"{words}.", files=(name,), effect_deg=fault.effect_deg or None)
