"""A gallery: an SQLite file of typed rows, encrypted as a whole by SQLCipher where a key is given.

A rollback journal, not a write-ahead log: at rest a gallery is one file, which can be copied, moved and read from a
read-only disk. What a killed writer began SQLite takes back. ``synchronous=EXTRA`` holds through a loss of power.
"""

from __future__ import annotations

import contextlib
import datetime
import getpass
import hashlib
import os
import sqlite3
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit import BadInput
from splitknit.errors import UNFINISHED, importing, printable, require, shown_path
from splitknit.io.atomic import append_line, private_modes
from splitknit.verbs import VERB, AnyPath
from splitknit_match.gallery.entry import Entry, NewCapture
from splitknit_match.gallery.key import Key, key_of
from splitknit_match.matching.minutiae_record import holds_minutiae, unpack_minutiae
from splitknit_match.matching.template import VERSION as TEMPLATE_VERSION
from splitknit_match.matching.template import unpack

if TYPE_CHECKING:
    from splitknit_match.gallery.minutia_index import MinutiaIndex

APPLICATION_ID = 0x534B4741
"""``SKGA``, in the header of the file."""
VERSION = 3
WAIT_S = 10.0
"""How long one waits for another program's transaction."""
LOG = ".log"
"""End of the name of the access log that may lie beside a gallery."""
_MAGIC = b"SQLite format 3\0"
_KINDS = {
    "person": str, "finger": str, "session": str, "kind": str, "source_sha256": str, "area_mm2": float, "failure": str,
    "enrolled_at": str, "images": str, "template_bytes": int, "template_sha256": str,
}  # fmt: skip
_SQL = {str: "TEXT", float: "REAL", int: "INTEGER"}
_COLUMNS = ", ".join(_KINDS)
_DECLARED = ", ".join(f"{name} {_SQL[kind]} NOT NULL" for name, kind in _KINDS.items())
_ABOUT = "CREATE TABLE about (settings_sha256 TEXT NOT NULL, template_version INTEGER NOT NULL)"
_ROWS = {
    "finger": f"CREATE TABLE finger (id INTEGER PRIMARY KEY, {_DECLARED}, UNIQUE (person, finger, session))",
    "images": "CREATE TABLE images (id INTEGER PRIMARY KEY, content BLOB NOT NULL)",
    "template": "CREATE TABLE template (id INTEGER PRIMARY KEY, content BLOB NOT NULL)",
}
"""What is large lies apart: names of very many fingers are read without it."""
_SETTINGS = (
    "trusted_schema=OFF", "cell_size_check=ON", "secure_delete=ON", "temp_store=MEMORY", "synchronous=EXTRA",
)  # fmt: skip


class Unavailable(BadInput):
    """The file of a gallery cannot be used now, whatever is asked of it: gone, locked, on a full disk, damaged."""


class People:
    """What a gallery held at one time, in memory; threads may share it."""

    def __init__(self, path: Path, settings_sha256: str, entries: list[Entry], templates: dict[int, bytes]) -> None:
        """Take over what was read."""
        self.path, self.settings_sha256, self.templates = path, settings_sha256, templates
        self.entries = {one.row: one for one in entries}
        self.indexed: tuple[MinutiaIndex | None, dict[int, Entry]] = (None, {})
        self._lock = threading.Lock()

    def of(self, person: str | None, finger: str | None) -> list[Entry]:
        """Entries of a person, a finger, or all, in the order of enrolment."""
        who = {"person": person, "finger": finger}
        wanted = {name: value for name, value in who.items() if value is not None}
        found = [
            one for one in self.entries.values() if all(getattr(one, name) == value for name, value in wanted.items())
        ]
        words = " and ".join(f"{name} '{value}'" for name, value in wanted.items())
        require(
            bool(found) or not wanted,
            f"'{self.path}' holds nothing of {words}; 'splitknit gallery list' shows who is in it.",
        )
        return found

    def index(self) -> MinutiaIndex:
        """Index of the minutiae of all templates; what an earlier one knows is not read again."""
        from splitknit_match.gallery.minutia_index import MinutiaIndex  # a list of names needs none of it

        with self._lock:
            earlier, known = self.indexed
            if earlier is None or known is not self.entries:
                same = {row for row, one in known.items() if self.entries.get(row) == one}
                earlier = MinutiaIndex(self.templates, self.path, earlier, same)
                self.indexed = earlier, self.entries
            return earlier


class GalleryFile:
    """The file of a gallery. It stays open; threads and forked processes may use one object.

    Each call sees whichever file has the name then, and what other programs changed in it. One that was there and is
    gone is refused.
    """

    def __init__(self, path: AnyPath, key: Key | AnyPath | None = None) -> None:
        """Remember path and key; the file is read with the first call that needs it."""
        self.path, self.key = Path(path), key_of(key)
        self._driver = sqlite3 if self.key is None else _sqlcipher()
        self._was_there = _stamp_of(self.path) is not None
        self._forget()

    def _forget(self) -> None:
        self._lock, self._pid = threading.Lock(), os.getpid()
        self._database: Any = None
        self._stamp: tuple[int, ...] | None = None
        """Of the file as it was opened last: where it lies, its size, and the time of its last change."""
        self._settings_sha256 = ""
        self._people: People | None = None
        self._seen: tuple[Any, ...] | None = None
        self._logged = False

    def __enter__(self) -> GalleryFile:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file and what was read."""
        if self._database is not None and self._pid == os.getpid():
            self._database.close()
        self._forget()

    @property
    def there(self) -> bool:
        """Whether there is one; an empty file is none yet. Raises Unavailable if it was there, and is gone."""
        found = _stamp_of(self.path)
        self._was_there |= found is not None
        gone = found is None and self._was_there
        require(not gone, f"the gallery '{self.path}' is gone (moved or removed); put it back.", Unavailable)
        return found is not None and found[2] > 0

    # What it holds.

    def __len__(self) -> int:
        with self._reading() as database:
            return int(database.execute("SELECT count(*) FROM finger").fetchone()[0])

    @property
    def settings_sha256(self) -> str:
        """Hash of the settings that all its templates were made with."""
        with self._reading():
            return self._settings_sha256

    def entries(self, person: str | None = None, finger: str | None = None, session: str | None = None) -> list[Entry]:
        """All rows in the order of enrolment, or those of a person, finger or session.

        Raises BadInput if a row is damaged.
        """
        with self._reading() as database:
            return self._entries(database, person=person, finger=finger, session=session)

    def templates(self, rows: Sequence[int] | None = None) -> dict[int, bytes]:
        """Templates (payloads) by row, of all or of those named; rows that were removed meanwhile are missing."""
        with self._reading() as database:
            return self._templates(database, rows)

    def images(self, rows: Sequence[int] | None = None) -> dict[int, bytes]:
        """What was kept of the pictures, by row."""
        with self._reading() as database:
            return _contents(database, "SELECT id, content FROM images", rows)

    def people(self, person: str | None = None) -> People:
        """What it holds, kept in memory for the next call; of one person alone if the rest was not read yet."""
        with self._reading() as database:
            seen = (*(self._stamp or ()), *database.execute("PRAGMA data_version").fetchone())
            if self._people is not None and seen == self._seen:
                return self._people
            entries = self._entries(database, person=person)
            earlier = self._people or People(self.path, "", [], {})
            same = {one.row for one in entries if earlier.entries.get(one.row) == one}
            new = [one.row for one in entries if one.row not in same]
            templates = {row: earlier.templates[row] for row in same}
            templates |= self._templates(database, new if same or person is not None else None)
            for row in new:
                if row not in templates:
                    raise self._damaged_row(row, "it has no template")
            people = People(self.path, self._settings_sha256, entries, templates)
            people.indexed = earlier.indexed
            if person is None:
                self._people, self._seen = people, seen
            return people

    def problems(self) -> list[tuple[int | None, str]]:
        """What is wrong, by row (None: with the file): SQLite's own checks, every entry, every template.

        Nothing if all is sound. Each is one printable line.
        """
        found: list[tuple[int | None, str]] = []
        with self._reading() as database:
            for check in ("integrity_check(20)", *([] if self.key is None else ["cipher_integrity_check"])):
                texts = database.execute(f"PRAGMA {check}").fetchall()
                lines = [line for (text,) in texts for line in str(text).splitlines() if line.strip()]
                found += [(None, printable(line)) for line in lines if line != "ok"]
            every = " UNION ".join(f"SELECT id FROM {table}" for table in _ROWS)
            for (row,) in database.execute(f"{every} ORDER BY id").fetchall():
                try:
                    require(len(self._entries(database, id=row)) == 1, f"row {row} has a content and no name.")
                    payload = self._templates(database, [row]).get(row)
                    require(payload is not None, f"row {row} has no template.")
                    (unpack_minutiae if holds_minutiae(payload or b"") else unpack)(payload or b"")
                except BadInput as error:
                    found.append((row, str(error)))
        return found

    def _entries(self, database: Any, **wanted: Any) -> list[Entry]:
        wanted = {name: value for name, value in wanted.items() if value is not None}
        where = " AND ".join(f"{name} = ?" for name in wanted) or "TRUE"
        query = f"SELECT id, {_COLUMNS} FROM finger WHERE {where} ORDER BY id"
        found = []
        for row, *values in database.execute(query, tuple(wanted.values())).fetchall():
            try:
                sound = all(type(value) is kind for value, kind in zip(values, _KINDS.values(), strict=True))
                require(sound, "a value is of another kind.")
                found.append(Entry(**dict(zip(_KINDS, values, strict=True)), row=row))
            except BadInput as error:
                raise self._damaged_row(row, str(error)) from error
        return found

    def _templates(self, database: Any, rows: Sequence[int] | None) -> dict[int, bytes]:
        found = _contents(database, "SELECT id, content, template_sha256 FROM template JOIN finger USING (id)", rows)
        for row, (content, sha256) in found.items():
            sound = isinstance(content, bytes) and hashlib.sha256(content).hexdigest() == sha256
            if not sound:
                raise self._damaged_row(row, "its template was changed.")
        return {row: content for row, (content, _) in found.items()}

    def _damaged_row(self, row: int, why: str) -> BadInput:
        return BadInput(
            f"row {row} of the gallery '{self.path}' is damaged ({why.rstrip('.')}); 'splitknit gallery check' lists "
            f"what is sound, 'splitknit gallery remove' takes row {row} out."
        )

    # What changes it.

    def add(
        self,
        captures: Iterable[NewCapture],
        settings_sha256: str,
        *,
        replaces: bool = False,
        first: Callable[[], object] = lambda: None,
        last: Callable[[], object] = lambda: None,
    ) -> list[bool]:
        """Put captures in, all or none; of each, whether it is new (False: the very same is there already).

        A gallery that is not there is made, for templates of these settings. `first` and `last` are called while no
        other program can change it, before anything is written, and before what was written is final: what they raise
        undoes it.

        Raises BadInput if another capture has these names (person, finger, session) and `replaces` is false.
        """
        new, replaced = [], False
        with self._changing(settings_sha256) as database:
            first()
            for one in captures:
                digest = hashlib.sha256(one.template).hexdigest()
                entry = replace(one.entry, template_bytes=len(one.template), template_sha256=digest)
                person, finger, session = entry.names
                earlier = self._entries(database, person=person, finger=finger, session=session)
                same = [
                    each.template_sha256 == digest and each.source_sha256 == entry.source_sha256 for each in earlier
                ]
                new.append(not any(same))
                if any(same):
                    continue
                require(
                    replaces or not earlier,
                    f"{entry.words} is in '{self.path}' already, made from something else; name another session, or "
                    "give `replace`.",
                )
                replaced |= bool(_delete(database, [each.row for each in earlier]))
                values = [getattr(entry, name) for name in _KINDS]
                row = database.execute(
                    f"INSERT INTO finger ({_COLUMNS}) VALUES (?{', ?' * (len(values) - 1)})", values
                ).lastrowid
                for table, content in (("template", one.template), ("images", one.images)):
                    if content is not None:
                        database.execute(f"INSERT INTO {table} VALUES (?, ?)", (row, content))
            if replaced:
                _rewrite(database)
            last()
        return new

    def remove(self, rows: Sequence[int]) -> int:
        """Remove rows so that nothing of them remains in the file; return how many there were."""
        with self._changing() as database:
            gone = _delete(database, rows)
            if gone:
                _rewrite(database)
        return gone

    # The file.

    @contextlib.contextmanager
    def _reading(self) -> Iterator[Any]:
        """One state of the gallery, whatever others write meanwhile; keep it short, as it holds them up."""
        if self._pid != os.getpid():  # a database must not cross a fork; the lock may be held by a thread left behind
            self._forget()
        with self._lock, self._told():
            require(self.there, f"there is no gallery '{self.path}'; 'splitknit enroll' makes one.")
            stamp = _stamp_of(self.path)
            if self._database is None or self._stamp != stamp:  # another file, or another program's change
                if self._database is not None:
                    self._database.close()
                self._database = None
                self._put_down()
                self._database, self._stamp = self._connect(), stamp
            with _transaction(self._database, "BEGIN"):
                self._settings_sha256 = self._checked(self._database)
                yield self._database

    @contextlib.contextmanager
    def _changing(self, settings_sha256: str | None = None) -> Iterator[Any]:
        """All or nothing; a writer waits for other writers first. With settings a missing gallery is made."""
        there = self.there
        require(there or settings_sha256 is not None, f"there is no gallery '{self.path}'.")
        with self._told():
            self._put_down()
            if not there:
                self.path.touch(private_modes()[0])
            place = _stamp_of(self.path)
            with contextlib.closing(self._connect()) as database, _transaction(database, "BEGIN IMMEDIATE"):
                try:
                    if not database.execute("PRAGMA schema_version").fetchone()[0]:
                        _make(database, settings_sha256 or "")
                    self.require_comparable(self._checked(database), settings_sha256)
                    yield database
                    now = _stamp_of(self.path)
                    same = now is not None and place is not None and now[:2] == place[:2]
                    require(same, f"'{self.path}' was replaced or removed meanwhile; run the same again.", Unavailable)
                except BaseException:
                    if not there and not self.there:  # it appears with its first finger, or not at all
                        self.path.unlink(missing_ok=True)
                    raise

    def require_comparable(self, own: str, settings_sha256: str | None) -> None:
        """Raise BadInput if its templates (`own`) were made with other settings: nothing is mixed."""
        require(
            settings_sha256 in (None, own),
            f"the templates in '{self.path}' were made with other settings (band, template); give the same "
            "`settings`, or enrol the fingers again in a new gallery.",
        )

    def _connect(self) -> Any:
        """A connection of its own."""
        require(self.path.is_file(), f"'{self.path}' is not a file; name the file of a gallery.")
        database = self._driver.connect(
            f"{self.path.resolve().as_uri()}?mode=rw", uri=True, timeout=WAIT_S, isolation_level=None,
            check_same_thread=False,
        )  # fmt: skip
        try:
            for statement in () if self.key is None else ("PRAGMA cipher_log_level=NONE", self.key.pragma):
                database.execute(statement)
            for setting in _SETTINGS:
                database.execute(f"PRAGMA {setting}")
        except BaseException:
            database.close()
            raise
        return database

    def _checked(self, database: Any) -> str:
        """Hash of the settings of its templates. Raises BadInput if it is not a gallery, or of another version."""
        (application,) = database.execute("PRAGMA application_id").fetchone()
        (version,) = database.execute("PRAGMA user_version").fetchone()
        fault = f"'{self.path}' is another program's database, not a gallery; name another file."
        require(application == APPLICATION_ID, fault)
        require(version == VERSION, self._other_version(version))
        found = database.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name").fetchall()
        require([row[0] for row in found] == [_ABOUT, *_ROWS.values()], self._damaged("its tables are not a gallery's"))
        about = database.execute("SELECT settings_sha256, template_version FROM about LIMIT 2").fetchall()
        sound = len(about) == 1 and isinstance(about[0][0], str) and type(about[0][1]) is int
        require(sound, self._damaged("its own record cannot be read"))
        require(
            about[0][1] == TEMPLATE_VERSION,
            f"the templates in '{self.path}' are of version {about[0][1]}, but this program makes version "
            f"{TEMPLATE_VERSION}; enrol the fingers again in a new gallery.",
        )
        return str(about[0][0])

    def _put_down(self) -> None:
        """Add a line to the access log, where one lies beside the gallery: who opens it when, for which verb."""
        log = self.path.with_name(self.path.name + LOG)
        if self._logged or not os.path.lexists(log):
            return
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        uid = os.getuid() if hasattr(os, "getuid") else None
        who = {"time": now, "user": getpass.getuser(), "uid": uid, "verb": VERB.get()}
        try:
            append_line(log, {**who, "gallery": str(self.path.resolve())})
        except OSError as error:
            raise Unavailable(
                f"the access log '{log}' cannot be written ({error.strerror}), and without it '{self.path}' is not "
                "opened."
            ) from error
        self._logged = True

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Turn errors of SQLite and of the system into one sentence."""
        path = self.path
        try:
            yield
        except UnicodeDecodeError as error:  # a name in its schema, or in SQLite's own message
            raise Unavailable(self._damaged("a text in it is not UTF-8")) from error
        except OSError as error:
            raise Unavailable(
                f"the gallery '{path}' cannot be written: {error.strerror}; choose another place."
            ) from error
        except self._driver.Error as error:
            code = getattr(error, "sqlite_errorcode", 0) & 0xFF
            words = {
                5: f"another program is writing the gallery '{path}'; nothing was changed: run the same again.",
                8: f"the gallery '{path}' may not be written here; change its permissions, or copy it.",
                13: f"the disk of '{path}' is full; the gallery is as it was before: make room, run the same again.",
                14: f"the gallery '{path}' cannot be opened, or its folder cannot be written; check the permissions.",
            }
            words[6] = words[5]
            text = self._why_not() if code == 26 else self._damaged(shown_path(str(error)))
            raise Unavailable(words.get(code, text)) from error

    def _why_not(self) -> str:
        """Sentence for a file that SQLite, or SQLCipher under this key, does not read."""
        with self.path.open("rb") as stream:
            begin = stream.read(72)
        if begin[:16] != _MAGIC:
            cure = "give its key with `key_file` or in SPLITKNIT_GALLERY_KEY"
            if self.key is None:
                return f"'{self.path}' is not a gallery, or it is encrypted; {cure}."
            return f"the key is not that of the gallery '{self.path}', or the file is not a gallery or damaged."
        if self.key is None:
            return self._damaged("its first page")
        version = int.from_bytes(begin[60:64], "big")
        if begin[68:] == APPLICATION_ID.to_bytes(4, "big") and version != VERSION:
            return self._other_version(version)
        return (
            f"a key was given, but the gallery '{self.path}' is not encrypted; leave the key out, or put an export of "
            "it into a new gallery with the key."
        )

    def _other_version(self, version: int) -> str:
        return (
            f"'{self.path}' is a gallery of version {version}, but this program reads version {VERSION}; enrol the "
            "fingers again, or export it with the program that wrote it and import that here."
        )

    def _damaged(self, what: str) -> str:
        cure = "take a copy or an export of it, or enrol the fingers again"
        return f"the gallery '{self.path}' is damaged ({what}); {cure}."


def _stamp_of(path: Path) -> tuple[int, ...] | None:
    """Device, inode, size and time of the last change of a file; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def _sqlcipher() -> Any:
    with importing("encrypted galleries need SQLCipher: pip install 'splitknit-match[encrypt]'."):
        from sqlcipher3 import dbapi2
    return dbapi2


def _make(database: Any, settings_sha256: str) -> None:
    for statement in (_ABOUT, *_ROWS.values()):
        database.execute(statement)
    database.execute("INSERT INTO about VALUES (?, ?)", (settings_sha256, TEMPLATE_VERSION))
    database.execute(f"PRAGMA application_id={APPLICATION_ID}")
    database.execute(f"PRAGMA user_version={VERSION}")


def _contents(database: Any, query: str, rows: Sequence[int] | None) -> dict[int, Any]:
    """What a query gives by row: one value, or several."""
    if rows is None:
        found = database.execute(f"{query} ORDER BY id").fetchall()
    else:
        found = [one for row in rows for one in database.execute(f"{query} WHERE id = ?", (row,)).fetchall()]
    return {row: values[0] if len(values) == 1 else values for row, *values in found}


def _delete(database: Any, rows: Sequence[int]) -> int:
    counts = [
        [database.execute(f"DELETE FROM {table} WHERE id = ?", (row,)).rowcount for table in _ROWS] for row in rows
    ]
    return sum(map(any, counts))


def _rewrite(database: Any) -> None:
    """Write all rows into new tables. SQLite zeroes what it frees, but a page that it divided may hold a second copy of
    a row; tables that are written once, in order, hold none.
    """
    for table, statement in _ROWS.items():
        database.execute(f"ALTER TABLE {table} RENAME TO old_{table}")
        database.execute(statement)
        database.execute(f"INSERT INTO {table} SELECT * FROM old_{table} ORDER BY id")
        database.execute(f"DROP TABLE old_{table}")


@contextlib.contextmanager
def _transaction(database: Any, begin: str) -> Iterator[None]:
    """All or nothing."""
    database.execute(begin)
    try:
        yield
        database.execute("COMMIT")
    except BaseException:
        UNFINISHED.depth += 1
        try:
            with contextlib.suppress(Exception):
                database.execute("ROLLBACK")
        finally:
            UNFINISHED.leave()
        raise


def is_gallery(file: Path) -> bool:
    """Whether a file begins as galleries do, or, as an encrypted one begins like noise, has their name (.skg)."""
    with contextlib.suppress(OSError), file.open("rb") as stream:
        begin = stream.read(72)
        return file.suffix == ".skg" or (begin[:16] == _MAGIC and begin[68:] == APPLICATION_ID.to_bytes(4, "big"))
    return False
