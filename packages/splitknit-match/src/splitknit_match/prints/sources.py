"""What prints are made from: a reconstruction, or a capture and what is needed of it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput, Capture, Reconstruction
from splitknit.errors import naming, require
from splitknit.model import BoolArray, FloatArray, Progress, no_progress


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A finger on its input's pixel grid."""

    kind: str
    """``result``, ``capture`` or ``photo``."""
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
    specular: FloatArray | None = None
    """(H, W) of polarised captures, see :class:`splitknit.model.Reconstruction`."""
    preset: str | None = None
    hashes: Mapping[str, str] = field(default_factory=dict)
    subject: Mapping[str, Any] = field(default_factory=dict)
    scale: str = ""
    """How the scale was found in the ridges, where it was."""
    quality: float | None = None
    """Of a photograph of a finger, 0 to 100."""

    @property
    def xy_mm(self) -> tuple[FloatArray, FloatArray] | None:
        """Where the surface points lie, of a perspective camera."""
        return None if self.x_mm is None or self.y_mm is None else (self.x_mm, self.y_mm)


def read_source(
    path: Path,
    *,
    photo: bool,
    surface: bool,
    preset: str = "metric",
    progress: Progress = no_progress,
    px_per_mm: float | None = None,
    ridge_period_mm: float | None = None,
) -> Source:
    """Read a result folder (or its ``height.npz``), or a capture folder, which is reconstructed where `surface` is set.

    Raises BadInput if it is neither, is damaged, has no scale or two, or holds no photograph where one is needed.

    `photo`, `surface`: whether these are needed; `px_per_mm`, `ridge_period_mm`: the scale, or the distance of the
    ridges that it follows from, where it is unknown.
    """
    from splitknit import read_capture
    from splitknit.io.capture import photographs_hint
    from splitknit.pipeline import with_scale  # photographs of fingers need none of them

    progress("reading", 0.05)
    require(os.path.exists(path), f"there is no '{path}'; name a capture folder or a result folder.")  # noqa: PTH110
    folder = path.is_dir()
    if folder and (path / "capture.json").is_file():
        capture, note = naming(path, lambda: with_scale(read_capture(path), px_per_mm, ridge_period_mm))
        source = naming(path, lambda: source_of_capture(capture, photo, surface, preset, progress))
        return replace(source, scale=note)
    result = path / "height.npz" if folder else path
    require(
        result.is_file() and result.suffix.lower() == ".npz",
        f"'{path}' is neither a capture (capture.json) nor a result (height.npz); name one {photographs_hint(path)}.",
    )
    require(
        not photo,
        f"'{path}' is a result, which holds no photograph of the finger; name the capture folder for `method` photo.",
    )
    return _of_result(result, px_per_mm, ridge_period_mm)


def source_of(result: Reconstruction) -> Source:
    """What prints need of a reconstruction in memory. Raises BadInput where its scale is unknown."""
    from splitknit.model import require_scale

    require_scale(result)
    return Source(
        "result", result.mask, result.pitch_mm, result.input_from_upright, result.upright_size, result.height_mm,
        result.ridge_mm, result.shape_mm, result.x_mm, result.y_mm, specular=result.specular, preset=result.preset,
        hashes=result.hashes,
    )  # fmt: skip


def _of_result(path: Path, px_per_mm: float | None, ridge_period_mm: float | None) -> Source:
    from splitknit.finger.ridge_period import scale_of_ridges
    from splitknit.io.provenance import file_hash
    from splitknit.io.results import read_fields

    names, unscaled = ("height_mm", "ridge_mm", "shape_mm"), px_per_mm is not None or ridge_period_mm is not None
    needed = (*names, "normals") if ridge_period_mm is not None else names
    arrays = read_fields(path, needed, ("x_mm", "y_mm", "specular"), unscaled=unscaled)
    require(arrays["mask"].any(), f"{path}: the mask is empty; reconstruct the capture again.")
    note, normals = "", arrays.pop("normals", None)
    if unscaled:
        require(not arrays.pop("scale_known"), f"{path} has a scale already: {1 / arrays['pitch_mm']:g} px/mm.")
        if ridge_period_mm is not None:
            px_per_mm, note = naming(path, lambda: scale_of_ridges(normals, arrays["mask"], px_per_mm, ridge_period_mm))
        pitch_mm = 1.0 / float(px_per_mm or 1.0)
        for name in names:
            arrays[name] = arrays[name] * np.float32(pitch_mm / arrays["pitch_mm"])
        arrays["pitch_mm"] = pitch_mm
    return Source("result", hashes={path.name: file_hash(path)}, scale=note, **arrays)


def source_of_capture(
    capture: Capture, photo: bool, surface: bool, preset: str = "metric", progress: Progress = no_progress
) -> Source:
    """What prints need of a capture, see :func:`read_source`."""
    from splitknit import preset_settings, reconstruct
    from splitknit.finger.locate import find_finger
    from splitknit.model import require_scale

    require_scale(capture.rig.camera)
    light = _photograph(capture) if photo else None
    if surface:
        result = reconstruct(capture, preset, progress=lambda stage, fraction: progress(stage, 0.1 + 0.6 * fraction))
        facts: dict[str, Any] = {"preset": preset, "hashes": capture.hashes, "subject": capture.subject}
        return replace(source_of(result), kind="capture", photo=light, **facts)
    if "white" not in capture.bands:
        raise BadInput("the capture has no band 'white', in which fingers are photographed.")
    finger = find_finger(capture, preset_settings(preset))
    return Source(
        "capture", finger.mask, capture.rig.camera.pitch_mm, finger.upright.input_from_upright, finger.upright.size,
        photo=light, hashes=capture.hashes, subject=capture.subject,
    )  # fmt: skip


def _photograph(capture: Capture) -> FloatArray:
    """(H, W) mean of the white images; of colours the blue one, which enters the skin least deeply."""
    from splitknit.imaging.band import has_colour, linear_channels
    from splitknit.imaging.polarised import without_films

    require("white" in capture.bands, "the capture has no band 'white', in which fingers are photographed.")
    band = without_films(capture).bands["white"]
    channel = "blue" if has_colour(band) else "grey"
    return np.asarray(linear_channels(band, capture.encoding, [channel])[0].mean(axis=0), dtype=np.float32)
