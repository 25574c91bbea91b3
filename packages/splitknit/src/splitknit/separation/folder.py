"""What ``splitknit separate`` does: a folder of images under patterns in, direct and global light out.

Into the result's folder go ``direct.tiff`` and ``global.tiff`` (float32, linear light, 1 = full scale of the files, NaN
outside the mask), 8-bit previews of both, and ``report.json``. The folder of images is described in
:mod:`splitknit.separation.pattern_folder`.

Of two folders of photographs through polarising films go ``specular_K.png`` and ``diffuse_K.png`` (16 bits, linear) of
light K, ``specular.png`` of all lights, and ``report.json``.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.imaging.band import decode_table, linear_image, pick_channel, srgb_code
from splitknit.imaging.polarised import NOT_SPECULAR, picture_bytes, separate_polarised, specular_picture
from splitknit.io.atomic import atomic_folder
from splitknit.io.content import mask_from_image
from splitknit.io.images import StackReader, image_size, write_image
from splitknit.io.photos import encoding_of, read_photo
from splitknit.io.plain import photographs_in
from splitknit.io.provenance import json_text, provenance
from splitknit.io.targets import check_target
from splitknit.io.images import write_float_tiff
from splitknit.model import BoolArray, FloatArray, Progress, no_progress
from splitknit.separation.binary import checkerboard
from splitknit.separation.pattern_folder import ESTIMATE, PatternFolder, read_pattern_folder
from splitknit.separation.stacks import Separation, StackSettings, estimate_patterns

MARKER = "direct.tiff"
POLARISED_MARKER = "specular.png"
_RIDGES = 45  # periods of ridges that a picture of a finger is about long
LINEAR = "linear light, 1 = full scale of the images"
_LIT = 0.1  # figures of the report are over pixels brighter than this part of the brightest


def separate_to_folder(
    folder: Path, out: Path, *, changes: Mapping[str, Any] | None = None, progress: Progress = no_progress
) -> dict[str, Any]:
    """Separate the images in `folder`, write all results into `out`, return the facts of ``report.json`` and more.

    `changes` replace fields of :class:`splitknit.separation.pattern_folder.PatternFolder` (``None`` changes nothing).
    Raises BadInput naming the file or the folder at fault; nothing is left half-written.
    """
    started = time.perf_counter()
    plan = read_pattern_folder(folder, changes)
    check_target(out, MARKER, "an earlier separation", keep=folder)
    with atomic_folder(out) as target:
        progress("reading", 0.0)
        light = _read_light(plan, folder)
        progress("separating", 0.5)
        try:
            parts = _separate(plan, light)
        except BadInput as error:
            raise BadInput(f"{folder}: {_with_names(str(error), plan)}") from error
        progress("writing", 0.8)
        facts = _write(parts, plan, light, target)
        facts["total_s"] = time.perf_counter() - started
        (target / "report.json").write_text(json_text(facts), encoding="utf-8")
    progress("done", 1.0)
    return {**facts, "out": str(out)}


def separate_polarised_folders(
    parallel: Path, crossed: Path, out: Path, *, encoding: str | None = None, progress: Progress = no_progress
) -> dict[str, Any]:
    """Separate photographs through parallel and crossed films, light by light; return the facts of ``report.json``.
    Raises BadInput if the folders do not hold the same number of photographs of one kind, or are not to be read.
    """
    series = []
    for folder in (parallel, crossed):
        require(folder.is_dir(), f"{folder} is not a folder; name the folders of the parallel and crossed photographs.")
        series.append(photographs_in(folder, folder / "lights.txt")[0])
        check_target(out, POLARISED_MARKER, "an earlier separation", keep=folder)
    count = len(series[0])
    cure = "both series need one photograph a light, in the same order."
    require(0 < count == len(series[1]), f"{parallel} holds {count} photographs and {crossed} {len(series[1])}; {cure}")
    if encoding is None:
        encoding, _ = encoding_of(series[0], lambda: False)
    hashes, sums, first = {}, [np.zeros(1, np.float32)] * 2, None
    with atomic_folder(out) as target:
        for k in range(count):
            progress("separating", k / count)
            light = []
            for folder, files in zip((parallel, crossed), series, strict=True):
                photo = read_photo(files[k])
                kind = (photo.pixels.shape, photo.pixels.dtype)
                first = first or kind
                fits = kind == first and photo.pixels.dtype.kind == "u"
                require(fits, f"{files[k]} is not of the size and kind of {series[0][0]}; all must agree, in integers.")
                light.append(linear_image(photo.pixels, encoding))
                hashes[f"{folder.name}/{files[k].name}"] = photo.sha256
            parts = separate_polarised(*light)
            sums = [total + pick_channel(part, "grey") for total, part in zip(sums, (parts[0], light[1]), strict=True)]
            for name, part in zip(("specular", "diffuse"), parts, strict=True):
                write_image(target / f"{name}_{k}.png", np.round(part * 65535).astype(np.uint16))
        specular, diffuse = (np.asarray(total / count, dtype=np.float32) for total in sums)
        lit = diffuse > _LIT * float(np.quantile(diffuse, 0.999))
        require(bool(lit.any()), "nothing is lit; the crossed images are black.")
        picture = specular_picture(specular[None], lit, max(lit.shape) / _RIDGES)
        write_image(target / POLARISED_MARKER, picture_bytes(picture))
        share = float(np.median(specular[lit] / (specular + diffuse)[lit]))
        names = [f"{name}_{k}.png" for name in ("specular", "diffuse") for k in range(count)]
        facts = {
            **provenance({"separate": {"method": "polarised", "encoding": encoding}}, hashes),
            "method": "polarised",
            "images": count,
            "image_size": list(lit.shape),
            "specular_share": share,
            "warnings": [NOT_SPECULAR] if share <= 0 else [],
            "files": [*names, POLARISED_MARKER, "report.json"],
        }
        (target / "report.json").write_text(json_text(facts), encoding="utf-8")
    progress("done", 1.0)
    return {**facts, "out": str(out)}


def _separate(plan: PatternFolder, light: _PatternLight) -> Separation:
    common: dict[str, Any] = {"mask": light.mask, "settings": StackSettings(clip_level=light.clip_level)}
    patterns = light.patterns
    if plan.patterns == ESTIMATE:
        patterns = estimate_patterns(light.stack, **common)
    grid: dict[str, Any] = {"dark": plan.dark, "check_px": plan.check_px, "shifts": plan.shifts, "period": plan.period}
    return checkerboard(light.stack, alpha=plan.alpha, patterns=patterns, **grid, **common)


def _with_names(message: str, plan: PatternFolder) -> str:
    """Let what stages refuse, which know numbers only, name the files."""

    def named(found: re.Match[str]) -> str:
        numbers = [found.group(2)] + ([found.group(3)] if found.group(3) else [])
        known = [f"{n} ({plan.images[int(n)].name})" if int(n) < len(plan.images) else n for n in numbers]
        return found.group(1) + " and ".join(known)

    return re.sub(r"(images? )(\d+)(?: and (\d+))?", named, message)


def _write(parts: Separation, plan: PatternFolder, light: _PatternLight, target: Path) -> dict[str, Any]:
    origin = provenance({"separate": plan.settings()}, light.hashes)
    files = ["direct.tiff", "global.tiff", "direct.png", "global.png"]
    for name, part in (("direct", parts.direct), ("global", parts.global_)):
        write_float_tiff(target / f"{name}.tiff", part, LINEAR, origin)
        write_image(target / f"{name}.png", _light_picture(part))
    return {**origin, **_figures(parts, plan, light), "files": [*files, "report.json"]}


def _figures(parts: Separation, plan: PatternFolder, light: _PatternLight) -> dict[str, Any]:
    total = parts.white
    grey = total if total.ndim == 2 else total.mean(axis=-1)
    known = np.isfinite(grey)
    lit = known & (np.where(known, grey, 0.0) > _LIT * float(np.quantile(grey[known], 0.999)))
    require(bool(lit.any()), "nothing is lit; the images are black.")
    direct, global_ = parts.direct[lit], parts.global_[lit]
    negative = float((global_ < 0).mean())
    warnings = []
    if negative > 0.05:
        dark = f"global light is negative in {100 * negative:.0f} % of the lit pixels"
        warnings.append(f"{dark}: check alpha, dark and the black image.")
    if plan.patterns is not None and plan.check_px is None:
        low = "on skin it is not, and direct light comes out a quarter too low: give check_px for skin."
        warnings.append(f"global light was taken to be the same under all shifts; {low}")
    white = None
    if light.white is not None and light.white.shape == total.shape:
        truth = light.white[lit]
        ratio = total[lit] / np.where(truth > 0, truth, np.nan)
        ratio = ratio[np.isfinite(ratio)]
        if ratio.size:
            white = {"median_ratio": float(np.median(ratio)), "median_error": float(np.median(np.abs(ratio - 1)))}
    return {
        "method": "checkerboard",
        "images": [file.name for file in plan.images],
        "image_size": list(light.stack.shape[1:3]),
        "result_size": list(parts.direct.shape[:2]),
        "direct": {"median": float(np.median(direct)), "p99": float(np.quantile(direct, 0.99))},
        "global": {"median": float(np.median(global_)), "p99": float(np.quantile(global_, 0.99))},
        "direct_share": float(np.median(direct / np.maximum(total[lit], 1e-9))),
        "negative_global_share": negative,
        "against_white": white,
        "warnings": warnings,
    }


# Previews of separated light for people.


def _light_picture(light: FloatArray) -> NDArray[np.uint8]:
    """8 bits for people: black to the 99.9th percentile, sRGB curve; black where nothing is known."""
    known = np.isfinite(light)
    top = max(float(np.quantile(light[known], 0.999)) if known.any() else 1.0, 1e-12)
    scaled = np.clip(np.where(known, light, 0.0) / top, 0.0, 1.0)
    return np.asarray(np.round(255 * srgb_code(scaled)), dtype=np.uint8)


# The images of a pattern folder as linear light.


@dataclass(frozen=True, slots=True, eq=False)
class _PatternLight:
    """The images of a folder as linear light without the black level."""

    stack: FloatArray  # (N, H, W) or (N, H, W, 3)
    white: FloatArray | None  # (H, W) or (H, W, 3)
    patterns: FloatArray | None  # (N, H, W) given states
    mask: BoolArray | None  # (H, W)
    clip_level: float  # value at which the files clip
    hashes: dict[str, str]  # SHA-256 by name


def _read_light(plan: PatternFolder, folder: Path) -> _PatternLight:
    """Read all files of a plan; hashes go by names relative to the folder, wherever that lies."""
    images = list(plan.images)
    states = list(plan.patterns) if isinstance(plan.patterns, tuple) else []
    with StackReader() as reader:
        size, by = image_size(images[0]), str(images[0])
        pixels = reader.start(images, size, by)
        named = {"black": plan.black, "white": plan.white, "mask": plan.mask}
        singles = {role: reader.start([file], size, by)[0] for role, file in named.items() if file is not None}
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
    return _PatternLight(
        stack[..., 0] if grey else stack,
        white if white is None or not grey else white[..., 0],
        None
        if state_pixels is None
        else np.stack([linear_image(image, "linear").mean(axis=-1) for image in state_pixels]),
        mask_from_image(singles["mask"], str(plan.mask)) if "mask" in singles else None,
        float(table[int(0.994 * (table.size - 1))]) - float(np.median(black)),
        {
            Path(name).relative_to(folder).as_posix() if Path(name).is_relative_to(folder) else Path(name).name: value
            for name, value in hashes.items()
        },
    )


def _as(light: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """`light` (H, W, C) with the number of channels of `shape`."""
    if light.shape[2] == shape[2]:
        return light
    return np.asarray(np.broadcast_to(light.mean(axis=-1, keepdims=True), shape))
