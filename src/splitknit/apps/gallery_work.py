"""What ``splitknit gallery`` does, but for export and import: look, remove, index, check, mend, rewrap."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from splitknit.apps.gallery_options import KEY_VARIABLE, NEW_KEY_VARIABLE
from splitknit.apps.matching_inputs import Progress, no_progress
from splitknit.apps.verb import Refused
from splitknit.errors import require
from splitknit.gallery.entry import check_person, session_order
from splitknit.gallery.file import describe
from splitknit.gallery.gallery import Gallery
from splitknit.gallery.key import Key
from splitknit.matching import unpack
from splitknit.matching.code import CODE_VERSION, code_of


def list_gallery(gallery: Path, person: str | None, *, key: Key | None = None) -> dict[str, Any]:
    """Whose fingers are in a gallery, person by person."""
    name = None if person is None else check_person(person)
    with Gallery.open(gallery, key) as opened:
        rows = opened.entries(name)
    require(name is None or len(rows) > 0, f"'{gallery}' holds nothing of person '{name}'.")
    rows.sort(key=lambda one: (one.entry.person, one.entry.finger, session_order(one.entry.session)))
    return {
        "gallery": str(gallery),
        "captures": [
            {
                "row": one.row,
                "person": one.entry.person,
                "finger": one.entry.finger,
                "session": one.entry.session,
                "kind": one.entry.kind,
                "area_mm2": one.entry.area_mm2,
                "acquired": one.template_bytes > 0,
                "failure": one.entry.failure,
                "template_bytes": one.template_bytes,
                "images": one.entry.images or "none",
                "enrolled_at": one.entry.enrolled_at or None,
                "source_sha256": one.entry.source_sha256,
            }
            for one in rows
        ],
    }


def gallery_info(gallery: Path, *, key: Key | None = None) -> dict[str, Any]:
    """What can be seen without a key, and with it the numbers of people and fingers."""
    facts = {"gallery": str(gallery), **describe(gallery), "fingers": None, "people": None, "failures": None}
    if key is not None or not facts["encrypted"]:
        with Gallery.open(gallery, key) as opened:
            rows = opened.entries()
        facts["fingers"] = len({(one.entry.person, one.entry.finger) for one in rows})
        facts["people"] = len({one.entry.person for one in rows})
        facts["failures"] = sum(one.template_bytes == 0 for one in rows)
    return facts


def remove_from_gallery(
    gallery: Path,
    *,
    person: str | None = None,
    finger: str | None = None,
    session: str | None = None,
    rows: Sequence[int] = (),
    key: Key | None = None,
) -> dict[str, Any]:
    """Remove a person, a finger, a session of it, or rows by number; nothing of them remains in the file.

    Raises
    ------
    BadInput
        If nothing is named, or what is named is not there.
    """
    require((person is None) != (not rows), "say whose fingers are to be removed: --person NAME, or --row N.")
    require(not rows or (finger is None and session is None), "--row goes without --finger and --session.")
    with Gallery.open(gallery, key) as opened:
        chosen = list(rows)
        if person is not None:
            chosen = [one.row for one in opened.entries(check_person(person), finger, session)]
            words = ", ".join(word for word in (person, finger, session and f"session {session}") if word)
            require(len(chosen) > 0, f"'{gallery}' holds nothing of {words}; 'splitknit gallery list' tells whom.")
        removed = opened.remove(chosen)
        require(removed > 0, f"'{gallery}' holds no row {', '.join(map(str, chosen))}.")
        return {"gallery": str(gallery), "removed": removed, "captures": len(opened)}


def index_gallery(gallery: Path, *, key: Key | None = None, progress: Progress = no_progress) -> dict[str, Any]:
    """Make the search codes that are missing or of another version, and keep them."""
    made = 0
    with Gallery.open(gallery, key) as opened:
        opened.require_changeable()
        rows = [one.row for one in opened.entries() if one.template_bytes > 0 and one.code_version != CODE_VERSION]
        for start in range(0, len(rows), 256):  # in short transactions: what is done is kept
            progress("coding", start / len(rows))
            templates = opened.templates(rows[start : start + 256])
            codes = {row: code_of(unpack(payload)).tobytes() for row, payload in templates.items()}
            opened.set_codes(codes, CODE_VERSION)
            made += len(codes)
    return {"gallery": str(gallery), "coded": made, "code_version": CODE_VERSION}


def check_gallery(gallery: Path, *, key: Key | None = None) -> dict[str, Any]:
    """Open everything.

    Raises
    ------
    Refused
        If something is damaged; its facts list what.
    """
    with Gallery.open(gallery, key) as opened:
        problems = opened.problems()
        facts = {
            "gallery": str(gallery),
            "captures": len(opened),
            "sound": not problems,
            "problems": [{"row": row, "what": what} for row, what in problems],
        }
    if problems:
        rows = sorted({row for row, _ in problems if row is not None})
        shown = ", ".join(map(str, rows[:10])) + (", ..." if len(rows) > 10 else "")
        where = f"rows {shown}; 'splitknit gallery remove --row N' takes a row out"
        whole = [what.rstrip(".") for row, what in problems if row is None]
        if whole:
            where = f"rows {shown}; {whole[0]}" if rows else whole[0]
        raise Refused(f"the gallery '{gallery}' is damaged in {len(problems)} places ({where}).", facts)
    return facts


def rekey_gallery(gallery: Path, *, key: Key | None, new: Key | None, plain: bool = False) -> dict[str, Any]:
    """Encrypt a gallery anew, or no longer.

    Raises
    ------
    BadInput
        If neither a new key nor `plain` is given, or both.
    """
    require(
        (new is None) == plain,
        f"give the new key with --new-key-file or in {NEW_KEY_VARIABLE} (the old one with --key-file or in "
        f"{KEY_VARIABLE}), or say --plain to take the encryption away.",
    )
    with Gallery.open(gallery, key) as opened:
        return {"gallery": str(gallery), "captures": opened.rekey(new), "encrypted": opened.encrypted}


def repair_gallery(gallery: Path, *, key: Key | None = None) -> dict[str, Any]:
    """Take out the rows that cannot be opened, and accept the others as they are."""
    with Gallery.open(gallery, key) as opened:
        return {"gallery": str(gallery), "removed": opened.repair(), "captures": len(opened)}


def migrate_gallery(gallery: Path, *, key: Key | None = None) -> dict[str, Any]:
    """Make a gallery of version 1 one of version 2.

    Raises
    ------
    BadInput
        If it is of version 2 already, or damaged; it is then as before.
    """
    with Gallery.open(gallery, key) as opened:
        return {"gallery": str(gallery), "captures": opened.migrate(), "version": 2}
