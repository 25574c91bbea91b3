"""Photographs of a scene under patterns, as linear light."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splitknit.errors import require
from splitknit.io.content import mask_from_image
from splitknit.io.images import StackReader, image_size
from splitknit.io.photograph_files import natural_order
from splitknit.model import BoolArray, FloatArray
from splitknit.observation.stored import decode_table, linear_image

ESTIMATE = "estimate"
_NOT_LIT = ("black", "white", "mask")
_SUFFIXES = {".png", ".tif", ".tiff", ".jpg", ".jpeg"}


@dataclass(frozen=True, slots=True, eq=False)
class PatternLight:
    """The images of a folder as linear light without the black level."""

    names: tuple[str, ...]  # of the images
    stack: FloatArray  # (N, H, W) or (N, H, W, 3)
    patterns: FloatArray | None  # (N, H, W) given states
    mask: BoolArray | None  # (H, W)
    clip_level: float  # value at which the files clip
    hashes: dict[str, str]  # SHA-256 by name


def lit_images(folder: Path) -> list[Path]:
    """The images of a folder but for ``black``, ``white`` and ``mask``."""
    return [file for file in _images_in(folder) if file.stem.lower() not in _NOT_LIT]


def read_light(folder: Path, states: Path | None = None, encoding: str = "linear") -> PatternLight:
    """Read all images of a folder, and of a folder of `states`, in the order of their names
    (``a_2`` before ``a_10``), ``black`` and ``mask`` apart and without ``white``; hashes go by
    names relative to the folder, wherever that lies.
    """
    for place in (folder, *([] if states is None else [states])):
        kind = "images" if place == folder else f"patterns (nor the word '{ESTIMATE}')"
        require(place.is_dir(), f"'{place}' is not a folder of {kind}.")
    files = _images_in(folder)
    roles = {file.stem.lower(): file for file in files if file.stem.lower() in ("black", "mask")}
    images = lit_images(folder)
    require(
        len(images) > 0, f"'{folder}' holds no PNG, TIFF or JPEG images; name the folder that does."
    )
    with StackReader() as reader:
        size, by = image_size(images[0]), str(images[0])
        pixels = reader.start(images, size, by)
        singles = {role: reader.start([file], size, by)[0] for role, file in roles.items()}
        state_pixels = None if states is None else reader.start(_images_in(states), size, by)
        hashes = reader.finish()
    channels = pixels.shape[3]

    black = np.zeros(1, dtype=np.float32)
    if "black" in singles:
        light = linear_image(singles["black"], encoding)
        black = light if light.shape[2] == channels else light.mean(axis=-1, keepdims=True)
    stack = np.empty(pixels.shape, dtype=np.float32)
    for k, image in enumerate(pixels):
        stack[k] = linear_image(image, encoding) - black
    table = decode_table(pixels.dtype, encoding)
    some = 0 if channels == 1 else slice(None)
    patterns = None
    if state_pixels is not None:
        patterns = np.stack([linear_image(image, "linear").mean(axis=-1) for image in state_pixels])
    named = {Path(name): value for name, value in hashes.items()}
    return PatternLight(
        tuple(file.name for file in images),
        stack[..., some],
        patterns,
        mask_from_image(singles["mask"], str(roles["mask"])) if "mask" in singles else None,
        float(table[int(0.994 * (table.size - 1))]) - float(np.median(black)),
        {
            (p.relative_to(folder).as_posix() if p.is_relative_to(folder) else p.name): v
            for p, v in named.items()
        },
    )


def _images_in(folder: Path) -> list[Path]:
    files = [
        file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file()
    ]
    return sorted(files, key=lambda file: (natural_order(file.stem), file.name))
