"""The file of a gallery: SQLite, encrypted as a whole by SQLCipher where a key is given.

One table of people, one of captures. Readers go on beside one writer (write-ahead log); each writer
puts the log back into the file, so that a gallery at rest is one file. What a killed writer began
SQLite takes back.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import re
import select
import sqlite3
import stat
import threading
import unicodedata
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from splitknit import BadInput
from splitknit.arguments import AnyPath
from splitknit.errors import importing, require
from splitknit.files import open_at_once, shown_path
from splitknit.findings import Finding
from splitknit.interrupts import UNFINISHED
from splitknit.io.atomic import GROUP_READABLE, private_modes
from splitknit.io.enrolment import FINGERS
from splitknit.model import Progress
from splitknit_match.matching.template import VERSION as TEMPLATE_VERSION
from splitknit_match.threads import one_blas_thread

if TYPE_CHECKING:
    from splitknit_match.gallery.minutia_index import MinutiaIndex
    from splitknit_match.matching.ridge import Prepared

_log = logging.getLogger(__name__)

APPLICATION_ID = 0x534B4741
"""``SKGA``, in the header of the file. Source: definition of the format."""
VERSION = 5
"""Version of the file. Source: definition of the format."""
KEY_VARIABLE = "SPLITKNIT_GALLERY_KEY"
_MAGIC = b"SQLite format 3\0"
_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
_SCHEMA = {
    "about": (
        "CREATE TABLE about (settings_sha256 TEXT NOT NULL, template_version INTEGER NOT NULL, "
        "changes INTEGER NOT NULL, erasing INTEGER NOT NULL) STRICT"
    ),
    "capture": (
        "CREATE TABLE capture (id INTEGER PRIMARY KEY, person INTEGER NOT NULL REFERENCES person,"
        " finger TEXT NOT NULL, session TEXT NOT NULL, kind TEXT NOT NULL, source_sha256 TEXT NOT"
        " NULL, area_mm2 REAL NOT NULL, failure TEXT NOT NULL, enrolled_at TEXT NOT NULL,"
        " template_sha256 TEXT NOT NULL, template BLOB NOT NULL, minutiae BLOB NOT NULL, UNIQUE"
        " (person, finger, session)) STRICT"
    ),
    "person": "CREATE TABLE person (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE) STRICT",
    "sqlite_autoindex_capture_1": None,
    "sqlite_autoindex_person_1": None,
}
"""All that ``sqlite_master`` lists, in this order: names and statements."""
_NO_TABLES = "its tables are not a gallery's"
FIELDS = ("kind", "source_sha256", "area_mm2", "failure", "enrolled_at", "template_sha256")
_PRAGMAS = (
    "trusted_schema=OFF",
    "cell_size_check=ON",
    "foreign_keys=ON",
    "secure_delete=ON",
    "temp_store=MEMORY",  # what VACUUM copies never lies in another file
)
"""None of them parses the tables, which :func:`_tables_of` reads before."""


class Unavailable(BadInput):
    """The file of a gallery cannot be used now, whatever is asked of it: gone, locked, on a full
    disk, damaged."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What is known of an enrolled capture beside its template."""

    person: str
    """1 to 100 printable characters."""
    finger: str
    """Small letters, digits and _ ."""
    session: str
    """Letters, digits, - and _ ."""
    kind: str
    """``capture``, ``result``, ``template``, ``print``, ``photo`` or ``minutiae``."""
    source_sha256: str
    """Hash of the files that it was made from."""
    area_mm2: float = 0.0
    """Area of skin in the template; 0 for a failure to acquire."""
    failure: str = ""
    """Why nothing could be acquired, where that is known."""
    enrolled_at: str = ""
    """ISO 8601, UTC; blank where it was not to be kept."""
    template_sha256: str = ""
    """The gallery fills it in, and what follows."""
    template_bytes: int = 0
    """0 for a failure to acquire."""
    row: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "person", check_person(self.person))
        sound = re.fullmatch(r"[a-z0-9_]{1,32}", self.finger) is not None
        expected = "small letters, digits and _ are expected, such as right_index."
        require(sound, f"{self.finger[:60]!a} cannot be a finger: {expected}")
        check_session(self.session)
        require(
            0 <= self.area_mm2 <= 1e6,
            f"area_mm2 must be a number from 0 to a million, not {self.area_mm2}.",
        )

    @property
    def names(self) -> tuple[str, str, str]:
        """By which a capture is found; no two captures of a gallery share them."""
        return self.person, self.finger, self.session

    @property
    def words(self) -> str:
        """For people."""
        return in_words(*self.names)


def in_words(person: str, finger: str, session: str) -> str:
    """Names of a capture, for people."""
    return f"{person}, {finger.replace('_', ' ')}, session {session}"


@dataclass(frozen=True, slots=True)
class NewCapture:
    """What is put into a gallery."""

    entry: Entry
    template: bytes = field(repr=False)
    """Payload (:func:`splitknit_match.matching.template.pack`), empty for a failure to acquire."""
    minutiae: bytes = field(default=b"", repr=False)
    """As :func:`splitknit_match.gallery.minutia_index.kept_minutiae` makes them, where they are
    known."""


MAX_NAME = 100  # longest name of a person


def check_person(text: Any) -> str:
    """Return `text` in one normal form (NFC) if it can be a person's name. Raises BadInput."""
    require(isinstance(text, str), f"a person's name is a text, not {text!r}.")
    name = unicodedata.normalize("NFC", text).strip()
    sound = 0 < len(name) <= MAX_NAME and name.isprintable()
    escaped = text.encode("unicode_escape").decode("ascii")[:60]
    require(
        sound,
        f"'{escaped}' cannot be a person's name: 1 to {MAX_NAME} printable characters are"
        " expected.",
    )
    return name


def check_session(text: Any) -> str:
    """Return `text` if it can be a session's name."""
    sound = re.fullmatch(r"[A-Za-z0-9_-]{1,32}", session := str(text)) is not None
    expected = "up to 32 letters, digits, - and _ are expected, such as 1."
    require(sound, f"{session[:60]!a} cannot be a session: {expected}")
    return session


def known_finger(finger: str) -> str:
    """Return `finger` if it is one of the ten."""
    require(finger in FINGERS, f"'{finger}' is not a finger; fingers are {', '.join(FINGERS)}.")
    return finger


def session_order(session: str) -> tuple[int, int, str]:
    """Key to sort sessions by: numbers by their size, before names."""
    number = session.isascii() and session.isdigit()
    return (0, int(session), session) if number else (1, 0, session)


@dataclass(frozen=True, slots=True, repr=False)
class Key:
    """64 hexadecimal digits, or a passphrase. Is never shown."""

    text: str

    @property
    def pragma(self) -> str:
        """SQLCipher's statement that opens a gallery; a passphrase is stretched (PBKDF2, 256,000
        rounds of SHA-512)."""
        if re.fullmatch("[0-9A-Fa-f]{64}", self.text):
            return f"PRAGMA key = \"x'{self.text}'\""
        quoted = self.text.replace("'", "''")
        return f"PRAGMA key = '{quoted}'"


_MAX_KEY_BYTES = 4096  # longest file of a key


def key_of(file: Key | AnyPath | None) -> Key | None:
    """Key from a file or a pipe, else from the environment; None where neither has one.

    Raises BadInput if the file cannot be read, or what it holds is not a key.
    """
    if isinstance(file, Key):
        return file
    if file is not None:
        content, where = b"", f"the key file {shown_path(file)}"
        try:
            with open(file, "rb", opener=open_at_once) as stream:
                # how long a pipe may be without a program that writes into it
                select.select([stream], [], [], 2.0)
                # a writer takes as long as it likes: it may ask for a password
                os.set_blocking(stream.fileno(), True)
                content = stream.read(_MAX_KEY_BYTES + 1)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise BadInput(f"{where} cannot be read: {reason}.") from error
    elif KEY_VARIABLE in os.environ:
        content, where = os.fsencode(os.environ[KEY_VARIABLE]), f"the variable {KEY_VARIABLE}"
    else:
        return None
    text = unicodedata.normalize("NFC", content.decode("utf-8", "replace").rstrip("\r\n"))
    sound = (
        len(content) <= _MAX_KEY_BYTES
        and text.isprintable()
        and "\ufffd" not in text
        and len(text) >= 8
    )
    expected = "a passphrase of 8 characters or more, or 64 hexadecimal digits, are expected."
    require(sound, f"{where} holds no key: {expected}")
    return Key(text)


def readable(file: Path, what: str, others: int = 0o077) -> tuple[Finding, ...]:
    """A finding where others can read a secret file."""
    if os.name != "posix" or not file.is_file() or not file.stat().st_mode & others:
        return ()
    words = f"the {what} '{file}' can be read by others on this computer (chmod 600 ends that)."
    return (Finding("readable-by-others", words, files=(str(file),)),)


def readable_gallery(gallery: AnyPath, key_file: AnyPath | None) -> tuple[Finding, ...]:
    """Findings where others can read a gallery, or the file of its key."""
    others = 0o007 if os.environ.get(GROUP_READABLE) == "1" else 0o077
    keys = () if key_file is None else readable(Path(key_file), "key file")
    return (*readable(Path(gallery), "gallery", others), *keys)


_PREPARED = 64
"""Templates that are kept ready, 2 to 5 MB each. Chosen on: memory."""


class Chosen(NamedTuple):
    """Captures that a search goes through; of the acquired ones also how many."""

    entries: list[Entry]
    acquired: list[Entry]
    fingers: int
    people: int


class People:
    """What a gallery held at one time, in memory; threads may share it."""

    def __init__(
        self,
        path: Path,
        settings_sha256: str,
        entries: list[Entry],
        templates: dict[int, bytes],
        minutiae: dict[int, bytes | memoryview],
    ) -> None:
        """Take over what was read; `minutiae`: of some rows, as
        :func:`splitknit_match.gallery.minutia_index.kept_minutiae` makes them."""
        self.path = path
        self.settings_sha256 = settings_sha256
        self.entries = {entry.row: entry for entry in entries}
        self.templates = templates
        self.minutiae = minutiae
        self.spread: Callable[[Callable[[People], Any]], Iterator[Any]] | None = None
        """Does something with each part, where workers of a cluster hold the parts."""
        self.source: tuple[Any, ...] = ()
        """What a part is read from: Dask moves that, or puts it on a disk, and no template."""
        self.prepared = lru_cache(_PREPARED)(self._prepare)
        self.of = lru_cache(1)(self._chosen)
        self._index: list[MinutiaIndex] | None = None
        self._lock = threading.Lock()

    def _prepare(self, row: int) -> Prepared:
        """Template of a row, ready to be compared. Raises BadInput, naming the row."""
        from splitknit_match.gallery.minutia_index import unpacked
        from splitknit_match.matching.ridge import Prepared

        return Prepared(unpacked(self.path, row, self.payload(row)))

    def _chosen(self, person: str | None, finger: str | None) -> Chosen:
        """Those of a person, a finger, or all, in the order of enrolment."""
        entries = [
            entry
            for entry in self.entries.values()
            if person in (None, entry.person) and finger in (None, entry.finger)
        ]
        acquired = [entry for entry in entries if entry.template_bytes > 0]
        people = {entry.person for entry in acquired}
        fingers = {(entry.person, entry.finger) for entry in acquired}
        return Chosen(entries, acquired, len(fingers), len(people))

    def payload(self, row: int) -> bytes:
        """Template of a row; of a part without it empty."""
        if self.spread is None:
            return self.templates.get(row, b"")
        return b"".join(self.spread(partial(People.payload, row=row)))

    def __sizeof__(self) -> int:
        return sum(map(len, (*self.templates.values(), *self.minutiae.values())))

    def __reduce__(self) -> tuple[Any, ...]:
        return _part, self.source

    def index(self, progress: Progress) -> list[MinutiaIndex]:
        """Indexes of the minutiae of all templates, each of :data:`PART` of them."""
        # a list of names needs none of it
        from splitknit_match.gallery.minutia_index import MinutiaIndex

        with self._lock:
            if self._index is None:
                self._index = [
                    MinutiaIndex(
                        {row: self.templates[row] for row in rows},
                        self.path,
                        self.minutiae,
                        progress,
                    )
                    for rows in _parts(self.entries)
                ]
                # what was read of a file is let go, what was found is kept
                known = self.minutiae.items()
                self.minutiae = {row: own for row, own in known if isinstance(own, bytes)}
            return self._index


PART = 10_000
"""Captures of one index, and of what a worker of a cluster reads at a time. Chosen on: real prints
(what a search among so many loses: validation/gallery/index.py)."""


def _parts(entries: Iterable[int]) -> list[list[int]]:
    """Rows of each part."""
    rows = list(entries)
    return [rows[start : start + PART] for start in range(0, len(rows), PART)]


def _part(path: Path, rows: tuple[int, int]) -> People:
    """The part of a gallery between two rows, as a worker of a cluster holds it."""
    file = GalleryFile(path)
    file._sound = (_stamp_of(path) or ())[:2]  # the client looked
    part = file.people(rows=rows)
    part.source = path, rows
    part.prepared = lru_cache(0)(part._prepare)  # a worker holds many parts
    return part


_ALL = -(2**63), 2**63 - 1  # rows
WAIT_S = 10.0  # how long one waits for another program's transaction


class GalleryFile:
    """The file of a gallery; threads and forked processes may use one object.

    Each call opens whichever file has the name then, and sees what other programs changed in it;
    what was read is kept. One that was there and is gone is refused.
    """

    def __init__(
        self, path: AnyPath, key: Key | AnyPath | None = None, scheduler: str | None = None
    ) -> None:
        """Remember path, key, and the Dask scheduler whose workers search it; the file is read with
        the first call that needs it."""
        self.path, self.key = Path(path), key_of(key)
        self._driver = sqlite3 if self.key is None else _sqlcipher()
        self._was_there = _stamp_of(self.path) is not None
        self._sound: tuple[int, ...] | None = None
        """Device and inode of the file whose pages were checked."""
        self._kept: tuple[object, People | None] = None, None
        """What was read last, and of which state of which file."""
        self.scheduler, self._open = scheduler, contextlib.ExitStack()
        self._client: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of what was read."""
        self._kept = None, None
        self._open.close()
        self._client = None

    @property
    def there(self) -> bool:
        """Whether there is one; an empty file is none yet. Raises Unavailable if it was there, and
        is gone."""
        # before the file is looked for: another thread may make it meanwhile
        was_there = self._was_there
        stamp = _stamp_of(self.path)
        self._was_there |= stamp is not None
        gone = stamp is None and was_there
        require(
            not gone,
            f"the gallery '{self.path}' is gone (moved or removed); put it back.",
            Unavailable,
        )
        return stamp is not None and stamp[2] > 0

    # What it holds.

    def __len__(self) -> int:
        with self._reading() as database:
            return int(database.execute("SELECT count(*) FROM capture").fetchone()[0])

    def __iter__(self) -> Iterator[Entry]:
        return iter(self.entries())

    @property
    def settings_sha256(self) -> str:
        """Hash of the settings that all its templates were made with."""
        with self._reading() as database:
            return _settings_of(database)

    def entries(
        self, person: str | None = None, finger: str | None = None, session: str | None = None
    ) -> list[Entry]:
        """All captures in the order of enrolment, or those of a person, finger or session.

        Raises BadInput if one is damaged.
        """
        with self._reading() as database:
            return self._entries(database, person, finger, session)

    def people(self, person: str | None = None, rows: tuple[int, int] = _ALL) -> People:
        """What it holds (in some rows), kept in memory for the next call; of one person alone if
        the rest was not read yet."""
        with self._reading() as database:
            state = _stamp_of(self.path), database.execute("SELECT changes FROM about").fetchone()
            known_state, kept = self._kept
            if kept is not None and state == known_state:
                return kept
            self._kept = None, None
            entries = self._entries(database, person, rows=rows)
            templates, minutiae = dict[int, bytes](), dict[int, bytes | memoryview]()
            people = People(self.path, _settings_of(database), entries, templates, minutiae)
            if self.scheduler is None or person is not None:
                # in one piece, whose memory is returned once an index is made of it
                room, ends = bytearray(), [0]
                for row, entry in people.entries.items():
                    templates[row], own = self._read(database, entry)
                    room += own
                    ends.append(len(room))
                parts = map(memoryview(room).__getitem__, map(slice, ends, ends[1:]))
                minutiae.update(zip(templates, parts, strict=True))
            else:
                from splitknit_match.tasks import connected, job_of, on_cluster

                client = self._client or self._open.enter_context(connected(self.scheduler))
                ends_of = [(part[0], part[-1]) for part in _parts(people.entries)]
                # a key is in the workers' environment, not in what a scheduler keeps
                read = job_of(partial(_part, self.path.resolve()))
                people.spread = partial(on_cluster, client, client.map(read, ends_of, pure=False))
                self._client = client
            if person is None:
                self._kept = state, people
            return people

    def _entries(
        self,
        database: Any,
        person: str | None = None,
        finger: str | None = None,
        session: str | None = None,
        rows: tuple[int, int] = _ALL,
    ) -> list[Entry]:
        wanted = {"name": person, "finger": finger, "session": session}
        wanted = {name: value for name, value in wanted.items() if value is not None}
        columns = ", ".join(
            ("name", "finger", "session", *FIELDS, "length(template)", "capture.id")
        )
        where = "".join(f" AND {name} = ?" for name in wanted)
        query = (
            f"SELECT {columns} FROM capture JOIN person ON person = person.id WHERE capture.id"
            f" BETWEEN ? AND ?{where} ORDER BY capture.id"
        )
        try:
            return [Entry(*values) for values in database.execute(query, (*rows, *wanted.values()))]
        except BadInput as error:
            raise Unavailable(self._damaged(str(error).rstrip("."))) from error

    def _read(self, database: Any, entry: Entry) -> tuple[bytes, bytes]:
        """Template and minutiae of a capture."""
        template, minutiae = database.execute(
            "SELECT template, minutiae FROM capture WHERE id = ?", (entry.row,)
        ).fetchone()
        sound = hashlib.sha256(template).hexdigest() == entry.template_sha256
        cure = "take it out with 'splitknit gallery remove', and enrol it again"
        require(sound, f"the template of {entry.words} in '{self.path}' is damaged; {cure}.")
        return bytes(template), minutiae

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
        """Put captures in, all or none; of each, whether it is new (False: the very same is there
        already).

        A gallery that is not there is made, for templates of these settings. `first` and `last` are
        called while no other program can change it, before anything is written, and before what was
        written is final: what they raise undoes it.

        Raises BadInput if another capture has these names (person, finger, session) and `replaces`
        is false.
        """
        from splitknit_match.gallery.minutia_index import each, minutiae_of  # a list needs none

        several = list(captures)
        one_blas_thread()
        minutiae = list(each(lambda new: new.minutiae or minutiae_of(new.template), several))
        new = []
        with self._changing(settings_sha256) as (database, _):
            first()
            for capture, own in zip(several, minutiae, strict=True):
                digest = hashlib.sha256(capture.template).hexdigest()
                entry = replace(capture.entry, template_sha256=digest)
                earlier = self._entries(database, *entry.names)
                known = [(one.template_sha256, one.source_sha256) for one in earlier]
                new.append((digest, entry.source_sha256) not in known)
                if not new[-1]:
                    continue
                require(
                    replaces or not earlier,
                    f"{entry.words} is in '{self.path}' already, made from something else; name"
                    " another session, or give `replace`.",
                )
                if earlier:
                    _delete(database, *entry.names)
                database.execute("INSERT OR IGNORE INTO person (name) VALUES (?)", (entry.person,))
                (person,) = database.execute(
                    "SELECT id FROM person WHERE name = ?", (entry.person,)
                ).fetchone()
                facts = [getattr(entry, name) for name in FIELDS]
                values = [None, person, entry.finger, entry.session, *facts, capture.template, own]
                database.execute(
                    f"INSERT INTO capture VALUES (?{', ?' * (len(values) - 1)})", values
                )
                database.execute("UPDATE about SET changes = changes + 1")
            last()
        return new

    def remove(
        self,
        person: str,
        finger: str | None = None,
        session: str | None = None,
        *,
        last: Callable[[], object] = lambda: None,
    ) -> int:
        """Remove captures so that nothing of them remains in the file; return how many there were.

        `last`: as of :meth:`add`. Raises BadInput if there are none; returns 0 where only
        the bytes of captures removed earlier, which could not be erased then, were erased now.
        """
        with self._changing() as (database, erased):
            removed = _delete(database, check_person(person), finger, session)
            words = ", ".join(
                word for word in (person, finger, session and f"session {session}") if word
            )
            require(
                removed > 0 or erased,
                f"'{self.path}' holds nothing of {words}; 'splitknit gallery list' shows who is"
                " in it.",
            )
            last()
        _log.info("removed %d captures", removed)
        return removed

    # The file.

    @contextlib.contextmanager
    def _reading(self) -> Iterator[Any]:
        """One state of the gallery, whatever others write meanwhile."""
        with self._refusing("the gallery cannot be read"):
            require(self.there, f"there is no gallery '{self.path}'; 'splitknit enroll' makes one.")
            with contextlib.closing(self._connect()) as database, _transaction(database, "BEGIN"):
                self._check(database)
                yield database

    @contextlib.contextmanager
    def _changing(self, settings_sha256: str | None = None) -> Iterator[tuple[Any, bool]]:
        """All or nothing; a writer waits for other writers first. With settings a missing gallery
        is made. Also yields whether what was removed earlier is erased only now."""
        there = self.there
        require(there or settings_sha256 is not None, f"there is no gallery '{self.path}'.")
        with self._refusing("the gallery was not changed"):
            if not there:
                self.path.touch(private_modes()[0])
            place = _stamp_of(self.path)
            try:
                with contextlib.closing(self._connect()) as database:
                    made = bool(_tables_of(database))
                    if made:
                        self._check(database)
                    database.execute("PRAGMA synchronous=EXTRA")
                    erased = made and _is_erasing(database)
                    if erased:
                        self._erase(database)
                    with _transaction(database, "BEGIN IMMEDIATE"):
                        if not _tables_of(database):
                            _make(database, settings_sha256 or "")
                        self._check(database)
                        self.require_comparable(_settings_of(database), settings_sha256)
                        yield database, erased
                        now = _stamp_of(self.path)
                        same = now is not None and place is not None and now[:2] == place[:2]
                        require(
                            same,
                            f"'{self.path}' was replaced or removed meanwhile; run the same again.",
                            Unavailable,
                        )
                        erasing = _is_erasing(database)
                    # it is changed now: on a full disk the change stays in the log
                    with contextlib.suppress(self._driver.OperationalError):
                        database.execute("PRAGMA journal_mode=WAL")
                    if erasing:
                        self._erase(database)
                    with contextlib.suppress(self._driver.OperationalError):
                        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            except BaseException:
                if not there and not self.there:  # it appears with its first finger, or not at all
                    self.path.unlink(missing_ok=True)
                    self._was_there = False
                raise

    def _erase(self, database: Any) -> None:
        """Write a file anew that captures were deleted from: SQLite zeroes what it frees, but a
        page that it divided may hold a second copy of a row. A writer that was killed before leaves
        it to the next.
        """
        try:
            database.execute("VACUUM")
            busy = database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]
            require(not busy, "another program reads it", Unavailable)
            database.execute("UPDATE about SET erasing = 0")
        except (self._driver.Error, Unavailable) as error:
            raise Unavailable(
                f"what was removed from '{self.path}' is no longer listed, but its bytes may"
                f" still lie in the file ({shown_path(str(error))}); run the same again."
            ) from error

    def require_comparable(self, own: str, settings_sha256: str | None) -> None:
        """Raise BadInput if its templates (`own`) were made with other settings: nothing is
        mixed."""
        require(
            settings_sha256 in (None, own),
            f"the templates in '{self.path}' are of another version; enrol the fingers again in a"
            " new gallery.",
        )

    def _connect(self) -> Any:
        """A connection of its own."""
        require(self.path.is_file(), f"'{self.path}' is not a file; name the file of a gallery.")
        path = self.path.resolve()
        for end in ("-journal", "-wal", "-shm"):
            _require_its_own(path.with_name(path.name + end))
        writable = os.access(self.path, os.W_OK) and os.access(self.path.parent, os.W_OK)
        mode = "mode=rw" if writable else "mode=ro&immutable=1"
        database = self._driver.connect(
            f"{path.as_uri()}?{mode}", uri=True, timeout=WAIT_S, isolation_level=None
        )
        try:
            for statement in (
                () if self.key is None else ("PRAGMA cipher_log_level=NONE", self.key.pragma)
            ):
                database.execute(statement)
            for pragma in _PRAGMAS:
                database.execute(f"PRAGMA {pragma}")
        except BaseException:
            database.close()
            raise
        return database

    def _check(self, database: Any) -> None:
        """Raise BadInput if it is not a gallery, or of another version."""
        (application,) = database.execute("PRAGMA application_id").fetchone()
        (version,) = database.execute("PRAGMA user_version").fetchone()
        tables = _tables_of(database)
        require(
            tables,
            f"there is no gallery '{self.path}'; 'splitknit enroll' makes one.",
        )
        fault = f"'{self.path}' is another program's database, not a gallery; name another file."
        require(application == APPLICATION_ID, fault)
        require(
            version == VERSION,
            f"'{self.path}' is a gallery of version {version}, but this program reads version"
            f" {VERSION}; export it with the program that wrote it and import that here, or enrol"
            " the fingers again.",
        )
        require(tables == [*_SCHEMA.items()], self._damaged(_NO_TABLES), Unavailable)
        place = (_stamp_of(self.path) or ())[:2]
        if place != self._sound:
            # a bit of memory a page; a gallery of a terabyte has so many
            (pages,) = database.execute("PRAGMA page_count").fetchone()
            require(pages <= 2**28, self._damaged("it has too many pages"), Unavailable)
            (fault,) = database.execute("PRAGMA quick_check(1)").fetchone()
            require(fault == "ok", self._damaged(shown_path(fault)), Unavailable)
            self._sound = place
        versions = database.execute("SELECT template_version FROM about").fetchall()
        require(len(versions) == 1, self._damaged("its own record is missing"), Unavailable)
        require(
            versions[0][0] == TEMPLATE_VERSION,
            f"the templates in '{self.path}' are of version {versions[0][0]}, but this program"
            f" makes version {TEMPLATE_VERSION}; enrol the fingers again in a new gallery.",
        )

    @contextlib.contextmanager
    def _refusing(self, outcome: str) -> Iterator[None]:
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
            busy = (
                f"another program is writing the gallery '{path}'; nothing was changed: run the"
                " same again."
            )
            full = (
                f"the disk of '{path}' is full, or cannot be used: {outcome}; make room, and run"
                " the same again."
            )
            faults = {
                5: busy,
                6: busy,
                8: (
                    f"the gallery '{path}' may not be written here; change its permissions, or"
                    " copy it."
                ),
                10: full,  # SQLITE_IOERR: no room for the index of the log
                13: full,
                18: self._damaged(_NO_TABLES),  # a text is longer than those of a gallery's
                14: (
                    f"the gallery '{path}' cannot be opened, or its folder cannot be written; check"
                    " the permissions."
                ),
            }
            fault = self._not_read() if code == 26 else self._damaged(shown_path(str(error)))
            raise Unavailable(faults.get(code, fault)) from error

    def _not_read(self) -> str:
        """Sentence for a file that SQLite, or SQLCipher under this key, does not read."""
        with self.path.open("rb") as stream:
            plain = stream.read(len(_MAGIC)) == _MAGIC
        if self.key is None and plain:
            return self._damaged("its first page")
        if self.key is None:
            cure = f"give its key with `key_file` or in {KEY_VARIABLE}"
            return f"'{self.path}' is not a gallery, or it is encrypted; {cure}."
        if plain:
            cure = "leave the key out, or put an export of it into a new gallery with the key"
            return f"a key was given, but the gallery '{self.path}' is not encrypted; {cure}."
        return (
            f"the key is not that of the gallery '{self.path}', or the file is not a gallery or"
            " damaged."
        )

    def _damaged(self, what: str) -> str:
        cure = "take a copy or an export of it, or enrol the fingers again"
        return f"the gallery '{self.path}' is damaged ({what}); {cure}."


def _stamp_of(path: Path) -> tuple[int, ...] | None:
    """Device, inode, size and time of the last change of a file; None where there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _require_its_own(path: Path) -> None:
    """Refuse what lies beside a gallery and would lead SQLite to another file: a link, a pipe, or a
    journal that ends with the name of a *super-journal* (``pager.c``, readSuperJournal), which
    SQLite deletes; only changes of several databases at once have one."""
    with contextlib.suppress(FileNotFoundError):
        status = path.lstat()
        sound = stat.S_ISREG(status.st_mode) and status.st_nlink <= 1
        if sound and path.name.endswith("-journal"):
            with open(path, "rb", opener=open_at_once) as stream:
                stream.seek(max(status.st_size - len(_JOURNAL_MAGIC), 0))
                sound = stream.read(len(_JOURNAL_MAGIC)) != _JOURNAL_MAGIC
        require(
            sound,
            f"'{path}' leads to another file, or is no plain file; no gallery has such a one: move"
            " it away, and run the same again.",
            Unavailable,
        )


def _sqlcipher() -> Any:
    with importing("encrypted galleries need SQLCipher: pip install 'splitknit-match[encrypt]'."):
        from sqlcipher3 import dbapi2
    return dbapi2


def _tables_of(database: Any) -> list[tuple[str, str | None]]:
    """What ``sqlite_master`` lists, up to one row more than a gallery has.

    SQLite parses all of it with the first statement that needs a table, and even evaluates
    expressions of a table ``sqlite_stat1``. With a schema that may be written, SQLite takes an
    interrupted load as complete: it is interrupted at once, so that nothing of it is parsed.
    """
    limited = isinstance(database, sqlite3.Connection)  # SQLCipher's module has no limits
    if limited:
        longest = database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 10_000)  # bytes; ours have 500
    database.execute("PRAGMA writable_schema=ON")
    database.set_progress_handler(True.__bool__, 1)  # in Python's code Ctrl-C would be lost
    with contextlib.suppress(database.OperationalError):
        database.execute("PRAGMA page_count")
    database.set_progress_handler(None, 0)
    query = f"SELECT name, sql FROM sqlite_master LIMIT {len(_SCHEMA) + 1}"
    tables = sorted(database.execute(query), key=lambda row: str(row[0]))
    database.execute("PRAGMA writable_schema=RESET")
    if limited:
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, longest)
    return tables


def _make(database: Any, settings_sha256: str) -> None:
    for statement in filter(None, _SCHEMA.values()):
        database.execute(statement)
    database.execute("INSERT INTO about VALUES (?, ?, 0, 0)", (settings_sha256, TEMPLATE_VERSION))
    database.execute(f"PRAGMA application_id={APPLICATION_ID}")
    database.execute(f"PRAGMA user_version={VERSION}")


def _is_erasing(database: Any) -> bool:
    """Whether captures were deleted, and the file not written anew since."""
    return bool(database.execute("SELECT erasing FROM about").fetchone()[0])


def _settings_of(database: Any) -> str:
    return str(database.execute("SELECT settings_sha256 FROM about").fetchone()[0])


def _delete(database: Any, person: str, finger: str | None, session: str | None) -> int:
    """Delete captures of a person, and the person with the last of them; the file is to be erased
    then."""
    removed = database.execute(
        "DELETE FROM capture WHERE person = (SELECT id FROM person WHERE name = ?) "
        "AND finger = coalesce(?, finger) AND session = coalesce(?, session)",
        (person, finger, session),
    ).rowcount
    if removed:
        database.execute("DELETE FROM person WHERE id NOT IN (SELECT person FROM capture)")
        database.execute("UPDATE about SET changes = changes + 1, erasing = 1")
    return int(removed)


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
