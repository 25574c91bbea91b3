"""The captures of a population that are complete, and which of them are compared."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splitknit.errors import refusing, require
from splitknit.io.enrolment import PLAN_FILE, PlannedCapture, open_enrolment
from splitknit.io.fields import read_json, text_of
from splitknit_match.evaluation.protocol import Comparisons, comparisons


@dataclass(frozen=True, slots=True)
class CaptureRef:
    """One capture folder of a population."""

    name: str  # path of its folder, relative to the population: ``S01/session_1/right_index``
    subject: str
    finger: str  # unique in the world: ``S01/right_index``
    session: str
    number: int  # number of the finger in the plan, the same in every session


@dataclass(frozen=True, slots=True)
class Population:
    """A population on disk."""

    folder: Path
    # of the simulation's settings; for captures of real fingers, of the word ``enrolment``
    sha256: str
    planned: int
    captures: tuple[CaptureRef, ...]  # those that are complete


def read_population(folder: Path) -> Population:
    """List the complete captures of an enrolment or a simulated population, still growing or not.

    Raises BadInput if it is neither, its plan is damaged, or it holds no complete capture.
    """
    fault = (
        f"'{folder}' is not a population: it holds no {PLAN_FILE}; name a folder of 'splitknit"
        " simulate population', of an enrolment, or of folders of photographs."
    )
    with refusing(fault):  # a name may be too long
        require((folder / PLAN_FILE).is_file(), fault)
    plan = open_enrolment(folder).plan
    captures = []
    fingers = [(subject, finger) for subject in plan.subject_ids() for finger in plan.fingers]
    for number, (subject, finger) in enumerate(fingers):
        for session in range(1, plan.sessions + 1):
            name = PlannedCapture(subject, session, finger).folder
            if (folder / name / "capture.json").is_file():
                world = f"{subject}/{finger}"
                captures.append(CaptureRef(name, subject, world, str(session), number))
    require(captures, f"the population '{folder}' holds no finished capture yet.")
    return Population(folder, _hash(folder), plan.total, tuple(captures))


def _hash(folder: Path) -> str:
    file = folder / "population.json"
    if not file.is_file():
        return hashlib.sha256(b"enrolment").hexdigest()
    return text_of(read_json(file)[0], "settings_sha256", str(file))


def all_pairs(captures: Sequence[CaptureRef], impostors: float, seed: int) -> Comparisons:
    """Every finger of a session with every finger of every later one.

    Of different fingers only a fraction `impostors`, drawn by pairs of fingers, all sessions of a
    pair together. Raises BadInput if the captures are of one session.
    """

    def drawn(finger: str, impostor: str) -> bool:
        first, second = sorted((finger, impostor))
        digest = hashlib.sha256(f"{seed}|{first}|{second}".encode()).digest()
        return int.from_bytes(digest[:8], "big") < impostors * 2.0**64

    fingers = [capture.finger for capture in captures]
    sessions = [capture.session for capture in captures]
    return comparisons(fingers, sessions, drawn if impostors < 1.0 else None)


PAIRS = 2048
"""Comparisons of a task at most: what a run that is killed loses, for each of its workers."""


def blocks_of(
    pairs: Comparisons, captures: Sequence[CaptureRef], fingers: int
) -> list[Comparisons]:
    """Comparisons in blocks: at most :data:`PAIRS`, with earlier captures of at most `fingers`.

    Blocks follow from the captures alone, not from what is done, so that a run that goes on makes
    the same ones.
    """
    session = np.array([int(capture.session) for capture in captures])[pairs.a]
    group = np.array([capture.number for capture in captures])[pairs.a] // fingers
    order = np.lexsort((pairs.a, pairs.b, group, session))
    changes = np.diff(session[order]) | np.diff(group[order])
    starts = [0, *(np.flatnonzero(changes) + 1).tolist()]
    ends = [*starts[1:], len(order)]
    cuts = [
        cut for start, end in zip(starts, ends, strict=True) for cut in range(start, end, PAIRS)
    ]
    return [chosen_pairs(pairs, part) for part in np.split(order, cuts[1:])]


def chosen_pairs(pairs: Comparisons, chosen: np.ndarray) -> Comparisons:
    """Some of the comparisons, by their places or by a mask."""
    return Comparisons(pairs.a[chosen], pairs.b[chosen], pairs.genuine[chosen])
