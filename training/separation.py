"""Train `direct`, the U-Net of the thesis that finds direct light (3.3.1.4).

    python training/separation.py --out DIR  # what ships: 42 minutes on two busy cores
    python training/separation.py --out DIR --thesis --device cuda --threads 16  # as the thesis

The thesis trains on 72 x 72 patches of 50 palms whose direct light was measured with 25 shifted
checkerboards; Adam on the mean squared error. Here the optics of the skin, the place of the light,
the size of a pixel and the noise of the camera are drawn for every photograph.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from palms import draw_palm, palm_surface
from patterns import checkerboard
from projector import Checkerboard, checkerboard_stack, separate_truth
from scenes import HELD_OUT_FROM
from splitknit.finger.contrast import ClaheSettings, clahe
from splitknit.imaging.pixels import GREY_WEIGHTS
from splitknit.model import Camera, Led
from splitknit.nominal import default_rig
from splitknit.separation.direct import exposure_level, local_level
from splitknit_simulator.camera.sensor import FULL_PX_PER_MM, SensorSettings, record
from splitknit_simulator.finger.finger import PoseRanges, draw_finger, finger_surface
from splitknit_simulator.light.skin import SkinRanges

IMAGE_SIZE = (1018, 768)  # rows and columns of a palm's photograph
PITCH_UM = (13.0, 40.0)  # size of a palm's pixels on the finger plane
FINGER_PITCH_UM = 20.0  # smallest size of a finger's pixels there
LED_RADIUS_MM = (20.0, 75.0)  # distance of the light from the camera's axis, at the camera's height
# side of the checks, about a ridge period: direct light is defined only together with it
CHECK_MM = 0.42
# beyond plausible fingers
SKIN = SkinRanges(scattering_factor=(0.5, 2.0), glare=(0.0, 1.5), roughness=(0.12, 0.45))
PATCH_PX = 72  # the thesis
# patches with a smaller fraction of skin are discarded (the thesis: those that are all black)
MIN_SKIN = 0.25
MAX_SHIFT_PX = 8  # random translation of a patch, each way
# fraction of the patches turned by any angle, which smooths noise; the others by quarter turns
TURNED_FRACTION = 0.5
# fraction of the patches that are given as grey, CLAHE-enhanced images, as by the thesis's presets
ENHANCED_FRACTION = 0.5
BATCH_SIZE = 32
LEARNING_RATE = 1e-3
HELD_OUT_COUNT = 4  # palms, and fingers, that are held out


@dataclass(frozen=True)
class Recipe:
    """What differs between the network that ships and the thesis's."""

    palms: int
    fingers: int
    views: int  # photographs of each, under other light and with other skin
    patches: int  # of each photograph
    # direct light by 25 shifted checkerboards (stack) or by the simulator, ten times faster (truth)
    labels: str
    width: int  # channels of the first block
    epochs: int
    dropout: float
    decay: float  # last part of the training over which the learning rate falls to zero
    start_fraction: float  # of its image that the untrained network gives
    border_px: int  # at a patch's border that the loss leaves out: there the network sees zeros


SHIPPED = Recipe(50, 50, 2, 40, "truth", 12, 25, 0.0, 0.48, 0.25, 8)
THESIS = Recipe(50, 0, 1, 750, "stack", 64, 50, 0.5, 0.0, 0.0, 0)


# --- photographs
# -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Photograph:
    """One photograph of one palm or finger, with its truth."""

    # (h, w, 8) float16: image red, green, blue; direct red, green, blue; enhanced image, enhanced
    # direct; image and direct light in units of the image's exposure level, zero outside
    pixels: np.ndarray
    corners: np.ndarray  # (n, 2) row and column of the patches' upper left corners
    facts: dict[str, Any]  # pixel size, light, optics


def photographs(kind, index, labels, *, patches=1, views=1, grey="srgb"):
    """All views of the ``palm`` or ``finger`` of that number; `grey`: light that the contrast is
    enhanced in."""
    surface = drawn_surface(kind, index)
    seeds = _root(kind, index).spawn(1 + views)[1:]
    return [_photograph(surface, seed, labels, patches, grey) for seed in seeds]


def drawn_surface(kind, index):
    """The palm or finger itself."""
    rng = np.random.default_rng(_root(kind, index).spawn(1)[0])
    if kind == "palm":
        camera = Camera(px_per_mm=1000.0 / _pitch_um(rng, PITCH_UM[0]), image_size=IMAGE_SIZE)
        return palm_surface(draw_palm(int(rng.integers(2**31))), camera)
    camera = default_rig(1000.0 / _pitch_um(rng, FINGER_PITCH_UM) / FULL_PX_PER_MM).camera
    finger = draw_finger(int(rng.integers(2**31)))
    return finger_surface(finger, PoseRanges().draw(rng, camera), camera, workers=1)


def _root(kind, index):
    return np.random.SeedSequence([0, 0x7A, kind == "finger", index])


def _pitch_um(rng, low):
    return float(low * (PITCH_UM[1] / low) ** rng.random())


def _photograph(surface, seed, labels, patches, grey):
    draw_seed, noise_seed, corner_seed = seed.spawn(3)
    rng = np.random.default_rng(draw_seed)
    skin = SKIN.draw(rng)
    low, high = LED_RADIUS_MM
    radius = low + (high - low) * rng.random()
    azimuth = 2.0 * np.pi * rng.random()
    place = (
        float(radius * np.cos(azimuth)),
        float(radius * np.sin(azimuth)),
        surface.camera.height_mm,
    )
    led = Led("white", position_mm=place)
    sensor = SensorSettings(
        exposure=float(rng.uniform(0.4, 0.9)), bits=8 if rng.random() < 0.5 else 16
    )
    light = separate_truth(surface, led, skin, check_mm=CHECK_MM, phases="centred")
    if labels == "stack":
        light = replace(light, direct=_through_patterns(surface, led, skin, light))
    pixels = _record(light, surface, sensor, noise_seed, grey)
    corners = _patch_corners(
        surface.mask[light.window], patches, np.random.default_rng(corner_seed)
    )
    facts = {
        "pitch_um": 1000.0 * surface.camera.pitch_mm,
        "led_mm": place,
        "skin": skin,
        "exposure": sensor.exposure,
        "bits": sensor.bits,
    }
    return Photograph(pixels, corners, facts)


def _through_patterns(surface, led, skin, light):
    """Direct light (3, h, w) from 25 shifted checkerboards, L_max - L_min of the noise-free
    images."""
    stack = checkerboard_stack(surface, led, skin, Checkerboard(CHECK_MM, steps=5)).transpose(
        0, 2, 3, 1
    )
    mask = surface.mask[light.window]
    # radiance in the rig's units knows no clipping; the black outside the mask is not a fault
    separated = checkerboard(stack, alpha=0.5, dark=0.0, mask=mask, clip_level=None)
    direct = np.where(mask, separated.direct.transpose(2, 0, 1), np.float32(0.0))
    return np.asarray(np.minimum(direct, light.white), dtype=np.float32)


def _record(light, surface, sensor, seed, grey_light):
    """Photograph the white light, noise and clipping included, and bring image and direct light to
    one scale."""
    mask, px_per_mm = surface.mask[light.window], surface.camera.px_per_mm
    brightest = np.percentile((light.white - light.glare)[:, mask].max(axis=0), 99.9)
    exposure = np.float32(sensor.exposure / max(float(brightest), 1e-12))
    clean = (light.white * exposure * mask).transpose(1, 2, 0)
    stored = record(clean, "white", seed, sensor, px_per_mm / FULL_PX_PER_MM)
    image = stored.astype(np.float32) / np.float32(2**sensor.bits - 1) * mask[..., None]
    # what clips is direct light: the truth of the clipped photograph is the clipped light less the
    # global light
    clipped = np.minimum(clean, np.float32(1.0))
    kept = np.maximum(
        (light.direct * exposure * mask).transpose(1, 2, 0) - (clean - clipped), np.float32(0.0)
    )
    grey, grey_clean, grey_kept = (
        np.asarray(part @ GREY_WEIGHTS) for part in (image, clipped, kept)
    )
    enhanced = clahe(grey, px_per_mm, ClaheSettings(grey=grey_light), mask=mask)
    fraction = np.clip(grey_kept / np.maximum(grey_clean, np.float32(1e-6)), 0.0, 1.0)
    level = np.float32(exposure_level(image.transpose(2, 0, 1)))
    enhanced_level = np.float32(exposure_level(enhanced))
    parts = [image / level, kept / level]
    parts += [(part / enhanced_level)[..., None] for part in (enhanced, enhanced * fraction)]
    return np.concatenate(parts, axis=2).astype(np.float16)


def _patch_corners(mask, count, rng):
    """Draw the upper left corners (n, 2) of patches that hold skin."""
    side = PATCH_PX
    summed = np.pad(np.cumsum(np.cumsum(mask, axis=0, dtype=np.int64), axis=1), ((1, 0), (1, 0)))
    inside = (
        summed[side:, side:]
        - summed[:-side, side:]
        - summed[side:, :-side]
        + summed[:-side, :-side]
    )
    chosen = rng.choice(np.flatnonzero(inside > MIN_SKIN * side * side), count)
    return np.stack(np.divmod(chosen, inside.shape[1]), axis=1).astype(np.int32)


# --- patches
# -------------------------------------------------------------------------------------------------


class Patches:
    """All patches of photographs ((pixels, corners) each), in an order that can be shuffled."""

    def __init__(self, photographed):
        self.pixels = [pixels for pixels, _ in photographed]
        self._owner = np.concatenate(
            [np.full(len(corners), k) for k, (_, corners) in enumerate(photographed)]
        )
        self._corners = np.concatenate([corners for _, corners in photographed])

    def __len__(self):
        return len(self._owner)

    def shuffled(self, epoch):
        """The batches of one epoch: every patch once, augmented; the last, smaller batch too."""
        rng = np.random.default_rng(np.random.SeedSequence([0, 0xBA, epoch]))
        order = rng.permutation(len(self))
        for first in range(0, len(order), BATCH_SIZE):
            chosen = order[first : first + BATCH_SIZE]
            enhanced = rng.random(len(chosen)) < ENHANCED_FRACTION
            yield _stacked([self._augmented(k, rng) for k in chosen], enhanced)

    def fixed(self, enhanced):
        """All patches in their order as they are, linear or enhanced."""
        for first in range(0, len(self), BATCH_SIZE):
            pieces = [
                self._piece(k, *self._corners[k])
                for k in range(first, min(first + BATCH_SIZE, len(self)))
            ]
            yield _stacked(pieces, np.full(len(pieces), enhanced))

    def _piece(self, k, row, column):
        pixels = self.pixels[self._owner[k]]
        return np.asarray(
            pixels[row : row + PATCH_PX, column : column + PATCH_PX], dtype=np.float32
        )

    def _augmented(self, k, rng):
        """(72, 72, 8) patch k, shifted, turned and mirrored."""
        pixels = self.pixels[self._owner[k]]
        shift = rng.integers(-MAX_SHIFT_PX, MAX_SHIFT_PX + 1, 2)
        height, width = pixels.shape[:2]
        row, column = np.clip(self._corners[k] + shift, 0, (height - PATCH_PX, width - PATCH_PX))
        if rng.random() < TURNED_FRACTION:
            piece = _turned(pixels, (int(row), int(column)), 360.0 * rng.random())
        else:
            piece = np.rot90(self._piece(k, row, column), int(rng.integers(4)))
        return piece[:, ::-1] if rng.random() < 0.5 else piece


def _turned(pixels, corner, angle_deg):
    """The patch at `corner`, turned about its middle; black where the photograph ends."""
    around = int(np.ceil(0.5 * (np.sqrt(2.0) - 1.0) * PATCH_PX)) + 2
    window, padding = [], []
    for start, length in zip(corner, pixels.shape[:2], strict=True):
        low, high = start - around, start + PATCH_PX + around
        window.append(slice(max(low, 0), min(high, length)))
        padding.append((max(-low, 0), max(high - length, 0)))
    source = np.pad(np.asarray(pixels[tuple(window)], dtype=np.float32), (*padding, (0, 0)))
    middle = 0.5 * (source.shape[0] - 1)
    matrix = cv2.getRotationMatrix2D((middle, middle), angle_deg, 1.0)
    matrix[:, 2] -= around
    # OpenCV turns four channels at a time
    halves = map(np.ascontiguousarray, (source[..., :4], source[..., 4:]))
    sides = (PATCH_PX, PATCH_PX)
    return np.concatenate(
        [cv2.warpAffine(half, matrix, sides, flags=cv2.INTER_LINEAR) for half in halves], 2
    )


def _stacked(pieces, enhanced):
    """Input and target (B, 3, 72, 72) of each piece: linear colours, or three times the enhanced
    grey."""
    inputs, targets = [], []
    for piece, grey in zip(pieces, enhanced, strict=True):
        image, direct = (
            (piece[..., [6, 6, 6]], piece[..., [7, 7, 7]])
            if grey
            else (piece[..., :3], piece[..., 3:6])
        )
        inputs.append(image.transpose(2, 0, 1))
        targets.append(direct.transpose(2, 0, 1))
    return np.stack(inputs), np.stack(targets)


# --- the training
# -------------------------------------------------------------------------------------------------


def shoot(recipe, kind, index):
    """Pixels and corners of every view; every second subject is equalised in linear light."""
    arrays = []
    taken = photographs(
        kind,
        index,
        recipe.labels,
        patches=recipe.patches,
        views=recipe.views,
        grey="linear" if index % 2 else "srgb",
    )
    for photograph in taken:
        pixels = photograph.pixels.astype(np.float32)
        # divided by the local level, as the network is given it
        level = local_level(np.ascontiguousarray(pixels[..., :3].transpose(2, 0, 1)))[..., None]
        enhanced_level = local_level(np.ascontiguousarray(pixels[..., 6]))[..., None]
        divided = np.concatenate(
            [pixels[..., :6] / level, pixels[..., 6:] / enhanced_level], axis=2
        )
        arrays += [divided.astype(np.float16), photograph.corners]
    return arrays


def train(out, recipe, command, *, held_out=HELD_OUT_COUNT, threads=2, device="cpu"):
    """Photograph palms and fingers, train, and write `direct.onnx` into `out`."""
    import torch

    from loop import ThesisUNet, Training, make_data, report, write_network

    counts = {"palm": recipe.palms, "finger": recipe.fingers}
    subjects = [(kind, index) for kind, count in counts.items() for index in range(count)]
    subjects += [(kind, HELD_OUT_FROM + index) for kind in counts for index in range(held_out)]
    data = make_data(out, subjects, partial(shoot, recipe), threads)
    views = [
        (n, pair)
        for (_, n), photographs in data.items()
        for pair in zip(photographs[::2], photographs[1::2], strict=True)
    ]
    seen = Patches([pair for number, pair in views if number < HELD_OUT_FROM])
    judged = Patches([pair for number, pair in views if number >= HELD_OUT_FROM])
    training = Training(
        lambda: ThesisUNet(recipe.width, recipe.dropout, recipe.start_fraction),
        seed=0,
        threads=threads,
        device=device,
        mixed=True,
    )
    rim = slice(recipe.border_px, -recipe.border_px or None)

    def loss_of(batch):
        inputs, targets = (training.tensor(part) for part in batch)
        error = (training.forward(inputs) - targets)[:, :, rim, rim]
        return (error * error).mean()

    def psnr_db(enhanced):
        """PSNR over held-out patches, for a peak of one: the local level."""
        training.network.eval()
        with torch.no_grad():
            squares = [(float(loss_of(batch)), len(batch[0])) for batch in judged.fixed(enhanced)]
        mean = sum(square * count for square, count in squares) / len(judged)
        return -10.0 * math.log10(max(mean, 1e-12))

    rows = []
    for epoch in range(recipe.epochs):
        training.network.train()
        losses = []
        for number, batch in enumerate(seen.shuffled(epoch)):
            done = (epoch + number / math.ceil(len(seen) / BATCH_SIZE)) / recipe.epochs
            loss = loss_of(batch)
            training.step(loss, LEARNING_RATE * learning_factor(done, recipe.decay))
            losses.append(float(loss.detach()))
        figures = {"psnr_linear_db": psnr_db(False), "psnr_enhanced_db": psnr_db(True)}
        report(out, rows, {"epoch": epoch + 1, "loss": float(np.mean(losses)), **figures})
    facts = {
        "command": command,
        "training": vars(recipe),
        "metrics": {
            "held_out": f"{held_out} palms and {held_out} fingers not trained on, local level 1",
            **figures,
        },
        "architecture": f"U-Net of the thesis (figure 3.19), depth 3, width {recipe.width}",
    }
    what = (
        "direct light of skin: a photograph, or its CLAHE-enhanced grey image three times, to its"
        " direct part"
    )
    write_network(out, "direct", training, what, (3, 3), 3, facts)


def learning_factor(done, decay):
    """Learning rate, relative to its start, when a fraction is `done`: it falls over the last
    `decay` (a cosine)."""
    if done <= 1 - decay:
        return 1.0
    return 0.5 * (1.0 + math.cos(math.pi * min((done - 1 + decay) / decay, 1.0)))


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, required=True, help="folder; what it holds is not photographed again"
    )
    parser.add_argument(
        "--thesis", action="store_true", help="the thesis's recipe instead of the shipped network's"
    )
    parser.add_argument(
        "--threads", type=int, default=2, help="of torch, and processes that photograph"
    )
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    options = parser.parse_args()
    command = "python training/separation.py --out DIR" + " --thesis" * options.thesis
    recipe = THESIS if options.thesis else SHIPPED
    train(options.out, recipe, command, threads=options.threads, device=options.device)


if __name__ == "__main__":
    main()
