"""Scores from a gallery: every finger of a session with every other finger and with itself in each later session, by
ridges, or, where templates of prints hold minutiae, by both on the same scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.io.provenance import file_hash
from splitknit.model import Progress, no_progress
from splitknit_match.evaluation.protocol import Comparisons, comparisons, scores_of_comparisons
from splitknit_match.evaluation.scores import Scores, score_table
from splitknit_match.gallery.file import GalleryFile, Key, session_order
from splitknit_match.matching.fusion import fused_match, with_fusion
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.template import unpack
from splitknit_match.prints.minutiae import minutiae_match
from splitknit_match.prints.minutiae_record import holds_minutiae, unpack_minutiae

_BLOCK = 32  # fingers kept ready at a time: 2 to 9 MB each


@dataclass(frozen=True, slots=True, eq=False)
class GalleryScores:
    """What an evaluation needs of a gallery."""

    scores: Scores
    table: bytes  # the same as a score file
    sha256: str  # hash of the gallery's file
    notes: tuple[str, ...]
    method: str  # of `match`, which gives such scores


def gallery_scores(path: Path, *, key: Key | None = None, progress: Progress = no_progress) -> GalleryScores:
    """Compare all sessions of a gallery with each other; people of an encrypted one are numbered by enrolment (P001
    ...). Raises BadInput if the gallery cannot be read, or holds fewer than two sessions or fingers.
    """
    with GalleryFile(path, key) as opened:
        people = opened.people()
    sha256, encrypted = file_hash(path), key is not None
    rows, templates = list(people.entries.values()), people.templates
    names = list(dict.fromkeys(one.person for one in rows))
    shown = {name: f"P{number:03d}" if encrypted else name for number, name in enumerate(names, start=1)}
    persons = [shown[one.person] for one in rows]
    sessions = sorted({one.session for one in rows}, key=session_order)
    when = [sessions.index(one.session) for one in rows]
    fingers = [f"{person}/{one.finger}" for person, one in zip(persons, rows, strict=True)]
    try:
        pairs = comparisons(fingers, when, within=True)
        score, note, method = _similarities([templates[one.row] for one in rows], pairs, progress)
        session_names = [one.session for one in rows]
        scores = scores_of_comparisons(pairs, score, fingers, session_names, persons, name=path.stem)
    except BadInput as error:
        raise BadInput(f"the gallery '{path}' cannot be evaluated: {error}") from error
    failures = sum(one.template_bytes == 0 for one in rows)
    notes = [f"{failures} of {len(rows)} captures are failures to acquire."] if failures else []
    if note:
        notes.append(note)
    if encrypted:
        notes.append("The gallery is encrypted: its people are numbered in the order of enrolment.")
    named = {"finger": [one.finger for one in rows], "subject": persons, "session": session_names}
    sides = pairs.a.tolist(), pairs.b.tolist()
    both = {kind: ([own[n] for n in sides[0]], [own[n] for n in sides[1]]) for kind, own in named.items()}
    table = score_table(pairs.genuine.tolist(), both, {"score": score.tolist()})
    return GalleryScores(scores, table, sha256, tuple(notes), method)


def _similarities(
    payloads: Sequence[bytes], pairs: Comparisons, progress: Progress
) -> tuple[NDArray[np.float64], str | None, str]:
    """(N,) similarity of each pair, NaN where a side is a failure to acquire, what is to be noted, and the method.

    Pairs go in blocks of second sides, one first side after the other, so that what is kept ready is small.
    """
    if any(holds_minutiae(payload) for payload in payloads):
        sides = [unpack_minutiae(payload) for payload in payloads]
        both = [(sides[a], sides[b]) for a, b in zip(pairs.a.tolist(), pairs.b.tolist(), strict=True)]
        found = [minutiae_match(a, b) if a.acquired and b.acquired else np.nan for a, b in both]
        return np.array(found), None, "minutiae"
    templates = [unpack(payload) for payload in payloads]
    fused, note = with_fusion([one for one in templates if not one.empty])
    match = fused_match if fused else ridge_match
    prepared = lru_cache(_BLOCK + 1)(lambda place: Prepared(templates[place]))
    score = np.full(pairs.a.size, np.nan)
    for done, n in enumerate(np.lexsort((pairs.a, pairs.b // _BLOCK)).tolist()):
        a, b = int(pairs.a[n]), int(pairs.b[n])
        if done % 256 == 0:
            progress("comparing", 0.9 * done / score.size)
        if not (templates[a].empty or templates[b].empty):
            score[n] = match(prepared(a), prepared(b)).similarity
    return score, note, "fusion" if fused else "ridge"
