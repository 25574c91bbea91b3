"""Score files as systems: one for each file, or for each name in its ``system`` column."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from splitknit.errors import BadInput, require
from splitknit.evaluation.protocol import Exclusion
from splitknit.evaluation.scores import Ids, Scores, contradiction, fingers_of_subjects
from splitknit.io.scores import ScoreFile, read_exclusions, read_scores


def read_systems(files: Sequence[Path], *, turn: bool) -> tuple[list[Scores], dict[str, str], list[str]]:
    """Read score files: the systems, the files' SHA-256, and the columns that were not read.

    `turn` makes similarities of dissimilarities: a score becomes its negative.
    """
    require(len(set(files)) == len(files), "a score file is named twice; name each once.")
    systems: list[Scores] = []
    hashes: dict[str, str] = {}
    ignored: list[str] = []
    for path in files:
        table = read_scores(path)
        hashes[str(path)] = table.sha256
        ignored += [column for column in table.ignored if column not in ignored]
        systems += _systems_of(path, table, turn)
    twice = {name for name, count in Counter(one.name for one in systems).items() if count > 1}
    counted: Counter[str] = Counter()
    for k, one in enumerate(systems):
        if one.name in twice:
            counted[one.name] += 1
            systems[k] = replace(one, name=f"{one.name} ({counted[one.name]})")
    return systems, hashes, ignored


def read_exclusion_list(path: Path, scores: Scores) -> tuple[list[Exclusion], str]:
    """Read a list of fingers to leave out, named as in `scores`, and its SHA-256."""
    entries, sha256 = read_exclusions(path)
    listed = []
    for entry in entries:
        name = entry["finger"]
        if scores.subject is not None and scores.finger is not None:
            subject = entry.get("subject", "")
            fitting = [one for one in scores.finger.names if one.endswith(f"/{name}")]
            require(
                bool(subject) or len(fitting) < 2,
                f"{path}: several subjects have a finger '{name}', so that the list needs its subject.",
            )
            name = f"{subject}/{name}" if subject else (fitting or [name])[0]
        listed.append(Exclusion(name, entry.get("session") or None, entry.get("reason", "")))
    return listed, sha256


def _systems_of(path: Path, table: ScoreFile, turn: bool) -> list[Scores]:
    finger, subject, session = (Ids(*table.ids[kind]) if kind in table.ids else None for kind in _KINDS)
    if finger is not None and subject is not None:
        finger = fingers_of_subjects(finger, subject)
    wrong = contradiction(table.label, finger, subject)
    if wrong is not None:
        said = "genuine (label 1), but its ids differ" if table.label[wrong] else "an impostor's (label 0), but its "
        said += "" if table.label[wrong] else "two fingers are one"
        raise BadInput(f"{path}, line {table.line[wrong]}: the comparison is {said}; correct label or ids.")
    score = -table.score if turn else table.score
    codes, names = table.system if table.system is not None else (np.zeros(score.size, dtype=np.int64), (path.stem,))
    systems = []
    for k, name in enumerate(names):
        chosen = codes == k
        whose, who, when = (None if one is None else one.taken(chosen) for one in (finger, subject, session))
        try:
            systems.append(Scores(table.label[chosen], score[chosen], whose, who, when, name))
        except BadInput as error:
            where = f"{path}: " if table.system is not None else f"{path}, as system "
            raise BadInput(f"{where}{error}") from error
    return systems


_KINDS = ("finger", "subject", "session")
