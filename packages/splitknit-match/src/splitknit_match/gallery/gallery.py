"""A gallery: enrolled fingers in one file, encrypted if a key is given.

Every capture is a row: names and facts, the template, and where kept its search code and images, each wrapped so that
a changed byte is noticed (:mod:`splitknit_match.gallery.key`), and all together so that an older, a missing or an
exchanged row is (:mod:`splitknit_match.gallery.rows`). Several programs may read while one writes; a writer waits
for another, and every change happens whole or not at all, also under ``kill -9``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace as replace_field
from pathlib import Path
from typing import TYPE_CHECKING

from splitknit import require
from splitknit_match.gallery.entry import Enrolled, NewCapture, encode_entry
from splitknit_match.gallery.file import VERSION, WAIT_S, connect, create_file, place_of
from splitknit_match.gallery.key import Key, ScryptSettings, box_of, document_of, lock
from splitknit_match.gallery.rows import GalleryRows, GalleryState, Row
from splitknit_match.matching.template import VERSION as TEMPLATE_VERSION

if TYPE_CHECKING:
    from splitknit_match.gallery.minutia_index import MinutiaIndex

__all__ = ["Enrolled", "Gallery", "NewCapture"]


class Gallery(GalleryRows):
    """An open gallery; a context manager. Get one from :meth:`open` or :meth:`create`."""

    @classmethod
    def open(
        cls, path: str | os.PathLike[str], key: Key | None = None, *, wait_s: float = WAIT_S, shared: bool = False
    ) -> Gallery:
        """Open an existing gallery, with its `key` if it is encrypted; wait so long for another program's change.

        `shared`: whether threads share it, one at a time.

        Raises BadInput if it is not a gallery, damaged, of an unknown version, or the key is missing, wrong, or not
        wanted.
        """
        file = Path(path)
        place = place_of(file)
        database = connect(file, wait_s=wait_s, shared=shared)
        try:
            opened = cls(file, database, key)
            opened.place = place
            return opened
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

        Raises BadInput if it cannot be written, or as :meth:`open`.
        """
        file = Path(path)
        if not file.exists():
            about = {"settings_sha256": settings_sha256, "template_version": TEMPLATE_VERSION, **lock(key, scrypt)}
            create_file(file, document_of(about), GalleryState().sealed(box_of(about, key, file), about))
        return cls.open(path, key)

    def __enter__(self) -> Gallery:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        self.database.close()

    @property
    def encrypted(self) -> bool:
        """Whether a key is needed."""
        return bool(self.about["box"] != "plain")

    @property
    def settings_sha256(self) -> str:
        """Hash of the settings that all its templates were made with."""
        return str(self.about["settings_sha256"])

    @property
    def template_version(self) -> int:
        """Version of all its templates."""
        return int(self.about["template_version"])

    def require_comparable(self, settings_sha256: str) -> None:
        """Raise BadInput if its templates are of another version, or made with other settings: nothing is mixed."""
        require(
            self.template_version == TEMPLATE_VERSION,
            f"the templates in '{self.path}' are of version {self.template_version}, but this program makes version "
            f"{TEMPLATE_VERSION}; enrol the fingers again in a new gallery.",
        )
        require(
            self.settings_sha256 == settings_sha256,
            f"the templates in '{self.path}' were made with other settings (band, template); give the same "
            "`settings`, or enrol the fingers again in a new gallery.",
        )

    def __len__(self) -> int:
        with self.reading(verified=False) as database:
            return int(database.execute("SELECT count(*) FROM finger NOT INDEXED").fetchone()[0])

    def add(
        self,
        captures: Iterable[NewCapture],
        *,
        replace: bool = False,
        first: Callable[[], object] = lambda: None,
        last: Callable[[], None] = lambda: None,
    ) -> list[bool]:
        """Put captures in, all or none; of each, whether it is new (False: the very same is there already).

        `first` and `last` are called while no other program can change it, before anything is written, and before what
        was written is final: what they raise undoes it.

        Raises BadInput if another capture has these names (person, finger, session) and `replace` is false.
        """
        new, replaced = [], False
        with self.changing():
            first()
            for one in captures:
                for earlier in self.rows("tag = ?", self.box.tag(one.entry.names)):
                    if self._is_same(earlier, one):
                        new.append(False)
                        break
                    require(
                        replace,
                        f"{one.entry.words} is in '{self.path}' already, made from something else; name another "
                        "session, or give `replace`.",
                    )
                    replaced = self.delete(earlier.id)
                else:
                    entry = encode_entry(replace_field(one.entry, template_bytes=len(one.template)))
                    contents = {"entry": entry, "template": one.template, "code": one.code, "images": one.images}
                    self.insert(one.entry.names, contents, one.code_version)
                    new.append(True)
            if replaced:
                self.rewrite()
            last()
        return new

    def _is_same(self, row: Row, one: NewCapture) -> bool:
        if self.entry(row).source_sha256 != one.entry.source_sha256:
            return False
        (cell,) = self.database.execute("SELECT content FROM template WHERE id = ?", (row.id,)).fetchone() or [0]
        return self.opened(row, "template", cell) == one.template

    def entries(
        self, person: str | None = None, finger: str | None = None, session: str | None = None
    ) -> list[Enrolled]:
        """All rows in the order of enrolment, or those of a person, finger or session.

        Raises BadInput if a row is damaged.
        """
        found = self._all()
        wanted = {"person": person, "finger": finger, "session": session}
        wanted = {name: value for name, value in wanted.items() if value is not None}
        return [one for one in found if all(getattr(one.entry, name) == value for name, value in wanted.items())]

    def _all(self) -> list[Enrolled]:
        with self.reading():
            rows = self.rows()
        return [self._enrolled(row) for row in rows]

    def entries_at(self, rows: Sequence[int]) -> dict[int, Enrolled]:
        """Some rows, without a look at the others; those that were removed meanwhile are missing."""
        with self.reading():
            found = [one for row in rows for one in self.rows("id = ?", row)]
        return {one.id: self._enrolled(one) for one in found}

    def _enrolled(self, row: Row) -> Enrolled:
        return Enrolled(row.id, self.entry(row), row.code_version)

    def without_code(self, version: int) -> list[int]:
        """Rows that have no search code of this version; failures to acquire never have one."""
        query = "SELECT id FROM finger WHERE code IS NULL OR code_version IS NOT ? ORDER BY id"
        with self.reading() as database:
            return [row for (row,) in database.execute(query, (version,)).fetchall()]

    def templates(self, rows: Sequence[int] | None = None) -> dict[int, bytes]:
        """Templates (payloads) by row, of all or of those named; rows that were removed meanwhile are missing."""
        return self._contents_at("template", rows)

    def minutia_index(self) -> MinutiaIndex:
        """Index of the minutiae of all its templates."""
        from splitknit_match.gallery.minutia_index import MinutiaIndex  # a list of names needs none of it

        return MinutiaIndex(self.templates(), self.path)

    def codes(self, version: int) -> dict[int, bytes]:
        """Search codes of this version by row."""
        return self.contents("code", "code_version = ?", [(version,)])

    def images(self, rows: Sequence[int] | None = None) -> dict[int, bytes]:
        """What was kept of the pictures, by row."""
        return self._contents_at("images", rows)

    def _contents_at(self, content: str, rows: Sequence[int] | None) -> dict[int, bytes]:
        return self.contents(content) if rows is None else self.contents(content, "id = ?", [(row,) for row in rows])

    def remove(self, rows: Sequence[int]) -> int:
        """Remove rows so that nothing of them remains in the file or its journal; return how many there were."""
        with self.changing():
            gone = sum(self.delete(row) for row in set(rows))
            if gone:
                self.rewrite()
        return gone

    def rekey(self, key: Key | None, scrypt: ScryptSettings | None = None) -> int:
        """Wrap everything anew under `key` (None: no longer encrypted), all or nothing; return the number of rows."""
        return self._rewrap(key, scrypt, VERSION)

    def migrate(self) -> int:
        """Make a gallery of version 1 one of version 2, under the same key, all or nothing; return the number of rows.

        Raises BadInput if it is of version 2 already, or damaged: what is damaged is removed by the program that wrote
        it.
        """
        about = self.about
        scrypt = ScryptSettings(about["log2_n"], about["r"], about["p"]) if "log2_n" in about else None
        return self._rewrap(self.key, scrypt, 1)

    def _rewrap(self, key: Key | None, scrypt: ScryptSettings | None, version: int) -> int:
        kept = {"settings_sha256": self.settings_sha256, "template_version": self.template_version}
        about = {**kept, **lock(key, scrypt)}
        with self.changing(version=version):
            return self.rewrite(about, key)
