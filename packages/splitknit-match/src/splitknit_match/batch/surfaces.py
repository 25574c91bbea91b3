"""A surface in a file: exactly what matching needs of a reconstruction, and nothing that follows
from it, 8 bytes a pixel of its mask under parallel rays.

Nothing is rounded: local binary patterns compare neighbours, and a step of 0.05 um changed the
features of the relief by 7 %.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splitknit.errors import refusing
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.io.npz import read_npz, write_npz
from splitknit.model import BoolArray, FloatArray
from splitknit.reconstruction import Surface


def write_surface(path: Path, surface: Surface, height_mm: FloatArray) -> None:
    """Write a surface whose knitted height (H, W) is `height_mm`, as ``.npz``."""
    mask = surface.mask
    height, shape, ridge = (
        field[mask] for field in (height_mm, surface.shape_mm, surface.ridge_mm)
    )
    arrays = {
        "mask": mask,
        "pitch_mm": surface.pitch_mm,
        "input_from_upright": surface.input_from_upright,
        "upright_size": surface.upright_size,
        "whole": surface.whole,
        "height_mm": height,
        "shape_mm": shape,
    }
    if not np.array_equal(height - shape, ridge):
        arrays["ridge_mm"] = ridge
    if not np.array_equal(_normals(height_mm, mask, surface.pitch_mm), surface.normals):
        arrays["normals"] = surface.normals[mask]
    write_npz(path, arrays)


def read_surface(path: Path) -> Surface:
    """Read what :func:`write_surface` wrote, to the last bit. Raises BadInput if it is damaged."""
    arrays = read_npz(path)
    with refusing(f"'{path}' is damaged; remove it and the table of its capture, and run again."):
        mask = arrays["mask"]
        height, shape = arrays["height_mm"], arrays["shape_mm"]
        pitch_mm = float(arrays["pitch_mm"])
        if "normals" in arrays:
            normals = np.zeros((*mask.shape, 3), dtype=np.float32)
            normals[mask] = arrays["normals"]
        else:
            normals = _normals(_placed(height, mask), mask, pitch_mm)
        rows, columns = arrays["upright_size"].tolist()
        return Surface(
            ridge_mm=_placed(arrays.get("ridge_mm", height - shape), mask),
            shape_mm=_placed(shape, mask),
            normals=normals,
            mask=mask,
            pitch_mm=pitch_mm,
            input_from_upright=arrays["input_from_upright"],
            upright_size=(rows, columns),
            whole=bool(arrays["whole"]),
        )


def _normals(height_mm: FloatArray, mask: BoolArray, pitch_mm: float) -> FloatArray:
    """Normals (H, W, 3) of a surface under parallel rays, zero outside the mask."""
    seen = np.where(mask, height_mm, np.nan).astype(np.float32)
    normals = normals_from_gradients(*height_gradients(seen, pitch_mm)) * mask[..., None]
    return np.nan_to_num(normals, nan=0.0)


def _placed(values: FloatArray, mask: BoolArray) -> FloatArray:
    whole = np.full(mask.shape, np.nan, dtype=np.float32)
    whole[mask] = values
    return whole
