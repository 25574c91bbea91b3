"""Optics of skin: coefficients in the camera's channels, and where light that enters at one point
leaves it.

Coefficients: reduced scattering by the power law of Jacques 2013 (skin: 46 /cm at 500 nm, exponent
1.42); absorption as a mixture of blood, melanosomes, water and a bloodless baseline (Jacques 1998,
2013). Each channel is represented by one effective wavelength, as ``docs/explain/simulator.md``
explains.

Diffusion: searchlight profiles of a semi-infinite medium. One set of random walks serves all
optics. Lengths scale with the mean free path 1/s between scattering events, and absorption a
weights a walk of length l by exp(-a l / s) (Beer-Lambert along the path), so a histogram of the
walks' exit radius and length, both in mean free paths, holds every pair of coefficients. The
histogram is shipped (``data/walks.npz``, made by ``tools/make_walk_table.py``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib import resources
from typing import Annotated, Any, Literal, NamedTuple, get_args

import numpy as np
import scipy.fft
from scipy.special import j1

from splitknit.errors import require
from splitknit.model import Array, FloatArray
from splitknit.settings import Checked, Limits

Channel = Literal["red", "green", "blue", "nir"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)
BAND_CHANNELS: Mapping[str, tuple[Channel, ...]] = {
    "white": ("red", "green", "blue"),
    "nir": ("nir",),
}
"""The media that the camera's channels see: under NIR all three see the same."""


@dataclass(frozen=True, slots=True)
class _EffectiveBand:
    """What one channel sees: wavelengths in nm and absorption in 1/mm of the pure substances
    there."""

    scattering_nm: float  # centroid of the channel under the LED: scattering varies slowly
    # where the channel's light is absorbed: the peak of a white LED's blue line for the blue
    # channel
    absorption_nm: float
    oxygenated: float  # whole blood of 150 g/l haemoglobin, all of it oxygenated
    deoxygenated: float  # whole blood of 150 g/l haemoglobin, none of it oxygenated
    water: float

    @property
    def melanosome(self) -> float:
        """Absorption of the inside of a melanosome, 519 /cm (wavelength / 500 nm)^-3.5 (Jacques
        2013)."""
        return float(51.9 * (self.absorption_nm / 500.0) ** -3.5)

    @property
    def bloodless(self) -> float:
        """Wavelength-dependent part of bloodless skin, 8.53 /cm exp(-(wavelength - 154) / 66.2 nm)
        (Jacques 1998)."""
        return float(0.853 * np.exp(-(self.absorption_nm - 154.0) / 66.2))


EFFECTIVE: Mapping[Channel, _EffectiveBand] = {
    "red": _EffectiveBand(620.0, 620.0, 0.50, 3.5, 0.00026),
    "green": _EffectiveBand(540.0, 540.0, 28.5, 25.0, 0.00004),
    "blue": _EffectiveBand(460.0, 450.0, 33.7, 55.3, 0.00003),
    "nir": _EffectiveBand(850.0, 850.0, 0.57, 0.37, 0.0043),
}
"""Absorption of blood from Prahl's compilation (2.303 x molar extinction x 150 g/l / 64,500 g/mol),
rounded."""


@dataclass(frozen=True, slots=True)
class ChannelOptics:
    """One medium as the renderer needs it."""

    scattering_per_mm: float  # reduced scattering coefficient
    absorption_per_mm: float
    # relative change of the diffuse light per micrometre of relief, under light along the skin's
    # normal
    relief_gain_per_um: float
    # what is added to it under light at the angle t to the normal, over ln(1 / cos t)
    oblique_gain_per_um: float = 0.0

    @property
    def attenuation_per_mm(self) -> float:
        """Effective attenuation of diffusion theory, sqrt(3 a (a + s))."""
        a, s = self.absorption_per_mm, self.scattering_per_mm
        return float(np.sqrt(3.0 * a * (a + s)))


@dataclass(frozen=True, slots=True)
class Boundary(Checked):
    """How light enters the skin. The defaults are a matt boundary."""

    refraction: Annotated[float, Limits(0.0, 1.0)] = 0.0
    """Strength of the reversed slope shading caused by refraction: 0 a matt boundary, 1 a smooth
    one above isotropic scattering; forward scattering (anisotropy 0.8) leaves about a quarter of
    it."""
    entry_power: Annotated[float, Limits(-1.0, 2.0)] = 1.0
    """Exponent of Fresnel's transmittance for entering light: 1 for a clean flat boundary, less for
    a rough one and where light scatters soon after a slanted entry."""
    blurred: bool = False
    """Count and spread light across the picture, as in an image that is blurred, instead of along
    the skin: ridges then flatten the slopes on which they lie, which they do not do on skin."""

    def slope_signal(self, channel: Channel) -> float:
        """Shading by ridge slopes over that behind a matt boundary."""
        return 1.0 - self.refraction * SLOPE_LOSS[channel]

    def height_signal(self, scattering_per_mm: float) -> float:
        """Brightness of heights over that behind a matt boundary above strong scattering.

        Behind a matt boundary, light whose mean free path is longer than a ridge is wide carries no
        signal of its height; refracted light brightens heights the more, the deeper it goes. Both
        follow our own reference walks (docs/experiments/simulator.md, ridges of 75 um,
        scattering of 1 to 10 per mm).
        """
        matt = max(1.0 - math.exp((1.0 - scattering_per_mm) / 0.65), 0.0)
        smooth = min(3.8 / scattering_per_mm, 1.5)
        return (1.0 - self.refraction) * matt + self.refraction * smooth

    def oblique_signal(self, attenuation_per_mm: float) -> float:
        """Brightness of heights that slanted light adds, per mm and ln(1 / cos t), t the angle to
        the skin's normal.

        With these factors of the square root of the effective attenuation (1/mm), heights on our
        captures are as bright as on those of our own walks in whole fingers, beside what heights
        have under upright light: 0.4 to 1 times that behind a matt boundary, 1 to 1.8 times where
        two thirds are refracted.
        """
        return (0.7 + 1.1 * self.refraction) * math.sqrt(attenuation_per_mm)


SLOPE_LOSS: Mapping[Channel, float] = {"red": 2.3, "green": 1.65, "blue": 1.0, "nir": 4.8}
"""What a smooth boundary takes from the shading by slopes, over that of a matt one: our own
reference walks (docs/experiments/simulator.md, ridges of 75 um; 1: none is left, above 1:
it is reversed)."""


@dataclass(frozen=True, slots=True)
class SkinOptics(Checked):
    """One finger's skin. The defaults give the coefficients measured on the reference renders."""

    scattering_factor: Annotated[float, Limits(0.15, 3.0)] = 1.0
    """Multiplies the reduced scattering of the power law; 0.15 to 3."""
    melanin: Annotated[float, Limits(0.0, 0.05)] = 0.00056
    """Volume fraction of melanosomes in the medium: 0.0002 very light, 0.004 dark, 0.02 very dark
    skin."""
    blood: Annotated[float, Limits(0.0, 0.1)] = 0.006
    """Volume fraction of whole blood (150 g/l haemoglobin)."""
    oxygenation: Annotated[float, Limits(0.0, 1.0)] = 0.75
    """Oxygenated fraction of the haemoglobin."""
    water: Annotated[float, Limits(0.0, 1.0)] = 0.65
    """Volume fraction of water."""
    baseline_per_mm: Annotated[float, Limits(0.004, 1.0)] = 0.008
    """Grey absorption of bloodless skin; the part that depends on wavelength is Jacques's."""
    yellow_per_mm: Annotated[float, Limits(0.0, 1.0)] = 0.105
    """Absorption in the blue channel by carotenoids, bilirubin and the thick horny layer of the
    finger pad."""
    roughness: Annotated[float, Limits(0.05, 1.0)] = 0.25
    """GGX alpha of the skin's surface."""
    glare: Annotated[float, Limits(0.0, 5.0)] = 1.0
    """Weight of the surface reflection: 1 bare skin (Fresnel), 0 polarised away, above 1 oily."""
    relief_gain: Annotated[float, Limits(0.0, 3.0)] = 0.78
    """Brightness signal of heights behind a matt boundary: in each channel this times its effective
    attenuation and :meth:`Boundary.height_signal`."""
    scattering_power: Annotated[float, Limits(0.0, 3.0)] = 1.42
    """Exponent of the wavelength in the reduced scattering: 1.42 Jacques's skin, 0.5 large
    scatterers."""
    layers: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """Absorption of red, green, blue and near-infrared light relative to a homogeneous medium:
    melanin above and blood below act as other absorptions than a mixture would."""
    boundary: Boundary = field(default_factory=Boundary)

    def medium(self, band: str) -> Medium:
        """Return the skin as the light of ``white`` or ``nir`` meets it."""
        optics = tuple(self.channel(name) for name in BAND_CHANNELS[band])
        return Medium(optics, self.roughness, self.glare, self.boundary)

    def channel(self, name: Channel) -> ChannelOptics:
        """Return the coefficients of the channel `name`: ``red``, ``green``, ``blue`` or
        ``nir``."""
        band = EFFECTIVE[name]
        scattering = (
            self.scattering_factor * 4.6 * (band.scattering_nm / 500.0) ** -self.scattering_power
        )
        absorption = (
            self.blood
            * (self.oxygenation * band.oxygenated + (1.0 - self.oxygenation) * band.deoxygenated)
            + self.melanin * band.melanosome
            + self.water * band.water
            + self.baseline_per_mm
            + band.bloodless
            + (self.yellow_per_mm if name == "blue" else 0.0)
        )
        absorption *= self.layers[CHANNELS.index(name)]
        optics = ChannelOptics(scattering, absorption, 0.0)
        attenuation = optics.attenuation_per_mm
        return replace(
            optics,
            relief_gain_per_um=1e-3
            * self.relief_gain
            * self.boundary.height_signal(scattering)
            * attenuation,
            oblique_gain_per_um=1e-3
            * self.relief_gain
            / 0.78
            * self.boundary.oblique_signal(attenuation),
        )


@dataclass(frozen=True, slots=True)
class Medium:
    """A finger's skin as the light of one band meets it."""

    optics: Sequence[ChannelOptics]  # C media, one a channel: red, green and blue, or near infrared
    roughness: float  # GGX alpha of the surface
    glare: float = 1.0  # weight of the surface reflection, 1 = Fresnel
    # how light enters, where nothing lies on the skin
    boundary: Boundary = field(default_factory=Boundary)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Names of the media, which follow from their number."""
        return next(names for names in BAND_CHANNELS.values() if len(names) == len(self.optics))


EVEN = ("oxygenation", "roughness", "glare")
DRAWN = ("scattering_factor", "melanin", "blood", *EVEN, "relief_gain")
"""Settings that are drawn for each finger, in this order: evenly, the others log-uniformly."""


@dataclass(frozen=True, slots=True)
class SkinRanges:
    """Ranges from which one finger's skin is drawn."""

    base: SkinOptics = field(default_factory=SkinOptics)
    """What is not drawn."""
    scattering_factor: tuple[float, float] = (0.7, 1.4)
    """Log-uniform."""
    melanin: tuple[float, float] = (0.0002, 0.006)
    """Log-uniform; palms and finger pads carry less melanin than the rest of the hand."""
    blood: tuple[float, float] = (0.003, 0.012)
    """Log-uniform."""
    oxygenation: tuple[float, float] = (0.6, 0.85)
    """Oxygenated fraction of the haemoglobin, 0 to 1; even."""
    roughness: tuple[float, float] = (0.18, 0.35)
    """GGX alpha of the skin's surface, 0.05 (polished) to 1 (matt); even."""
    glare: tuple[float, float] = (0.5, 1.3)
    """Weight of the surface reflection, 0 to 5: 1 bare skin, 0 polarised away, above 1 oily;
    even."""
    relief_gain: tuple[float, float] = (0.55, 1.55)
    """Log-uniform: the boundary model changes this term by 0.7 to 2 times."""

    def __post_init__(self) -> None:
        for name in DRAWN:
            low, high = getattr(self, name)
            require(
                0.0 <= low <= high,
                f"skin range {name} must be (low, high), but it is ({low}, {high}).",
            )
            for value in (low, high):
                replace(self.base, **{name: value})

    def draw(self, rng: np.random.Generator) -> SkinOptics:
        """Return the skin of one finger; every range takes one number from `rng`, in a fixed
        order."""
        drawn: dict[str, Any] = {}
        for name in DRAWN:
            low, high = getattr(self, name)
            fraction, even = float(rng.random()), name in EVEN or low == 0.0
            drawn[name] = float(
                low + (high - low) * fraction if even else low * (high / low) ** fraction
            )
        return replace(self.base, **drawn)


RADIUS_EDGES = np.concatenate([[0.0], np.geomspace(1e-3, 250.0, 101)])
"""Radii that bound the rings in which walks leave the skin, in mean free paths. Source: definition
of the shipped table of walks."""

# Where light that enters skin at one point leaves it.
REFRACTIVE_INDEX = 1.42
"""Of skin as one homogeneous medium, between dermis (1.36) and epidermis (1.49; Ding et al. 2006,
Physics in Medicine and Biology 51, 1479)."""


def fresnel(cosine: FloatArray, ratio: float = REFRACTIVE_INDEX) -> FloatArray:
    """Unpolarised Fresnel reflectance at `cosine` of incidence in [0, 1]; `ratio` is n behind / n
    before the surface.

    Born and Wolf, Principles of Optics, section 1.5.2, equation (21).
    """
    c = np.clip(cosine, 0.0, 1.0)
    inside = 1.0 - (1.0 - c * c) * (1.0 / ratio**2)
    t = np.sqrt(np.clip(inside, 0.0, 1.0))
    # total reflection at grazing incidence: zero over zero, which the last line replaces by one
    tiny = 1e-12
    across = (c - ratio * t) / (c + ratio * t + tiny)
    along = (ratio * c - t) / (ratio * c + t + tiny)
    return np.asarray(
        np.where(inside <= 0.0, np.ones_like(c), 0.5 * (across * across + along * along))
    )


def diffuse_transmittance(ratio: float = REFRACTIVE_INDEX) -> float:
    """Fraction of diffuse (cosine-weighted) light that enters the medium: 1 - int 2 c F(c) dc over
    [0, 1]."""
    c = (np.arange(4000) + 0.5) / 4000.0
    return float(1.0 - np.mean(2.0 * c * fresnel(c, ratio)))


class WalkTable(NamedTuple):
    """Histogram of random walks without absorption, in mean free paths."""

    # (radii, lengths): fraction of all walks that leave at a radius and after a length within the
    # bins
    counts: Array
    lengths: Array  # (lengths,) mean length of the walks in each bin of lengths


@lru_cache(maxsize=1)
def load_walks() -> WalkTable:
    """Return the shipped table of walks."""
    shipped = resources.files("splitknit_simulator").joinpath("data/walks.npz")
    with shipped.open("rb") as file, np.load(file, allow_pickle=False) as table:
        counts = table["counts"].astype(np.float64) / float(table["walks"])
        return WalkTable(counts=counts, lengths=table["lengths"].astype(np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """The diffusion profile of one medium: light leaves ring k, between two radii, with weight
    `weights[k]`."""

    radii_mm: Array  # (rings + 1,) edges of the rings
    weights: Array  # (rings,) their sum is the albedo

    @property
    def albedo(self) -> float:
        """Fraction of the light that entered which leaves again."""
        return float(np.sum(self.weights))

    def radius_mm(self, fraction: float) -> float:
        """Radius within which `fraction` of the leaving light leaves."""
        inside = np.concatenate([[0.0], np.cumsum(self.weights)]) / self.albedo
        return float(np.interp(fraction, inside, self.radii_mm))

    def transfer(self, cycles_per_mm: FloatArray) -> Array:
        """Fourier (Hankel) transform of the profile at a frequency, evenly spread within each ring.

        One ring between radii p and q has the transform 2 (q J1(kq) - p J1(kp)) / (k (q^2 - p^2)),
        k = 2 pi f. The value at zero is the albedo.
        """
        k = 2.0 * np.pi * np.maximum(np.asarray(cycles_per_mm, dtype=np.float64), 1e-6)[..., None]
        r = self.radii_mm
        disc = r * j1(k * r) / k
        rings = 2.0 * np.diff(disc, axis=-1) / np.diff(r * r)
        return np.asarray(np.sum(rings * self.weights, axis=-1))

    def transfer_grid(self, shape: tuple[int, int], pitch_mm: float) -> FloatArray:
        """(H, W // 2 + 1) transfer on the grid of a real two-dimensional FFT of `shape`."""
        rows = scipy.fft.fftfreq(shape[0], pitch_mm)
        columns = scipy.fft.rfftfreq(shape[1], pitch_mm)
        longest = float(np.hypot(rows.max() + 1.0 / (shape[0] * pitch_mm), columns.max()))
        knots = longest * (np.arange(601) / 600.0) ** 2
        values = self.transfer(knots)
        # knots are spaced with the square of their index: the index itself is the coordinate to
        # interpolate in
        index = np.sqrt(np.hypot(rows[:, None], columns[None, :]) / longest) * 600.0
        return np.interp(index, np.arange(601), values).astype(np.float32)


def diffusion_profile(scattering_per_mm: float, absorption_per_mm: float) -> Profile:
    """Return the profile of a medium with reduced scattering and absorption in 1/mm, by the shipped
    table of walks.

    Raises BadInput if scattering is not positive, absorption is negative, or absorption is so weak
    (below 0.2 % of scattering) that walks longer than the table would matter. Wang, Jacques and
    Zheng 1995, MCML; Zijp and ten Bosch 1998 on the scaling of one simulation to other optics.
    """
    require(
        scattering_per_mm > 0, f"scattering must be positive, but it is {scattering_per_mm} per mm."
    )
    ratio = absorption_per_mm / scattering_per_mm
    require(
        ratio >= 0.002,
        f"absorption must be at least 0.2 % of scattering, but it is {100 * ratio:.3g} %.",
    )
    counts, lengths = load_walks()
    return Profile(
        RADIUS_EDGES / scattering_per_mm, np.sum(counts * np.exp(-ratio * lengths), axis=1)
    )
