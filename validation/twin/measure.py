"""One comparison of the fast twin with the reference: ridges, glare, or the low frequencies of a whole finger."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from compare import Array, Relief, binned, contrast, contrast_error, gain_of_relief, modulation, spread
from patches import PITCH_MM, middle, ridged_patch
from reference import ReferenceSettings, reference_scene, render_glare, render_volume
from reference_scene import ReferenceScene

from splitknit.model import FloatArray, Led, default_rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.light.renderer import render_band
from splitknit_simulator.light.skin import Channel, ChannelOptics, Medium, SkinOptics
from splitknit_simulator.surface import SimulatedSurface

FIELD_MM = 10.0
CROP_PX = 128
"""Side of the crop on the map; the reference's pixels are twice as large."""


@dataclass(frozen=True, slots=True)
class Ridges:
    """A flat, ridged crop under the LEDs of one channel."""

    boundary: str
    channel: Channel
    depth_um: float = 75.0
    factor: float = 1.0
    """Multiplies the reduced scattering."""
    print_seed: int = 5
    samples: int = 256

    def name(self) -> str:
        return f"{self.boundary}-{self.channel}-{self.depth_um:g}um-x{self.factor:g}-print{self.print_seed}"


def lights(channel: str) -> tuple[tuple[Led, ...], Array]:
    """The seven LEDs of the channel's band, and where they stand around the finger, (7, 2) unit vectors."""
    leds = default_rig().leds[7:] if channel == "nir" else default_rig().leds[:7]
    around = np.array([led.position_mm for led in leds], dtype=np.float64)[:, :2]
    return leds, around / np.linalg.norm(around, axis=1, keepdims=True)


@lru_cache(maxsize=1)
def _scene(depth_um: float, seed: int, nir: bool, crop_px: int) -> tuple[SimulatedSurface, ReferenceScene]:
    surface = ridged_patch(depth_um, FIELD_MM, seed=seed)
    leds, _ = lights("nir" if nir else "red")
    return surface, reference_scene(surface, middle(surface, crop_px), leds, ReferenceSettings())


def _twin(surface: SimulatedSurface, leds: Sequence[Led], optics: ChannelOptics) -> FloatArray:
    """The twin's light without and with its relief term, (2, L, H, W)."""
    both = [replace(optics, relief_gain_per_um=0.0), optics]
    light = render_band(surface, leds, Medium(both, 0.25, 0.0))
    return np.moveaxis(light.diffuse, 1, 0)


def compare_ridges(case: Ridges, crop_px: int = CROP_PX, seed: int = 1) -> dict[str, Any]:
    """Relief gain, contrast, modulation with height and with slope, and the twin's, with standard errors."""
    surface, scene = _scene(case.depth_um, case.print_seed, case.channel == "nir", crop_px)
    leds, around = lights(case.channel)
    window = middle(surface, crop_px)
    optics = SkinOptics(scattering_factor=case.factor).channel(case.channel)
    settings = ReferenceSettings(boundary=case.boundary, samples=case.samples, seed=seed)
    image = render_volume(scene, optics, settings)
    batches = image.batches.astype(np.float64)
    relief = Relief.of(surface.relief_um, window, around, PITCH_MM)
    whole, twin_whole = _twin(surface, leds, optics)
    plain, twin = (binned(light[(slice(None), *window)]) for light in (whole, twin_whole))
    gain, gain_error = spread(lambda light: gain_of_relief(light, plain, relief), batches)
    follows, follows_error = spread(lambda light: modulation(light, relief), batches)
    of_twin, of_plain = modulation(twin, relief), modulation(plain, relief)
    expected = drift_mm(optics)
    drifts = np.linspace(-0.5, 2.5, 7)
    shaded = [modulation(_drifted(twin_whole, around, d * expected, window), relief)[1] for d in drifts]
    per_slope = float(np.polyfit(drifts, shaded, 1)[0])
    drift = float(np.interp(-follows[1], -np.array(shaded), drifts))
    scale = 1e3 / optics.attenuation_per_mm / 100.0
    return {
        **asdict(case),
        "relief_gain": float(gain) * scale,
        "relief_gain_error": float(gain_error) * scale,
        "k_percent_per_um": float(gain),
        "k_error": float(gain_error),
        "k_twin": 100.0 * optics.relief_gain_per_um,
        "contrast": float(contrast(batches)),
        "contrast_error": contrast_error(batches),
        "contrast_twin": float(contrast(twin[None])),
        "with_height": float(follows[0]),
        "with_height_error": float(follows_error[0]),
        "with_height_twin": float(of_twin[0]),
        "with_height_convolution": float(of_plain[0]),
        "with_slope": float(follows[1]),
        "with_slope_error": float(follows_error[1]),
        "with_slope_twin": float(of_twin[1]),
        "drift": drift,
        "drift_error": float(follows_error[1] / abs(per_slope)),
        "level_twin_over_reference": float(plain.mean() / batches.mean()),
        "level_error": float(batches.mean(axis=(1, 2, 3)).std(ddof=1) / np.sqrt(len(batches)) / batches.mean()),
    }


def drift_mm(optics: ChannelOptics) -> float:
    """How far refracted light of the LEDs (20.6 deg) drifts sideways before it has forgotten its direction.

    References
    ----------
    Wang and Jacques 1995, Use of a laser beam with an oblique angle of incidence, Appl. Opt. 34, equation (5).
    """
    sine = 52.5 / np.hypot(52.5, 140.0) / 1.42
    return float(sine / (optics.scattering_per_mm + 0.35 * optics.absorption_per_mm))


def _drifted(images: FloatArray, around: Array, shift_mm: float, window: tuple[slice, slice]) -> Array:
    """The twin's crop when the light of each LED comes out `shift_mm` further from that LED."""
    result = []
    rows, columns = (slice(part.start - 32, part.stop + 32) for part in window)
    for image, (x, y) in zip(images[:, rows, columns], around, strict=True):
        # the image at a point is what was `shift_mm` nearer to the light; rows run against y
        move = np.array([[1.0, 0.0, x * shift_mm / PITCH_MM], [0.0, 1.0, -y * shift_mm / PITCH_MM]])
        size = image.shape[::-1]
        moved = cv2.warpAffine(image, move, size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
        result.append(binned(moved[32:-32, 32:-32]))
    return np.array(result)


def compare_glare(depth_um: float, roughness: float, samples: int = 64, crop_px: int = CROP_PX) -> dict[str, Any]:
    """Level, contrast and likeness of the surface reflection, and what inter-reflection adds."""
    surface, scene = _scene(depth_um, 5, False, crop_px)
    leds, _ = lights("red")
    window = middle(surface, crop_px)
    image = render_glare(scene, roughness, ReferenceSettings(seed=1), samples)
    batches = image.batches.astype(np.float64)
    light = render_band(surface, leds, Medium([SkinOptics().channel("red")], roughness, 1.0))
    twin = binned(light.glare[(slice(None), *window)])
    reference = batches.mean(axis=0)
    level, level_error = spread(lambda one: np.asarray(twin.mean() / one.mean()), batches)
    return {
        "depth_um": depth_um,
        "roughness": roughness,
        "level_twin_over_reference": float(level),
        "level_error": float(level_error),
        "contrast": float(contrast(batches)),
        "contrast_error": contrast_error(batches),
        "contrast_twin": float(contrast(twin[None])),
        "correlation": float(np.corrcoef(twin.ravel(), reference.ravel())[0, 1]),
        "reflected_twice_or_more": image.left,
    }


def compare_finger(channels: Sequence[tuple[Channel, int]], boundary: str, scale: float = 0.25) -> list[dict[str, Any]]:
    """Relative rms difference of the low frequencies on the pad of a whole, closed finger, one scale a channel."""
    rig = default_rig(scale)
    finger = draw_finger(3, "whorl")
    surface = finger_surface(finger, FingerPose(), rig.camera)
    surface = replace(surface, pigment=np.ones_like(surface.pigment))
    factor = 4
    rows, columns = np.nonzero(surface.mask)
    # the largest rectangle of 60 x 60 cells about the middle of the pad
    centre_row, centre_column = int(np.percentile(rows, 45)), int(np.median(columns))
    window = (
        slice(centre_row - 30 * factor, centre_row + 30 * factor),
        slice(centre_column - 30 * factor, centre_column + 30 * factor),
    )
    settings = ReferenceSettings(boundary=boundary, binning=factor, seed=2)
    scene = reference_scene(surface, window, rig.leds[:7], settings)
    slant = np.rad2deg(np.arccos(binned(surface.shape_normals[window][..., 2], factor)))
    result = []
    for channel, samples in channels:
        optics = SkinOptics().channel(channel)
        image = render_volume(scene, optics, replace(settings, samples=samples))
        band = render_band(surface, rig.leds[:7], Medium([optics], 0.25, 0.0))
        full = np.zeros((7, *surface.mask.shape), dtype=np.float32)
        full[(slice(None), *band.window)] = band.diffuse[:, 0]
        twin = binned(full[(slice(None), *window)], factor)
        parts = image.batches.astype(np.float64)
        row: dict[str, Any] = {"channel": channel, "boundary": boundary, "samples": samples}
        for name, chosen in (("below_20_deg", slant < 20), ("20_to_40_deg", (slant >= 20) & (slant < 40))):
            row[name] = _low_difference(twin, parts, chosen)
        row["greatest_slant_deg"] = float(slant.max())
        result.append(row)
    return result


def _low_difference(twin: Array, parts: Array, chosen: Array) -> dict[str, float]:
    """Rms of twin / reference, one scale for all lights, after a mean over 0.6 mm; the reference's noise taken out."""
    weight = cv2.GaussianBlur(chosen.astype(np.float64), (0, 0), 3.0)

    def smooth(images: Array) -> Array:
        blurred = [cv2.GaussianBlur(one * chosen, (0, 0), 3.0) / np.maximum(weight, 1e-6) for one in images]
        return np.array(blurred)[:, chosen]

    model = smooth(twin)
    low = np.array([smooth(part) for part in parts])
    mean = low.mean(axis=0)
    difference = model / model.mean() - mean / mean.mean()
    relative = difference / (mean / mean.mean())
    noise = low.var(axis=0, ddof=1) / len(parts) / mean**2
    fraction = float((relative**2).mean() - noise.mean())
    return {
        "rms": float(np.sign(fraction) * np.sqrt(abs(fraction))),
        "noise": float(np.sqrt(noise.mean())),
        "level_twin_over_reference": float(model.mean() / mean.mean()),
        "cells": int(chosen.sum()),
    }
