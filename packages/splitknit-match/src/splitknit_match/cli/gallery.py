"""``splitknit gallery list|info|remove|export|import|check``."""

from __future__ import annotations

from dataclasses import KW_ONLY, asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any

from splitknit.cli.verb import Outcome, Verb, count
from splitknit.errors import Refused, require
from splitknit.verbs import AnyPath, Help, Job, KeyFile, Natural, Progress, path

if TYPE_CHECKING:
    from splitknit_match.gallery.file import GalleryFile


@dataclass(frozen=True, slots=True)
class _OfGallery(Job):
    """What every verb needs."""

    gallery: Annotated[AnyPath, Help("file of the gallery", "GALLERY", positional=True, secret=True)]
    _: KW_ONLY
    key_file: KeyFile = None

    def opened(self) -> GalleryFile:
        """Open it."""
        from splitknit_match.gallery.file import GalleryFile  # verbs import what they need

        return GalleryFile(self.gallery, self.key_file)


@dataclass(frozen=True, slots=True)
class ListJob(_OfGallery):
    """List whose fingers are in it."""

    _: KW_ONLY
    person: Annotated[str | None, Help("of this person only", "NAME")] = None

    def run(self, progress: Progress) -> Outcome:
        """Read it."""
        from splitknit_match.gallery.entry import check_person, session_order

        name = None if self.person is None else check_person(self.person)
        with self.opened() as gallery:
            rows = gallery.entries(name)
        require(name is None or len(rows) > 0, f"'{self.gallery}' holds nothing of person '{name}'.")
        rows.sort(key=lambda one: (one.person, one.finger, session_order(one.session)))
        lines = [f"{'row':>5}  {'person':24} {'finger':13} {'session':8} {'from':9} skin"]
        captures = []
        for one in rows:
            acquired = one.template_bytes > 0
            skin = f"{one.area_mm2:.0f} mm²" if acquired else f"failure to acquire ({one.failure or 'unknown'})"
            kept = f", with {one.images} image" if one.images else ""
            lines.append(f"{one.row:>5}  {one.person:24} {one.finger:13} {one.session:8} {one.kind:9} {skin}{kept}")
            facts = {**asdict(one), "acquired": acquired, "images": one.images or "none"}
            captures.append(facts | {"enrolled_at": one.enrolled_at or None})
        return {"gallery": str(self.gallery), "captures": captures}, lines


@dataclass(frozen=True, slots=True)
class InfoJob(_OfGallery):
    """Show numbers and sizes."""

    def run(self, progress: Progress) -> Outcome:
        """Count."""
        from splitknit_match.gallery.file import VERSION
        from splitknit_match.matching.template import VERSION as TEMPLATE_VERSION

        with self.opened() as gallery:
            rows, sha256 = gallery.entries(), gallery.settings_sha256
        facts: dict[str, Any] = {
            "gallery": str(self.gallery),
            "version": VERSION,
            "encrypted": gallery.key is not None,
            "template_version": TEMPLATE_VERSION,
            "settings_sha256": sha256,
            "captures": len(rows),
            "fingers": len({(one.person, one.finger) for one in rows}),
            "people": len({one.person for one in rows}),
            "failures": sum(one.template_bytes == 0 for one in rows),
            "with_images": sum(one.images != "" for one in rows),
            "template_bytes": sum(one.template_bytes for one in rows),
            "file_bytes": path(self.gallery).stat().st_size,
        }
        locked = "encrypted" if facts["encrypted"] else "not encrypted"
        people = f"{count(len(rows), 'capture')} of {count(facts['fingers'], 'finger')} of "
        people += count(facts["people"], "person", "people")
        return facts, [
            f"{self.gallery}: a gallery of version {VERSION}, {locked}.",
            f"{people}, {facts['template_bytes'] / 1e6:.2f} MB of templates (version {TEMPLATE_VERSION}), "
            f"{facts['file_bytes'] / 1e6:.2f} MB in all.",
            f"{facts['failures']} of them are failures to acquire, {facts['with_images']} have images.",
        ]


@dataclass(frozen=True, slots=True)
class RemoveJob(_OfGallery):
    """Remove a person or a finger, so that nothing of it remains in the file."""

    _: KW_ONLY
    person: Annotated[str | None, Help("whose fingers", "NAME")] = None
    finger: Annotated[str | None, Help("this one only", "FINGER")] = None
    session: Annotated[str | None, Help("this one only", "S")] = None
    row: Annotated[tuple[Natural, ...], Help("a row that is damaged", "N")] = ()

    def run(self, progress: Progress) -> Outcome:
        """Remove it."""
        from splitknit_match.gallery.entry import check_person

        fault = "name whose fingers are to be removed"
        require((self.person is None) != (not self.row), f"{fault}: `person` NAME, or `row` N.")
        alone = not self.row or (self.finger is None and self.session is None)
        require(alone, "`row` goes without `finger` and `session`.")
        with self.opened() as gallery:
            chosen = list(self.row)
            if self.person is not None:
                found = gallery.entries(check_person(self.person), self.finger, self.session)
                session = self.session and f"session {self.session}"
                words = ", ".join(word for word in (self.person, self.finger, session) if word)
                shown = f"'{self.gallery}' holds nothing of {words}; 'splitknit gallery list' shows who is in it."
                require(len(found) > 0, shown)
                chosen = [one.row for one in found]
            removed = gallery.remove(chosen)
            require(removed > 0, f"'{self.gallery}' holds no row {', '.join(map(str, chosen))}.")
            left = len(gallery)
        facts = {"gallery": str(self.gallery), "removed": removed, "captures": left}
        return facts, [f"Removed {count(removed, 'capture')} from {self.gallery}; {left} are left."]


@dataclass(frozen=True, slots=True)
class ExportGalleryJob(_OfGallery):
    """Write all of it, not encrypted, into a folder of templates and a table."""

    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write", "DIR")]
    images: Annotated[bool, Help("write kept images as well")] = False
    person: Annotated[str | None, Help("all that is kept of this person, images included", "NAME")] = None

    def run(self, progress: Progress) -> Outcome:
        """Write it."""
        from splitknit_match.gallery.manage import export_gallery

        with self.opened() as gallery:
            facts = export_gallery(gallery, path(self.out), images=self.images, person=self.person)
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
        from splitknit_match.gallery.manage import import_gallery

        with self.opened() as gallery:
            facts = import_gallery(gallery, path(self.folder), replaces=self.replace)
        known = facts["found"] - facts["new"]
        came = f"{facts['new']} captures came in, {known} were there already"
        return facts, [f"{came}; {facts['captures']} are in it now."]


@dataclass(frozen=True, slots=True)
class CheckJob(_OfGallery):
    """Look for damage."""

    def run(self, progress: Progress) -> Outcome:
        """Open every row."""
        with self.opened() as gallery:
            problems, captures = gallery.problems(), len(gallery)
        listed = [{"row": row, "what": what} for row, what in problems]
        facts = {"gallery": str(self.gallery), "captures": captures, "sound": not problems, "problems": listed}
        if problems:
            rows = sorted({row for row, _ in problems if row is not None})
            shown = ", ".join(map(str, rows[:10])) + (", ..." if len(rows) > 10 else "")
            where = f"rows {shown}; 'splitknit gallery remove' takes a row out" if rows else problems[0][1].rstrip(".")
            places = count(len(problems), "place")
            raise Refused(f"the gallery '{self.gallery}' is damaged in {places} ({where}).", facts)
        return facts, [f"{self.gallery} is sound: all {captures} captures can be opened."]


LIST, INFO, REMOVE = Verb(ListJob), Verb(InfoJob), Verb(RemoveJob)
EXPORT, IMPORT, CHECK = Verb(ExportGalleryJob), Verb(ImportGalleryJob), Verb(CheckJob)
