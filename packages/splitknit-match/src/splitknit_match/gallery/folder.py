"""A gallery as a folder of plain files, and back: ``templates/0001.skt`` ..., ``gallery.csv`` and
``gallery.json``."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

from splitknit import BadInput
from splitknit.errors import refusing, require
from splitknit.files import read_bytes
from splitknit.io.atomic import atomic_folder
from splitknit.io.csv_table import csv_text, plain_text
from splitknit.io.fields import read_json, text_of
from splitknit.io.provenance import json_text
from splitknit.io.targets import check_target
from splitknit_match.gallery.file import FIELDS, Entry, GalleryFile, NewCapture, check_person
from splitknit_match.gallery.gallery import content_of
from splitknit_match.matching.template import VERSION, unpack
from splitknit_match.records.minutiae_record import holds_minutiae, unpack_minutiae
from splitknit_match.records.templates import encode_template, read_template

TABLE_FILE, FACTS_FILE = "gallery.csv", "gallery.json"
_FORMAT, _VERSION = "splitknit-gallery-export", 1
_FIELDS = ("person", "finger", "session", *FIELDS[:-1])
_COLUMNS = ("template", *_FIELDS)


def export_gallery(gallery: GalleryFile, out: Path, *, person: str | None = None) -> dict[str, Any]:
    """Write all of a gallery, or of a `person`, **not encrypted**, into a folder that only its
    owner may read.

    Returns facts. Raises BadInput if the gallery or a template of it cannot be read, or the folder
    not be written; nothing is written then.
    """
    check_target(out, TABLE_FILE, "an earlier export of a gallery")
    name = None if person is None else check_person(person)
    people = gallery.people(name)
    about = {"format": _FORMAT, "version": _VERSION, "template_version": VERSION}
    about["settings_sha256"] = people.settings_sha256
    table = [[*_COLUMNS]]
    with atomic_folder(out) as folder:
        folder.chmod(0o700)
        (folder / "templates").mkdir(mode=0o700)
        for number, entry in enumerate(people.of(name, None).entries, start=1):
            file = f"templates/{number:04d}.skt"
            _write(folder / file, encode_template(people.templates[entry.row], VERSION))
            table.append([file, *(getattr(entry, column) for column in _FIELDS)])
        _write(folder / TABLE_FILE, csv_text(table).encode("utf-8"))
        _write(folder / FACTS_FILE, json_text(about).encode("ascii"))
    return {"gallery": str(gallery.path), "out": str(out), "captures": len(table) - 1}


def import_gallery(gallery: GalleryFile, folder: Path, *, replaces: bool = False) -> dict[str, Any]:
    """Put what was exported into a gallery (made where there is none), all or none; return facts.

    Raises BadInput if the folder is not an export, damaged or of another version, or its templates
    were made with other settings than the gallery's.
    """
    settings_sha256 = _read_settings(folder)
    captures = _read_table(folder)
    created = not gallery.there
    added = gallery.add(captures, settings_sha256, replaces=replaces)
    facts = asdict(content_of(gallery, created=created))
    return {**facts, "folder": str(folder), "found": len(captures), "new": sum(added)}


def _write(file: Path, data: bytes) -> None:
    file.touch(mode=0o600)
    file.write_bytes(data)


def _read_settings(folder: Path) -> str:
    """Hash of the settings of the folder's templates."""
    file = folder / FACTS_FILE
    require(file.is_file(), f"'{folder}' is not an export of a gallery: it holds no {FACTS_FILE}.")
    document, _ = read_json(file)
    form, settings_sha256 = (
        text_of(document, key, str(file)) for key in ("format", "settings_sha256")
    )
    require(
        form == _FORMAT and re.fullmatch("[0-9a-f]{64}", settings_sha256) is not None,
        f"'{file}' is damaged, or not of an export; export the gallery again.",
    )
    versions = document.get("version"), document.get("template_version")
    require(
        versions == (_VERSION, VERSION),
        f"'{folder}' is an export of version {versions[0]!a} with templates of version"
        f" {versions[1]!a}, but this program reads {_VERSION} and {VERSION}; enrol the fingers"
        " again.",
    )
    return settings_sha256


def _read_table(folder: Path) -> list[NewCapture]:
    file = folder / TABLE_FILE
    # longest table of an exported folder: a quarter of a million captures
    data = read_bytes(file, 50_000_000)
    with refusing(f"'{file}' cannot be read as a table; export the gallery again."):
        rows = list(csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True))
    require(rows, f"'{file}' lists no finger.")
    captures, lines = [], dict[tuple[str, ...], int]()
    for number, row in enumerate(rows, start=2):
        require(
            all(isinstance(row.get(column), str) for column in _COLUMNS),
            f"'{file}', line {number}: the columns {', '.join(_COLUMNS)} are expected.",
        )
        try:
            capture = _capture(folder, {column: plain_text(row[column]) for column in _COLUMNS})
        except (BadInput, ValueError) as error:
            raise BadInput(f"'{file}', line {number}: {error}") from error
        first = lines.setdefault(capture.entry.names, number)
        require(
            first == number,
            f"'{file}', lines {first} and {number} are of the same finger and session; remove one"
            " of them.",
        )
        captures.append(capture)
    return captures


def _capture(folder: Path, row: dict[str, str]) -> NewCapture:
    # names of files are checked: a table from elsewhere must not lead out of the folder
    name = row["template"]
    require(
        re.fullmatch(r"templates/\d{1,9}\.skt", name) is not None,
        f"a template is named such as templates/0001.skt, not {name[:60]!a}.",
    )
    template = read_template(folder / name, VERSION)
    empty = (
        unpack_minutiae(template).count == 0 if holds_minutiae(template) else unpack(template).empty
    )
    values: dict[str, Any] = {column: row[column] for column in _FIELDS}
    values["area_mm2"] = 0.0 if empty else float(row["area_mm2"])
    return NewCapture(Entry(**values), template)
