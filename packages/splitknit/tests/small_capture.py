"""A small simulated capture on disk, and copies of it to damage."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.io.images import encode_image, read_image

Pixels = NDArray[Any]


def copy_of(folder: Path, target: Path) -> Path:
    """Copy a capture folder without its truth, which no bad image needs."""
    shutil.copytree(folder, target, ignore=shutil.ignore_patterns("truth.npz"))
    edit(target / "capture.json", lambda document: document.pop("truth", None))
    return target


def edit(file: Path, change: Callable[[Any], object]) -> None:
    """Change a JSON file in place."""
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))


def repaint(file: Path, change: Callable[[Pixels], Pixels]) -> None:
    """Change an image file in place: (H, W, C) integers in, the same out."""
    pixels = read_image(file)
    file.write_bytes(encode_image(np.ascontiguousarray(change(pixels)), file.suffix))
