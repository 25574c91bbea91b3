"""A finger made by hand: a half ellipsoid with a spiral of ridges, turned by a known yaw on the
input grid."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Band, Capture
from splitknit.findings import Finding
from splitknit.imaging.geometry import height_gradients, normals_from_gradients, rotation_about
from splitknit.model import Camera, Led, Rig
from splitknit.reconstruction import Comparison, Reconstruction


def finger(
    px_per_mm: float = 20.0,
    size: tuple[int, int] = (440, 640),
    yaw_deg: float = 12.0,
    preset: str = "metric",
) -> tuple[Reconstruction, dict[str, NDArray[Any]]]:
    """Return a reconstruction that equals its truth, and the truth."""
    height, width = size
    centre = ((width - 1) / 2, (height - 1) / 2)
    input_from_upright = rotation_about(centre, np.deg2rad(yaw_deg))
    upright_from_input = np.linalg.inv(input_from_upright)
    columns, rows = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    upright_column = (
        upright_from_input[0, 0] * columns
        + upright_from_input[0, 1] * rows
        + upright_from_input[0, 2]
    )
    upright_row = (
        upright_from_input[1, 0] * columns
        + upright_from_input[1, 1] * rows
        + upright_from_input[1, 2]
    )
    x = (upright_column - centre[0]) / px_per_mm
    y = (centre[1] - upright_row) / px_per_mm
    along = np.where(y > 1.0, (y - 1.0) / 8.5, 0.0)
    inside = 1.0 - (x / 7.5) ** 2 - along**2
    mask = (inside > 0.03) & (y > -8.5)
    shape = np.where(mask, 5.5 * np.sqrt(np.maximum(inside, 0.0)), np.nan)
    radius, turn = np.hypot(x - 0.6, y - 2.0), np.arctan2(y - 2.0, x - 0.6)
    ridge = np.where(mask, 0.03 * np.cos(2 * np.pi * radius / 0.45 + 2 * turn), np.nan)
    total = (shape + ridge).astype(np.float32)
    pitch = 1.0 / px_per_mm
    gradient_x, gradient_y = height_gradients(total, pitch)
    normals = np.where(mask[..., None], normals_from_gradients(gradient_x, gradient_y), 0.0).astype(
        np.float32
    )
    result = Reconstruction(
        height_mm=total,
        ridge_mm=ridge.astype(np.float32),
        shape_mm=shape.astype(np.float32),
        mask=mask,
        normals=normals,
        albedo=np.where(mask, 0.5 + 0.1 * np.cos(x), np.nan).astype(np.float32),
        pitch_mm=pitch,
        input_from_upright=input_from_upright,
        upright_size=size,
        preset=preset,
        uncertainty_um=np.where(mask, 2.0 + np.abs(x), np.nan).astype(np.float32),
        settings={"integrate": {"method": "poisson"}, "knit": {"mode": "crossover"}},
        quality={"focus": 0.8, "coverage": 0.97, "led_brightness": [1.0, 0.9, 1.1]},
        facts={"yaw_deg": yaw_deg, "crease_row": 400, "scattering_mm": 0.24},
        findings=(
            Finding(
                "no-crease", "No flexion crease is in view; the whole visible finger was kept."
            ),
        ),
        timings_s={"preprocess": 0.5, "normals": 1.25},
        hashes={"white_0.png": "ab" * 32},
    )
    truth = {
        "height_mm": total,
        "shape_mm": shape.astype(np.float32),
        "mask": mask,
        "normals": normals,
    }
    return result, truth


def comparison_of(result: Reconstruction, gain: float = 1.0) -> Comparison:
    """Return what a simulator says of a result whose relief has this gain."""
    figures = {"surface_rms_mm": 0.0, "ridge_correlation": 1.0, "ridge_gain": gain}
    error_um = np.where(result.mask, 1000.0 * (gain - 1.0) * result.ridge_mm, np.nan)
    no_error = np.where(result.mask, np.float32(0.0), np.nan)
    return Comparison(result.preset, figures, no_error, error_um, result.mask, result.mask)


def capture_of(result: Reconstruction, lights: int = 4) -> Capture:
    """Return grey images of the reconstruction under distant lights."""
    angles = 2 * np.pi * np.arange(lights) / lights
    directions = np.stack(
        [0.35 * np.cos(angles), 0.35 * np.sin(angles), np.full(lights, 0.937)], axis=1
    )
    camera = Camera(px_per_mm=1.0 / result.pitch_mm, image_size=result.mask.shape)
    leds = tuple(
        Led(band="white", direction=(float(d[0]), float(d[1]), float(d[2]))) for d in directions
    )
    shaded = np.stack([np.clip(0.7 * result.normals @ d, 0.0, 1.0) for d in directions])
    pixels = np.round(255 * shaded).astype(np.uint8)[..., None]
    band = Band(
        name="white",
        pixels=pixels,
        leds=tuple((k,) for k in range(lights)),
        exposure=np.ones(lights),
        black_level=np.zeros(lights),
        files=tuple(f"white_{k}.png" for k in range(lights)),
    )
    return Capture(rig=Rig(camera=camera, leds=leds), bands={"white": band})
