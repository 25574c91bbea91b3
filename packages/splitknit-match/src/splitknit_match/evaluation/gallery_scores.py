"""Scores from a gallery: every finger of a session with every other finger and with itself in each
later session, by ridges, or, where templates of prints hold minutiae, by both on the same scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from splitknit import BadInput
from splitknit.findings import Finding
from splitknit.io.provenance import file_hash
from splitknit.model import Array, Progress, no_progress
from splitknit_match.evaluation.protocol import Comparisons, comparisons, scores_of_comparisons
from splitknit_match.evaluation.scores import Scores, score_table
from splitknit_match.gallery.file import GalleryFile, Key, session_order
from splitknit_match.matching.fusion import with_fusion
from splitknit_match.matching.methods import compare_templates
from splitknit_match.matching.minutiae_match import minutiae_match
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import unpack
from splitknit_match.records.minutiae_record import holds_minutiae, unpack_minutiae


@dataclass(frozen=True, slots=True, eq=False)
class GalleryScores:
    """What an evaluation needs of a gallery."""

    scores: Scores
    table: bytes  # the same as a score file
    sha256: str  # hash of the gallery's file
    findings: tuple[Finding, ...]
    method: str  # of `match`, which gives such scores


def gallery_scores(
    path: Path, *, key: Key | None = None, progress: Progress = no_progress
) -> GalleryScores:
    """Compare all sessions of a gallery with each other.

    People of an encrypted one are numbered by enrolment (P001 ...). Raises BadInput if the gallery
    cannot be read, or holds fewer than two sessions or fingers.
    """
    people = GalleryFile(path, key).people()
    captures = list(people.entries.values())
    persons = [capture.person for capture in captures]
    if key is not None:
        numbers = {
            person: f"P{number:03d}"
            for number, person in enumerate(dict.fromkeys(persons), start=1)
        }
        persons = [numbers[person] for person in persons]
    sessions = [capture.session for capture in captures]
    order = {
        session: place for place, session in enumerate(sorted(set(sessions), key=session_order))
    }
    fingers = [
        f"{person}/{capture.finger}" for person, capture in zip(persons, captures, strict=True)
    ]
    try:
        pairs = comparisons(fingers, [order[session] for session in sessions], within=True)
        payloads = [people.templates[capture.row] for capture in captures]
        score, compared, method = _similarities(payloads, pairs, progress)
        scores = scores_of_comparisons(pairs, score, fingers, sessions, persons, name=path.stem)
    except BadInput as error:
        raise BadInput(f"the gallery '{path}' cannot be evaluated: {error}") from error
    failures = sum(capture.template_bytes == 0 for capture in captures)
    findings = []
    if failures:
        words = f"{failures} of {len(captures)} captures are failures to acquire."
        findings.append(Finding("failures-in-gallery", words))
    findings += compared
    if key is not None:
        words = "The gallery is encrypted: its people are numbered in the order of enrolment."
        findings.append(Finding("numbered-people", words))
    columns = {
        "finger": [capture.finger for capture in captures],
        "subject": persons,
        "session": sessions,
    }
    names = {
        kind: ([column[place] for place in pairs.a], [column[place] for place in pairs.b])
        for kind, column in columns.items()
    }
    table = score_table(pairs.genuine.tolist(), names, {"score": score.tolist()})
    return GalleryScores(scores, table, file_hash(path), tuple(findings), method)


KEPT_FINGERS = 32
"""Fingers kept ready at a time: 2 to 16 MB each. Chosen on: speed."""


def _similarities(
    payloads: Sequence[bytes], pairs: Comparisons, progress: Progress
) -> tuple[Array, tuple[Finding, ...], str]:
    """(N,) similarity of each pair, NaN where a side is a failure to acquire, what a reader has to
    know, and the method.

    Pairs go in blocks of second sides, one first side after the other, so that what is kept ready
    is small.
    """
    if any(holds_minutiae(payload) for payload in payloads):
        minutiae = [unpack_minutiae(payload) for payload in payloads]
        sides = ((minutiae[a], minutiae[b]) for a, b in zip(pairs.a, pairs.b, strict=True))
        scores = [minutiae_match(a, b) if a.acquired and b.acquired else np.nan for a, b in sides]
        return np.array(scores), (), "minutiae"
    templates = [unpack(payload) for payload in payloads]
    fused, findings = with_fusion([template for template in templates if not template.empty])
    method = "fusion" if fused else "ridge"
    prepared = lru_cache(KEPT_FINGERS + 1)(lambda place: Prepared(templates[place]))
    score = np.full(pairs.a.size, np.nan)
    for done, n in enumerate(np.lexsort((pairs.a, pairs.b // KEPT_FINGERS)).tolist()):
        a, b = int(pairs.a[n]), int(pairs.b[n])
        if done % 256 == 0:
            progress("comparing", 0.9 * done / score.size)
        if not (templates[a].empty or templates[b].empty):
            score[n] = compare_templates(method, prepared(a), prepared(b)).similarity
    return score, findings, method
