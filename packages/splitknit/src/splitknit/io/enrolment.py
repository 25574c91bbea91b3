"""A plan of many captures over days: which are done, and which is next.

The folder holds ``enrolment.json`` (the plan) and ``S01/session_1/right_index/`` (a capture folder
each). What is finished is read off the folders, which appear whole or not at all: stopping at any
moment loses nothing. Subjects have numbers, no names; who S01 is, is nobody's business here.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import asdict

from splitknit.errors import BadInput, require
from splitknit.io.atomic import write_file
from splitknit.io.fields import Version1, converted, read_document
from splitknit.io.photograph_files import some_of
from splitknit.io.provenance import json_text

HAND = ("thumb", "index", "middle", "ring", "little")
FINGERS = tuple(f"{side}_{finger}" for side in ("right", "left") for finger in HAND)
PLAN_FILE = "enrolment.json"
_Finger = Annotated[str, Meta(pattern=f"^({'|'.join(FINGERS)})$")]


class EnrolmentPlan(Struct, frozen=True, kw_only=True):
    """What is to be captured."""

    format: Annotated[str, Meta(pattern="^(splitknit-enrolment)$")] = "splitknit-enrolment"
    version: Version1 = 1
    subjects: Annotated[int, Meta(ge=1, le=9999)]
    sessions: Annotated[int, Meta(ge=1, le=999)]
    fingers: Annotated[tuple[_Finger, ...], Meta(min_length=1)]

    @property
    def total(self) -> int:
        """Number of captures."""
        return self.subjects * self.sessions * len(self.fingers)

    def subject_ids(self) -> tuple[str, ...]:
        """S01, S02, ..."""
        return tuple(f"S{number:02d}" for number in range(1, self.subjects + 1))


THESIS = EnrolmentPlan(subjects=17, sessions=4, fingers=FINGERS)
"""17 people, all ten fingers, four sessions. Source: thesis."""


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
    plan: EnrolmentPlan

    def places(self) -> Iterator[PlannedCapture]:
        """Yield all captures in their order: session by session, subject by subject, finger by
        finger."""
        days = range(1, self.plan.sessions + 1)
        for session, subject, finger in itertools.product(
            days, self.plan.subject_ids(), self.plan.fingers
        ):
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
        """What is not captured yet, in its order; of one subject, session or finger of the plan
        where named."""
        wanted = {"subject": subject, "session": session, "finger": finger}
        left = list(self.places())
        for name, value in wanted.items():
            planned = list(dict.fromkeys(str(getattr(place, name)) for place in left))
            require(
                value is None or str(value) in planned,
                f"{name} '{value}' is not in the plan of '{self.folder}'; it has"
                f" {some_of(planned)}.",
            )
            left = [place for place in left if value in (None, getattr(place, name))]
        return [place for place in left if not self.finished(place)]

    def seeds(self, place: PlannedCapture, seed: int) -> tuple[int, int]:
        """Seed and impression of a simulated finger: every finger has its own, every session is
        another impression."""
        person = int(place.subject.removeprefix("S"))
        key = [seed, 0xE7, person, FINGERS.index(place.finger)]
        return int(np.random.SeedSequence(key).generate_state(1, np.uint32)[0]), place.session - 1


def open_enrolment(
    folder: Path,
    *,
    subjects: int | None = None,
    sessions: int | None = None,
    fingers: Sequence[str] | None = None,
) -> Enrolment:
    """Open an enrolment, or start one; what is not given is as planned, or as in the thesis. Raises
    BadInput if the folder holds something else, its plan is damaged, or it would shrink: what was
    planned may be captured.
    """
    planned = plan_enrolment(folder, subjects=subjects, sessions=sessions, fingers=fingers)
    file = folder / PLAN_FILE
    if not file.is_file() or _read(file) != planned.plan:
        write_file(file, json_text(asdict(planned.plan)).encode("ascii"))
    return planned


def fingers_named(words: str | None) -> tuple[str, ...] | None:
    """The fingers of an option: all of them, or those with commas between; None where it was not
    given.

    >>> fingers_named("right_index,left_thumb"), len(fingers_named("all") or ())
    (('right_index', 'left_thumb'), 10)
    """
    if words is None:
        return None
    return FINGERS if words == "all" else tuple(words.split(","))


def plan_enrolment(
    folder: Path,
    *,
    subjects: int | None = None,
    sessions: int | None = None,
    fingers: Sequence[str] | None = None,
) -> Enrolment:
    """What :func:`open_enrolment` would open; nothing is written."""
    file = folder / PLAN_FILE
    earlier = _read(file) if file.is_file() else None
    if earlier is None and folder.exists():
        require(folder.is_dir(), f"'{folder}' is a file; name a folder for the enrolment.")
        require(
            not any(folder.iterdir()),
            f"'{folder}' is not an enrolment: it holds other files and no {PLAN_FILE}; name another"
            " folder.",
        )
    wishes = {"subjects": subjects, "sessions": sessions, "fingers": fingers}
    changes = {name: value for name, value in wishes.items() if value is not None}
    plan = converted({**asdict(earlier or THESIS), **changes}, EnrolmentPlan, "the enrolment")
    require(len(set(plan.fingers)) == len(plan.fingers), "an enrolment names a finger twice.")
    if earlier is not None:
        grown = plan.subjects >= earlier.subjects and plan.sessions >= earlier.sessions
        require(
            grown and set(plan.fingers) >= set(earlier.fingers),
            f"the enrolment in '{folder}' is planned for {earlier.subjects} subjects,"
            f" {earlier.sessions} sessions and {len(earlier.fingers)} fingers; a plan may grow but"
            " not shrink: leave out `subjects`, `sessions` and `fingers`, or name another folder.",
        )
    return Enrolment(folder, plan)


def _read(file: Path) -> EnrolmentPlan:
    try:
        return read_document(file, EnrolmentPlan)[0]
    except BadInput as error:
        raise BadInput(
            f"the plan '{file}' cannot be read ({str(error).rstrip('.')}); put it right, or remove"
            " it and give `subjects`, `sessions` and `fingers` again: no capture is lost by that."
        ) from error
