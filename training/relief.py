"""Train `relief`, which separates relief from specular reflection for the `metric` method.

    python training/relief.py --out DIR [--prints FOLDER]       # an hour or two on two cores, 13 GB
    python training/relief.py --out DIR --walked FOLDER --start relief.onnx --iterations 3000

What photometric stereo leaves of the light of skin is split by how it turns with the light's
azimuth (`splitknit.skin.learned`); the network learns on simulated fingers what of it is relief and
what is specular reflection (glare). A whole finger is found and cut out as in any reconstruction,
its smooth shape mixed from the true one and the first round's. A piece of a finger takes a tenth of
the time; its smooth shape is the true one, in error.

Path-traced fingers (``validation/path_traced/make.py --drawn``) are a second medium, whose light
walks through a volume: the network then learns less of what one simulator gets wrong.

The shipped weights are a mean over several runs on older simulators too (see the card): the command
repeats the recipe, not the bytes.
"""

from __future__ import annotations

import argparse
import math
import zlib
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np

from scenes import (
    HELD_OUT_FROM,
    OTHER_RIG_FRACTION,
    TruthOnGrid,
    draw_finger_of,
    draw_scene,
    draw_sensor,
    draw_skin,
    moved_rig,
    photograph_scene,
    textured,
)
from splitknit.errors import require
from splitknit.finger.locate import find_finger
from splitknit.imaging.pixels import bin_mean
from splitknit.io.capture import read_capture
from splitknit.io.npz import read_npz
from splitknit.nominal import default_rig
from splitknit.observation.observe import observe
from splitknit.presets import preset_settings
from splitknit.skin.grid import BandImages, Grid, coarsen
from splitknit.skin.images import skin_images
from splitknit.skin.learned import GLARE as GLARE_UNIT
from splitknit.skin.learned import (
    RELIEF_MM,
    RELIEF_SYMMETRY,
    RIDGE_BAND_MM,
    azimuth_waves,
    features,
)
from splitknit.skin.light import fine_lighting, slant_of, trust_of
from splitknit.skin.shape import COARSE_PITCH_MM, coarse_images, coarse_shape, on_fine_grid
from splitknit_simulator.camera.sensor import record
from splitknit_simulator.finger.finger import PoseRanges, finger_surface
from splitknit_simulator.light.renderer import RenderSettings, render_band

CROPPED_FINGERS = 160  # fingers that pieces come from
FIRST_CROPPED = 7000  # number of the first of them
WHOLE_FINGERS = 116  # fingers that are trained on as a whole
FIRST_WHOLE = 5000  # number of the first of them
HELD_OUT_FINGERS = 6
ITERATIONS = 7200
CROPS = 5  # pieces of each finger, every one with its own skin, lights and exposure
CROP_PX = 420  # side of a piece as rendered
SCALE = 0.5  # size of the images
OTHER_SCALE = (0.38, 0.62)  # size of a part of the images
# in a sample, in the network's units
RELIEF_CHANNEL = 32
GLARE_CHANNELS = slice(33, 40)  # glare, its waves over azimuth: 1, cos a, ..., sin 3a
WEIGHT_CHANNEL = 40
MAX_RELIEF = np.float32(10.0)  # relief beyond this many units (0.2 mm) is none
MAX_GLARE = np.float32(3.0)  # times the green level: more hides the skin, whatever it is
# rim of a piece that is rendered but not kept: light from beyond the piece is missing there
TRIM_PX = 60
HELD_OUT_EVERY = 10  # one of as many path-traced fingers is not trained on
MIN_SKIN = 0.35  # pieces with a smaller fraction of skin are not rendered
MIN_WEIGHT = 0.2  # pieces with a smaller mean weight are not kept
BRIGHTEST_LEVEL = 0.72  # brightest diffuse light of a piece over full scale
EXPOSURE_FACTOR = (0.55, 1.05)  # by which that is multiplied
BLURRED_FRACTION = 0.25  # of the pieces: those that are out of focus
BLUR_PX = (0.3, 1.2)  # standard deviation of their defocus
# of a shift (mm), slopes along both axes, three bends (1/mm)
SMOOTH_ERROR = (0.5, 0.06, 0.06, 0.01, 0.01, 0.01)
JUDGED_PX = 512  # side of the middle part of a finger on which the network is evaluated
UNIT_UM = 1000.0 * float(RELIEF_MM)
VARIANCE_LIMITS = (-6.0, 4.0)  # of the logarithm of the relief's variance, in the network's unit


def training_sample(number, prints=None):
    """Fields, relief, glare and weight (41, h, w) float16 of the finger `number`; BadInput if it is
    refused."""
    rng = np.random.default_rng([number, 77])
    scale = float(rng.uniform(*OTHER_SCALE)) if rng.random() < 0.25 else SCALE
    finger, rig, twin = draw_scene(number, rng, scale, prints)
    capture, truth = photograph_scene(number, finger, rig, replace(twin, sensor=draw_sensor(rng)))
    return _whole_sample(capture, truth, number)


def walked_sample(truth_file):
    """The same of a finger of ``validation/path_traced/make.py --drawn``; its glare is not known
    (NaN)."""
    capture = read_capture(truth_file.with_name(truth_file.name.removesuffix("_truth.npz")))
    return _whole_sample(capture, read_npz(truth_file), zlib.crc32(truth_file.name.encode()))


def _whole_sample(capture, truth, seed):
    """The sample of a whole capture; `seed`: of how much of the measured shape is mixed into the
    true one."""
    settings = preset_settings("metric")
    observation = observe(capture)
    located = find_finger(observation, settings)
    lit = tuple(light for name, light in observation.bands.items() if name in {"white", "nir"})
    grid, bands, binning = skin_images(lit, located.window, located.inside)
    images = coarse_images(bands, grid, settings.metric.plane_mm)
    optics = settings.skin.optics(images.channels)
    measured = on_fine_grid(
        coarse_shape(images, optics, settings.metric.coarse_steps).height_mm, images
    )
    on_grid = TruthOnGrid(truth, located.window, grid, binning)
    true = on_grid.shape_mm()
    level = true[grid.mask].mean(dtype=np.float64)
    true = true - np.float32(level) + np.float32(settings.metric.plane_mm)
    mix = np.float32(np.random.default_rng(seed).random())
    return _assembled(
        bands[0], grid, ((1 - mix) * true + mix * measured).astype(np.float32), on_grid
    )


def _assembled(white, grid, surface_mm, truth):
    """The sample of one finger on one smooth surface."""
    light = _light_on(white.rig, grid, surface_mm)
    seen = features(white, grid, surface_mm, light)
    known = grid.mask & truth.mask
    relief = np.where(known, truth.relief_mm(), np.float32(0.0))
    relief = (relief - grid.smooth(relief, known, RIDGE_BAND_MM)) * known
    size = np.sqrt((light.vectors * light.vectors).sum(axis=1))
    waves = np.full((7, *grid.shape), np.nan, dtype=np.float32)
    if (glare := truth.glare()) is not None:
        glare = glare / (seen.level[1] * size + np.float32(1e-9))
        to_waves = np.linalg.pinv(azimuth_waves(white.rig, 3), rcond=1e-3).astype(np.float32)
        waves = np.tensordot(to_waves, glare, 1) * known
    weight = trust_of(slant_of(surface_mm, grid.pitch_mm), grid) * known
    parts = (
        seen.fields,
        np.clip(relief / RELIEF_MM, -MAX_RELIEF, MAX_RELIEF)[None],
        np.clip(waves, -MAX_GLARE, MAX_GLARE) / GLARE_UNIT,
        weight[None],
    )
    return np.concatenate(parts).astype(np.float16)


def _light_on(rig, grid, surface_mm):
    """Lights on a smooth surface of the fine grid, by way of the coarse one as in a
    reconstruction."""
    factor = max(1, round(COARSE_PITCH_MM / grid.pitch_mm))
    low = coarsen(grid, factor)
    rows, columns = low.shape
    height = bin_mean(np.ascontiguousarray(surface_mm[: rows * factor, : columns * factor]), factor)
    height = np.asarray(cv2.GaussianBlur(height, (0, 0), 0.25 / low.pitch_mm), dtype=np.float32)
    return fine_lighting(rig, low, height, factor, grid)


def training_crops(number, prints=None):
    """Samples (n, 41, h, w) of pieces of the finger `number`; BadInput if none holds enough
    skin."""
    rng = np.random.default_rng([number, 78])
    scale = SCALE if rng.random() < 0.7 else float(rng.uniform(*OTHER_SCALE))
    finger = draw_finger_of(number, rng, prints)
    camera = default_rig(scale).camera
    surface = finger_surface(finger, PoseRanges().draw(rng, camera), camera, workers=1)
    rows, columns = np.nonzero(surface.mask)
    pieces = []
    for piece in range(CROPS):
        i = int(rng.integers(len(rows)))
        corner = (int(rows[i]) - CROP_PX // 2, int(columns[i]) - CROP_PX // 2)
        starts = np.clip(corner, 0, np.array(surface.mask.shape) - CROP_PX)
        window = tuple(slice(int(start), int(start) + CROP_PX) for start in starts)
        if surface.mask[window].mean() < MIN_SKIN:
            continue
        skin = draw_skin(rng).draw(rng)
        rig = default_rig(scale, int(rng.integers(10_000)))
        rig = replace(rig, leds=tuple(led for led in rig.leds if led.band == "white"))
        rig = moved_rig(rig, rng) if rng.random() < OTHER_RIG_FRACTION else rig
        sample = _piece(textured(surface, rng), window, skin, rig, scale, (number, piece), rng)
        if sample[WEIGHT_CHANNEL].mean(dtype=np.float32) >= MIN_WEIGHT:
            pieces.append(sample)
    require(
        len(pieces) > 0, f"not one piece of {CROP_PX} pixels of finger {number} holds enough skin."
    )
    return np.stack(pieces)


def _piece(surface, window, skin, rig, scale, name, rng):  # noqa: PLR0917
    mask = np.zeros_like(surface.mask)
    mask[window] = surface.mask[window]
    light = render_band(
        replace(surface, mask=mask), rig.leds, skin.medium("white"), RenderSettings(workers=1)
    )
    diffuse, glare = (_placed(part, light, window) for part in (light.diffuse, light.glare))
    inside = mask[window]
    brightest = max(float(np.percentile(diffuse[:, :, inside], 99.5)), 1e-12)
    exposure = np.float32(BRIGHTEST_LEVEL / brightest * rng.uniform(*EXPOSURE_FACTOR))
    blur_px = float(rng.uniform(*BLUR_PX)) if rng.random() < BLURRED_FRACTION else 0.0
    images = []
    sensor = draw_sensor(rng)
    for k in range(len(rig.leds)):
        frame = np.moveaxis((diffuse[k] + glare[k]) * exposure, 0, -1)
        if blur_px > 0:
            frame = cv2.GaussianBlur(frame, (0, 0), blur_px)
        stored = record(
            np.ascontiguousarray(frame), "white", np.random.SeedSequence([*name, k]), sensor, scale
        )
        images.append(np.moveaxis(stored.astype(np.float32) / np.float32(255), -1, 0))
    white = BandImages(("red", "green", "blue"), np.stack(images, axis=1), rig)
    pitch_mm = rig.camera.pitch_mm
    (height, width), (rows, columns) = surface.mask.shape, window
    x = (np.arange(columns.start, columns.stop) - (width - 1) / 2) * pitch_mm
    y = ((height - 1) / 2 - np.arange(rows.start, rows.stop)) * pitch_mm
    grid = Grid(np.ascontiguousarray(inside), x, y, pitch_mm, (False,) * 4)
    heights, shape = surface.height_mm[window], surface.shape_mm[window]
    truth = {
        "mask": inside,
        "height_mm": heights,
        "shape_mm": shape,
        "glare_white": glare * exposure,
    }
    on_grid = TruthOnGrid(truth, (slice(None), slice(None)), grid, 1)
    sample = _assembled(white, grid, on_grid.shape_mm() + _smooth_error(rng, grid), on_grid)
    return np.ascontiguousarray(sample[:, TRIM_PX:-TRIM_PX, TRIM_PX:-TRIM_PX])


def _placed(light, band, window):
    """Rendered light (..., h, w), whose own window is that of the skin, on the piece; zero around
    it."""
    piece = np.zeros(
        (*light.shape[:-2], *(part.stop - part.start for part in window)), dtype=np.float32
    )
    into, source = [...], [...]
    for own, part in zip(band.window, window, strict=True):
        low = max(own.start, part.start)
        high = min(own.stop, part.stop)
        into.append(slice(low - part.start, high - part.start))
        source.append(slice(low - own.start, high - own.start))
    piece[tuple(into)] = light[tuple(source)]
    return piece


def _smooth_error(rng, grid):
    """A random smooth error (h, w) of a shape, mm."""
    x, y = np.meshgrid(grid.x_mm - grid.x_mm.mean(), grid.y_mm - grid.y_mm.mean())
    terms = (np.ones_like(x), x, y, x * x, y * y, x * y)
    total = sum(
        rng.normal(0, spread) * term for spread, term in zip(SMOOTH_ERROR, terms, strict=True)
    )
    return np.asarray(total, dtype=np.float32)


def relief_loss(output, batch):
    """Loss of `output` (B, 9, h, w), means over the pixels that count: squared error of heights; of
    their differences, where ridges outweigh what is wide; negative log-likelihood of the error
    (fixed, so that no height gets worse) under the estimated variance; squared error of the glare's
    waves, where they are known.
    """
    weight = batch[:, WEIGHT_CHANNEL]
    count = weight.sum() + 1.0
    error = output[:, 0] - batch[:, RELIEF_CHANNEL]
    along = (error[:, :, 1:] - error[:, :, :-1]) * weight[:, :, 1:]
    down = (error[:, 1:] - error[:, :-1]) * weight[:, 1:]
    logarithm = output[:, 8].clamp(*VARIANCE_LIMITS)
    waves = (output[:, 1:8] - batch[:, GLARE_CHANNELS]).nan_to_num(0.0)
    relief = (error**2 * weight).sum() / count
    slope = ((along**2).sum() + (down**2).sum()) / count
    likelihood = ((error.detach() ** 2 * (-logarithm).exp() + logarithm) * weight).sum() / count
    glare = (waves**2 * weight[:, None]).sum() / count / waves.shape[1]
    return relief + slope + 0.2 * likelihood + 0.2 * glare


def judge(run, sample, stride):
    """Figures of the middle of a finger: correlation, gain and rms error of the relief, explained
    power of the glare; ``error_ratio``: over the expected error.
    """
    sides = np.minimum(JUDGED_PX, np.array(sample.shape[1:]) // stride * stride)
    starts = (np.array(sample.shape[1:]) - sides) // 2
    rows, columns = (
        slice(int(start), int(start + side)) for start, side in zip(starts, sides, strict=True)
    )
    sample = np.asarray(sample[:, rows, columns], dtype=np.float32)
    output = run(sample[:32])
    counts = sample[WEIGHT_CHANNEL] > 0.5
    if not counts.any():
        return dict.fromkeys(("correlation", "gain", "rms_um", "error_ratio", "glare_r2"), math.nan)
    drawn, truth = (
        np.asarray(field[counts], dtype=np.float64) for field in (output[0], sample[RELIEF_CHANNEL])
    )
    square = float(((drawn - truth) ** 2).mean())
    expected = float(np.exp(np.clip(output[8][counts], *VARIANCE_LIMITS), dtype=np.float64).mean())
    glare = np.asarray(sample[GLARE_CHANNELS][:, counts], dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        return {
            "correlation": float(np.corrcoef(drawn, truth)[0, 1]),
            "gain": float((drawn * truth).mean() / (truth**2).mean()),
            "rms_um": UNIT_UM * math.sqrt(square),
            "error_ratio": math.sqrt(square / expected),
            "glare_r2": float(
                1.0 - ((output[1:8][:, counts] - glare) ** 2).mean() / (glare**2).mean()
            ),
        }


TASK = SimpleNamespace(
    name="relief",
    what=(
        "relief and glare of skin: the fields of splitknit.skin.learned to the relief in 0.02 mm,"
        " seven waves of the glare over the light's azimuth in 0.05 of the green level, and the"
        " logarithm of the relief's variance"
    ),
    held_out=(
        f"; the middle {JUDGED_PX} x {JUDGED_PX} pixels, on the smooth shape they would be"
        " trained on"
    ),
    outputs=9,
    symmetry=replace(
        RELIEF_SYMMETRY,
        vectors=(*RELIEF_SYMMETRY.vectors, (34, 35)),
        second_harmonics=(*RELIEF_SYMMETRY.second_harmonics, (36, 37)),
        third_harmonics=(*RELIEF_SYMMETRY.third_harmonics, (38, 39)),
    ),
    loss=relief_loss,
    judge=judge,
    widths=(16, 32, 48, 64, 64),
    batch=6,
    patch_px=192,
    beyond_px=0,
    # of the patches, relative: from pieces of fingers, whole fingers, path-traced fingers
    shares={"pieces": 0.8, "finger": 0.2, "walked": 0.8},
    min_weight=0.2,
    min_deviation=0.02,
    scale_patches=12,
    nir_fields=(),
    no_nir_share=0.0,
    learning_rate=1.5e-3,
    weight_decay=0.0,
    warm_up=200,
)


def shoot(prints, walked, kind, number):
    if kind == "walked":
        return [walked_sample(walked[number])]
    return (
        [training_sample(number, prints)]
        if kind == "finger"
        else list(training_crops(number, prints))
    )


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
    parser.add_argument(
        "--walked",
        type=Path,
        help="path-traced fingers, of validation/path_traced/make.py --drawn: a second medium",
    )
    parser.add_argument("--start", type=Path, help="network (ONNX) that is trained further")
    parser.add_argument("--iterations", type=int, default=ITERATIONS)
    options = parser.parse_args()
    whole = [
        *range(FIRST_WHOLE, FIRST_WHOLE + WHOLE_FINGERS),
        *range(HELD_OUT_FROM, HELD_OUT_FROM + HELD_OUT_FINGERS),
    ]
    truths = sorted(options.walked.glob("*_truth.npz")) if options.walked else []
    if options.walked and not truths:
        parser.error(f"{options.walked} holds no captures of make.py --drawn.")
    walked = {
        HELD_OUT_FROM + n if n % HELD_OUT_EVERY == 0 else n: truth for n, truth in enumerate(truths)
    }
    subjects = [
        *(("pieces", n) for n in range(FIRST_CROPPED, FIRST_CROPPED + CROPPED_FINGERS)),
        *(("finger", n) for n in whole),
        *(("walked", n) for n in walked),
    ]
    data = make_data(options.out, subjects, partial(shoot, options.prints, walked), options.threads)
    samples, held_out = {}, {}
    for (kind, number), arrays in data.items():
        group = samples if number < HELD_OUT_FROM else held_out
        group.setdefault(kind, []).extend(arrays)
    command = "python training/relief.py --out DIR"
    if walked:
        command += " --walked FOLDER"
    if options.start:
        command += f" --start {options.start.name} --iterations {options.iterations}"
    train_fields(
        TASK,
        options.out,
        command,
        samples,
        held_out,
        iterations=options.iterations,
        start=options.start,
        threads=options.threads,
        device=options.device,
    )


if __name__ == "__main__":
    main()
