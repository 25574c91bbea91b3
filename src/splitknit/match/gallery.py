"""A gallery: enrolled fingers in one file, encrypted if a key is given.

Every capture is a row: names and facts, the template, and where kept its search code and images, each wrapped so that
a changed byte or an exchange between rows is noticed (:mod:`splitknit.match.gallery_box`). Several programs may read
while one writes; a writer waits for another, and every change happens whole or not at all, also under ``kill -9``.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from splitknit.check import require
from splitknit.match.gallery_entry import Entry, encode_entry
from splitknit.match.gallery_file import WAIT_S, connect, create_file
from splitknit.match.gallery_key import Key, ScryptSettings
from splitknit.match.gallery_rows import Rows, box_of, context, document_of, lock
from splitknit.match.template import VERSION as TEMPLATE_VERSION


@dataclass(frozen=True, slots=True)
class Enrolled:
    """A row of a gallery."""

    row: int
    entry: Entry
    template_bytes: int
    """0 for a failure to acquire."""
    code_version: int | None
    """None where no search code is kept."""


@dataclass(frozen=True, slots=True)
class NewCapture:
    """What is put into a gallery."""

    entry: Entry
    template: bytes
    """Payload (:func:`splitknit.match.pack`), empty for a failure to acquire."""
    code: bytes | None = None
    code_version: int | None = None
    images: bytes | None = None


class Gallery:
    """An open gallery; a context manager. Get one from :meth:`open` or :meth:`create`."""

    def __init__(self, rows: Rows) -> None:
        """Wrap what is open already."""
        self._rows = rows
        self.path = rows.path

    @classmethod
    def open(cls, path: str | os.PathLike[str], key: Key | None = None, *, wait_s: float = WAIT_S) -> Gallery:
        """Open an existing gallery.

        Parameters
        ----------
        path : of the file
        key : if it is encrypted
        wait_s : how long to wait for another program's change

        Raises
        ------
        BadInput
            If it is no gallery, damaged, of another version, or the key is missing, wrong, or not wanted.
        """
        file = Path(path)
        database = connect(file, wait_s=wait_s)
        try:
            return cls(Rows(file, database, key))
        except BaseException:
            database.close()
            raise

    @classmethod
    def create(
        cls,
        path: str | os.PathLike[str],
        settings_sha256: str,
        key: Key | None = None,
        scrypt: ScryptSettings | None = None,
    ) -> Gallery:
        """Make a gallery (mode 0600) for templates of these settings, or open the one that is there.

        Raises
        ------
        BadInput
            If it cannot be written, or as :meth:`open`.
        """
        about = {"settings_sha256": settings_sha256, "template_version": TEMPLATE_VERSION, **lock(key, scrypt)}
        create_file(Path(path), about)
        return cls.open(path, key)

    def __enter__(self) -> Gallery:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        self._rows.database.close()

    @property
    def encrypted(self) -> bool:
        """Whether a key is needed."""
        return bool(self._rows.about["box"] != "plain")

    @property
    def settings_sha256(self) -> str:
        """Of the settings that all its templates were made with."""
        return str(self._rows.about["settings_sha256"])

    @property
    def template_version(self) -> int:
        """Of all its templates."""
        return int(self._rows.about["template_version"])

    def require_comparable(self, settings_sha256: str) -> None:
        """Refuse to mix templates.

        Raises
        ------
        BadInput
            If its templates are of another version, or made with other settings.
        """
        require(
            self.template_version == TEMPLATE_VERSION,
            f"the templates in '{self.path}' are of version {self.template_version}, but this program makes version "
            f"{TEMPLATE_VERSION}; enrol the fingers again in a new gallery.",
        )
        require(
            self.settings_sha256 == settings_sha256,
            f"the templates in '{self.path}' were made with other settings (band, template); give the same --set, or "
            "enrol the fingers again in a new gallery.",
        )

    def __len__(self) -> int:
        with self._rows.reading() as database:
            return int(database.execute("SELECT count(*) FROM finger").fetchone()[0])

    def add(self, captures: Iterable[NewCapture], *, replace: bool = False) -> list[bool]:
        """Put captures in, all or none; of each, whether it is new (False: the very same is there already).

        Raises
        ------
        BadInput
            If another capture has these names (person, finger, session) and `replace` is false.
        """
        rows, new, replaced = self._rows, [], False
        with rows.changing() as database:
            for one in captures:
                tag = rows.box.tag(one.entry.names)
                found = database.execute("SELECT id, entry, template FROM finger WHERE tag = ?", (tag,)).fetchone()
                if found is not None:
                    earlier = rows.entry(found[0], tag, found[1])
                    same = earlier.source_sha256 == one.entry.source_sha256
                    if same and rows.opened(found[0], "template", tag, found[2]) == one.template:
                        new.append(False)
                        continue
                    require(
                        replace,
                        f"{one.entry.words} is in '{self.path}' already, made from something else; name another "
                        "session, or say --replace.",
                    )
                    database.execute("DELETE FROM finger WHERE id = ?", (found[0],))
                    replaced = True
                contents = {
                    "entry": encode_entry(one.entry), "template": one.template, "code": one.code, "images": one.images,
                }  # fmt: skip
                rows.insert(tag, contents, one.code_version)
                new.append(True)
        if replaced:
            rows.compact()
        return new

    def entries(
        self, person: str | None = None, finger: str | None = None, session: str | None = None
    ) -> list[Enrolled]:
        """All rows in the order of enrolment, or those of a person, finger or session.

        Raises
        ------
        BadInput
            If a row is damaged.
        """
        query = "SELECT id, tag, entry, length(template), code_version FROM finger ORDER BY id"
        with self._rows.reading() as database:
            rows = database.execute(query).fetchall()
        found = []
        for row, tag, sealed, size, version in rows:
            entry = self._rows.entry(row, tag, sealed)
            if person in (None, entry.person) and finger in (None, entry.finger) and session in (None, entry.session):
                found.append(Enrolled(row, entry, size - self._rows.box.overhead, version))
        return found

    def templates(self, rows: Sequence[int] | None = None) -> dict[int, bytes]:
        """Templates (payloads) by row, of all or of those named; rows that were removed meanwhile are missing."""
        return self._rows.contents("template", rows)

    def codes(self, version: int) -> dict[int, bytes]:
        """Search codes of this version by row."""
        return self._rows.contents("code", None, version)

    def images(self, rows: Sequence[int] | None = None) -> dict[int, bytes]:
        """What was kept of the pictures, by row."""
        return self._rows.contents("images", rows)

    def set_codes(self, codes: Mapping[int, bytes], version: int) -> None:
        """Keep search codes beside templates that were enrolled without."""
        with self._rows.changing() as database:
            for row, code in codes.items():
                found = database.execute("SELECT tag FROM finger WHERE id = ?", (row,)).fetchone()
                if found is not None:
                    sealed = self._rows.box.seal(code, context("code", found[0]))
                    values = (sealed, version, row)
                    database.execute("UPDATE finger SET code = ?, code_version = ? WHERE id = ?", values)

    def remove(self, rows: Sequence[int]) -> int:
        """Remove rows so that nothing of them remains in the file; return how many there were.

        Freed pages are overwritten with zeros (``secure_delete``) before the change is complete; then the file is
        written anew without them.
        """
        with self._rows.changing() as database:
            gone = sum(database.execute("DELETE FROM finger WHERE id = ?", (row,)).rowcount for row in set(rows))
        if gone:
            self._rows.compact()
        return gone

    def rekey(self, key: Key | None, scrypt: ScryptSettings | None = None) -> int:
        """Wrap everything anew under `key` (None: no longer encrypted), all or nothing; return the number of rows."""
        kept = {"settings_sha256": self.settings_sha256, "template_version": self.template_version}
        about = {**kept, **lock(key, scrypt)}
        box = box_of(about, key, self.path)
        with self._rows.changing() as database:
            rows = [row[0] for row in database.execute("SELECT id FROM finger ORDER BY id").fetchall()]
            for row in rows:
                self._rows.reseal(row, box)
            database.execute("UPDATE about SET document = ?", (document_of(about),))
        self._rows.about, self._rows.box = about, box
        self._rows.compact()
        return len(rows)

    def problems(self) -> list[tuple[int | None, str]]:
        """What is damaged, by row (None: the file); nothing if all is sound. Opens every content."""
        return self._rows.problems()
