"""What two layers of skin reflect: the model of Hanrahan and Krueger, and how it changes with everything it depends on.

Light enters through the surface (Fresnel) and is refracted; what the upper layer (epidermis) scatters once, and the
lower one (dermis, without end) below it, leaves through the surface again; all that is scattered more often is a matt
base. With mu_i, mu_r the cosines of light and view outside and c_i, c_r those of the refracted rays, an image is

    I = strength * mu_i * T(mu_i) T(mu_r) / T(1)^2 * (base + exposure * K),
    K = [W p(q; g) (1 - E) + W' p(q; g') E] / (c_i + c_r),    E = exp(-depth (1 / c_i + 1 / c_r)),

q the cosine between the refracted rays towards light and view, p Henyey and Greenstein's phase function, W the fraction
of an interaction that is scattering and not absorption; primes are the dermis. Arrays hold pixels along their last
axis and everything is elementwise, so that chunking changes no byte.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class SkinLayers:
    """What all pixels have in common; the defaults are from Hanrahan and Krueger's table of two layers of skin."""

    refractive_index: float = 1.5
    """Of both layers; theirs is 1.37 to 1.5, of which the largest was best on fingers of the twin."""
    epidermis_asymmetry: float = 0.79
    """g: mean cosine of the angle by which the epidermis scatters; near 1 is forward."""
    dermis_asymmetry: float = 0.81
    """g' of the dermis."""
    epidermis_scattering_per_mm: float = 50.0
    """With absorption and thickness: where a pixel's fit starts, and what holds it where its images do not."""
    epidermis_absorption_per_mm: float = 3.8
    """See scattering."""
    epidermis_thickness_mm: float = 0.08
    """See scattering; theirs is 0.001 to 0.15 mm."""
    dermis_scattering_per_mm: float = 21.7
    """Only its fraction of scattering and absorption counts: the dermis has no end."""
    dermis_absorption_per_mm: float = 0.3
    """See scattering."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("refractive_index", 1.05, 2.5),
            ("epidermis_asymmetry", -0.95, 0.95),
            ("dermis_asymmetry", -0.95, 0.95),
            ("epidermis_scattering_per_mm", 1e-3, 1e3),
            ("epidermis_absorption_per_mm", 1e-3, 1e3),
            ("epidermis_thickness_mm", 1e-3, 1.0),
            ("dermis_scattering_per_mm", 1e-3, 1e3),
            ("dermis_absorption_per_mm", 1e-3, 1e3),
        ):
            value = getattr(self, name)
            require(
                bool(np.isfinite(value)) and low <= value <= high,
                f"layers.{name} must lie between {low:g} and {high:g}, but it is {value}.",
            )

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
    fraction = (2.0 * index) * cosine * inside * (across2 + along2)
    slope = (2.0 * (index**2 - 1.0) / index) / inside
    # r_s and r_p, and T = 1 - (r_s^2 + r_p^2) / 2
    change = slope * ((index * inside - cosine) * across2 / across + (inside - index * cosine) * along2 / along)
    return fraction, change


def _scattered(cosine: Array, asymmetry: float) -> tuple[Array, Array]:
    """Phase function back towards the viewer per steradian, and its derivative.

    `cosine` is that between the rays *towards* light and viewer: the light turns by the angle whose cosine is minus it.
    """
    below = 1.0 + asymmetry**2 + (2.0 * asymmetry) * cosine
    phase = ((1.0 - asymmetry**2) / (4.0 * np.pi)) / (below * np.sqrt(below))
    return phase, (-3.0 * asymmetry) * phase / below


@dataclass(frozen=True, slots=True, eq=False)
class Reflected:
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
    to_light: Array, to_view: Array, between: Array, base: Array, fraction: Array, depth: Array, exposure: float,
    layers: SkinLayers,
) -> Reflected:  # fmt: skip
    """The two-layer model and its derivatives.

    Parameters
    ----------
    to_light : (L, n)
        mu_i; where it is not positive the light is behind the surface, and everything is zero.
    to_view : (n,)
        mu_r, positive.
    between : (L, 1) or (L, n)
        Cosine between the directions towards light and view, outside.
    base, fraction, depth : (n,)
        Matt base in units of the images; W and optical depth of the epidermis.
    exposure : float
        Units of the images for a radiance factor K of one.
    layers : SkinLayers

    References
    ----------
    P. Hanrahan and W. Krueger, "Reflection from layered surfaces due to subsurface scattering", SIGGRAPH 1993: first
    order solution for the backscattered radiance, Henyey and Greenstein's phase function, Fresnel's coefficients.
    W. Xie, Z. Song and R. C. Chung, "Real-time three-dimensional fingerprint acquisition via a new photometric stereo
    means", Optical Engineering 52 (2013): single scattering over a matt base for fingers.
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
    step = (lower - fraction * upper) * passed * spread
    once = fraction * upper * upper_lit + lower * passed * spread
    by_turn = fraction * upper_by * upper_lit + lower_by * passed * spread
    once_by_light = by_turn * (outside * inside_by - to_view / index**2) + inside_by * (
        step * depth / (inside * inside) - once * spread
    )
    once_by_view = by_turn * (inside * outside_by - mu / index**2) + outside_by * (
        step * depth / (outside * outside) - once * spread
    )
    through = np.where(lit, mu * enters, np.zeros((), dtype=mu.dtype))
    front = through * leaves
    level = base + exposure * once
    return Reflected(
        value=front * level,
        by_light=np.where(lit, leaves, 0.0 * leaves) * (enters + mu * enters_by) * level
        + front * (exposure * once_by_light),
        by_view=through * leaves_by * level + front * (exposure * once_by_view),
        by_base=front,
        by_fraction=front * (exposure * upper * upper_lit),
        by_depth=front * ((-exposure) * step * (1.0 / inside + 1.0 / outside)),
    )
