"""A candidate rig photographs a finger: light, lens, shutter and noise, in physical units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.model import Band, BoolArray, Capture, FloatArray, Led, Rig
from splitknit.rig.photons import Exposure, PhotonSettings, electrons_per_s, plan_exposure, tremor_blur_mm
from splitknit.simulator.camera.lens import blur_sigma_px, defocus
from splitknit.simulator.camera.sensor import SensorSettings, record
from splitknit.simulator.light.lighting import render_opaque, white_card
from splitknit.simulator.light.renderer import RenderSettings, render_band
from splitknit.simulator.light.skin import BAND_CHANNELS, SkinSettings, WalkTable
from splitknit.simulator.scene import finger_depth
from splitknit.simulator.surface import Surface

W_PER_UNIT = 100.0
"""W/(m^2 sr) in one unit of the twin's radiance, where intensities are W/sr: its unit is that of 100 mm, (0.1 m)^-2."""
OPAQUE_ALBEDO = 0.5
CLOTH_ALBEDO, CLOTH_DEPTH_MM = 0.006, 10.0
"""Black cloth below the finger."""
FOCUS_DEPTH_MM = 1.5
"""The lens is focused this far below the finger's highest point."""


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A capture and how it was exposed."""

    capture: Capture
    exposures: Mapping[str, Exposure]


def photograph(
    surface: Surface,
    rig: Rig,
    *,
    known_rig: Rig,
    mask: BoolArray,
    skin: SkinSettings | None,
    walks: WalkTable,
    photons: PhotonSettings,
    seed: np.random.SeedSequence,
    rendered: bool = False,
) -> Shot:
    """Photograph `surface` under every LED of `rig`.

    Parameters
    ----------
    surface : on the pixels of `rig.camera`
    rig : intensities in W/sr
    known_rig : what the reconstruction is told
    mask : (H, W) what is to be reconstructed
    skin : its optics; None for an opaque Lambertian finger
    walks : for the skin
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
    scale = rig.camera.px_per_mm / photons.full_px_per_mm
    for name, band_seed in zip(names, seed.spawn(len(names)), strict=True):
        members = [k for k, led in enumerate(rig.leds) if led.band == name]
        frames, brightest = _frames(surface, [rig.leds[k] for k in members], name, skin, walks)
        if rendered:
            exposure = Exposure(0.0, 1.0, brightest * W_PER_UNIT)
            sensor = SensorSettings(noise=False, raw_bits=16, encoding="srgb")
        else:
            exposure = plan_exposure(electrons_per_s(brightest * W_PER_UNIT, photons.lamps[name], photons), photons)
            sensor = SensorSettings(
                full_well_e=photons.full_well_e / exposure.gain,
                read_noise_e=photons.read_noise_e,
                raw_bits=16,  # binned pixels have more levels than ten bits tell apart
                bits=16,
            )
        gain = np.float32(exposure.level / brightest)
        blur_px = tremor_blur_mm(exposure.time_s, photons) * rig.camera.px_per_mm
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
    return Shot(Capture(rig=known_rig, bands=bands, encoding=encoding, material=material, mask=mask), exposures)


def _frames(
    surface: Surface, leds: list[Led], name: str, skin: SkinSettings | None, walks: WalkTable
) -> tuple[list[FloatArray], float]:
    """(H, W, 3) radiance of the whole frame under each LED, and the radiance of the brightest skin without glare."""
    if skin is None:
        window, matt = render_opaque(surface, leds, OPAQUE_ALBEDO)
        diffuse, glare = matt[:, None], np.zeros_like(matt)
    else:
        optics = [skin.channel(channel) for channel in BAND_CHANNELS[name]]
        settings = RenderSettings(workers=1)
        light = render_band(
            surface, leds, optics, roughness=skin.roughness, glare=skin.glare, walks=walks, settings=settings
        )
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


def _defocus(surface: Surface, photons: PhotonSettings) -> FloatArray:
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
