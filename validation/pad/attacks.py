"""Presentation attacks on the simulated rig: copies of a finger with the optics and the geometry of
other materials.

An attack is the twin's finger with its skin replaced: a medium with the reflectance, scattering and
gloss of the material, and a surface whose relief is weaker and smoother, or flat. Terms: ISO/IEC
30107-1.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from splitknit.capture import Capture
from splitknit.errors import require
from splitknit.model import FloatArray, Led
from splitknit_simulator.light.renderer import BandLight, render_band
from splitknit_simulator.light.skin import CHANNELS, SkinOptics, diffusion_profile
from splitknit_simulator.mirror_twin import Drawn
from splitknit_simulator.scene import (
    Scene,
    TwinSettings,
    ambient_level,
    surface_truth,
    take_capture,
)
from splitknit_simulator.surface import SimulatedSurface, Texture
from splitknit_simulator.twin import lay_down

Range = tuple[float, float]
_NONE: Range = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Species:
    """Ranges from which one instrument of a species is drawn."""

    words: str
    # diffuse: red, green, blue, NIR
    reflectance: tuple[Range, Range, Range, Range] = (_NONE, _NONE, _NONE, _NONE)
    scattering_per_mm: Range = (1.0, 4.0)  # reduced, at 500 nm; the twin's media reach 13.8
    roughness: Range = (0.15, 0.4)  # GGX alpha
    gloss: Range = (0.7, 1.2)  # weight of the surface reflection, 1 = Fresnel
    tint: Range = _NONE  # how far its visible colour is brought to that of the finger: 1 = the same
    # fraction of the wearer's skin in its optics, near infrared included: a film on a finger
    live: Range = _NONE
    relief: Range = _NONE  # height of its ridges over that of the finger's
    blur_mm: Range = _NONE  # standard deviation of their smoothing
    flat: Range = _NONE  # 0: the finger's shape, 1: a plane
    layer_um: Range = _NONE  # steps of a printer
    picture: bool = False  # it shows a photograph of the finger
    glow: Range = _NONE  # emitted light over that of a white card under one LED


def _species() -> dict[str, Species]:
    """Rows of ``species.csv``; a range is written as its ends, reflectance as the ends of four."""
    kinds = {}
    with Path(__file__).with_name("species.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            name, words, picture = row.pop("name"), row.pop("words"), row.pop("picture") == "yes"
            ranges: dict[str, Any] = {}
            for field, text in row.items():
                if text:
                    ends = [float(number) for number in text.split()]
                    pairs = tuple(zip(ends[::2], ends[1::2], strict=True))
                    ranges[field] = pairs if field == "reflectance" else pairs[0]
            kinds[name] = Species(words, picture=picture, **ranges)
    return kinds


SPECIES: Mapping[str, Species] = _species()
"""Instruments by name. Sources: paper spreads light over 0.1 to 0.3 mm (Arney 1997, J. Imaging Sci.
Technol. 41); inks of dyes are clear in near infrared, carbon black is not; scattering of silicone
and gelatine: Pogue and Patterson 2006, J. Biomed. Opt. 11, 041102; casts lose height and sharpness:
Matsumoto et al. 2002, Proc. SPIE 4677; skin without blood: the twin's (Jacques 1998). All other
numbers are assumed: nobody has measured these instruments on this rig."""


def simulate_attack(
    seed: int, species: str, settings: TwinSettings | None = None, *, impression: int = 0
) -> tuple[Capture, dict[str, NDArray[Any]]]:
    """Simulate a capture of an instrument made of one person's finger.

    Parameters
    ----------
    seed : of the finger and of the instrument
    species : a name of `SPECIES`, or ``live`` for the finger itself
    settings : of the simulator; a still finger without mirrors, before a camera with parallel rays
    impression : number of the capture: pose, noise and instrument change with it

    Returns the capture, with exposures, so that near infrared compares with visible light, and the
    truth, as those of :func:`splitknit_simulator.twin.simulate_capture`. Raises BadInput if there
    is no such species, or setting.

    Examples
    --------
    >>> from splitknit_simulator.twin import twin_settings
    >>> capture, truth = simulate_attack(1, "photo-matt", twin_settings(0.08, None))
    >>> capture.shape
    (176, 256)
    """
    settings = settings or TwinSettings()
    require(
        species == "live" or species in SPECIES,
        f"attacks are {', '.join(SPECIES)}; not '{species}'.",
    )
    surface, drawn = lay_down(seed, None, settings, impression=impression)
    plain = (
        settings.motion.amplitude_mm == 0
        and not drawn.rig.mirrors
        and surface.camera.model == "orthographic"
    )
    require(
        plain,
        "attacks lie still before a camera with parallel rays; leave out motion, mirrors, a"
        " perspective rig.",
    )
    seeds = [*_entropy(drawn.photo_seed), 0xA7, [*SPECIES, "live"].index(species)]
    background, noise, own = np.random.SeedSequence(seeds).spawn(3)
    optics, glow = drawn.skin, None
    if species != "live":
        kind = SPECIES[species]
        numbers, optics = _draw(kind, drawn.skin, own)
        picture = _picture_of(surface, drawn, own) if kind.picture else None
        surface = _copied(surface, numbers, own, picture)
        if kind is not SPECIES["bloodless"]:  # skin keeps its pigment
            surface = replace(surface, pigment=surface.mask.astype(np.float32))
        if picture is not None and numbers["glow"] > 0:
            glow = np.float32(numbers["glow"]) * picture[:3]
    scene = _Scene((surface, drawn.rig, optics), settings, np.random.default_rng(background))
    scene.glow, truth = glow, surface_truth(surface)
    capture = take_capture(scene, scene.photograph, noise, truth)
    truth["attack"] = np.array(species)
    bands = {}
    for name, band in capture.bands.items():
        # lights of two bands are brought to one scale by a white card: to 4 %
        drift = (
            1.0
            if name != "nir"
            else float(np.exp(0.04 * np.random.default_rng(own).standard_normal()))
        )
        exposure = drift * float(truth[f"exposure_{name}"] / truth["exposure_white"])
        bands[name] = replace(
            band,
            exposure=band.exposure * exposure,
            ambient=None if band.ambient is None else replace(band.ambient, exposure=exposure),
        )
    return replace(capture, bands=bands), truth


def _entropy(seed: np.random.SeedSequence) -> list[int]:
    return [*np.atleast_1d(np.asarray(seed.entropy)).tolist(), *seed.spawn_key]


def _draw(
    species: Species, skin: SkinOptics, seed: np.random.SeedSequence
) -> tuple[Mapping[str, float], SkinOptics]:
    """Draw one instrument of a species that imitates a finger with this skin: its numbers and its
    optics."""
    rng = np.random.default_rng(seed)
    names = (
        "scattering_per_mm",
        "roughness",
        "gloss",
        "tint",
        "live",
        "relief",
        "blur_mm",
        "flat",
        "layer_um",
        "glow",
    )
    drawn = {name: float(rng.uniform(*getattr(species, name))) for name in names}
    light = rng.random()
    own = [
        low + (high - low) * np.clip(light + 0.2 * rng.standard_normal(), 0, 1)
        for low, high in species.reflectance
    ]
    if not any(high for _, high in species.reflectance):  # the finger itself, without its blood
        return drawn | {"relief": 1.0}, replace(skin, blood=skin.blood * rng.uniform(0.0, 0.05))
    media = [skin.channel(name) for name in CHANNELS]
    skins = [
        diffusion_profile(medium.scattering_per_mm, medium.absorption_per_mm).albedo
        for medium in media
    ]
    mixed = []
    for k, (own_albedo, skin_albedo) in enumerate(zip(own, skins, strict=True)):
        match = drawn["live"] if drawn["live"] > 0 else drawn["tint"] * (k < 3)
        # mixed by eye
        near = (
            skin_albedo
            if drawn["live"] > 0
            else skin_albedo * float(np.exp(0.06 * rng.standard_normal()))
        )
        mixed.append(min(own_albedo ** (1 - match) * near**match, 0.82))
    scattering = (
        drawn["scattering_per_mm"] ** (1 - drawn["live"])
        * (4.6 * skin.scattering_factor) ** drawn["live"]
    )
    power = (1 - drawn["live"]) * rng.uniform(0.3, 1.2) + 1.42 * drawn["live"]
    plain = SkinOptics(
        scattering_factor=min(scattering / 4.6, 3.0),
        melanin=0.0,
        blood=0.0,
        water=0.0,
        yellow_per_mm=0.0,
        roughness=drawn["roughness"],
        glare=drawn["gloss"],
        scattering_power=power,
        relief_gain=skin.relief_gain,
    )
    pairs = zip((plain.channel(name) for name in CHANNELS), mixed, strict=True)
    layers: Any = tuple(
        _absorption(medium.scattering_per_mm, seen) / medium.absorption_per_mm
        for medium, seen in pairs
    )
    return drawn, replace(plain, layers=layers)


def _absorption(scattering_per_mm: float, reflectance: float) -> float:
    """Absorption (1/mm) at which a medium has a diffuse reflectance."""

    def excess(log_ratio: float) -> float:
        return (
            diffusion_profile(
                scattering_per_mm, scattering_per_mm * float(np.exp(log_ratio))
            ).albedo
            - reflectance
        )

    low = np.log(0.0021)
    high = np.log(60.0)
    return scattering_per_mm * float(
        np.exp(low if excess(low) < 0 else brentq(excess, low, high, xtol=1e-3))
    )


def _picture_of(
    surface: SimulatedSurface, drawn: Drawn, seed: np.random.SeedSequence
) -> FloatArray:
    """(4, H, W) a photograph of the finger under one LED, as red, green, blue and NIR show it; mean
    one, 0 outside."""
    rng = np.random.default_rng([*_entropy(seed), 1])
    leds: Sequence[Led] = [led for led in drawn.rig.leds if led.band == "white"]
    light = render_band(surface, [leds[int(rng.integers(len(leds)))]], drawn.skin.medium("white"))
    seen = light.diffuse[0] + np.float32(0.5) * light.glare[0]
    # mm; near infrared: dyes 0, black 1
    size, ink = (float(rng.uniform(*span)) for span in ((0.03, 0.08), (0.0, 0.7)))
    whole = np.zeros((4, *surface.mask.shape), dtype=np.float32)
    window, inside = light.window, surface.mask[light.window]
    for c in range(3):
        channel = np.minimum(seen[c], np.percentile(seen[c][inside], 99))
        channel = (
            cv2.GaussianBlur(channel, (0, 0), max(size * surface.camera.px_per_mm, 0.2))
            / channel[inside].mean()
        )
        whole[c][window] = np.where(inside, np.clip(channel, 0.05, 1.6), 0)
    whole[3][window] = np.where(inside, whole[1][window] ** ink, 0)
    return whole


def _copied(
    surface: SimulatedSurface,
    drawn: Mapping[str, float],
    seed: np.random.SeedSequence,
    picture: FloatArray | None,
) -> SimulatedSurface:
    """Give a finger's surface the relief, the flatness and the layers of an instrument."""
    mask = surface.mask
    rng = np.random.default_rng([*_entropy(seed), 2])
    pitch = surface.camera.pitch_mm
    weight = mask.astype(np.float32)
    sigma = drawn["blur_mm"] / pitch

    def smooth(field: NDArray[Any]) -> FloatArray:
        field = np.where(mask, field, 0).astype(np.float32)
        if sigma < 0.2:
            return field
        covered = np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-3)
        return np.asarray(
            cv2.GaussianBlur(field, (0, 0), sigma) / covered * weight, dtype=np.float32
        )

    def slopes(normals: FloatArray) -> NDArray[Any]:
        return np.moveaxis(
            -normals[..., :2] / np.maximum(normals[..., 2:], np.float32(0.15)), -1, 0
        )

    gain, flat = drawn["relief"], drawn["flat"]
    shaped = slopes(surface.shape_normals)
    ridges = np.stack([gain * smooth(component) for component in slopes(surface.normals) - shaped])
    raised, relief = (
        gain * smooth(field) for field in (surface.height_mm - surface.shape_mm, surface.relief_um)
    )
    tilt = rng.normal(0.0, 0.06, 2) * (flat > 0.5)
    rows, columns = np.indices(mask.shape)
    x, y = (columns - mask.shape[1] / 2) * pitch, (mask.shape[0] / 2 - rows) * pitch
    plane = float(np.nanpercentile(surface.shape_mm, 95)) + tilt[0] * x + tilt[1] * y
    shape = (1 - flat) * np.where(mask, surface.shape_mm, 0) + flat * plane
    shaped = (1 - flat) * shaped + flat * tilt[:, None, None]
    if drawn["layer_um"] > 0:
        step = drawn["layer_um"] / 1000
        lean = rng.normal(0.0, 0.2, 2)
        along = shape + lean[0] * x + lean[1] * y
        width = step / np.maximum(np.hypot(shaped[0] + lean[0], shaped[1] + lean[1]), 1e-3) / pitch
        steps = np.where(
            mask, step * (along / step % 1.0 - 0.5) * np.clip(width / 2 - 0.5, 0, 1), 0
        )
        steps = cv2.GaussianBlur(steps.astype(np.float32), (0, 0), 0.7)
        ridges += np.stack([np.gradient(steps, pitch, axis=1), -np.gradient(steps, pitch, axis=0)])
        raised, relief = raised + steps, relief + 1000 * steps

    def normals(gradient: NDArray[Any]) -> FloatArray:
        vectors = np.stack([-gradient[0], -gradient[1], np.ones_like(gradient[0])], axis=-1)
        vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
        vectors[~mask] = 0
        return np.asarray(vectors, dtype=np.float32)

    shape = np.where(mask, shape, np.nan).astype(np.float32)
    zero = np.zeros(mask.shape, dtype=np.float32)
    texture = (
        surface.texture if picture is None else Texture(zero + 1, zero, np.maximum(picture, 0.05))
    )
    return replace(
        surface,
        height_mm=shape + np.where(mask, raised, 0).astype(np.float32),
        shape_mm=shape,
        normals=normals(shaped + ridges),
        shape_normals=normals(shaped),
        relief_um=np.where(mask, relief, 0),
        texture=texture,
        coat=None,
    )


class _Scene(Scene):
    """A scene whose object may glow."""

    # (3, H, W) emitted light over that of a white card under one LED
    glow: FloatArray | None = None

    def ambient(self, name: str, leds: Sequence[Led]) -> FloatArray:
        """(H, W, 3) radiance with all LEDs off."""
        return super().ambient(name, leds) + np.moveaxis(self._emitted(name, leds), 0, -1)

    def brightest(
        self, light: BandLight, groups: Sequence[Sequence[int]], leds: Sequence[Led]
    ) -> float:
        """Brightest light that the exposure is set to."""
        return super().brightest(light, groups, leds) + float(
            self._emitted(leds[0].band, leds).max()
        )

    def _emitted(self, name: str, leds: Sequence[Led]) -> FloatArray:
        if self.glow is None or name == "nir":
            return np.zeros((3, 1, 1), dtype=np.float32)
        return self.glow * np.float32(ambient_level(self.rig.camera, leds, 1.0))
