"""A print's folder: the pictures, the minutiae, the distortion, and the report."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import asdict
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from splitknit import BadInput
from splitknit.errors import naming
from splitknit.findings import Finding, worst_first
from splitknit.io.atomic import atomic_folder, write_file
from splitknit.io.npz import write_npz
from splitknit.io.prints import write_print_png
from splitknit.io.provenance import canonical_json, file_hash, json_text, provenance
from splitknit.model import GreyArray, Progress
from splitknit_match.prints.fingerphoto import FingerPhoto
from splitknit_match.prints.from_file import (
    contact_print,
    finger_view,
    pressed_print,
    read_one_finger,
)
from splitknit_match.prints.make import Print, enhance, measured, minutiae_by_phase
from splitknit_match.prints.print_quality import PrintQuality
from splitknit_match.prints.sources import Source
from splitknit_match.records.minutiae_files import encode_minutiae_record
from splitknit_match.records.minutiae_record import PPI, Minutiae
from splitknit_match.records.pictures import PrintFile

if TYPE_CHECKING:
    from splitknit_match.rolled.finger import Rolled

Facts = dict[str, Any]


def write_print(
    out: Path,
    path: Path,
    source: Source,
    printed: Print,
    *,
    method: str,
    around: Rolled | None,
    progress: Progress,
) -> Facts:
    """Enhance a print and write all its files; return the facts of ``report.json``.

    `path`: of the finger; `around`: the finger of a rolled print. Raises BadInput, naming `path`,
    without ridges.
    """
    place = printed.map.surface
    ppi = printed.map.ppi
    mm2 = (25.4 / ppi) ** 2
    with atomic_folder(out) as target:
        chart = {} if around is None else {"rolled": {"pitch_mm": round(around.chart.pitch_mm, 6)}}
        origin = provenance(
            {"method": method, **chart, "surface": place, "ppi": ppi}, source.hashes
        )
        progress("enhancing", 0.85)
        enhanced = naming(path, lambda: enhance(printed))
        progress("writing", 0.92)
        texts = {"Software": f"splitknit {origin['version']}", "Comment": canonical_json(origin)}
        pictures = {"print": printed.image, "enhanced": enhanced.image}
        for name, picture in pictures.items():
            write_print_png(target / f"{name}.png", picture, ppi, texts)
        arrays = {
            name: getattr(printed.map, name)
            for name in ("columns", "rows", "input_from_grid", "print_of_grid")
        }
        write_npz(
            target / "map.npz", {**arrays, "ppi": np.float64(ppi), "surface": np.array(place)}
        )
        p5, median, p95 = np.percentile(
            enhanced.field.period_mm(ppi)[enhanced.field.mask], [5, 50, 95]
        ).round(4)
        quality = measured(printed, enhanced)
        score = quality.score if source.quality is None else source.quality
        minutiae = minutiae_by_phase(printed, enhanced)
        impression = "live_plain" if method == "file" else "contactless"
        view = finger_view(minutiae, score, source.subject.get("finger"), impression)
        write_file(target / "minutiae.iso", encode_minutiae_record(view))
        facts = {
            "method": method,
            "surface": place,
            "source": {
                "path": str(path),
                "kind": source.kind,
                "preset": source.preset,
                "pitch_mm": source.pitch_mm,
            },
            "ppi": ppi,
            "size": list(printed.image.shape),
            "mirrored": True,
            "ridges": "dark",
            "ridge_period_mm": {"p5": float(p5), "median": float(median), "p95": float(p95)},
            "area_mm2": round(float(printed.weight.sum()) * mm2, 1),
            "ridge_area_mm2": round(float(enhanced.mask.sum()) * mm2, 1),
            "quality": _quality_facts(quality, source.quality, pictures, ppi),
            "minutiae": {"count": view.count, "finger": view.finger},
        }
        findings = [*source.findings]
        # nobody captures a file again; flanks that shine are not edges; a photograph has its own,
        # and what is not skin is not captured better
        if source.quality is None and source.skin and method not in ("file", "specular"):
            findings += advice(quality)
        if printed.distortion is not None:
            facts["distortion"] = printed.distortion
        if around is not None:
            from splitknit_match.prints.rolled import write_rolled  # slow to import

            facts["rolled"] = write_rolled(target, around)
            findings += around.findings
        elif source.height_mm is not None:
            page = _page(source, printed, minutiae, pictures, {"facts": facts, "quality": score})
            write_file(target / "report.html", page.encode("utf-8"))
        facts["findings"] = [finding.facts for finding in worst_first(findings)]
        facts["provenance"] = origin
        facts["files"] = sorted([file.name for file in target.iterdir()] + ["report.json"])
        write_file(target / "report.json", json_text(facts).encode("ascii"))
    progress("done", 1.0)
    return facts


def print_of_file(
    path: Path, resolution_ppi: float | None, ridges: str | None
) -> tuple[Source, Print]:
    """The only print of a file. Raises BadInput, naming it, if it holds minutiae or has no
    ridges."""
    item = read_one_finger(path, resolution_ppi, ridges)
    if not isinstance(item, PrintFile):
        raise BadInput(
            f"'{path}' holds minutiae and no picture to print; name a print, a result or a capture."
        )
    source = Source(
        "print",
        np.ones(item.image.shape, dtype=bool),
        25.4 / (item.resolution_ppi or PPI),
        np.eye(3),
        item.image.shape,
        hashes={path.name: file_hash(path)},
        subject={"finger": item.finger},
        findings=item.findings,
    )
    return source, naming(path, lambda: pressed_print(item))


def print_of_photo(photo: FingerPhoto) -> tuple[Source, Print]:
    """The print of a photograph of a finger."""
    ridges = photo.pressed
    source = Source(
        "photo",
        ridges.inside,
        photo.pitch_mm,
        np.eye(3),
        photo.flat.shape,
        hashes=photo.hashes,
        findings=photo.findings,
        quality=photo.quality,
    )
    return source, contact_print(photo.flat, ridges, photo.map)


def _page(
    source: Source,
    printed: Print,
    minutiae: Minutiae,
    pictures: Mapping[str, GreyArray],
    words: Facts,
) -> str:
    """The surface in three dimensions with the print's minutiae on it, and the print; `words`: of
    the template."""
    from splitknit.report import template
    from splitknit.report.photos import captioned
    from splitknit.report.surface import PageSurface, scene, upright_surface

    assert source.height_mm is not None and source.ridge_mm is not None
    known = source.mask & np.isfinite(source.height_mm)
    surface = upright_surface(
        (source.height_mm, source.ridge_mm),
        known,
        source.pitch_mm,
        source.input_from_upright,
        xy_mm=source.xy_mm,
    )
    places = np.stack([minutiae.x_px, minutiae.y_px], axis=1).astype(np.float64)
    turn = minutiae.direction_rad
    beyond = places + 4.0 * np.stack([np.cos(turn), -np.sin(turn)], axis=1)  # rows run downwards
    start, end = (
        surface.places_mm(printed.map.input_from_print(each)) for each in (places, beyond)
    )
    circles = np.stack([*start, np.arctan2(*(end - start)[::-1])], axis=1)
    circles = circles[np.isfinite(circles).all(axis=1)]
    captions = (
        "As ink on paper: ridges dark, mirrored against the camera image.",
        "Ridges made even.",
    )
    figures = zip(pictures.items(), captions, strict=True)
    page: str = template(Path(__file__).with_name("print.html")).render(
        scene=scene(
            [PageSurface("Minutiae: circles, with a line along the ridge", surface, None, circles)]
        ),
        pictures=[
            captioned(name.capitalize(), picture, caption) for (name, picture), caption in figures
        ],
        count=minutiae.count,
        **words,
    )
    return page


# Quality of a print in the report: NFIQ 2, the figures and score of `prints.print_quality`, and
# advice.


def _quality_facts(
    quality: PrintQuality,
    photo: float | None,
    pictures: Mapping[str, GreyArray],
    ppi: float,
) -> Facts:
    """What ``report.json`` holds under ``quality``: plain numbers; `photo`: quality of a
    photograph."""
    from splitknit_match.prints.minutiae import NFIQ2_FAILED, nfiq2  # large, and not everywhere

    figures = asdict(quality.figures)
    facts = {
        "nfiq2": None,
        "ours": round(quality.score, 1),
        "figures": {
            name: None if value is None else round(value, 3) for name, value in figures.items()
        },
        "worth": {name: round(rating, 3) for name, rating in quality.worth.items()},
    }
    if photo is not None:  # NFIQ 2 is not for photographs
        return {**facts, "photo": photo}
    with contextlib.suppress(BadInput):  # the package for it is missing
        values = {name: nfiq2(picture, ppi) for name, picture in pictures.items()}
        facts["nfiq2"] = {
            name: None if value == NFIQ2_FAILED else value for name, value in values.items()
        }
    return facts


_MIN_RATING = 0.7
"""A figure of a lower rating is mentioned. Chosen on: simulated fingers (with and without a fault,
scale 0.4)."""
_FULL_RATING = 0.95
"""Rating of the ridges' height from which on soft edges are the finger's own. Chosen on: simulated
fingers (with and without a fault, scale 0.4)."""


def advice(quality: PrintQuality) -> tuple[Finding, ...]:
    """What is wrong with a print and what to do, at most three findings, the worst first; empty if
    nothing is.

    Every figure rated below 0.7 is mentioned; of figures with one remedy only the worst.
    """
    figures = {name: value or 0.0 for name, value in asdict(quality.figures).items()}
    percent = {"lost": 100.0 * (1.0 - figures["ridge_share"]), "gaps": 100.0 * figures["gap_share"]}
    sharp = quality.worth.get("ridge_height_um", 0.0) >= _FULL_RATING
    findings: dict[Finding, None] = {}
    for name, rating in sorted(quality.worth.items(), key=itemgetter(1)):
        # defocus lowers ridges as well; soft but high ones grew that way
        if rating < _MIN_RATING and not (sharp and name == "sharpness"):
            code, sentence = _ADVICE[name]
            findings[Finding(code, sentence.format(**figures, **percent))] = None
    return tuple(findings)[:3]


_NOISE = (
    "noisy-ridges",
    "The picture is noisy or the finger dusty (directions or distances of ridges disagree); wipe"
    " it, lengthen the exposure, keep the finger still, and capture again.",
)
_PARTIAL = (
    "few-ridges",
    "Only {ridge_length_mm:.0f} mm of ridges ({ridge_area_mm2:.0f} mm2) are in view; push the"
    " finger further in, its pad to the camera, and capture again.",
)
_ADVICE = {
    "ridge_height_um": (
        "weak-ridges",
        "Ridges are weak ({ridge_height_um:.0f} um), missing over {lost:.0f} % of the area: dry,"
        " worn, wet or out of focus; moisten the finger if it is dry, dry it if it is wet, check"
        " the focus, and capture again.",
    ),
    "ridge_share": (
        "missing-ridges",
        "Ridges are missing over {lost:.0f} % of the finger's area; check focus and exposure, clean"
        " finger and lens, and capture again.",
    ),
    "gap_share": (
        "gaps-in-ridges",
        "{gaps:.0f} % of the skin between ridges shows none: glare, a crease, a scar, water, dirt"
        " or blur; wipe the finger and the lens, check the focus, and capture again.",
    ),
    "coherence": _NOISE,
    "plausible_share": _NOISE,
    "sharpness": (
        "soft-ridges",
        "The ridges' edges are soft; focus the camera on the finger, keep it still, and capture"
        " again.",
    ),
    "ridge_area_mm2": _PARTIAL,
    "ridge_length_mm": _PARTIAL,
    "centre_offset_mm": (
        "off-centre",
        "The ridges lie {centre_offset_mm:.0f} mm beside the finger's middle; turn its pad to the "
        "camera and capture again.",
    ),
}
"""Codes and sentences by the figure that is rated low."""
