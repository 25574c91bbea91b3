"""What prints are made from: a reconstruction, or a capture and what is needed of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, naming, require
from splitknit.imaging import has_colour, linear_channels
from splitknit.io import file_hash, read_capture, read_npz
from splitknit.matching.inputs import LARGEST_MM
from splitknit.model import BoolArray, Capture, FloatArray, Progress, Reconstruction, no_progress
from splitknit.pipeline import preset_settings, reconstruct
from splitknit.recipe.finger import find_finger
from splitknit.recipe.stopwatch import Stopwatch

NEEDED = ("height_mm", "ridge_mm", "shape_mm", "mask", "pitch_mm", "input_from_upright", "upright_size")


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A finger on its input's pixel grid."""

    kind: str
    """``result`` or ``capture``."""
    mask: BoolArray
    pitch_mm: float
    input_from_upright: NDArray[np.float64]
    upright_size: tuple[int, int]
    height_mm: FloatArray | None = None
    """(H, W); None where only the photograph was asked for."""
    ridge_mm: FloatArray | None = None
    shape_mm: FloatArray | None = None
    x_mm: FloatArray | None = None
    y_mm: FloatArray | None = None
    photo: FloatArray | None = None
    """(H, W) light of the skin, ridges bright; captures only."""
    points_mm: FloatArray | None = None
    """(H, W, 3) of the skin, upright, NaN where not known: given where the pixels are no picture's but a chart's."""
    preset: str | None = None
    hashes: Mapping[str, str] = field(default_factory=dict)
    subject: Mapping[str, Any] = field(default_factory=dict)


def read_source(
    path: Path, *, photo: bool, surface: bool, preset: str = "metric", progress: Progress = no_progress
) -> Source:
    """Read a result folder (or its ``height.npz``), or a capture folder, which is reconstructed where `surface` asks.

    Parameters
    ----------
    path : path
    photo : whether the photograph is needed
    surface : whether the surface is needed

    Raises
    ------
    BadInput
        If it is neither, is damaged, has no scale, or holds no photograph where one is needed.
    """
    progress("reading", 0.05)
    try:
        found, folder = path.exists(), path.is_dir()
    except (OSError, ValueError):
        found, folder = False, False
    require(found, f"there is no '{path}'; name a capture folder or a result folder.")
    if folder and (path / "capture.json").is_file():
        return naming(path, lambda: _of_capture(path, photo, surface, preset, progress))
    result = path / "height.npz" if folder else path
    require(
        result.is_file() and result.suffix.lower() == ".npz",
        f"'{path}' is neither a capture (capture.json) nor a result (height.npz); name one of them.",
    )
    require(
        not photo,
        f"'{path}' is a result, which holds no photograph of the finger; name the capture folder for --method photo.",
    )
    return _of_result(result)


def source_of(result: Reconstruction) -> Source:
    """What prints need of a reconstruction in memory."""
    return Source(
        "result", result.mask, result.pitch_mm, result.input_from_upright, result.upright_size, result.height_mm,
        result.ridge_mm, result.shape_mm, result.x_mm, result.y_mm, preset=result.preset, hashes=result.hashes,
    )  # fmt: skip


def _of_result(path: Path) -> Source:
    arrays = read_npz(path, (*NEEDED, "x_mm", "y_mm"))
    for name in NEEDED:
        remedy = "it has no scale, so calibrate the camera and" if name == "pitch_mm" else "please"
        require(name in arrays, f"{path} holds no '{name}': {remedy} reconstruct the capture again.")
    shape = arrays["mask"].shape
    fields = [name for name in ("height_mm", "ridge_mm", "shape_mm", "x_mm", "y_mm") if name in arrays]
    good = len(shape) == 2 and all(arrays[name].shape == shape and arrays[name].dtype.kind == "f" for name in fields)
    good = good and arrays["input_from_upright"].shape == (3, 3) and arrays["upright_size"].shape == (2,)
    good = good and arrays["pitch_mm"].shape == () and arrays["pitch_mm"].dtype.kind in "fiu"
    require(good, f"{path} holds arrays of other shapes than a result's; reconstruct the capture again.")
    matrix = arrays["input_from_upright"].astype(np.float64)
    good = arrays["upright_size"].dtype.kind in "iu"
    rows, columns = arrays["upright_size"].tolist() if good else (0, 0)
    usable = bool(np.isfinite(matrix).all()) and abs(float(np.linalg.det(matrix[:2, :2]))) > 1e-9
    usable = usable and 0 < rows <= 20_000 and 0 < columns <= 20_000 and rows * columns <= 100_000_000
    require(usable, f"{path}: 'input_from_upright' or 'upright_size' cannot be used; reconstruct the capture again.")
    pitch = float(arrays["pitch_mm"])
    require(
        0 < pitch * max(rows, columns) <= LARGEST_MM,
        f"{path} has no scale (pitch_mm is {pitch}): calibrate the camera and reconstruct the capture again.",
    )
    require(bool(arrays["mask"].any()), f"{path}: the mask is empty; reconstruct the capture again.")
    parts: dict[str, Any] = {name: arrays[name].astype(np.float32, copy=False) for name in fields}
    return Source(
        "result",
        arrays["mask"].astype(np.bool_),
        pitch,
        matrix,
        (rows, columns),
        hashes={path.name: file_hash(path)},
        **parts,
    )


def _of_capture(path: Path, photo: bool, surface: bool, preset: str, progress: Progress) -> Source:
    capture = read_capture(path)
    light = _photograph(capture) if photo else None
    if surface:
        result = reconstruct(capture, preset, progress=lambda stage, fraction: progress(stage, 0.1 + 0.6 * fraction))
        return replace(
            source_of(result),
            kind="capture",
            photo=light,
            preset=preset,
            hashes=capture.hashes,
            subject=capture.subject,
        )
    if "white" not in capture.bands:
        raise BadInput("the capture has no band 'white', in which fingers are photographed.")
    finger = find_finger(capture, preset_settings(preset), Stopwatch(None))
    return Source(
        "capture", finger.mask, capture.rig.camera.pitch_mm, finger.upright.input_from_upright, finger.upright.size,
        photo=light, hashes=capture.hashes, subject=capture.subject,
    )  # fmt: skip


def _photograph(capture: Capture) -> FloatArray:
    """(H, W) mean of the white images; of colours the blue one, which enters the skin least deeply."""
    require("white" in capture.bands, "the capture has no band 'white', in which fingers are photographed.")
    band = capture.bands["white"]
    channel = "blue" if has_colour(band) else "grey"
    return np.asarray(linear_channels(band, capture.encoding, [channel])[0].mean(axis=0), dtype=np.float32)
