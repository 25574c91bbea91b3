"""A print's folder: the pictures, the minutiae and the report that ``splitknit print`` writes."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.apps.printing import (
    Print,
    PrintingSettings,
    checked_surface,
    enhance,
    make_print,
    make_rolled_print,
    measured,
)
from splitknit.apps.printing_files import distortion_picture, map_arrays, write_minutiae
from splitknit.apps.printing_quality import nfiq2_of, quality_facts
from splitknit.apps.printing_rolled import read_rolled, write_rolled
from splitknit.apps.printing_sources import Source, read_source
from splitknit.apps.targets import check_target
from splitknit.errors import BadInput, require
from splitknit.io import atomic_file, atomic_folder, canonical_json, provenance, write_image, write_npz, write_print_png
from splitknit.prints import Enhanced, as_print, ridge_mask, thin
from splitknit.recipe.rolled import Rolled
from splitknit.settings import override

RESOLUTIONS = (500.0, 1000.0)
Progress = Callable[[str, float], None]


def print_to_folder(
    path: Path,
    out: Path,
    *,
    method: str = "unroll",
    surface: str | None = None,
    ppi: float = 500.0,
    preset: str = "metric",
    changes: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Make a print of a capture or a result and write all its files; return the facts of ``report.json``.

    Raises
    ------
    BadInput
        Naming the input at fault.
    """
    started = time.perf_counter()
    tell = progress or (lambda stage, share: None)
    settings = override(PrintingSettings(), dict(changes or {}))
    place = checked_surface(method, surface, settings)
    require(ppi in RESOLUTIONS, f"a print has 500 or 1000 pixels per inch, not {ppi:g}.")
    check_target(out, "map.npz", "an earlier print", keep=path)
    with atomic_folder(out) as target:
        source, around = _read(path, method, place, preset, settings, tell)
        timings = {"reading": time.perf_counter() - started}
        tell("printing", 0.75)
        try:
            clock = time.perf_counter()
            made = (
                make_print(source, method, place, ppi, settings)
                if around is None
                else make_rolled_print(around, source, place, ppi, settings)
            )
            timings["printing"] = time.perf_counter() - clock
            tell("enhancing", 0.85)
            clock = time.perf_counter()
            enhanced = enhance(made, ppi, settings)
            ridges = ridge_mask(enhanced)
            lines = thin(ridges)
            timings["enhancing"] = time.perf_counter() - clock
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from error
        tell("writing", 0.92)
        origin = provenance({**_parameters(method, settings), "surface": place, "ppi": ppi}, source.hashes)
        texts = {"Software": f"splitknit {origin['version']}", "Comment": canonical_json(origin)}
        pictures = {
            "print.png": made.image,
            "enhanced.png": enhanced.image,
            "binary.png": as_print(ridges),
            "thinned.png": as_print(lines),
        }
        for name, picture in pictures.items():
            write_print_png(target / name, picture, ppi, texts)
        write_npz(target / "map.npz", map_arrays(made.map))
        facts: dict[str, Any] = {
            "method": method,
            "surface": place,
            "source": {"path": str(path), "kind": source.kind, "preset": source.preset, "pitch_mm": source.pitch_mm},
            "ppi": ppi,
            "enhanced": settings.enhance,
            **_sizes(made, enhanced, ppi),
        }
        if made.unrolled is not None:
            facts["distortion"] = made.unrolled.distortion.figures()
            write_image(target / "distortion.png", distortion_picture(made.map, made.unrolled))
        if around is not None:
            facts["rolled"] = write_rolled(target, around)
        clock = time.perf_counter()
        quality = measured(made, enhanced, ppi, settings)
        timings["quality"] = time.perf_counter() - clock
        nfiq2 = nfiq2_of(pictures, ppi)
        facts["quality"] = quality_facts(quality, nfiq2)
        sought = settings.minutiae
        facts["minutiae"] = write_minutiae(
            target, pictures, enhanced, sought, made.map, source, origin, round(quality.score)
        )
        timings["total"] = time.perf_counter() - started
        facts["timings_s"] = {name: round(value, 3) for name, value in timings.items()}
        facts["provenance"] = origin
        facts["files"] = sorted([path.name for path in target.iterdir()] + ["report.json"])
        with atomic_file(target / "report.json") as stream:
            stream.write((json.dumps(facts, indent=1, allow_nan=False) + "\n").encode("utf-8"))
    tell("done", 1.0)
    return {**facts, "out": str(out)}


def _read(  # noqa: PLR0917
    path: Path, method: str, place: str, preset: str, settings: PrintingSettings, tell: Progress
) -> tuple[Source, Rolled | None]:  # fmt: skip
    """What the print is made from, and the finger around its front where the print is rolled."""
    if method == "rolled":
        return read_rolled(path, preset, settings.rolled, tell)
    photo = method == "photo"
    surface = not photo or place != "plane"
    return read_source(path, photo=photo, surface=surface, preset=preset, progress=tell), None


def _parameters(method: str, settings: PrintingSettings) -> dict[str, Any]:
    """What a print follows from; the rolled finger's settings only where it is one."""
    found = {"method": method, **asdict(settings)}
    if method != "rolled":
        found.pop("rolled")
    return found


def _sizes(made: Print, enhanced: Enhanced, ppi: float) -> dict[str, Any]:
    return {
        "size": list(made.image.shape),
        "mirrored": True,
        "ridges": "dark",
        "ridge_period_mm": _periods(enhanced, ppi),
        "area_mm2": round(float(made.weight.sum()) * (25.4 / ppi) ** 2, 1),
        "ridge_area_mm2": round(float(enhanced.mask.sum()) * (25.4 / ppi) ** 2, 1),
    }


def _periods(enhanced: Enhanced, ppi: float) -> dict[str, float]:
    period = enhanced.field.period_mm(ppi)[enhanced.field.mask]
    low, middle, high = (round(float(value), 4) for value in np.percentile(period, [5, 50, 95]))
    return {"p5": low, "median": middle, "p95": high}
