"""Train `shape`, which estimates the residual slopes of the shape in the `metric` method.

    python training/shape.py --out DIR [--prints FOLDER]        # an hour or two on two cores

Where a finger turns away, ridges that are not resolved and specular reflection at grazing angles
bend the shape that all bands agree on; the network learns on simulated fingers which slopes are
missing. A finger is photographed and reconstructed as any other, but in place of the relief network
stands the true relief, a little too low or too high.

The shipped weights are the mean of two networks: after 3,000 iterations on 125 fingers whose light
was blurred across the picture, and after 5,400 more along the skin; the command repeats the recipe
of one run, not the bytes.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
from scipy import ndimage

from scenes import (
    HELD_OUT_FROM,
    TRUTH_FRACTION,
    TruthOnGrid,
    draw_scene,
    draw_sensor,
    photograph_scene,
)
from splitknit.errors import require
from splitknit.finger.locate import find_finger
from splitknit.imaging.geometry import height_gradients
from splitknit.imaging.pixels import bin_mean
from splitknit.methods.metric import metric_skin
from splitknit.observation.observe import observe
from splitknit.presets import preset_settings
from splitknit.skin.grid import coarsen
from splitknit.skin.images import skin_images
from splitknit.skin.learned import (
    RELIEF_MM,
    RIDGE_BAND_MM,
    SHAPE_SLOPE,
    SHAPE_SYMMETRY,
    Networks,
    can_learn,
)
from splitknit.skin.shape import COARSE_PITCH_MM

FINGERS = 160
FIRST_FINGER = 5000
HELD_OUT_FINGERS = 8
ITERATIONS = 6000
SCALE = (0.34, 0.43)  # size of the images
# of the light at the finger's outline: the simulator's least certain physics
RIM_EXPONENT = (0.0, 1.0)
# height of the relief that the reconstruction is given, over the true one
RELIEF_GAIN = 0.93
RELIEF_GAIN_SD = 0.12
SLOPE_CHANNELS = slice(32, 34)  # residual slopes along x and y of a sample, in the network's unit
WEIGHT_CHANNEL = 34
MAX_MISSING = 3.0  # slopes that are missing beyond this are cut off
SEEN_SLOPES = slice(20, 22)  # the shape's own slopes among the fields, over two
# side of the blocks over which the loss also compares mean slopes: wide errors become the shape's
WIDE_PX = 8
JUDGED_WIDE_PX = 17
MIN_TRUST = 0.05  # blocks with little weight count for less than that weight
UNIT = float(SHAPE_SLOPE)


def shape_sample(number, prints=None):
    """Fields, missing slopes and weight (35, h, w) float16 of the finger `number`; BadInput if it
    is refused."""
    rng = np.random.default_rng([number, 77])
    scale, rim = (float(rng.uniform(*limits)) for limits in (SCALE, RIM_EXPONENT))
    finger, rig, twin = draw_scene(number, rng, scale, prints, rim)
    gain = max(float(rng.normal(RELIEF_GAIN, RELIEF_GAIN_SD)), 0.1)
    capture, truth = photograph_scene(number, finger, rig, replace(twin, sensor=draw_sensor(rng)))
    settings = preset_settings("metric")
    observation = observe(capture)
    located = find_finger(observation, settings)
    lit = tuple(light for name, light in observation.bands.items() if name in {"white", "nir"})
    grid, bands, binning = skin_images(lit, located.window, located.inside)
    require(
        can_learn(bands[0], grid.pitch_mm),
        "the lights or pixels are not such that a network draws the relief.",
    )
    on_grid = TruthOnGrid(truth, located.window, grid, binning)
    known = grid.mask & on_grid.mask
    relief = np.where(known, on_grid.relief_mm(), np.float32(0.0)).astype(np.float32)
    wide = grid.smooth(relief, known, RIDGE_BAND_MM)  # counts as shape
    relief = ((relief - wide) * known).astype(np.float32)
    drawn = np.zeros((9, *relief.shape), dtype=np.float32)
    drawn[0] = relief * np.float32(gain) / RELIEF_MM
    kept = []

    def no_slopes(fields):
        kept.append(fields.copy())  # their memory is used for other orientations
        return np.zeros((2, *fields.shape[1:]), dtype=np.float32)

    def true_relief(fields):
        """True relief for the first estimate; other orientations follow later, when all is
        known."""
        return (
            drawn
            if fields.shape[1:] == drawn.shape[1:]
            else np.zeros((9, *fields.shape[1:]), dtype=np.float32)
        )

    metric_skin(bands, grid, settings.skin, settings.metric, Networks(true_relief, no_slopes))
    factor = max(1, round(COARSE_PITCH_MM / grid.pitch_mm))
    return _assembled(
        kept[0], on_grid.shape_mm() + wide, on_grid.mask, coarsen(grid, factor), factor
    )


def _assembled(fields, true_mm, known, low, factor):
    """`known`: where the shape is, on the fine grid; `factor`: fine pixels a coarse one."""
    rows, columns = low.shape

    def coarse(field):
        return bin_mean(
            np.ascontiguousarray(field[: rows * factor, : columns * factor], dtype=np.float32),
            factor,
        )

    there = low.mask & (coarse(known) > TRUTH_FRACTION)
    slopes = np.stack(
        height_gradients(np.where(there, coarse(true_mm), np.float32(np.nan)), low.pitch_mm)
    )
    # slopes are whole where the neighbours up, down, left and right are in the mask or beyond the
    # image
    inner = (
        there
        & ndimage.binary_erosion(low.mask, border_value=1)
        & ndimage.binary_erosion(there, border_value=1)
    )
    missing = (
        np.clip(slopes - 2 * fields[SEEN_SLOPES], -MAX_MISSING, MAX_MISSING) * inner / SHAPE_SLOPE
    )
    weight = inner / (1 + (slopes**2).sum(axis=0))
    return np.concatenate([fields[:32], missing, weight[None]]).astype(np.float16)


def shape_loss(output, batch):
    """Squared error of slopes (B, 2, h, w), and of its means over blocks, as integration adds up
    what is wrong."""
    from torch.nn.functional import avg_pool2d

    weight = batch[:, WEIGHT_CHANNEL : WEIGHT_CHANNEL + 1]
    error = output - batch[:, SLOPE_CHANNELS]
    count = weight.sum() + 1.0
    means = avg_pool2d(error * weight, WIDE_PX) ** 2 / (avg_pool2d(weight, WIDE_PX) + MIN_TRUST)
    return (error**2 * weight).sum() / count + means.sum() * WIDE_PX**2 / count


def judge(run, sample, stride):
    """Weighted rms error of a slope before and after, and of means over squares of 17 pixels."""
    rows, columns = (length // stride * stride for length in sample.shape[1:])
    sample = np.asarray(sample[:, :rows, :columns], dtype=np.float32)
    weight, wanted = (
        np.asarray(sample[part], dtype=np.float64) for part in (WEIGHT_CHANNEL, SLOPE_CHANNELS)
    )
    figures = {}
    for name, error in (("before", wanted), ("after", wanted - run(sample[:32]))):
        wide = np.stack(
            [_mean(part * weight) / np.maximum(_mean(weight), MIN_TRUST) for part in error]
        )
        figures |= {name: _rms(error, weight), f"wide_{name}": _rms(wide, weight)}
    return figures


def _rms(error, weight):
    total = float(weight.sum())
    return UNIT * math.sqrt(float((error**2 * weight).sum()) / total / 2) if total > 0 else math.nan


def _mean(field):
    return cv2.blur(field, (JUDGED_WIDE_PX, JUDGED_WIDE_PX), borderType=cv2.BORDER_CONSTANT)


TASK = SimpleNamespace(
    name="shape",
    what=(
        "slopes that a finger's shape lacks: the fields of splitknit.skin.learned on the coarse"
        " grid to slopes along x and y in units of 0.1"
    ),
    held_out=(
        ": error of the shape's slopes (rms of one slope, steep parts count less) before and after"
        f" mending, and of their means over {JUDGED_WIDE_PX} x {JUDGED_WIDE_PX} pixels of the"
        " coarse grid"
    ),
    outputs=2,
    symmetry=replace(SHAPE_SYMMETRY, vectors=(*SHAPE_SYMMETRY.vectors, (32, 33))),
    loss=shape_loss,
    judge=judge,
    widths=(24, 32, 48, 64, 64),
    batch=8,
    patch_px=160,
    beyond_px=20,  # how far a patch may reach over a finger's edge, where the shape errs most
    shares={"finger": 1.0},
    min_weight=0.15,
    min_deviation=0.05,
    scale_patches=24,
    nir_fields=(6, 7, 11, 16, 17, 18, 19, 29, 30),  # zero without near-infrared images
    no_nir_share=0.15,
    learning_rate=1.5e-3,
    weight_decay=1e-3,
    warm_up=100,
)


def shoot(prints, kind, number):
    return [shape_sample(number, prints)]


def main():
    from loop import make_data, train_fields

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, required=True, help="folder; what it holds is not photographed again"
    )
    parser.add_argument(
        "--prints",
        type=Path,
        help="real prints of 500 pixels an inch (PNG), of a part of the fingers",
    )
    parser.add_argument(
        "--threads", type=int, default=1, help="of torch, and processes that photograph"
    )
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    options = parser.parse_args()
    numbers = [
        *range(FIRST_FINGER, FIRST_FINGER + FINGERS),
        *range(HELD_OUT_FROM, HELD_OUT_FROM + HELD_OUT_FINGERS),
    ]
    data = make_data(
        options.out,
        [("finger", n) for n in numbers],
        partial(shoot, options.prints),
        options.threads,
    )
    seen, held_out = (
        [a[0] for (_, n), a in data.items() if (n < HELD_OUT_FROM) == training]
        for training in (True, False)
    )
    command = "python training/shape.py --out DIR"
    train_fields(
        TASK,
        options.out,
        command,
        {"finger": seen},
        {"finger": held_out},
        iterations=ITERATIONS,
        threads=options.threads,
        device=options.device,
    )


if __name__ == "__main__":
    main()
