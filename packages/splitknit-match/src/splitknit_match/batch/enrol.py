"""A whole enrolment folder into a gallery: resumable, by several workers, failures to acquire
counted and kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from splitknit import BadInput, read_capture
from splitknit.errors import Refused, require
from splitknit.io.enrolment import FINGERS
from splitknit.model import Progress
from splitknit.workers import run_jobs
from splitknit_match.gallery.file import (
    Entry,
    GalleryFile,
    Key,
    check_session,
    known_finger,
    session_order,
)
from splitknit_match.gallery.gallery import (
    Enrolling,
    Made,
    content_of,
    made_of,
    new_capture,
    settings_of,
    source_hash,
)
from splitknit_match.gallery.identify import MINUTIAE_HASH

_SESSION = "session_"


@dataclass(frozen=True, slots=True)
class _Source:
    """A capture, result, print or template of an enrolment folder."""

    person: str
    finger: str
    session: str
    path: Path


def enroll_population(
    gallery: Path,
    folder: Path,
    settings: Enrolling,
    *,
    key: Key | None,
    workers: int,
    progress: Progress,
) -> dict[str, Any]:
    """Enrol ``folder/S01/session_1/right_index`` (or ``right_index.png``) and so on, but for what
    is in the gallery; every finished capture is kept at once. A capture in which no finger is found
    is a failure to acquire, a template of zero bytes. Raises BadInput if there are no captures, or
    one was enrolled from other files before (unless it may be replaced). Raises Refused if files of
    some captures cannot be read; the others are enrolled then.
    """
    require(1 <= workers <= 256, f"workers must be 1 to 256, but it is {workers}.")
    progress("looking", 0.0)
    places = _found_in(folder)
    with GalleryFile(gallery, key) as target:
        created, sha256 = not target.there, settings_of(target)
        require(
            sha256 != MINUTIAE_HASH,
            f"'{gallery}' keeps minutiae; enrol a population into a gallery of its own.",
        )
        waiting = _waiting([] if created else target.entries(), places, replace=settings.replace)
        unread = []
        failures = []
        enrolled = 0
        jobs = run_jobs(
            partial(_template_of, settings=settings), waiting, workers, "what is enrolled"
        )
        for done, (place, row) in enumerate(jobs, start=1):
            if isinstance(row, str):
                unread.append({"path": str(place.path), "reason": row})
            else:
                new = new_capture(row, place.person, place.finger, place.session, settings)
                enrolled += sum(target.add([new], sha256, replaces=settings.replace))
                if not row.template:
                    failures.append({"path": str(place.path), "reason": row.failure})
            progress(f"{place.person} {place.finger}", done / len(waiting))
        there = target.there
        facts = asdict(content_of(target, created=created)) if there else {}
    facts |= {
        "population": str(folder),
        "found": len(places),
        "known": len(places) - len(waiting),
        "new": enrolled,
        "failures_to_acquire": failures,
        "unreadable": unread,
    }
    if unread:
        kept = "nothing was enrolled" if not there else "the others are enrolled"
        first = unread[0]["reason"].rstrip(".")
        raise Refused(
            f"{len(unread)} of {len(places)} captures cannot be read, {kept} (first: {first});"
            " repair or remove them, and run the same again.",
            facts,
        )
    return facts


def _found_in(folder: Path) -> list[_Source]:
    """What an enrolment folder holds, by person, session and finger. Raises BadInput if that is
    nothing, a folder has a name that no finger or session has, or a finger of a session is there
    twice.
    """
    require(
        folder.is_dir(),
        f"there is no folder '{folder}'; name an enrolment or a simulated population.",
    )
    sources: dict[tuple[str, str, str], _Source] = {}
    for path in folder.glob(f"*/{_SESSION}*/*"):
        is_file = path.is_file() and path.stem in FINGERS
        if not (is_file or (path / "capture.json").is_file() or (path / "height.npz").is_file()):
            continue
        session = check_session(path.parent.name.removeprefix(_SESSION))
        source = _Source(
            path.parent.parent.name,
            known_finger(path.stem if is_file else path.name),
            session,
            path,
        )
        first = sources.setdefault((source.person, source.session, source.finger), source)
        require(
            first is source,
            f"'{first.path}' and '{path}' are of one finger and session; remove one of them.",
        )
    require(
        sources,
        f"'{folder}' holds nothing to enrol: captures in S01/session_1/right_index (or prints,"
        " right_index.png) and so on are expected.",
    )
    return sorted(
        sources.values(),
        key=lambda source: (source.person, session_order(source.session), source.finger),
    )


def _waiting(
    entries: Sequence[Entry], places: Sequence[_Source], *, replace: bool
) -> list[_Source]:
    """What is not in the gallery; of what is, the files are compared by their hash."""
    earlier = {entry.names: entry.source_sha256 for entry in entries}
    waiting = []
    for place in places:
        known = earlier.get((place.person, place.finger, place.session))
        if known is not None and known == source_hash(place.path):
            continue
        require(
            known is None or replace,
            f"'{place.path}' is not what was enrolled as {place.person}, {place.finger}, session"
            f" {place.session}; give `replace`, or name another gallery.",
        )
        waiting.append(place)
    return waiting


def _template_of(place: _Source, settings: Enrolling) -> Made | str:
    """Make the template of a source: a capture that is sound but shows no finger is a failure to
    acquire.

    Returns a sentence, and no row, where the files themselves are unusable.
    """
    path = place.path
    try:
        return replace(made_of(path, settings), side=None)
    except BadInput as error:
        if not (path / "capture.json").is_file() or (path / "height.npz").is_file():
            return str(error)
        try:
            read_capture(path)
        except BadInput as unread:
            return str(unread)
        failure = str(error).removeprefix(f"{path}: ")
        return Made("capture", b"", 0.0, source_hash(path), failure)
