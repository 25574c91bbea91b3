"""The fields of a reconstruction as files.

Fields stay on the input's pixel grid; the mesh is turned upright by its coordinates (``docs/conventions.md``, frames of
the results).
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.io import (
    atomic_file,
    canonical_json,
    settings_hash,
    surface_mesh,
    write_npz,
    write_ply,
)
from splitknit.io.pictures import normal_colours, upright_turn
from splitknit.io.prints import provenance_texts
from splitknit.io.provenance import JsonValue
from splitknit.model import FloatArray, Reconstruction

Origin = dict[str, JsonValue]


def write_arrays(path: Path, result: Reconstruction, origin: Origin) -> None:
    """Write ``height.npz``: all fields on the input's pixel grid."""
    arrays: dict[str, Any] = {
        "height_mm": result.height_mm,
        "ridge_mm": result.ridge_mm,
        "shape_mm": result.shape_mm,
        "mask": result.mask,
        "pitch_mm": np.float64(result.pitch_mm),
        "normals": result.normals,
        "input_from_upright": result.input_from_upright,
        "upright_size": np.asarray(result.upright_size, dtype=np.int64),
    }
    for name in ("x_mm", "y_mm"):
        if getattr(result, name) is not None:
            arrays[name] = getattr(result, name)
    if result.uncertainty_um is not None:
        arrays["uncertainty_um"] = result.uncertainty_um
    arrays["provenance"] = np.array(canonical_json(origin))
    write_npz(path, arrays)


def _upright_mesh(
    result: Reconstruction,
) -> tuple[FloatArray, FloatArray, NDArray[np.uint8], NDArray[np.int32]]:
    """Return vertices (N, 3) in mm, normals (N, 3), intensity (N,) and faces (M, 3) of the surface, tip along +y.

    One vertex for each pixel of the mask, in the order of the rows; the grid is not resampled.
    """
    rows, columns = _box(result)
    height, width = result.mask.shape
    turn = upright_turn(result)
    if result.x_mm is not None and result.y_mm is not None:
        x, y = result.x_mm[rows, columns], result.y_mm[rows, columns]
    else:
        x = ((np.arange(width)[columns] - (width - 1) / 2) * result.pitch_mm)[None, :]
        y = (((height - 1) / 2 - np.arange(height)[rows]) * result.pitch_mm)[:, None]
    vertices, faces, index = surface_mesh(
        (turn[0, 0] * x + turn[0, 1] * y).astype(np.float32),
        (turn[1, 0] * x + turn[1, 1] * y).astype(np.float32),
        result.height_mm[rows, columns],
        result.mask[rows, columns],
    )
    used = index >= 0
    normals = result.normals[rows, columns][used]
    nx, ny = normals[:, 0].copy(), normals[:, 1].copy()
    normals[:, 0] = np.float32(turn[0, 0]) * nx + np.float32(turn[0, 1]) * ny
    normals[:, 1] = np.float32(turn[1, 0]) * nx + np.float32(turn[1, 1]) * ny
    return vertices, normals, _albedo_bytes(result)[rows, columns][used], faces


def write_mesh(path: Path, result: Reconstruction, origin: Origin) -> None:
    """Write ``phalange.ply``: the surface in mm, tip up."""
    vertices, normals, intensity, faces = _upright_mesh(result)
    comments = [
        f"splitknit {origin['version']}, preset {result.preset}",
        "unit mm; x right, y to the fingertip, z to the camera",
        f"settings_sha256 {origin['settings_sha256']}",
        f"inputs_sha256 {settings_hash(origin['inputs'])}",
    ]
    write_ply(path, vertices, normals, intensity, faces, comments)


def write_normals(path: Path, result: Reconstruction, origin: Origin) -> None:
    """Write the normals as a colour picture on the input's pixel grid."""
    picture = np.zeros((*result.mask.shape, 3), dtype=np.uint8)
    box = _box(result)
    picture[box] = normal_colours(result.normals[box]) * result.mask[box][..., None]
    write_picture(path, picture, origin)


def write_albedo(path: Path, result: Reconstruction, origin: Origin) -> None:
    """Write the albedo as a grey picture on the input's pixel grid."""
    write_picture(path, _albedo_bytes(result), origin)


def _albedo_bytes(result: Reconstruction) -> NDArray[np.uint8]:
    """Albedo (H, W) with its 99.9th percentile at 255, 0 outside the mask."""
    box = _box(result)
    picture = np.zeros(result.mask.shape, dtype=np.uint8)
    known = result.mask[box] & np.isfinite(result.albedo[box])
    if not bool(known.any()):
        return picture
    albedo = np.where(known, result.albedo[box], np.float32(0.0))
    white = max(float(np.percentile(albedo[known][::7], 99.9)), 1e-12)
    picture[box] = np.clip(np.round(albedo * np.float32(255.0 / white)), 0, 255).astype(np.uint8)
    return picture


def _box(result: Reconstruction) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(result.mask.any(axis=1)), np.flatnonzero(result.mask.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def write_picture(path: Path, picture: NDArray[np.uint8], origin: Origin) -> None:
    """Write a grey or RGB picture as PNG, with its provenance."""
    image = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 2])
    if not done:
        raise RuntimeError(f"{path.name} could not be encoded")
    encoded = data.tobytes()
    header = 33  # signature and IHDR
    texts = b"".join(_text_chunk(keyword, text) for keyword, text in sorted(provenance_texts(origin).items()))
    with atomic_file(path) as stream:
        stream.write(encoded[:header] + texts + encoded[header:])


def _text_chunk(keyword: str, text: str) -> bytes:
    """PNG ``tEXt`` chunk (W3C PNG specification, section 11.3.4.3); `text` is ASCII."""
    body = b"tEXt" + keyword.encode("ascii") + b"\0" + text.encode("ascii")
    return struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
