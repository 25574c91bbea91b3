"""Patches of palms and fingers under a projector, which of their pixels are judged, and how."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit.model import Camera, Led
from splitknit.nominal import default_rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.light.skin import Medium, SkinOptics, SkinRanges
from splitknit_simulator.surface import SimulatedSurface

sys.path.append(str(Path(__file__).resolve().parents[2] / "training"))

from palms import draw_palm, palm_surface
from projector import (
    Checkerboard,
    Separated,
    checkerboard_images,
    pattern_states,
    separate_truth,
)

PX_PER_MM = 37.85
PATCH_SIZE = (224, 240)
LEDS = default_rig().leds
FULL_WELL_E = 4700.0
"""Electrons at full scale, as in the twin's sensor; one colour channel of one pixel, exposed to 0.7
of it."""
READ_NOISE_E = 2.5
"""Standard deviation of the noise of reading out, electrons, as in the twin's sensor."""
RENDER: dict[str, Any] = {"settings": RenderSettings(reach_mm=3.0, workers=1)}
"""A shorter reach than the captures': of the light beyond 3 mm the checkerboard leaves nothing."""

Patch = tuple[SimulatedSurface, Led, SkinOptics | Medium]
"""What is looked at, where the projector stands, and the skin: the first arguments of the twin's
separation."""


def draw_patches() -> dict[str, Patch]:
    """Crops of palms and fingers with skins drawn from the population's ranges."""
    camera = Camera(PX_PER_MM, PATCH_SIZE)
    result = {}
    for k in range(2):
        skin = SkinRanges().draw(np.random.default_rng([17, k]))
        result[f"palm {k}"] = (palm_surface(draw_palm(500 + k), camera), LEDS[k], skin)
        # the pad fills most of the crop, its flank and outline the rest
        pose = FingerPose(
            x_mm=3.5 * (-1) ** k, insertion_mm=PATCH_SIZE[0] / PX_PER_MM + 6.0, roll_rad=0.1
        )
        finger = finger_surface(
            draw_finger(500 + k, ("whorl", "left_loop")[k]), pose, camera, workers=1
        )
        result[f"finger {k}"] = (finger, LEDS[k + 3], skin)
    return result


def truth_of(patch: Patch, check_mm: float, **options: Any) -> Separated:
    """Direct and global light at this check size."""
    return separate_truth(*patch, check_mm=check_mm, **RENDER, **options)


def photograph(patch: Patch, pattern: Any) -> np.ndarray:
    """Return the images (N, h, w, C) under all shifts of a pattern, without noise."""
    return np.stack(
        [np.moveaxis(image, 0, -1) for image in checkerboard_images(*patch, pattern, **RENDER)]
    )


def noisy_images(clean: np.ndarray, truth: Separated, mask: np.ndarray) -> np.ndarray:
    """The images with shot and read noise of the twin's sensor."""
    scale = FULL_WELL_E * 0.7 / np.percentile(truth.white[0][mask], 99.9)
    spread = np.sqrt(np.maximum(clean * scale, 0) + READ_NOISE_E**2)
    drawn = np.random.default_rng(5).standard_normal(clean.shape)
    return np.asarray((clean * scale + spread * drawn) / scale, dtype=np.float32)


def inner(surface: SimulatedSurface, truth: Separated) -> np.ndarray:
    """Pixels that are judged: on the skin, not on its outline, not grazing, lit."""
    mask = cv2.erode(surface.mask[truth.window].astype(np.uint8), np.ones((5, 5))) > 0
    slope = surface.shape_normals[truth.window][..., 2] > 0.5
    lit = truth.white[0] > 0.05 * np.percentile(truth.white[0][mask], 99)
    return np.asarray(mask & slope & lit)


def known_states(
    patch: Patch, truth: Separated, mask: np.ndarray, pattern: Checkerboard
) -> np.ndarray:
    """The pattern's states in the window; beside the judged pixels, where any will do, those of the
    finger plane."""
    x, y = np.meshgrid(np.arange(mask.shape[1]) / PX_PER_MM, np.arange(mask.shape[0]) / PX_PER_MM)
    states = pattern_states(patch[0], patch[1], pattern)[(slice(None), *truth.window)]
    beside = np.stack(
        [pattern.state(x, y, shift, 1.0 / PX_PER_MM) for shift in pattern.shifts_mm()]
    )
    return np.where(mask, states, beside)


def decibels(error: np.ndarray, truth: np.ndarray, white: np.ndarray) -> dict[str, float]:
    """PSNR of an error (..., pixels) under both conventions of what the peak is.

    ``white_peak``: the 99.9th percentile of the image under full light, as for photographs whose
    full scale is 1. ``own_peak``: the 99.9th percentile of the true part itself, which is darker:
    the stricter figure.
    """
    rms = np.sqrt(np.mean(np.square(error, dtype=np.float64)))
    peaks = {"white_peak": white, "own_peak": truth}
    return {
        name: float(20 * np.log10(np.percentile(peak, 99.9) / rms)) for name, peak in peaks.items()
    }
