"""The recipe: shape and relief of a finger of skin, in turns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from splitknit.check import require
from splitknit.geometry import height_gradients, normals_from_gradients
from splitknit.metric import relief as fine
from splitknit.metric.coarse import BandImages, CoarsePrior, compare, integrate, lighting, start_shape, unit
from splitknit.metric.facets import Facets, measure_facets, ridged_normals
from splitknit.metric.grid import Grid, coarsen, refine
from splitknit.metric.relief import FineLight
from splitknit.radiance import bin_mean
from splitknit.separate import Diffusion, LocalWienerSettings, SkinSettings, diffusion
from splitknit.types import FloatArray


@dataclass(frozen=True, slots=True)
class MetricSettings:
    """Grids and iterations of the `metric` preset on skin."""

    working_pitch_mm: float = 0.0264
    """Pitch of the fine grid: skin passes less than 2 % of anything that a finer one could show."""
    coarse_pitch_mm: float = 0.106
    """Pitch of the coarse grid."""
    plane_mm: float = 1.0
    """Assumed mean height of the visible skin above the finger plane (it moves the lights only)."""
    rounds: int = 3
    """Turns of shape and relief."""
    coarse_steps: tuple[int, ...] = (6, 3, 2)
    """Corrections of the shape in each round; the last entry holds for all further rounds."""
    relief_steps: int = 2
    """Corrections of the relief in each round."""
    coarse: CoarsePrior = field(default_factory=CoarsePrior)
    """What is expected of shape and glare on the coarse grid."""
    model_error: float = 0.5
    """Error of the relief that is not noise (glare taken for relief, flanks too steep to be resolved), as a part of the
    relief's local rms height; measured on simulated fingers, see docs/accuracy.md."""
    seed: int = 0
    """Seed of the noise that is sent through the filters to learn its spectrum."""
    denoise: LocalWienerSettings = field(default_factory=LocalWienerSettings)
    """Removal of the noise from the relief."""

    def __post_init__(self) -> None:
        require(
            0 < self.working_pitch_mm <= self.coarse_pitch_mm,
            "metric.working_pitch_mm must be positive and at most metric.coarse_pitch_mm.",
        )
        require(self.model_error >= 0, "metric.model_error must not be negative.")
        require(self.rounds >= 1 and self.relief_steps >= 1, "metric.rounds and metric.relief_steps must be positive.")
        require(
            len(self.coarse_steps) > 0 and min(self.coarse_steps) >= 1,
            "metric.coarse_steps must hold positive numbers.",
        )


@dataclass(frozen=True, slots=True, eq=False)
class SkinSurface:
    """Reconstructed skin on the fine grid; heights are finite everywhere and mean something inside the mask."""

    shape_mm: FloatArray
    relief_mm: FloatArray
    deviation_mm: FloatArray
    """Standard deviation of the relief: noise, what denoising took, unknown scattering, and model error."""
    albedo: FloatArray
    """Diffuse brightness of the first channel, relative."""
    facts: Mapping[str, Any]


def reconstruct_skin(
    bands: tuple[BandImages, ...],
    grid: Grid,
    skin: SkinSettings,
    settings: MetricSettings,
    progress: Callable[[float], None] | None = None,
) -> SkinSurface:
    """Shape and relief from images of skin.

    Parameters
    ----------
    bands : the white band first (red, green, blue, or one channel called ``green``), then near-infrared if there is one
    grid : fine grid of the images
    skin : assumed optics
    settings : MetricSettings
    progress : called with the share done
    """
    white = bands[0]
    factor = max(1, round(settings.coarse_pitch_mm / grid.pitch_mm))
    low = coarsen(grid, factor)
    rows, columns = low.shape
    cropped = np.s_[..., : rows * factor, : columns * factor]
    small = tuple(BandImages(b.channels, bin_mean(b.stack[cropped], factor) * low.mask, b.rig) for b in bands)
    optics = _optics(skin, bands)
    start = start_shape(small[-1], low, settings.plane_mm)
    first = low.smooth(start, low.mask, 0.5) * low.mask
    shape = first
    relief = np.zeros(grid.shape, dtype=np.float32)
    facets: Facets | None = None
    total = settings.rounds
    for turn in range(total):
        for _ in range(settings.coarse_steps[min(turn, len(settings.coarse_steps) - 1)]):
            surface = _placed(shape, low, factor, grid, settings.plane_mm) + relief
            ridged = np.moveaxis(fine.mean_normals(surface, grid), -1, 0)[cropped]
            normals = np.ascontiguousarray(np.moveaxis(bin_mean(np.ascontiguousarray(ridged), factor), 0, -1))
            normals = ridged_normals(normals, shape, low, facets)
            height = (shape - _mean(shape, low) + np.float32(settings.plane_mm)) * low.mask
            added = height_gradients(np.where(low.mask, shape - first, np.float32(np.nan)), low.pitch_mm)
            step = compare(small, low, height, normals, optics, added, settings.coarse, facets)
            shape = shape + integrate(step.slope_x - added[0], step.slope_y - added[1], low, unit(normals)[..., 2])
        smooth = _placed(shape, low, factor, grid, settings.plane_mm)
        colour = {name: step.brightness[name] / step.brightness[white.channels[0]] for name in white.channels}
        optics = _optics(skin, bands, 1.0, colour if len(colour) > 1 else None)
        light = _fine_lighting(white, low, shape, settings.plane_mm, factor, grid)
        measured = fine.measure(white, grid, smooth, light, optics, step.brightness)
        for _ in range(settings.relief_steps):
            lacking = fine.lacking_slopes(measured, grid, smooth + relief)
            mix = fine.unmixing(measured, grid, _with_relief(lacking.slopes, measured, grid, relief), lacking.glare)
            raw = fine.update(measured, grid, lacking.slopes, mix, relief)
            relief, noise = fine.denoise(raw, grid, mix, settings.denoise, settings.seed)
        facets = measure_facets(relief, smooth, grid, low, factor, mix.fit, measured.region)
        if progress is not None:
            progress((turn + 1) / (total + 1))
    other = _optics(skin, bands, 1 + skin.scattering_uncertainty, colour if len(colour) > 1 else None)
    sensitivity = abs(fine.scattering_sensitivity(measured, grid, mix, other, relief))
    height = np.sqrt(np.maximum(grid.smooth(relief * relief, grid.mask, 0.6), np.float32(0.0)))
    model = np.float32(np.hypot(sensitivity, settings.model_error)) * height
    deviation = np.sqrt(noise**2 + model**2)
    facts = {
        "scattering_per_mm": {name: optics[name].scattering_per_mm for name in sorted(optics)},
        "absorption_per_mm": {name: optics[name].absorption_per_mm for name in sorted(optics)},
        "scattering_assumed": True,
        "gain_sensitivity": sensitivity,
        "colour": colour,
        "glare": {name: {"roughness": r, "strength": s} for name, (r, s) in step.glare.items()},
        "working_pitch_mm": grid.pitch_mm,
    }
    detail = fine.detail_of(smooth, measured, grid)
    albedo = np.sqrt((measured.pseudo_normals[0] ** 2).sum(axis=-1))
    return SkinSurface(smooth - detail, relief + detail, deviation.astype(np.float32), albedo.astype(np.float32), facts)


def _optics(
    skin: SkinSettings, bands: tuple[BandImages, ...], factor: float = 1.0, colour: Mapping[str, float] | None = None
) -> dict[str, Diffusion]:
    names = [name for band in bands for name in band.channels]
    return {
        name: diffusion(skin.scattering(name) * factor, skin.absorption(name, (colour or {}).get(name)))
        for name in names
    }


def _mean(field: FloatArray, grid: Grid) -> np.float32:
    return np.float32(field[grid.mask].mean(dtype=np.float64))


def _placed(shape: FloatArray, low: Grid, factor: int, grid: Grid, plane_mm: float) -> FloatArray:
    """The shape on the fine grid at its assumed height above the finger plane."""
    return refine(shape - _mean(shape, low) + np.float32(plane_mm), low.mask, factor, grid.shape)


def _fine_lighting(  # noqa: PLR0917
    band: BandImages, low: Grid, shape: FloatArray, plane_mm: float, factor: int, grid: Grid
) -> FineLight:
    """Fresnel transmission and trust of the lights on the smooth shape, enlarged from the coarse grid."""
    height = refine(shape - _mean(shape, low) + np.float32(plane_mm), low.mask, 1, low.shape)
    height = np.asarray(cv2.GaussianBlur(height, (0, 0), 0.25 / low.pitch_mm), dtype=np.float32)
    normals = normals_from_gradients(*height_gradients(height, low.pitch_mm))
    light = lighting(band.rig, low, height, normals)
    trust = np.where(low.mask, light.trust, np.float32(0.0))

    def enlarge(fields: FloatArray) -> FloatArray:
        size = (low.shape[1] * factor, low.shape[0] * factor)
        large = [cv2.resize(f, size, interpolation=cv2.INTER_LINEAR) for f in fields]
        missing = ((0, 0), (0, grid.shape[0] - size[1]), (0, grid.shape[1] - size[0]))
        return np.asarray(np.pad(np.stack(large), missing, mode="edge"), dtype=np.float32)

    return FineLight(enlarge(light.entering), np.maximum(enlarge(trust), np.float32(1e-3)) * grid.mask)


def _with_relief(
    slopes: list[tuple[FloatArray, FloatArray]], measured: fine.Measured, grid: Grid, relief: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """The slopes that the channels would lack without the current relief."""
    if not relief.any():
        return slopes
    spectrum = grid.forward(relief)
    wx, wy, _ = grid.omega
    return [
        (x + grid.inverse(spectrum * (1j * wx) * t), y + grid.inverse(spectrum * (1j * wy) * t))
        for (x, y), t in zip(slopes, measured.transfer, strict=True)
    ]
