"""Fingers for other systems, and from them: captures, results, prints, templates and galleries as records and images.

One table of formats (:mod:`splitknit_match.records.print_formats`) says what can be read and written.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from splitknit import BadInput, Led, __version__, read_capture, read_result, reconstruct
from splitknit.errors import naming, refusing, require
from splitknit.imaging.geometry import gaussian_mean
from splitknit.io.atomic import atomic_folder
from splitknit.io.capture import photographs_hint
from splitknit.io.fields import read_json, text_of
from splitknit.io.light_list import write_light_list
from splitknit.io.prints import PrintFile, provenance_texts
from splitknit.io.provenance import file_hash, json_text, provenance
from splitknit.io.results import SURFACES as KINDS
from splitknit.io.results import surface_bytes
from splitknit.io.targets import check_target
from splitknit.model import no_progress
from splitknit.verbs import AnyPath, Progress, path
from splitknit_match.gallery.entry import Entry
from splitknit_match.gallery.export_job import ExportJob
from splitknit_match.gallery.file import GalleryFile, is_gallery
from splitknit_match.gallery.key import Key, key_of
from splitknit_match.matching.minutiae import extract
from splitknit_match.matching.minutiae_record import PPI, holds_minutiae, no_minutiae, unpack_minutiae
from splitknit_match.matching.template import VERSION, Template, unpack
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
from splitknit_match.records.minutiae_record import FINGER_CODES, IMPRESSIONS, FingerView
from splitknit_match.records.print_formats import FORMATS, WSQ_PPI, PrintFormat, Writing
from splitknit_match.records.templates import read_template

FACTS_FILE = "export.json"
SURFACES = (*KINDS, "lp")
"""Formats of surfaces, and of lights."""
_FORMAT = "splitknit-export"
_PARAMETERS = ("to", "finger", "impression", "compression", "device", "owner", "minutiae", "input_ppi", "preset")
_KEPT_PPI = (500, 1000)
"""Resolutions that records have; prints of others are resampled to 500."""
_INK = 70.0
"""Grey levels for one standard deviation of a template's ridges."""
_WINDOW_MM, _LEAST_SPREAD = 0.3, 0.3
"""Skin of a template whose levels differ less within a sigma of 0.3 mm has no ridges (ridges: about 1)."""
_CLOSED_MM = 1.5
"""Gaps in a template that are narrower than twice this are grey, and beside them no ridge ends."""

Facts = dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class _Item:
    """One finger on its way."""

    name: str
    """Name of the file to write, without suffix."""
    kind: str
    """``capture``, ``result``, ``print``, ``minutiae`` or ``template``."""
    picture: PrintFile | None = None
    view: FingerView | None = None
    """Its minutiae, where the source holds them."""
    made: Print | None = None
    """The picture as it was made of a surface or a template."""
    names: tuple[str, str] | None = None
    """Person and session, of a gallery."""


def export_records(settings: ExportJob, progress: Progress = no_progress) -> dict[str, Any]:
    """Write fingers in a format of other systems, one file each, all or none; return the facts of ``export.json``.

    Raises BadInput, naming the source at fault: it cannot be read, holds no picture where one is needed, or nothing at
    all.
    """
    sources, out = [Path(source) for source in settings.sources], path(settings.out)
    key = key_of(path(settings.key_file))
    fingers = f"choose one of {', '.join(FINGER_CODES)}."
    known = settings.finger is None or settings.finger in FINGER_CODES
    require(known, f"'{settings.finger}' is not a finger; {fingers}")
    require(
        settings.impression is None or settings.impression in IMPRESSIONS,
        f"'{settings.impression}' is not an impression type; choose one of {', '.join(IMPRESSIONS)}.",
    )
    require(len(sources) > 0, "name what is to be exported: captures, results, prints, records or galleries.")
    for source in sources:
        check_target(out, FACTS_FILE, "an earlier export", keep=source)
    hashes: dict[str, str] = {}
    rows: list[dict[str, Any]] = []
    taken: set[str] = set()
    with atomic_folder(out) as folder:
        for number, source in enumerate(sources):
            progress(source.name, number / len(sources))
            own: dict[str, str] = {}
            if settings.to in SURFACES:
                write = _lights if settings.to == "lp" else _surface
                rows.append(write(source, folder, settings, taken, hashes))
                continue
            for item in _items(source, settings, key, own):
                form = FORMATS[settings.to or ("iso-19794-2" if item.picture is None else "png")]
                file = _free(item.name, form.suffix, taken)
                data, facts = naming(source, lambda: _written(item, form, settings, own))  # noqa: B023
                (folder / file).write_bytes(data)
                hashes |= own
                rows.append({"file": file, "source": str(source), "kind": item.kind, **facts})
        require(len(rows) > 0, f"'{sources[0]}' holds no finger to export.")
        date = None if settings.date is None else settings.date.isoformat()
        parameters = {**{name: getattr(settings, name) for name in _PARAMETERS}, "date": date}
        facts = {
            "format": _FORMAT,
            "to": settings.to,
            "files": rows,
            "failures_to_acquire": [one["file"] for one in rows if one.get("minutiae") == 0],
            "provenance": provenance(parameters, hashes),
        }
        (folder / FACTS_FILE).write_text(json_text(facts), encoding="utf-8")
    progress("done", 1.0)
    return {**facts, "out": str(out)}


def import_records(
    files: Sequence[AnyPath], out: AnyPath, input_ppi: float | None = None, progress: Progress = no_progress
) -> dict[str, Any]:
    """Write prints of other systems as PNG, their minutiae as ISO/IEC 19794-2; as :func:`export_records`.

    Raises BadInput, naming the file at fault.
    """
    for file in map(Path, files):
        require(
            not file.is_dir(),
            f"'{file}' is a folder; photographs of a folder are imported by `folder` {file} `lights` FILE.",
        )
    return export_records(ExportJob(tuple(files), to=None, out=out, input_ppi=input_ppi), progress)


# What a source holds.


def _items(source: Path, settings: ExportJob, key: Key | None, hashes: dict[str, str]) -> Iterator[_Item]:
    try:
        found, folder = source.exists(), source.is_dir()
    except (OSError, ValueError):
        found, folder = False, False
    require(found, f"there is no '{source}'; name a capture, a result, a print, a record or a gallery.")
    name = _safe(source.resolve().name if folder else source.stem)
    if folder and (source / "print.png").is_file() and (source / "map.npz").is_file():
        yield _of_print_folder(source, name, hashes)
    elif folder or source.suffix.lower() == ".npz":
        yield _of_surface(source, name, settings, hashes)
    else:
        hashes[source.name] = file_hash(source)
        if is_gallery(source):
            yield from _of_gallery(source, key)
        elif source.suffix.lower() == ".skt":
            payload = read_template(source, VERSION)
            require(len(payload) > 0, f"'{source}' is a failure to acquire: it holds no finger.")
            yield naming(source, lambda: _of_payload(name, payload))
        else:
            prints = read_print_file(source, settings.input_ppi)
            for number, held in enumerate(prints, start=1):
                one = name if len(prints) == 1 else f"{name}-{number}"
                if isinstance(held, PrintFile):
                    yield _Item(one, "print", held)
                else:
                    yield _Item(one, "minutiae", view=held)


def _of_surface(source: Path, name: str, settings: ExportJob, hashes: dict[str, str]) -> _Item:
    """Print of a capture or a result, as ``splitknit print`` makes it."""
    known = not source.is_dir() or any((source / one).is_file() for one in ("capture.json", "height.npz"))
    require(
        known,
        f"'{source}' is not a capture (capture.json), result (height.npz) or print (print.png); name one "
        f"{photographs_hint(source)}.",
    )
    taken = read_source(source, photo=False, surface=True, preset=settings.preset)
    hashes.update(taken.hashes)
    made = naming(source, lambda: make_print(taken, "unroll", None, PPI))
    finger, text = coded_finger(taken.subject.get("finger")), _contactless("unroll", taken.pitch_mm)
    return _Item(name, taken.kind, PrintFile(made.image, PPI, text, finger, "contactless"), made=made)


def _contactless(method: str, pitch_mm: float) -> dict[str, str]:
    """Fields of ANSI/NIST-ITL: the technology of the capture (6: light, unrolled by the shape; 7: ridges of a surface),
    its resolution, and that it is no contact print.
    """
    light, ppi = method in ("photo", "specular"), str(round(25.4 / pitch_mm))
    what = "light of the skin" if light else "ridges of a surface"
    comment = f"no contact print: {what}, printed by splitknit {__version__}, method {method}"
    return {"SHPS": ppi, "SVPS": ppi, "COM": comment, "FCT": "6" if light else "7"}


def _lights(source: Path, folder: Path, _: ExportJob, taken: set[str], hashes: dict[str, str]) -> Facts:
    capture = read_capture(source)
    band = capture.bands.get("white")
    names = read_json(source / "capture.json", f"{source}: capture.json is damaged.")[0]["bands"].get("white", {})
    if band is None or len(names.get("images", ())) != len(band.lights):
        raise BadInput(f"'{source}' has no band 'white' with one photograph for each light.")
    hashes.update(capture.hashes)
    rows = capture.rig.select(band.lights).light_vectors()
    leds = [Led("white", direction=(float(x), float(y), float(z))) for x, y, z in rows]
    file = _free(_safe(source.resolve().name), ".lp", taken)
    write_light_list(leds, folder / file, names["images"])
    return {"file": file, "source": str(source), "kind": "capture", "lights": len(leds)}


def _surface(
    source: Path, folder: Path, settings: ExportJob, taken: set[str], hashes: dict[str, str]
) -> dict[str, Any]:
    arrays = source / "height.npz" if source.is_dir() else source
    if source.is_dir() and not arrays.is_file() and (source / "capture.json").is_file():
        capture = read_capture(source)
        hashes.update(capture.hashes)
        kind, result = "capture", naming(source, lambda: reconstruct(capture, settings.preset))
    else:
        named = arrays.suffix.lower() == ".npz" and arrays.is_file()
        require(named, f"'{source}' has no surface to export; name a result (height.npz) or a capture (capture.json).")
        hashes[f"{source.name}/{arrays.name}"] = file_hash(arrays)
        kind, result = "result", read_result(source)
    assert settings.to is not None
    title = f"splitknit {provenance({}, {})['version']}, preset {result.preset or settings.preset}"
    facts, content = naming(source, lambda: surface_bytes(result, cast(str, settings.to), title))
    file = _free(_safe(source.resolve().name if source.is_dir() else source.stem), f".{settings.to}", taken)
    (folder / file).write_bytes(content)
    return {"file": file, "source": str(source), "kind": kind, **facts}


def _of_print_folder(source: Path, name: str, hashes: dict[str, str]) -> _Item:
    picture, view = read_print_folder(source)
    about = read_json(source / "report.json")[0]
    method, text, impression = text_of(about, "method", f"{source}: report.json"), {}, "live_plain"
    if method != "file":  # that was a print of a finger's contact already
        with refusing(f"{source}: report.json states no source.pitch_mm; make the print again."):
            pitch_mm = float(about["source"]["pitch_mm"])
        text, impression = _contactless(method, pitch_mm), "contactless"
    if view is not None:
        view = dataclasses.replace(view, impression=impression)
        hashes[f"{source.name}/minutiae.iso"] = file_hash(source / "minutiae.iso")
    hashes[f"{source.name}/print.png"] = file_hash(source / "print.png")
    finger = "unknown" if view is None else view.finger
    return _Item(name, "print", dataclasses.replace(picture, text=text, finger=finger, impression=impression), view)


def _of_gallery(source: Path, key: Key | None) -> Iterator[_Item]:
    with GalleryFile(source, key) as opened:
        people = opened.people()
    for one in people.entries.values():
        payload = people.templates[one.row]
        if payload:  # the others are failures to acquire
            stem = _safe("_".join(one.names))
            yield naming(f"row {one.row} of '{source}'", lambda: _of_payload(stem, payload, one))  # noqa: B023


def _of_payload(name: str, payload: bytes, entry: Entry | None = None) -> _Item:
    """A template: the minutiae that it holds, or a print of its ridges."""
    finger = coded_finger(None if entry is None else entry.finger)
    impression = "live_plain" if entry is not None and entry.kind in ("print", "minutiae") else "contactless"
    names = None if entry is None else (entry.person, entry.session)
    if holds_minutiae(payload):
        view = finger_view(unpack_minutiae(payload), 0, finger, impression)
        return _Item(name, "template", view=view, names=names)
    made = _template_print(unpack(payload))
    return _Item(name, "template", PrintFile(made.image, PPI, {}, finger, impression), made=made, names=names)


def _template_print(template: Template) -> Print:
    """Print of 500 ppi that a template's ridges make: dark, mirrored, four grey levels made smooth, paper elsewhere.

    Raises BadInput if the template is empty, or has no ridges.
    """
    require(not template.empty, "the template is a failure to acquire: it holds no ridges.")
    scale, sigma = PPI * template.pitch_mm / 25.4, _WINDOW_MM / template.pitch_mm
    value = template.value()
    spread = np.sqrt(np.maximum(gaussian_mean(value * value, sigma) - gaussian_mean(value, sigma) ** 2, np.float32(0)))
    there = (template.valid & (spread > _LEAST_SPREAD)).astype(np.uint8)  # rims are of one level, and no ridges
    radius = round(_CLOSED_MM / template.pitch_mm)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    closed = cv2.morphologyEx(np.pad(there, radius), cv2.MORPH_CLOSE, disc)[radius:-radius, radius:-radius]
    ridges, weight = (
        np.asarray(
            cv2.resize(np.ascontiguousarray(one[:, ::-1]), None, fx=scale, fy=scale, interpolation=how), np.float32
        )
        for one, how in ((value * there, cv2.INTER_CUBIC), (closed.astype(np.float32), cv2.INTER_LINEAR))
    )
    inside = weight > 0.5
    image = np.where(inside, np.clip(127.5 - _INK * ridges, 0, 255), 255.0).astype(np.uint8)
    return pressed_print(PrintFile(image, PPI, {}), inside)


def _free(stem: str, suffix: str, taken: set[str]) -> str:
    """A file name that is not taken yet, on no system."""
    names = (f"{stem}{end}{suffix}" for end in ("", *(f"-{number}" for number in range(2, len(taken) + 3))))
    name = next(name for name in names if name.casefold() not in taken)
    taken.add(name.casefold())
    return name


def _safe(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]", "_", name).strip(".")[:100] or "finger"


# A finger in the format that was asked for.


def _written(
    item: _Item, form: PrintFormat, settings: ExportJob, hashes: dict[str, str]
) -> tuple[bytes, dict[str, Any]]:
    stated = item.view or item.picture
    assert stated is not None
    finger = settings.finger or stated.finger
    touched = stated.impression == "unknown" and item.kind == "print"
    impression = settings.impression or ("live_plain" if touched else stated.impression)
    facts: dict[str, Any] = {"finger": finger, "impression": impression}
    if item.picture is not None and (item.picture.doubt or item.picture.note):
        facts["note"] = " ".join(filter(None, (item.picture.doubt, item.picture.note)))
    if item.names is not None:
        facts |= {"person": item.names[0], "session": item.names[1]}
    text = provenance_texts(provenance({"to": form.name}, hashes))
    device = {} if settings.device is None else {"MMS": settings.device}
    how = Writing(settings.compression, settings.date, text=text, owner=settings.owner)
    if form.holds == "image":
        if item.picture is None:
            raise BadInput(
                f"it holds minutiae and no picture, but {form.words} is for pictures; write iso-19794-2 or ansi-378."
            )
        text = {**item.picture.text, **device}
        picture = _fitting(dataclasses.replace(item.picture, text=text, finger=finger, impression=impression), form)
        facts |= {"size": list(picture.image.shape), "ppi": round(picture.resolution_ppi or 0.0, 2)}
        if form.name in ("iso-19794-4-2011", "iso-39794-4"):
            how = dataclasses.replace(how, quality=minutiae_in(picture, "none", item.made).finger_quality)
            facts["quality"] = how.quality
        number = hashlib.sha256(picture.image.tobytes()).hexdigest()[:16]
        return cast(Any, form.encode)(picture, dataclasses.replace(how, control_number=number)), facts
    view = item.view
    if view is None:
        assert item.picture is not None
        view = minutiae_in(item.picture, settings.minutiae, item.made)
    view = dataclasses.replace(view, finger=finger, impression=impression)
    facts |= {"size": list(view.size), "minutiae": view.count, "quality": view.finger_quality}
    return cast(Any, form.encode)(view, how), facts


def _fitting(held: PrintFile, form: PrintFormat) -> PrintFile:
    """A print of a resolution that the format has."""
    ppi = held.resolution_ppi or PPI
    near = next((float(usual) for usual in _KEPT_PPI if abs(ppi / usual - 1) < 0.005), None)
    if form.name in ("png", "tiff"):
        return held
    if near is None or (form.name == "wsq" and near != WSQ_PPI):
        return print_at_500_ppi(held)
    return dataclasses.replace(held, resolution_ppi=near)


def minutiae_in(picture: PrintFile, how: str = "phase", made: Print | None = None) -> FingerView:
    """Minutiae and quality of a print, at 500 ppi; none where it has no ridges (failure to acquire)."""
    try:
        made = made or pressed_print(picture)
        enhanced = enhance(made, PPI)
    except BadInput:
        size = print_at_500_ppi(picture).image.shape
        return finger_view(no_minutiae((size[0], size[1])), 0)
    found = no_minutiae((made.image.shape[0], made.image.shape[1]))
    if how == "mindtct":
        found = extract(made.image, PPI, enhance=made.even is not None)
    elif how == "phase":
        found = minutiae_by_phase(made, enhanced, PPI)
    return finger_view(found, round(measured(made, enhanced, PPI).score))
