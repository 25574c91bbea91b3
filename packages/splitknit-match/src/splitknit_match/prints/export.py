"""Fingers for other systems, and from them: captures, results and prints as records, images and meshes.

One table of formats (:mod:`splitknit_match.records.print_formats`) says what can be read and written.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from splitknit import BadInput, Led, read_capture, read_result, reconstruct
from splitknit.arguments import AnyPath
from splitknit.errors import naming, require
from splitknit.io.atomic import atomic_folder
from splitknit.io.capture import photographs_hint
from splitknit.io.fields import read_json, text_of
from splitknit.io.light_list import write_light_list
from splitknit.io.prints import PrintFile, provenance_texts
from splitknit.io.provenance import file_hash, json_text, provenance
from splitknit.io.results import SURFACES as MESHES
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
from splitknit_match.records.minutiae_record import FINGER_CODES, IMPRESSIONS, FingerView
from splitknit_match.records.print_formats import FORMATS, WSQ_PPI, PrintFormat, Writing

FACTS_FILE = "export.json"
SURFACES = (*MESHES, "lp")
"""Formats of surfaces, and of lights."""
_FORMAT = "splitknit-export"
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


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """How fingers are written."""

    to: str | None = None
    """A format; None: pictures as PNG, minutiae as ISO 19794-2."""
    finger: str | None = None
    impression: str | None = None
    """Which finger and kind of impression it is; None: as the sources state."""
    compression: str = "none"
    owner: int = 0x0103
    minutiae: str = "phase"
    """``phase`` or ``mindtct``: how they are found."""
    input_ppi: float | None = None
    preset: str = "metric"


def export_records(
    sources: Sequence[Path], out: Path, options: ExportOptions, progress: Progress = no_progress
) -> Facts:
    """Write fingers in a format of other systems, one file each, all or none; return the facts of ``export.json``.

    Raises BadInput, naming the source at fault: it cannot be read, holds no picture where one is needed, or nothing at
    all.
    """
    known = options.finger is None or options.finger in FINGER_CODES
    require(known, f"'{options.finger}' is not a finger; choose one of {', '.join(FINGER_CODES)}.")
    known = options.impression is None or options.impression in IMPRESSIONS
    require(known, f"'{options.impression}' is not an impression type; choose one of {', '.join(IMPRESSIONS)}.")
    require(sources, "name what is to be exported: captures, results, prints or records.")
    for source in sources:
        check_target(out, FACTS_FILE, "an earlier export", keep=source)
    hashes: dict[str, str] = {}
    rows: list[Facts] = []
    taken: set[str] = set()
    with atomic_folder(out) as folder:
        for number, source in enumerate(sources):
            progress(source.name, number / len(sources))
            if options.to in SURFACES:
                write = _write_lights if options.to == "lp" else _write_mesh
                rows.append(write(source, folder, options, taken, hashes))
                continue
            own: dict[str, str] = {}
            for finger in _fingers(source, options, own):
                form = FORMATS[options.to or ("iso-19794-2" if finger.picture is None else "png")]
                data, facts = naming(source, lambda: _encoded(finger, form, options, own))  # noqa: B023
                file = _free(finger.name, form.suffix, taken)
                (folder / file).write_bytes(data)
                rows.append({"file": file, "source": str(source), "kind": finger.kind, **facts})
            hashes |= own
        require(rows, f"'{sources[0]}' holds no finger to export.")
        facts = {
            "format": _FORMAT,
            "to": options.to,
            "files": rows,
            "failures_to_acquire": [row["file"] for row in rows if row.get("minutiae") == 0],
            "provenance": provenance(options, hashes),
        }
        (folder / FACTS_FILE).write_text(json_text(facts), encoding="utf-8")
    progress("done", 1.0)
    return {**facts, "out": str(out)}


def import_records(
    files: Sequence[AnyPath], out: AnyPath, input_ppi: float | None = None, progress: Progress = no_progress
) -> Facts:
    """Write prints of other systems as PNG, their minutiae as ISO/IEC 19794-2; as :func:`export_records`.

    Raises BadInput, naming the file at fault.
    """
    for file in map(Path, files):
        cure = f"photographs of a folder are imported by `images` {file} `lights` FILE"
        require(not file.is_dir(), f"'{file}' is a folder; {cure}.")
    return export_records([Path(file) for file in files], Path(out), ExportOptions(input_ppi=input_ppi), progress)


# What a source holds.


def _fingers(source: Path, options: ExportOptions, hashes: dict[str, str]) -> Iterator[_Finger]:
    try:
        there, folder = source.exists(), source.is_dir()
    except (OSError, ValueError):
        there, folder = False, False
    require(there, f"there is no '{source}'; name a capture, a result, a print or a record.")
    name = _safe(source.resolve().name if folder else source.stem)
    if folder and (source / "print.png").is_file() and (source / "map.npz").is_file():
        yield _of_print_folder(source, name, hashes)
    elif folder or source.suffix.lower() == ".npz":
        yield _of_surface(source, name, options, hashes)
    else:
        hashes[source.name] = file_hash(source)
        prints = read_print_file(source, options.input_ppi)
        for number, held in enumerate(prints, start=1):
            numbered = name if len(prints) == 1 else f"{name}-{number}"
            if isinstance(held, PrintFile):
                yield _Finger(numbered, "print", held)
            else:
                yield _Finger(numbered, "minutiae", view=held)


def _of_surface(source: Path, name: str, options: ExportOptions, hashes: dict[str, str]) -> _Finger:
    """Print of a capture or a result, as ``splitknit print`` makes it."""
    known = not source.is_dir() or any((source / file).is_file() for file in ("capture.json", "height.npz"))
    kinds = "a capture (capture.json), result (height.npz) or print (print.png)"
    require(known, f"'{source}' is not {kinds}; name one {photographs_hint(source)}.")
    taken = read_source(source, photo=False, surface=True, preset=options.preset)
    hashes.update(taken.hashes)
    made = naming(source, lambda: make_print(taken, "unroll", None, PPI))
    finger = coded_finger(taken.subject.get("finger"))
    return _Finger(name, taken.kind, PrintFile(made.image, PPI, {}, finger, "contactless"), made=made)


def _of_print_folder(source: Path, name: str, hashes: dict[str, str]) -> _Finger:
    picture, view = read_print_folder(source)
    method = text_of(read_json(source / "report.json")[0], "method", f"{source}: report.json")
    impression = "live_plain" if method == "file" else "contactless"  # of a print of a finger's contact
    if view is not None:
        view = dataclasses.replace(view, impression=impression)
        hashes[f"{source.name}/minutiae.iso"] = file_hash(source / "minutiae.iso")
    hashes[f"{source.name}/print.png"] = file_hash(source / "print.png")
    finger = "unknown" if view is None else view.finger
    return _Finger(name, "print", dataclasses.replace(picture, finger=finger, impression=impression), view)


def _write_lights(source: Path, folder: Path, _: ExportOptions, taken: set[str], hashes: dict[str, str]) -> Facts:
    capture = read_capture(source)
    band = capture.bands.get("white")
    names = read_json(source / "capture.json", f"{source}: capture.json is damaged.")[0]["bands"].get("white", {})
    if band is None or len(names.get("images", ())) != len(band.lights):
        raise BadInput(f"'{source}' has no band 'white' with one photograph for each light.")
    hashes.update(capture.hashes)
    vectors = capture.rig.select(band.lights).light_vectors()
    leds = [Led("white", direction=(float(x), float(y), float(z))) for x, y, z in vectors]
    file = _free(_safe(source.resolve().name), ".lp", taken)
    write_light_list(leds, folder / file, names["images"])
    return {"file": file, "source": str(source), "kind": "capture", "lights": len(leds)}


def _write_mesh(source: Path, folder: Path, options: ExportOptions, taken: set[str], hashes: dict[str, str]) -> Facts:
    arrays = source / "height.npz" if source.is_dir() else source
    if source.is_dir() and not arrays.is_file() and (source / "capture.json").is_file():
        capture = read_capture(source)
        hashes.update(capture.hashes)
        kind, result = "capture", naming(source, lambda: reconstruct(capture, options.preset))
    else:
        named = arrays.suffix.lower() == ".npz" and arrays.is_file()
        require(named, f"'{source}' has no surface to export; name a result (height.npz) or a capture (capture.json).")
        hashes[f"{source.name}/{arrays.name}"] = file_hash(arrays)
        kind, result = "result", read_result(source)
    assert options.to is not None
    title = f"splitknit {provenance({}, {})['version']}, preset {result.preset or options.preset}"
    facts, content = naming(source, lambda: surface_bytes(result, cast(str, options.to), title))
    file = _free(_safe(source.resolve().name if source.is_dir() else source.stem), f".{options.to}", taken)
    (folder / file).write_bytes(content)
    return {"file": file, "source": str(source), "kind": kind, **facts}


def _free(stem: str, suffix: str, taken: set[str]) -> str:
    """A file name that is not taken yet, on no system."""
    names = (f"{stem}{end}{suffix}" for end in ("", *(f"-{number}" for number in range(2, len(taken) + 3))))
    name = next(name for name in names if name.casefold() not in taken)
    taken.add(name.casefold())
    return name


def _safe(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]", "_", name).strip(".")[:100] or "finger"


# A finger in the format that was asked for.


def _encoded(item: _Finger, form: PrintFormat, options: ExportOptions, hashes: dict[str, str]) -> tuple[bytes, Facts]:
    stated = item.view or item.picture
    assert stated is not None
    finger = options.finger or stated.finger
    touched = stated.impression == "unknown" and item.kind == "print"
    impression = options.impression or ("live_plain" if touched else stated.impression)
    facts: Facts = {"finger": finger, "impression": impression}
    if item.picture is not None and (item.picture.doubt or item.picture.note):
        facts["note"] = " ".join(filter(None, (item.picture.doubt, item.picture.note)))
    if form.holds == "image":
        if item.picture is None:
            cure = "write iso-19794-2 or ansi-378"
            raise BadInput(f"it holds minutiae and no picture, but {form.words} is for pictures; {cure}.")
        picture = _fitting(dataclasses.replace(item.picture, finger=finger, impression=impression), form)
        facts |= {"size": list(picture.image.shape), "ppi": round(picture.resolution_ppi or 0.0, 2)}
        quality = None
        if form.name == "iso-39794-4":
            quality = facts["quality"] = minutiae_in(picture, "none", item.made).finger_quality
        text = provenance_texts(provenance({"to": form.name}, hashes))
        return cast(Any, form.encode)(picture, Writing(options.compression, text, quality, options.owner)), facts
    view = item.view
    if view is None:
        assert item.picture is not None
        view = minutiae_in(item.picture, options.minutiae, item.made)
    view = dataclasses.replace(view, finger=finger, impression=impression)
    facts |= {"size": list(view.size), "minutiae": view.count, "quality": view.finger_quality}
    return cast(Any, form.encode)(view, Writing(owner=options.owner)), facts


def _fitting(picture: PrintFile, form: PrintFormat) -> PrintFile:
    """A print of a resolution that the format has."""
    if form.name in ("png", "tiff"):
        return picture
    ppi = picture.resolution_ppi or PPI
    near = next((float(kept) for kept in _KEPT_PPI if abs(ppi / kept - 1) < 0.005), None)
    if near is None or (form.name == "wsq" and near != WSQ_PPI):
        return print_at_500_ppi(picture)
    return dataclasses.replace(picture, resolution_ppi=near)


def minutiae_in(picture: PrintFile, how: str, made: Print | None = None) -> FingerView:
    """Minutiae and quality of a print, at 500 ppi; none where it has no ridges (failure to acquire)."""
    try:
        made = made or pressed_print(picture)
        enhanced = enhance(made, PPI)
    except BadInput:
        size = print_at_500_ppi(picture).image.shape
        return finger_view(no_minutiae((size[0], size[1])), 0)
    minutiae = no_minutiae((made.image.shape[0], made.image.shape[1]))
    if how == "mindtct":
        minutiae = extract(made.image, PPI, enhance=made.even is not None)
    elif how == "phase":
        minutiae = minutiae_by_phase(made, enhanced, PPI)
    return finger_view(minutiae, round(measured(made, enhanced, PPI).score))
