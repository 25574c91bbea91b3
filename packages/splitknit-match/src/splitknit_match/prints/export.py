"""Fingers for other systems, and from them: captures, results and prints as records, images and
meshes.

One table of formats (:mod:`splitknit_match.records.print_formats`) says what can be read and
written.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from splitknit import BadInput, Led, Reconstruction, read_capture, read_result, reconstruct
from splitknit.arguments import count
from splitknit.errors import naming, require
from splitknit.findings import Finding, worst_first
from splitknit.io.atomic import atomic_folder
from splitknit.io.capture import photographs_hint
from splitknit.io.fields import read_json, text_of
from splitknit.io.light_list import write_light_list
from splitknit.io.prints import provenance_texts
from splitknit.io.provenance import file_hash, json_text, provenance
from splitknit.io.targets import check_target
from splitknit.model import Progress
from splitknit_match.prints.from_file import (
    coded_finger,
    finger_view,
    pressed_print,
    print_at_500_ppi,
    read_print_file,
    read_print_folder,
)
from splitknit_match.prints.make import Print, enhance, make_print, measured, minutiae_by_phase
from splitknit_match.prints.sources import read_source
from splitknit_match.records.minutiae_record import (
    FINGER_CODES,
    IMPRESSIONS,
    PPI,
    VENDOR_UNKNOWN,
    FingerView,
    no_minutiae,
)
from splitknit_match.records.pictures import PrintFile
from splitknit_match.records.print_formats import FORMATS, WSQ_PPI, PrintFormat, Writing
from splitknit_match.records.surface_files import surface_bytes

FACTS_FILE = "export.json"
_KEPT_PPI = (500, 1000)
"""Resolutions that records have; prints of others are resampled to 500. Source: the resolutions
that records of prints have."""

Facts = dict[str, Any]
File = tuple[str, str, Callable[[Path], object], Facts, tuple[Finding, ...]]
"""Name and suffix of a file to write, what writes it, its facts, and what is to be known of it."""


@dataclass(frozen=True, slots=True, eq=False)
class _Finger:
    """One finger on its way."""

    name: str
    """Name of the file to write, without suffix."""
    kind: str
    """``capture``, ``result``, ``print`` or ``minutiae``."""
    picture: PrintFile | None = None
    view: FingerView | None = None
    """Its minutiae, where the source holds them."""
    printed: Print | None = None
    """The picture as it was made of a surface."""


def export_records(
    sources: Sequence[Path],
    out: Path,
    *,
    to: str | None = None,
    finger: str | None = None,
    impression: str | None = None,
    compression: str = "none",
    owner: int = VENDOR_UNKNOWN,
    resolution_ppi: float | None,
    ridges: str | None,
    preset: str = "metric",
    progress: Progress,
) -> Facts:
    """Write fingers in a format of other systems, one file each, all or none; return the facts of
    ``export.json``.

    `to`: a name of `FORMATS`; by default PNG, and ISO/IEC 19794-2 where there are only minutiae.
    Raises BadInput, naming the source at fault: it cannot be read, holds no picture where one is
    needed, or nothing at all.
    """
    for value, known, noun in (
        (finger, FINGER_CODES, "a finger"),
        (impression, IMPRESSIONS, "an impression type"),
    ):
        require(
            value is None or value in known,
            f"'{value}' is not {noun}; choose one of {', '.join(known)}.",
        )
    parameters = {
        "to": to,
        "finger": finger,
        "impression": impression,
        "compression": compression,
        "owner": owner,
        "resolution_ppi": resolution_ppi,
        "ridges": ridges,
        "preset": preset,
    }

    def files(source: Path, hashes: dict[str, str]) -> Iterator[File]:
        for item in _fingers(source, hashes, resolution_ppi, ridges, preset):
            stated = item.view or item.picture
            assert stated is not None
            own = stated.impression
            if own == "unknown" and item.kind == "print":  # of a print of a finger's contact
                own = "live_plain"
            label: Any = {"finger": finger or stated.finger, "impression": impression or own}
            picture = item.picture and replace(item.picture, **label)
            view = item.view and replace(item.view, **label)
            form = FORMATS[to or ("iso-19794-2" if picture is None else "png")]
            facts: Facts = {"kind": item.kind, **label}
            findings = () if picture is None else picture.findings
            writing = Writing(
                compression, provenance_texts(provenance({"to": form.name}, hashes)), owner=owner
            )
            encode = partial(_encoded, picture, view, form, writing, item.printed)
            data, more = naming(source, encode)
            write = partial(Path.write_bytes, data=data)
            yield item.name, form.suffix, write, facts | more, findings

    return _exported(sources, out, files, parameters, progress)


def export_surfaces(
    sources: Sequence[Path],
    out: Path,
    to: str,
    *,
    preset: str,
    base_mm: float | None,
    progress: Progress,
) -> Facts:
    """Write the surfaces of captures and results, or the lights of captures (`to` lp); as
    :func:`export_records`."""

    def files(source: Path, hashes: dict[str, str]) -> Iterator[File]:
        name = _name_of(source)
        if to == "lp":
            write, facts = _lights(source, hashes)
            yield name, ".lp", write, facts, ()
            return
        result, facts = _surface(source, preset, hashes)
        title = f"splitknit {provenance({}, {})['version']}, preset {result.preset or preset}"
        more, data = naming(source, lambda: surface_bytes(result, to, title, base_mm))
        yield name, f".{to}", partial(Path.write_bytes, data=data), facts | more, ()

    parameters = {"to": to, "preset": preset, "base_mm": base_mm}
    return _exported(sources, out, files, parameters, progress)


def _exported(
    sources: Sequence[Path],
    out: Path,
    files: Callable[[Path, dict[str, str]], Iterator[File]],
    parameters: Facts,
    progress: Progress,
) -> Facts:
    """Write the files of all sources and ``export.json``; `files` adds the hashes of what it
    reads."""
    require(sources, "name what is to be exported: captures, results, prints or records.")
    for source in sources:
        check_target(out, FACTS_FILE, "an earlier export", keep=source)
    rows: list[Facts] = []
    findings = []
    hashes: dict[str, str] = {}
    with atomic_folder(out) as folder:
        for number, source in enumerate(sources):
            progress(source.name, number / len(sources))
            own: dict[str, str] = {}
            for stem, suffix, write, facts, of_file in files(source, own):
                # a name that is not taken yet, on no system
                taken = {row["file"].casefold() for row in rows}
                ends = ["", *(f"-{k}" for k in range(2, len(rows) + 3))]
                names = (f"{stem}{end}{suffix}" for end in ends)
                file = next(name for name in names if name.casefold() not in taken)
                write(folder / file)
                rows.append({"file": file, "source": str(source), **facts})
                findings += [finding.of_file(file) for finding in of_file]
            hashes |= own
        failed = [row["file"] for row in rows if row.get("minutiae") == 0]
        if failed:
            lacks = f"{count(len(failed), 'file')} without minutiae (failure to acquire)"
            words = f"{lacks}: {failed[0]} ..."
            findings.append(Finding("failure-to-acquire", words, files=tuple(failed)))
        facts = {
            "format": "splitknit-export",
            "to": parameters["to"],
            "files": rows,
            "failures_to_acquire": failed,
            "findings": [finding.facts for finding in worst_first(findings)],
            "provenance": provenance(parameters, hashes),
        }
        (folder / FACTS_FILE).write_text(json_text(facts), encoding="utf-8")
    return {**facts, "out": str(out)}


# What a source holds.


def _fingers(
    source: Path,
    hashes: dict[str, str],
    resolution_ppi: float | None,
    ridges: str | None,
    preset: str,
) -> Iterator[_Finger]:
    require(
        os.path.exists(source),  # noqa: PTH110
        f"there is no '{source}'; name a capture, a result, a print or a record.",
    )
    folder = source.is_dir()
    name = _name_of(source)
    if folder and (source / "print.png").is_file() and (source / "map.npz").is_file():
        yield _of_print_folder(source, name, hashes)
    elif folder or source.suffix.lower() == ".npz":
        yield _of_surface(source, name, preset, hashes)
    else:
        hashes[source.name] = file_hash(source)
        prints = read_print_file(source, resolution_ppi, ridges)
        for number, item in enumerate(prints, start=1):
            numbered = name if len(prints) == 1 else f"{name}-{number}"
            if isinstance(item, PrintFile):
                yield _Finger(numbered, "print", item)
            else:
                yield _Finger(numbered, "minutiae", view=item)


def _of_surface(source: Path, name: str, preset: str, hashes: dict[str, str]) -> _Finger:
    """Print of a capture or a result, as ``splitknit print`` makes it."""
    known = not source.is_dir() or any(
        (source / file).is_file() for file in ("capture.json", "height.npz")
    )
    kinds = "a capture (capture.json), result (height.npz) or print (print.png)"
    require(known, f"'{source}' is not {kinds}; name one {photographs_hint(source)}.")
    surface = read_source(source, photo=False, surface=True, preset=preset)
    hashes.update(surface.hashes)
    printed = naming(source, lambda: make_print(surface, "unroll"))
    finger = coded_finger(surface.subject.get("finger"))
    return _Finger(
        name,
        surface.kind,
        PrintFile(printed.image, PPI, {}, finger, "contactless"),
        printed=printed,
    )


def _of_print_folder(source: Path, name: str, hashes: dict[str, str]) -> _Finger:
    picture, view = read_print_folder(source)
    method = text_of(read_json(source / "report.json")[0], "method", f"{source}: report.json")
    # of a print of a finger's contact
    impression = "live_plain" if method == "file" else "contactless"
    if view is not None:
        view = replace(view, impression=impression)
        hashes[f"{source.name}/minutiae.iso"] = file_hash(source / "minutiae.iso")
    hashes[f"{source.name}/print.png"] = file_hash(source / "print.png")
    finger = "unknown" if view is None else view.finger
    return _Finger(name, "print", replace(picture, finger=finger, impression=impression), view)


def _lights(source: Path, hashes: dict[str, str]) -> tuple[Callable[[Path], object], Facts]:
    capture = read_capture(source)
    band = capture.bands.get("white")
    bands = read_json(source / "capture.json", f"{source}: capture.json is damaged.")[0]["bands"]
    photographs = bands.get("white", {}).get("images", ())
    lights = () if band is None else capture.rig.lights_of(band.leds)
    if len(photographs) != len(lights):
        raise BadInput(f"'{source}' has no band 'white' with one photograph for each light.")
    hashes.update(capture.hashes)
    vectors = capture.rig.select(lights).light_vectors().tolist()
    leds = [Led("white", direction=(x, y, z)) for x, y, z in vectors]
    facts = {"kind": "capture", "lights": len(leds)}
    return lambda file: write_light_list(leds, file, photographs), facts


def _surface(source: Path, preset: str, hashes: dict[str, str]) -> tuple[Reconstruction, Facts]:
    arrays = source / "height.npz" if source.is_dir() else source
    if not arrays.is_file() and (source / "capture.json").is_file():
        capture = read_capture(source)
        hashes.update(capture.hashes)
        return naming(source, lambda: reconstruct(capture, preset)), {"kind": "capture"}
    require(
        arrays.suffix.lower() == ".npz" and arrays.is_file(),
        f"'{source}' has no surface to export; name a result (height.npz) or a capture"
        " (capture.json).",
    )
    hashes[f"{source.name}/{arrays.name}"] = file_hash(arrays)
    return read_result(source), {"kind": "result"}


def _name_of(source: Path) -> str:
    """Name of a source as a file's, on any system."""
    name = source.resolve().name if source.is_dir() else source.stem
    return re.sub(r"[^A-Za-z0-9_.-]", "_", name).strip(".")[:100] or "finger"


# A finger in the format that was asked for.


def _encoded(
    picture: PrintFile | None,
    view: FingerView | None,
    form: PrintFormat,
    writing: Writing,
    printed: Print | None,
) -> tuple[bytes, Facts]:
    """Bytes of a finger, and facts of them."""
    assert form.encode is not None
    if form.holds == "minutiae":
        if view is None:
            assert picture is not None
            view = _minutiae_in(picture, printed)
        facts: Facts = {
            "size": list(view.size),
            "minutiae": view.count,
            "quality": view.finger_quality,
        }
        return form.encode(view, writing), facts
    if picture is None:
        raise BadInput(
            f"it holds minutiae and no picture, but {form.words} is for pictures; write iso-19794-2"
            " or ansi-378."
        )
    picture = _fitting(picture, form)
    facts = {"size": list(picture.image.shape), "ppi": round(picture.resolution_ppi or 0.0, 2)}
    if form.name == "iso-39794-4":
        facts["quality"] = _minutiae_in(picture, printed).finger_quality
    return form.encode(picture, replace(writing, quality=facts.get("quality"))), facts


def _fitting(picture: PrintFile, form: PrintFormat) -> PrintFile:
    """A print of a resolution that the format has."""
    if form.name in ("png", "tiff"):
        return picture
    ppi = picture.resolution_ppi or PPI
    near = next((float(kept) for kept in _KEPT_PPI if abs(ppi / kept - 1) < 0.005), None)
    if near is None or (form.name == "wsq" and near != WSQ_PPI):
        return print_at_500_ppi(picture)
    return replace(picture, resolution_ppi=near)


def _minutiae_in(picture: PrintFile, printed: Print | None) -> FingerView:
    """Minutiae and quality of a print, at 500 ppi; none where it has no ridges (failure to
    acquire)."""
    minutiae = no_minutiae(
        print_at_500_ppi(picture).image.shape if printed is None else printed.image.shape
    )
    quality = 0.0
    try:
        printed = printed or pressed_print(picture)
        enhanced = enhance(printed)
    except BadInput:
        pass
    else:
        quality = measured(printed, enhanced).score
        minutiae = minutiae_by_phase(printed, enhanced)
    return finger_view(minutiae, quality, picture.finger, picture.impression)
