"""Templates that a program keeps itself, such as rows of its own database, searched as a gallery
is: :class:`splitknit_match.Candidates`."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from splitknit.arguments import Natural, Preset, Ridges, checked
from splitknit.errors import naming, require
from splitknit.model import Progress, no_progress
from splitknit_match.gallery.file import Entry, People
from splitknit_match.gallery.identify import (
    MINUTIAE_HASH,
    TEMPLATES_HASH,
    Identification,
    identify_finger,
)
from splitknit_match.matching.inputs import held, side_reader
from splitknit_match.matching.match import Finger
from splitknit_match.matching.template import unpack
from splitknit_match.prints.minutiae_record import holds_minutiae, unpack_minutiae

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
            area_mm2 = naming(name, partial(_area_mm2, payload))
            own = MINUTIAE_HASH if of_minutiae else TEMPLATES_HASH
            mixed = f"'{name}' is of {'minutiae' if of_minutiae else 'ridges'}, others are not"
            require(not payload or settings in ("", own), f"{mixed}; search them apart.")
            settings = settings or (own if payload else "")
            entry = Entry(name, "finger", "1", "template", "", area_mm2, row=row)
            entries.append(replace(entry, template_bytes=len(payload)))
            payloads[row] = payload
        self._people = People(_NAME, settings, entries, payloads, kept.minutiae)
        self._rows += len(templates)

    def remove(self, name: str) -> None:
        """Take a template out. Raises BadInput if there is none of this name."""
        self._people.of(name, None)
        self._people = self._without((name,))

    def _without(self, names: Collection[str]) -> People:
        people = self._people
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


def _area_mm2(payload: bytes) -> float:
    if holds_minutiae(payload):
        unpack_minutiae(payload)
        return 0.0
    template = unpack(payload)
    return 0.0 if template.empty else round(template.area_mm2, 2)
