"""The folder of a result: its files, and one page and one JSON document that report what was
measured, and how well.

Dates and timings are written here and nowhere else: all other files are the same bytes for the same
input.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Capture
from splitknit.files import AnyPath
from splitknit.findings import SEVERITY_WORDS
from splitknit.finger.ridges import surface_print
from splitknit.imaging.pixels import srgb_code
from splitknit.io.atomic import atomic_folder, make_folder, write_file
from splitknit.io.images import write_float_tiff, write_image
from splitknit.io.pictures import ColourArray, colour, data_uri, upright_frame, upright_limits
from splitknit.io.prints import provenance_texts, write_print_png
from splitknit.io.provenance import json_text, plain_json, provenance, report_head
from splitknit.io.results import (
    albedo_bytes,
    normals_picture,
    surface_colours,
    write_arrays,
    write_mesh,
    write_picture,
)
from splitknit.model import FloatArray
from splitknit.observation.films import picture_bytes
from splitknit.reconstruction import Comparison, Reconstruction
from splitknit.report import figures, template
from splitknit.report.photos import LONGEST_PX, captioned, capture_pictures, is_finger
from splitknit.report.surface import scene_of


@dataclass(frozen=True, slots=True)
class Report:
    """The page, the same facts for programs, and the pictures that are files of their own."""

    html: str
    facts: Mapping[str, Any]
    above: ColourArray  # the shaded surface as the camera sees it, upright
    # the relief as a print; None if it is not a finger's, or its scale is unknown
    prints: NDArray[np.uint8] | None

    def write(self, folder: Path, files: Sequence[str]) -> dict[str, Any]:
        """Write ``report.html`` and ``report.json``, which lists `files`, and return the facts."""
        facts = {**self.facts, "files": list(files)}
        write_file(folder / "report.html", self.html.encode("utf-8"))
        write_file(folder / "report.json", json_text(facts).encode("utf-8"))
        return facts


def make_report(
    result: Reconstruction,
    capture: Capture | None,
    comparisons: Sequence[Comparison] = (),
    others: Sequence[Reconstruction] = (),
    title: str = "",
) -> Report:
    """Build the report of `result`; its pictures are drawn side by side, in threads. `capture`:
    what it was made from, whose previews enter the page; `comparisons`: with a simulator's truth,
    of `result` and of `others`, of the same capture by other presets; `title`: by default "3D
    fingerprint", or "Surface" of what is not a finger.
    """
    finger = is_finger(result)
    results = (result, *others)
    shown = result if finger else figures.details_of_object(result)
    with ThreadPoolExecutor(4) as pool:
        printing = pool.submit(surface_print, result, PRINT_PPI) if is_printed(result) else None
        page = pool.submit(template, "report.html")
        frame = upright_frame(result, LONGEST_PX)
        small = figures.small_fields(shown, frame)
        drawn = pool.submit(figures.view_from_above, small)
        surfaces = pool.submit(scene_of, shown, f"{result.preset}: drag to turn, wheel to zoom")
        photographs = pool.submit(capture_pictures, result, capture)
        fields = [pool.submit(draw, shown, small) for draw in figures.FIELD_PICTURES]
        facts = _facts(result, capture, comparisons)
        maps = [picture for job in fields if (picture := job.result()) is not None]
        prints = None if printing is None else printing.result()
        above = drawn.result()
    html = page.result().render(
        title=title,
        finger=finger,
        unit=result.unit,
        facts=facts,
        **_summary(shown),
        warnings=[f"{SEVERITY_WORDS[finding.severity]}: {finding}" for finding in result.findings],
        scene=surfaces.result(),
        above=captioned("From above", above, pitch_mm=frame.pitch_mm),
        prints=None if prints is None else figures.print_picture(prints),
        maps=[*photographs.result(), *maps],
        grouped=_grouped,
        comparisons=comparisons,
        errors=figures.error_pictures(results, comparisons, frame) if comparisons else [],
    )
    return Report(html, facts, above, prints)


def _facts(
    result: Reconstruction, capture: Capture | None, comparisons: Sequence[Comparison]
) -> dict[str, Any]:
    unit = result.unit
    area_px = int(np.count_nonzero(result.mask))
    photographed: dict[str, Any] = {}
    if capture is not None:
        photographed = {
            "material": capture.material,
            "encoding": capture.encoding,
            "image_size": capture.shape,
            "px_per_mm": capture.rig.camera.measured_px_per_mm,
            "bands": {name: len(band.leds) for name, band in capture.bands.items()},
            "captured_at": capture.captured_at,
            "subject": capture.subject,
        }
    facts = {
        **report_head("splitknit-report"),
        "preset": result.preset,
        "capture": photographed,
        "result": {
            "pitch_mm": result.pitch_mm if unit.known else None,
            "scale_known": unit.known,
            "input_from_upright": result.input_from_upright,
            "upright_size": result.upright_size,
            "area_mm2": area_px * result.pitch_mm**2 if unit.known else None,
            "area_px": area_px,
        },
        "findings": [finding.facts for finding in result.findings],
        "quality": unit.converted(result.quality),
        "facts": unit.converted(result.facts),
        "settings": result.settings,
        "timings_s": result.timings_s,
        "inputs_sha256": dict(sorted(result.hashes.items())),
        "comparison": {each.preset: each.figures for each in comparisons},
    }
    return {name: _plain(fact) for name, fact in facts.items()}


def _plain(value: Any) -> Any:
    """Plain JSON as by :func:`splitknit.io.provenance.plain_json`; NaN and infinity become None,
    and large arrays a description."""
    if isinstance(value, np.ndarray):
        return _plain(value.tolist()) if value.size <= 256 else f"array {value.shape} {value.dtype}"
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return (
        [_plain(item) for item in value] if isinstance(value, list | tuple) else plain_json(value)
    )


def _summary(result: Reconstruction) -> dict[str, float]:
    """The most important facts: size and area seen from above, and the range of the relief, from
    the 5th to the 95th percentile where the surface faces the camera."""
    width, length = np.ptp(upright_limits(result), axis=0) * result.pitch_mm
    height = result.height_mm[result.mask]
    relief = figures.facing_relief_mm(result)
    return {
        "width_mm": width,
        "length_mm": length,
        "depth_mm": float(np.nanmax(height) - np.nanmin(height)),
        "area_mm2": np.count_nonzero(result.mask) * result.pitch_mm**2,
        "relief_mm": float(np.ptp(np.percentile(relief, (5, 95)))) if relief.size else 0.0,
        "pitch_mm": result.pitch_mm,
    }


def _grouped(facts: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One table for each nested group of `facts`."""
    groups = {"": {key: value for key, value in facts.items() if not isinstance(value, Mapping)}}
    groups |= {key: dict(value) for key, value in facts.items() if isinstance(value, Mapping)}
    return [
        {
            "name": _label(name),
            "rows": [(_label(key), _text(value)) for key, value in group.items()],
        }
        for name, group in groups.items()
        if group
    ]


def _text(value: Any) -> str:
    """Show a number, a text or a list in one line."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{float(f'{value:.4g}'):g}"
    if isinstance(value, Mapping):
        return "; ".join(f"{_label(str(key))}: {_text(item)}" for key, item in value.items())
    if isinstance(value, list):
        items = [f"({_text(item)})" if isinstance(item, list) else _text(item) for item in value]
        return ", ".join(items) or "none"
    return str(value)


def _label(name: str) -> str:
    """Return a name as words."""
    return name.replace("_", " ")


PRINT_PPI = 500.0
"""Pixels an inch of ``print.png``. Source: ISO/IEC 19794-4, the usual resolution of prints."""
_IMAGES = ("normals.png", "albedo.png", "print.png", "preview.png")
FILES = ("phalange.ply", "height.tiff", "height.npz", *_IMAGES, "report.html", "report.json")


def is_printed(result: Reconstruction) -> bool:
    """Whether a print is written: the result is a finger of known scale."""
    return result.unit.known and is_finger(result)


def write_results(
    result: Reconstruction,
    capture: Capture | None,
    folder: AnyPath,
    comparisons: Sequence[Comparison] = (),
) -> dict[str, Any]:
    """Write all files of a reconstruction into `folder`, which appears complete or not at all, in
    place of an earlier result; return the facts of ``report.json``. The report shows the
    photographs of `capture`, and the comparison with a simulator's truth. Raises BadInput if the
    folder holds files of others or cannot be written.
    """
    with atomic_folder(folder) as target:
        return write_files(result, capture, target, comparisons)


def write_steps(
    kept: Mapping[str, FloatArray], target: Path
) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Write images of steps (:func:`splitknit.reconstruct`, `kept`) into ``steps/``, 16 bits in the
    sRGB code; return for each step its files and the linear light stored as white, and the list of
    all files."""
    facts: dict[str, dict[str, Any]] = {}
    for name, images in kept.items():
        white = max(float(images.max()), 1e-12)
        of_lights = name not in {"chromaticity", "raw_mask"}
        make_folder(target / "steps")
        files = []
        for number, image in enumerate(images if of_lights else [images]):
            file = f"steps/{name}_{number}.png" if of_lights else f"steps/{name}.png"
            code = 65535 * srgb_code(np.clip(image / white, 0.0, 1.0))
            write_image(target / file, np.rint(code).astype(np.uint16))
            files.append(file)
        facts[name] = {"files": files, "white": white}
    return facts, [file for step in facts.values() for file in step["files"]]


def write_files(
    result: Reconstruction,
    capture: Capture | None,
    target: Path,
    comparisons: Sequence[Comparison] = (),
    step_files: Sequence[str] = (),
) -> dict[str, Any]:
    """Write the files of :func:`write_results` into a folder where `step_files` lie."""
    heights = result.unit.heights(result.height_mm)
    unit, pitch = ("mm", result.pitch_mm) if result.unit.known else ("pixel", None)
    mesh = FILES[0] if is_finger(result) else "surface.ply"
    names = [mesh, *(name for name in FILES[1:] if name != "print.png" or is_printed(result))]
    origin = provenance({"preset": result.preset, **result.settings}, result.hashes)
    pictures = {
        "normals.png": lambda: normals_picture(result, result.normals),
        "albedo.png": lambda: albedo_bytes(result),
    }
    if (measured := result.normals_measured) is not None:
        pictures["normals_measured.png"] = lambda: normals_picture(result, measured)
    if result.colour is not None:
        pictures["colour.png"] = lambda: surface_colours(result)
    if (specular := result.specular) is not None:
        pictures["specular.png"] = lambda: picture_bytes(specular)
    if (misfit := result.misfit) is not None:
        pictures["misfit.png"] = lambda: colour(np.nan_to_num(misfit), 0.0, figures.MISFIT)

    def write(name: str) -> None:
        write_picture(target / name, pictures[name](), origin)

    with ThreadPoolExecutor(4) as pool:
        jobs = [
            pool.submit(write_arrays, target / "height.npz", result, origin),
            pool.submit(write_mesh, target / mesh, result, origin),
            pool.submit(write_float_tiff, target / "height.tiff", heights, unit, origin, pitch),
            *(pool.submit(write, name) for name in pictures),
        ]
        report = make_report(result, capture, comparisons)
        if report.prints is not None:
            write_print_png(
                target / "print.png", report.prints, PRINT_PPI, provenance_texts(origin)
            )
        write_picture(target / "preview.png", report.above, origin)
        for job in jobs:
            job.result()
    return report.write(target, [*dict.fromkeys((*names, *pictures)), *step_files])


def preview_html(result: Reconstruction) -> str:
    """The shaded surface as an image element, small, for notebooks."""
    small = figures.small_fields(result, upright_frame(result, 400))
    data = data_uri(figures.view_from_above(small), photo=True)
    return f'<img src="{data}" alt="surface from above">'
