"""Enrolment: sources in, rows of a gallery out. A gallery appears with its first finger, or not at all."""

from __future__ import annotations

import contextlib
import datetime
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from splitknit.apps.enrolling_sources import Made, made_of
from splitknit.apps.gallery_options import templates_hash
from splitknit.apps.matching_inputs import MatchingSettings, Progress, no_progress
from splitknit.capture.enrolment import FINGERS
from splitknit.errors import require
from splitknit.gallery.entry import Entry, check_person, check_session
from splitknit.gallery.gallery import Enrolled, Gallery, NewCapture
from splitknit.gallery.key import Key
from splitknit.matching import unpack
from splitknit.matching.code import CODE_VERSION, code_of


@dataclass(frozen=True, slots=True)
class Enrolling:
    """How fingers are enrolled."""

    preset: str = "metric"
    """By which captures are reconstructed."""
    matching: MatchingSettings = field(default_factory=MatchingSettings)
    keep: str = "none"
    """``none``, ``thumbnail`` or ``raw``."""
    replace: bool = False
    """Whether a capture takes the place of another of the same names."""
    with_time: bool = False
    """Whether the time of enrolment is kept."""


def enroll_files(
    gallery: Path,
    sources: Sequence[Path],
    person: str,
    finger: str,
    session: str | None,
    *,
    settings: Enrolling,
    key: Key | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Enrol captures, results, templates or prints of one finger, all or none; return facts for ``--json``.

    Parameters
    ----------
    gallery : file; made where there is none
    sources : at least one
    person, finger : whose
    session : None: that of the very same source if it is enrolled already, else the next number

    Raises
    ------
    BadInput
        Naming what is at fault; the gallery is then as before.
    """
    require(len(sources) > 0, "name a capture, a result, a template (.skt) or a print to enrol.")
    require(len(sources) == 1 or session is None, "--session goes with one source; several are numbered by themselves.")
    name, finger = check_person(person), known_finger(finger)
    if session is not None:
        check_session(session)
    earlier: list[Enrolled] = []
    with contextlib.ExitStack() as stack:
        found = opened(gallery, key, settings.matching)
        if found is not None:
            earlier = stack.enter_context(found).entries(name, finger)
        made = []
        for k, source in enumerate(sources):
            made.append(
                made_of(
                    source, settings.preset, settings.matching, settings.keep,
                    lambda stage, share, k=k: progress(stage, (k + 0.9 * share) / len(sources)),  # type: ignore[misc]
                )
            )  # fmt: skip
        new = []
        taken = {one.entry.session: one.entry.source_sha256 for one in earlier}
        for one in made:
            chosen = session or _session(taken, one.source_sha256)
            taken[chosen] = one.source_sha256
            new.append(new_capture(one, name, finger, chosen, settings))
        target = found or stack.enter_context(Gallery.create(gallery, templates_hash(settings.matching), key))
        target.require_comparable(templates_hash(settings.matching))
        added = target.add(new, replace=settings.replace)
        facts = gallery_facts(target, created=found is None)
    progress("done", 1.0)
    enrolled = [entry_facts(one, is_new=is_new) for one, is_new in zip(new, added, strict=True)]
    return {**facts, "enrolled": enrolled}


def opened(gallery: Path, key: Key | None, settings: MatchingSettings) -> Gallery | None:
    """Open a gallery that can be changed and takes templates of these settings; None if there is no such file."""
    if not gallery.exists():
        require(gallery.parent.is_dir(), f"there is no folder '{gallery.parent}' for the gallery; make it first.")
        return None
    found = Gallery.open(gallery, key)
    try:
        found.require_changeable()
        found.require_comparable(templates_hash(settings))
    except BaseException:
        found.close()
        raise
    return found


def known_finger(finger: str) -> str:
    """Return `finger` if it is one of the ten."""
    require(finger in FINGERS, f"'{finger}' is no finger; fingers are {', '.join(FINGERS)}.")
    return finger


def new_capture(made: Made, person: str, finger: str, session: str, settings: Enrolling) -> NewCapture:
    """Give what was made its names."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds") if settings.with_time else ""
    entry = Entry(
        person,
        finger,
        session,
        made.kind,
        made.source_sha256,
        area_mm2=made.area_mm2,
        failure=made.failure,
        enrolled_at=now,
        images="" if made.images is None else settings.keep,
    )
    code = code_of(unpack(made.template)).tobytes() if made.template else None
    return NewCapture(entry, made.template, code, None if code is None else CODE_VERSION, made.images)


def entry_facts(one: NewCapture, *, is_new: bool) -> dict[str, Any]:
    """Of an enrolled capture."""
    return {
        "person": one.entry.person,
        "finger": one.entry.finger,
        "session": one.entry.session,
        "kind": one.entry.kind,
        "area_mm2": one.entry.area_mm2,
        "acquired": bool(one.template),
        "template_bytes": len(one.template),
        "images": one.entry.images or "none",
        "source_sha256": one.entry.source_sha256,
        "new": is_new,
    }


def gallery_facts(gallery: Gallery, *, created: bool) -> dict[str, Any]:
    """Of a gallery after an enrolment."""
    rows = gallery.entries()
    entries = [one.entry for one in rows]
    return {
        "gallery": str(gallery.path),
        "created": created,
        "encrypted": gallery.encrypted,
        "captures": len(entries),
        "fingers": len({(one.person, one.finger) for one in entries}),
        "people": len({one.person for one in entries}),
        "failures": sum(one.template_bytes == 0 for one in rows),
        "settings_sha256": gallery.settings_sha256,
    }


def _session(taken: dict[str, str], source_sha256: str) -> str:
    """Session of the very same source, else the number after the last."""
    for session, source in taken.items():
        if source == source_sha256:
            return session
    return str(1 + max((int(session) for session in taken if session.isascii() and session.isdigit()), default=0))
