"""Templates that a program keeps itself, such as rows of its own database, searched as a gallery
is: :class:`splitknit_match.Candidates`."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Self

from splitknit.arguments import AnyPath, Natural, Preset, Ridges, checked
from splitknit.errors import naming, require
from splitknit.model import Progress, no_progress
from splitknit_match.gallery.file import Entry, GalleryFile, Key, NewCapture, People
from splitknit_match.gallery.identify import (
    MINUTIAE_HASH,
    TEMPLATES_HASH,
    Identification,
    comparable_people,
    identify_finger,
)
from splitknit_match.matching.inputs import held, side_reader
from splitknit_match.matching.match import Finger
from splitknit_match.matching.template import Template, unpack
from splitknit_match.records.minutiae_record import holds_minutiae, unpack_minutiae
from splitknit_match.threads import one_blas_thread

_NAME = Path("candidates")


class Candidates:
    """Templates in memory, each under a name of yours; one thread changes them at a time.

    Parameters
    ----------
    templates : mapping, optional
        From a name (1 to 100 printable characters) to what a ``.skt`` file holds: ridges of all,
        or minutiae of all.

    Raises
    ------
    BadInput
        If a template is damaged, or ridges and minutiae are mixed.

    Examples
    --------
    >>> import splitknit_match
    >>> rows = {"17": splitknit_match.make_template("ann.png").payload}  # doctest: +SKIP
    >>> candidates = splitknit_match.Candidates(rows)  # doctest: +SKIP
    >>> candidates.search("probe.png").candidates[0].person  # doctest: +SKIP
    '17'
    """

    def __init__(self, templates: Mapping[str, bytes] | None = None) -> None:
        """Take over templates."""
        self._people = People(_NAME, "", [], {}, {})
        self._rows = 0
        self._file: GalleryFile | None = None
        """Whose cluster stays connected."""
        self.add(templates or {})

    def __len__(self) -> int:
        return len(self._people.entries)

    def add(self, templates: Mapping[str, bytes]) -> None:
        """Add templates, or replace those of the same names; all or none."""
        kept = self._without(templates)
        entries, payloads = list(kept.entries.values()), dict(kept.templates)
        settings = kept.settings_sha256 if entries else ""
        for row, (name, template) in enumerate(templates.items(), self._rows + 1):
            payload = naming(name, partial(held, template))
            require(isinstance(template, bytes), f"the template of '{name}' must be bytes.")
            assert isinstance(payload, bytes)
            of_minutiae = holds_minutiae(payload)
            read = naming(name, partial(unpack_minutiae if of_minutiae else unpack, payload))
            area_mm2 = round(read.area_mm2, 2) if isinstance(read, Template) else 0.0
            own = MINUTIAE_HASH if of_minutiae else TEMPLATES_HASH
            mixed = f"'{name}' is of {'minutiae' if of_minutiae else 'ridges'}, others are not"
            require(not payload or settings in ("", own), f"{mixed}; search them apart.")
            settings = settings or (own if payload else "")
            size = len(payload)
            entries.append(
                Entry(name, "finger", "1", "template", "", area_mm2, template_bytes=size, row=row)
            )
            payloads[row] = payload
        self._people = People(_NAME, settings, entries, payloads, kept.minutiae)
        self._rows += len(templates)

    def remove(self, name: str) -> None:
        """Take a template out. Raises BadInput if there is none of this name."""
        left = self._without((name,))
        require(
            len(left.entries) < len(self), f"there is no template '{name}' among the candidates."
        )
        self._people = left

    def prepare(self, progress: Progress = no_progress) -> None:
        """Make what the first search would make: the index of all minutiae. Workers of a cluster
        make theirs at the first search."""
        one_blas_thread()
        if self._people.spread is None:
            self._people.index(progress)

    def save(self, path: AnyPath, key: Key | AnyPath | None = None) -> None:
        """Write all, and what is known of their minutiae, into a new file, which only you can read.

        It is a gallery's, of one finger a name; `key`: file with the key of an encrypted one.
        Raises BadInput if the file is there, or there is nothing to write.
        """
        file = GalleryFile(path, key)
        require(not file.there, f"there is a file '{path}' already; name another one.")
        require(len(self) > 0, "there are no templates to save; add some first.")
        people = self._people
        captures = (
            NewCapture(entry, people.payload(row), bytes(people.minutiae.get(row, b"")))
            for row, entry in people.entries.items()
        )
        file.add(captures, people.settings_sha256 or TEMPLATES_HASH)

    @classmethod
    def load(
        cls, path: AnyPath, key: Key | AnyPath | None = None, *, scheduler: str | None = None
    ) -> Self:
        """Read what :meth:`save` wrote, or a gallery of one capture a person; with `scheduler`
        workers of a cluster hold and search it, as of :func:`splitknit_match.identify`.

        Raises BadInput if the file is damaged, of another version, or names somebody twice.
        """
        file = GalleryFile(path, key, scheduler)
        people = comparable_people(file)
        names = {entry.person for entry in people.entries.values()}
        require(
            len(names) == len(people.entries),
            f"'{path}' holds several captures of one person; open it as a Gallery.",
        )
        people.minutiae = {row: bytes(own) for row, own in people.minutiae.items()}
        candidates = cls()
        candidates._people, candidates._file = people, file
        candidates._rows = max(people.entries, default=0)
        return candidates

    def _without(self, names: Collection[str]) -> People:
        people = self._people
        require(people.spread is None, "what workers hold cannot be changed; load it without them.")
        entries = [entry for entry in people.entries.values() if entry.person not in names]
        rows = {entry.row for entry in entries}
        templates = {row: people.templates[row] for row in rows}
        minutiae = {row: side for row, side in people.minutiae.items() if row in rows}
        return People(_NAME, people.settings_sha256, entries, templates, minutiae)

    @checked
    def search(
        self,
        probe: Finger,
        *,
        top: Natural = 10,
        fmr: float | None = None,
        resolution_ppi: float | None = None,
        ridges: Ridges = None,
        preset: Preset = "metric",
        progress: Progress = no_progress,
    ) -> Identification:
        """Whose finger is it? Arguments, and what is raised, as of
        :func:`splitknit_match.identify`; ``person`` of a candidate is its name."""
        read = side_reader(probe, preset, resolution_ppi, ridges)
        return identify_finger(self._people, read, top=top, fmr=fmr, progress=progress)
