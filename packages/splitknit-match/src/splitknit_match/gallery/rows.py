"""The rows of an open gallery: wrapped contents in, contents out, every change in one transaction.

Each row has a version that is new whenever the row is written. The entry is sealed for its finger and that version;
template, images and code for that very entry as well. One more record, the state, seals the number of changes, the
number of rows and a root over all rows. It is compared with the rows when a gallery is opened, and again after another
program changed it: a row that something else put back, brought back, exchanged or took away is found.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from splitknit import UNFINISHED, BadInput, require
from splitknit_match.gallery.entry import Entry, decode_entry
from splitknit_match.gallery.file import (
    ROWS,
    STATE,
    VERSION,
    Unavailable,
    damaged,
    place_of,
    read_about,
    read_counter,
    read_record,
    transaction,
    wipe_journal,
    write_counter,
)
from splitknit_match.gallery.key import Box, Damaged, Key, box_of, document_of
from splitknit_match.matching.minutiae_record import holds_minutiae, unpack_minutiae
from splitknit_match.matching.template import unpack

_CONTENTS = ("code", "template", "images")
"""What a row holds beside its entry."""
_ACCEPT = "look with 'splitknit gallery check', and accept what is there with 'splitknit gallery repair'"
_ROOTS = 2**256


@dataclass(frozen=True, slots=True)
class Row:
    """What a row's contents are bound to, as it is stored (SQLite keeps any kind in any column)."""

    id: int
    tag: Any
    """By which its names are found."""
    version: Any
    """None in a gallery of version 1."""
    code_version: Any
    """None where no search code is kept."""
    entry: Any
    """Sealed."""

    @property
    def sound(self) -> bool:
        """Whether its columns are of the kinds that are written."""
        bound = isinstance(self.tag, bytes) and isinstance(self.entry, bytes)
        version = self.version is None or isinstance(self.version, bytes)
        return bound and version and (self.code_version is None or isinstance(self.code_version, int))

    def context(self, content: str) -> bytes:
        """Place of one of its contents."""
        if self.version is None:
            return b"splitknit gallery 1\0" + content.encode("ascii") + b"\0" + bytes(self.tag)
        place: list[bytes] = [b"splitknit gallery 2\0", content.encode("ascii"), b"\0", self.tag, self.version]
        if content != "entry":
            place.append(hashlib.sha256(self.entry).digest())
        if content == "code":
            place.append(b"%d" % self.code_version)
        return b"".join(place)


@dataclass(frozen=True, slots=True)
class GalleryState:
    """What is sealed of all rows together."""

    changes: int = 0
    """Transactions since the gallery was made; only grows."""
    count: int = 0
    root: int = 0
    """Sum of the rows' hashes, modulo 2^256."""

    def sealed(self, box: Box, about: dict[str, Any]) -> bytes:
        """As it is stored."""
        document = {"changes": self.changes, "count": self.count, "root": f"{self.root:064x}"}
        return box.seal(json.dumps(document, sort_keys=True).encode("ascii"), _state_context(about))


class GalleryRows:
    """An open database, and the box that its contents are wrapped in."""

    def __init__(self, path: Path, database: sqlite3.Connection, key: Key | None) -> None:
        """Take over the database; raises :class:`BadInput` if the key does not fit."""
        self.path, self.database, self.key = path, database, key
        self.place = place_of(path)
        with transaction(database, path, write=False):
            self.version, self.about = read_about(database, path)
        self.box = box_of(self.about, key, path, self.version)
        self.state = GalleryState()
        self.verified: int | None = None
        """SQLite's number of the content that was compared with the state; others' changes give it a new one."""

    @contextlib.contextmanager
    def reading(self, *, verified: bool = True) -> Iterator[sqlite3.Connection]:
        """One state of the gallery, whatever others write meanwhile; keep it short, as it holds them up."""
        with transaction(self.database, self.path, write=False):
            self._same_key()
            if verified:
                self.verify()
            yield self.database

    @contextlib.contextmanager
    def changing(self, *, version: int = VERSION, verified: bool = True) -> Iterator[sqlite3.Connection]:
        """All or nothing, of a gallery of this version."""
        earlier = self.version, self.about, self.key, self.box
        try:
            with transaction(self.database, self.path, write=True):
                self._same_key()
                self.require_version(version)
                if verified:
                    self.verify()
                before = self.version, self.about, self.state
                yield self.database
                same = self.place == place_of(self.path)
                require(same, f"'{self.path}' was replaced or removed meanwhile; run the same again.", Unavailable)
                if (self.version, self.about, self.state) != before:
                    self.state = replace(self.state, changes=self.state.changes + 1)
                    self.database.execute("UPDATE state SET sealed = ?", (self.state.sealed(self.box, self.about),))
        except BaseException:
            self.verified = None
            self.version, self.about, self.key, self.box = earlier
            raise
        finally:
            UNFINISHED.depth += 1
            try:
                wipe_journal(self.database, self.path)
            finally:
                UNFINISHED.leave()
        for key, box in (earlier[2:], (self.key, self.box)):  # so that copies under an earlier key are known as older
            if key is not None and key.counter is not None:
                write_counter(key.counter, box.gallery, self.state.changes)

    def require_version(self, version: int = VERSION) -> None:
        """Refuse to change a gallery of another version."""
        require(
            self.version == version,
            f"the gallery '{self.path}' is of version {self.version}, which is read, but not changed; run 'splitknit "
            f"gallery migrate', which makes it one of version {VERSION}."
            if self.version < VERSION
            else f"the gallery '{self.path}' is of version {self.version} already.",
        )

    def _same_key(self) -> None:
        same = read_about(self.database, self.path) == (self.version, self.about)
        require(
            same, f"the key of the gallery '{self.path}' was changed meanwhile, or its version; run the same again."
        )

    def verify(self) -> None:
        """Compare the rows with the state, unless that was done and nobody changed the file since.

        Raises BadInput if a row is missing, or there that should not be, or the file is older than the counter file
        knows.
        """
        (content,) = self.database.execute("PRAGMA data_version").fetchone()
        if content == self.verified:
            return
        if self.version > 1:
            self.state = self._sealed_state()
            require(
                replace(self._found_state(), changes=self.state.changes) == self.state,
                f"the rows of the gallery '{self.path}' are not those that were last written: something else than this "
                f"program put one back, took one away or changed one; restore a copy, or {_ACCEPT}.",
            )
        counter = None if self.key is None else self.key.counter
        if counter is not None:
            last = read_counter(counter).get(self.box.gallery)
            require(
                last is None or (self.version > 1 and last <= self.state.changes),
                f"the gallery '{self.path}' is an older copy: it has seen {self.state.changes} changes, but "
                f"'{counter}' {last}; restore the newest copy, or {_ACCEPT}.",
            )
            if self.version > 1:
                with contextlib.suppress(BadInput):  # a reader may have no right to write there
                    write_counter(counter, self.box.gallery, self.state.changes)
        self.verified = content

    def _sealed_state(self) -> GalleryState:
        try:
            sealed = read_record(self.database, "state", "sealed")
            document = json.loads(self.box.open(sealed, _state_context(self.about)))
            return GalleryState(int(document["changes"]), int(document["count"]), int(document["root"], 16))
        except (Damaged, ValueError, TypeError, KeyError) as error:
            raise BadInput(
                f"the gallery '{self.path}' is damaged (the record of all its rows); restore a copy, or {_ACCEPT}."
            ) from error

    def _found_state(self) -> GalleryState:
        query = "SELECT id, tag, version, code_version FROM finger NOT INDEXED"
        found = self.database.execute(query).fetchall()
        return GalleryState(0, len(found), sum(_leaf(self.box, *one) for one in found) % _ROOTS)

    def rows(self, where: str = "TRUE", *values: Any) -> list[Row]:
        """Rows, in the order of enrolment."""
        return [row for row, _ in self._select(None, where, *values)]

    def contents(self, content: str, where: str = "TRUE", each: Sequence[Sequence[Any]] = ((),)) -> dict[int, bytes]:
        """Contents (``code``, ``template`` or ``images``) by row, where there is one; for each of these values."""
        with self.reading():
            found = [one for values in each for one in self._select(content, where, *values)]
        return {row.id: self.opened(row, content, cell) for row, cell in found if self._kept(row, content, cell)}

    def _kept(self, row: Row, content: str, cell: Any) -> bool:
        """Whether a row has such a content, or lost it: of a code its version, of images its entry says so."""
        if cell is not None or content == "template":
            return True
        return row.code_version is not None if content == "code" else self.entry(row).images != ""

    def _select(self, content: str | None, where: str, *values: Any) -> list[tuple[Row, Any]]:
        version = "version" if self.version > 1 else "NULL"
        cell = "NULL" if content is None else "code" if content == "code" else "content"
        joined = f" LEFT JOIN {content} USING (id)" if cell == "content" else ""
        found = self.database.execute(
            f"SELECT id, tag, {version}, code_version, entry, {cell} FROM finger{joined} WHERE {where} ORDER BY id",
            values,
        )
        return [(Row(*one[:5]), one[5]) for one in found]

    def opened(self, row: Row, content: str, cell: Any, box: Box | None = None) -> bytes:
        """Content of a cell, of the gallery's box or another; raises :class:`BadInput` if it is damaged."""
        try:
            if not isinstance(cell, bytes) or not row.sound:
                raise Damaged
            return (box or self.box).open(cell, row.context(content))
        except (Damaged, TypeError) as error:
            raise BadInput(
                f"row {row.id} of the gallery '{self.path}' is damaged (its {content}); 'splitknit gallery check' "
                f"lists what is sound, 'splitknit gallery remove' takes row {row.id} out."
            ) from error

    def entry(self, row: Row) -> Entry:
        """Names and facts of a row; raises :class:`BadInput` if they are damaged."""
        return self._decoded(row, self.opened(row, "entry", row.entry))

    def _decoded(self, row: Row, content: bytes) -> Entry:
        try:
            return decode_entry(content)
        except BadInput as error:
            raise BadInput(damaged(self.path, f"row {row.id}: {str(error).rstrip('.')}")) from error

    def insert(
        self, names: bytes, contents: dict[str, bytes | None], code_version: int | None, row_id: int | None = None
    ) -> None:
        """Add a row of these contents (``entry``, ``template``, ``code``, ``images``)."""
        box, database = self.box, self.database
        row = Row(0, box.tag(names), box.version(self.state.changes + 1), code_version, b"")
        row = replace(row, entry=box.seal(contents["entry"] or b"", row.context("entry")))
        cells = {
            name: None if contents[name] is None else box.seal(contents[name] or b"", row.context(name))
            for name in _CONTENTS
        }
        values = (row_id, row.tag, row.version, code_version, row.entry, cells["code"])
        number = int(database.execute("INSERT INTO finger VALUES (?, ?, ?, ?, ?, ?)", values).lastrowid or 0)
        for table in ("template", "images"):
            if cells[table] is not None:
                database.execute(f"INSERT INTO {table} VALUES (?, ?)", (number, cells[table]))
        self._count(replace(row, id=number), 1)

    def set_codes(self, codes: Mapping[int, bytes], version: int) -> None:
        """Write the rows that are there anew, with these search codes."""
        with self.changing():
            for row_id in (row_id for row_id in codes if self.rows("id = ?", row_id)):
                names, contents, _ = self._opened_cells(row_id, self.version, self.box)
                self.delete(row_id)
                self.insert(names, contents | {"code": codes[row_id]}, version, row_id)

    def delete(self, row_id: int) -> bool:
        """Remove a row; whether there was one."""
        for row in self.rows("id = ?", row_id):
            self._count(row, -1)
        gone = [self.database.execute(f"DELETE FROM {table} WHERE id = ?", (row_id,)).rowcount for table in ROWS]
        return any(gone)

    def _count(self, row: Row, times: int) -> None:
        root = (self.state.root + times * _leaf(self.box, row.id, row.tag, row.version, row.code_version)) % _ROOTS
        self.state = replace(self.state, count=self.state.count + times, root=root)

    def rewrite(self, about: dict[str, Any] | None = None, key: Key | None = None) -> int:
        """Write all rows into new tables, wrapped as in `about` if that is given; return how many.

        SQLite zeroes what it frees, but a page that it divided may hold a second copy of a row. Tables that were
        written once, in order, hold none. The file is not made shorter: what a file system takes from the end of a
        file is not overwritten.
        """
        database, old_version, old_box = self.database, self.version, self.box
        for table, statement in ROWS.items():
            database.execute(f"ALTER TABLE {table} RENAME TO old_{table}")
            database.execute(statement)
        if about is not None:
            if old_version == 1:
                database.execute(STATE)
                database.execute("INSERT INTO state VALUES (x'')")
                database.execute(f"PRAGMA user_version = {VERSION}")
            database.execute("UPDATE about SET document = ?", (document_of(about),))
            self.version, self.about, self.key, self.box = VERSION, about, key, box_of(about, key, self.path)
            self.state = GalleryState(self.state.changes)
        ids = [row_id for (row_id,) in database.execute("SELECT id FROM old_finger ORDER BY id").fetchall()]
        for row_id in ids:
            if about is None:
                for table in ROWS:
                    database.execute(f"INSERT INTO {table} SELECT * FROM old_{table} WHERE id = ?", (row_id,))
            else:
                self.insert(*self._opened_cells(row_id, old_version, old_box, "old_"), row_id)
            for table in ROWS:
                database.execute(f"DELETE FROM old_{table} WHERE id = ?", (row_id,))
        for table in ROWS:
            database.execute(f"DROP TABLE old_{table}")
        return len(ids)

    def _cells(self, row_id: int, version: int, prefix: str = "") -> tuple[Row, dict[str, Any]]:
        number = "version" if version > 1 else "NULL"
        found = self.database.execute(
            f"SELECT id, tag, {number}, code_version, entry, code, t.content, i.content FROM {prefix}finger "
            f"LEFT JOIN {prefix}template t USING (id) LEFT JOIN {prefix}images i USING (id) WHERE id = ?",
            (row_id,),
        ).fetchone()
        return Row(*found[:5]), dict(zip(_CONTENTS, found[5:], strict=True))

    def _opened_cells(
        self, row_id: int, version: int, box: Box, prefix: str = ""
    ) -> tuple[bytes, dict[str, bytes | None], int | None]:
        """Names, contents, and version of the code."""
        row, cells = self._cells(row_id, version, prefix)
        entry = self.opened(row, "entry", row.entry, box)
        contents: dict[str, bytes | None] = {"entry": entry}
        for name, cell in cells.items():
            missing = cell is None and name != "template" and (name != "code" or row.code_version is None)
            contents[name] = None if missing else self.opened(row, name, cell, box)
        return self._decoded(row, entry).names, contents, row.code_version

    def repair(self) -> list[int]:
        """Take out the rows that cannot be opened and accept the others as they are; return those taken out.

        For after something else changed the file and there is no copy to restore: a row that was put back in whole
        opens, and is accepted.
        """
        with self.changing(verified=False) as database:
            counter = None if self.key is None else self.key.counter
            changes = 0 if counter is None else read_counter(counter).get(self.box.gallery, 0)
            with contextlib.suppress(BadInput):
                changes = max(changes, self._sealed_state().changes)
            out = {row_id for row_id in self._ids() if next(self._problems_of(row_id), None) is not None}
            for row_id in out:
                for table in ROWS:
                    database.execute(f"DELETE FROM {table} WHERE id = ?", (row_id,))
            self.rewrite()
            database.execute("DELETE FROM state")
            database.execute("INSERT INTO state VALUES (x'')")
            self.state = replace(self._found_state(), changes=changes + 1)
        return sorted(out)

    def problems(self) -> list[tuple[int | None, str]]:
        """What is wrong, by row (None: with the file): SQLite's own check, the state, every seal, every template.

        Nothing if all is sound. Each is one printable line.
        """
        found: list[tuple[int | None, str]] = []
        with self.reading(verified=False) as database:
            checked = database.execute("PRAGMA integrity_check(20)").fetchall()
            said = [line for (text,) in checked for line in str(text).splitlines() if line.strip()]
            found += [(None, str(BadInput(line))) for line in said if line != "ok"]
            self.verified = None
            try:
                self.verify()
            except BadInput as error:
                found.append((None, str(error)))
            ids = self._ids()
        for row_id in ids:
            with self.reading(verified=False):
                found += [(row_id, words) for words in self._problems_of(row_id)]
        return found

    def _ids(self) -> list[int]:
        """Numbers of all rows, also of those that lost their names."""
        query = " UNION ".join(f"SELECT id FROM {table}" for table in ROWS)
        return [row_id for (row_id,) in self.database.execute(f"{query} ORDER BY id").fetchall()]

    def _problems_of(self, row_id: int) -> Iterator[str]:
        if not self.database.execute("SELECT 1 FROM finger WHERE id = ?", (row_id,)).fetchall():
            for table in ("template", "images"):
                if self.database.execute(f"SELECT 1 FROM {table} WHERE id = ?", (row_id,)).fetchall():
                    yield f"row {row_id} has a content ({table}) and no name."
            return
        row, cells = self._cells(row_id, self.version)
        try:
            self.entry(row)
        except BadInput as error:
            yield str(error)  # the others are bound to it
            return
        for name, cell in cells.items():
            if not self._kept(row, name, cell):
                continue
            try:
                content = self.opened(row, name, cell)
                if name == "template":
                    (unpack_minutiae if holds_minutiae(content) else unpack)(content)
            except BadInput as error:
                yield str(error)


def _leaf(box: Box, number: int, tag: Any, version: Any, code_version: Any) -> int:
    """What a row adds to the root."""
    try:
        place = b"%d,%d,%d\0" % (number, -1 if code_version is None else code_version, len(tag))
        return box.leaf(b"".join((place, tag, version)))
    except TypeError:  # of another kind than is written
        return 1


def _state_context(about: dict[str, Any]) -> bytes:
    """The state holds for the gallery's own record, too."""
    return b"splitknit gallery 2\0state\0" + hashlib.sha256(document_of(about).encode("utf-8")).digest()
