"""The folder of a result: its files, and one page and one JSON document that report what was
measured, and how well.

Dates and timings are written here and nowhere else: all other files are the same bytes for the same
input.
"""

from __future__ import annotations

import json
import os
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
from splitknit.io.provenance import plain_json, provenance, report_head
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
from splitknit.report.photos import LONGEST_PX, capture_pictures, is_finger
from splitknit.report.surface import scene_of

_COMPARED = (
    ("surface_rms_mm", "Whole surface, rms", "mm", "below 0.13 mm"),
    ("shape_rms_mm", "Shape without ridges, rms", "mm", "below 0.13 mm"),
    ("normals_mean_deg", "Normals, mean angle", "deg", "small"),
    ("ridge_correlation", "Ridge band, correlation", "", "above 0.85"),
    ("ridge_gain", "Ridge band, gain", "", "0.6 to 1.4, ideally 1"),
    ("ridge_rms_um", "Ridge band, rms", "µm", "small"),
    ("ridge_truth_std_um", "Ridge band of the truth, standard deviation", "µm", ""),
    ("ridge_good_area", "Area where the local ridge correlation exceeds 0.8", "", "above 0.90"),
    ("height_band_correlation", "Ridge band of the whole height, correlation", "", ""),
    ("height_band_gain", "Ridge band of the whole height, gain", "", ""),
    ("mask_on_finger", "Fraction of the mask that lies on the finger", "", "above 0.99"),
)
"""Figure, words, unit, what good looks like."""


_OF_FINGERS = ("crease_found", "crease_distance_mm", "crease_line", "tip_direction", "heights")
"""Facts that the page of an opaque thing leaves out."""


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
        write_file(
            folder / "report.json",
            (json.dumps(facts, indent=1, allow_nan=False) + "\n").encode("utf-8"),
        )
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
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        printing = pool.submit(surface_print, result, PRINT_PPI) if is_printed(result) else None
        page = pool.submit(template, "report.html")
        frame = upright_frame(result, LONGEST_PX)
        small = figures.small_fields(shown, frame)
        drawn = pool.submit(figures.view_from_above, small)
        surfaces = pool.submit(scene_of, shown, f"{result.preset}: drag to turn, wheel to zoom")
        photographs = None if capture is None else pool.submit(capture_pictures, result, capture)
        fields = [pool.submit(draw, shown, small) for draw in figures.FIELD_PICTURES]
        facts = _facts(result, capture, comparisons)
        summary = _summary(shown)
        maps = [] if photographs is None else photographs.result()
        maps += [picture for job in fields if (picture := job.result()) is not None]
        prints = None if printing is None else printing.result()
        above = drawn.result()
    hidden = ("mirror_drawing",) if finger else _OF_FINGERS

    html = page.result().render(
        title=title or ("3D fingerprint" if finger else "Surface"),
        finger=finger,
        scale_known=result.unit.known,
        unit="millimetres" if result.unit.known else "pixels: its scale is unknown",
        facts=facts,
        summary=summary,
        warnings=[f"{SEVERITY_WORDS[finding.severity]}: {finding}" for finding in result.findings],
        scene=surfaces.result(),
        above=figures.picture_from_above(above, frame.pitch_mm, finger),
        prints=None if prints is None else figures.print_picture(prints),
        maps=maps,
        details={
            "Quality of the capture": _tables(facts["quality"]),
            "What was found and assumed": _tables(
                {name: fact for name, fact in facts["facts"].items() if name not in hidden}
            ),
            "Capture": _tables({name: fact for name, fact in facts["capture"].items() if fact}),
            "Timings, s": _tables(
                {
                    "object" if stage == "finger" and not finger else stage: round(seconds, 2)
                    for stage, seconds in result.timings_s.items()
                }
            ),
            "Settings": _tables(facts["settings"]),
            "Files that were read, with their SHA-256": [
                {"name": "", "rows": list(facts["inputs_sha256"].items())}
            ],
        },
        comparisons=comparisons,
        compared=[
            row
            for row in _COMPARED
            if any(each.figures.get(row[0]) is not None for each in comparisons)
        ],
        errors=figures.error_pictures(results, comparisons, frame) if comparisons else [],
    )
    return Report(html, facts, above, prints)


def _facts(
    result: Reconstruction, capture: Capture | None, comparisons: Sequence[Comparison]
) -> dict[str, Any]:
    unit = result.unit
    area_px = int(np.count_nonzero(result.mask))
    return {
        **report_head("splitknit-report"),
        "preset": result.preset,
        "capture": (
            {}
            if capture is None
            else {
                "material": capture.material,
                "encoding": capture.encoding,
                "image_size": list(capture.shape),
                "px_per_mm": capture.rig.camera.measured_px_per_mm,
                "bands": {name: len(band.leds) for name, band in capture.bands.items()},
                "captured_at": capture.captured_at,
                "subject": _plain(capture.subject),
            }
        ),
        "result": {
            "pitch_mm": result.pitch_mm if unit.known else None,
            "scale_known": unit.known,
            "input_from_upright": _plain(result.input_from_upright),
            "upright_size": list(result.upright_size),
            "area_mm2": area_px * result.pitch_mm**2 if unit.known else None,
            "area_px": area_px,
        },
        "findings": [finding.facts for finding in result.findings],
        "quality": _plain(unit.converted(result.quality)),
        "facts": _plain(unit.converted(result.facts)),
        "settings": _plain(result.settings),
        "timings_s": _plain(result.timings_s),
        "inputs_sha256": dict(sorted(result.hashes.items())),
        "files": [],
        "comparison": {each.preset: _plain(each.figures) for each in comparisons},
    }


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


def _summary(result: Reconstruction) -> list[tuple[str, str]]:
    """The most important facts."""
    unit = result.unit
    finger = is_finger(result)
    area_px = int(np.count_nonzero(result.mask))
    width, length = unit.per_mm * np.ptp(upright_limits(result), axis=0) * result.pitch_mm
    height = result.height_mm[result.mask]
    depth = unit.per_mm * float(np.nanmax(height) - np.nanmin(height))
    relief = figures.facing_relief_mm(result)
    low, high = np.percentile(relief, (5, 95)) if relief.size else (0.0, 0.0)
    small, per_mm = unit.fitting(float(high - low))
    swing = per_mm * float(high - low)
    over = f"(5th to 95th percentile where {'the skin' if finger else 'it'} faces the camera)"
    sampling = ("Scale", "unknown, heights in pixels")
    if unit.known:
        per_inch = f" ({25.4 / result.pitch_mm:.0f} per inch)" if finger else ""
        sampling = ("Sampling", f"one value every {1000 * result.pitch_mm:.1f} µm{per_inch}")
    return [
        (
            "Size seen from above",
            f"{width:.1f} {unit.name} wide, {length:.1f} {unit.name} long,"
            f" {depth:.1f} {unit.name} deep",
        ),
        (
            "Skin measured" if finger else "Area measured",
            f"{area_px * (unit.per_mm * result.pitch_mm) ** 2:.0f} {unit.name}² in projection",
        ),
        sampling,
        (
            "Relief, valley to ridge" if finger else "Relief of fine details",
            f"{swing:.3g} {small} {over}",
        ),
    ]


def _tables(facts: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One table for each nested group of `facts`."""
    groups = {"": {key: value for key, value in facts.items() if not isinstance(value, Mapping)}}
    groups |= {key: dict(value) for key, value in facts.items() if isinstance(value, Mapping)}
    return [
        {
            "name": _label(name),
            "rows": [
                (_label(key), _text(value), EXPLAINED.get(key, "")) for key, value in group.items()
            ],
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
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return "; ".join(f"{_label(str(key))}: {_text(item)}" for key, item in value.items())
    if isinstance(value, list):
        return (
            ", ".join(
                f"({_text(item)})" if isinstance(item, list) else _text(item) for item in value
            )
            or "none"
        )
    return str(value)


# What the names in a report mean, for readers who do not know the code.

EXPLAINED = {
    "ridge_contrast": (
        "How much the ridges change the brightness, relative. Good: above 0.006; more is better."
    ),
    "ridge_contrast_per_image": "The same for every image. Good: all similar.",
    "sharpness": (
        "Focus: fine detail relative to brightness. Compare it between captures of one rig."
    ),
    "dark_specks": (
        "Fraction of the surface under dark specks, as dust makes them. Good: below 0.002."
    ),
    "bright_specks": (
        "Fraction of the surface under bright specks, as scales of dry skin make them. Good: below"
        " 0.005."
    ),
    "saturated_per_image": (
        "Fraction of the surface that is too bright to measure, for every image. Good: below 0.02."
    ),
    "brightness": "Median brightness of the surface, 1 = full scale. Good: 0.1 to 0.6.",
    "brightness_per_image": "The same for every image.",
    "ambient_share": "Ambient light, relative to that of the lamps. Good: below 0.3.",
    "area_mm2": "Area of the surface in the image.",
    "length_mm": "Length in view.",
    "width_mm": "Width in view.",
    "frame_share": "Fraction of the image that it fills.",
    "borders": "Borders of the image that it touches.",
    "led_relative": (
        "Brightness of every image relative to what its light should give. Good: all near 1."
    ),
    "light_residual": (
        "Part of the photographs that no matt surface under their lights explains. Good: below"
        " 0.15."
    ),
    "light_brightness": (
        "Brightness of each light over the mean, estimated with the surface and taken out."
    ),
    "light_residual_per_image": "The same for every image. Good: all similar.",
    "yaw_deg": "Turn in the image, counter-clockwise; it is taken out.",
    "tip_direction": (
        "Where the tip's direction comes from: the capture, the outline, or an assumption."
    ),
    "crease_line": "Ends of the flexion crease at which the finger was cut (column, row).",
    "motion_mm": ("How far it moved against the other shots, in every image. Good: below 0.05 mm."),
    "motion_reliability": "How well that is known, for every image: 1 = certain.",
    "moved_mm": (
        "How far it moved against the reference image, for every image. A note says where it was"
        " undone."
    ),
    "shift_mm": "The same to the right and upwards.",
    "turn_deg": "By how much it turned, counter-clockwise.",
    "centre_mm": "About which point, to the right and downwards from the first pixel.",
    "unexplained_before": (
        "Details of every image that no matt surface explains, before the motion was undone."
    ),
    "unexplained_after": "The same afterwards. Good: below 0.2.",
    "likeness_before": (
        "Correlation of every image's details with the expected ones, before the motion was undone."
    ),
    "likeness_after": "The same afterwards.",
    "scattering_per_mm": (
        "How often light is scattered in the skin, a millimetre; assumed for the shape."
    ),
    "relief_by": (
        "network: ridges drawn by the trained network; colour: specular reflection removed by"
        " colour alone; polarised: ridges from what the surface reflects, parallel less crossed"
        " images; side: from what is white in images lit from the front and the side."
    ),
    "heights": (
        "Of the ridges: measured in this finger's images, or modelled, as blurred by skin that was"
        " simulated."
    ),
    "roughness": (
        "Of the skin's surface for the light that it reflects (GGX alpha): 0.1 oily, 0.5 dry."
    ),
    "specular_over_noise": (
        "What the surface reflects, by the brightest light, over the noise. Good: above 10."
    ),
    "residual_over_noise": (
        "What the specular image leaves unexplained, over the noise. Good: below 1.5."
    ),
    "misfit": (
        "Part of the light that no matt surface with the given normals explains, median. Good: near"
        " `photometric_misfit`, that of the normals that the photographs themselves give."
    ),
    "contradicted": (
        "Fraction of the surface where the photographs contradict the given normals. Good: below"
        " 0.02."
    ),
    "separation": (
        "What was done about specular reflection and about light that spreads below the surface."
    ),
}
"""Name in ``quality`` or ``facts`` to what it means and what good looks like."""


def _label(name: str) -> str:
    """Return a name as words."""
    return name.replace("_", " ")


PRINT_PPI = 500.0
"""Pixels an inch of ``print.png``. Source: ISO/IEC 19794-4, the usual resolution of prints."""
_FIELDS = ("phalange.ply", "height.tiff", "height.npz", "normals.png", "albedo.png")
FILES = (*_FIELDS, "print.png", "preview.png", "report.html", "report.json")


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

    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
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
    more = [name for name in pictures if name not in names]
    return report.write(target, [*names, *more, *step_files])


def preview_html(result: Reconstruction) -> str:
    """The shaded surface as an image element, small, for notebooks."""
    small = figures.small_fields(result, upright_frame(result, 400))
    data = data_uri(figures.view_from_above(small), photo=True)
    return f'<img src="{data}" alt="surface from above">'
