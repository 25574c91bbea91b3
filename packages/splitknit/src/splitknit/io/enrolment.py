"""Many fingers, one after the other, over days: which are captured, and which is next.

The folder holds ``enrolment.json`` (the plan) and ``S01/session_1/right_index/`` (a capture folder each). What is
finished is read off the folders, which appear whole or not at all: stopping at any moment loses nothing. Subjects have
numbers, no names; who S01 is, is nobody's business here.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.errors import BadInput, require
from splitknit.io.atomic import write_file
from splitknit.io.fields import read_json
from splitknit.io.provenance import json_text

HAND = ("thumb", "index", "middle", "ring", "little")
FINGERS = tuple(f"{side}_{finger}" for side in ("right", "left") for finger in HAND)
PLAN_FILE = "enrolment.json"
_FORMAT, _VERSION = "splitknit-enrolment", 1


@dataclass(frozen=True, slots=True)
class _EnrolmentPlan:
    subjects: int = 17  # the thesis has 17, with all ten fingers, in four sessions
    sessions: int = 4
    fingers: tuple[str, ...] = FINGERS

    def __post_init__(self) -> None:
        require(1 <= self.subjects <= 9999, f"an enrolment has 1 to 9999 subjects, not {self.subjects}.")
        require(1 <= self.sessions <= 999, f"an enrolment has 1 to 999 sessions, not {self.sessions}.")
        require(len(self.fingers) > 0, "an enrolment needs at least one finger.")
        for finger in self.fingers:
            require(finger in FINGERS, f"{finger[:60]!a} is not a finger; fingers are {', '.join(FINGERS)}.")
        require(len(set(self.fingers)) == len(self.fingers), "an enrolment names a finger twice.")

    @property
    def total(self) -> int:
        """Number of captures."""
        return self.subjects * self.sessions * len(self.fingers)

    def subject_ids(self) -> tuple[str, ...]:
        """S01, S02, ..."""
        return tuple(f"S{number:02d}" for number in range(1, self.subjects + 1))


@dataclass(frozen=True, slots=True)
class PlannedCapture:
    """One capture of the plan."""

    subject: str
    session: int
    finger: str

    @property
    def folder(self) -> str:
        """Where it is, relative to the enrolment."""
        return f"{self.subject}/session_{self.session}/{self.finger}"

    @property
    def words(self) -> str:
        """For people."""
        return f"{self.subject}, session {self.session}, {self.finger.replace('_', ' ')}"


@dataclass(frozen=True, slots=True)
class Enrolment:
    """An enrolment on disk."""

    folder: Path
    plan: _EnrolmentPlan

    def places(self) -> Iterator[PlannedCapture]:
        """Yield all captures in their order: session by session, subject by subject, finger by finger."""
        days = range(1, self.plan.sessions + 1)
        for session, subject, finger in itertools.product(days, self.plan.subject_ids(), self.plan.fingers):
            yield PlannedCapture(subject, session, finger)

    def path(self, place: PlannedCapture) -> Path:
        """Capture folder of a place."""
        return self.folder / place.folder

    def finished(self, place: PlannedCapture) -> bool:
        """Whether it is captured."""
        return (self.path(place) / "capture.json").is_file()

    def waiting(
        self, *, subject: str | None = None, session: int | None = None, finger: str | None = None
    ) -> list[PlannedCapture]:
        """What is not captured yet, in its order; of one subject, session or finger of the plan where named."""
        plan = self.plan
        people, lacking = plan.subject_ids(), f"is not in the plan of '{self.folder}'; it has"
        planned = subject is None or subject in people
        require(planned, f"subject '{subject}' {lacking} {people[0]} to {people[-1]}.")
        planned = session is None or 1 <= session <= plan.sessions
        require(planned, f"session {session} {lacking} sessions 1 to {plan.sessions}.")
        planned = finger is None or finger in plan.fingers
        require(planned, f"finger '{finger}' {lacking} {', '.join(plan.fingers)}.")

        def wanted(place: PlannedCapture) -> bool:
            of_one = subject in (None, place.subject) and session in (None, place.session)
            return of_one and finger in (None, place.finger) and not self.finished(place)

        return list(filter(wanted, self.places()))

    def seeds(self, place: PlannedCapture, seed: int) -> tuple[int, int]:
        """Seed and impression of a simulated finger: every finger has its own, every session is another impression."""
        person = int(place.subject.removeprefix("S"))
        key = [seed, 0xE7, person, FINGERS.index(place.finger)]
        return int(np.random.SeedSequence(key).generate_state(1, np.uint32)[0]), place.session - 1


def open_enrolment(
    folder: Path, *, subjects: int | None = None, sessions: int | None = None, fingers: Sequence[str] | None = None
) -> Enrolment:
    """Open an enrolment, or start one; what is not given is as planned, or as in the thesis. Raises BadInput if the
    folder holds something else, its plan is damaged, or it would shrink: what was planned may be captured.
    """
    planned = plan_enrolment(folder, subjects=subjects, sessions=sessions, fingers=fingers)
    file = folder / PLAN_FILE
    if not file.is_file() or _read(file) != planned.plan:
        document = {"format": _FORMAT, "version": _VERSION, **asdict(planned.plan)}
        write_file(file, json_text(document).encode("ascii"))
    return planned


def plan_enrolment(
    folder: Path, *, subjects: int | None = None, sessions: int | None = None, fingers: Sequence[str] | None = None
) -> Enrolment:
    """What :func:`open_enrolment` would open; nothing is written."""
    file = folder / PLAN_FILE
    earlier = _read(file) if file.is_file() else None
    if earlier is None and folder.exists():
        require(folder.is_dir(), f"'{folder}' is a file; name a folder for the enrolment.")
        require(
            not any(folder.iterdir()),
            f"'{folder}' is not an enrolment: it holds other files and no {PLAN_FILE}; name another folder.",
        )
    given = {"subjects": subjects, "sessions": sessions, "fingers": None if fingers is None else tuple(fingers)}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    wanted = replace(earlier or _EnrolmentPlan(), **changes)
    if earlier is not None:
        grown = wanted.subjects >= earlier.subjects and wanted.sessions >= earlier.sessions
        require(
            grown and set(wanted.fingers) >= set(earlier.fingers),
            f"the enrolment in '{folder}' is planned for "
            f"{earlier.subjects} subjects, {earlier.sessions} sessions and {len(earlier.fingers)} fingers"
            "; a plan may grow but not shrink: "
            "leave out `subjects`, `sessions` and `fingers`, or name another folder.",
        )
    return Enrolment(folder, wanted)


def check_subject_id(text: str) -> str:
    """Return `text` if it can be a subject's id: letters, digits, - and _ only; it is safe in paths and files."""
    require(
        re.fullmatch(r"[A-Za-z0-9_-]{1,32}", text) is not None,
        f"'{text}' cannot be a subject's id: use up to 32 letters, digits, - and _ (such as S01), never a name.",
    )
    return text


def _read(file: Path) -> _EnrolmentPlan:
    try:
        document, _ = read_json(file)
        require(document["format"] == _FORMAT and document["version"] == _VERSION, f"'{file}' is of another version.")
        subjects, sessions, fingers = document["subjects"], document["sessions"], document["fingers"]
        sound = type(subjects) is int and type(sessions) is int and isinstance(fingers, list)
        require(sound and all(isinstance(finger, str) for finger in fingers), f"'{file}' is damaged.")
        return _EnrolmentPlan(subjects, sessions, tuple(fingers))
    except (ValueError, KeyError, TypeError) as error:
        reason = str(error) if isinstance(error, BadInput) else "it is damaged"
        raise BadInput(
            f"the plan '{file}' cannot be read ({reason.rstrip('.')}); put it right, or remove it and "
            "give `subjects`, `sessions` and `fingers` again: no capture is lost by that."
        ) from error
