"""The images of a pattern folder as linear light."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splitknit.apps.pattern_folder import PatternFolder
from splitknit.imaging import decode_table, linear_image
from splitknit.io import image_size
from splitknit.io.content import mask_from_image
from splitknit.io.images import StackReader
from splitknit.model import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PatternLight:
    """The images of a folder as linear light without the black level."""

    stack: FloatArray
    """(N, H, W) or (N, H, W, 3)."""
    white: FloatArray | None
    """(H, W) or (H, W, 3)."""
    patterns: FloatArray | None
    """(N, H, W) given states."""
    mask: BoolArray | None
    """(H, W)."""
    clip_level: float
    """Value at which the files clip."""
    hashes: dict[str, str]
    """SHA-256 by name."""


def read_light(plan: PatternFolder, folder: Path) -> PatternLight:
    """Read all files of a plan; hashes go by names relative to the folder, wherever that lies."""
    images = list(plan.images)
    states = list(plan.patterns) if isinstance(plan.patterns, tuple) else []
    with StackReader() as reader:
        size, by = image_size(images[0]), str(images[0])
        pixels = reader.start(images, size, by)
        singles = {
            role: reader.start([file], size, by)[0]
            for role, file in (("black", plan.black), ("white", plan.white), ("mask", plan.mask))
            if file is not None
        }
        state_pixels = reader.start(states, size, by) if states else None
        hashes = reader.finish()
    shape: tuple[int, ...] = pixels.shape[1:]
    black = _as(linear_image(singles["black"], plan.encoding), shape) if "black" in singles else np.float32(0.0)
    stack = np.empty(pixels.shape, dtype=np.float32)
    for k, image in enumerate(pixels):
        stack[k] = linear_image(image, plan.encoding) - black
    white = None
    if "white" in singles:
        white = _as(linear_image(singles["white"], plan.encoding), shape) - black
    table = decode_table(pixels.dtype, plan.encoding)
    grey = shape[2] == 1
    return PatternLight(
        stack[..., 0] if grey else stack,
        white if white is None or not grey else white[..., 0],
        None
        if state_pixels is None
        else np.stack([linear_image(image, "linear").mean(axis=-1) for image in state_pixels]),
        mask_from_image(singles["mask"], str(plan.mask)) if "mask" in singles else None,
        float(table[int(0.994 * (table.size - 1))]) - float(np.median(black)),
        {_short(Path(name), folder): value for name, value in hashes.items()},
    )


def _short(file: Path, folder: Path) -> str:
    return file.relative_to(folder).as_posix() if file.is_relative_to(folder) else file.name


def _as(light: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """`light` (H, W, C) with the number of channels of `shape`."""
    if light.shape[2] == shape[2]:
        return light
    return np.asarray(np.broadcast_to(light.mean(axis=-1, keepdims=True), shape))
