"""A gallery after enrolment: its codes; as a folder of plain files, and back.

An export holds ``templates/0001.skt`` ..., ``gallery.csv`` and ``gallery.json``.
"""

from __future__ import annotations

import contextlib
import csv
import io
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import (
    BadInput,
    Fields,
    Progress,
    atomic_folder,
    check_target,
    csv_text,
    json_text,
    no_progress,
    plain_text,
    read_bytes,
    read_json,
    refusing,
    require,
)
from splitknit_match.gallery.enrol import LARGEST_RAW, MINUTIAE_HASH, code_of_payload, content_of
from splitknit_match.gallery.entry import Entry, NewCapture, check_person
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.key import Key
from splitknit_match.gallery.shards import write_shards
from splitknit_match.matching.code import CODE_VERSION, code_of, code_size
from splitknit_match.matching.minutiae_record import holds_minutiae, unpack_minutiae
from splitknit_match.matching.template import VERSION, unpack
from splitknit_match.records.templates import encode_template, read_template


def index_gallery(
    gallery: Path,
    *,
    key: Key | None = None,
    shards: Path | None = None,
    renew: bool = False,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Make the search codes that are missing or of another version, and keep them.

    `shards`: folder where the codes, under the gallery's key, are kept for searches through millions as well, brought
    up to date where it is there; `renew`: under a new salt: those of before cannot be compared with them. Raises
    BadInput if the gallery cannot be opened or changed, or the shards not be written or are of another key.
    """
    require(shards is not None or not renew, "`renew` is for shards; name their folder with `shards`.")
    made = 0
    with Gallery.open(gallery, key) as opened:
        opened.require_version()
        ridges = opened.settings_sha256 != MINUTIAE_HASH
        require(ridges or shards is None, f"'{gallery}' keeps minutiae, which have no codes; leave out `shards`.")
        missing = [one.row for one in opened.entries() if one.template_bytes > 0 and one.code_version != CODE_VERSION]
        rows = missing if ridges else []
        for start in range(0, len(rows), 256):  # in short transactions: what is done is kept
            progress("coding", start / len(rows))
            templates = opened.templates(rows[start : start + 256])
            codes = {row: code_of(unpack(payload)).tobytes() for row, payload in templates.items()}
            opened.set_codes(codes, CODE_VERSION)
            made += len(codes)
        facts = {"gallery": str(gallery), "coded": made, "code_version": CODE_VERSION, "shards": None}
        if shards is not None:
            there = shards.exists()
            try:
                facts["shards"] = write_shards(shards, *codes_of(opened), key, renew=renew)
            except BaseException:
                with contextlib.suppress(OSError):  # something is in it
                    if not there:
                        shards.rmdir()
                raise
    return facts


def codes_of(opened: Gallery) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
    """Rows that have a code, ascending, and the codes."""
    kept = dict(sorted(opened.codes(CODE_VERSION).items()))
    table = np.frombuffer(b"".join(kept.values()), dtype=np.int8).reshape(-1, code_size())
    return np.array(list(kept), dtype=np.int64), table


TABLE_FILE, FACTS_FILE = "gallery.csv", "gallery.json"
_FORMAT, _VERSION = "splitknit-gallery-export", 1
_FIELDS = ("person", "finger", "session", "kind", "source_sha256", "area_mm2", "failure", "enrolled_at", "images")
_COLUMNS = ("template", *_FIELDS, "image")
_SUFFIX = {"thumbnail": "png", "raw": "zip"}
_MAX_TABLE_BYTES = 50_000_000
"""A quarter of a million captures."""


def export_gallery(
    gallery: Path, out: Path, *, key: Key | None = None, images: bool = False, person: str | None = None
) -> dict[str, Any]:
    """Write all of a gallery, **not encrypted**, into a folder that only its owner may read; return facts.

    Of a `person`, where one is named, everything that is kept: images and search codes (hexadecimal) as well. Raises
    BadInput if the gallery or a row of it cannot be read, or the folder not be written; nothing is written then.
    """
    check_target(out, TABLE_FILE, "an earlier export of a gallery")
    with Gallery.open(gallery, key) as opened:
        rows = opened.entries(None if person is None else check_person(person))
        require(person is None or len(rows) > 0, f"'{gallery}' holds nothing of person '{person}'.")
        numbers = [one.row for one in rows]
        templates = opened.templates(numbers)
        kept = opened.images(numbers) if images or person is not None else {}
        codes = {} if person is None else opened.codes(CODE_VERSION)
        about = {
            "format": _FORMAT,
            "version": _VERSION,
            "template_version": opened.template_version,
            "settings_sha256": opened.settings_sha256,
        }
    table: list[list[Any]] = [[*_COLUMNS, *(() if person is None else ("code",))]]
    with atomic_folder(out) as folder:
        folder.chmod(0o700)
        for number, one in enumerate((one for one in rows if one.row in templates), start=1):
            name = f"templates/{number:04d}.skt"
            _write(folder / name, encode_template(templates[one.row], int(str(about["template_version"]))))
            image = ""
            if one.row in kept:
                image = f"images/{number:04d}.{_SUFFIX[one.entry.images]}"
                _write(folder / image, kept[one.row])
            code = () if person is None else (codes.get(one.row, b"").hex(),)
            table.append([name, *(getattr(one.entry, column) for column in _FIELDS), image, *code])
        _write(folder / TABLE_FILE, csv_text(table).encode("utf-8"))
        _write(folder / FACTS_FILE, json_text(about).encode("ascii"))
    return {"gallery": str(gallery), "out": str(out), "captures": len(rows), "images": len(kept)}


def import_gallery(gallery: Path, folder: Path, *, key: Key | None = None, replace: bool = False) -> dict[str, Any]:
    """Put what was exported into a gallery (made where there is none), all or none; return facts.

    Raises BadInput if the folder is not an export, damaged or of another version, or its templates were made with other
    settings than the gallery's.
    """
    about = _read_about(folder)
    captures = _read_table(folder)
    created = not gallery.exists()
    opened = Gallery.create(gallery, about["settings_sha256"], key) if created else Gallery.open(gallery, key)
    with opened:
        opened.require_comparable(about["settings_sha256"])
        added = opened.add(captures, replace=replace)
        facts = asdict(content_of(opened, created=created))
    return {**facts, "folder": str(folder), "found": len(captures), "new": sum(added)}


def _write(file: Path, data: bytes) -> None:
    file.parent.mkdir(mode=0o700, exist_ok=True)
    file.touch(mode=0o600)
    file.write_bytes(data)


def _read_about(folder: Path) -> dict[str, Any]:
    file = folder / FACTS_FILE
    require(file.is_file(), f"'{folder}' is not an export of a gallery: it holds no {FACTS_FILE}.")
    document, _ = read_json(file)
    fields = Fields(document, str(file))
    sound = fields.text("format") == _FORMAT and re.fullmatch("[0-9a-f]{64}", fields.text("settings_sha256"))
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
    values["area_mm2"] = 0.0 if empty else _area(row["area_mm2"])
    values["images"] = row["images"] if image is not None else ""
    code = code_of_payload(payload)
    return NewCapture(Entry(**values), payload, code, None if code is None else CODE_VERSION, image)


def _area(text: str) -> float:
    try:
        area = float(text)
    except ValueError:
        area = -1.0
    require(0 <= area <= 1e6, f"area_mm2 must be a number from 0 to a million, not {text[:60]!a}.")
    return area
