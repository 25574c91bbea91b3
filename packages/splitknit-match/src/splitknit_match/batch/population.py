"""The captures of a population: those that are complete."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.io.enrolment import PLAN_FILE, PlannedCapture, open_enrolment
from splitknit.io.fields import read_json, text_of
from splitknit_match.evaluation.protocol import Comparisons, comparisons

_SIMULATED = "population.json"


@dataclass(frozen=True, slots=True)
class CaptureRef:
    """One capture folder of a population."""

    name: str  # path of its folder, relative to the population: ``S01/session_1/right_index``
    subject: str
    finger: str  # the finger, unique in the world: ``S01/right_index``
    session: str
    place: int  # in the order of subjects, fingers and sessions of the plan, captured or not
    number: int = 0  # number of the finger in that order, the same in every session


@dataclass(frozen=True, slots=True)
class Population:
    """A population on disk."""

    folder: Path
    sha256: str  # hash of the simulation's settings; for captures of real fingers, of the word ``enrolment``
    planned: int
    captures: tuple[CaptureRef, ...]  # those that are complete, in the order of the plan


def read_population(folder: Path) -> Population:
    """List the complete captures of an enrolment or a simulated population, even while it is still being filled. Raises
    BadInput if it is neither, its plan is damaged, or it holds no complete capture.
    """
    try:
        known = (folder / PLAN_FILE).is_file()
    except (OSError, ValueError):
        known = False
    cure = "name a folder of 'splitknit simulate population' or of an enrolment."
    require(known, f"'{folder}' is not a population: it holds no {PLAN_FILE}; {cure}")
    plan = open_enrolment(folder).plan
    captures = []
    for number, (subject, finger, session) in enumerate(
        (subject, finger, session)
        for subject in plan.subject_ids()
        for finger in plan.fingers
        for session in range(1, plan.sessions + 1)
    ):
        place = PlannedCapture(subject, session, finger)
        if (folder / place.folder / "capture.json").is_file():
            who = subject, f"{subject}/{finger}", str(session)
            captures.append(CaptureRef(place.folder, *who, number, number // plan.sessions))
    require(len(captures) > 0, f"the population '{folder}' holds no finished capture yet.")
    return Population(folder, _hash(folder), plan.total, tuple(captures))


def _hash(folder: Path) -> str:
    file = folder / _SIMULATED
    if not file.is_file():
        return hashlib.sha256(b"enrolment").hexdigest()
    return text_of(read_json(file)[0], "settings_sha256", str(file))


# Which captures are compared, in blocks: a block of one session with a block of a later one.
#
# Where a block ends depends on the plan of the population and on the matcher alone, never on what is there already, so
# that two runs, however they were interrupted, do the same chunks.


@dataclass(frozen=True, slots=True)
class Blocks:
    """How many captures stand together."""

    database: int  # captures of the earlier session, kept ready for the whole block
    query: int  # captures of the later session, taken one after the other


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """The comparisons of one block."""

    number: int  # in the order of all blocks of the plan
    pairs: Comparisons


def all_pairs(captures: Sequence[CaptureRef], impostors: float, seed: int) -> Comparisons:
    """Every finger of a session with every finger of every later one; of different fingers a fraction only, drawn by
    pairs of fingers, all sessions of a pair together. Raises BadInput if the captures are of one session.
    """
    drawn = None if impostors >= 1.0 else lambda one, other: draw(one, other, seed) < impostors
    return comparisons([one.finger for one in captures], [one.session for one in captures], drawn)


def draw(a: str, b: str, seed: int) -> float:
    """Number in [0, 1) that belongs to two fingers; those below the fraction of impostors are compared."""
    first, second = sorted((a, b))
    digest = hashlib.sha256(f"{seed}|{first}|{second}".encode()).digest()
    return int.from_bytes(digest[:8], "big") / 2.0**64


def missing_pairs(pairs: Comparisons, count: int, done: NDArray[np.int64]) -> Comparisons:
    """Those of `pairs` whose key ``a * count + b`` is not in `done`."""
    kept = ~np.isin(pairs.a * count + pairs.b, done)
    return Comparisons(pairs.a[kept], pairs.b[kept], pairs.genuine[kept])


def blocks_of(pairs: Comparisons, captures: Sequence[CaptureRef], blocks: Blocks) -> list[Block]:
    """Comparisons block by block; those that share a database's block follow each other."""
    session = np.array([int(one.session) for one in captures], dtype=np.int64)
    number = np.array([one.number for one in captures], dtype=np.int64)
    at_a, at_b = number[pairs.a] // blocks.database, number[pairs.b] // blocks.query
    keys = np.stack([session[pairs.a], at_a, session[pairs.b], at_b])
    order = np.lexsort((pairs.b, pairs.a, *keys[::-1]))
    keys = keys[:, order]
    if not order.size:
        return []
    starts = np.flatnonzero(np.concatenate([[True], (keys[:, 1:] != keys[:, :-1]).any(axis=0)]))
    parts = np.split(order, starts[1:])
    found = []
    for start, part in zip(starts.tolist(), parts, strict=True):
        first, low, second, high = (int(value) for value in keys[:, start])
        place = ((first * 1000 + second) * 10_000 + low) * 10_000 + high
        found.append(Block(place, Comparisons(pairs.a[part], pairs.b[part], pairs.genuine[part])))
    return found
