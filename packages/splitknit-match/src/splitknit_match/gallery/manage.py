"""A gallery as a folder of plain files, and back: ``templates/0001.skt`` ..., ``gallery.csv`` and ``gallery.json``."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

from splitknit import BadInput
from splitknit.errors import read_bytes, refusing, require
from splitknit.io.atomic import atomic_folder
from splitknit.io.csv_table import csv_text, plain_text
from splitknit.io.fields import read_json, text_of
from splitknit.io.provenance import json_text
from splitknit.io.targets import check_target
from splitknit_match.gallery.enrol import LARGEST_RAW, content_of
from splitknit_match.gallery.entry import Entry, NewCapture, check_person
from splitknit_match.gallery.file import GalleryFile
from splitknit_match.matching.minutiae_record import holds_minutiae, unpack_minutiae
from splitknit_match.matching.template import VERSION, unpack
from splitknit_match.records.templates import encode_template, read_template

TABLE_FILE, FACTS_FILE = "gallery.csv", "gallery.json"
_FORMAT, _VERSION = "splitknit-gallery-export", 1
_FIELDS = ("person", "finger", "session", "kind", "source_sha256", "area_mm2", "failure", "enrolled_at", "images")
_COLUMNS = ("template", *_FIELDS, "image")
_SUFFIX = {"thumbnail": "png", "raw": "zip"}
_MAX_TABLE_BYTES = 50_000_000
"""A quarter of a million captures."""


def export_gallery(
    gallery: GalleryFile, out: Path, *, images: bool = False, person: str | None = None
) -> dict[str, Any]:
    """Write all of a gallery, **not encrypted**, into a folder that only its owner may read; return facts.

    Of a `person`, where one is named, everything that is kept: images as well. Raises BadInput if the gallery or a row
    of it cannot be read, or the folder not be written; nothing is written then.
    """
    check_target(out, TABLE_FILE, "an earlier export of a gallery")
    rows = gallery.entries(None if person is None else check_person(person))
    require(person is None or len(rows) > 0, f"'{gallery.path}' holds nothing of person '{person}'.")
    numbers = [one.row for one in rows]
    templates = gallery.templates(numbers)
    kept = gallery.images(numbers) if images or person is not None else {}
    about = {"format": _FORMAT, "version": _VERSION, "template_version": VERSION}
    about["settings_sha256"] = gallery.settings_sha256
    table: list[list[Any]] = [[*_COLUMNS]]
    with atomic_folder(out) as folder:
        folder.chmod(0o700)
        for number, one in enumerate((one for one in rows if one.row in templates), start=1):
            name = f"templates/{number:04d}.skt"
            _write(folder / name, encode_template(templates[one.row], VERSION))
            image = ""
            if one.row in kept:
                image = f"images/{number:04d}.{_SUFFIX[one.images]}"
                _write(folder / image, kept[one.row])
            table.append([name, *(getattr(one, column) for column in _FIELDS), image])
        _write(folder / TABLE_FILE, csv_text(table).encode("utf-8"))
        _write(folder / FACTS_FILE, json_text(about).encode("ascii"))
    return {"gallery": str(gallery.path), "out": str(out), "captures": len(rows), "images": len(kept)}


def import_gallery(gallery: GalleryFile, folder: Path, *, replaces: bool = False) -> dict[str, Any]:
    """Put what was exported into a gallery (made where there is none), all or none; return facts.

    Raises BadInput if the folder is not an export, damaged or of another version, or its templates were made with other
    settings than the gallery's.
    """
    about = _read_about(folder)
    captures = _read_table(folder)
    created = not gallery.there
    added = gallery.add(captures, about["settings_sha256"], replaces=replaces)
    facts = asdict(content_of(gallery, created=created))
    return {**facts, "folder": str(folder), "found": len(captures), "new": sum(added)}


def _write(file: Path, data: bytes) -> None:
    file.parent.mkdir(mode=0o700, exist_ok=True)
    file.touch(mode=0o600)
    file.write_bytes(data)


def _read_about(folder: Path) -> dict[str, Any]:
    file = folder / FACTS_FILE
    require(file.is_file(), f"'{folder}' is not an export of a gallery: it holds no {FACTS_FILE}.")
    document, _ = read_json(file)
    known = text_of(document, "format", str(file)) == _FORMAT
    sound = known and re.fullmatch("[0-9a-f]{64}", text_of(document, "settings_sha256", str(file)))
    versions = document.get("version"), document.get("template_version")
    require(
        bool(sound) and all(type(one) is int for one in versions),
        f"'{file}' is damaged, or not of an export; export the gallery again.",
    )
    require(
        versions == (_VERSION, VERSION),
        f"'{folder}' is an export of version {versions[0]} with templates of version {versions[1]}, but this program "
        f"reads {_VERSION} and {VERSION}; enrol the fingers again.",
    )
    return dict(document)


def _read_table(folder: Path) -> list[NewCapture]:
    file = folder / TABLE_FILE
    data = read_bytes(file, _MAX_TABLE_BYTES)
    with refusing(f"'{file}' cannot be read as a table; export the gallery again."):
        rows = list(csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True))
        rows = [{key: plain_text(cell) if isinstance(cell, str) else cell for key, cell in row.items()} for row in rows]
    require(len(rows) > 0, f"'{file}' lists no finger.")
    _check_rows(rows, file)
    found = []
    for number, row in enumerate(rows, start=2):
        try:
            found.append(_capture(folder, row))
        except (BadInput, ValueError) as error:
            raise BadInput(f"'{file}', line {number}: {error}") from error
    return found


def _check_rows(rows: list[dict[str, str]], file: Path) -> None:
    """Refuse what is not complete or there twice before any of the files is read."""
    lines: dict[tuple[str, ...], int] = {}
    for number, row in enumerate(rows, start=2):
        complete = all(isinstance(row.get(column), str) for column in _COLUMNS)
        require(complete, f"'{file}', line {number}: the columns {', '.join(_COLUMNS)} are expected.")
        for columns in (("person", "finger", "session"), ("template",)):
            first = lines.setdefault((*columns, *(row[column] for column in columns)), number)
            require(
                first == number,
                f"'{file}', lines {first} and {number} have the same {', '.join(columns)}; remove one of them.",
            )


def _capture(folder: Path, row: dict[str, str]) -> NewCapture:
    # names of files are checked: a table from elsewhere must not lead out of the folder
    named = re.fullmatch(r"templates/\d{1,9}\.skt", row["template"]) is not None
    require(named, f"a template is named such as templates/0001.skt, not {row['template'][:60]!a}.")
    payload = read_template(folder / row["template"], VERSION)
    empty = (unpack_minutiae(payload).count == 0) if holds_minutiae(payload) else unpack(payload).empty
    image = None
    if row["image"]:
        named = re.fullmatch(r"images/\d{1,9}\.(png|zip)", row["image"]) is not None
        require(named, f"an image is named such as images/0001.png, not {row['image'][:60]!a}.")
        kind = next(kind for kind, suffix in _SUFFIX.items() if row["image"].endswith(suffix))
        require(
            row["images"] == kind,
            f"the column 'images' must be '{kind}' where the image is {row['image']}, not {row['images'][:60]!a}.",
        )
        image = read_bytes(folder / row["image"], LARGEST_RAW)
    values: dict[str, Any] = {column: row[column] for column in _FIELDS}
    values["area_mm2"] = 0.0 if empty else float(row["area_mm2"])
    values["images"] = row["images"] if image is not None else ""
    return NewCapture(Entry(**values), payload, image)
