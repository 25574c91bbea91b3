"""A print's folder: the pictures, the minutiae, the distortion, and the report."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import naming, require
from splitknit.io.atomic import atomic_folder, write_file
from splitknit.io.npz import write_npz
from splitknit.io.prints import PrintFile, write_print_png
from splitknit.io.provenance import JsonValue, canonical_json, file_hash, json_text, provenance
from splitknit.io.targets import check_target
from splitknit.model import no_progress
from splitknit.settings import override
from splitknit.verbs import Progress
from splitknit_match.matching.minutiae_record import PPI, Minutiae
from splitknit_match.matching.photo_finger import PhotoFinger
from splitknit_match.prints.enhance import Enhanced, as_print, ridge_mask, thin
from splitknit_match.prints.fingerphoto import USUAL_RIDGES, fingerphoto, read_fingerphoto
from splitknit_match.prints.from_file import finger_view, pressed_print, read_one_finger
from splitknit_match.prints.make import (
    Print,
    PrintingSettings,
    checked_surface,
    enhance,
    make_print,
    make_rolled_print,
    measured,
    minutiae_by_phase,
)
from splitknit_match.prints.pressed import pressed_ridges
from splitknit_match.prints.print_job import PrintJob
from splitknit_match.prints.print_map import PrintMap
from splitknit_match.prints.print_quality import PrintQuality
from splitknit_match.prints.rolled import read_rolled, write_rolled
from splitknit_match.prints.sources import Source, read_source
from splitknit_match.records.minutiae_files import encode_minutiae_record
from splitknit_match.rolled.finger import Rolled


def print_to_folder(job: PrintJob, progress: Progress = no_progress) -> dict[str, Any]:
    """Make a print of a capture or a result and write all its files; return the facts of ``report.json``.

    A print that is a file already is brought to 500 ppi and enhanced; a photograph of a finger is unrolled by a mean
    shape. Raises BadInput, naming the input at fault.
    """
    started = time.perf_counter()
    settings, path, out, ppi = override(PrintingSettings(), job.settings or {}), job.path, Path(job.out), float(job.ppi)
    method, place = _how(job)
    check_target(out, "map.npz", "an earlier print", keep=path)
    with atomic_folder(out) as target:
        source, around, given = _read(job, method, place, settings, progress)
        origin = provenance({**_parameters(method, settings), "surface": place, "ppi": ppi}, source.hashes)
        timings = {"reading": time.perf_counter() - started}
        progress("printing", 0.75)
        try:
            clock = time.perf_counter()
            made = given or _made(source, around, (method, place), ppi, settings)
            timings["printing"] = time.perf_counter() - clock
            progress("enhancing", 0.85)
            clock = time.perf_counter()
            enhanced = enhance(made, ppi)
            ridges = ridge_mask(enhanced)
            timings["enhancing"] = time.perf_counter() - clock
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from error
        progress("writing", 0.92)
        pictures = {
            "print.png": made.image,
            "enhanced.png": enhanced.image,
            "binary.png": as_print(ridges),
            "thinned.png": as_print(thin(ridges)),
        }
        _write_pictures(target, pictures, made.map, origin)
        periods = np.percentile(enhanced.field.period_mm(ppi)[enhanced.field.mask], [5, 50, 95]).tolist()
        facts: dict[str, Any] = {
            "method": method,
            "surface": place,
            "source": {"path": str(path), "kind": source.kind, "preset": source.preset, "pitch_mm": source.pitch_mm},
            "ppi": ppi,
            **({"scale": source.scale} if source.scale else {}),
            "size": list(made.image.shape),
            "mirrored": True,
            "ridges": "dark",
            "ridge_period_mm": {k: round(one, 4) for k, one in zip(("p5", "median", "p95"), periods, strict=True)},
            "area_mm2": round(float(made.weight.sum()) * (25.4 / ppi) ** 2, 1),
            "ridge_area_mm2": round(float(enhanced.mask.sum()) * (25.4 / ppi) ** 2, 1),
        }
        if made.unrolled is not None:
            facts["distortion"] = made.unrolled.distortion.figures()
        if around is not None:
            facts["rolled"] = write_rolled(target, around)
        clock = time.perf_counter()
        quality = measured(made, enhanced, ppi)
        timings["quality"] = time.perf_counter() - clock
        # nobody captures a file again; flanks that shine are not edges; NFIQ 2 is not for photographs
        advised = method not in ("file", "specular") and source.quality is None
        facts["quality"] = _quality_facts(
            quality, _nfiq2_of(pictures, ppi) if source.quality is None else None, source.quality, advised=advised
        )
        found, where = _minutiae_of(made, pictures, enhanced, settings.minutiae)
        facts["minutiae"] = {"written": False, "missing": where}
        if found is not None:
            score = round(quality.score if source.quality is None else source.quality)
            view = finger_view(
                found, score, source.subject.get("finger"), "live_plain" if method == "file" else "contactless"
            )
            facts["minutiae"] = {
                "written": True, "sought_in": where, "count": len(view.x_px), "finger": view.finger,
            }  # fmt: skip
            write_file(target / "minutiae.iso", encode_minutiae_record(view))
        timings["total"] = time.perf_counter() - started
        facts["timings_s"] = {name: round(value, 3) for name, value in timings.items()}
        facts["provenance"] = origin
        facts["files"] = sorted([path.name for path in target.iterdir()] + ["report.json"])
        write_file(target / "report.json", json_text(facts).encode("ascii"))
    progress("done", 1.0)
    return {**facts, "out": str(out)}


def _write_pictures(
    target: Path, pictures: Mapping[str, NDArray[np.uint8]], print_map: PrintMap, origin: dict[str, JsonValue]
) -> None:
    """Write the pictures, and where their pixels come from (``map.npz``)."""
    texts = {"Software": f"splitknit {origin['version']}", "Comment": canonical_json(origin)}
    for name, picture in pictures.items():
        write_print_png(target / name, picture, print_map.ppi, texts)
    arrays = {name: getattr(print_map, name) for name in ("columns", "rows", "input_from_grid", "print_of_grid")}
    arrays |= {"ppi": np.float64(print_map.ppi), "surface": np.array(print_map.surface)}
    write_npz(target / "map.npz", arrays)


def _how(job: PrintJob) -> tuple[str, str]:
    """Method, and where it is printed; ``file`` and ``paper`` for a print that is there already."""
    path = job.path
    photo = None if path.suffix.lower() == ".npz" else fingerphoto(path)
    require(
        photo is not None or (job.mask, job.box) == (None, None),
        f"`mask` and `box` choose the finger of a photograph in colour, and '{path}' is none.",
    )
    if not path.is_file() or path.suffix.lower() == ".npz":
        method = job.method or "unroll"
        return method, checked_surface(method, job.surface)
    if photo is not None:
        method = job.method or "photo"
        require(
            (method, job.ridge_period_mm, job.input_ppi) == ("photo", None, None),
            f"'{path}' is a photograph of a finger: its `method` is photo, its scale, if it is known, `px_per_mm`.",
        )
        return method, checked_surface(method, job.surface or "free")
    require(
        (job.method, job.surface, job.px_per_mm, job.ridge_period_mm, job.ppi) == (None, None, None, None, PPI),
        f"'{path}' is a print already, to be made one of 500 ppi; leave out `method`, `surface`, `ppi` and scales.",
    )
    return "file", "paper"


def _of_file(path: Path, input_ppi: float | None) -> tuple[Source, Print]:
    """A print from a file."""
    item = read_one_finger(path, input_ppi)
    if not isinstance(item, PrintFile):
        raise BadInput(f"'{path}' holds minutiae and no picture to print; name a print, a result or a capture.")
    made = naming(path, lambda: pressed_print(item))
    ppi = item.resolution_ppi or PPI
    source = Source(
        "print", np.ones(item.image.shape, dtype=np.bool_), 25.4 / ppi, np.eye(3), item.image.shape,
        hashes={path.name: file_hash(path)}, subject={"finger": item.finger},
        scale=" ".join(filter(None, (item.doubt, item.note))),
    )  # fmt: skip
    return source, made


def _read(
    job: PrintJob, method: str, place: str, settings: PrintingSettings, progress: Progress
) -> tuple[Source, Rolled | None, Print | None]:
    """What the print is made from, the finger around its front where the print is rolled, and a print from a file."""
    if method == "file":
        source, given = _of_file(job.path, job.input_ppi)
        return source, None, given
    if method == "photo" and job.path.is_file():
        return read_fingerphoto(job.path, job.px_per_mm, PhotoFinger(job.mask, job.box)), None, None
    if method == "rolled":
        unscaled = job.px_per_mm is None and job.ridge_period_mm is None
        require(unscaled, "a rig with mirrors has a scale; leave out `px_per_mm` and `ridge_period_mm`.")
        return *read_rolled(job.path, job.preset, settings.rolled, progress), None
    photo = method == "photo"
    source = read_source(
        job.path, photo=photo, surface=not photo or place != "plane", preset=job.preset, progress=progress,
        px_per_mm=job.px_per_mm, ridge_period_mm=job.ridge_period_mm,
    )  # fmt: skip
    return source, None, None


def _made(source: Source, around: Rolled | None, how: tuple[str, str], ppi: float, settings: PrintingSettings) -> Print:
    """The print of a source by a method, where it is made."""
    if around is not None:
        return make_rolled_print(around, source, how[1], ppi)
    made = make_print(source, *how, ppi, settings)
    if source.quality is None or ppi != PPI:
        return made
    sure = pressed_ridges(made.image, USUAL_RIDGES)  # noise is as strong as a photograph's ridges
    weight = np.where(sure.inside, made.weight, np.float32(0))
    return replace(made, weight=weight, even=sure.image, confidence=sure.confidence)


def _parameters(method: str, settings: PrintingSettings) -> dict[str, Any]:
    """What a print follows from; the rolled finger's settings only where it is one."""
    found = {"method": method, **asdict(settings)}
    if method != "rolled":
        found.pop("rolled")
    return found


# Quality of a print in the report: NFIQ 2, the figures and score of `prints.print_quality`, and advice.

MAX_SENTENCES = 3
MIN_WORTH = 0.7
"""A figure of a lower rating is mentioned."""
FULL_WORTH = 0.95
"""Fraction of the ridges' height from which on soft edges are the finger's own."""


def _nfiq2_of(pictures: Mapping[str, NDArray[np.uint8]], ppi: float) -> dict[str, int | None] | None:
    """NFIQ 2 of ``print.png`` and ``enhanced.png``, None where it sees no print; None without the package for it."""
    from splitknit_match.matching.minutiae import NFIQ2_FAILED, nfiq2  # large, and not everywhere

    try:
        found = {name: nfiq2(pictures[f"{name}.png"], ppi) for name in ("print", "enhanced")}
    except BadInput:
        return None
    return {name: None if value == NFIQ2_FAILED else value for name, value in found.items()}


def _quality_facts(
    found: PrintQuality, nfiq2: dict[str, int | None] | None, photo: float | None = None, *, advised: bool = True
) -> dict[str, Any]:
    """What ``report.json`` holds under ``quality``: plain numbers and sentences."""

    def rounded(values: Mapping[str, float | None]) -> dict[str, float | None]:
        return {name: None if value is None else round(value, 3) for name, value in values.items()}

    return {
        "nfiq2": nfiq2,
        "ours": round(found.score, 1),
        **({} if photo is None else {"photo": photo}),
        "figures": rounded(asdict(found.figures)),
        "worth": rounded(found.worth),
        "advice": list(advice(found)) if advised else [],
    }


def advice(found: PrintQuality) -> tuple[str, ...]:
    """What is wrong with a print and what to do, at most three sentences, the worst first; empty if nothing is.

    Every figure rated below 0.7 is mentioned; of figures with one remedy only the worst.
    """
    sentences: dict[str, None] = {}
    causes: set[str] = set()
    for name, rating in sorted(found.worth.items(), key=lambda item: item[1]):
        cause = _CAUSES[name]
        if cause == "soft" and found.worth.get("ridge_height_um", 0.0) >= FULL_WORTH:
            continue  # defocus lowers ridges as well; soft but high ones grew that way
        if rating < MIN_WORTH and cause not in causes and len(sentences) < MAX_SENTENCES:
            causes.add(cause)
            sentences[_sentence(cause, name, found)] = None
    return tuple(sentences)


_CAUSES = {
    "ridge_height_um": "weak",
    "ridge_share": "lost",
    "gap_share": "gaps",
    "coherence": "noise",
    "plausible_share": "noise",
    "sharpness": "soft",
    "ridge_area_mm2": "partial",
    "ridge_length_mm": "partial",
    "centre_offset_mm": "beside",
}


def _sentence(cause: str, name: str, found: PrintQuality) -> str:
    figures = found.figures
    lost = 100 * (1 - figures.ridge_share)
    noise = "directions of ridges disagree" if name == "coherence" else "distances of ridges are not plausible"
    sentences = {
        "weak": f"Ridges are weak ({figures.ridge_height_um or 0:.0f} um), missing over {lost:.0f} % of the area: dry, "
        "worn, wet or out of focus; moisten the finger if it is dry, dry it if it is wet, check the focus, and capture "
        "again.",
        "lost": f"Ridges are missing over {lost:.0f} % of the finger's area; check focus and exposure, clean finger "
        "and lens, and capture again.",
        "gaps": f"{100 * figures.gap_share:.0f} % of the skin between ridges shows none: glare, a crease, a scar, "
        "water, dirt or blur; wipe the finger and the lens, check the focus, and capture again.",
        "noise": f"The picture is noisy or the finger dusty ({noise}); wipe it, lengthen the exposure, keep the finger "
        "still, and capture again.",
        "soft": "The ridges' edges are soft; focus the camera on the finger, keep it still, and capture again.",
        "partial": f"Only {figures.ridge_length_mm:.0f} mm of ridges ({figures.ridge_area_mm2:.0f} mm2) are in view; "
        "push the finger further in, its pad to the camera, and capture again.",
        "beside": f"The ridges lie {figures.centre_offset_mm:.0f} mm beside the finger's middle; turn its pad to the "
        "camera and capture again.",
    }
    return sentences[cause]


def _minutiae_of(
    made: Print, pictures: Mapping[str, NDArray[np.uint8]], enhanced: Enhanced, sought_in: str
) -> tuple[Minutiae | None, str]:
    """Minutiae of a print, and in which picture they were sought; or None, and what to install.

    By mindtct in ``print.png`` or ``enhanced.png`` of `pictures`, as `sought_in` (without ``.png``) says, or by the
    phase of the ridges (``phase``), which needs no package.
    """
    from splitknit_match.matching.minutiae import extract  # large, and not everywhere

    try:
        if sought_in == "phase":
            return minutiae_by_phase(made, enhanced, made.map.ppi), "print.png, by the phase"
        pressed = made.even is not None and sought_in == "print"
        return extract(pictures[f"{sought_in}.png"], made.map.ppi, enhance=pressed), f"{sought_in}.png"
    except BadInput as error:
        return None, f"{' '.join(str(error).split())} Or find them with `settings` minutiae=phase."
