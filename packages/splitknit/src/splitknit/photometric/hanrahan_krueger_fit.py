"""Layered skin (Hanrahan and Krueger): its reflection with derivatives, and the least squares of one pixel's unknowns.

Light enters through the surface (Fresnel) and is refracted; what the upper layer (epidermis) scatters once, and the
lower one (dermis, without end) below it, leaves through the surface again; all that is scattered more often is a matt
base. With mu_i, mu_r the cosines of light and view outside and c_i, c_r those of the refracted rays, an image is

    I = strength * mu_i * T(mu_i) T(mu_r) / T(1)^2 * (base + exposure * K),
    K = [W p(q; g) (1 - E) + W' p(q; g') E] / (c_i + c_r),    E = exp(-depth (1 / c_i + 1 / c_r)),

q the cosine between the refracted rays towards light and view, p Henyey and Greenstein's phase function, W the fraction
of an interaction that is scattering and not absorption; primes are the dermis. Arrays hold pixels along their last
axis and everything is elementwise, so that chunking changes no byte.

Parameters, in rows: the normal's two stereographic coordinates f, g (n = (2f, 2g, 1 - f^2 - g^2) / (1 + f^2 + g^2)),
the logarithm of the base over the Lambertian albedo, the logit of the epidermis's scattering fraction W, the logarithm
of its optical depth. The last two are held to what all skin has: seven images see little of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.photometric.equations import unit_normals
from splitknit.settings import Checked, Limits, check_fields

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class SkinLayers(Checked):
    """What all pixels have in common; the defaults are from Hanrahan and Krueger's table of two layers of skin."""

    _group = "layers"
    refractive_index: Annotated[float, Limits(1.05, 2.5)] = 1.5
    """Refractive index of both layers. Skin has 1.37 to 1.5; 1.5 was best on simulated fingers."""
    epidermis_asymmetry: Annotated[float, Limits(-0.95, 0.95)] = 0.79
    """g: mean cosine of the angle by which the epidermis scatters; near 1 is forward."""
    dermis_asymmetry: Annotated[float, Limits(-0.95, 0.95)] = 0.81
    """g' of the dermis."""
    epidermis_scattering_per_mm: Annotated[float, Limits(1e-3, 1e3)] = 50.0
    """Start of each pixel's fit, and prior where the images do not determine it; so are absorption and thickness."""
    epidermis_absorption_per_mm: Annotated[float, Limits(1e-3, 1e3)] = 3.8
    """See scattering."""
    epidermis_thickness_mm: Annotated[float, Limits(1e-3, 1)] = 0.08
    """See scattering; the source's range is 0.001 to 0.15 mm."""
    dermis_scattering_per_mm: Annotated[float, Limits(1e-3, 1e3)] = 21.7
    """Only its fraction of scattering and absorption counts: the dermis has no end."""
    dermis_absorption_per_mm: Annotated[float, Limits(1e-3, 1e3)] = 0.3
    """See scattering."""

    def __post_init__(self) -> None:
        check_fields(self)
        require(
            0.001 <= self.epidermis_fraction <= 0.999 and 0.01 <= self.epidermis_depth <= 100,
            "layers: scattering over scattering and absorption of the epidermis must lie between 0.001 and 0.999, and "
            f"its thickness times both between 0.01 and 100, but they are {self.epidermis_fraction:.4g} and "
            f"{self.epidermis_depth:.4g}.",
        )

    @property
    def epidermis_fraction(self) -> float:
        """W: scattering over scattering and absorption."""
        return self.epidermis_scattering_per_mm / (self.epidermis_scattering_per_mm + self.epidermis_absorption_per_mm)

    @property
    def epidermis_depth(self) -> float:
        """Thickness in mean free paths."""
        return self.epidermis_thickness_mm * (self.epidermis_scattering_per_mm + self.epidermis_absorption_per_mm)

    @property
    def dermis_fraction(self) -> float:
        """W': scattering over scattering and absorption."""
        return self.dermis_scattering_per_mm / (self.dermis_scattering_per_mm + self.dermis_absorption_per_mm)


def _refracted(cosine: Array, index: float) -> tuple[Array, Array]:
    """Cosine inside of a ray with `cosine` outside, and its derivative (Snell)."""
    inside = np.sqrt(1.0 - (1.0 - cosine * cosine) / index**2)
    return inside, cosine / (index**2 * inside)


def _transmitted(cosine: Array, inside: Array, index: float) -> tuple[Array, Array]:
    """Fraction of unpolarised light that passes the surface, T, and dT / d cosine (Fresnel)."""
    across, along = cosine + index * inside, index * cosine + inside
    across2, along2 = 1.0 / (across * across), 1.0 / (along * along)
    share = (2.0 * index) * cosine * inside * (across2 + along2)
    slope = (2.0 * (index**2 - 1.0) / index) / inside
    # r_s and r_p, and T = 1 - (r_s^2 + r_p^2) / 2
    change = slope * ((index * inside - cosine) * across2 / across + (inside - index * cosine) * along2 / along)
    return share, change


def _scattered(cosine: Array, asymmetry: float) -> tuple[Array, Array]:
    """Phase function back towards the viewer per steradian, and its derivative.

    `cosine` is that between the rays *towards* light and viewer: the light turns by the angle whose cosine is minus it.
    """
    below = 1.0 + asymmetry**2 + (2.0 * asymmetry) * cosine
    phase = ((1.0 - asymmetry**2) / (4.0 * np.pi)) / (below * np.sqrt(below))
    return phase, (-3.0 * asymmetry) * phase / below


@dataclass(frozen=True, slots=True, eq=False)
class _Reflected:
    """Images (L, n) of the model for strength one, and their derivatives."""

    value: Array
    by_light: Array
    """By mu_i, the normal's cosine with the light."""
    by_view: Array
    """By mu_r, the normal's cosine with the view."""
    by_base: Array
    by_fraction: Array
    """By W of the epidermis."""
    by_depth: Array
    """By the epidermis's optical depth."""


def reflected(  # noqa: PLR0917 - the model's own variables
    to_light: Array, to_view: Array, between: Array, base: Array, share: Array, depth: Array, exposure: float,
    layers: SkinLayers,
) -> _Reflected:  # fmt: skip
    """The two-layer model and its derivatives.

    Source: P. Hanrahan and W. Krueger, "Reflection from layered surfaces due to subsurface scattering", SIGGRAPH 1993:
    first order solution for the backscattered radiance, Henyey and Greenstein's phase function, Fresnel's coefficients.
    W. Xie, Z. Song and R. C. Chung, "Real-time three-dimensional fingerprint acquisition via a new photometric stereo
    means", Optical Engineering 52 (2013): single scattering over a matt base for fingers.

    Parameters
    ----------
    to_light : (L, n); mu_i; where it is not positive the light is behind the surface, and everything is zero
    to_view : (n,); mu_r, positive
    between : (L, 1) or (L, n); cosine between the directions towards light and view, outside
    base, share, depth : (n,); matt base in units of the images; W and optical depth of the epidermis
    exposure : units of the images for a radiance factor K of one
    """
    index = layers.refractive_index
    lit = to_light > 0
    mu = np.where(lit, to_light, np.ones((), dtype=to_light.dtype))
    inside, inside_by = _refracted(mu, index)
    outside, outside_by = _refracted(to_view, index)
    enters, enters_by = _transmitted(mu, inside, index)
    facing = (4.0 * index / (1.0 + index) ** 2) ** 2
    leaves, leaves_by = _transmitted(to_view, outside, index)
    leaves, leaves_by = leaves / facing, leaves_by / facing

    turn = (between - mu * to_view) / index**2 + inside * outside
    upper, upper_by = _scattered(turn, layers.epidermis_asymmetry)
    lower, lower_by = _scattered(turn, layers.dermis_asymmetry)
    lower, lower_by = lower * layers.dermis_fraction, lower_by * layers.dermis_fraction
    passed = np.exp(-depth * (1.0 / inside + 1.0 / outside))
    spread = 1.0 / (inside + outside)
    upper_lit = spread * (1.0 - passed)
    step = (lower - share * upper) * passed * spread
    once = share * upper * upper_lit + lower * passed * spread
    by_turn = share * upper_by * upper_lit + lower_by * passed * spread
    once_by_light = by_turn * (outside * inside_by - to_view / index**2) + inside_by * (
        step * depth / (inside * inside) - once * spread
    )
    once_by_view = by_turn * (inside * outside_by - mu / index**2) + outside_by * (
        step * depth / (outside * outside) - once * spread
    )
    through = np.where(lit, mu * enters, np.zeros((), dtype=mu.dtype))
    front = through * leaves
    level = base + exposure * once
    return _Reflected(
        value=front * level,
        by_light=np.where(lit, leaves, 0.0 * leaves) * (enters + mu * enters_by) * level
        + front * (exposure * once_by_light),
        by_view=through * leaves_by * level + front * (exposure * once_by_view),
        by_base=front,
        by_fraction=front * (exposure * upper * upper_lit),
        by_depth=front * ((-exposure) * step * (1.0 / inside + 1.0 / outside)),
    )


# Levenberg and Marquardt's method for many small problems at once: every pixel has its own damping and its own end.

_DAMPING = 1e-3
"""At the start, relative to the diagonal of the normal equations."""


@dataclass(frozen=True, slots=True)
class LevenbergSettings(Checked):
    """When a pixel's fit ends, and how it is damped."""

    _group = "fit"
    iterations: Annotated[int, Limits(1, 1000)] = 30
    """Maximum number of iterations, rejected steps included."""
    step: Annotated[float, Limits(0, 1, above=True, below=True)] = 1e-3
    """A pixel has converged when no parameter moves by more than this; directions then turn by 0.1 deg at most."""
    gain: Annotated[float, Limits(0, 1, above=True, below=True)] = 1e-5
    """A pixel has also converged when its cost falls by less than this fraction."""


class _NormalEquations(NamedTuple):
    """Cost (n,), gradient J^T r (P, n) and J^T J (P (P + 1) / 2, n), its upper triangle row by row."""

    cost: Array
    gradient: Array
    moments: Array


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Where the fits ended."""

    parameters: Array
    cost: Array
    iterations: Array
    converged: Array


_STEEPER, _FLATTER = 8.0, 0.15
_MIN, _MAX = 1e-7, 1e7


def _levenberg_marquardt(problem: Pixels, start: Array, settings: LevenbergSettings) -> Minimum:
    """Minimise every problem from `start` (P, n).

    All arithmetic is elementwise over n: a problem's result depends on nothing but itself. Source: D. W. Marquardt, "An
    algorithm for least-squares estimation of nonlinear parameters", SIAM J. Appl. Math. 11 (1963); the damping scales
    the diagonal, as he has it.
    """
    best, pixels = start.copy(), np.arange(start.shape[1])
    count = np.full(start.shape[1], settings.iterations, dtype=np.int16)
    done = np.zeros(start.shape[1], dtype=np.bool_)
    here = start.copy()
    known = problem.equations(here)
    cost = known.cost.copy()
    damping = np.full(pixels.size, _DAMPING, dtype=start.dtype)
    for turn in range(1, settings.iterations + 1):
        trial = problem.moved(here, -_solved(known.moments, known.gradient, damping))
        new = problem.equations(trial)
        better = new.cost < known.cost
        moved = np.abs(trial - here).max(axis=0)
        fallen = known.cost - new.cost
        ended = (moved < settings.step) | (better & (fallen < settings.gain * known.cost)) | (damping >= _MAX)
        here = np.where(better, trial, here)
        known = _NormalEquations(*(np.where(better, n, k) for n, k in zip(new, known, strict=True)))
        factor = np.where(better, np.asarray(_FLATTER, start.dtype), np.asarray(_STEEPER, start.dtype))
        damping = np.clip(damping * factor, _MIN, _MAX)
        if ended.any():
            over = pixels[ended]
            best[:, over], cost[over], count[over], done[over] = here[:, ended], known.cost[ended], turn, True
            on = np.flatnonzero(~ended)
            if not on.size:
                break
            pixels, here, damping, problem = pixels[on], here[:, on], damping[on], problem.take(on)
            known = _NormalEquations(*(part[..., on] for part in known))
    else:
        best[:, pixels], cost[pixels] = here, known.cost
    return Minimum(best, cost, count, done)


def _solved(moments: Array, gradient: Array, damping: Array) -> Array:
    """(M + damping diag M)^-1 g for every column, by elimination without pivoting (M is positive definite)."""
    size = gradient.shape[0]
    matrix: dict[tuple[int, int], Array] = {}
    index = 0
    for i in range(size):
        for j in range(i, size):
            matrix[i, j] = moments[index] * (1.0 + damping) + 1e-20 if i == j else moments[index]
            index += 1
    right = list(gradient)
    inverse: list[Array] = []
    for i in range(size):
        # rounding must not make a pivot vanish or turn it round
        pivot = moments[i * size - i * (i - 1) // 2]  # (i, i) in the upper triangle
        least = matrix[i, i] if i == 0 else np.maximum(matrix[i, i], 1e-6 * pivot + 1e-20)
        inverse.append(1.0 / least)
        for j in range(i + 1, size):
            factor = matrix[i, j] * inverse[i]
            for k in range(j, size):
                matrix[j, k] = matrix[j, k] - factor * matrix[i, k]
            right[j] = right[j] - factor * right[i]
    result = np.empty_like(gradient)
    for i in reversed(range(size)):
        total = right[i]
        for j in range(i + 1, size):
            total = total - matrix[i, j] * result[j]
        np.multiply(total, inverse[i], out=result[i])
    return result


_STEEPEST = 0.97
"""Largest f^2 + g^2: 89 deg of slant."""
_LONGEST = np.array([0.25, 0.25, 0.7, 2.0, 1.5])
"""Longest step of every parameter."""
_LOW = np.array([-np.inf, -np.inf, -4.0, -9.0, -6.0])
_HIGH = np.array([np.inf, np.inf, 4.0, 9.0, 5.0])


@dataclass(frozen=True, slots=True)
class HanrahanKruegerSettings(Checked):
    """Photometric stereo of two-layer skin."""

    layers: SkinLayers = field(default_factory=SkinLayers)
    """What all pixels have in common."""
    base_reflectance: Annotated[float, Limits(0.01, 1)] = 0.45
    """Fraction of the light that the skin's matt base gives back, taken for the median pixel: it sets the images' scale
    against the layers' single scattering, which the exposure leaves unknown."""
    noise: Annotated[float, Limits(1e-4, 100)] = 0.02
    """Standard deviation of an image, relative to the albedo: how much a residual counts against the two spreads."""
    spread_share: Annotated[float, Limits(1e-4, 100)] = 1.0
    """Standard deviation of the logit of the epidermis's W over the pixels; small: the same everywhere."""
    spread_depth: Annotated[float, Limits(1e-4, 100)] = 0.7
    """Standard deviation of the logarithm of its optical depth; small: the same everywhere."""
    weights: Literal["robust", "equal"] = "robust"
    """``robust``: shadowed and glossy lights lose weight as in the method of that name; ``equal``: none does, as the
    source has it."""
    fit: LevenbergSettings = field(default_factory=LevenbergSettings)
    """When a pixel's fit ends."""


@dataclass(frozen=True, slots=True, eq=False)
class Pixels:
    """The problems of n pixels."""

    images: Array
    """(L, n)."""
    trust: Array
    """(L, n): root of a light's weight over the noise in units of the images."""
    lights: Array
    """(L, 3, 1) or (L, 3, n): unit directions towards the lights."""
    strengths: Array
    """(L, 1) or (L, n)."""
    albedo: Array
    """(n,) of the Lambertian fit, positive."""
    exposure: float
    settings: HanrahanKruegerSettings

    def start(self, normals: Array) -> Array:
        """(5, n): normals (3, n), the Lambertian albedo and the layers of all skin."""
        result = np.zeros((5, normals.shape[1]), dtype=self.images.dtype)
        result[:2] = normals[:2] / (1.0 + np.maximum(normals[2], 0.0))
        result[:2] *= self._inside(result)
        result[3], result[4] = self._prior()
        return result

    def equations(self, parameters: Array) -> _NormalEquations:
        """Weighted squares of the residuals over the noise, and of the layers' distance from all skin's."""
        normals, by_f, by_g = directions(parameters)
        fraction = 1.0 / (1.0 + np.exp(-parameters[3]))
        depth, base = np.exp(parameters[4]), self.albedo * np.exp(parameters[2])
        to_light = _dots(self.lights, normals)
        model = reflected(
            to_light, normals[2], self.lights[:, 2], base, fraction, depth, self.exposure, self.settings.layers
        )
        scale = self.strengths * self.trust
        residual = model.value * scale - self.images * self.trust
        slopes = (
            scale * (model.by_light * _dots(self.lights, by_f) + model.by_view * by_f[2]),
            scale * (model.by_light * _dots(self.lights, by_g) + model.by_view * by_g[2]),
            scale * (model.by_base * base),
            scale * (model.by_fraction * (fraction * (1.0 - fraction))),
            scale * (model.by_depth * depth),
        )
        cost = _summed(residual, residual)
        gradient = np.stack([_summed(slope, residual) for slope in slopes])
        moments = np.stack([_summed(slopes[i], slopes[j]) for i in range(5) for j in range(i, 5)])
        for row, spread, prior, place in zip(
            (3, 4), (self.settings.spread_share, self.settings.spread_depth), self._prior(), (12, 14), strict=True
        ):
            away = (parameters[row] - prior) / spread
            cost = cost + away * away
            gradient[row] += away / spread
            moments[place] += 1.0 / spread**2
        return _NormalEquations(cost, gradient, moments)

    def held(self, parameters: Array) -> Array:
        """The part of the cost that is the layers' distance from all skin's, (n,)."""
        fraction, depth = self._prior()
        return np.asarray(
            ((parameters[3] - fraction) / self.settings.spread_share) ** 2
            + ((parameters[4] - depth) / self.settings.spread_depth) ** 2
        )

    def moved(self, parameters: Array, step: Array) -> Array:
        """Parameters after `step`, no parameter further than its longest step, inside the hemisphere and the bounds."""
        kind = parameters.dtype
        longest = _LONGEST[:, None].astype(kind)
        shorter = np.minimum(1.0, (longest / np.maximum(np.abs(step), 1e-20)).min(axis=0))
        result = np.clip(parameters + step * shorter, _LOW[:, None].astype(kind), _HIGH[:, None].astype(kind))
        result[:2] *= self._inside(result)
        return np.asarray(result)

    def take(self, kept: Array) -> Pixels:
        """The pixels of some indices."""
        near = self.lights.shape[2] > 1
        lights, strengths = (
            (self.lights[:, :, kept], self.strengths[:, kept]) if near else (self.lights, self.strengths)
        )
        images, trust, albedo = self.images[:, kept], self.trust[:, kept], self.albedo[kept]
        return Pixels(images, trust, lights, strengths, albedo, self.exposure, self.settings)

    def _prior(self) -> tuple[float, float]:
        fraction = self.settings.layers.epidermis_fraction
        return float(np.log(fraction / (1.0 - fraction))), float(np.log(self.settings.layers.epidermis_depth))

    @staticmethod
    def _inside(parameters: Array) -> Array:
        square = parameters[0] * parameters[0] + parameters[1] * parameters[1]
        return np.asarray(np.minimum(1.0, np.sqrt(_STEEPEST / np.maximum(square, 1e-20))), dtype=parameters.dtype)


def directions(parameters: Array) -> tuple[Array, Array, Array]:
    """Unit normals (3, n) of f and g, and their derivatives by f and by g."""
    f, g = parameters[0], parameters[1]
    twice = 2.0 / (1.0 + f * f + g * g)  # 1 + nz
    x, y = f * twice, g * twice
    normals = np.stack([x, y, twice - 1.0])
    mixed = -x * y
    return normals, np.stack([twice - x * x, mixed, -twice * x]), np.stack([mixed, twice - y * y, -twice * y])


def fitted(pixels: Pixels, g: Array) -> tuple[Array, Minimum]:
    """Normals (3, n) and the minimum, from the Lambertian albedo-scaled normals `g` (3, n)."""
    normals, _ = unit_normals(g)
    minimum = _levenberg_marquardt(pixels, pixels.start(normals), pixels.settings.fit)
    return directions(minimum.parameters)[0], minimum


def _dots(lights: Array, vectors: Array) -> Array:
    """(L, n) scalar products of lights (L, 3, 1 or n) with vectors (3, n), summed in one order."""
    return np.asarray(lights[:, 0] * vectors[0] + lights[:, 1] * vectors[1] + lights[:, 2] * vectors[2])


def _summed(first: Array, second: Array) -> Array:
    """Sum over the lights, one after the other."""
    total = first[0] * second[0]
    for k in range(1, first.shape[0]):
        total += first[k] * second[k]
    return np.asarray(total)
