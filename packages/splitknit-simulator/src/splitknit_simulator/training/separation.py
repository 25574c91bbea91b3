"""The network that separates direct light: its data, of simulated palms and fingers, and its training.

The thesis, 3.3.1.4: a U-Net of three encoder and three decoder blocks, trained on 72 x 72 patches of 50 palms whose
direct light was measured with 25 shifted checkerboards; Adam on the mean squared error, an epoch at a time. Here the
optics of the skin, the place of the light, the size of a pixel and the noise of the camera are drawn for every
photograph, so that the network is of more than one palm. Patches are cut from photographs, turned, shifted, and stacked
into batches.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import (
    GREY_WEIGHTS,
    BadInput,
    BoolArray,
    Camera,
    Checked,
    ClaheSettings,
    FloatArray,
    Led,
    Limits,
    StackSettings,
    check_fields,
    checkerboard,
    clahe,
    default_rig,
    exposure_level,
    local_level,
    require,
)
from splitknit_simulator.camera.sensor import SensorSettings, record
from splitknit_simulator.finger.finger import PoseRanges, draw_finger, finger_surface
from splitknit_simulator.finger.palm import draw_palm, palm_surface
from splitknit_simulator.light.separation import Checkerboard, Separated, checkerboard_stack, separate_truth
from splitknit_simulator.light.skin import SkinOptics, SkinRanges
from splitknit_simulator.surface import SimulatedSurface
from splitknit_simulator.training.networks import unet
from splitknit_simulator.training.trainer import (
    FREE,
    HELD_OUT_FROM,
    LearningCurve,
    NetworkKind,
    Sample,
    Step,
    Subject,
    Trainer,
    TrainerSettings,
    TrainingRun,
    files_of,
    load_data,
    make_data,
    open_folder,
    packed,
    require_subjects,
    require_torch,
    train_in_folder,
    write_network,
)

_FULL_PX_PER_MM = 75.7
_FINGER_PITCH_UM = 20.0
CHANNELS = 8
"""Channels of a stored photograph: image red, green, blue; direct red, green, blue; enhanced image, enhanced direct."""
PATCH_PX = 72  # side of a patch (the thesis)
_MIN_SKIN = 0.25  # patches with a smaller fraction of skin are discarded (the thesis: those that are all black)
_MAX_SHIFT_PX = 8  # random translation of a patch, each way
_TURNED = 0.5
"""Fraction of the patches that are turned by any angle, which smooths their noise; the others by quarter turns."""
_ENHANCED = 0.5  # fraction of the patches that are given as grey, CLAHE-enhanced images, as by the thesis's presets
_WIDE_SKIN = SkinRanges(scattering_factor=(0.5, 2.0), glare=(0.0, 1.5), roughness=(0.12, 0.45))


@dataclass(frozen=True, slots=True)
class SeparationData(Checked):
    """The data set: photographs of simulated skin with and without its global light."""

    _group = "data"

    palms: Annotated[int, Limits(0, 10_000)] = 50
    """Palms; the thesis has 50."""
    fingers: Annotated[int, Limits(0, 10_000)] = 0
    """Fingers beside them; the thesis has none."""
    views: Annotated[int, Limits(1, 100)] = 1
    """Photographs of each, every one under other light and with other optics of the skin; the thesis has one."""
    patches: Annotated[int, Limits(1, 100_000)] = 750
    """Patches of each photograph."""
    image_size: Annotated[tuple[int, int], Limits(2 * PATCH_PX)] = (1018, 768)
    """Rows and columns of a palm's photograph."""
    labels: Literal["stack", "truth"] = "stack"
    """Direct light by 25 shifted checkerboards (``stack``, as the thesis) or by the simulator, ten times faster."""
    check_mm: Annotated[float, Limits(0.1, 5)] = 0.42
    """Side of the checks. About a ridge period: direct light is defined only together with it."""
    pitch_um: Annotated[tuple[float, float], Limits(5, 50)] = (13.0, 40.0)
    """Size of a palm's pixels on the finger plane, log-uniform; fingers have 20 um or more."""
    led_radius_mm: Annotated[tuple[float, float], Limits(0)] = (20.0, 75.0)
    """Distance of the light from the camera's axis, at the camera's height."""
    skin: SkinRanges = _WIDE_SKIN
    """Ranges beyond those of plausible fingers: what lies at their edge is then inside for the network."""
    held_out: Annotated[int, Limits(1, 1000)] = 4
    """Palms, and as many fingers, that are set apart for the learning curve."""

    def __post_init__(self) -> None:
        check_fields(self)
        require(self.palms + self.fingers >= 1, "there must be at least one palm or finger to train on.")
        for name in ("pitch_um", "led_radius_mm"):
            low, high = getattr(self, name)
            require(low <= high, f"data.{name} must be (low, high), but it is ({low:g}, {high:g}).")


Enhance = Callable[[FloatArray, float, BoolArray], FloatArray]
"""CLAHE: grey image (h, w), pixels per mm, mask -> (h, w) in [0, 1]."""


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """One photograph of one palm or finger, with its truth."""

    # (h, w, 8): see :data:`CHANNELS`; image and direct light in units of the image's exposure level, zero outside
    pixels: NDArray[np.float16]
    corners: NDArray[np.int32]  # (n, 2) row and column of the patches' upper left corners
    facts: Mapping[str, Any]  # kind, seed, pixel size, light, optics


def photographs(kind: str, index: int, seed: int, settings: SeparationData, enhance: Enhance) -> list[Photograph]:
    """Take all views of the palm or finger `index`, which follows from it and the data set's `seed`. `enhance`: the
    contrast enhancement of the thesis's presets, :func:`enhanced_contrast`.
    """
    surface = drawn_surface(kind, index, seed, settings)
    view_seeds = _root(kind, index, seed).spawn(1 + settings.views)[1:]
    return [_photograph(surface, (kind, index), view, settings, enhance) for view in view_seeds]


def enhanced_contrast(grey: FloatArray, px_per_mm: float, mask: BoolArray) -> FloatArray:
    """Enhance the contrast as the presets ``pr`` and ``snk`` do before the network."""
    return clahe(grey, px_per_mm, mask=mask)


def drawn_surface(kind: str, index: int, seed: int, settings: SeparationData) -> SimulatedSurface:
    """The palm or finger itself, before its camera: what :func:`photographs` takes pictures of."""
    require(kind in ("palm", "finger"), f"kind must be palm or finger, not '{kind}'.")
    rng = np.random.default_rng(_root(kind, index, seed).spawn(1)[0])
    if kind == "palm":
        camera = Camera(px_per_mm=1000.0 / _pitch_um(rng, settings.pitch_um), image_size=settings.image_size)
        return palm_surface(draw_palm(int(rng.integers(2**31))), camera)
    low, high = (max(pitch, _FINGER_PITCH_UM) for pitch in settings.pitch_um)
    camera = default_rig(1000.0 / _pitch_um(rng, (low, high)) / _FULL_PX_PER_MM).camera
    finger = draw_finger(int(rng.integers(2**31)))
    return finger_surface(finger, PoseRanges().draw(rng, camera), camera, workers=1)


def _root(kind: str, index: int, seed: int) -> np.random.SeedSequence:
    return np.random.SeedSequence([seed, 0x7A, kind == "finger", index])


def _pitch_um(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    return float(limits[0] * (limits[1] / limits[0]) ** rng.random())


def _photograph(
    surface: SimulatedSurface,
    name: tuple[str, int],
    seed: np.random.SeedSequence,
    settings: SeparationData,
    enhance: Enhance,
) -> Photograph:
    draw_seed, noise_seed, corner_seed = seed.spawn(3)
    rng = np.random.default_rng(draw_seed)
    skin = settings.skin.draw(rng)
    low, high = settings.led_radius_mm
    radius, azimuth = low + (high - low) * rng.random(), 2.0 * np.pi * rng.random()
    x, y = float(radius * np.cos(azimuth)), float(radius * np.sin(azimuth))
    led = Led("white", position_mm=(x, y, surface.camera.height_mm))
    sensor = SensorSettings(exposure=float(rng.uniform(0.4, 0.9)), bits=8 if rng.random() < 0.5 else 16)
    light = separate_truth(surface, led, skin, check_mm=settings.check_mm, phases="centred")
    if settings.labels == "stack":
        light = replace(light, direct=_through_patterns(surface, led, skin, light))
    pixels = _record(light, surface, sensor, noise_seed, enhance)
    corners = _patch_corners(surface.mask[light.window], settings, np.random.default_rng(corner_seed))
    facts = {
        "kind": name[0],
        "index": name[1],
        "pitch_um": 1000.0 * surface.camera.pitch_mm,
        "led_mm": list(led.position_mm or ()),
        "skin": skin,
        "exposure": sensor.exposure,
        "bits": sensor.bits,
    }
    return Photograph(pixels, corners, facts)


def _through_patterns(surface: SimulatedSurface, led: Led, skin: SkinOptics, light: Separated) -> FloatArray:
    """Direct light (3, h, w) from 25 shifted checkerboards, L_max - L_min of the noise-free images."""
    pattern = Checkerboard(light.check_mm, steps=5)
    stack = checkerboard_stack(surface, led, skin, pattern).transpose(0, 2, 3, 1)
    mask = surface.mask[light.window]
    # radiance in the rig's units knows no clipping; the black outside the mask is not a fault
    unbounded = StackSettings(clip_level=None)
    made = checkerboard(stack, alpha=0.5, dark=0.0, mask=mask, settings=unbounded)
    direct = np.where(mask, made.direct.transpose(2, 0, 1), np.float32(0.0))
    return np.asarray(np.minimum(direct, light.white), dtype=np.float32)


def _record(
    light: Separated, surface: SimulatedSurface, sensor: SensorSettings, seed: np.random.SeedSequence, enhance: Enhance
) -> NDArray[np.float16]:
    """Photograph the white light, noise and clipping included, and bring image and direct light to one scale."""
    mask, px_per_mm = surface.mask[light.window], surface.camera.px_per_mm
    brightest = np.percentile((light.white - light.glare)[:, mask].max(axis=0), 99.9)
    exposure = np.float32(sensor.exposure / max(float(brightest), 1e-12))
    clean = (light.white * exposure * mask).transpose(1, 2, 0)
    full = np.float32(2**sensor.bits - 1)
    stored = record(clean, "white", seed, sensor, px_per_mm / _FULL_PX_PER_MM)
    image = stored.astype(np.float32) / full * mask[..., None]
    # what clips is direct light: the truth of the clipped photograph is the clipped light less the global light
    clipped = np.minimum(clean, np.float32(1.0))
    kept = np.maximum((light.direct * exposure * mask).transpose(1, 2, 0) - (clean - clipped), np.float32(0.0))
    grey, grey_clean, grey_kept = (np.asarray(part @ GREY_WEIGHTS) for part in (image, clipped, kept))
    enhanced = enhance(grey, px_per_mm, mask)
    fraction = np.clip(grey_kept / np.maximum(grey_clean, np.float32(1e-6)), 0.0, 1.0)
    level = np.float32(exposure_level(image.transpose(2, 0, 1)))
    enhanced_level = np.float32(exposure_level(enhanced))
    parts = [image / level, kept / level]
    parts += [(part / enhanced_level)[..., None] for part in (enhanced, enhanced * fraction)]
    return np.concatenate(parts, axis=2).astype(np.float16)


def _patch_corners(mask: BoolArray, settings: SeparationData, rng: np.random.Generator) -> NDArray[np.int32]:
    """Draw the upper left corners (n, 2) of patches that hold skin."""
    side = PATCH_PX
    require(
        min(mask.shape) >= side,
        f"a photograph of {mask.shape[0]} x {mask.shape[1]} pixels is smaller than a patch of {side}.",
    )
    summed = np.pad(np.cumsum(np.cumsum(mask, axis=0, dtype=np.int64), axis=1), ((1, 0), (1, 0)))
    inside = summed[side:, side:] - summed[:-side, side:] - summed[side:, :-side] + summed[:-side, :-side]
    usable = np.flatnonzero(inside > _MIN_SKIN * side * side)
    if usable.size == 0:
        raise BadInput(f"no patch of {side} pixels holds enough skin; take smaller patches or larger images.")
    chosen = rng.choice(usable, settings.patches)
    return np.stack(np.divmod(chosen, inside.shape[1]), axis=1).astype(np.int32)


Batch = tuple[FloatArray, FloatArray]
"""Input and target, (B, 3, side, side)."""


class Patches:
    """All patches of a data set, in an order that can be shuffled."""

    def __init__(self, photographs: Sequence[Photograph], side: int = PATCH_PX) -> None:
        """Number the patches of `photographs`, each `side` pixels a side."""
        require(len(photographs) > 0, "there are no photographs to train on.")
        self.photographs, self.side = photographs, side
        self._owner = np.concatenate([np.full(len(p.corners), k) for k, p in enumerate(photographs)])
        self._corners = np.concatenate([p.corners for p in photographs])

    def __len__(self) -> int:
        return len(self._owner)

    def shuffled(self, batch: int, seed: int, epoch: int) -> Iterator[Batch]:
        """Yield the batches of one epoch: every patch once, augmented; the last, smaller batch too."""
        rng = np.random.default_rng(np.random.SeedSequence([seed, 0xBA, epoch]))
        order = rng.permutation(len(self))
        for first in range(0, len(order), batch):
            chosen = order[first : first + batch]
            enhanced = rng.random(len(chosen)) < _ENHANCED
            yield _stacked([self._augmented(k, rng) for k in chosen], enhanced)

    def fixed(self, enhanced: bool, batch: int) -> Iterator[Batch]:
        """Yield all patches in their order as they are, linear or enhanced."""
        for first in range(0, len(self), batch):
            pieces = [self._piece(k, *self._corners[k]) for k in range(first, min(first + batch, len(self)))]
            yield _stacked(pieces, np.full(len(pieces), enhanced))

    def _piece(self, k: int, row: int, column: int) -> FloatArray:
        """(side, side, 8) the square at a corner of the photograph of patch k."""
        pixels = self.photographs[self._owner[k]].pixels
        return np.asarray(pixels[row : row + self.side, column : column + self.side], dtype=np.float32)

    def _augmented(self, k: int, rng: np.random.Generator) -> FloatArray:
        """(side, side, 8) patch k, shifted, turned and mirrored."""
        pixels = self.photographs[self._owner[k]].pixels
        height, width = pixels.shape[:2]
        shift = rng.integers(-_MAX_SHIFT_PX, _MAX_SHIFT_PX + 1, 2)
        row, column = np.clip(self._corners[k] + shift, 0, (height - self.side, width - self.side))
        if rng.random() < _TURNED:
            piece = _turned(pixels, (int(row), int(column)), self.side, 360.0 * rng.random())
        else:
            piece = np.rot90(self._piece(k, row, column), int(rng.integers(4)))
        return piece[:, ::-1] if rng.random() < 0.5 else piece


def _turned(pixels: NDArray[np.float16], corner: tuple[int, int], side: int, angle_deg: float) -> FloatArray:
    """The patch at `corner`, turned about its middle; black where the photograph ends."""
    around = int(np.ceil(0.5 * (np.sqrt(2.0) - 1.0) * side)) + 2
    window, padding = [], []
    for start, length in zip(corner, pixels.shape[:2], strict=True):
        low, high = start - around, start + side + around
        window.append(slice(max(low, 0), min(high, length)))
        padding.append((max(-low, 0), max(high - length, 0)))
    source = np.pad(np.asarray(pixels[tuple(window)], dtype=np.float32), (*padding, (0, 0)))
    middle = 0.5 * (source.shape[0] - 1)
    matrix = cv2.getRotationMatrix2D((middle, middle), angle_deg, 1.0)
    matrix[:, 2] -= around
    halves = map(np.ascontiguousarray, (source[..., :4], source[..., 4:]))  # OpenCV turns four channels at a time
    return np.concatenate([cv2.warpAffine(half, matrix, (side, side), flags=cv2.INTER_LINEAR) for half in halves], 2)


def _stacked(pieces: Sequence[FloatArray], enhanced: NDArray[np.bool_]) -> Batch:
    """Input and target of each piece: linear colours, or three times the enhanced grey."""
    inputs, targets = [], []
    for piece, grey in zip(pieces, enhanced, strict=True):
        image, direct = (piece[..., [6, 6, 6]], piece[..., [7, 7, 7]]) if grey else (piece[..., :3], piece[..., 3:6])
        inputs.append(image.transpose(2, 0, 1))
        targets.append(direct.transpose(2, 0, 1))
    return np.stack(inputs), np.stack(targets)


# The network and its training.


NETWORK = NetworkKind(
    "direct",
    "direct light of skin: a photograph, or its CLAHE-enhanced grey image three times, to its direct part",
    (3, 3),
)
FILES = files_of(NETWORK.name, "photographs")


@dataclass(frozen=True, slots=True)
class SeparationSettings(TrainerSettings):
    """Network and training; the defaults are the thesis's where it gives a number."""

    width: Annotated[int, Limits(1, 1024)] = 64
    """Channels of the first block; they double from block to block. The thesis: 64."""
    depth: Annotated[int, Limits(1, 6)] = 3
    """Encoder blocks, and decoder blocks."""
    dropout: Annotated[float, Limits(0, 1, below=True)] = 0.5
    """Fraction dropped after the last encoder block and the bridge, while training; below 1."""
    start_fraction: Annotated[float, Limits(0, 1)] = 0.0
    """The untrained network gives this fraction of its image: a better start than noise. 0 = all random."""
    epochs: Annotated[int, Limits(1, 100_000)] = 50
    """How often every patch is seen."""
    decay: Annotated[float, Limits(0, 1)] = 0.0
    """Over this last part of the training the learning rate falls to zero along a cosine; the thesis keeps it."""
    border_px: Annotated[int, Limits(0, 512)] = 0
    """Pixels at a patch's border that the loss leaves out: there the network sees zeros where an image would go on."""

    @property
    def stride(self) -> int:
        """Both sides of what the network sees are multiples of this."""
        return int(2**self.depth)


class SeparationTrainer(Trainer):
    """The network for direct light in training."""

    counted: ClassVar[str] = "epoch"
    free: ClassVar[tuple[str, ...]] = (*FREE, "epochs", "decay")

    def __init__(self, settings: SeparationSettings, patches: Patches) -> None:
        """Draw the first weights from the settings' seed."""
        shape = (settings.width, settings.depth, settings.dropout, settings.start_fraction)
        super().__init__(settings, lambda: unet(*shape))
        self.settings: SeparationSettings = settings
        self.patches = patches

    def steps(self) -> Iterator[Step]:
        """One epoch: every patch once, augmented."""
        settings = self.settings
        count = math.ceil(len(self.patches) / settings.batch)
        for number, batch in enumerate(self.patches.shuffled(settings.batch, settings.seed, self.done)):
            done = (self.done + number / count) / settings.epochs
            rate = settings.learning_rate * _learning_factor(done, settings.decay)
            yield Step(batch, rate, len(batch[0]), done)

    def losses(self, batch: Batch) -> dict[str, Any]:
        """Mean squared error."""
        inputs, targets = (self.tensor(part) for part in batch)
        error = self.forward(inputs) - targets
        rim = self.settings.border_px
        if rim:
            error = error[:, :, rim:-rim, rim:-rim]
        return {"loss": (error * error).mean()}

    def loss_of(self, patches: Patches, enhanced: bool) -> float:
        """Mean squared error over all patches as they are, nothing dropped."""
        self.network.eval()
        total, count = 0.0, 0
        with self.torch.no_grad():
            for batch in patches.fixed(enhanced, self.settings.batch):
                total += float(self.losses(batch)["loss"]) * len(batch[0])
                count += len(batch[0])
        return total / count

    def packed(self, facts: Mapping[str, Any]) -> tuple[bytes, bytes]:
        """Network and card, see :func:`splitknit_simulator.training.trainer.packed`."""
        settings = self.settings
        words = f"U-Net of the thesis (figure 3.19), depth {settings.depth}, width {settings.width}"
        return packed(NETWORK, self.network, words, settings.depth, facts)


def _learning_factor(done: float, decay: float) -> float:
    """Learning rate, relative to its start, when a fraction is `done`: it falls over the last `decay`."""
    if decay <= 0 or done <= 1 - decay:
        return 1.0
    return 0.5 * (1.0 + math.cos(math.pi * min((done - 1 + decay) / decay, 1.0)))


def train_separation(run: TrainingRun, data: SeparationData, settings: SeparationSettings) -> dict[str, Any]:
    """Build the data set and train. BadInput if torch is missing, or the folder in use or of other settings."""
    started = time.perf_counter()
    require_torch(settings)
    *photographed, refused = stored_photographs(run, data, settings)
    train, held_out = map(Patches, photographed)
    trainer = SeparationTrainer(settings, train)
    lines = {
        "training": lambda entry: _psnr(entry["loss"]),
        "held out": lambda entry: _psnr(entry["held_out_linear"]),
        "held out, enhanced": lambda entry: _psnr(entry["held_out_enhanced"]),
    }
    curve = LearningCurve(
        1,
        lambda: {"linear": trainer.loss_of(held_out, False), "enhanced": trainer.loss_of(held_out, True)},
        lines,
        "PSNR, dB",
    )
    train_in_folder(run, trainer, settings.epochs, curve)
    run.progress("exporting", 1.0)
    last = trainer.curve[-1]
    facts = {
        "command": run.command,
        "training": {**asdict(settings), "epochs_done": trainer.done, "patches": len(train)},
        "data": asdict(data),
        "metrics": {
            "held_out": f"{data.held_out} palms and {data.held_out} fingers not trained on, patches, local level 1",
            "psnr_linear_db": _psnr(last["held_out_linear"]),
            "psnr_enhanced_db": _psnr(last["held_out_enhanced"]),
        },
    }
    side = 10 * settings.stride
    probe = np.random.default_rng(0).random((1, 3, side, side + settings.stride), dtype=np.float32)
    written = write_network(run.out, NETWORK.name, trainer.packed(facts), trainer.run, probe)
    return {**written, "refused": len(refused), "out": str(run.out), "total_s": time.perf_counter() - started}


def stored_photographs(
    run: TrainingRun, data: SeparationData, settings: SeparationSettings
) -> tuple[list[Photograph], list[Photograph], list[str]]:
    """Photographs to train on and those held out, made where the folder lacks them, and why subjects were refused.
    Raises BadInput as :func:`train_separation` does.
    """
    open_folder(run, data, settings, SeparationTrainer.free)
    views, subjects = [f"_{view:02d}" for view in range(data.views)], _subjects(data)
    shoot = functools.partial(_shoot, data=data, seed=settings.seed)
    refused = make_data(run, subjects, shoot, views, settings.threads)
    train: list[Photograph] = []
    held_out: list[Photograph] = []
    for kind, number in subjects:
        for pixels, facts in load_data(run.out, kind, [number], _fits, views).get(number, []):
            corners = np.asarray(facts["corners"], dtype=np.int32).reshape(-1, 2)
            (held_out if number >= HELD_OUT_FROM else train).append(Photograph(pixels, corners, facts))
    require_subjects(len(train), "train on", refused)
    require_subjects(len(held_out), "judge the network on", refused)
    return train, held_out, refused


def _subjects(data: SeparationData) -> list[Subject]:
    counts = {"palm": data.palms, "finger": data.fingers}
    trained = [(kind, index) for kind, count in counts.items() for index in range(count)]
    return trained + [(kind, HELD_OUT_FROM + index) for kind in counts for index in range(data.held_out)]


def _shoot(kind: str, index: int, data: SeparationData, seed: int) -> Iterable[Sample]:
    """Every second palm and finger is equalised in linear light, so that the network knows both."""
    for photograph in photographs(kind, index, seed, data, _enhance_linear if index % 2 else enhanced_contrast):
        facts = photograph.facts
        stored = {**facts, "skin": asdict(facts["skin"]), "corners": photograph.corners.tolist()}
        yield _levelled(photograph).pixels, stored


def _fits(shape: tuple[int, ...], facts: Mapping[str, Any]) -> bool:
    """Whether these are the pixels of a photograph, and its patches lie within."""
    corners = np.asarray(facts["corners"], dtype=np.int32).reshape(-1, 2)
    inside = corners.min() >= 0 and (corners.max(axis=0) + PATCH_PX <= shape[:2]).all()
    return len(shape) == 3 and shape[2] == CHANNELS and bool(inside)


def _psnr(loss: float) -> float:
    """PSNR of a mean squared error, in dB, for a peak of one: the local level."""
    return float(-10.0 * np.log10(max(loss, 1e-12)))


def _enhance_linear(grey: FloatArray, px_per_mm: float, mask: BoolArray) -> FloatArray:
    return clahe(grey, px_per_mm, ClaheSettings(grey="linear"), mask=mask)


def _levelled(photograph: Photograph) -> Photograph:
    """The photograph divided by its local level, as the network is given it."""
    pixels = photograph.pixels.astype(np.float32)
    level = local_level(np.ascontiguousarray(pixels[..., :3].transpose(2, 0, 1)))[..., None]
    enhanced_level = local_level(np.ascontiguousarray(pixels[..., 6]))[..., None]
    divided = np.concatenate([pixels[..., :6] / level, pixels[..., 6:] / enhanced_level], axis=2)
    return replace(photograph, pixels=divided.astype(np.float16))
