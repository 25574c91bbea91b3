"""What prints are made from: a reconstruction, or a capture and what is needed of it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import Capture, Reconstruction
from splitknit.errors import naming, require
from splitknit.findings import Finding
from splitknit.model import Array, BoolArray, FloatArray, Progress, no_progress

SCALE_OF_RIDGES = "scale-of-ridges"
"""Code of the finding of a scale that was found in the ridges."""


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A finger on its input's pixel grid."""

    kind: str
    """``result``, ``capture`` or ``photo``."""
    mask: BoolArray
    pitch_mm: float
    input_from_upright: Array
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
    """(H, W) of polarised captures, see :class:`splitknit.reconstruction.Reconstruction`."""
    preset: str | None = None
    hashes: Mapping[str, str] = field(default_factory=dict)
    subject: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    """What was assumed of it: how the scale was found in the ridges, where it was."""
    quality: float | None = None
    """Of a photograph of a finger, 0 to 100."""
    skin: bool = True
    """Whether it is live skin, and no cast or other thing."""

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
    """Read a result folder (or its ``height.npz``), or a capture folder, which is reconstructed
    where `surface` is set.

    Raises BadInput if it is neither, is damaged, has no scale or two, or holds no photograph where
    one is needed.

    `photo`, `surface`: whether these are needed; `px_per_mm`, `ridge_period_mm`: the scale, or the
    distance of the ridges that it follows from, where it is unknown.
    """
    from splitknit import read_capture
    from splitknit.io.capture import photographs_hint
    from splitknit.pipeline import with_scale  # photographs of fingers need none of them

    progress("reading", 0.05)
    require(
        os.path.exists(path),  # noqa: PTH110
        f"there is no '{path}'; name a capture folder or a result folder.",
    )
    if (path / "capture.json").is_file():
        capture, note = naming(
            path, lambda: with_scale(read_capture(path), px_per_mm, ridge_period_mm)
        )
        source = naming(path, lambda: source_of_capture(capture, photo, surface, preset, progress))
        return replace(source, findings=_scale_findings(note))
    result = path / "height.npz" if path.is_dir() else path
    require(
        result.is_file() and result.suffix.lower() == ".npz",
        f"'{path}' is neither a capture (capture.json) nor a result (height.npz); name one"
        f" {photographs_hint(path)}.",
    )
    require(
        not photo,
        f"'{path}' is a result, which holds no photograph of the finger; name the capture folder"
        " for `method` photo.",
    )
    return _of_result(result, px_per_mm, ridge_period_mm)


def source_of(result: Reconstruction) -> Source:
    """What prints need of a reconstruction in memory. Raises BadInput where its scale is
    unknown."""
    from splitknit.reconstruction import require_scale

    require_scale(result)
    return Source(
        "result",
        result.mask,
        result.pitch_mm,
        result.input_from_upright,
        result.upright_size,
        result.height_mm,
        result.ridge_mm,
        result.shape_mm,
        result.x_mm,
        result.y_mm,
        specular=result.specular,
        preset=result.preset or None,
        hashes=result.hashes,
        skin=result.facts.get("material", "skin") == "skin",
    )


def _of_result(path: Path, px_per_mm: float | None, ridge_period_mm: float | None) -> Source:
    from splitknit import read_result
    from splitknit.finger.ridge_period import scale_of_ridges
    from splitknit.io.fields import read_json
    from splitknit.io.provenance import file_hash

    result = read_result(path)
    note = ""
    if px_per_mm is not None or ridge_period_mm is not None:
        require(
            not result.scale_known, f"{path} has a scale already: {1 / result.pitch_mm:g} px/mm."
        )
        if ridge_period_mm is not None:
            ridges = partial(
                scale_of_ridges, result.normals, result.mask, px_per_mm, ridge_period_mm
            )
            px_per_mm, note = naming(path, ridges)
        pitch_mm = 1.0 / float(px_per_mm or 1.0)
        factor = np.float32(pitch_mm / result.pitch_mm)
        result = replace(
            result,
            pitch_mm=pitch_mm,
            scale_known=True,
            height_mm=result.height_mm * factor,
            ridge_mm=result.ridge_mm * factor,
            shape_mm=result.shape_mm * factor,
        )
    source = naming(path, lambda: source_of(result))
    report = path.with_name("report.json")
    facts = read_json(report)[0].get("facts") if report.is_file() else None
    skin = not (isinstance(facts, dict) and facts.get("material") == "opaque")
    hashes = {path.name: file_hash(path)}
    return replace(source, hashes=hashes, findings=_scale_findings(note), skin=skin)


def _scale_findings(note: str) -> tuple[Finding, ...]:
    return (Finding(SCALE_OF_RIDGES, note),) if note else ()


def source_of_capture(
    capture: Capture,
    photo: bool,
    surface: bool,
    preset: str = "metric",
    progress: Progress = no_progress,
) -> Source:
    """What prints need of a capture, see :func:`read_source`."""
    from splitknit import preset_settings, reconstruct
    from splitknit.finger.locate import find_finger
    from splitknit.observation.observe import observe
    from splitknit.reconstruction import require_scale

    require_scale(capture.rig.camera)
    light = _photograph(capture) if photo else None
    if surface:
        result = reconstruct(
            capture, preset, progress=lambda stage, fraction: progress(stage, 0.1 + 0.6 * fraction)
        )
        return replace(
            source_of(result),
            kind="capture",
            photo=light,
            preset=preset,
            hashes=capture.hashes,
            subject=capture.subject,
        )
    finger = find_finger(observe(capture), preset_settings(preset))
    return Source(
        "capture",
        finger.mask,
        capture.rig.camera.pitch_mm,
        finger.upright.input_from_upright,
        finger.upright.size,
        photo=light,
        hashes=capture.hashes,
        subject=capture.subject,
        skin=capture.material == "skin",
    )


def _photograph(capture: Capture) -> FloatArray:
    """(H, W) mean of the white images; of colours the blue one, which enters the skin least
    deeply."""
    from splitknit.observation.observe import observe

    require(
        "white" in capture.bands,
        "the capture has no band 'white', in which fingers are photographed.",
    )
    white = observe(capture).without_films().white
    light = white.stack[2] if white.has_colour else white.grey
    return np.asarray(light.mean(axis=0), dtype=np.float32)
