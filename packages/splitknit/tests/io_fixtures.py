"""A small capture folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from io_shared import Build
from splitknit.capture import Band, Capture
from splitknit.io.capture import write_capture
from splitknit.model import Camera, Led, Rig


def ring(band: str, count: int = 4) -> list[Led]:
    angles = 2 * np.pi * np.arange(count) / count
    return [
        Led(band=band, position_mm=(50 * np.cos(a), 50 * np.sin(a), 140.0), intensity=1 + a / 9)
        for a in angles
    ]


@pytest.fixture
def build_capture() -> Build:
    """Capture of a bright disc under four white and four NIR lights."""

    def build(
        dtype: Any = np.uint8, channels: int = 3, shape: tuple[int, int] = (40, 30), **changes: Any
    ) -> Capture:
        rng = np.random.default_rng(5)
        full = int(np.iinfo(dtype).max)
        rows, columns = np.mgrid[: shape[0], : shape[1]]
        disc = (rows - shape[0] / 2) ** 2 + (columns - shape[1] / 2) ** 2 < (min(shape) * 0.4) ** 2
        pixels = rng.uniform(0.3, 0.7, (8, *shape, channels)) * disc[:, :, None] * full
        pixels = (pixels + rng.uniform(0, 0.01, pixels.shape) * full).astype(dtype)
        rig = Rig(Camera(20.0, shape), (*ring("white"), *ring("nir")), {"calibrated_at": "today"})
        bands = {
            name: Band(
                name,
                pixels[first : first + 4],
                tuple((first + k,) for k in range(4)),
                np.ones(4),
                np.zeros(4),
                files=tuple(f"{name}_{k}.png" for k in range(4)),
            )
            for name, first in (("white", 0), ("nir", 4))
        }
        return Capture(**{"rig": rig, "bands": bands, **changes})

    return build


@pytest.fixture
def folder(tmp_path, build_capture: Build) -> Path:
    """Capture folder that is in order."""
    path = tmp_path / "capture"
    write_capture(build_capture(), path)
    return path
