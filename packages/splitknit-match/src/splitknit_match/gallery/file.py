"""The SQLite file of a gallery, and the counter file that may lie beside its key.

A gallery is made whole or not at all, opened only if it is one, and errors are one sentence.

A rollback journal (not a write-ahead log): at rest a gallery is one file, which can be copied, moved and read from a
read-only disk. A killed writer leaves a journal from which the next one who opens the gallery restores it.
``synchronous=EXTRA`` holds through a loss of power. A journal holds pages as they were, removed templates too, so that
it is never just unlinked: SQLite leaves it (``journal_mode=PERSIST``), and :func:`wipe_journal` overwrites it first.
"""

from __future__ import annotations

import contextlib
import datetime
import getpass
import json
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from splitknit import UNFINISHED, VERB, BadInput, append_line, atomic_file, open_file, read_bytes, require, shown_path
from splitknit_match.gallery import LOG

APPLICATION_ID = 0x534B4741
"""``SKGA``, in the header of the file."""
VERSION = 2
"""Version of the layout. Galleries of version 1 can be read; only a migration changes them."""
WAIT_S = 10.0
"""How long one waits for another program's transaction."""
_ABOUT = "CREATE TABLE about (document TEXT NOT NULL)"
STATE = "CREATE TABLE state (sealed BLOB NOT NULL)"
ROWS = {
    "finger": "CREATE TABLE finger (id INTEGER PRIMARY KEY, tag BLOB NOT NULL UNIQUE, version BLOB NOT NULL, "
    "code_version INTEGER, entry BLOB NOT NULL, code BLOB)",
    "images": "CREATE TABLE images (id INTEGER PRIMARY KEY, content BLOB NOT NULL)",
    "template": "CREATE TABLE template (id INTEGER PRIMARY KEY, content BLOB NOT NULL)",
}
"""What is large lies apart: names and codes of very many fingers are read without it."""
_FINGER_1 = (
    "CREATE TABLE finger (id INTEGER PRIMARY KEY, tag BLOB NOT NULL UNIQUE, entry BLOB NOT NULL, code BLOB, "
    "code_version INTEGER)"
)
_SCHEMAS = {
    1: (_ABOUT, _FINGER_1, ROWS["images"], ROWS["template"]),
    2: (_ABOUT, ROWS["finger"], ROWS["images"], STATE, ROWS["template"]),
}
_MAX_RECORD, _MAX_COUNTER = 10_000, 1_000_000
"""Bytes of a gallery's own record, and of a counter file (about 20,000 galleries)."""
_MAGIC = b"SQLite format 3\0"
_BUSY, _READONLY, _FULL, _CANTOPEN = (5, 6), 8, 13, 14


class Unavailable(BadInput):
    """The file of a gallery cannot be used now, whatever is asked of it: gone, locked, on a full disk, damaged."""


def create_file(path: Path, about: str, state: bytes) -> bool:
    """Make an empty gallery; False if there is a file of that name already."""
    with contextlib.closing(sqlite3.connect(":memory:", isolation_level=None)) as database:
        database.execute(f"PRAGMA application_id={APPLICATION_ID}")
        database.execute(f"PRAGMA user_version={VERSION}")
        for statement in _SCHEMAS[VERSION]:
            database.execute(statement)
        database.execute("INSERT INTO about VALUES (?)", (about,))
        database.execute("INSERT INTO state VALUES (?)", (state,))
        content = database.serialize()
    try:
        with atomic_file(path, overwrite=False) as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    except BadInput as error:
        if path.exists():
            return False
        raise Unavailable(str(error)) from error
    return True


def place_of(path: Path) -> tuple[int, int] | None:
    """Device and inode of a file, by which another one of the same name is told apart; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def connect(path: Path, *, wait_s: float = WAIT_S, shared: bool = False) -> sqlite3.Connection:
    """Open an existing gallery, `shared` by threads or not.

    Raises BadInput if it is none, of another program or version, damaged, or locked.
    """
    _look_at(path)
    _put_down(path)
    with _told(path):
        database = sqlite3.connect(
            f"{path.resolve().as_uri()}?mode=rw", uri=True, timeout=wait_s, isolation_level=None,
            check_same_thread=not shared,
        )  # fmt: skip
        try:
            _prepare(database, path)
            if os.path.lexists(f"{path.resolve()}-journal"):  # of a program that was killed
                with contextlib.suppress(BadInput):
                    wipe_journal(database, path)
        except BaseException:
            database.close()
            raise
    return database


def _put_down(path: Path) -> None:
    """Add a line to the access log, where one lies beside the gallery: who opens it when, for which verb."""
    file = path.with_name(path.name + LOG)
    if not os.path.lexists(file):
        return
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    uid = os.getuid() if hasattr(os, "getuid") else None
    line = {"time": now, "user": getpass.getuser(), "uid": uid, "verb": VERB.get(), "gallery": str(path.resolve())}
    try:
        append_line(file, line)
    except OSError as error:
        raise Unavailable(
            f"the access log '{file}' cannot be written ({error.strerror}), and without it '{path}' is not opened."
        ) from error


def _look_at(path: Path) -> None:
    """Refuse what does not begin as SQLite files do, before SQLite raises its own error."""
    try:
        require(path.exists(), f"there is no gallery '{path}'; 'splitknit enroll' makes one.")
        require(not path.is_dir(), f"'{path}' is a folder; name the file of a gallery.")
        with open_file(path, 1 << 62) as (stream, _):
            begin = stream.read(len(_MAGIC))
    except (OSError, ValueError) as error:
        if isinstance(error, BadInput):
            raise
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"the gallery '{path}' cannot be opened: {reason}.") from error
    require(begin == _MAGIC, f"'{path}' is not a gallery (it is not an SQLite file); name another file.")


def _prepare(database: sqlite3.Connection, path: Path) -> None:
    # the first look at the file may roll a killed writer's change back; so that its journal is not unlinked with what
    # it holds, SQLite must be in one of the modes that keep it, and only the exclusive one can be set without a look
    for pragma in (
        "locking_mode=EXCLUSIVE", "journal_mode=PERSIST", "locking_mode=NORMAL",
        "trusted_schema=OFF", "cell_size_check=ON", "secure_delete=ON", "temp_store=MEMORY", "synchronous=EXTRA",
    ):  # fmt: skip
        database.execute(f"PRAGMA {pragma}").fetchall()
    (application,) = database.execute("PRAGMA application_id").fetchone()
    (version,) = database.execute("PRAGMA user_version").fetchone()
    require(application == APPLICATION_ID, f"'{path}' is another program's database, not a gallery; name another file.")
    require(
        version in _SCHEMAS,
        f"'{path}' is a gallery of version {version}, but this program reads versions 1 and {VERSION}; use the program "
        "that wrote it to export the gallery, and import it here.",
    )
    found = database.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name").fetchall()
    require([row[0] for row in found] == list(_SCHEMAS[version]), damaged(path, "its tables are not a gallery's"))


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """Turn SQLite's errors into one sentence."""
    try:
        yield
    except UnicodeDecodeError as error:  # a name in its schema, or in SQLite's own message
        raise BadInput(damaged(path, "a text in it is not UTF-8")) from error
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code in _BUSY:
            message = f"another program is writing the gallery '{path}'; nothing was changed: run the same again."
        elif code == _READONLY:
            message = f"the gallery '{path}' may not be written here; change its permissions, or copy it."
        elif code == _FULL:
            message = f"the disk of '{path}' is full; the gallery is as it was before: make room, run the same again."
        elif code == _CANTOPEN:
            message = f"the gallery '{path}' cannot be opened, or its folder cannot be written; check the permissions."
        else:
            message = damaged(path, shown_path(str(error)))
        raise Unavailable(message) from error


def damaged(path: Path, what: str) -> str:
    """Sentence for a gallery that cannot be used."""
    return f"the gallery '{path}' is damaged ({what}); take a copy or an export of it, or enrol the fingers again."


def read_about(database: sqlite3.Connection, path: Path) -> tuple[int, dict[str, Any]]:
    """Version of the layout, and the gallery's own record."""
    (version,) = database.execute("PRAGMA user_version").fetchone()
    try:
        document: dict[str, Any] = json.loads(read_record(database, "about", "document"))
        require(isinstance(document, dict), "no object")
    except (ValueError, RecursionError) as error:
        raise BadInput(damaged(path, "its own record cannot be read")) from error
    return int(version), document


def read_record(database: sqlite3.Connection, table: str, column: str) -> bytes:
    """The one record of a table; raises ValueError unless it is one, and short."""
    try:
        rows = database.execute(f"SELECT rowid FROM {table} LIMIT 2").fetchall()
        with database.blobopen(table, column, rows[0][0], readonly=True) as record:
            if len(rows) == 1 and len(record) <= _MAX_RECORD:
                return record.read()
    except (IndexError, sqlite3.OperationalError):  # none, or neither text nor bytes
        pass
    raise ValueError(table)


@contextlib.contextmanager
def transaction(database: sqlite3.Connection, path: Path, *, write: bool) -> Iterator[None]:
    """All or nothing; a writer waits for other writers first."""
    with _told(path):
        database.execute("BEGIN IMMEDIATE" if write else "BEGIN")
        try:
            yield
            database.execute("COMMIT")
        except BaseException:
            UNFINISHED.depth += 1
            try:
                with contextlib.suppress(sqlite3.Error):
                    database.execute("ROLLBACK")
            finally:
                UNFINISHED.leave()
            raise


def wipe_journal(database: sqlite3.Connection, path: Path) -> None:
    """Overwrite the rollback journal with zeros and remove it, also one that a killed writer left.

    Nothing is done while another program writes: the journal is its own then, and it wipes it.
    """
    (wait_ms,) = database.execute("PRAGMA busy_timeout").fetchone()
    database.execute("PRAGMA busy_timeout = 0")
    try:
        database.execute("BEGIN IMMEDIATE")  # keeps other writers away, not readers; rolls a killed one's change back
    except sqlite3.OperationalError:
        return
    finally:
        database.execute(f"PRAGMA busy_timeout = {int(wait_ms)}")
    journal = Path(f"{path.resolve()}-journal")
    try:
        wipe(journal)
    except OSError as error:
        raise BadInput(
            f"'{journal}' cannot be overwritten: {error.strerror}; it may hold what was removed: delete it once no "
            "program uses the gallery."
        ) from error
    finally:
        database.execute("ROLLBACK")


def wipe(file: Path) -> None:
    """Overwrite a file with zeros and remove it, if it is there. Raises OSError, also of a link."""
    with contextlib.suppress(FileNotFoundError):
        with wiping(file):
            pass
        file.unlink()


@contextlib.contextmanager
def wiping(file: Path) -> Iterator[None]:
    """Overwrite what a file holds with zeros when the block, which may put another in its place, ends."""
    # a link would lead to a file that is not ours
    descriptor = os.open(file, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(descriptor, "r+b", buffering=0) as stream:
        yield
        left = os.fstat(descriptor).st_size
        while left > 0:
            left -= stream.write(bytes(min(left, 1 << 20)))
        os.fsync(descriptor)


def is_gallery(file: Path) -> bool:
    """Whether a file begins as galleries do."""
    with contextlib.suppress(BadInput), open_file(file, 1 << 62) as (stream, _):
        begin = stream.read(72)
        return begin.startswith(_MAGIC) and begin[68:] == APPLICATION_ID.to_bytes(4, "big")
    return False


def read_counter(file: Path) -> dict[str, int]:
    """Last change that was seen of each gallery; an empty file has seen none.

    Raises BadInput if it cannot be read, or is not a counter file.
    """
    content = read_bytes(file, _MAX_COUNTER)
    try:
        seen: Any = json.loads(content) if content else {}
        require(isinstance(seen, dict) and all(type(one) is int for one in seen.values()), "other values")
        return dict(seen)
    except (ValueError, RecursionError) as error:
        raise BadInput(
            f"'{shown_path(file)}' is not a counter file of galleries, or damaged; empty it to begin anew."
        ) from error


def write_counter(file: Path, gallery: str, change: int) -> None:
    """Keep the number of a gallery's last change, or leave the file as it was."""
    seen = read_counter(file)
    if seen.get(gallery, -1) >= change:
        return
    content = json.dumps(seen | {gallery: change}, sort_keys=True, indent=1) + "\n"
    try:
        with atomic_file(file) as stream:
            stream.write(content.encode("ascii"))
            stream.flush()
            os.fsync(stream.fileno())
    except BadInput as error:
        raise Unavailable(f"the gallery is changed, but its counter is not: {error}") from error


def describe(path: Path) -> dict[str, Any]:
    """What anyone can see of a gallery without its key: kind of key, number of rows, sizes.

    Raises BadInput if it is not a gallery, damaged, or of another version.
    """
    with contextlib.closing(connect(path)) as database, transaction(database, path, write=False):
        version, about = read_about(database, path)
        counts = {
            "captures": "count(*) FROM finger",
            "with_code": "count(code) FROM finger",
            "with_images": "count(*) FROM images",
            "template_bytes": "total(length(content)) FROM template",
            "image_bytes": "total(length(content)) FROM images",
        }
        found = {name: int(database.execute(f"SELECT {what}").fetchone()[0]) for name, what in counts.items()}
    stated = {name: about.get(name) for name in ("key", "template_version", "settings_sha256")}
    encrypted = about.get("box") != "plain"
    return {"version": version, "encrypted": encrypted, **stated, **found, "file_bytes": path.stat().st_size}
