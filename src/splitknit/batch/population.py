"""The captures of a population: those that are complete."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from splitknit.capture.enrolment import PLAN_FILE, Place, open_enrolment
from splitknit.errors import require
from splitknit.io.fields import Fields, read_json

_SIMULATED = "population.json"


@dataclass(frozen=True, slots=True)
class CaptureRef:
    """One capture folder of a population."""

    name: str
    """Of its folder, relative to the population: ``S01/session_1/right_index``."""
    subject: str
    finger: str
    """Of the world: ``S01/right_index``."""
    session: str
    place: int
    """In the order of subjects, fingers and sessions of the plan, captured or not."""
    number: int = 0
    """Of the finger in that order: the same in every session."""


@dataclass(frozen=True, slots=True)
class Population:
    """A population on disk."""

    folder: Path
    sha256: str
    """Of what it was simulated with; of the word ``enrolment`` for captures of real fingers."""
    planned: int
    captures: tuple[CaptureRef, ...]
    """Those that are complete, in the order of the plan."""


def read_population(folder: Path) -> Population:
    """List the complete captures of an enrolment or a simulated population, even while it is still being filled.

    Raises
    ------
    BadInput
        If it is neither, its plan is damaged, or it holds no complete capture.
    """
    try:
        known = (folder / PLAN_FILE).is_file()
    except (OSError, ValueError):
        known = False
    require(
        known,
        f"'{folder}' is no population: it holds no {PLAN_FILE}; name a folder of 'splitknit simulate population' or of "
        "an enrolment.",
    )
    enrolment = open_enrolment(folder)
    plan = enrolment.plan
    captures = []
    for number, (subject, finger, session) in enumerate(
        (subject, finger, session)
        for subject in plan.subject_ids()
        for finger in plan.fingers
        for session in range(1, plan.sessions + 1)
    ):
        place = Place(subject, session, finger)
        if enrolment.finished(place):
            captures.append(
                CaptureRef(place.folder, subject, f"{subject}/{finger}", str(session), number, number // plan.sessions)
            )
    require(len(captures) > 0, f"the population '{folder}' holds no finished capture yet.")
    return Population(folder, _hash(folder), plan.total, tuple(captures))


def _hash(folder: Path) -> str:
    file = folder / _SIMULATED
    if not file.is_file():
        return hashlib.sha256(b"enrolment").hexdigest()
    return Fields(read_json(file)[0], str(file)).text("settings_sha256")
