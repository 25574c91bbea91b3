"""``splitknit gallery list|info|remove|export|import``."""

from __future__ import annotations

from dataclasses import KW_ONLY, asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any

from splitknit.cli.verb import Outcome, Verb, count
from splitknit.errors import require
from splitknit.verbs import AnyPath, Help, Job, KeyFile, Progress, path

if TYPE_CHECKING:
    from splitknit_match.gallery.gallery import Gallery


@dataclass(frozen=True, slots=True)
class _OfGallery(Job):
    """What every verb needs."""

    gallery: Annotated[AnyPath, Help("file of the gallery", "GALLERY", positional=True, secret=True)]
    _: KW_ONLY
    key_file: KeyFile = None

    def opened(self) -> Gallery:
        """Open it."""
        from splitknit_match.gallery.gallery import Gallery  # verbs import what they need

        return Gallery(self.gallery, self.key_file)


@dataclass(frozen=True, slots=True)
class ListJob(_OfGallery):
    """List whose fingers are in it."""

    _: KW_ONLY
    person: Annotated[str | None, Help("of this person only", "NAME")] = None

    def run(self, progress: Progress) -> Outcome:
        """Read it."""
        from splitknit_match.gallery.file import check_person, session_order

        name = None if self.person is None else check_person(self.person)
        with self.opened() as gallery:
            entries = gallery.entries(name)
        require(name is None or entries, f"'{self.gallery}' holds nothing of person '{name}'.")
        entries.sort(key=lambda entry: (entry.person, entry.finger, session_order(entry.session)))
        lines = [f"{'person':24} {'finger':13} {'session':8} {'from':9} skin"]
        captures = []
        for entry in entries:
            acquired = entry.template_bytes > 0
            skin = f"{entry.area_mm2:.0f} mm²" if acquired else f"failure to acquire ({entry.failure or 'unknown'})"
            lines.append(f"{entry.person:24} {entry.finger:13} {entry.session:8} {entry.kind:9} {skin}")
            captures.append({**asdict(entry), "acquired": acquired, "enrolled_at": entry.enrolled_at or None})
        return {"gallery": str(self.gallery), "captures": captures}, lines


@dataclass(frozen=True, slots=True)
class InfoJob(_OfGallery):
    """Show numbers and sizes."""

    def run(self, progress: Progress) -> Outcome:
        """Count."""
        from splitknit_match.gallery.file import VERSION
        from splitknit_match.gallery.gallery import content_of
        from splitknit_match.matching.template import VERSION as TEMPLATE_VERSION

        with self.opened() as gallery:
            facts: dict[str, Any] = asdict(content_of(gallery, created=False))
            template_bytes = sum(entry.template_bytes for entry in gallery)
        del facts["created"]
        file_bytes = path(self.gallery).stat().st_size
        facts |= {"version": VERSION, "template_version": TEMPLATE_VERSION}
        facts |= {"template_bytes": template_bytes, "file_bytes": file_bytes}
        locked = "encrypted" if facts["encrypted"] else "not encrypted"
        people = count(facts["people"], "person", "people")
        return facts, [
            f"{self.gallery}: a gallery of version {VERSION}, {locked}.",
            f"{count(facts['captures'], 'capture')} of {count(facts['fingers'], 'finger')} of {people}.",
            f"{template_bytes / 1e6:.2f} MB of templates (version {TEMPLATE_VERSION}), "
            f"{file_bytes / 1e6:.2f} MB in all.",
            f"{facts['failures']} of them are failures to acquire.",
        ]


@dataclass(frozen=True, slots=True)
class RemoveJob(_OfGallery):
    """Remove a person or a finger, so that nothing of it remains in the file."""

    _: KW_ONLY
    person: Annotated[str, Help("whose fingers", "NAME")]
    finger: Annotated[str | None, Help("this one only", "FINGER")] = None
    session: Annotated[str | None, Help("this one only", "S")] = None

    def run(self, progress: Progress) -> Outcome:
        """Remove it."""
        with self.opened() as gallery:
            removed = gallery.remove(self.person, self.finger, self.session)
            left = len(gallery)
        facts = {"gallery": str(self.gallery), "removed": removed, "captures": left}
        return facts, [f"Removed {count(removed, 'capture')} from {self.gallery}; {left} are left."]


@dataclass(frozen=True, slots=True)
class ExportGalleryJob(_OfGallery):
    """Write all of it, not encrypted, into a folder of templates and a table."""

    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write", "DIR")]
    person: Annotated[str | None, Help("all that is kept of this person", "NAME")] = None

    def run(self, progress: Progress) -> Outcome:
        """Write it."""
        from splitknit_match.gallery.folder import export_gallery

        with self.opened() as gallery:
            facts = export_gallery(gallery, path(self.out), person=self.person)
        lines = [f"Wrote {count(facts['captures'], 'template')} and gallery.csv to {facts['out']}."]
        lines.append("Please note: they are personal data, and they are not encrypted there.")
        return facts, lines


@dataclass(frozen=True, slots=True)
class ImportGalleryJob(_OfGallery):
    """Put an exported folder into a gallery, which is made where there is none."""

    folder: Annotated[AnyPath, Help("what 'splitknit gallery export' wrote", "FOLDER", positional=True)]
    _: KW_ONLY
    replace: Annotated[bool, Help("let captures take the place of others")] = False

    def run(self, progress: Progress) -> Outcome:
        """Read it."""
        from splitknit_match.gallery.folder import import_gallery

        with self.opened() as gallery:
            facts = import_gallery(gallery, path(self.folder), replaces=self.replace)
        known = facts["found"] - facts["new"]
        came = f"{facts['new']} captures came in, {known} were there already"
        return facts, [f"{came}; {facts['captures']} are in it now."]


LIST, INFO, REMOVE = Verb(ListJob), Verb(InfoJob), Verb(RemoveJob)
EXPORT, IMPORT = Verb(ExportGalleryJob), Verb(ImportGalleryJob)
