"""Everything that is kept of a person: found in galleries, shards, captures, results, stores and exports, then erased.

Whose something is, is read off what this program wrote there, never guessed: the entries of a gallery, the subject of a
capture or result, its place (``NAME/session_1/right_index``), the captures of a store, the tables of exports and
populations. Links are not followed.
"""

from __future__ import annotations

import contextlib
import csv
import html
import io
import json
import os
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from splitknit import (
    FINGERS,
    MANIFEST,
    BadInput,
    Refused,
    json_text,
    manifest_of,
    plain_text,
    read_bytes,
    read_json,
    require,
    write_file,
)
from splitknit_match.batch.chunks import SUFFIX, read_chunk, read_origin, read_schema, write_chunk
from splitknit_match.batch.engine import alone
from splitknit_match.batch.store import FORMAT, STORE_FILE
from splitknit_match.gallery.entry import check_person
from splitknit_match.gallery.file import is_gallery, wipe, wiping
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.key import Key
from splitknit_match.gallery.manage import FACTS_FILE as ABOUT_FILE
from splitknit_match.gallery.manage import TABLE_FILE, index_gallery
from splitknit_match.gallery.records import FACTS_FILE
from splitknit_match.gallery.shards import files_of_shards

POPULATION_FILE, POPULATION_TABLE = "population.json", "population.csv"  # as the simulator names them
_WHO = ("person", "subject", "subject_a", "subject_b")  # columns of our tables
_MAX_TABLE, _MAX_TEXT = 1_000_000_000, 20_000_000
_UNNAMED = (".skt", ".iso", ".fmr", ".fir", ".an2", ".itl", ".wsq")


@dataclass(frozen=True, slots=True)
class _Held:
    """Something about the person."""

    what: str  # such as "gallery"
    path: Path
    records: int
    erase: Callable[[], object]


def forget(people: Sequence[str], places: Sequence[Path], *, key: Key | None = None, erase: bool) -> dict[str, Any]:
    """Find all that is kept of a person below `places`, and erase it: what is removed is overwritten with zeros first.

    Returns ``found`` (what, path and number of records), ``shards`` made anew, ``unreached`` (with reasons),
    ``mentions`` (files that still hold a name), ``unnamed`` (files of fingers that state no person). Raises BadInput if
    a place is missing, or nothing of the person is there. Raises Refused if something could not be looked into or
    erased; the rest is erased then.

    people : names of one person, as galleries and captures have them
    places : galleries, and folders that are searched with all that is in them
    key : of encrypted galleries
    erase : False: nothing is changed
    """
    require(len(people) > 0 and len(places) > 0, "name a person, and the galleries and folders to look in.")
    names = frozenset(check_person(one) for one in people)
    for place in places:
        found = place.is_dir() or is_gallery(place)
        require(found, f"'{place}' is neither a gallery nor a folder; name galleries and folders.")
    unreached: list[dict[str, str]] = []
    held: list[_Held] = []
    galleries = {place.resolve(): place for place in places if not place.is_dir()}
    shards: list[Path] = []
    unnamed: list[str] = []
    for folder, files in _walked(places, unreached):
        shards += [folder] if files_of_shards(folder) else []
        galleries |= {file.resolve(): file for file in (folder / name for name in files) if is_gallery(file)}
        known = FACTS_FILE in files or (folder.parent / TABLE_FILE).is_file()
        unnamed += [str(folder / name) for name in files if name.endswith(_UNNAMED) and not known]
        for look in (_finger, _tables, _export, _store):
            with _noted(folder, unreached):
                held += look(folder, files, names)
    for gallery in galleries.values():
        with _noted(gallery, unreached):
            held += _gallery(gallery, names, key)
    words = ", ".join(sorted(names))
    nothing = f"nothing of {words} was found; names are compared letter by letter"
    nothing += " ('splitknit gallery list' shows them)."
    require(bool(held or shards or unreached), nothing)
    facts: dict[str, Any] = {
        "people": sorted(names),
        "found": [{"what": one.what, "path": str(one.path), "records": one.records} for one in held],
        "shards": [str(folder) for folder in shards],
        "unreached": unreached,
        "unnamed": unnamed,
        "mentions": [],
        "erased": erase,
    }
    if not erase:
        return facts
    for one in held:
        with _noted(one.path, unreached):
            one.erase()
    for folder in shards:
        with _noted(folder, unreached):
            _shards(folder, list(galleries.values()), key)
    every = (folder / name for folder, files in _walked(places, []) for name in files)
    facts["mentions"] = [str(file) for file in every if _names(file, names)]
    facts["unnamed"] = [path for path in unnamed if Path(path).exists()]
    if unreached:
        first = f"{unreached[0]['path']}: {unreached[0]['reason'].rstrip('.')}"
        said = f"{len(unreached)} places could not be looked into or erased, the rest is (first: {first})."
        raise Refused(said, facts)
    return facts


@contextlib.contextmanager
def _noted(path: Path, unreached: list[dict[str, str]]) -> Iterator[None]:
    try:
        yield
    except (BadInput, OSError) as error:
        unreached.append({"path": str(path), "reason": str(error)})


def _walked(places: Sequence[Path], unreached: list[dict[str, str]]) -> Iterator[tuple[Path, list[str]]]:
    """Folders, each once, and the names of their regular files; links, and what may not be read, are put down."""
    seen: set[Path] = set()
    for place in (one for one in places if one.is_dir()):
        failed: list[OSError] = []
        for folder, folders, files in os.walk(place, onerror=failed.append):
            if Path(folder).resolve() in seen:
                continue
            seen.add(Path(folder).resolve())
            folders.sort()
            links = [name for name in (*folders, *files) if (Path(folder) / name).is_symlink()]
            unreached += [{"path": str(Path(folder) / name), "reason": "a link is not followed."} for name in links]
            yield Path(folder), sorted(name for name in files if (Path(folder) / name).is_file() and name not in links)
        unreached += [{"path": str(error.filename), "reason": error.strerror or str(error)} for error in failed]


def _gallery(path: Path, names: Collection[str], key: Key | None) -> Iterator[_Held]:
    with Gallery.open(path, key) as opened:
        rows = [one.row for one in opened.entries() if one.entry.person in names]

    def erase() -> None:
        with Gallery.open(path, key) as opened:
            opened.remove(rows)

    if rows:
        yield _Held("gallery", path, len(rows), erase)


def _shards(folder: Path, galleries: Sequence[Path], key: Key | None) -> None:
    """Codes have no names, and those who were removed earlier may be among them: all are made anew, of the gallery."""
    for file in files_of_shards(folder):
        wipe(file)
    only = f"'{folder}' is empty now, as not one gallery was named; run 'splitknit gallery index' on it (`shards`)."
    require(len(galleries) == 1, only)
    with contextlib.suppress(BadInput):  # nobody is left
        index_gallery(galleries[0], key=key, shards=folder)


def _finger(folder: Path, files: Sequence[str], names: Collection[str]) -> Iterator[_Held]:
    """A capture, result or print, of whom it states, or whose it is by its place."""
    own = manifest_of(folder)
    stated: Any = None
    for name in ("capture.json", "report.json"):
        if name in files:
            document, _ = read_json(folder / name)
            about = document.get("capture") if name == "report.json" else document
            subject = about.get("subject") if isinstance(about, dict) else None
            stated = subject.get("id") if isinstance(subject, dict) else stated
    if own and (stated in names or (_in_place(folder) and folder.parent.parent.name in names)):
        yield _Held("capture or result", folder, 1, partial(_erase_folder, folder, own))


def _erase_folder(folder: Path, own: Collection[str]) -> None:
    for name in (*own, MANIFEST):
        wipe(_inside(folder, name))
    emptied = [folder, folder.parent, folder.parent.parent] if _in_place(folder) else [folder]
    for one in (*sorted({(folder / name).parent for name in own} - {folder}, reverse=True), *emptied):
        with contextlib.suppress(OSError):  # something else is in it
            one.rmdir()
    left = sorted(one.name for one in folder.iterdir()) if folder.is_dir() else []
    require(not left, f"'{folder}' holds what splitknit did not write there ({', '.join(left[:3])}).")


def _in_place(folder: Path) -> bool:
    """Whether a folder lies as in a population: ``NAME/session_1/right_index``."""
    return folder.name in FINGERS and folder.parent.name.startswith("session_")


def _inside(folder: Path, name: str) -> Path:
    """A file that a table names; BadInput if that leads out of the folder."""
    file = folder / name
    sound = file.parent.resolve().is_relative_to(folder.resolve()) and file.name not in ("", "..")
    require(sound, f"'{folder}' names a file outside of it ({name[:60]!a}); nothing is removed there.")
    return file


def _is(file: Path, form: str) -> bool:
    """Whether it is a JSON file of ours, no link, of this format."""
    with contextlib.suppress(BadInput):
        return file.is_file() and not file.is_symlink() and read_json(file)[0].get("format") == form
    return False


def _tables(folder: Path, files: Sequence[str], names: Collection[str]) -> Iterator[_Held]:
    """Rows of a population's and an export's table, with the files that the latter names."""
    for name, beside, form in (
        (POPULATION_TABLE, POPULATION_FILE, "splitknit-population"),
        (TABLE_FILE, ABOUT_FILE, "splitknit-gallery-export"),
    ):
        if name in files and _is(folder / beside, form):
            yield from _table(folder / name, names, files=name == TABLE_FILE)


def _table(file: Path, names: Collection[str], *, files: bool = False) -> Iterator[_Held]:
    text = read_bytes(file, _MAX_TABLE).decode("utf-8-sig", "replace")
    rows = list(csv.reader(io.StringIO(text, newline="")))
    columns = [k for k, name in enumerate(rows[0] if rows else ()) if name in _WHO]
    gone = [row for row in rows[1:] if any(k < len(row) and plain_text(row[k]) in names for k in columns)]
    holders = [rows[0].index(name) for name in ("template", "image") if files and name in rows[0]] if rows else []

    def erase() -> None:
        for name in (plain_text(row[k]) for row in gone for k in holders if row[k]):
            wipe(_inside(file.parent, name))
        kept = io.StringIO()
        csv.writer(kept, lineterminator="\n").writerows(row for row in rows if row not in gone)
        _rewrite(file, kept.getvalue())

    if gone:
        yield _Held("export of a gallery" if files else "table", file, len(gone), erase)


def _rewrite(file: Path, text: str) -> None:
    with wiping(file):
        write_file(file, text.encode("utf-8"))


def _export(folder: Path, files: Sequence[str], names: Collection[str]) -> Iterator[_Held]:
    document = read_json(folder / FACTS_FILE)[0] if _is(folder / FACTS_FILE, "splitknit-export") else {}
    rows = document.get("files", [])
    gone = [row for row in rows if isinstance(row, dict) and row.get("person") in names]

    def erase() -> None:
        for row in gone:
            wipe(_inside(folder, str(row["file"])))
        _rewrite(folder / FACTS_FILE, json_text(document | {"files": [row for row in rows if row not in gone]}))

    if gone:
        yield _Held("export", folder, len(gone), erase)


def _store(folder: Path, files: Sequence[str], names: Collection[str]) -> Iterator[_Held]:
    """Captures and comparisons in the chunks, times and tables of a store."""
    if not _is(folder / STORE_FILE, FORMAT):
        return
    found: list[_Held] = []
    for below, _, inside in os.walk(folder):
        for file in (Path(below) / name for name in sorted(inside)):
            if file.suffix == SUFFIX:
                found += _chunk(file, names)
            elif file.suffix == ".json" and file.parent.parent.name == "timings":
                found += _times(file, names)
            elif file.suffix == ".csv" and file.parent == folder / "csv":
                found += _table(file, names)

    def erase() -> None:
        with alone(folder):
            for one in found:
                one.erase()

    if found:
        yield _Held("store", folder, sum(one.records for one in found), erase)


def _chunk(file: Path, names: Collection[str]) -> Iterator[_Held]:
    columns = [name for name in ("capture", "a", "b") if name in read_schema(file).names]
    sides = read_chunk(file, columns).to_pylist() if columns else []
    gone = [any(value.partition("/")[0] in names for value in row.values()) for row in sides]

    def erase() -> None:
        table = read_chunk(file).filter([not one for one in gone])
        with wiping(file):
            write_chunk(file, table.to_pydict(), table.schema, read_origin(file))

    if any(gone):
        yield _Held("chunk", file, sum(gone), erase)


def _times(file: Path, names: Collection[str]) -> Iterator[_Held]:
    times, _ = read_json(file)
    kept = {name: value for name, value in times.items() if name.partition("/")[0] not in names}
    if len(kept) < len(times):
        yield _Held("times", file, 0, partial(_rewrite, file, json_text(kept)))


def _names(file: Path, names: Collection[str]) -> bool:
    """Whether a text holds a name."""
    try:
        text = read_bytes(file, _MAX_TEXT).decode("utf-8")
    except (BadInput, UnicodeDecodeError):
        return False
    spelled = {one for name in names for one in (name, json.dumps(name)[1:-1], html.escape(name))}
    return any(re.search(rf"(?<!\w){re.escape(one)}(?!\w)", text) for one in spelled)
