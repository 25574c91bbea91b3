"""What a rig must satisfy before it is worth photographing with, found by geometry alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Led
from splitknit.rig.candidates import BuildSettings, Candidate, rig_of
from splitknit.rig.photons import PhotonSettings, electrons_per_s, intensity_w_sr, plan_exposure

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Limits:
    """How much is too much."""

    led_body_mm: float = 2.5
    """Radius of an LED's case."""
    camera_body_mm: float = 17.3
    """Half the diagonal of the camera's board (25 x 24 mm), which stands inside the circle."""
    finger_mm: float = 12.0
    """Half the breadth of the opening that a large finger needs."""
    wall_mm: float = 8.0
    """From the circle of the LEDs to the outside of the box."""
    bed_mm: tuple[float, float] = (220.0, 250.0)
    """Side of the printer's bed, and its height."""
    roughness: float = 0.25
    """GGX alpha of the skin whose glare is judged."""
    blind_share: float = 0.05
    """Largest share of the print where fewer than three LEDs are free of glare: three is what a normal needs."""
    blur_mm: float = 0.11
    """Disc of defocus that is allowed: a quarter of a ridge period."""
    albedo: float = 0.6
    """Of the brightest channel of skin, for the exposure."""
    beam_share: float = 0.1
    """Least share of an LED's axial intensity that falls on the middle of the finger plane."""

    def __post_init__(self) -> None:
        for name in ("led_body_mm", "camera_body_mm", "finger_mm", "wall_mm", "blur_mm", "roughness", "albedo"):
            value = getattr(self, name)
            require(bool(np.isfinite(value)) and value > 0, f"limits.{name} must be positive, but it is {value}.")
        require(min(self.bed_mm) > 0, f"limits.bed_mm must be positive, but it is {self.bed_mm}.")
        require(0 <= self.blind_share <= 1, f"limits.blind_share must be 0 to 1, but it is {self.blind_share}.")


@dataclass(frozen=True, slots=True)
class Finding:
    """One constraint and what a rig makes of it."""

    name: str
    ok: bool
    hard: bool
    """Whether a rig that fails is left out; otherwise it is only said."""
    value: float
    words: str
    """One sentence."""


@dataclass(frozen=True, slots=True, eq=False)
class Print:
    """Where on a finger glare is looked for."""

    points_mm: Array
    """(N, 3)."""
    normals: Array
    """(N, 3) of the finger's shape, towards the camera."""


def examine(
    candidate: Candidate,
    build: BuildSettings,
    photons: PhotonSettings,
    limits: Limits,
    *,
    finger: Print,
    bands: Sequence[str] = ("white",),
) -> tuple[Finding, ...]:
    """Judge one candidate.

    Parameters
    ----------
    candidate, build, photons, limits : the rig and what is asked of it
    finger : surface of a typical finger
    bands : whose exposure is judged

    Returns
    -------
    One finding for every constraint, those that failed included.
    """
    exponent = build.lobe_exponent
    intensities = {band: intensity_w_sr(candidate.power_w, photons.lamps[band], exponent) for band in bands}
    leds = rig_of(candidate, build, intensities).leds
    white = [led for led in leds if led.band == leds[0].band]
    return (
        _in_view(white, candidate, build, limits),
        _into_lens(white, candidate),
        _room(candidate, limits),
        _bed(candidate, limits),
        _beam(candidate, exponent, limits),
        _glare(white, candidate, build, limits, finger),
        *(_exposed(band, [led for led in leds if led.band == band], photons, limits) for band in bands),
        _depth(photons, limits, finger),
    )


def glare_lobe_rad(roughness: float) -> float:
    """Angle between normal and half vector at which a GGX surface's glare has fallen to half.

    References
    ----------
    Walter et al. 2007, equation (33): D is half its largest value where tan^2 = a^2 (sqrt 2 - 1) / (1 - sqrt 2 a^2).
    """
    squared = min(roughness**2, 0.6)
    return float(np.arctan(np.sqrt(squared * (np.sqrt(2) - 1) / (1 - np.sqrt(2) * squared))))


def glaring(leds: list[Led], candidate: Candidate, build: BuildSettings, roughness: float, finger: Print) -> Array:
    """(L, N) whether each LED's mirror direction lies within the roughness lobe, seen by the camera."""
    points = finger.points_mm
    view = np.array([0.0, 0.0, 1.0])
    if build.view == "perspective":
        view = _unit(np.array([0.0, 0.0, candidate.height_mm]) - points)
    limit = np.cos(glare_lobe_rad(roughness))
    rows = []
    for led in leds:
        half = _unit(_unit(np.asarray(led.position_mm) - points) + view)
        rows.append(np.sum(half * finger.normals, axis=1) > limit)
    return np.array(rows)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _in_view(leds: list[Led], candidate: Candidate, build: BuildSettings, limits: Limits) -> Finding:
    """Distance of the LEDs' cases from the pyramid (or prism) that the camera sees."""
    clear = np.inf
    for led in leds:
        x, y, z = np.asarray(led.position_mm)
        below = candidate.height_mm - z + limits.led_body_mm  # of the LED's lowest point, from the lens
        if below <= 0:
            continue
        share = below / candidate.height_mm if build.view == "perspective" else 1.0
        half_y, half_x = (0.5 * side * share for side in build.field_mm)
        outside = np.hypot(max(abs(x) - half_x, 0.0), max(abs(y) - half_y, 0.0))
        clear = min(clear, outside - limits.led_body_mm)
    clear = float(min(clear, 1e3))
    ok = clear > 0.0
    words = (
        f"the LEDs stand {clear:.1f} mm beside what the camera sees."
        if ok
        else f"an LED on a circle of {candidate.radius_mm:g} mm stands in the picture; widen the circle or raise it."
    )
    return Finding("leds_in_view", ok, True, clear, words)


def _into_lens(leds: list[Led], candidate: Candidate) -> Finding:
    """Share of an LED's axial intensity that meets the front of the lens, weighed by the cosine there."""
    worst = 0.0
    for led in leds:
        to_lens = np.array([0.0, 0.0, candidate.height_mm]) - np.asarray(led.position_mm)
        distance = float(np.linalg.norm(to_lens))
        if distance == 0.0:
            continue
        meets = max(float(to_lens[2]) / distance, 0.0)  # the lens looks down: only light from below meets it
        leaves = max(float(np.dot(led.axis, to_lens)) / distance, 0.0)
        worst = max(worst, meets * leaves**led.lobe_exponent if meets > 0 else 0.0)
    ok = worst < 1e-3
    words = (
        "no LED shines into the lens."
        if ok
        else f"LEDs below the lens shine into it ({100 * worst:.1f} % of their axial light); raise or shade them."
    )
    return Finding("direct_light", ok, True, worst, words)


def _room(candidate: Candidate, limits: Limits) -> Finding:
    inside = candidate.radius_mm - limits.led_body_mm
    needed = max(limits.camera_body_mm, limits.finger_mm)
    ok = inside >= needed
    words = (
        f"{inside:.1f} mm are free inside the circle."
        if ok
        else f"inside the circle only {inside:.1f} mm are free, but camera and finger need {needed:.1f} mm; widen it."
    )
    return Finding("room", ok, True, inside - needed, words)


def _bed(candidate: Candidate, limits: Limits) -> Finding:
    breadth = 2.0 * (candidate.radius_mm + limits.wall_mm)
    spare = min(limits.bed_mm[0] - breadth, limits.bed_mm[1] - candidate.height_mm)
    ok = spare >= 0.0
    words = (
        f"the box, {breadth:.0f} mm wide and {candidate.height_mm:.0f} mm high, fits the printer."
        if ok
        else f"the box, {breadth:.0f} mm wide and {candidate.height_mm:.0f} mm high, does not fit a printer of "
        f"{limits.bed_mm[0]:g} mm and {limits.bed_mm[1]:g} mm of height."
    )
    return Finding("printer", ok, True, spare, words)


def _beam(candidate: Candidate, exponent: float, limits: Limits) -> Finding:
    centre = float(np.rad2deg(np.arctan2(candidate.radius_mm, candidate.height_mm)))
    off = abs(candidate.beam_deg - centre)
    share = max(float(np.cos(np.deg2rad(off))), 0.0) ** exponent
    ok = share >= limits.beam_share and off < 75.0
    words = (
        f"the finger gets {100 * share:.0f} % of the LEDs' axial intensity."
        if ok
        else f"beams {off:.0f} deg off the finger give it {100 * share:.0f} % of it; tilt them by {centre:.0f} deg."
    )
    return Finding("beam", ok, True, share, words)


def _glare(leds: list[Led], candidate: Candidate, build: BuildSettings, limits: Limits, finger: Print) -> Finding:
    glare = glaring(leds, candidate, build, limits.roughness, finger)
    free = (~glare.astype(bool)).sum(axis=0)
    blind = float(np.mean(free < 3))
    ok = blind <= limits.blind_share
    shares = f"glare covers {100 * float(glare.mean()):.0f} % of the print under one LED"
    words = (
        f"{shares}, and {100 * blind:.0f} % of it under all but two."
        if ok
        else f"{shares}; on {100 * blind:.0f} % of it fewer than three LEDs are free of it; widen or lower the circle."
    )
    return Finding("glare", ok, True, blind, words)


def _exposed(band: str, leds: list[Led], photons: PhotonSettings, limits: Limits) -> Finding:
    """Exposure of a facing patch of skin below the middle."""
    brightest = 0.0
    for led in leds:
        for x, y in ((0.0, 0.0), (5.0, 0.0), (-5.0, 0.0), (0.0, 5.0), (0.0, -5.0)):
            towards = np.asarray(led.position_mm) - np.array([x, y, 0.0])
            squared = float(towards @ towards)
            along = max(-float(led.axis @ towards) / np.sqrt(squared), 0.0)
            irradiance = led.intensity * along**led.lobe_exponent * 1e6 / squared * float(towards[2]) / np.sqrt(squared)
            brightest = max(brightest, irradiance)
    rate = electrons_per_s(limits.albedo / np.pi * brightest, photons.lamps[band], photons) if brightest else 0.0
    if rate <= 0.0:
        return Finding(f"exposure_{band}", False, True, 0.0, "no light falls on the finger; turn the beams towards it.")
    plan = plan_exposure(rate, photons)
    how = f"{1000 * plan.time_s:.3g} ms at gain {plan.gain:.2g}"
    dark = plan.level < photons.least_level
    ok = not dark and not plan.saturates
    words = f"the {band} band is exposed for {how} to {100 * plan.level:.0f} % of full scale."
    if dark:
        words = f"the {band} band is too dark: {how} give {100 * plan.level:.2g} % of full scale; use more power."
    elif plan.saturates:
        words = f"the {band} band is too bright: {how} give {100 * plan.level:.0f} % of full scale; use less power."
    return Finding(f"exposure_{band}", ok, True, plan.level, words)


def _depth(photons: PhotonSettings, limits: Limits, finger: Print) -> Finding:
    seen = float(np.ptp(finger.points_mm[:, 2]))
    sharp = photons.depth_of_field_mm(limits.blur_mm)
    ok = sharp >= seen
    words = f"{sharp:.1f} mm of depth are sharp within {limits.blur_mm:g} mm at f/{photons.f_number:g}; the print has "
    words += f"{seen:.1f} mm." if ok else f"{seen:.1f} mm: stop down."
    return Finding("depth_of_field", ok, False, sharp - seen, words)
