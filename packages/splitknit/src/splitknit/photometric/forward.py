"""The forward model of photographs of an opaque thing: what every pixel's light depends on, and how
well the model explains the photographs.

A surface of tiny facets sends light to the camera where the facets' normals halve the angle between
light and view (K. E. Torrance and E. M. Sparrow, JOSA 57, 1967). With the lamp's gain its
brightness is ::

    log I = log albedo + log irradiance + log gain + log(n . l) + lobe(angle between n and half
    vector)

with a lobe of any falling shape, the same for all pixels (after N. Alldrin, T. Zickler and D.
Kriegman, "Photometric stereo with non-parametric and spatially-varying reflectance", CVPR 2008).
Matt is a level lobe. The cosine is kept beside the lobe: without it, a lobe on a surface half as
high explains a matt thing under a ring of lights as well. Hypotheses differ in what is free:
normals and albedo always, the lobe, the lamps' gains. They are fitted in turns to some of the
pixels, by robust least squares of the logarithm; then the normals of all, which have three unknowns
each, as under a matt model. Lights are in the pixels' own frames, whose z points to the camera.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splitknit.imaging.robust import cauchy, deviation
from splitknit.model import BoolArray, FloatArray
from splitknit.photometric.equations import length, shading, solve
from splitknit.photometric.robust import robust_fit

_KNOTS = np.deg2rad([0.0, 3, 6, 9, 12, 16, 20, 25, 31, 38, 46, 56, 70])
"""Angles between which the lobe is linear: closer where metal's falls steeply."""
_TABLE = 1024  # angles from 0 to 90 deg at which the lobe is tabulated
_SAMPLED = 2500  # pixels to which lobe and gains are fitted
_LAMP_PRIOR = 1e-3  # part of the mean weight that holds a lamp's gain where nothing shows it
_FEWEST_LIGHTS = 8  # fewer leave little beside normal and lobe
_DARK = 0.01  # a light is in shadow below this part of the brightest one's
_STILL_RAD = 1e-4  # mean step of the normals from which a fit has converged
_GRAZING = 0.05  # cosine below which a light may be in attached shadow, or a surface is unseen
LEAST_MISFIT = 1e-3  # relative, of any fit
_MATT_MISFIT = 0.01  # relative deviation up to which a matt model explains the photographs
GLOSS_LEAVES = 0.7
"""A thing is glossy where a lobe lowers the misfit of the matt model below this fraction of it:
0.02 to 0.33 on metal, lacquer and wax, rendered (validation/objects, glossy) and photographed, 0.68
on DiLiGenT's bear, whose normals come out 0.9 deg nearer."""


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """A hypothesis, fitted to photographs."""

    normals: FloatArray
    """(3, n)."""
    lobe: FloatArray
    """(K,) logarithm of the brightness at the angles of `_KNOTS`, falling; zeros of a matt surface.
    """
    gains: FloatArray
    """(L,) logarithm of the lamps' brightness relative to the stated one, mean zero."""
    misfit: float
    """Relative (robust) deviation of the photographs from the model."""


def fitted_gloss(images: FloatArray, lights: FloatArray) -> Explanation | None:
    """The lobe that explains photographs clearly better than a matt surface does; None where none
    does, or there are fewer than eight lights.

    Parameters
    ----------
    images : (L, n)
        Linear light of pixels; zero where a value is clipped.
    lights : (L, 3) or (L, 3, n)
        Light vectors in the pixels' own frames.
    """
    if len(images) < _FEWEST_LIGHTS or not images.shape[1]:
        return None
    pixels, start = _some_pixels(images, lights)
    matt = pixels.solved(start, 12)
    if matt.misfit < _MATT_MISFIT:
        return None
    glossy = pixels.glossy(start)
    return glossy if glossy.misfit < GLOSS_LEAVES * matt.misfit else None


def matt_misfit(images: FloatArray, lights: FloatArray) -> float:
    """Misfit of the hypothesis ``matt`` of :func:`hypotheses`."""
    pixels, start = _some_pixels(images, lights)
    return pixels.solved(start, 12).misfit


def hypotheses(images: FloatArray, lights: FloatArray) -> dict[str, Explanation]:
    """Photographs explained as ``matt``; ``glossy``, with a lobe; ``unequal``, matt under lamps of
    any brightness; and ``both``. Parameters as of :func:`fitted_gloss`.

    >>> lights = np.array([[0.6, 0, 0.8], [-0.6, 0, 0.8], [0, 0.6, 0.8], [0, -0.6, 0.8], [0, 0, 1]])
    >>> y, x = np.mgrid[-9:10, -9:10] / 24.0
    >>> ball = np.stack([x, y, np.sqrt(1 - x**2 - y**2)]).reshape(3, -1)
    >>> images = (lights @ ball * np.array([[1.0], [1.2], [1], [1], [0.8]])).astype(np.float32)
    >>> fits = hypotheses(images, lights.astype(np.float32))
    >>> fits["matt"].misfit > 0.05, fits["unequal"].misfit < 0.005
    (True, True)
    """
    pixels, start = _some_pixels(images, lights)
    matt = pixels.solved(start, 12)
    glossy = pixels.glossy(start)
    return {
        "matt": matt,
        "glossy": glossy,
        "unequal": pixels.solved(matt, 20, gains=True),
        "both": pixels.solved(glossy, 20, lobe=True, gains=True),
    }


def unequal(images: FloatArray, lights: FloatArray) -> Explanation:
    """The hypothesis ``unequal`` of :func:`hypotheses` alone: each lamp has any brightness."""
    pixels, start = _some_pixels(images, lights)
    return pixels.solved(start, 20, gains=True)


def misfits_by_light(fit: Explanation, images: FloatArray, lights: FloatArray) -> FloatArray:
    """Misfit (L, L) of each photograph, of any brightness, under each light. Parameters as of
    :func:`fitted_gloss`; of few pixels, those of the fit."""
    pixels = _Pixels.of(images, lights)
    residual, _, cosine, lit = pixels._residual(fit.normals, fit.lobe)
    seen = lit.any(axis=0)
    albedo = np.nanmedian(np.where(lit, residual, np.nan)[:, seen], axis=0)
    expected = np.log(cosine[:, seen]) + albedo
    misfits = []
    for bright, reached in zip(pixels.brightness[:, seen], pixels.lit[:, seen], strict=True):
        lit_here = reached | ~reached.any()
        off = bright[lit_here] - expected[:, lit_here]
        off -= np.median(off, axis=1, keepdims=True)
        misfits.append(np.median(np.abs(off), axis=1))
    return np.stack(misfits)


def glossy_fit(images: FloatArray, lights: FloatArray, gloss: Explanation) -> FloatArray:
    """Albedo-scaled normals (3, n), as :func:`splitknit.photometric.robust.robust_fit` has them,
    under a known lobe: each pixel from the start, matt or halfway to the brightest light, from
    which it fits better."""
    lights = _per_pixel(lights, images.shape[1])
    pixels = _Pixels.of(images, lights)
    g = robust_fit(images, lights)
    candidates = [_unit(g), pixels.brightest_half()]
    residuals = [pixels.left(normals, gloss.lobe) for normals in candidates]
    normals = np.where(residuals[0] <= residuals[1], *candidates)
    fit = pixels.solved(replace(gloss, normals=normals), 12)
    return np.asarray(fit.normals * length(g))


def _some_pixels(images: FloatArray, lights: FloatArray) -> tuple[_Pixels, Explanation]:
    """Some of the pixels, and a matt start under equal lamps."""
    every = max(1, images.shape[1] // _SAMPLED)
    images = images[:, ::every]
    lights = _per_pixel(lights[..., ::every] if lights.ndim == 3 else lights, images.shape[1])
    level = np.zeros(len(_KNOTS), dtype=np.float32)
    equal = np.zeros(len(images), dtype=np.float32)
    start = Explanation(_unit(robust_fit(images, lights)), level, equal, np.inf)
    return _Pixels.of(images, lights), start


def _per_pixel(lights: FloatArray, count: int) -> FloatArray:
    return lights if lights.ndim == 3 else np.repeat(lights[..., None], count, axis=2)


def _unit(g: FloatArray) -> FloatArray:
    """Unit normals (3, n) that face the camera."""
    g = g / np.maximum(length(g), 1e-20)
    g[2] = np.maximum(g[2], _GRAZING)
    return np.asarray(g / length(g))


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """Photographs of n pixels, by logarithms."""

    brightness: FloatArray
    """(L, n) logarithm of light over irradiance."""
    towards: FloatArray
    """(L, 3, n) unit vectors to the lights."""
    half: FloatArray
    """(L, 3, n) unit vectors halfway between light and camera."""
    lit: BoolArray
    """(L, n) where a light reaches the pixel and its value is not clipped."""
    weight: FloatArray
    """(L, n) light over that of the brightest."""

    @classmethod
    def of(cls, images: FloatArray, lights: FloatArray) -> _Pixels:
        strength = length(np.moveaxis(lights, 1, 0))
        towards = lights / strength[:, None]
        half = towards.copy()
        half[:, 2] += 1.0
        half /= length(np.moveaxis(half, 1, 0))[:, None]
        relative = images / strength
        peak = np.maximum(relative.max(axis=0), 1e-20)
        lit = relative > _DARK * peak
        return cls(np.log(np.maximum(relative, 1e-12)), towards, half, lit, relative / peak)

    def brightest_half(self) -> FloatArray:
        """(3, n) mean half vector, weighted by the light squared: the normal of a mirror."""
        return _unit(np.einsum("kn,kin->in", np.square(self.weight), self.half))

    def left(self, normals: FloatArray, lobe: FloatArray) -> FloatArray:
        """(n,) mean size of the residuals, the large ones cut at one."""
        residual, _, _, lit = self._residual(normals, lobe, lit_from=0.0)
        residual -= _mean(residual, lit.astype(np.float32))
        return np.asarray(_mean(np.minimum(np.abs(residual), 1.0), lit.astype(np.float32)))

    def glossy(self, start: Explanation) -> Explanation:
        """The better fit of a lobe from two starts: matt normals, and those of a mirror."""
        mirror = replace(start, normals=self.brightest_half())
        fits = [self.solved(each, 25, lobe=True) for each in (start, mirror)]
        return min(fits, key=lambda fit: fit.misfit)

    def solved(
        self, start: Explanation, rounds: int, *, lobe: bool = False, gains: bool = False
    ) -> Explanation:
        """Normals, and `lobe` and `gains` where these are free, by Gauss-Newton and Cauchy
        weights."""
        normals, table, lamps = start.normals, start.lobe, start.gains
        weight: FloatArray = self.lit.astype(np.float32)
        misfit = 1.0
        for _ in range(rounds):
            equal = replace(self, brightness=self.brightness - lamps[:, None])
            if lobe:
                table = equal._lobe(normals, table, weight)
            residual, angle, cosine, lit = equal._residual(normals, table)
            residual -= _mean(residual, weight * lit)
            misfit = max(deviation(residual[lit]), LEAST_MISFIT) if lit.any() else 1.0
            weight = np.where(lit, cauchy(residual, 2.385 * misfit), 0.0).astype(np.float32)
            across, along = _tangents(normals)
            slope = _at(np.gradient(_tabulated(table), np.pi / 2 / (_TABLE - 1)), angle)
            slope /= np.maximum(np.sin(angle), 0.03)
            by_normal = np.ones((*residual.shape[:1], 3, residual.shape[1]), dtype=np.float32)
            for k, tangent in enumerate((across, along)):
                by_normal[:, k] = -slope * shading(tangent, self.half)
                by_normal[:, k] += shading(tangent, self.towards) / cosine
            if gains:
                change = _gains(residual, by_normal, weight)
                lamps = lamps + change
                residual -= change[:, None]
            step = solve(residual, by_normal, weight)[:2]
            # at most 0.1 rad a round
            step *= np.minimum(1.0, 0.1 / np.maximum(length(step), 1e-9))
            normals = _unit(normals + step[0] * across + step[1] * along)
            if not lobe and length(step).mean() < _STILL_RAD:
                break
        return Explanation(normals, table, lamps, misfit)

    def _residual(
        self, normals: FloatArray, lobe: FloatArray, lit_from: float = _GRAZING
    ) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Logarithm of the light over what the model expects, up to the albedo (L, n); angle to
        the half vector; cosine of incidence; and where the light counts."""
        cosine = shading(normals, self.towards)
        lit = self.lit & (cosine > lit_from)
        cosine = np.maximum(cosine, _GRAZING)
        angle = np.arccos(np.clip(shading(normals, self.half), 0.0, 1.0))
        return (
            self.brightness - np.log(cosine) - _at(_tabulated(lobe), angle),
            angle,
            cosine,
            lit,
        )

    def _lobe(self, normals: FloatArray, lobe: FloatArray, weight: FloatArray) -> FloatArray:
        """The falling lobe (K,) that fits best under these normals."""
        residual, angle, _, lit = self._residual(normals, lobe)
        weight = weight * lit
        residual += _at(_tabulated(lobe), angle) - _mean(residual, weight)
        chosen = weight > 0
        angle, residual, weight = angle[chosen], residual[chosen], weight[chosen]
        count = len(_KNOTS)
        below = np.clip(np.searchsorted(_KNOTS, angle, side="right") - 1, 0, count - 2)
        part = np.clip((angle - _KNOTS[below]) / np.diff(_KNOTS)[below], 0.0, 1.0)
        ends = ((below, 1.0 - part), (below + 1, part))
        normal = np.zeros(count * count)
        right = np.zeros(count)
        for knot, share in ends:
            right += np.bincount(knot, weight * share * residual, count)
            for other, rest in ends:
                index = knot * count + other
                normal += np.bincount(index, weight * share * rest, count * count)
        bend = np.diff(np.eye(count), 2, axis=0)
        even = float(weight.sum()) / count
        matrix = normal.reshape(count, count) + even * (2e-3 * bend.T @ bend + 1e-5 * np.eye(count))
        fitted = np.minimum.accumulate(np.linalg.solve(matrix, right))
        return np.asarray(fitted, dtype=np.float32)


def _gains(residual: FloatArray, by_normal: FloatArray, weight: FloatArray) -> FloatArray:
    """Change of the lamps' gains (L,), mean zero, that fits the residuals (L, n) best together with
    normals and albedo, which are eliminated."""
    weighted = weight[:, None] * by_normal
    moments = np.einsum("kin,kjn->nij", weighted, by_normal).astype(np.float64)
    least = 1e-6 * np.trace(moments, axis1=1, axis2=2) + 1e-12  # keeps an unlit pixel solvable
    moments += least[:, None, None] * np.eye(3)
    pull = np.linalg.solve(moments, weighted.transpose(2, 1, 0))
    own = np.einsum("kin,nil->kl", weighted, pull)
    matrix = np.diag(weight.sum(axis=1)) - own
    explained = np.einsum("nik,kn->ni", pull, residual)
    right = (weight * residual).sum(axis=1) - np.einsum("kin,ni->k", weighted, explained)
    matrix += _LAMP_PRIOR * np.trace(matrix) / len(matrix) * np.eye(len(matrix))
    change = np.clip(np.linalg.solve(matrix, right), -0.5, 0.5)
    return np.asarray(change - change.mean(), dtype=np.float32)


def _mean(values: FloatArray, weight: FloatArray) -> FloatArray:
    """Weighted mean (n,) over the lights."""
    return np.asarray((weight * values).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-9))


def _tabulated(lobe: FloatArray) -> FloatArray:
    angles = np.linspace(0.0, np.pi / 2, _TABLE)
    return np.interp(angles, _KNOTS, lobe).astype(np.float32)


def _at(table: FloatArray, angle: FloatArray) -> FloatArray:
    return np.asarray(table[np.rint(angle * ((_TABLE - 1) / (np.pi / 2))).astype(np.intp)])


def _tangents(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (3, n) across normals that face the camera."""
    across = np.stack([normals[2], np.zeros_like(normals[0]), -normals[0]])
    across /= length(across)
    return across, np.cross(normals, across, axis=0)
