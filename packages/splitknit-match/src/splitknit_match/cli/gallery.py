"""``splitknit gallery list|info|remove|export|import|check|repair|index|rekey|migrate``."""

from __future__ import annotations

from dataclasses import KW_ONLY, asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from splitknit import (
    AnyPath,
    BadInput,
    Help,
    Job,
    KeyFile,
    Natural,
    Outcome,
    Progress,
    Refused,
    Verb,
    count,
    path,
    require,
)
from splitknit_match.gallery import KEY_VARIABLE, NEW_KEY_VARIABLE

if TYPE_CHECKING:
    from splitknit_match.gallery.gallery import Gallery
    from splitknit_match.gallery.key import Key


@dataclass(frozen=True, slots=True)
class _OfGallery(Job):
    """What every verb needs."""

    gallery: Annotated[AnyPath, Help("file of the gallery", "GALLERY", positional=True, secret=True)]
    _: KW_ONLY
    key_file: KeyFile = None

    @property
    def file(self) -> Path:
        """The gallery's file."""
        return Path(self.gallery)

    @property
    def key(self) -> Key | None:
        """To open it."""
        from splitknit_match.gallery.key import key_of  # verbs import what they need

        return key_of(self.key_file)

    def opened(self) -> Gallery:
        """Open it."""
        from splitknit_match.gallery.gallery import Gallery

        return Gallery.open(self.file, self.key)


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
        require(name is None or len(rows) > 0, f"'{self.file}' holds nothing of person '{name}'.")
        rows.sort(key=lambda one: (one.entry.person, one.entry.finger, session_order(one.entry.session)))
        lines = [f"{'row':>5}  {'person':24} {'finger':13} {'session':8} {'from':9} skin"]
        captures = []
        for one in rows:
            entry, acquired = one.entry, one.template_bytes > 0
            skin = f"{entry.area_mm2:.0f} mm²" if acquired else f"failure to acquire ({entry.failure or 'unknown'})"
            kept = f", with {entry.images} image" if entry.images else ""
            who = f"{one.row:>5}  {entry.person:24} {entry.finger:13} {entry.session:8}"
            lines.append(f"{who} {entry.kind:9} {skin}{kept}")
            facts = {"row": one.row, **asdict(entry), "acquired": acquired}
            captures.append(facts | {"images": entry.images or "none", "enrolled_at": entry.enrolled_at or None})
        return {"gallery": str(self.file), "captures": captures}, lines


@dataclass(frozen=True, slots=True)
class InfoJob(_OfGallery):
    """Show numbers and sizes; needs no key."""

    def run(self, progress: Progress) -> Outcome:
        """Count."""
        from splitknit_match.gallery.file import describe

        facts = {"gallery": str(self.file), **describe(self.file), "fingers": None, "people": None, "failures": None}
        if self.key is not None or not facts["encrypted"]:
            with self.opened() as gallery:
                rows = gallery.entries()
            facts["fingers"] = len({(one.entry.person, one.entry.finger) for one in rows})
            facts["people"] = len({one.entry.person for one in rows})
            facts["failures"] = sum(one.template_bytes == 0 for one in rows)
        kinds = {
            None: "not encrypted",
            "raw": "encrypted, by a key of 32 bytes",
            "scrypt": "encrypted, by a passphrase",
        }
        locked = kinds.get(facts["key"], "encrypted")
        lines = [f"{facts['gallery']}: a gallery of version {facts['version']}, {locked}."]
        people = ""
        if facts["people"] is not None:
            people = f" of {count(facts['fingers'], 'finger')} of {count(facts['people'], 'person', 'people')}"
        templates = f"{facts['template_bytes'] / 1e6:.2f} MB of templates (version {facts['template_version']})"
        captures = f"{count(facts['captures'], 'capture')}{people}"
        lines.append(f"{captures}, {templates}, {facts['file_bytes'] / 1e6:.2f} MB in all.")
        if facts["failures"]:
            lines.append(f"{facts['failures']} of them are failures to acquire.")
        lines.append(f"{facts['with_code']} have a search code, {facts['with_images']} have images.")
        return facts, lines


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
                shown = f"'{self.file}' holds nothing of {words}; 'splitknit gallery list' shows who is in it."
                require(len(found) > 0, shown)
                chosen = [one.row for one in found]
            removed = gallery.remove(chosen)
            require(removed > 0, f"'{self.file}' holds no row {', '.join(map(str, chosen))}.")
            left = len(gallery)
        facts = {"gallery": str(self.file), "removed": removed, "captures": left}
        return facts, [f"Removed {count(removed, 'capture')} from {self.file}; {left} are left."]


@dataclass(frozen=True, slots=True)
class ExportGalleryJob(_OfGallery):
    """Write all of it, not encrypted, into a folder of templates and a table."""

    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write", "DIR")]
    images: Annotated[bool, Help("write kept images as well")] = False
    person: Annotated[str | None, Help("all that is kept of this person, images and codes included", "NAME")] = None

    def run(self, progress: Progress) -> Outcome:
        """Write it."""
        from splitknit_match.gallery.manage import export_gallery

        facts = export_gallery(self.file, path(self.out), key=self.key, images=self.images, person=self.person)
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

        facts = import_gallery(self.file, path(self.folder), key=self.key, replace=self.replace)
        known = facts["found"] - facts["new"]
        came = f"{facts['new']} captures came in, {known} were there already"
        return facts, [f"{came}; {facts['captures']} are in it now."]


@dataclass(frozen=True, slots=True)
class CheckJob(_OfGallery):
    """Look for damage, and for rows that something else changed."""

    _: KW_ONLY
    shards: Annotated[AnyPath | None, Help("compare the codes here with the gallery's as well", "DIR")] = None

    def run(self, progress: Progress) -> Outcome:
        """Open every row."""
        from splitknit_match.gallery.manage import codes_of
        from splitknit_match.gallery.shards import Shards

        with self.opened() as gallery:
            problems, captures = gallery.problems(), len(gallery)
            if self.shards is not None and not problems:
                try:
                    Shards(path(self.shards), self.key).require_same(*codes_of(gallery))
                except BadInput as error:
                    problems.append((None, str(error)))
        listed = [{"row": row, "what": what} for row, what in problems]
        facts = {"gallery": str(self.file), "captures": captures, "sound": not problems, "problems": listed}
        if problems:
            rows = sorted({row for row, _ in problems if row is not None})
            shown = ", ".join(map(str, rows[:10])) + (", ..." if len(rows) > 10 else "")
            where = f"rows {shown}; 'splitknit gallery remove' takes a row out"
            whole = [what.rstrip(".") for row, what in problems if row is None]
            if whole:
                where = f"rows {shown}; {whole[0]}" if rows else whole[0]
            places = count(len(problems), "place")
            raise Refused(f"the gallery '{self.file}' is damaged in {places} ({where}).", facts)
        shards = "" if self.shards is None else f", and {self.shards} holds their codes"
        return facts, [f"{self.file} is sound: all {captures} captures can be opened{shards}."]


@dataclass(frozen=True, slots=True)
class RepairJob(_OfGallery):
    """Take out rows that cannot be opened, and accept the others as they are."""

    def run(self, progress: Progress) -> Outcome:
        """Take them out."""
        with self.opened() as gallery:
            removed, captures = gallery.repair(), len(gallery)
        rows = f" (rows {', '.join(map(str, removed))})" if removed else ""
        took = f"Took {count(len(removed), 'row')}{rows} out of {self.file}"
        words = f"{took}; {captures} others are accepted as they are."
        return {"gallery": str(self.file), "removed": removed, "captures": captures}, [words]


@dataclass(frozen=True, slots=True)
class MigrateJob(_OfGallery):
    """Make a gallery of version 1 one of version 2, in place."""

    def run(self, progress: Progress) -> Outcome:
        """Rewrite it."""
        with self.opened() as gallery:
            captures = gallery.migrate()
        facts = {"gallery": str(self.file), "captures": captures, "version": 2}
        return facts, [f"{self.file} ({count(captures, 'capture')}) is a gallery of version 2 now."]


@dataclass(frozen=True, slots=True)
class IndexJob(_OfGallery):
    """Make the codes that a search through very many fingers needs, where they are missing."""

    _: KW_ONLY
    shards: Annotated[AnyPath | None, Help("keep them here as well, for searches through millions", "DIR")] = None
    renew: Annotated[bool, Help(
        "transform all in `shards` anew: a stolen copy cannot be compared with them")] = False  # fmt: skip

    def run(self, progress: Progress) -> Outcome:
        """Make them."""
        from splitknit_match.gallery.manage import index_gallery

        facts = index_gallery(self.file, key=self.key, shards=path(self.shards), renew=self.renew, progress=progress)
        lines = [f"Made {facts['coded']} codes of version {facts['code_version']}."]
        if facts["shards"] is not None:
            written = count(facts["shards"]["written"], "shard")
            held = f"{facts['shards']['shards']} holds {count(facts['shards']['fingers'], 'code')}"
            lines.append(f"{held}; wrote {written}, {facts['shards']['kept']} were up to date.")
            if not facts["shards"]["keyed"]:
                lines.append("Please note: without a key anyone can undo the codes' transform.")
        return facts, lines


@dataclass(frozen=True, slots=True)
class RekeyJob(_OfGallery):
    """Encrypt it, change its key, or take the encryption away."""

    _: KW_ONLY
    new_key_file: Annotated[AnyPath | None, Help(
        f"the new key: a passphrase, or 64 hexadecimal digits (or the variable {NEW_KEY_VARIABLE})",
        "FILE", secret=True)] = None  # fmt: skip
    plain: Annotated[bool, Help("take the encryption away")] = False

    def run(self, progress: Progress) -> Outcome:
        """Encrypt it anew."""
        from splitknit_match.gallery.key import key_of

        new = None if self.plain else key_of(self.new_key_file, NEW_KEY_VARIABLE)
        keys = f"`new_key_file` or in {NEW_KEY_VARIABLE} (the old one with `key_file` or in {KEY_VARIABLE})"
        cure = "or give `plain` to take the encryption away."
        require((new is None) == self.plain, f"give the new key with {keys}, {cure}")
        with self.opened() as gallery:
            captures, encrypted = gallery.rekey(new), gallery.encrypted
        facts = {"gallery": str(self.file), "captures": captures, "encrypted": encrypted}
        state = "encrypted under the new key" if encrypted else "not encrypted any more"
        words = f"{self.file} ({count(captures, 'capture')}) is {state}. Copies made before are as they were."
        return facts, [words]


LIST, INFO, REMOVE, EXPORT, IMPORT = map(Verb, (ListJob, InfoJob, RemoveJob, ExportGalleryJob, ImportGalleryJob))
CHECK, REPAIR, INDEX, REKEY, MIGRATE = map(Verb, (CheckJob, RepairJob, IndexJob, RekeyJob, MigrateJob))
