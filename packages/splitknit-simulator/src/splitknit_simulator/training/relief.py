"""The relief network, which separates relief from specular reflection for the `metric` method: its data and training.

What photometric stereo leaves of the light of skin is split by how it turns with the light's azimuth
(:mod:`splitknit.skin.learned`); the network learns on simulated fingers what of it is relief and what is specular
reflection (here: glare).

A finger is photographed by the simulator, found and cut out as in any reconstruction, and its smooth shape taken from
the first round. The network shall find the relief on any smooth shape, so that the shape is mixed for each finger from
that one and the true one. A piece of a finger takes a tenth of the time of a whole one, so that a network sees ten
times as many kinds of skin. A piece is not reconstructed: its smooth shape is the true one with a random smooth error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import (
    COARSE_PITCH_MM,
    RELIEF_MM,
    RELIEF_SYMMETRY,
    RIDGE_BAND_MM,
    BandImages,
    Capture,
    FloatArray,
    Grid,
    Lighting,
    Limits,
    Rig,
    Symmetry,
    azimuth_waves,
    bin_mean,
    coarse_images,
    coarse_shape,
    coarsen,
    default_rig,
    features,
    find_finger,
    fine_lighting,
    on_fine_grid,
    preset_settings,
    require,
    skin_images,
    slant_of,
    trust_of,
)
from splitknit import GLARE as GLARE_UNIT
from splitknit_simulator.camera.sensor import record
from splitknit_simulator.finger.finger import PoseRanges, finger_surface
from splitknit_simulator.light.renderer import BandLight, RenderSettings, render_band
from splitknit_simulator.light.skin import SkinOptics
from splitknit_simulator.surface import SimulatedSurface
from splitknit_simulator.training.fields import FIELDS, FieldsSettings, FieldsTask, Run, Sample
from splitknit_simulator.training.scenes import (
    Range,
    SceneRanges,
    TrainingScene,
    TruthOnGrid,
    draw_base,
    draw_finger_of,
    draw_scene,
    drawn_sensor,
    moved_rig,
    photograph_scene,
    textured,
    with_sensor,
)
from splitknit_simulator.training.trainer import HELD_OUT_FROM, NetworkKind, files_of
from splitknit_simulator.training.trainer import Sample as Stored

RELIEF = 32  # number of the relief in a sample, in the network's unit
GLARE = slice(33, 40)
"""The glare in a sample, in the network's unit: its mean over the light's azimuth a, cos a, sin a, ..., sin 3a."""
WEIGHT = 40  # number of the weight in a sample, in [0, 1]
CHANNELS = 41
_MAX_RELIEF = np.float32(10.0)  # relief beyond this many units (0.2 mm) is none
_MAX_GLARE = np.float32(3.0)
"""Glare above this many times the green level is cut off: it hides the skin whatever more there is of it."""
TRIM_PX = 60  # rim of a piece that is rendered but not kept: light from beyond the piece is missing there
_MIN_SKIN = 0.35  # pieces with a smaller fraction of skin are not rendered
_MIN_WEIGHT = 0.2  # pieces with a smaller mean weight are not kept
_BRIGHTEST = 0.72
_EXPOSURE = (0.55, 1.05)
"""Times :data:`_BRIGHTEST`, the brightest diffuse light of a piece over the sensor's full scale."""
_BLUR_PX = (0.3, 1.2)  # standard deviation of the defocus of a fraction of the pieces
_BLURRED = 0.25
_SHIFT_MM = 0.5
_TILT = 0.06
_BEND_PER_MM = 0.01
"""Standard deviations of the smooth shape's error: a shift, slopes along both axes, and three second-order terms."""


@dataclass(frozen=True, slots=True)
class ReliefData(SceneRanges):
    """How many fingers, and the ranges from which each is drawn."""

    fingers: Annotated[int, Limits(1, 100_000)] = 160
    """How many fingers the training pieces come from; about 35 MB each on disk."""
    crops: Annotated[int, Limits(1, 1000)] = 5
    """Pieces of each, every one with its own skin, lights and exposure."""
    crop_px: Annotated[int, Limits(1, 2000)] = 420
    """Side of a piece as it is rendered."""
    crop_usual_share: Annotated[float, Limits(0, 1)] = 0.7
    """Part of these fingers whose images have the size `scale`; the others' is drawn from `other_scale`."""
    whole_fingers: Annotated[int, Limits(0, 100_000)] = 116
    """That are trained on as a whole, through the front end of a reconstruction; about 60 MB each on disk."""
    held_out: Annotated[int, Limits(1, 1000)] = 6
    """Further whole ones, for the learning curve and the card."""
    first: Annotated[int, Limits(0, 900_000)] = 7000
    """Number of the first finger for pieces; everything about a finger follows from its number."""
    first_whole: Annotated[int, Limits(0, 900_000)] = 5000
    """Number of the first whole finger."""
    scale: Annotated[float, Limits(0, 1, above=True)] = 0.5
    """Size of the images relative to the full frame of 2200 x 3200 pixels."""
    other_scale: Annotated[Range, Limits(0, 1, above=True)] = (0.38, 0.62)
    """Scale of the other fingers."""
    other_scale_share: Annotated[float, Limits(0, 1)] = 0.25
    """Part of the whole fingers that have another size."""

    @property
    def numbers(self) -> tuple[range, range, range]:
        """Numbers of the fingers that pieces come from, of whole ones to train on, and of those held out."""
        return (
            range(self.first, self.first + self.fingers),
            range(self.first_whole, self.first_whole + self.whole_fingers),
            range(HELD_OUT_FROM, HELD_OUT_FROM + self.held_out),
        )


def _draw_scene(number: int, data: ReliefData) -> TrainingScene:
    rng = np.random.default_rng([number, 77])
    other = rng.random() < data.other_scale_share
    scale = float(rng.uniform(*data.other_scale)) if other else data.scale
    return with_sensor(draw_scene(number, rng, data, scale), rng, data)


def training_sample(number: int, data: ReliefData) -> tuple[NDArray[np.float16], dict[str, Any]]:
    """Photograph the finger `number`: a sample (41, h, w) float16 (:mod:`splitknit_simulator.training.fields`), and the
    facts drawn. Raises BadInput if the reconstruction would refuse the capture.
    """
    scene = _draw_scene(number, data)
    capture, truth = photograph_scene(scene)
    mix = float(np.random.default_rng(number).random())
    return _sample_of(capture, truth, mix), {**scene.facts(truth), "estimated_share": mix}


def _sample_of(capture: Capture, truth: Mapping[str, NDArray[Any]], mix: float) -> NDArray[np.float16]:
    """Fields, relief, glare and weight (41, h, w) of a capture; `mix`: the reconstruction's part of the shape."""
    settings = preset_settings("metric")
    finger = find_finger(capture, settings)
    lit = tuple(capture.bands[name] for name in ("white", "nir") if name in capture.bands)
    grid, bands, binning = skin_images(capture, lit, finger.window, finger.inside)
    images = coarse_images(bands, grid, settings.metric.plane_mm)
    optics = settings.skin.optics(images.channels)
    shape = coarse_shape(images, optics, settings.metric.coarse_steps)
    found = on_fine_grid(shape.height_mm, images)
    on_grid = TruthOnGrid(truth, finger.window, grid, binning)
    true = on_grid.shape_mm()
    level = true[grid.mask].mean(dtype=np.float64)
    true = true - np.float32(level) + np.float32(settings.metric.plane_mm)
    surface = ((1 - np.float32(mix)) * true + np.float32(mix) * found).astype(np.float32)
    light = _light_on(bands[0].rig, grid, surface)
    return _assembled(bands[0], grid, surface, light, on_grid)


def _assembled(
    white: BandImages, grid: Grid, surface_mm: FloatArray, light: Lighting, truth: TruthOnGrid
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
        np.clip(relief / RELIEF_MM, -_MAX_RELIEF, _MAX_RELIEF)[None],
        np.clip(waves, -_MAX_GLARE, _MAX_GLARE) / GLARE_UNIT,
        weight[None],
    )
    return np.concatenate(parts).astype(np.float16)


def _light_on(rig: Rig, grid: Grid, surface_mm: FloatArray) -> Lighting:
    """Lights on a smooth surface of the fine grid, by way of the coarse one as in a reconstruction."""
    factor = max(1, round(COARSE_PITCH_MM / grid.pitch_mm))
    low = coarsen(grid, factor)
    rows, columns = low.shape
    height = bin_mean(np.ascontiguousarray(surface_mm[: rows * factor, : columns * factor]), factor)
    height = np.asarray(cv2.GaussianBlur(height, (0, 0), 0.25 / low.pitch_mm), dtype=np.float32)
    return fine_lighting(rig, low, height, factor, grid)


def training_crops(number: int, data: ReliefData) -> NDArray[np.float16]:
    """Samples (n, 41, h, w) of pieces of the finger `number`, see :mod:`splitknit_simulator.training.fields`. Raises
    BadInput if the images are smaller than a piece, or no piece holds enough skin.
    """
    rng = np.random.default_rng([number, 78])
    usual = rng.random() < data.crop_usual_share
    scale = data.scale if usual else float(rng.uniform(*data.other_scale))
    finger = draw_finger_of(number, rng, data)
    camera = default_rig(scale).camera
    side = data.crop_px
    require(
        min(camera.image_size) >= side > 2 * TRIM_PX,
        f"pieces of {side} pixels do not fit into images of {camera.image_size[0]} x {camera.image_size[1]}, "
        f"or are not larger than twice their rim of {TRIM_PX}.",
    )
    surface = finger_surface(finger, PoseRanges().draw(rng, camera), camera, workers=1)
    rows, columns = np.nonzero(surface.mask)
    found = []
    for piece in range(data.crops):
        i = int(rng.integers(len(rows)))
        starts = np.clip(
            (int(rows[i]) - side // 2, int(columns[i]) - side // 2), 0, np.array(surface.mask.shape) - side
        )
        window = (slice(int(starts[0]), int(starts[0]) + side), slice(int(starts[1]), int(starts[1]) + side))
        if surface.mask[window].mean() < _MIN_SKIN:
            continue
        skin = data.skin(draw_base(rng, data)).draw(rng)
        rig = default_rig(scale, int(rng.integers(10_000)))
        rig = replace(rig, leds=tuple(led for led in rig.leds if led.band == "white"))
        rig = moved_rig(rig, rng, data) if rng.random() < data.other_rig_share else rig
        sample = _piece(textured(surface, rng, data), window, (skin, rig, scale), data, (number, piece), rng)
        if sample[WEIGHT].mean(dtype=np.float32) >= _MIN_WEIGHT:
            found.append(sample)
    require(len(found) > 0, f"not one piece of {side} pixels of finger {number} holds enough skin.")
    return np.stack(found)


def _piece(  # noqa: PLR0917
    surface: SimulatedSurface,
    window: tuple[slice, slice],
    scene: tuple[SkinOptics, Rig, float],
    data: ReliefData,
    name: tuple[int, int],
    rng: np.random.Generator,
) -> NDArray[np.float16]:
    skin, rig, scale = scene
    mask = np.zeros_like(surface.mask)
    mask[window] = surface.mask[window]
    light = render_band(replace(surface, mask=mask), rig.leds, skin.medium("white"), RenderSettings(workers=1))
    diffuse, glare = (_placed(part, light, window) for part in (light.diffuse, light.glare))
    inside = mask[window]
    brightest = max(float(np.percentile(diffuse[:, :, inside], 99.5)), 1e-12)
    exposure = np.float32(_BRIGHTEST / brightest * rng.uniform(*_EXPOSURE))
    blur_px = float(rng.uniform(*_BLUR_PX)) if rng.random() < _BLURRED else 0.0
    images, sensor = [], drawn_sensor(rng, data)
    for k in range(len(rig.leds)):
        frame = np.moveaxis((diffuse[k] + glare[k]) * exposure, 0, -1)
        if blur_px > 0:
            frame = cv2.GaussianBlur(frame, (0, 0), blur_px)
        seed = np.random.SeedSequence([*name, k])
        stored = record(np.ascontiguousarray(frame), "white", seed, sensor, scale)
        images.append(np.moveaxis(stored.astype(np.float32) / np.float32(255), -1, 0))
    white = BandImages(("red", "green", "blue"), np.stack(images, axis=1), rig)
    pitch_mm = rig.camera.pitch_mm
    (height, width), (rows, columns) = surface.mask.shape, window
    x = (np.arange(columns.start, columns.stop) - (width - 1) / 2) * pitch_mm
    y = ((height - 1) / 2 - np.arange(rows.start, rows.stop)) * pitch_mm
    grid = Grid(np.ascontiguousarray(inside), x, y, pitch_mm, (False,) * 4)
    heights, shape = surface.height_mm[window], surface.shape_mm[window]
    truth = {"mask": inside, "height_mm": heights, "shape_mm": shape, "glare_white": glare * exposure}
    on_grid = TruthOnGrid(truth, (slice(None), slice(None)), grid, 1)
    smooth = on_grid.shape_mm() + _smooth_error(rng, grid)
    lights = _light_on(rig, grid, smooth)
    sample = _assembled(white, grid, smooth, lights, on_grid)
    return np.ascontiguousarray(sample[:, TRIM_PX:-TRIM_PX, TRIM_PX:-TRIM_PX])


def _placed(light: FloatArray, band: BandLight, window: tuple[slice, slice]) -> FloatArray:
    """Rendered light (..., h, w), whose own window is that of the skin, on the piece; zero around it."""
    piece = np.zeros((*light.shape[:-2], *(part.stop - part.start for part in window)), dtype=np.float32)
    into: list[Any] = [...]
    source: list[Any] = [...]
    for own, part in zip(band.window, window, strict=True):
        low, high = max(own.start, part.start), min(own.stop, part.stop)
        into.append(slice(low - part.start, high - part.start))
        source.append(slice(low - own.start, high - own.start))
    piece[tuple(into)] = light[tuple(source)]
    return piece


def _smooth_error(rng: np.random.Generator, grid: Grid) -> FloatArray:
    """A random smooth error (h, w) of a shape, mm."""
    x, y = np.meshgrid(grid.x_mm - grid.x_mm.mean(), grid.y_mm - grid.y_mm.mean())
    spreads = (_SHIFT_MM, _TILT, _TILT, _BEND_PER_MM, _BEND_PER_MM, _BEND_PER_MM)
    terms = (np.ones_like(x), x, y, x * x, y * y, x * y)
    total = sum(rng.normal(0, spread) * term for spread, term in zip(spreads, terms, strict=True))
    return np.asarray(total, dtype=np.float32)


# The network, its loss, and what it is judged by.


NETWORK = NetworkKind(
    "relief",
    "relief and glare of skin: the fields of splitknit.skin.learned to the relief in 0.02 mm, seven "
    "waves of the glare over the light's azimuth in 0.05 of the green level, and the logarithm of the relief's "
    "variance",
    (FIELDS, 9),  # the relief, seven waves of the glare, the logarithm of the relief's variance
)
FILES = files_of(NETWORK.name, "fingers")
PARTS = ("relief", "slope", "likelihood", "glare")
SYMMETRY = Symmetry(
    vectors=(*RELIEF_SYMMETRY.vectors, (34, 35)),
    second_harmonics=(*RELIEF_SYMMETRY.second_harmonics, (36, 37)),
    third_harmonics=(*RELIEF_SYMMETRY.third_harmonics, (38, 39)),
)
"""Symmetry of a sample."""
JUDGED_PX = 512  # side of the middle part of a finger on which the network is evaluated
UNIT_UM = 1000.0 * float(RELIEF_MM)  # unit of the network's relief, micrometres
VARIANCE_LIMITS = (-6.0, 4.0)  # limits of the logarithm of the relief's variance, in the network's unit


@dataclass(frozen=True, slots=True)
class ReliefSettings(FieldsSettings):
    """Network, loss and training.

    The network that ships was trained in three runs, each from the weights of the one before: about 2400 iterations on
    whole fingers alone, then 200 and 4600 on pieces too. The defaults are its numbers, in one run.
    """

    whole_share: Annotated[float, Limits(0, 1)] = 0.2
    """Fraction of the patches that are cut from whole fingers, where there are any; the others are from pieces."""
    slope_share: Annotated[float, Limits(0)] = 1.0
    """Weight of the relief's slopes in the loss, beside its heights with weight one."""
    likelihood_share: Annotated[float, Limits(0)] = 0.2
    """Weight of how well the network knows its own error."""
    glare_share: Annotated[float, Limits(0)] = 0.2
    """Weight of the glare."""

    @property
    def loss_weights(self) -> dict[str, float]:
        """Weights of the loss's parts in their sum."""
        weights = (1.0, self.slope_share, self.likelihood_share, self.glare_share)
        return dict(zip(PARTS, weights, strict=True))


def _relief_losses(made: Any, batch: Any) -> dict[str, Any]:
    """Losses of `made` (B, 9, h, w), means over the pixels that count: ``relief``, squared error of heights; ``slope``,
    of their differences, where ridges outweigh what is wide; ``likelihood``, negative log-likelihood of the error
    (fixed, so that no height gets worse) under the estimated variance; ``glare``, squared error of its waves.
    """
    weight = batch[:, WEIGHT]
    count = weight.sum() + 1.0
    error = made[:, 0] - batch[:, RELIEF]
    along = (error[:, :, 1:] - error[:, :, :-1]) * weight[:, :, 1:]
    down = (error[:, 1:] - error[:, :-1]) * weight[:, 1:]
    logarithm = made[:, 8].clamp(*VARIANCE_LIMITS)
    glare = made[:, 1:8] - batch[:, GLARE]
    return {
        "relief": (error**2 * weight).sum() / count,
        "slope": ((along**2).sum() + (down**2).sum()) / count,
        "likelihood": ((error.detach() ** 2 * (-logarithm).exp() + logarithm) * weight).sum() / count,
        "glare": (glare**2 * weight[:, None]).sum() / count / glare.shape[1],
    }


def _judge_middle(run: Run, sample: Sample, stride: int) -> dict[str, float]:
    """Figures of :func:`_judged` for the middle of a finger, as `run` turns its fields (32, h, w) into (9, h, w)."""
    sides = np.minimum(JUDGED_PX, np.array(sample.shape[1:]) // stride * stride)
    starts = (np.array(sample.shape[1:]) - sides) // 2
    rows, columns = (slice(int(start), int(start + side)) for start, side in zip(starts, sides, strict=True))
    middle = np.asarray(sample[:, rows, columns], dtype=np.float32)
    return _judged(run(middle[:FIELDS]), middle)


def _judged(made: FloatArray, sample: FloatArray) -> dict[str, float]:
    """Figures of a result (9, h, w) against a sample (41, h, w) of weight above 1/2: of the relief ``correlation``,
    ``gain``, ``rms`` error (network's unit), ``error_ratio`` to the expected one; ``glare_r2``, explained power. NaN
    without skin or glare.
    """
    counts = sample[WEIGHT] > 0.5
    if not counts.any():
        return dict.fromkeys(("correlation", "gain", "rms", "error_ratio", "glare_r2"), math.nan)
    drawn, truth = (np.asarray(field[counts], dtype=np.float64) for field in (made[0], sample[RELIEF]))
    power = float((truth**2).mean())
    square = float(((drawn - truth) ** 2).mean())
    expected = float(np.exp(np.clip(made[8][counts], *VARIANCE_LIMITS), dtype=np.float64).mean())
    spread = float(drawn.std() * truth.std())
    glare = np.asarray(sample[GLARE][:, counts], dtype=np.float64)
    missed = float(((made[1:8][:, counts] - glare) ** 2).mean())
    shone = float((glare**2).mean())
    product = float(((drawn - drawn.mean()) * (truth - truth.mean())).mean())
    return {
        "correlation": product / spread if spread > 0 else math.nan,
        "gain": float((drawn * truth).mean()) / power if power > 0 else math.nan,
        "rms": math.sqrt(square),
        "error_ratio": math.sqrt(square / expected),
        "glare_r2": 1.0 - missed / shone if shone > 0 else math.nan,
    }


def _shoot(data: ReliefData, kind: str, number: int) -> Sequence[Stored]:
    if kind == "finger":
        return [training_sample(number, data)]
    pieces = training_crops(number, data)
    return [(pieces, {"finger": number, "pieces": len(pieces)})]


TASK = FieldsTask(
    kind=NETWORK,
    channels=CHANNELS,
    symmetry=SYMMETRY,
    losses=_relief_losses,
    judge=_judge_middle,
    in_units=lambda entry: {**{k: v for k, v in entry.items() if k != "rms"}, "rms_um": UNIT_UM * entry["rms"]},
    held_out=f"; the middle {JUDGED_PX} x {JUDGED_PX} pixels, on the smooth shape they would be trained on",
    lines={
        "training": lambda entry: UNIT_UM * math.sqrt(entry["relief"]),
        "held out": lambda entry: UNIT_UM * entry["held_out_rms"],
    },
    unit="error of the relief, µm",
    min_weight=0.2,
    min_deviation=0.02,
    scale_patches=12,
    shoot=_shoot,
)
