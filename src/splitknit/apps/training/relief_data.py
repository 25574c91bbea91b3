"""Training data of the relief's network: simulated fingers through the front end of a reconstruction.

A finger is photographed by the twin, found and cut out as in any reconstruction, and its smooth shape taken from the
first turn. The network shall draw the relief on whatever smooth shape it is given, so that the shape is mixed, anew for
each finger, from that one and the true one. What it shall draw, relief and glare, is the twin's truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.apps.training.relief_scenes import ReliefData, draw_scene
from splitknit.apps.training.scene_ranges import photograph_scene
from splitknit.imaging import Window, bin_mean
from splitknit.model import BoolArray, Capture, FloatArray, Rig
from splitknit.pipeline import preset_settings
from splitknit.recipe.finger import find_finger
from splitknit.recipe.presets import PipelineSettings
from splitknit.recipe.skin import skin_images
from splitknit.recipe.stopwatch import Stopwatch
from splitknit.skin.grid import BandImages, Grid, coarsen
from splitknit.skin.learned import GLARE, RELIEF_MM, RIDGE_BAND_MM, azimuth_waves, features
from splitknit.skin.light import FineLight, fine_lighting, slant_of, trust_of
from splitknit.skin.surface import first_shape

MOST_RELIEF = np.float32(10.0)
"""Relief beyond this many units (0.2 mm) is none."""
MOST_GLARE = np.float32(3.0)
"""Glare above this many times the green level is cut off: it hides the skin whatever more there is of it."""
TRUTH_SHARE = 0.999
"""Blocks of pixels of which less lies on the finger have no truth."""


def training_sample(number: int, data: ReliefData) -> tuple[NDArray[np.float16], dict[str, Any]]:
    """Photograph the finger `number` and turn it into a sample (41, h, w); see ``separate.train_relief_batches``.

    Returns
    -------
    sample : (41, h, w) float16
    facts : what was drawn

    Raises
    ------
    BadInput
        If the reconstruction would refuse the capture.
    """
    scene = draw_scene(number, data)
    capture, truth = photograph_scene(scene)
    mix = float(np.random.default_rng(number).random())
    settings = preset_settings("metric")
    skin = {
        name: float(truth[f"skin_{name}"]) for name in ("scattering_factor", "melanin", "blood", "roughness", "glare")
    }
    return sample_of(capture, truth, settings, mix), {**scene.facts(), "skin": skin, "estimated_share": mix}


def sample_of(
    capture: Capture, truth: Mapping[str, NDArray[Any]], settings: PipelineSettings, mix: float
) -> NDArray[np.float16]:
    """Fields, relief, glare and weight (41, h, w) of one capture with its truth.

    Parameters
    ----------
    capture, truth : of the twin
    settings : of the reconstruction
    mix : share of the reconstruction's smooth shape in [0, 1]; the rest is the true shape
    """
    finger = find_finger(capture, settings, Stopwatch())
    grid, bands, binning = skin_images(capture, finger, settings)
    found = first_shape(bands, grid, settings.skin, settings.metric)
    on_grid = TruthOnGrid(truth, finger.window, grid, binning)
    true = on_grid.shape_mm()
    level = true[grid.mask].mean(dtype=np.float64)
    true = true - np.float32(level) + np.float32(settings.metric.plane_mm)
    surface = ((1 - np.float32(mix)) * true + np.float32(mix) * found).astype(np.float32)
    light = light_on(bands[0].rig, grid, surface, settings.metric.coarse_pitch_mm)
    return assembled(bands[0], grid, surface, light, on_grid)


def assembled(
    white: BandImages, grid: Grid, surface_mm: FloatArray, light: FineLight, truth: TruthOnGrid
) -> NDArray[np.float16]:
    """The sample (41, h, w) of one finger on one smooth surface."""
    seen = features(white, grid, surface_mm, light)
    known = grid.mask & truth.mask
    relief = np.where(known, truth.relief_mm(), np.float32(0.0))
    relief = (relief - grid.smooth(relief, known, RIDGE_BAND_MM)) * known
    size = np.sqrt((light.vectors * light.vectors).sum(axis=1))
    glare = truth.glare() / (seen.level[1] * size + np.float32(1e-9))
    to_waves = np.linalg.pinv(azimuth_waves(white.rig, 3), rcond=1e-3).astype(np.float32)
    waves = np.tensordot(to_waves, glare, 1) * known
    weight = trust_of(slant_of(surface_mm, grid.pitch_mm), grid) * known
    parts = (
        seen.fields,
        np.clip(relief / RELIEF_MM, -MOST_RELIEF, MOST_RELIEF)[None],
        np.clip(waves, -MOST_GLARE, MOST_GLARE) / GLARE,
        weight[None],
    )
    return np.concatenate(parts).astype(np.float16)


def light_on(rig: Rig, grid: Grid, surface_mm: FloatArray, coarse_pitch_mm: float) -> FineLight:
    """Lights on a smooth surface of the fine grid, by way of the coarse one as in a reconstruction."""
    factor = max(1, round(coarse_pitch_mm / grid.pitch_mm))
    low = coarsen(grid, factor)
    rows, columns = low.shape
    height = bin_mean(np.ascontiguousarray(surface_mm[: rows * factor, : columns * factor]), factor)
    height = np.asarray(cv2.GaussianBlur(height, (0, 0), 0.25 / low.pitch_mm), dtype=np.float32)
    return fine_lighting(rig, low, height, factor, grid)


class TruthOnGrid:
    """The twin's truth on the fine grid."""

    def __init__(self, truth: Mapping[str, NDArray[Any]], window: Window, grid: Grid, binning: int) -> None:
        """Take the window of the twin's arrays; `binning` pixels a side make one of the grid's."""
        self._truth, self._window, self._shape, self._binning = truth, window, grid.shape, binning
        self.mask: BoolArray = np.asarray(self._mean("mask") > TRUTH_SHARE)

    def relief_mm(self) -> FloatArray:
        """(h, w) height less shape; means something inside the mask."""
        return self._mean("height_mm") - self._mean("shape_mm")

    def shape_mm(self) -> FloatArray:
        """(h, w) shape, continued beyond the mask by the nearest values."""
        nearest = ndimage.distance_transform_edt(~self.mask, return_distances=False, return_indices=True)
        return np.asarray(self._mean("shape_mm")[tuple(nearest)], dtype=np.float32)

    def glare(self) -> FloatArray:
        """(L, h, w) in the white images' units."""
        return self._mean("glare_white")

    def _mean(self, name: str) -> FloatArray:
        rows, columns = (length * self._binning for length in self._shape)
        cut = self._truth[name][(..., *self._window)][..., :rows, :columns]
        return bin_mean(np.nan_to_num(np.ascontiguousarray(cut, dtype=np.float32)), self._binning)
