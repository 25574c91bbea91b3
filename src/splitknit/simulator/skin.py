"""Optical coefficients of skin in the camera's channels, from a handful of parameters.

Sources: reduced scattering by the power law of Jacques 2013 (skin: 46 /cm at 500 nm, exponent 1.42); absorption as a
mixture of blood, melanosomes, water and a bloodless baseline (Jacques 1998, 2013). Each channel is represented by one
effective wavelength, as ``docs/twin.md`` explains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from splitknit.errors import require

Channel = Literal["red", "green", "blue", "nir"]
CHANNELS: tuple[Channel, ...] = ("red", "green", "blue", "nir")
BAND_CHANNELS: Mapping[str, tuple[Channel, ...]] = {"white": ("red", "green", "blue"), "nir": ("nir",)}
"""The media that the camera's channels see: under NIR all three see the same."""


@dataclass(frozen=True, slots=True)
class EffectiveBand:
    """What one channel sees: wavelengths in nm and absorption in 1/mm of the pure substances there."""

    scattering_nm: float
    """Centroid of the channel under the LED: scattering varies slowly."""
    absorption_nm: float
    """Where the channel's light is absorbed: the peak of a white LED's blue line for the blue channel."""
    oxygenated: float
    """Whole blood of 150 g/l haemoglobin, all of it oxygenated."""
    deoxygenated: float
    """Whole blood of 150 g/l haemoglobin, none of it oxygenated."""
    water: float

    @property
    def melanosome(self) -> float:
        """Absorption of the inside of a melanosome, 519 /cm (wavelength / 500 nm)^-3.5 (Jacques 2013)."""
        return float(51.9 * (self.absorption_nm / 500.0) ** -3.5)

    @property
    def bloodless(self) -> float:
        """Wavelength-dependent part of bloodless skin, 8.53 /cm exp(-(wavelength - 154) / 66.2 nm) (Jacques 1998)."""
        return float(0.853 * np.exp(-(self.absorption_nm - 154.0) / 66.2))


EFFECTIVE: Mapping[Channel, EffectiveBand] = {
    "red": EffectiveBand(620.0, 620.0, 0.50, 3.5, 0.00026),
    "green": EffectiveBand(540.0, 540.0, 28.5, 25.0, 0.00004),
    "blue": EffectiveBand(460.0, 450.0, 33.7, 55.3, 0.00003),
    "nir": EffectiveBand(850.0, 850.0, 0.57, 0.37, 0.0043),
}
"""Absorption of blood from Prahl's compilation (2.303 x molar extinction x 150 g/l / 64,500 g/mol), rounded."""


@dataclass(frozen=True, slots=True)
class ChannelOptics:
    """One medium as the renderer needs it."""

    scattering_per_mm: float
    """Reduced scattering coefficient."""
    absorption_per_mm: float
    relief_gain_per_um: float
    """Relative change of the diffuse light per micrometre of relief, whatever the light's direction."""

    @property
    def attenuation_per_mm(self) -> float:
        """Effective attenuation of diffusion theory, sqrt(3 a (a + s))."""
        a, s = self.absorption_per_mm, self.scattering_per_mm
        return float(np.sqrt(3.0 * a * (a + s)))


@dataclass(frozen=True, slots=True)
class SkinSettings:
    """One finger's skin. The defaults give the coefficients measured on the reference renders."""

    scattering_factor: float = 1.0
    """Multiplies the reduced scattering of the power law; 0.3 to 3."""
    melanin: float = 0.00056
    """Volume fraction of melanosomes in the medium: 0.0002 very light, 0.004 dark, 0.02 very dark skin."""
    blood: float = 0.006
    """Volume fraction of whole blood (150 g/l haemoglobin)."""
    oxygenation: float = 0.75
    """Oxygenated share of the haemoglobin."""
    water: float = 0.65
    """Volume fraction of water."""
    baseline_per_mm: float = 0.008
    """Grey absorption of bloodless skin; the part that depends on wavelength is Jacques's."""
    yellow_per_mm: float = 0.105
    """Absorption in the blue channel by carotenoids, bilirubin and the thick horny layer of the finger pad."""
    roughness: float = 0.25
    """GGX alpha of the skin's surface."""
    glare: float = 1.0
    """Weight of the surface reflection: 1 bare skin (Fresnel), 0 polarised away, above 1 oily."""
    relief_gain: float = 0.78
    """The relief gain of a channel is this number times its effective attenuation: k h = gain x mu_eff x h."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("scattering_factor", 0.3, 3.0),
            ("melanin", 0.0, 0.05),
            ("blood", 0.0, 0.1),
            ("oxygenation", 0.0, 1.0),
            ("water", 0.0, 1.0),
            ("baseline_per_mm", 0.004, 1.0),
            ("yellow_per_mm", 0.0, 1.0),
            ("roughness", 0.05, 1.0),
            ("glare", 0.0, 5.0),
            ("relief_gain", 0.0, 3.0),
        ):
            value = getattr(self, name)
            require(
                bool(np.isfinite(value)) and low <= value <= high,
                f"skin.{name} must lie between {low} and {high}, but it is {value}.",
            )

    def channel(self, name: Channel) -> ChannelOptics:
        """Return the coefficients of the channel `name`: ``red``, ``green``, ``blue`` or ``nir``."""
        band = EFFECTIVE[name]
        scattering = self.scattering_factor * 4.6 * (band.scattering_nm / 500.0) ** -1.42
        absorption = (
            self.blood * (self.oxygenation * band.oxygenated + (1.0 - self.oxygenation) * band.deoxygenated)
            + self.melanin * band.melanosome
            + self.water * band.water
            + self.baseline_per_mm
            + band.bloodless
            + (self.yellow_per_mm if name == "blue" else 0.0)
        )
        optics = ChannelOptics(scattering, absorption, 0.0)
        return replace(optics, relief_gain_per_um=self.relief_gain * optics.attenuation_per_mm * 1e-3)


@dataclass(frozen=True, slots=True)
class SkinRanges:
    """Ranges from which one finger's skin is drawn."""

    base: SkinSettings = field(default_factory=SkinSettings)
    """What is not drawn."""
    scattering_factor: tuple[float, float] = (0.7, 1.4)
    """Log-uniform."""
    melanin: tuple[float, float] = (0.0002, 0.006)
    """Log-uniform; palms and finger pads carry less melanin than the rest of the hand."""
    blood: tuple[float, float] = (0.003, 0.012)
    """Log-uniform."""
    oxygenation: tuple[float, float] = (0.6, 0.85)
    """Oxygenated share of the haemoglobin, 0 to 1; even."""
    roughness: tuple[float, float] = (0.18, 0.35)
    """GGX alpha of the skin's surface, 0.05 (polished) to 1 (matt); even."""
    glare: tuple[float, float] = (0.5, 1.3)
    """Weight of the surface reflection, 0 to 5: 1 bare skin, 0 polarised away, above 1 oily; even."""
    relief_gain: tuple[float, float] = (0.55, 1.55)
    """Log-uniform: the boundary model changes this term by 0.7 to 2 times."""

    def __post_init__(self) -> None:
        for name in ("scattering_factor", "melanin", "blood", "oxygenation", "roughness", "glare", "relief_gain"):
            low, high = getattr(self, name)
            require(0.0 <= low <= high, f"skin range {name} must be (low, high), but it is ({low}, {high}).")
            replace(self.base, **{name: low})
            replace(self.base, **{name: high})

    def draw(self, rng: np.random.Generator) -> SkinSettings:
        """Return the skin of one finger; every range takes one number from `rng`, in a fixed order."""
        drawn = {}
        for name, logarithmic in (
            ("scattering_factor", True),
            ("melanin", True),
            ("blood", True),
            ("oxygenation", False),
            ("roughness", False),
            ("glare", False),
            ("relief_gain", True),
        ):
            low, high = getattr(self, name)
            share = float(rng.random())
            if logarithmic and low > 0.0:
                drawn[name] = float(low * (high / low) ** share)
            else:
                drawn[name] = float(low + (high - low) * share)
        return replace(self.base, **drawn)
