"""How far light wanders under the skin: the transfer function of subsurface scattering.

Light that enters a flat half space at one point leaves it around that point. The Fourier transform
of this spot, over its value at zero, is what is left of a pattern of irradiance (and so of the
shading of ridges) at each spatial frequency. By similarity it depends on the frequency over
sigma_t' = sigma_s' + sigma_a and on the albedo sigma_s' / sigma_t' alone; a table of both, made by
random walks (``validation/diffusion/make_table.py``), ships with the package.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Annotated, Any

import numpy as np

from splitknit.model import Array
from splitknit.settings import Checked, Limits

CHANNELS = ("red", "green", "blue", "nir")
SCATTERING_PER_MM = (3.39, 4.12, 5.18, 2.16)
"""Reduced scattering in the channels: 4.6 (wavelength / 500 nm)^-1.42 per mm. Source: Jacques
2013."""
ABSORPTION_PER_MM = (0.030, 0.20, 0.40, 0.020)
"""Absorption in the channels. Source: the simulator's light skin, docs/explain/simulator.md,
"Optics"."""
_COLOUR_TRUST = 0.6
"""How much the absorption in green and blue follows this finger's colour: 0 not at all, 1 fully.
Chosen on: judgement. Range: 0.42 to 0.84 (validation/parameters)."""


@dataclass(frozen=True, slots=True)
class SkinSettings(Checked):
    """Optics of the skin that are assumed where its blur is undone."""

    invert_blur: bool | None = None
    """Undo the blur: None does so where the capture's material is skin."""
    scattering_factor: Annotated[float, Limits(0, above=True)] = 1.0
    """Multiplies the scattering that is assumed in light of all colours."""

    def scattering(self, channel: str) -> float:
        """Reduced scattering per mm in `channel` (``red``, ``green``, ``blue`` or ``nir``)."""
        return SCATTERING_PER_MM[CHANNELS.index(channel)] * self.scattering_factor

    def absorption(self, channel: str, colour: float | None = None) -> float:
        """Absorption per mm in `channel`, adapted to the finger's `colour` (over red, under white
        light) if given.

        The absorption in red is taken as it is; green and blue get what brings the ratio of the
        albedos of :func:`diffusion` to the colour, as far as `_COLOUR_TRUST` says (in the
        logarithm).
        """
        assumed = ABSORPTION_PER_MM[CHANNELS.index(channel)]
        if colour is None or channel not in ("green", "blue"):
            return assumed
        scattering = self.scattering(channel)
        red = diffusion(self.scattering("red"), ABSORPTION_PER_MM[0]).albedo
        usual = diffusion(scattering, assumed).albedo / red
        wanted = red * usual * (max(colour, 1e-3) / usual) ** _COLOUR_TRUST
        trial = np.geomspace(assumed / 4 + 1e-4, assumed * 12 + 1e-2, 60)
        albedo = np.array([diffusion(scattering, float(a)).albedo for a in trial])
        return float(np.exp(np.interp(-wanted, -albedo, np.log(trial))))

    def optics(
        self, channels: Iterable[str], colour: Mapping[str, float] | None = None
    ) -> dict[str, Diffusion]:
        """Transfer function of each channel; `colour`: each white channel's diffuse brightness over
        the first's; of several, the absorption follows it.
        """
        tint = colour if colour is not None and len(colour) > 1 else {}
        return {
            name: diffusion(self.scattering(name), self.absorption(name, tint.get(name)))
            for name in channels
        }


@dataclass(frozen=True, slots=True, eq=False)
class Diffusion:
    """Subsurface scattering in one channel."""

    scattering_per_mm: float
    absorption_per_mm: float
    albedo: float
    """Part of the light that comes out again, for diffuse light that entered."""
    _omega: Array
    _transfer: Array

    def __call__(self, omega_per_mm: Any) -> Array:
        """Gain of an irradiance pattern at radial frequencies in rad/mm (any shape), one at
        zero."""
        return np.asarray(np.interp(omega_per_mm, self._omega, self._transfer))


def diffusion(scattering_per_mm: float, absorption_per_mm: float) -> Diffusion:
    """Transfer function of a half space with a refractive index of 1.42 and a rough boundary, by
    its reduced scattering coefficient sigma_s', above zero, and its absorption coefficient sigma_a;
    S. Jacques, "Optical properties of biological tissues: a review", Phys. Med. Biol. 58 (2013).

    >>> blue = diffusion(5.18, 0.40)
    >>> float(blue(0.0)), bool(0.15 < blue(14.4) < 0.25)
    (1.0, True)
    """
    albedos, frequencies, table = _table()
    total = scattering_per_mm + absorption_per_mm
    # between albedos the table is nearly linear in the logarithm of the absorbed part
    place = np.interp(
        -np.log(1 - min(scattering_per_mm / total, albedos[-1])),
        -np.log(1 - albedos),
        np.arange(len(albedos)),
    )
    low = min(int(place), len(albedos) - 2)
    row = table[low] + (place - low) * (table[low + 1] - table[low])
    return Diffusion(
        scattering_per_mm, absorption_per_mm, float(row[0]), frequencies * total, row / row[0]
    )


@lru_cache(maxsize=1)
def _table() -> tuple[Array, Array, Array]:
    with (
        (resources.files("splitknit.skin") / "diffusion_table.npz").open("rb") as file,
        np.load(file) as data,
    ):
        return (
            data["albedo"].astype(np.float64),
            data["frequency"].astype(np.float64),
            data["transfer"].astype(np.float64),
        )
