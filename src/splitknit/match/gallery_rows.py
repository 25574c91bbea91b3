"""The rows of an open gallery: wrapped contents in, contents out, every change in one transaction."""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from splitknit.check import BadInput, require
from splitknit.match.gallery_box import Box, Damaged, PlainBox
from splitknit.match.gallery_entry import Entry, decode_entry
from splitknit.match.gallery_file import damaged, read_about, transaction
from splitknit.match.gallery_key import SALT_BYTES, Key, ScryptSettings, SealedBox
from splitknit.match.template import unpack

_CHECK = b"splitknit gallery"
_PLACES = {"entry": ("finger", "entry"), "code": ("finger", "code"), "template": ("template", "content"),
           "images": ("images", "content")}  # fmt: skip
"""Table and column of each content; all go by the row's id."""
_JOINED = (
    "SELECT tag, entry, code, template.content, images.content FROM finger LEFT JOIN template USING (id) "
    "LEFT JOIN images USING (id) WHERE id = ?"
)
_CONTENTS = ("entry", "code", "template", "images")


class Rows:
    """An open database, and the box that its contents are wrapped in."""

    def __init__(self, path: Path, database: sqlite3.Connection, key: Key | None) -> None:
        """Take over the database; raises :class:`BadInput` if the key does not fit."""
        self.path = path
        self.database = database
        with transaction(database, path, write=False):
            self.about = read_about(database, path)
        self.box = box_of(self.about, key, path)

    @contextlib.contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """One state of the gallery, whatever others write meanwhile; keep it short, as it holds them up."""
        with transaction(self.database, self.path, write=False):
            self._unchanged()
            yield self.database

    @contextlib.contextmanager
    def changing(self) -> Iterator[sqlite3.Connection]:
        """All or nothing."""
        with transaction(self.database, self.path, write=True):
            self._unchanged()
            yield self.database

    def _unchanged(self) -> None:
        same = read_about(self.database, self.path) == self.about
        require(
            same, f"the key of the gallery '{self.path}' was changed meanwhile; run the same again with the new one."
        )

    def compact(self) -> bool:
        """Write the file anew without what was removed; False where readers hold it (its pages are zeros already)."""
        try:
            self.database.execute("VACUUM")
        except sqlite3.OperationalError:
            return False
        return True

    def opened(self, row: int, column: str, tag: bytes, sealed: Any) -> bytes:
        """Content of a cell; raises :class:`BadInput` if it is damaged."""
        try:
            if not isinstance(sealed, bytes) or not isinstance(tag, bytes):
                raise Damaged
            return self.box.open(sealed, context(column, tag))
        except Damaged as error:
            raise BadInput(
                f"row {row} of the gallery '{self.path}' is damaged (its {column}); 'splitknit gallery check' says "
                f"what is sound, 'splitknit gallery remove --row {row}' takes it out."
            ) from error

    def entry(self, row: int, tag: bytes, sealed: Any) -> Entry:
        """Names and facts of a row; raises :class:`BadInput` if they are damaged."""
        content = self.opened(row, "entry", tag, sealed)
        try:
            return decode_entry(content)
        except BadInput as error:
            raise BadInput(damaged(self.path, f"row {row}: {str(error).rstrip('.')}")) from error

    def insert(self, tag: bytes, contents: dict[str, bytes | None], code_version: int | None) -> None:
        """Add a row of these contents (`entry`, `template`, `code`, `images`)."""
        sealed = {
            name: None if one is None else self.box.seal(one, context(name, tag)) for name, one in contents.items()
        }
        row = self.database.execute(
            "INSERT INTO finger (tag, entry, code, code_version) VALUES (?, ?, ?, ?)",
            (tag, sealed["entry"], sealed["code"], code_version),
        ).lastrowid
        for table in ("template", "images"):
            if sealed[table] is not None:
                self.database.execute(f"INSERT INTO {table} VALUES (?, ?)", (row, sealed[table]))

    def delete(self, row: int) -> bool:
        """Remove a row; whether there was one."""
        gone = [
            self.database.execute(f"DELETE FROM {table} WHERE id = ?", (row,)).rowcount
            for table in ("finger", "template", "images")
        ]
        return any(gone)

    def contents(self, column: str, rows: Sequence[int] | None, version: int | None = None) -> dict[int, bytes]:
        """Contents of a column by row, of all or of some rows, where there is one (codes: of one version)."""
        table, field = _PLACES[column]
        joined = "" if table == "finger" else f" JOIN {table} USING (id)"
        query = f"SELECT id, tag, {field} FROM finger{joined} WHERE {field} IS NOT NULL"
        query += "" if version is None else f" AND code_version = {int(version)}"
        with self.reading() as database:
            if rows is None:
                found = database.execute(f"{query} ORDER BY id").fetchall()
            else:
                found = [one for row in rows for one in database.execute(f"{query} AND id = ?", (row,)).fetchall()]
        return {row: self.opened(row, column, tag, sealed) for row, tag, sealed in found}

    def reseal(self, row: int, box: Box) -> None:
        """Wrap a row in another box."""
        found = self.database.execute(_JOINED, (row,)).fetchone()
        entry = self.entry(row, found[0], found[1])
        tag = box.tag(entry.names)
        for name, sealed in zip(_CONTENTS, found[1:], strict=True):
            if sealed is None and name in ("code", "images"):
                continue
            again = box.seal(self.opened(row, name, found[0], sealed), context(name, tag))
            table, field = _PLACES[name]
            self.database.execute(f"UPDATE {table} SET {field} = ? WHERE id = ?", (again, row))
        self.database.execute("UPDATE finger SET tag = ? WHERE id = ?", (tag, row))

    def problems(self) -> list[tuple[int | None, str]]:
        """What is wrong, by row (None: with the file): SQLite's own check, every seal, every template."""
        found: list[tuple[int | None, str]] = []
        with self.reading() as database:
            said = [str(row[0]) for row in database.execute("PRAGMA integrity_check(20)").fetchall()]
            found += [(None, one) for one in said if one != "ok"]
            rows = [row[0] for row in database.execute("SELECT id FROM finger ORDER BY id").fetchall()]
            for table in ("template", "images"):
                orphans = database.execute(f"SELECT id FROM {table} WHERE id NOT IN (SELECT id FROM finger)").fetchall()
                found += [(row, f"row {row} has a content ({table}) and no name.") for (row,) in orphans]
        for row in rows:
            with self.reading() as database:
                cells = database.execute(_JOINED, (row,)).fetchone()
            if cells is not None:
                found += [(row, words) for words in self._problems_of(row, cells[0], cells[1:])]
        return found

    def _problems_of(self, row: int, tag: bytes, cells: Sequence[Any]) -> Iterator[str]:
        for name, sealed in zip(_CONTENTS, cells, strict=True):
            if sealed is None and name in ("code", "images"):
                continue
            try:
                if name == "entry":
                    self.entry(row, tag, sealed)
                else:
                    content = self.opened(row, name, tag, sealed)
                    if name == "template":
                        unpack(content)
            except BadInput as error:
                yield str(error)


def lock(key: Key | None, scrypt: ScryptSettings | None) -> dict[str, Any]:
    """What a gallery says of how it is wrapped, under a new salt."""
    if key is None:
        return {"box": "plain"}
    chosen = scrypt or ScryptSettings()
    salt = os.urandom(SALT_BYTES)
    check = SealedBox(key, salt, chosen).seal(_CHECK, context("check", b""))
    cost = {} if key.raw else {"log2_n": chosen.log2_n, "r": chosen.r, "p": chosen.p}
    return {
        "box": "aes-256-gcm",
        "key": "raw" if key.raw else "scrypt",
        "salt": salt.hex(),
        "check": check.hex(),
        **cost,
    }


def box_of(about: dict[str, Any], key: Key | None, path: Path) -> Box:
    """Box of a gallery.

    Raises
    ------
    BadInput
        If the key is missing, wrong, of the other kind, or not wanted, or what the gallery says is damaged.
    """
    wrong = damaged(path, "what it says of itself cannot be read")
    known = all(isinstance(about.get(name), kind) for name, kind in _ABOUT.items())
    require(known and about["box"] in ("plain", "aes-256-gcm"), wrong)
    if about["box"] == "plain":
        require(
            key is None,
            f"a key was given, but the gallery '{path}' is not encrypted; leave the key out, or encrypt it with "
            "'splitknit gallery rekey'.",
        )
        return PlainBox()
    if key is None:
        raise BadInput(f"the gallery '{path}' is encrypted; give its key with --key-file or in SPLITKNIT_GALLERY_KEY.")
    try:
        salt, check = bytes.fromhex(about["salt"]), bytes.fromhex(about["check"])
        raw = {"raw": True, "scrypt": False}[about["key"]]
        scrypt = ScryptSettings() if raw else ScryptSettings(int(about["log2_n"]), int(about["r"]), int(about["p"]))
        require(len(salt) == SALT_BYTES, wrong)
    except (KeyError, ValueError, TypeError) as error:
        raise BadInput(wrong) from error
    kinds = "32 bytes (64 hexadecimal digits)", "a passphrase"
    require(
        key.raw == raw,
        f"the key does not fit: that of the gallery '{path}' is {kinds[not raw]}, but {kinds[not key.raw]} was given.",
    )
    box = SealedBox(key, salt, scrypt)
    with contextlib.suppress(Damaged):
        if box.open(check, context("check", b"")) == _CHECK:
            return box
    raise BadInput(f"the key is not that of the gallery '{path}'; give the one it was encrypted with.")


def context(column: str, tag: bytes) -> bytes:
    """To what a content is bound: its column, and whose it is."""
    return b"splitknit gallery 1\0" + column.encode("ascii") + b"\0" + tag


def document_of(about: dict[str, Any]) -> str:
    """As it is stored."""
    return json.dumps(about, sort_keys=True)


_ABOUT = {"box": str, "settings_sha256": str, "template_version": int}
