"""Rigs that are compared: what changes from one to the next, what a rig must satisfy, and the study of all of them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Camera, Led, Rig
from splitknit.rig.photography import (
    LAMPS,
    MIN_LEVEL,
    W_PER_UNIT,
    PhotonSettings,
    electrons_per_s,
    intensity_w_sr,
    plan_exposure,
)
from splitknit.settings import Checked, Limits
from splitknit.simulator.light.lighting import irradiance

FULL_PX_PER_MM = 75.7
"""Of the full frame of the thesis's camera, 3200 x 2200 pixels."""
_FIELD_MM = (2200 / FULL_PX_PER_MM, 3200 / FULL_PX_PER_MM)
"""Rows and columns of the field on the finger plane: the lens is chosen for it, whatever the height."""
_LEDS_PER_BAND = 7


@dataclass(frozen=True, slots=True)
class RigCandidate:
    """One rig out of a sweep."""

    height_mm: float
    """Of camera and LEDs above the finger plane (the same, as in the thesis)."""
    radius_mm: float
    """Of the circle of LEDs."""
    power_w: float
    """Electrical power of one LED."""
    tilt_deg: float | None = None
    """Of the beams from the vertical, towards the axis; None aims them at the middle of the finger plane."""
    px_per_mm: float = 12.0
    """Resolution of the camera on the finger plane; the field stays."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("height_mm", 20.0, 1000.0),
            ("radius_mm", 1.0, 1000.0),
            ("power_w", 1e-4, 100.0),
            ("px_per_mm", 3.0, FULL_PX_PER_MM),
        ):
            value = getattr(self, name)
            require(
                bool(np.isfinite(value)) and low <= value <= high,
                f"a rig's {name} must lie between {low:g} and {high:g}, but it is {value:g}.",
            )
        require(
            self.tilt_deg is None or -60.0 <= self.tilt_deg <= 80.0,
            f"a rig's tilt_deg must lie between -60 and 80, or be 'centre', but it is {self.tilt_deg}.",
        )

    @property
    def beam_deg(self) -> float:
        """Angle of the beams from the vertical, towards the axis."""
        centre = float(np.rad2deg(np.arctan2(self.radius_mm, self.height_mm)))
        return centre if self.tilt_deg is None else self.tilt_deg

    @property
    def name(self) -> str:
        """Short, unique, fit for a file."""
        tilt = "centre" if self.tilt_deg is None else f"{self.tilt_deg:g}"
        return f"h{self.height_mm:g}_r{self.radius_mm:g}_p{self.power_w:g}_t{tilt}_s{self.px_per_mm:g}"

    @property
    def volume_l(self) -> float:
        """Size of the box: litres of the cylinder that holds LEDs and camera."""
        return float(np.pi * self.radius_mm**2 * self.height_mm * 1e-6)


@dataclass(frozen=True, slots=True)
class BuildSettings(Checked):
    """What all candidates share."""

    half_angle_deg: Annotated[float, Limits(5, 90)] = 30.0
    """Angle from the beam's axis at which an LED is half as bright: 60 for a bare chip, 30 and less with a lens; 90
    stands for equal light all around."""
    led_drop_mm: Annotated[float, Limits(-100, 100)] = 0.0
    """How far the LEDs stand below the front of the lens; negative is above."""
    view: Literal["perspective", "orthographic"] = "perspective"
    """Of the simulated camera: ``perspective``, or ``orthographic`` as the thesis assumes it."""

    @property
    def lobe_exponent(self) -> float:
        """Exponent m of an LED whose intensity falls with cos^m: half at the half angle."""
        if self.half_angle_deg >= 90.0:
            return 0.0
        return float(np.log(0.5) / np.log(np.cos(np.deg2rad(self.half_angle_deg))))


def grid(
    heights_mm: Sequence[float],
    radii_mm: Sequence[float],
    powers_w: Sequence[float],
    tilts_deg: Sequence[float | None] = (None,),
    resolutions: Sequence[float] = (12.0,),
) -> tuple[RigCandidate, ...]:
    """All combinations, in the order of the lists; what is listed twice counts once.

    Raises
    ------
    BadInput
        If a list is empty or holds an impossible value.
    """
    for name, values in (
        ("heights_mm", heights_mm),
        ("radii_mm", radii_mm),
        ("powers_w", powers_w),
        ("tilts_deg", tilts_deg),
        ("resolutions", resolutions),
    ):
        require(len(values) > 0, f"{name} is empty; list one value at least.")
    found = (
        RigCandidate(*values) for values in itertools.product(heights_mm, radii_mm, powers_w, tilts_deg, resolutions)
    )
    return tuple(dict.fromkeys(found))


def _camera_of(candidate: RigCandidate, build: BuildSettings, view: str | None = None) -> Camera:
    """The candidate's camera: the field of `build`, seen from the candidate's height."""
    rows, columns = (max(8, round(side * candidate.px_per_mm)) for side in _FIELD_MM)
    matrix = None
    if (view or build.view) == "perspective":
        focal = candidate.px_per_mm * candidate.height_mm
        matrix = np.array([[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1]], dtype=np.float64)
    return Camera(
        px_per_mm=candidate.px_per_mm,
        image_size=(rows, columns),
        height_mm=candidate.height_mm,
        model="orthographic" if matrix is None else "perspective",
        matrix=matrix,
    )


def candidate_rig(
    candidate: RigCandidate, build: BuildSettings, intensities: dict[str, float], view: str | None = None
) -> Rig:
    """The candidate as a rig.

    Parameters
    ----------
    candidate, build : what to build
    intensities : of the LEDs on their axis, by band, in W/sr; a band that is not named has no LEDs
    view : of the camera, where it differs from `build.view`
    """
    count = _LEDS_PER_BAND
    tilt = np.deg2rad(candidate.beam_deg)
    leds = []
    for band, intensity in intensities.items():
        for k in range(count):
            azimuth = 2.0 * np.pi * (k + (0.5 if band == "nir" else 0.0)) / count
            x, y = float(np.cos(azimuth)), float(np.sin(azimuth))
            z = candidate.height_mm - build.led_drop_mm
            leds.append(
                Led(
                    band=band,
                    position_mm=(candidate.radius_mm * x, candidate.radius_mm * y, z),
                    intensity=intensity,
                    lobe_exponent=build.lobe_exponent,
                    aim=(-float(np.sin(tilt)) * x, -float(np.sin(tilt)) * y, -float(np.cos(tilt))),
                )
            )
    return Rig(_camera_of(candidate, build, view), tuple(leds), {"source": "rig optimise", "candidate": candidate.name})


Array = NDArray[np.float64]


_LED_BODY_MM = 2.5
"""Radius of an LED's case."""
_CAMERA_BODY_MM = 17.3
"""Half the diagonal of the camera's board (25 x 24 mm), which stands inside the circle."""
_FINGER_MM = 12.0
"""Half the breadth of the opening that a large finger needs."""
_WALL_MM = 8.0
"""From the circle of the LEDs to the outside of the box."""
_BED_MM = (220.0, 250.0)
"""Side of the printer's bed, and its height."""
_ROUGHNESS = 0.25
"""GGX alpha of the skin whose specular reflection is evaluated."""
_MAX_BLIND = 0.05
"""Largest fraction of the print where fewer than three LEDs are free of it: three is what a normal needs."""
_BLUR_MM = 0.11
"""Disc of defocus that is allowed: a quarter of a ridge period."""
_ALBEDO = 0.6
"""Of the brightest channel of skin, for the exposure."""
_MIN_BEAM = 0.1
"""Smallest fraction of an LED's axial intensity that falls on the middle of the finger plane."""


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
class PrintPoints:
    """Where on a finger specular reflection is looked for."""

    points_mm: Array
    """(N, 3)."""
    normals: Array
    """(N, 3) of the finger's shape, towards the camera."""


def examine(
    candidate: RigCandidate,
    build: BuildSettings,
    photons: PhotonSettings,
    *,
    finger: PrintPoints,
    bands: Sequence[str] = ("white",),
) -> tuple[Finding, ...]:
    """Judge one candidate.

    Parameters
    ----------
    candidate, build, photons : the rig
    finger : surface of a typical finger
    bands : whose exposure is judged

    Returns
    -------
    One finding for every constraint, those that failed included.
    """
    exponent = build.lobe_exponent
    intensities = {band: intensity_w_sr(candidate.power_w, LAMPS[band], exponent) for band in bands}
    leds = candidate_rig(candidate, build, intensities).leds
    white = [led for led in leds if led.band == leds[0].band]
    return (
        _in_view(white, candidate, build),
        _into_lens(white, candidate),
        _room(candidate),
        _bed(candidate),
        _beam(candidate, exponent),
        _glare(white, candidate, build, finger),
        *(_exposed(band, [led for led in leds if led.band == band], photons) for band in bands),
        _depth(photons, finger),
    )


def _glare_lobe_rad(roughness: float) -> float:
    """Angle between normal and half vector at which a GGX surface's glare has fallen to half. Source: Walter et al.
    2007, equation (33): D is half its largest value where tan^2 = a^2 (sqrt 2 - 1) / (1 - sqrt 2 a^2).
    """
    squared = min(roughness**2, 0.6)
    return float(np.arctan(np.sqrt(squared * (np.sqrt(2) - 1) / (1 - np.sqrt(2) * squared))))


def _glaring(
    leds: list[Led], candidate: RigCandidate, build: BuildSettings, roughness: float, finger: PrintPoints
) -> Array:
    """(L, N) whether each LED's mirror direction lies within the roughness lobe, seen by the camera."""
    points = finger.points_mm
    view = np.array([0.0, 0.0, 1.0])
    if build.view == "perspective":
        view = _unit(np.array([0.0, 0.0, candidate.height_mm]) - points)
    limit = np.cos(_glare_lobe_rad(roughness))
    rows = []
    for led in leds:
        half = _unit(_unit(np.asarray(led.position_mm) - points) + view)
        rows.append(np.sum(half * finger.normals, axis=1) > limit)
    return np.array(rows)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _in_view(leds: list[Led], candidate: RigCandidate, build: BuildSettings) -> Finding:
    """Distance of the LEDs' cases from the pyramid (or prism) that the camera sees."""
    clear = np.inf
    for led in leds:
        x, y, z = np.asarray(led.position_mm)
        below = candidate.height_mm - z + _LED_BODY_MM  # of the LED's lowest point, from the lens
        if below <= 0:
            continue
        fraction = below / candidate.height_mm if build.view == "perspective" else 1.0
        half_y, half_x = (0.5 * side * fraction for side in _FIELD_MM)
        outside = np.hypot(max(abs(x) - half_x, 0.0), max(abs(y) - half_y, 0.0))
        clear = min(clear, outside - _LED_BODY_MM)
    clear = float(min(clear, 1e3))
    ok = clear > 0.0
    words = (
        f"the LEDs stand {clear:.1f} mm beside what the camera sees."
        if ok
        else f"an LED on a circle of {candidate.radius_mm:g} mm stands in the picture; widen the circle or raise it."
    )
    return Finding("leds_in_view", ok, True, clear, words)


def _into_lens(leds: list[Led], candidate: RigCandidate) -> Finding:
    """Fraction of an LED's axial intensity that meets the front of the lens, weighed by the cosine there."""
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


def _room(candidate: RigCandidate) -> Finding:
    inside = candidate.radius_mm - _LED_BODY_MM
    needed = max(_CAMERA_BODY_MM, _FINGER_MM)
    ok = inside >= needed
    words = (
        f"{inside:.1f} mm are free inside the circle."
        if ok
        else f"inside the circle only {inside:.1f} mm are free, but camera and finger need {needed:.1f} mm; widen it."
    )
    return Finding("room", ok, True, inside - needed, words)


def _bed(candidate: RigCandidate) -> Finding:
    breadth = 2.0 * (candidate.radius_mm + _WALL_MM)
    spare = min(_BED_MM[0] - breadth, _BED_MM[1] - candidate.height_mm)
    ok = spare >= 0.0
    words = (
        f"the box, {breadth:.0f} mm wide and {candidate.height_mm:.0f} mm high, fits the printer."
        if ok
        else f"the box, {breadth:.0f} mm wide and {candidate.height_mm:.0f} mm high, does not fit a printer of "
        f"{_BED_MM[0]:g} mm and {_BED_MM[1]:g} mm of height."
    )
    return Finding("printer", ok, True, spare, words)


def _beam(candidate: RigCandidate, exponent: float) -> Finding:
    centre = float(np.rad2deg(np.arctan2(candidate.radius_mm, candidate.height_mm)))
    off = abs(candidate.beam_deg - centre)
    fraction = max(float(np.cos(np.deg2rad(off))), 0.0) ** exponent
    ok = fraction >= _MIN_BEAM and off < 75.0
    words = (
        f"the finger gets {100 * fraction:.0f} % of the LEDs' axial intensity."
        if ok
        else f"beams {off:.0f} deg off the finger give it {100 * fraction:.0f} % of it; tilt them by {centre:.0f} deg."
    )
    return Finding("beam", ok, True, fraction, words)


def _glare(leds: list[Led], candidate: RigCandidate, build: BuildSettings, finger: PrintPoints) -> Finding:
    glare = _glaring(leds, candidate, build, _ROUGHNESS, finger)
    free = (~glare.astype(bool)).sum(axis=0)
    blind = float(np.mean(free < 3))
    ok = blind <= _MAX_BLIND
    covered = f"glare covers {100 * float(glare.mean()):.0f} % of the print under one LED"
    words = (
        f"{covered}, and {100 * blind:.0f} % of it under all but two."
        if ok
        else f"{covered}; on {100 * blind:.0f} % of it fewer than three LEDs are free of it; widen or lower the circle."
    )
    return Finding("glare", ok, True, blind, words)


def _exposed(band: str, leds: list[Led], photons: PhotonSettings) -> Finding:
    """Exposure of a facing patch of skin below the middle."""
    spots = np.array([[0.0, 5.0, -5.0, 0.0, 0.0], [0.0, 0.0, 0.0, 5.0, -5.0], np.zeros(5)])
    brightest = W_PER_UNIT * max(float(irradiance(led, spots, (0.0, 0.0, 1.0)).max()) for led in leds)
    rate = electrons_per_s(_ALBEDO / np.pi * brightest, LAMPS[band], photons) if brightest else 0.0
    if rate <= 0.0:
        return Finding(f"exposure_{band}", False, True, 0.0, "no light falls on the finger; turn the beams towards it.")
    plan = plan_exposure(rate, photons)
    how = f"{1000 * plan.time_s:.3g} ms at gain {plan.gain:.2g}"
    dark = plan.level < MIN_LEVEL
    ok = not dark and not plan.saturates
    words = f"the {band} band is exposed for {how} to {100 * plan.level:.0f} % of full scale."
    if dark:
        words = f"the {band} band is too dark: {how} give {100 * plan.level:.2g} % of full scale; use more power."
    elif plan.saturates:
        words = f"the {band} band is too bright: {how} give {100 * plan.level:.0f} % of full scale; use less power."
    return Finding(f"exposure_{band}", ok, True, plan.level, words)


def _depth(photons: PhotonSettings, finger: PrintPoints) -> Finding:
    seen = float(np.ptp(finger.points_mm[:, 2]))
    sharp = photons.depth_of_field_mm(_BLUR_MM)
    ok = sharp >= seen
    words = f"{sharp:.1f} mm of depth are sharp within {_BLUR_MM:g} mm at f/{photons.f_number:g}; the print has "
    words += f"{seen:.1f} mm." if ok else f"{seen:.1f} mm: stop down."
    return Finding("depth_of_field", ok, False, sharp - seen, words)


FIRST_SEED = 400
"""Of the fingers."""
TRUTH_PX_PER_MM = 10.0
"""Density of the points of the true surface."""
METHODS = {
    "ea": "the thesis's plain photometric stereo: distant lights, Frankot-Chellappa",
    "ea-poisson": "the same normals, integrated over the finger's mask alone",
    "metric": "near lights, a calibrated perspective camera, glare and scattering undone",
}
MATERIALS = {"opaque": "an opaque Lambertian finger, as the thesis's sculpture", "skin": "the twin's skin"}
CAMERAS = {
    "sensor": "the rig's: photons, noise, defocus, exposure chosen within the shutter's range",
    "renderer": "a rendering program's: pin-hole, no noise, one fixed exposure, bare isotropic lamps, 8 bits sRGB",
}


@dataclass(frozen=True, slots=True)
class Study(Checked):
    """Everything that a candidate's figures follow from, besides the candidate."""

    method: Literal["ea", "ea-poisson", "metric"] = "ea"
    """See :data:`METHODS`."""
    material: Literal["opaque", "skin"] = "opaque"
    """See :data:`MATERIALS`."""
    camera: Literal["sensor", "renderer"] = "sensor"
    """See :data:`CAMERAS`."""
    fingers: Annotated[int, Limits(1, 200)] = 3
    """Number of fingers; all candidates photograph the same ones, with the same noise."""
    build: BuildSettings = field(default_factory=BuildSettings)
    photons: PhotonSettings = field(default_factory=PhotonSettings)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Of the fingers."""
        return tuple(range(FIRST_SEED, FIRST_SEED + self.fingers))

    @property
    def bands(self) -> tuple[str, ...]:
        """Bands that the method looks at."""
        return ("white", "nir") if self.method == "metric" else ("white",)
