"""The SQLite file of a gallery: made whole or not at all, opened only if it is one, errors in words.

A rollback journal (not a write-ahead log): at rest a gallery is one file, which can be copied, moved and read from a
read-only disk, and a removal leaves no older pages in a log. A killed writer leaves a journal from which the next one
who opens the gallery restores it. ``synchronous=EXTRA`` holds through a loss of power.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from splitknit.check import BadInput, require

APPLICATION_ID = 0x534B4741
"""``SKGA``, in the header of the file."""
VERSION = 1
"""Of the layout; a reader refuses others."""
WAIT_S = 10.0
"""How long one waits for another program's transaction."""
SCHEMA = (
    "CREATE TABLE about (document TEXT NOT NULL)",
    "CREATE TABLE finger (id INTEGER PRIMARY KEY, tag BLOB NOT NULL UNIQUE, entry BLOB NOT NULL, code BLOB, "
    "code_version INTEGER)",
    "CREATE TABLE images (id INTEGER PRIMARY KEY, content BLOB NOT NULL)",
    "CREATE TABLE template (id INTEGER PRIMARY KEY, content BLOB NOT NULL)",
)
"""What is large lies apart: names and codes of very many fingers are read without it."""
_MAGIC = b"SQLite format 3\0"
_BUSY, _READONLY, _FULL, _CANTOPEN = (5, 6), 8, 13, 14


def create_file(path: Path, about: dict[str, Any]) -> bool:
    """Make an empty gallery that only its owner may read (0600); False if there is a file of that name already."""
    temporary = path.with_name(f".{path.name[:100]}.{secrets.token_hex(6)}.tmp")
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"cannot write '{path}': {reason}; choose another place for the gallery.") from error
    try:
        with told(path), contextlib.closing(sqlite3.connect(temporary, isolation_level=None)) as database:
            database.execute(f"PRAGMA application_id={APPLICATION_ID}")
            database.execute(f"PRAGMA user_version={VERSION}")
            database.execute("PRAGMA synchronous=EXTRA")
            database.execute("BEGIN")
            for statement in SCHEMA:
                database.execute(statement)
            database.execute("INSERT INTO about VALUES (?)", (json.dumps(about, sort_keys=True),))
            database.execute("COMMIT")
        try:
            os.link(temporary, path)  # fails where one exists, unlike a renaming
        except FileExistsError:
            return False
        except OSError as error:  # a disk without links
            if path.exists():
                return False
            try:
                temporary.rename(path)
            except OSError:
                raise BadInput(f"cannot write '{path}': {error.strerror}; choose another place.") from error
        return True
    finally:
        temporary.unlink(missing_ok=True)


def connect(path: Path, *, wait_s: float = WAIT_S) -> sqlite3.Connection:
    """Open an existing gallery.

    Raises
    ------
    BadInput
        If it is none, another program's, of another version, damaged, or cannot be opened.
    """
    _look_at(path)
    with told(path):
        database = sqlite3.connect(f"{path.resolve().as_uri()}?mode=rw", uri=True, timeout=wait_s, isolation_level=None)
        try:
            _prepare(database, path)
        except BaseException:
            database.close()
            raise
    return database


def _look_at(path: Path) -> None:
    """Refuse what does not begin as SQLite files do, before SQLite says so in its words."""
    try:
        require(path.exists(), f"there is no gallery '{path}'; 'splitknit enroll' makes one.")
        require(path.is_file(), f"'{path}' is a folder; name the file of a gallery.")
        with path.open("rb") as stream:
            begin = stream.read(len(_MAGIC))
    except (OSError, ValueError) as error:
        if isinstance(error, BadInput):
            raise
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"the gallery '{path}' cannot be opened: {reason}.") from error
    require(begin == _MAGIC, f"'{path}' is not a gallery (it is no SQLite file); name another file.")


def _prepare(database: sqlite3.Connection, path: Path) -> None:
    (application,) = database.execute("PRAGMA application_id").fetchone()
    (version,) = database.execute("PRAGMA user_version").fetchone()
    require(application == APPLICATION_ID, f"'{path}' is another program's database, not a gallery; name another file.")
    require(
        version == VERSION,
        f"'{path}' is a gallery of version {version}, but this program reads version {VERSION}; use the program that "
        "wrote it to export the gallery, and import it here.",
    )
    for pragma in (
        "trusted_schema=OFF", "cell_size_check=ON", "secure_delete=ON", "temp_store=MEMORY", "synchronous=EXTRA",
    ):  # fmt: skip
        database.execute(f"PRAGMA {pragma}").fetchall()
    found = database.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name").fetchall()
    require([row[0] for row in found] == list(SCHEMA), damaged(path, "its tables are not a gallery's"))


@contextlib.contextmanager
def told(path: Path) -> Iterator[None]:
    """Turn what SQLite says into one sentence."""
    try:
        yield
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
            message = damaged(path, str(error))
        raise BadInput(message) from error


def damaged(path: Path, what: str) -> str:
    """Sentence for a gallery that cannot be used."""
    return f"the gallery '{path}' is damaged ({what}); take a copy or an export of it, or enrol the fingers again."


def read_about(database: sqlite3.Connection, path: Path) -> dict[str, Any]:
    """What the gallery says of itself."""
    try:
        rows = database.execute("SELECT document FROM about").fetchall()
        document: dict[str, Any] = json.loads(rows[0][0])
        require(len(rows) == 1 and isinstance(document, dict), "not one document")
    except (IndexError, ValueError, TypeError, RecursionError) as error:
        raise BadInput(damaged(path, "what it says of itself cannot be read")) from error
    return document


@contextlib.contextmanager
def transaction(database: sqlite3.Connection, path: Path, *, write: bool) -> Iterator[None]:
    """All or nothing; a writer waits for other writers first."""
    with told(path):
        database.execute("BEGIN IMMEDIATE" if write else "BEGIN")
        try:
            yield
            database.execute("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                database.execute("ROLLBACK")
            raise


def describe(path: Path) -> dict[str, Any]:
    """What anyone can see of a gallery without its key: kind of key, number of rows, sizes.

    Raises
    ------
    BadInput
        If it is no gallery, damaged, or of another version.
    """
    with contextlib.closing(connect(path)) as database, transaction(database, path, write=False):
        about = read_about(database, path)
        counted = []
        for what in ("count(*), count(code) FROM finger",
                     "total(length(content)) FROM template",
                     "count(*), total(length(content)) FROM images"):  # fmt: skip
            counted += database.execute(f"SELECT {what}").fetchone()
    captures, codes, template_bytes, images, image_bytes = (int(one) for one in counted)
    return {
        "version": VERSION,
        "encrypted": about.get("box") != "plain",
        "key": about.get("key"),
        "template_version": about.get("template_version"),
        "settings_sha256": about.get("settings_sha256"),
        "captures": captures,
        "with_code": codes,
        "with_images": images,
        "template_bytes": template_bytes,
        "image_bytes": image_bytes,
        "file_bytes": path.stat().st_size,
    }
