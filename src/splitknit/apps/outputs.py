"""A reconstruction as files, all or none of them.

Fields stay on the input's pixel grid; the mesh is turned upright by its coordinates; pictures for people and the print
are upright (``docs/conventions.md``, frames of the results).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.apps.figures import LONGEST_PX, render_views
from splitknit.apps.pictures import normal_colours, upright_frame, upright_turn
from splitknit.apps.report import Truth, make_report
from splitknit.io import (
    atomic_file,
    atomic_folder,
    canonical_json,
    provenance,
    settings_hash,
    surface_mesh,
    write_height_tiff,
    write_npz,
    write_ply,
    write_print_png,
)
from splitknit.io.prints import provenance_texts
from splitknit.io.provenance import JsonValue
from splitknit.model import Capture, FloatArray, Reconstruction
from splitknit.prints.ridges import surface_print

PRINT_PPI = 500.0
FILES = (
    "phalange.ply",
    "height.tiff",
    "height.npz",
    "normals.png",
    "albedo.png",
    "print.png",
    "preview.png",
    "report.html",
    "report.json",
)
_Origin = dict[str, JsonValue]


def write_results(
    result: Reconstruction,
    capture: Capture,
    folder: str | os.PathLike[str],
    truth: Truth | None = None,
    others: Sequence[Reconstruction] = (),
) -> dict[str, Any]:
    """Write all files of a reconstruction into `folder` and return the facts of ``report.json``.

    Parameters
    ----------
    result : Reconstruction
    capture : Capture
        What it was made from.
    folder : path
        Appears complete or not at all; an earlier result in it is replaced.
    truth : mapping, optional
        A simulator's arrays, compared in the report.
    others : sequence of Reconstruction
        Further presets, compared beside `result`.

    Raises
    ------
    BadInput
        If the folder holds files of others or cannot be written.
    """
    with atomic_folder(folder) as target:
        return write_files(result, capture, target, truth, others)


def write_files(
    result: Reconstruction,
    capture: Capture,
    target: Path,
    truth: Truth | None = None,
    others: Sequence[Reconstruction] = (),
) -> dict[str, Any]:
    """Write the files of :func:`write_results` into an existing folder."""
    origin = provenance({"preset": result.preset, **result.settings}, result.hashes)
    prints = surface_print(result, PRINT_PPI)
    tasks: list[Callable[[], object]] = [
        partial(_write_pages, target, result, capture, prints, origin, truth, others),
        partial(_write_arrays, target / "height.npz", result, origin),
        partial(_write_mesh, target / "phalange.ply", result, origin),
        partial(_write_normals, target / "normals.png", result, origin),
        partial(_write_albedo, target / "albedo.png", result, origin),
        partial(write_height_tiff, target / "height.tiff", result.height_mm, result.pitch_mm, origin),
        partial(write_print_png, target / "print.png", prints, PRINT_PPI, provenance_texts(origin)),
    ]
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        jobs = [pool.submit(task) for task in tasks]
        done = [job.result() for job in jobs]
    facts: dict[str, Any] = done[0]  # type: ignore[assignment]
    return facts


def _write_arrays(path: Path, result: Reconstruction, origin: _Origin) -> None:
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


def upright_mesh(
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


def _write_mesh(path: Path, result: Reconstruction, origin: _Origin) -> None:
    vertices, normals, intensity, faces = upright_mesh(result)
    comments = [
        f"splitknit {origin['version']}, preset {result.preset}",
        "unit mm; x right, y to the fingertip, z to the camera",
        f"settings_sha256 {origin['settings_sha256']}",
        f"inputs_sha256 {settings_hash(origin['inputs'])}",
    ]
    write_ply(path, vertices, normals, intensity, faces, comments)


def _write_normals(path: Path, result: Reconstruction, origin: _Origin) -> None:
    picture = np.zeros((*result.mask.shape, 3), dtype=np.uint8)
    box = _box(result)
    picture[box] = normal_colours(result.normals[box]) * result.mask[box][..., None]
    _write_png(path, picture, origin)


def _write_albedo(path: Path, result: Reconstruction, origin: _Origin) -> None:
    _write_png(path, _albedo_bytes(result), origin)


def _write_pages(  # noqa: PLR0917
    target: Path,
    result: Reconstruction,
    capture: Capture,
    prints: NDArray[np.uint8],
    origin: _Origin,
    truth: Truth | None,
    others: Sequence[Reconstruction],
) -> Mapping[str, Any]:
    """Write what people look at: the preview and the report."""
    views = render_views(result, upright_frame(result, LONGEST_PX))
    _write_png(target / "preview.png", _side_by_side(views.above, views.left), origin)
    report = make_report(result, capture, prints, views, truth=truth, others=others, files=FILES)
    write_report(target, report.html, report.facts)
    return report.facts


def _side_by_side(*panels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, paper = max(panel.shape[0] for panel in panels), int(panels[0][0, 0, 0])
    padded = []
    for panel in panels:
        missing = height - panel.shape[0]
        edges = ((missing // 2, missing - missing // 2), (0, 0), (0, 0))
        padded.append(np.pad(panel, edges, constant_values=paper))
    return np.hstack(padded)


def write_report(target: Path, html: str, facts: Mapping[str, Any]) -> None:
    """Write ``report.html`` and ``report.json``."""
    import json  # noqa: PLC0415

    with atomic_file(target / "report.html") as stream:
        stream.write(html.encode("utf-8"))
    with atomic_file(target / "report.json") as stream:
        stream.write((json.dumps(facts, indent=1, allow_nan=False) + "\n").encode("utf-8"))


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


def _write_png(path: Path, picture: NDArray[np.uint8], origin: _Origin) -> None:
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
