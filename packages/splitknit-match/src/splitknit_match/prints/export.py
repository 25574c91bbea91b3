"""Fingers for other systems, and from them: captures, results and prints as records, images and meshes.

One table of formats (:mod:`splitknit_match.records.print_formats`) says what can be read and written.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from splitknit import BadInput, Led, read_capture, read_result, reconstruct
from splitknit.errors import naming, require
from splitknit.io.atomic import atomic_folder
from splitknit.io.capture import photographs_hint
from splitknit.io.fields import read_json, text_of
from splitknit.io.light_list import write_light_list
from splitknit.io.prints import PrintFile, provenance_texts
from splitknit.io.provenance import file_hash, json_text, provenance
from splitknit.io.results import surface_bytes
from splitknit.io.targets import check_target
from splitknit.model import Progress, no_progress
from splitknit_match.prints.from_file import (
    coded_finger,
    finger_view,
    pressed_print,
    print_at_500_ppi,
    read_print_file,
    read_print_folder,
)
from splitknit_match.prints.make import Print, enhance, make_print, measured, minutiae_by_phase
from splitknit_match.prints.minutiae import extract
from splitknit_match.prints.minutiae_record import PPI, no_minutiae
from splitknit_match.prints.sources import read_source
from splitknit_match.records.minutiae_record import FINGER_CODES, IMPRESSIONS, VENDOR_UNKNOWN, FingerView
from splitknit_match.records.print_formats import FORMATS, WSQ_PPI, PrintFormat, Writing

FACTS_FILE = "export.json"
_KEPT_PPI = (500, 1000)
"""Resolutions that records have; prints of others are resampled to 500."""

Facts = dict[str, Any]


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
    made: Print | None = None
    """The picture as it was made of a surface."""

    def labelled(self, finger: str | None, impression: str | None) -> _Finger:
        """The same as another finger or impression, where these are given."""
        stated = self.view or self.picture
        assert stated is not None
        if impression is None:
            touched = stated.impression == "unknown" and self.kind == "print"
            impression = "live_plain" if touched else stated.impression
        label: Any = {"finger": finger or stated.finger, "impression": impression}
        picture = self.picture and replace(self.picture, **label)
        return replace(self, picture=picture, view=self.view and replace(self.view, **label))


def export_records(
    sources: Sequence[Path],
    out: Path,
    *,
    to: str | None = None,
    finger: str | None = None,
    impression: str | None = None,
    compression: str = "none",
    owner: int = VENDOR_UNKNOWN,
    minutiae: str = "phase",
    input_ppi: float | None = None,
    preset: str = "metric",
    progress: Progress = no_progress,
) -> Facts:
    """Write fingers in a format of other systems, one file each, all or none; return the facts of ``export.json``.

    `to`: a name of `FORMATS`; by default PNG, and ISO/IEC 19794-2 where there are only minutiae. Raises BadInput,
    naming the source at fault: it cannot be read, holds no picture where one is needed, or nothing at all.
    """
    known = finger is None or finger in FINGER_CODES
    require(known, f"'{finger}' is not a finger; choose one of {', '.join(FINGER_CODES)}.")
    known = impression is None or impression in IMPRESSIONS
    require(known, f"'{impression}' is not an impression type; choose one of {', '.join(IMPRESSIONS)}.")
    parameters = {
        "to": to, "finger": finger, "impression": impression, "compression": compression, "owner": owner,
        "minutiae": minutiae, "input_ppi": input_ppi, "preset": preset,
    }  # fmt: skip
    _check_target(sources, out)
    rows: list[Facts] = []
    hashes: dict[str, str] = {}
    with atomic_folder(out) as folder:
        for number, source in enumerate(sources):
            progress(source.name, number / len(sources))
            own: dict[str, str] = {}
            for read in _fingers(source, own, input_ppi, preset):
                item = read.labelled(finger, impression)
                form = FORMATS[to or ("iso-19794-2" if item.picture is None else "png")]
                writing = Writing(compression, owner=owner)
                if form.holds == "image":
                    work = partial(_picture_bytes, item, form, writing, own)
                else:
                    work = partial(_minutiae_bytes, item, form, writing, minutiae)
                data, facts = naming(source, work)
                file = _free(item.name, form.suffix, rows)
                (folder / file).write_bytes(data)
                rows.append({"file": file, "source": str(source), "kind": item.kind, **facts})
            hashes |= own
        return _write_facts(folder, out, rows, parameters, hashes)


def export_meshes(sources: Sequence[Path], out: Path, to: str, preset: str, progress: Progress = no_progress) -> Facts:
    """Write the surfaces of captures and results, or the lights of captures (`to` lp); as :func:`export_records`."""
    _check_target(sources, out)
    rows: list[Facts] = []
    hashes: dict[str, str] = {}
    with atomic_folder(out) as folder:
        for number, source in enumerate(sources):
            progress(source.name, number / len(sources))
            file = _free(_safe(source.resolve().name if source.is_dir() else source.stem), f".{to}", rows)
            kind, facts = "capture", {}
            if to == "lp":
                facts = _write_lights(source, folder / file, hashes)
            else:
                kind, facts = _write_mesh(source, folder / file, to, preset, hashes)
            rows.append({"file": file, "source": str(source), "kind": kind, **facts})
        return _write_facts(folder, out, rows, {"to": to, "preset": preset}, hashes)


def _check_target(sources: Sequence[Path], out: Path) -> None:
    require(sources, "name what is to be exported: captures, results, prints or records.")
    for source in sources:
        check_target(out, FACTS_FILE, "an earlier export", keep=source)


def _write_facts(folder: Path, out: Path, rows: list[Facts], parameters: Facts, hashes: dict[str, str]) -> Facts:
    facts = {
        "format": "splitknit-export",
        "to": parameters["to"],
        "files": rows,
        "failures_to_acquire": [row["file"] for row in rows if row.get("minutiae") == 0],
        "provenance": provenance(parameters, hashes),
    }
    (folder / FACTS_FILE).write_text(json_text(facts), encoding="utf-8")
    return {**facts, "out": str(out)}


# What a source holds.


def _fingers(source: Path, hashes: dict[str, str], input_ppi: float | None, preset: str) -> Iterator[_Finger]:
    require(os.path.exists(source), f"there is no '{source}'; name a capture, a result, a print or a record.")  # noqa: PTH110
    folder = source.is_dir()
    name = _safe(source.resolve().name if folder else source.stem)
    if folder and (source / "print.png").is_file() and (source / "map.npz").is_file():
        yield _of_print_folder(source, name, hashes)
    elif folder or source.suffix.lower() == ".npz":
        yield _of_surface(source, name, preset, hashes)
    else:
        hashes[source.name] = file_hash(source)
        prints = read_print_file(source, input_ppi)
        for number, item in enumerate(prints, start=1):
            numbered = name if len(prints) == 1 else f"{name}-{number}"
            if isinstance(item, PrintFile):
                yield _Finger(numbered, "print", item)
            else:
                yield _Finger(numbered, "minutiae", view=item)


def _of_surface(source: Path, name: str, preset: str, hashes: dict[str, str]) -> _Finger:
    """Print of a capture or a result, as ``splitknit print`` makes it."""
    known = not source.is_dir() or any((source / file).is_file() for file in ("capture.json", "height.npz"))
    kinds = "a capture (capture.json), result (height.npz) or print (print.png)"
    require(known, f"'{source}' is not {kinds}; name one {photographs_hint(source)}.")
    surface = read_source(source, photo=False, surface=True, preset=preset)
    hashes.update(surface.hashes)
    made = naming(source, lambda: make_print(surface, "unroll", None, PPI))
    finger = coded_finger(surface.subject.get("finger"))
    return _Finger(name, surface.kind, PrintFile(made.image, PPI, {}, finger, "contactless"), made=made)


def _of_print_folder(source: Path, name: str, hashes: dict[str, str]) -> _Finger:
    picture, view = read_print_folder(source)
    method = text_of(read_json(source / "report.json")[0], "method", f"{source}: report.json")
    impression = "live_plain" if method == "file" else "contactless"  # of a print of a finger's contact
    if view is not None:
        view = replace(view, impression=impression)
        hashes[f"{source.name}/minutiae.iso"] = file_hash(source / "minutiae.iso")
    hashes[f"{source.name}/print.png"] = file_hash(source / "print.png")
    finger = "unknown" if view is None else view.finger
    return _Finger(name, "print", replace(picture, finger=finger, impression=impression), view)


def _write_lights(source: Path, file: Path, hashes: dict[str, str]) -> Facts:
    capture = read_capture(source)
    band = capture.bands.get("white")
    names = read_json(source / "capture.json", f"{source}: capture.json is damaged.")[0]["bands"].get("white", {})
    if band is None or len(names.get("images", ())) != len(band.lights):
        raise BadInput(f"'{source}' has no band 'white' with one photograph for each light.")
    hashes.update(capture.hashes)
    vectors = capture.rig.select(band.lights).light_vectors()
    leds = [Led("white", direction=(float(x), float(y), float(z))) for x, y, z in vectors]
    write_light_list(leds, file, names["images"])
    return {"lights": len(leds)}


def _write_mesh(source: Path, file: Path, to: str, preset: str, hashes: dict[str, str]) -> tuple[str, Facts]:
    arrays = source / "height.npz" if source.is_dir() else source
    if source.is_dir() and not arrays.is_file() and (source / "capture.json").is_file():
        capture = read_capture(source)
        hashes.update(capture.hashes)
        kind, result = "capture", naming(source, lambda: reconstruct(capture, preset))
    else:
        named = arrays.suffix.lower() == ".npz" and arrays.is_file()
        require(named, f"'{source}' has no surface to export; name a result (height.npz) or a capture (capture.json).")
        hashes[f"{source.name}/{arrays.name}"] = file_hash(arrays)
        kind, result = "result", read_result(source)
    title = f"splitknit {provenance({}, {})['version']}, preset {result.preset or preset}"
    facts, content = naming(source, lambda: surface_bytes(result, to, title))
    file.write_bytes(content)
    return kind, facts


def _free(stem: str, suffix: str, rows: Sequence[Facts]) -> str:
    """A file name that is not taken yet, on no system."""
    taken = {row["file"].casefold() for row in rows}
    names = (f"{stem}{end}{suffix}" for end in ("", *(f"-{number}" for number in range(2, len(taken) + 3))))
    return next(name for name in names if name.casefold() not in taken)


def _safe(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]", "_", name).strip(".")[:100] or "finger"


# A finger in the format that was asked for.


def _facts_of(item: _Finger) -> Facts:
    stated = item.view or item.picture
    assert stated is not None
    facts: Facts = {"finger": stated.finger, "impression": stated.impression}
    if item.picture is not None and (item.picture.doubt or item.picture.note):
        facts["note"] = " ".join(filter(None, (item.picture.doubt, item.picture.note)))
    return facts


def _picture_bytes(item: _Finger, form: PrintFormat, writing: Writing, hashes: dict[str, str]) -> tuple[bytes, Facts]:
    if item.picture is None:
        cure = "write iso-19794-2 or ansi-378"
        raise BadInput(f"it holds minutiae and no picture, but {form.words} is for pictures; {cure}.")
    picture = _fitting(item.picture, form)
    facts = _facts_of(item) | {"size": list(picture.image.shape), "ppi": round(picture.resolution_ppi or 0.0, 2)}
    if form.name == "iso-39794-4":
        facts["quality"] = _minutiae_in(picture, "none", item.made).finger_quality
    text = provenance_texts(provenance({"to": form.name}, hashes))
    writing = replace(writing, text=text, quality=facts.get("quality"))
    assert form.encode is not None
    return form.encode(picture, writing), facts


def _minutiae_bytes(item: _Finger, form: PrintFormat, writing: Writing, how: str) -> tuple[bytes, Facts]:
    view = item.view
    if view is None:
        assert item.picture is not None
        view = _minutiae_in(item.picture, how, item.made)
    facts = _facts_of(item) | {"size": list(view.size), "minutiae": view.count, "quality": view.finger_quality}
    assert form.encode is not None
    return form.encode(view, writing), facts


def _fitting(picture: PrintFile, form: PrintFormat) -> PrintFile:
    """A print of a resolution that the format has."""
    if form.name in ("png", "tiff"):
        return picture
    ppi = picture.resolution_ppi or PPI
    near = next((float(kept) for kept in _KEPT_PPI if abs(ppi / kept - 1) < 0.005), None)
    if near is None or (form.name == "wsq" and near != WSQ_PPI):
        return print_at_500_ppi(picture)
    return replace(picture, resolution_ppi=near)


def _minutiae_in(picture: PrintFile, how: str, made: Print | None = None) -> FingerView:
    """Minutiae and quality of a print, at 500 ppi; none where it has no ridges (failure to acquire)."""
    label = picture.finger, picture.impression
    try:
        made = made or pressed_print(picture)
        enhanced = enhance(made, PPI)
    except BadInput:
        size = print_at_500_ppi(picture).image.shape
        return finger_view(no_minutiae((size[0], size[1])), 0, *label)
    minutiae = no_minutiae((made.image.shape[0], made.image.shape[1]))
    if how == "mindtct":
        minutiae = extract(made.image, PPI, enhance=made.even is not None)
    elif how == "phase":
        minutiae = minutiae_by_phase(made, enhanced, PPI)
    return finger_view(minutiae, round(measured(made, enhanced, PPI).score), *label)
