"""A gallery: enrolled fingers in one file, encrypted if a key is given.

Every capture is a row: names and facts, the template, and where kept its search code and images, each wrapped so that
a changed byte or an exchange between rows is noticed (:mod:`splitknit.match.gallery_box`). Several programs may read
while one writes; a writer waits for another, and every change happens whole or not at all, also under ``kill -9``.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace as replace_field
from pathlib import Path

from splitknit.check import require
from splitknit.match.gallery_entry import Enrolled, NewCapture, encode_entry
from splitknit.match.gallery_file import WAIT_S, connect, create_file
from splitknit.match.gallery_key import Key, ScryptSettings
from splitknit.match.gallery_rows import Rows, box_of, context, document_of, lock
from splitknit.match.template import VERSION as TEMPLATE_VERSION

__all__ = ["Enrolled", "Gallery", "NewCapture"]

_ENTRIES = "SELECT id, tag, entry, code_version FROM finger"
_BY_TAG = "SELECT id, entry, content FROM finger LEFT JOIN template USING (id) WHERE tag = ?"


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
                found = database.execute(_BY_TAG, (tag,)).fetchone()
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
                    rows.delete(found[0])
                    replaced = True
                entry = encode_entry(replace_field(one.entry, template_bytes=len(one.template)))
                contents = {"entry": entry, "template": one.template, "code": one.code, "images": one.images}
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
        with self._rows.reading() as database:
            rows = database.execute(f"{_ENTRIES} ORDER BY id").fetchall()
        found = [Enrolled(row, self._rows.entry(row, tag, sealed), version) for row, tag, sealed, version in rows]
        wanted = {"person": person, "finger": finger, "session": session}
        wanted = {name: value for name, value in wanted.items() if value is not None}
        return [one for one in found if all(getattr(one.entry, name) == value for name, value in wanted.items())]

    def entries_at(self, rows: Sequence[int]) -> dict[int, Enrolled]:
        """Some rows, without a look at the others; those that were removed meanwhile are missing."""
        with self._rows.reading() as database:
            found = [one for row in rows for one in database.execute(f"{_ENTRIES} WHERE id = ?", (row,)).fetchall()]
        return {row: Enrolled(row, self._rows.entry(row, tag, sealed), version) for row, tag, sealed, version in found}

    def without_code(self, version: int) -> list[int]:
        """Rows that have no search code of this version; failures to acquire never have one."""
        query = "SELECT id FROM finger WHERE code IS NULL OR code_version IS NOT ? ORDER BY id"
        with self._rows.reading() as database:
            return [row for (row,) in database.execute(query, (version,)).fetchall()]

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
        with self._rows.changing():
            gone = sum(self._rows.delete(row) for row in set(rows))
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
