"""What ``splitknit separate`` does: a folder of images under patterns in, direct and global light out.

Into the result's folder go ``direct.tiff`` and ``global.tiff`` (float32, linear light, 1 = full scale of the files, NaN
outside the mask), 8-bit previews of both, for sinusoids also ``phase.tiff`` (rad, wrapped) and its preview, and
``report.json``. The folder of images is described in :mod:`splitknit.apps.pattern_folder`.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.apps.commands import Progress, no_progress
from splitknit.apps.pattern_folder import ESTIMATE, PatternFolder, read_pattern_folder
from splitknit.apps.pattern_light import PatternLight, read_light
from splitknit.apps.separation_pictures import light_picture, phase_picture
from splitknit.apps.targets import check_target
from splitknit.errors import BadInput, require
from splitknit.io import atomic_folder, plain_json, provenance, write_image
from splitknit.io.light import write_light_tiff
from splitknit.model import FloatArray
from splitknit.separation import (
    PhaseSeparation,
    Separation,
    StackSettings,
    checkerboard,
    estimate_patterns,
    occluder,
    single_image,
    sinusoid,
)
from splitknit.separation.patterns import by_symmetry

MARKER = "direct.tiff"
LINEAR = "linear light, 1 = full scale of the images"
_LIT = 0.1
"""Figures of the report are over pixels brighter than this part of the brightest."""


def separate_to_folder(
    folder: Path, out: Path, *, changes: Mapping[str, Any] | None = None, progress: Progress = no_progress
) -> dict[str, Any]:
    """Separate the images in `folder`, write all results into `out`, return the facts of ``report.json`` and more.

    `changes` replace fields of :class:`splitknit.apps.pattern_folder.PatternFolder` (``None`` changes nothing).

    Raises
    ------
    BadInput
        Naming the file or the folder at fault; nothing is left half-written.
    """
    started = time.perf_counter()
    plan = read_pattern_folder(folder, changes)
    check_target(out, MARKER, "an earlier separation", keep=folder)
    with atomic_folder(out) as target:
        progress("reading", 0.0)
        light = read_light(plan, folder)
        progress("separating", 0.5)
        try:
            parts = _separate(plan, light)
        except BadInput as error:
            raise BadInput(f"{folder}: {_with_names(str(error), plan)}") from error
        progress("writing", 0.8)
        facts = _write(parts, plan, light, target)
        facts["total_s"] = time.perf_counter() - started
        _write_report(target / "report.json", facts)
    progress("done", 1.0)
    return {**facts, "out": str(out)}


def _separate(plan: PatternFolder, light: PatternLight) -> Separation:
    """Run the method."""
    settings = StackSettings(clip_level=light.clip_level)
    common: dict[str, Any] = {"mask": light.mask, "settings": settings}
    patterns: FloatArray | None = light.patterns
    if plan.method in ("checkerboard", "occluder") and plan.patterns == ESTIMATE:
        patterns = estimate_patterns(light.stack, **common)
    if plan.method == "checkerboard":
        alpha = 0.5 if plan.alpha is None else plan.alpha
        return checkerboard(
            light.stack,
            alpha=alpha,
            dark=plan.dark,
            patterns=patterns,
            check_px=plan.check_px,
            shifts=plan.shifts,
            period=plan.period,
            **common,
        )
    if plan.method == "symmetry":
        return by_symmetry(
            light.stack,
            white=light.white,
            dark=plan.dark,
            check_px=plan.check_px,
            shifts=plan.shifts,
            period=plan.period,
            **common,
        )
    if plan.method == "sinusoid":
        return sinusoid(light.stack, _phases(plan), dark=plan.dark, noise_std=plan.noise_std, **common)
    if plan.method == "occluder":
        kind = plan.kind or ("line" if plan.alpha is None else "mesh")
        return occluder(
            light.stack, kind, alpha=plan.alpha, shadow_percent=plan.shadow_percent, patterns=patterns, **common
        )
    require(plan.patterns != ESTIMATE, "method single needs the pattern's image or check_px, not 'estimate'.")
    require(light.mask is None, "method single takes no mask; cut the image instead.")
    return single_image(
        light.stack[0],
        plan.block or 0,
        check_px=plan.check_px,
        alpha=0.5 if plan.alpha is None else plan.alpha,
        dark=plan.dark,
        pattern=None if patterns is None else patterns[0],
        settings=settings,
    )


def _phases(plan: PatternFolder) -> NDArray[np.float64] | None:
    if plan.shifts is None:
        return None
    require(plan.period is not None and plan.period > 0, "a sinusoid's shifts need its period, in the same units.")
    require(
        all(len(row) == 1 for row in plan.shifts), "a sinusoid's shifts are single numbers, along its one direction."
    )
    return np.asarray(2 * np.pi * np.array([row[0] for row in plan.shifts]) / float(plan.period or 1.0))


def _with_names(message: str, plan: PatternFolder) -> str:
    """Let what stages refuse, which know numbers only, name the files."""

    def named(found: re.Match[str]) -> str:
        numbers = [found.group(2)] + ([found.group(3)] if found.group(3) else [])
        known = [f"{n} ({plan.images[int(n)].name})" if int(n) < len(plan.images) else n for n in numbers]
        return found.group(1) + " and ".join(known)

    return re.sub(r"(images? )(\d+)(?: and (\d+))?", named, message)


def _write(parts: Separation, plan: PatternFolder, light: PatternLight, target: Path) -> dict[str, Any]:
    """Write images; return facts."""
    origin = provenance({"separate": plan.settings()}, light.hashes)
    files = ["direct.tiff", "global.tiff", "direct.png", "global.png"]
    for name, part in (("direct", parts.direct), ("global", parts.global_)):
        write_light_tiff(target / f"{name}.tiff", part, LINEAR, origin)
        write_image(target / f"{name}.png", light_picture(part))
    if isinstance(parts, PhaseSeparation):
        write_light_tiff(target / "phase.tiff", parts.phase_rad, "rad, wrapped", origin)
        write_image(target / "phase.png", phase_picture(parts))
        files += ["phase.tiff", "phase.png"]
    return {**origin, **_figures(parts, plan, light), "files": [*files, "report.json"]}


def _figures(parts: Separation, plan: PatternFolder, light: PatternLight) -> dict[str, Any]:
    """What the report says about the result."""
    total = parts.white
    grey = total if total.ndim == 2 else total.mean(axis=-1)
    known = np.isfinite(grey)
    lit = known & (np.where(known, grey, 0.0) > _LIT * float(np.quantile(grey[known], 0.999)))
    require(bool(lit.any()), "nothing is lit; the images are black.")
    direct, global_ = parts.direct[lit], parts.global_[lit]
    negative = float((global_ < 0).mean())
    warnings = []
    if negative > 0.05:
        warnings.append(
            f"global light is negative in {100 * negative:.0f} % of the lit pixels: check alpha, dark and the black "
            f"image."
        )
    if plan.method == "checkerboard" and plan.patterns is not None and plan.check_px is None:
        warnings.append(
            "global light was taken to be the same under all shifts; on skin it is not, and direct light comes out a "
            "quarter too low: give check_px for skin."
        )
    white = None
    if light.white is not None and light.white.shape == total.shape:
        truth = light.white[lit]
        ratio = total[lit] / np.where(truth > 0, truth, np.nan)
        ratio = ratio[np.isfinite(ratio)]
        if ratio.size:
            white = {"median_ratio": float(np.median(ratio)), "median_error": float(np.median(np.abs(ratio - 1)))}
    return {
        "method": plan.method,
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


def _write_report(path: Path, facts: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(plain_json(facts), indent=1, allow_nan=False) + "\n", encoding="utf-8")
