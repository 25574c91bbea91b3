"""The shape network, which estimates the residual slopes of the shape in the `metric` method: its data and training.

Where a finger turns away, ridges that are not resolved and specular reflection at grazing angles bend the shape that
all bands agree on (:mod:`splitknit.skin.learned`); the network learns on simulated fingers which slopes are missing.

A finger is photographed by the simulator and reconstructed as any other, except for the relief network: in its place
stands the true relief, a little too low or too high as an estimated one is. A sample is the input of the shape network
in the last round, and the residual slopes of the shape against the truth there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit import (
    COARSE_PITCH_MM,
    RELIEF_MM,
    RIDGE_BAND_MM,
    SHAPE_SLOPE,
    SHAPE_SYMMETRY,
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
from splitknit_simulator.training.fields import FIELDS, FieldsSettings, FieldsTask, Run, Sample
from splitknit_simulator.training.networks import load_torch
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
from splitknit_simulator.training.trainer import HELD_OUT_FROM, NetworkKind, files_of
from splitknit_simulator.training.trainer import Sample as Stored

_MAX_MISSING = 3.0  # slopes that are missing beyond this are cut off
_SEEN_SLOPES = slice(20, 22)  # the shape's own slopes among the fields, over two


@dataclass(frozen=True, slots=True)
class ShapeData(SceneRanges):
    """How many fingers, and the ranges from which each is drawn.

    The network that ships learned from about 160 such fingers, some 60 of which had the usual rim exponent.
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
    grid, bands, binning = skin_images(capture, lit, finger.window, finger.inside)
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
    factor = max(1, round(COARSE_PITCH_MM / grid.pitch_mm))
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


# The network, its loss, and what it is judged by.


NETWORK = NetworkKind(
    "shape",
    "slopes that a finger's shape lacks: the fields of splitknit.skin.learned on the coarse grid to slopes "
    "along x and y in units of 0.1",
    (FIELDS, 2),
)
FILES = files_of(NETWORK.name, "fingers")
PARTS = ("slope", "wide")
SLOPES = slice(32, 34)  # the residual slopes along x and y (up), in the network's unit
WEIGHT = 34  # number of the weight in a sample, in [0, 1]
CHANNELS = 35
SYMMETRY = replace(SHAPE_SYMMETRY, vectors=(*SHAPE_SYMMETRY.vectors, (32, 33)))  # symmetry of a sample
OF_NIR = (6, 7, 11, 16, 17, 18, 19, 29, 30)  # fields that are zero without near-infrared images
JUDGED_WIDE_PX = 17  # side of the squares over which slopes are averaged: wide errors become the shape's
UNIT = float(SHAPE_SLOPE)  # unit of the network's slopes
_WIDE_PX = 8  # side of the blocks over which the loss also compares mean slopes: wide errors become the shape's
_MIN_TRUST = 0.05  # blocks with little weight count for less than that weight


@dataclass(frozen=True, slots=True)
class ShapeNetSettings(FieldsSettings):
    """Network, loss and training.

    The network that ships was trained in three runs of 957, 2623 and 2354 iterations, each from the weights of the one
    before, while its fingers became ready. The defaults are its numbers, the iterations rounded, in one run.
    """

    widths: Annotated[tuple[int, ...], Limits(1)] = (24, 32, 48, 64, 64)
    """Channels of each level; every level but the first works at half the scale of the one before."""
    iterations: Annotated[int, Limits(1, 10_000_000)] = 6000
    """Corrections of the weights."""
    batch: Annotated[int, Limits(1, 4096)] = 8
    """Patches of each."""
    patch_px: Annotated[int, Limits(1, 2048)] = 160
    """Side of a patch on the coarse grid; a multiple of the network's stride."""
    warm_up: Annotated[int, Limits(1, 10_000_000)] = 100
    """Iterations over which the learning rate rises; then it falls along a cosine."""
    weight_decay: Annotated[float, Limits(0)] = 1e-3
    """By which weights shrink, times the learning rate."""
    beyond_px: Annotated[int, Limits(0)] = 20
    """How far a patch may reach over a finger's edge, where the shape errs most."""
    no_nir_share: Annotated[float, Limits(0, 1, below=True)] = 0.15
    """Fraction of the patches without near-infrared fields; below 1."""
    wide_share: Annotated[float, Limits(0)] = 1.0
    """Weight of the mean slopes of blocks in the loss, beside the slopes with weight one."""

    def __post_init__(self) -> None:
        FieldsSettings.__post_init__(self)
        require(
            max(self.beyond_px + 1, _WIDE_PX) <= self.patch_px,
            f"training.patch_px must be larger than beyond_px ({self.beyond_px}) and {_WIDE_PX - 1}, "
            f"but it is {self.patch_px}.",
        )

    @property
    def loss_weights(self) -> dict[str, float]:
        """Weights of the loss's parts in their sum."""
        return {"slope": 1.0, "wide": self.wide_share}


def _shape_losses(made: Any, batch: Any, wide_px: int = _WIDE_PX) -> dict[str, Any]:
    """Losses of the slopes `made` (B, 2, h, w), means over the pixels that count: ``slope``, squared error; ``wide``,
    of its means over blocks of `wide_px`, as integration adds up what is wrong over many pixels.
    """
    pooled = load_torch().nn.functional.avg_pool2d
    weight = batch[:, WEIGHT : WEIGHT + 1]
    error = made - batch[:, SLOPES]
    count = weight.sum() + 1.0
    means = pooled(error * weight, wide_px) ** 2 / (pooled(weight, wide_px) + _MIN_TRUST)
    return {"slope": (error**2 * weight).sum() / count, "wide": means.sum() * wide_px**2 / count}


def _judge_whole(run: Run, sample: Sample, stride: int) -> dict[str, float]:
    """Figures of :func:`_judged`, without last rows and columns where the sides are not multiples of `stride`."""
    rows, columns = (length // stride * stride for length in sample.shape[1:])
    seen = np.asarray(sample[:, :rows, :columns], dtype=np.float32)
    return _judged(run(seen[:FIELDS]), seen)


def _judged(made: FloatArray, sample: FloatArray) -> dict[str, float]:
    """Figures of slopes (2, h, w) against a sample (35, h, w), network's unit; NaN without skin: weighted rms slope
    error without and with them, ``before`` and ``after``, and of means over squares of 17 pixels, ``wide_before`` and
    ``wide_after``.
    """
    weight = np.asarray(sample[WEIGHT], dtype=np.float64)
    wanted = np.asarray(sample[SLOPES], dtype=np.float64)
    found: dict[str, float] = {}
    for name, error in (("before", wanted), ("after", wanted - made)):
        found[name] = _rms(error, weight)
        fraction = np.maximum(_mean(weight), _MIN_TRUST)
        found[f"wide_{name}"] = _rms(np.stack([_mean(part * weight) / fraction for part in error]), weight)
    return found


def _rms(error: Any, weight: Any) -> float:
    total = float(weight.sum())
    return math.sqrt(float((error**2 * weight).sum()) / total / 2) if total > 0 else math.nan


def _mean(field: Any) -> Any:
    return cv2.blur(field, (JUDGED_WIDE_PX, JUDGED_WIDE_PX), borderType=cv2.BORDER_CONSTANT)


def _shoot(data: ShapeData, kind: str, number: int) -> list[Stored]:
    return [shape_sample(number, data)]


TASK = FieldsTask(
    kind=NETWORK,
    channels=CHANNELS,
    symmetry=SYMMETRY,
    losses=_shape_losses,
    judge=_judge_whole,
    in_units=lambda entry: {name: UNIT * value for name, value in entry.items()},
    held_out=": error of the shape's slopes (rms of one slope, steep parts count less) before and after mending, and "
    f"of their means over {JUDGED_WIDE_PX} x {JUDGED_WIDE_PX} pixels of the coarse grid",
    lines={
        "training": lambda entry: UNIT * math.sqrt(entry["slope"] / 2),  # of one slope
        "held out": lambda entry: UNIT * entry["held_out_after"],
        "held out, before": lambda entry: UNIT * entry["held_out_before"],
    },
    unit="error of a slope",
    min_weight=0.15,
    min_deviation=0.05,
    scale_patches=24,
    shoot=_shoot,
    of_nir=OF_NIR,
)
