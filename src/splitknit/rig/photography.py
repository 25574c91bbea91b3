"""A candidate rig photographs a finger: light, lens, shutter and noise, in physical units.

Radiometry: an LED of the electrical power P emits the flux efficiency * P in a lobe cos^m, so its intensity on the axis
is flux (m + 1) / (2 pi); irradiance falls with the squared distance; a lens of the f-number N that images with the
magnification M gives the sensor pi L T / (4 N^2 (1 + M)^2) of a surface of radiance L; photons times the quantum
efficiency are electrons.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.model import Band, BoolArray, Capture, FloatArray, Led, Rig
from splitknit.settings import Checked, Limits
from splitknit.simulator.camera.lens import blur_sigma_px, defocus
from splitknit.simulator.camera.sensor import SensorSettings, record
from splitknit.simulator.light.lighting import render_opaque, white_card
from splitknit.simulator.light.renderer import RenderSettings, render_band
from splitknit.simulator.light.skin import BAND_CHANNELS, SkinOptics
from splitknit.simulator.scene import finger_depth
from splitknit.simulator.surface import SimulatedSurface

PLANCK_LIGHT = 1.98645e-25
"""Planck's constant times the speed of light, J m."""


@dataclass(frozen=True, slots=True)
class _Lamp:
    """One band's LED and how well the sensor sees it."""

    efficiency: float
    """Radiant flux over electrical power."""
    wavelength_nm: float
    """Mean, for the energy of a photon."""
    quantum_efficiency: float
    """Electrons of a green pixel per photon of this light, colour filter included."""


LAMPS = {"white": _Lamp(0.31, 560.0, 0.22), "nir": _Lamp(0.40, 850.0, 0.20)}
"""By band. White: 100 lm/W, as data sheets of white LEDs of this size give it, over 320 lm a watt of light of a
phosphor LED of 5000 K; green filters pass a third of its photons to silicon of 65 %. Near infrared: data sheets of
850 nm emitters; the camera without infrared filter."""
_TRANSMISSION = 0.9
"""Of the lens."""
_PIXEL_UM = 1.12
"""Of the IMX219 at full resolution; smaller pictures bin its pixels."""
_FULL_PX_PER_MM = 75.7
"""At full resolution on the finger plane; with the pixel it fixes the magnification."""
MAGNIFICATION = _PIXEL_UM * 1e-3 * _FULL_PX_PER_MM
"""Size on the sensor over size on the finger."""
FULL_WELL_E = 4700.0
"""Electrons at full scale of a pixel at full resolution."""
_READ_NOISE_E = 2.5
"""Standard deviation of the noise of reading out, electrons, a pixel at full resolution."""
TARGET_LEVEL = 0.7
"""Fraction of full scale that the brightest skin shall reach."""
MIN_LEVEL = 0.1
"""Below this fraction a picture is too dark to be used."""
_LONGEST_S = 0.2
"""14 pictures in 7 s leave half a second each for light, settling and reading out."""
_MAX_GAIN = 8.0
"""Of the camera: beyond it a picture stays dark."""
_TREMOR_UM = 30.0
"""Amplitude of a resting finger's tremor (Growdon et al. 2000: about 30 um)."""
_TREMOR_HZ = 9.0
"""Frequency of the tremor."""


@dataclass(frozen=True, slots=True)
class PhotonSettings(Checked):
    """Lens and shutter."""

    _group = "photons"

    f_number: Annotated[float, Limits(0, above=True)] = 4.0
    """The lens's focal length over its pupil."""
    shortest_s: Annotated[float, Limits(0, _LONGEST_S, above=True)] = 1.0 / 4000.0
    """Shortest exposure time."""

    def focal_mm(self, height_mm: float) -> float:
        """Focal length that images from `height_mm` with this magnification (thin lens)."""
        return height_mm * MAGNIFICATION / (1.0 + MAGNIFICATION)

    def depth_of_field_mm(self, blur_mm: float) -> float:
        """Depth within which a point's image stays below `blur_mm` on the finger; the height drops out of it."""
        return 2.0 * self.f_number * blur_mm * (1.0 + MAGNIFICATION) / MAGNIFICATION


@dataclass(frozen=True, slots=True)
class _Exposure:
    """How one band is exposed."""

    time_s: float
    gain: float
    level: float
    """Fraction of full scale of the brightest skin: the target where the shutter and the gain allow it."""

    @property
    def saturates(self) -> bool:
        """Whether the brightest skin is beyond full scale."""
        return self.level > 1.0


def intensity_w_sr(power_w: float, lamp: _Lamp, lobe_exponent: float) -> float:
    """Radiant intensity of an LED on its axis."""
    return power_w * lamp.efficiency * (lobe_exponent + 1.0) / (2.0 * np.pi)


def electrons_per_s(radiance: float, lamp: _Lamp, settings: PhotonSettings) -> float:
    """Electrons a second in one full-resolution green pixel that looks at `radiance`, in W/(m^2 sr)."""
    on_sensor = np.pi * radiance * _TRANSMISSION / (4.0 * (settings.f_number * (1 + MAGNIFICATION)) ** 2)
    photons = on_sensor * (_PIXEL_UM * 1e-6) ** 2 * lamp.wavelength_nm * 1e-9 / PLANCK_LIGHT
    return float(photons * lamp.quantum_efficiency)


def plan_exposure(rate_e_s: float, settings: PhotonSettings) -> _Exposure:
    """Shutter first, then gain, then darkness.

    Parameters
    ----------
    rate_e_s : electrons a second where the finger is brightest

    Returns
    -------
    Exposure whose level is the target where the ranges of shutter and gain allow it, else what they give.
    """
    require(rate_e_s > 0, "no light falls on the finger; turn the LEDs towards it.")
    wanted = TARGET_LEVEL * FULL_WELL_E / rate_e_s
    time = float(np.clip(wanted, settings.shortest_s, _LONGEST_S))
    gain = float(np.clip(wanted / time, 1.0, _MAX_GAIN))
    return _Exposure(time, gain, rate_e_s * time * gain / FULL_WELL_E)


def _tremor_blur_mm(time_s: float) -> float:
    """Standard deviation, per axis, of where a trembling finger is while the shutter is open.

    A sinusoid of amplitude a and a random phase, seen for the time t, varies by a^2 / 2 (1 - sinc^2(f t)) on average.
    """
    fraction = 1.0 - float(np.sinc(_TREMOR_HZ * time_s)) ** 2
    return _TREMOR_UM * 1e-3 * float(np.sqrt(0.5 * fraction))


W_PER_UNIT = 100.0
"""W/(m^2 sr) in one unit of the twin's radiance, where intensities are W/sr: its unit is that of 100 mm, (0.1 m)^-2."""
OPAQUE_ALBEDO = 0.5
CLOTH_ALBEDO, CLOTH_DEPTH_MM = 0.006, 10.0
"""Black cloth below the finger."""
FOCUS_DEPTH_MM = 1.5
"""The lens is focused this far below the finger's highest point."""


@dataclass(frozen=True, slots=True, eq=False)
class ExposedCapture:
    """A capture and how it was exposed."""

    capture: Capture
    exposures: Mapping[str, _Exposure]


def photograph_candidate(
    surface: SimulatedSurface,
    rig: Rig,
    *,
    known_rig: Rig,
    mask: BoolArray,
    skin: SkinOptics | None,
    photons: PhotonSettings,
    seed: np.random.SeedSequence,
    rendered: bool = False,
) -> ExposedCapture:
    """Photograph `surface` under every LED of `rig`.

    Parameters
    ----------
    surface : on the pixels of `rig.camera`
    rig : intensities in W/sr
    known_rig : what the reconstruction is given
    mask : (H, W) what is to be reconstructed
    skin : its optics; None for an opaque Lambertian finger
    photons : lens, shutter, sensor
    seed : of the noise
    rendered : as a rendering program stores it: one fixed exposure (a radiance of 1 W/(m^2 sr) is white), pin-hole, no
        noise, 8 bits sRGB

    Returns
    -------
    Shot whose capture is exposed so that the brightest skin reaches the target, where shutter and gain allow it.

    Raises
    ------
    BadInput
        If no LED lights the finger.
    """
    bands, exposures = {}, {}
    names = [name for name in BAND_CHANNELS if any(led.band == name for led in rig.leds)]
    require(len(names) > 0, "the rig has no LED of the bands white and nir.")
    sharpness = np.zeros(surface.mask.shape, np.float32) if rendered else _defocus(surface, photons)
    scale = rig.camera.px_per_mm / _FULL_PX_PER_MM
    for name, band_seed in zip(names, seed.spawn(len(names)), strict=True):
        members = [k for k, led in enumerate(rig.leds) if led.band == name]
        frames, brightest = _frames(surface, [rig.leds[k] for k in members], name, skin)
        if rendered:
            exposure = _Exposure(0.0, 1.0, brightest * W_PER_UNIT)
            sensor = SensorSettings(noise=False, raw_bits=16, encoding="srgb")
        else:
            exposure = plan_exposure(electrons_per_s(brightest * W_PER_UNIT, LAMPS[name], photons), photons)
            sensor = SensorSettings(
                full_well_e=FULL_WELL_E / exposure.gain,
                read_noise_e=_READ_NOISE_E,
                raw_bits=16,  # binned pixels have more levels than ten bits hold
                bits=16,
            )
        gain = np.float32(exposure.level / brightest)
        blur_px = _tremor_blur_mm(exposure.time_s) * rig.camera.px_per_mm
        images = []
        for frame, one in zip(frames, band_seed.spawn(len(frames)), strict=True):
            light = _trembled(defocus(frame, sharpness), blur_px) * gain
            images.append(record(light, name, one, sensor, scale))
        bands[name] = Band(
            name=name,
            pixels=np.stack(images),  # type: ignore[arg-type]
            leds=tuple((k,) for k in members),
            exposure=np.ones(len(images)),
            black_level=np.zeros(len(images)),
        )
        exposures[name] = exposure
    material = "opaque" if skin is None else "skin"
    encoding = "srgb" if rendered else "linear"
    return ExposedCapture(
        Capture(rig=known_rig, bands=bands, encoding=encoding, material=material, mask=mask), exposures
    )


def _frames(
    surface: SimulatedSurface, leds: list[Led], name: str, skin: SkinOptics | None
) -> tuple[list[FloatArray], float]:
    """(H, W, 3) radiance of the whole frame under each LED, and that of the brightest skin without specular light."""
    if skin is None:
        window, matt = render_opaque(surface, leds, OPAQUE_ALBEDO)
        diffuse, glare = matt[:, None], np.zeros_like(matt)
    else:
        light = render_band(surface, leds, skin.medium(name), RenderSettings(workers=1))
        window, diffuse, glare = light.window, light.diffuse, light.glare
    frames = []
    for k, led in enumerate(leds):
        card = white_card(surface.camera, led, -CLOTH_DEPTH_MM) * np.float32(CLOTH_ALBEDO)
        frame = np.repeat(np.where(surface.mask, np.float32(0.0), card)[..., None], 3, axis=2)
        for c in range(3):
            frame[window][..., c] += diffuse[k, min(c, diffuse.shape[1] - 1)] + glare[k]
        frames.append(frame)
    lit = diffuse[diffuse > 0]
    require(lit.size > 0, "no LED lights the finger; turn the beams towards it.")
    brightest = max(float(np.percentile(part[part > 0], 99.9)) for part in np.moveaxis(diffuse, 1, 0) if part.any())
    return frames, brightest


def _defocus(surface: SimulatedSurface, photons: PhotonSettings) -> FloatArray:
    """(H, W) width of the defocus in pixels; beyond the outline that of the outline goes on."""
    camera = surface.camera
    depth, top = finger_depth(surface)
    focus = top - FOCUS_DEPTH_MM
    aperture = photons.focal_mm(camera.height_mm) / photons.f_number
    return blur_sigma_px(depth, focus, camera.height_mm, aperture, camera.px_per_mm)


def _trembled(frame: FloatArray, sigma_px: float) -> FloatArray:
    if sigma_px < 0.05:
        return frame
    return np.asarray(cv2.GaussianBlur(frame, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)
