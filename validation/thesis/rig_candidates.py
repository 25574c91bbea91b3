"""Rigs that are compared: what changes from one to the next, how brightly a rig exposes, and what
it must satisfy.

Radiometry: an LED of the electrical power P emits the flux efficiency * P in a lobe cos^m, so its
intensity on the axis is flux (m + 1) / (2 pi); irradiance falls with the squared distance; a lens
of the f-number N that images with the magnification M gives the sensor pi L T / (4 N^2 (1 + M)^2)
of a surface of radiance L; photons times the quantum efficiency are electrons.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Camera, Led, Rig
from splitknit_simulator.calibration_set.solids import unit

Array = NDArray[np.float64]
FULL_PX_PER_MM = 75.7  # scale of the full frame of the thesis's camera, 3200 x 2200 pixels
FIELD_MM = (2200 / FULL_PX_PER_MM, 3200 / FULL_PX_PER_MM)
"""Rows and columns of the field on the finger plane: the lens is chosen for it, whatever the
height."""
_LEDS_PER_BAND = 7


@dataclass(frozen=True, slots=True)
class RigCandidate:
    """One rig out of a sweep."""

    height_mm: float
    """Height of camera and LEDs above the finger plane (the same, as in the thesis)."""
    radius_mm: float
    """Radius of the circle of LEDs."""
    power_w: float
    """Electrical power of one LED."""
    tilt_deg: float | None = None
    """Tilt of the beams from the vertical, towards the axis; None aims them at the middle of the
    finger plane."""
    px_per_mm: float = 12.0
    """Resolution of the camera on the finger plane; the field stays."""

    @property
    def beam_deg(self) -> float:
        """Angle of the beams from the vertical, towards the axis."""
        centre = float(np.rad2deg(np.arctan2(self.radius_mm, self.height_mm)))
        return centre if self.tilt_deg is None else self.tilt_deg

    @property
    def name(self) -> str:
        """Short, unique, fit for a file."""
        tilt = "centre" if self.tilt_deg is None else f"{self.tilt_deg:g}"
        return (
            f"h{self.height_mm:g}_r{self.radius_mm:g}_p{self.power_w:g}_t{tilt}_s{self.px_per_mm:g}"
        )


@dataclass(frozen=True, slots=True)
class BuildSettings:
    """What all candidates share."""

    half_angle_deg: float = 30.0
    """Angle at which an LED is half as bright: 60 bare, 30 and less with a lens, 90 for even
    light."""
    view: str = "perspective"
    """Model of the simulated camera: ``perspective``, or ``orthographic`` as the thesis assumes
    it."""

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
    tilts_deg: Sequence[float | None],
    resolutions: Sequence[float],
) -> tuple[RigCandidate, ...]:
    """All combinations, in the lists' order, each once."""
    axes = itertools.product(heights_mm, radii_mm, powers_w, tilts_deg, resolutions)
    return tuple(dict.fromkeys(RigCandidate(*values) for values in axes))


def _camera_of(candidate: RigCandidate, build: BuildSettings) -> Camera:
    rows, columns = (max(8, round(side * candidate.px_per_mm)) for side in FIELD_MM)
    camera = Camera(candidate.px_per_mm, (rows, columns), height_mm=candidate.height_mm)
    if build.view == "orthographic":
        return camera
    focal = candidate.px_per_mm * candidate.height_mm
    matrix = np.array(
        [[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1]], dtype=np.float64
    )
    return replace(camera, model="perspective", matrix=matrix)


def candidate_rig(
    candidate: RigCandidate, build: BuildSettings, intensities: Mapping[str, float]
) -> Rig:
    """The candidate as a rig; `intensities`: of the LEDs on their axis, in W/sr, of each band that
    has LEDs."""
    tilt = np.deg2rad(candidate.beam_deg)
    leds = []
    for band, intensity in intensities.items():
        for k in range(_LEDS_PER_BAND):
            azimuth = 2.0 * np.pi * (k + (0.5 if band == "nir" else 0.0)) / _LEDS_PER_BAND
            x, y = float(np.cos(azimuth)), float(np.sin(azimuth))
            place = (candidate.radius_mm * x, candidate.radius_mm * y, candidate.height_mm)
            aim = (-float(np.sin(tilt)) * x, -float(np.sin(tilt)) * y, -float(np.cos(tilt)))
            leds.append(
                Led(band, place, intensity=intensity, lobe_exponent=build.lobe_exponent, aim=aim)
            )
    return Rig(
        _camera_of(candidate, build),
        tuple(leds),
        {"source": "search of rigs", "candidate": candidate.name},
    )


# How brightly a rig exposes.

PLANCK_LIGHT = 1.98645e-25  # Planck's constant times the speed of light, J m


@dataclass(frozen=True, slots=True)
class _Lamp:
    """One band's LED and how well the sensor sees it."""

    efficiency: float  # radiant flux over electrical power
    wavelength_nm: float  # mean, for the energy of a photon
    # electrons of a green pixel per photon of this light, colour filter included
    quantum_efficiency: float


LAMPS = {"white": _Lamp(0.31, 560.0, 0.22), "nir": _Lamp(0.40, 850.0, 0.20)}
"""By band. White: 100 lm/W, as data sheets of white LEDs of this size give it, over 320 lm a watt
of light of a phosphor LED of 5000 K; green filters pass a third of its photons to silicon of 65 %.
Near infrared: data sheets of 850 nm emitters; the camera without infrared filter."""
_TRANSMISSION = 0.9  # transmission of the lens
_PIXEL_UM = 1.12  # pixel of the IMX219 at full resolution; smaller pictures bin its pixels
MAGNIFICATION = _PIXEL_UM * 1e-3 * FULL_PX_PER_MM  # size on the sensor over size on the finger
FULL_WELL_E = 4700.0  # electrons at full scale of a pixel at full resolution
# standard deviation of the noise of reading out, electrons, a pixel at full resolution
READ_NOISE_E = 2.5
TARGET_LEVEL = 0.7  # fraction of full scale that the brightest skin shall reach
MIN_LEVEL = 0.1  # below this fraction a picture is too dark to be used
_LONGEST_S = 0.2  # 14 pictures in 7 s leave half a second each for light, settling and reading out
_MAX_GAIN = 8.0  # largest gain of the camera: beyond it a picture stays dark


@dataclass(frozen=True, slots=True)
class PhotonSettings:
    """Lens and shutter."""

    f_number: float = 4.0
    """The lens's focal length over its pupil."""
    shortest_s: float = 1.0 / 4000.0
    """Shortest exposure time."""

    def focal_mm(self, height_mm: float) -> float:
        """Focal length that images from `height_mm` with this magnification (thin lens)."""
        return height_mm * MAGNIFICATION / (1.0 + MAGNIFICATION)


@dataclass(frozen=True, slots=True)
class PlannedExposure:
    """How one band is exposed."""

    time_s: float
    gain: float
    # fraction of full scale of the brightest skin: the target where the shutter and the gain allow
    # it
    level: float


def intensity_w_sr(power_w: float, lamp: _Lamp, lobe_exponent: float) -> float:
    """Radiant intensity of an LED on its axis."""
    return power_w * lamp.efficiency * (lobe_exponent + 1.0) / (2.0 * np.pi)


def electrons_per_s(radiance: float, lamp: _Lamp, settings: PhotonSettings) -> float:
    """Electrons a second in one full-resolution green pixel that looks at `radiance`, in W/(m^2
    sr)."""
    on_sensor = (
        np.pi * radiance * _TRANSMISSION / (4.0 * (settings.f_number * (1 + MAGNIFICATION)) ** 2)
    )
    photons = on_sensor * (_PIXEL_UM * 1e-6) ** 2 * lamp.wavelength_nm * 1e-9 / PLANCK_LIGHT
    return float(photons * lamp.quantum_efficiency)


def plan_exposure(rate_e_s: float, settings: PhotonSettings) -> PlannedExposure:
    """Shutter first, then gain, then darkness, for electrons a second where the finger is
    brightest."""
    require(rate_e_s > 0, "no light falls on the finger; turn the LEDs towards it.")
    wanted = TARGET_LEVEL * FULL_WELL_E / rate_e_s
    time = float(np.clip(wanted, settings.shortest_s, _LONGEST_S))
    gain = float(np.clip(wanted / time, 1.0, _MAX_GAIN))
    return PlannedExposure(time, gain, rate_e_s * time * gain / FULL_WELL_E)


W_PER_UNIT = 100.0
"""W/(m^2 sr) in one unit of the twin's radiance, where intensities are W/sr: its unit is that of
100 mm, (0.1 m)^-2."""
_ROUGHNESS = 0.25  # GGX alpha of the skin whose specular reflection is evaluated
_MAX_BLIND = 0.05
"""Largest fraction of the print where fewer than three LEDs are free of it: three is what a normal
needs."""


@dataclass(frozen=True, slots=True, eq=False)
class PrintPoints:
    """Where on a finger specular reflection is looked for: (N, 3) points in mm, and normals towards
    the camera."""

    points_mm: Array
    normals: Array


def led_intensities(
    candidate: RigCandidate, build: BuildSettings, bands: Sequence[str]
) -> dict[str, float]:
    """Radiant intensity of the candidate's LEDs on their axis, W/sr, by band."""
    return {
        band: intensity_w_sr(candidate.power_w, LAMPS[band], build.lobe_exponent) for band in bands
    }


def glare_fault(candidate: RigCandidate, build: BuildSettings, finger: PrintPoints) -> str:
    """Why too much of the print shows specular reflection, "" where it does not: each LED's mirror
    direction must lie outside the roughness lobe, seen by the camera."""
    leds, points = candidate_rig(candidate, build, {"white": 1.0}).leds, finger.points_mm
    view = np.array([0.0, 0.0, 1.0])
    if build.view == "perspective":
        view = unit(np.array([0.0, 0.0, candidate.height_mm]) - points)
    halves = [unit(unit(np.asarray(led.position_mm) - points) + view) for led in leds]
    limit = np.cos(_glare_lobe_rad(_ROUGHNESS))
    clear = [np.sum(half * finger.normals, axis=1) <= limit for half in halves]
    blind = float(np.mean(np.sum(clear, axis=0) < 3))
    return (
        ""
        if blind <= _MAX_BLIND
        else f"on {100 * blind:.0f} % of the print fewer than three LEDs show no glare."
    )


def _glare_lobe_rad(roughness: float) -> float:
    """Angle between normal and half vector where a GGX surface's glare is halved: Walter et al.
    2007, equation (33)."""
    squared = min(roughness**2, 0.6)
    return float(np.arctan(np.sqrt(squared * (np.sqrt(2) - 1) / (1 - np.sqrt(2) * squared))))
