"""Training data of the shape network: simulated fingers through a whole reconstruction.

A finger is photographed by the simulator and reconstructed as any other, except for the relief network: in its place
stands the true relief, a little too low or too high as an estimated one is. A sample is the input of the shape network
in the last round, and the residual slopes of the shape against the truth there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit import (
    RELIEF_MM,
    RIDGE_BAND_MM,
    SHAPE_SLOPE,
    BoolArray,
    Capture,
    FloatArray,
    Grid,
    Limits,
    Networks,
    bin_mean,
    can_learn,
    coarsen,
    find_finger,
    height_gradients,
    metric_skin,
    preset_settings,
    require,
    skin_images,
)
from splitknit_simulator.training.fields import FIELDS
from splitknit_simulator.training.scenes import (
    TRUTH_FRACTION,
    Range,
    SceneRanges,
    TrainingScene,
    TruthOnGrid,
    draw_scene,
    photograph_scene,
    with_sensor,
)
from splitknit_simulator.training.trainer import HELD_OUT_FROM

_MAX_MISSING = 3.0  # slopes that are missing beyond this are cut off
_SEEN_SLOPES = slice(20, 22)  # the shape's own slopes among the fields, over two


@dataclass(frozen=True, slots=True)
class ShapeData(SceneRanges):
    """How many fingers, and the ranges from which each is drawn.

    The network that ships learned from about 160 such fingers. Some 60 of them had the usual rim exponent; here it
    varies from finger to finger.
    """

    fingers: Annotated[int, Limits(1, 100_000)] = 160
    """To train on; about 4 MB each on disk."""
    held_out: Annotated[int, Limits(1, 1000)] = 8
    """Further ones, for the learning curve and the card."""
    first: Annotated[int, Limits(0, 900_000)] = 5000
    """Number of the first finger; everything about a finger follows from its number."""
    scale: Annotated[Range, Limits(0, 1, above=True)] = (0.34, 0.43)
    """Size of the images relative to the full frame of 2200 x 3200 pixels."""
    rim_exponent: Annotated[Range, Limits(0, 1)] = (0.0, 1.0)
    """Exponent of the light at the finger's outline (`RenderSettings`): the simulator's least certain physics."""
    gain: Annotated[float, Limits(0, 2, above=True)] = 0.93
    """Mean height of the relief that the reconstruction is given, over the true one."""
    gain_spread: Annotated[float, Limits(0, 0.3)] = 0.12
    """Its standard deviation from finger to finger."""

    @property
    def numbers(self) -> tuple[range, range, range]:
        """Numbers of the fingers that pieces come from (none), of whole ones to train on, and of those held out."""
        held_out = range(HELD_OUT_FROM, HELD_OUT_FROM + self.held_out)
        return range(0), range(self.first, self.first + self.fingers), held_out


def _draw_shape_scene(number: int, data: ShapeData) -> tuple[TrainingScene, float]:
    rng = np.random.default_rng([number, 77])
    scale, rim = (float(rng.uniform(*limits)) for limits in (data.scale, data.rim_exponent))
    scene = draw_scene(number, rng, data, scale, rim)
    gain = max(float(rng.normal(data.gain, data.gain_spread)), 0.1)
    return with_sensor(scene, rng, data), gain


def shape_sample(number: int, data: ShapeData) -> tuple[NDArray[np.float16], dict[str, Any]]:
    """Photograph the finger `number`: a sample (35, h, w) float16 (:mod:`splitknit_simulator.training.fields`), and the
    facts drawn. Raises BadInput if the reconstruction would refuse the capture.
    """
    scene, gain = _draw_shape_scene(number, data)
    capture, truth = photograph_scene(scene)
    return _shape_sample_of(capture, truth, gain), {**scene.facts(truth), "relief_gain": gain}


def _shape_sample_of(capture: Capture, truth: Mapping[str, NDArray[Any]], gain: float) -> NDArray[np.float16]:
    """Fields, missing slopes and weight (35, h, w) of a capture; `gain`: of the relief that is given."""
    settings = preset_settings("metric")
    finger = find_finger(capture, settings)
    lit = tuple(capture.bands[name] for name in ("white", "nir") if name in capture.bands)
    grid, bands, binning = skin_images(capture, lit, finger.window, finger.inside, settings.metric.working_pitch_mm)
    require(can_learn(bands[0], grid.pitch_mm), "the lights or pixels are not such that a network draws the relief.")
    on_grid = TruthOnGrid(truth, finger.window, grid, binning)
    relief, wide = _split_relief(on_grid, grid)
    drawn = np.zeros((9, *relief.shape), dtype=np.float32)
    drawn[0] = relief * np.float32(gain) / RELIEF_MM
    kept: list[FloatArray] = []

    def no_slopes(fields: FloatArray) -> FloatArray:
        kept.append(fields.copy())  # their memory is used for other orientations
        return np.zeros((2, *fields.shape[1:]), dtype=np.float32)

    def true_relief(fields: FloatArray) -> FloatArray:
        """True relief for the first estimate; other orientations follow later, when all is known."""
        return drawn if fields.shape[1:] == drawn.shape[1:] else np.zeros((9, *fields.shape[1:]), dtype=np.float32)

    networks = Networks(true_relief, no_slopes)
    metric_skin(bands, grid, settings.skin, settings.metric, networks)
    factor = max(1, round(settings.metric.coarse_pitch_mm / grid.pitch_mm))
    return _assembled_shape(kept[0], on_grid.shape_mm() + wide, on_grid.mask, coarsen(grid, factor), factor)


def _split_relief(truth: TruthOnGrid, grid: Grid) -> tuple[FloatArray, FloatArray]:
    """The true relief (h, w) and the wide part of it that counts as shape, mm; zero where one is not known."""
    known = grid.mask & truth.mask
    relief = np.where(known, truth.relief_mm(), np.float32(0.0)).astype(np.float32)
    wide = grid.smooth(relief, known, RIDGE_BAND_MM)
    return ((relief - wide) * known).astype(np.float32), wide


def _assembled_shape(
    fields: FloatArray, true_mm: FloatArray, known: BoolArray, low: Grid, factor: int
) -> NDArray[np.float16]:
    """Sample (35, h, w) of a finger; `known`: where the shape is, fine grid; `factor`: fine pixels a coarse one."""
    rows, columns = low.shape

    def coarse(field: Any) -> FloatArray:
        return bin_mean(np.ascontiguousarray(field[: rows * factor, : columns * factor], dtype=np.float32), factor)

    there = low.mask & (coarse(known) > TRUTH_FRACTION)
    slopes = np.stack(height_gradients(np.where(there, coarse(true_mm), np.float32(np.nan)), low.pitch_mm))
    # slopes are whole where the neighbours up, down, left and right are in the mask or beyond the image
    inner = there & ndimage.binary_erosion(low.mask, border_value=1) & ndimage.binary_erosion(there, border_value=1)
    missing = np.clip(slopes - 2 * fields[_SEEN_SLOPES], -_MAX_MISSING, _MAX_MISSING) * inner / SHAPE_SLOPE
    weight = inner / (1 + (slopes**2).sum(axis=0))
    return np.concatenate([fields[:FIELDS], missing, weight[None]]).astype(np.float16)
