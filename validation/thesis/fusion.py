"""Attributes of the thesis's matcher, and minutiae, joined into one score (figure 5.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from trials import ATTRIBUTES, Table, Trial, scores_of

from splitknit.errors import BadInput
from splitknit_match.evaluation.fusion import fuse

OF_THESIS = {"normals + relief": ("normals", "relief"), "all three": ATTRIBUTES}
"""What is joined; the thesis's figure 5.3 has all three, its further figures the first two
apart."""
MINUTIAE_SET = "all three + minutiae"
SETS = {
    **{
        name: tuple(("thesis", attribute) for attribute in chosen)
        for name, chosen in OF_THESIS.items()
    },
    MINUTIAE_SET: (*(("thesis", attribute) for attribute in ATTRIBUTES), ("minutiae", "")),
}


def fused(table: Table, case: str, name: str, seed: int) -> list[Trial]:
    """A set of :data:`SETS` joined in several ways; none where a part is missing.

    ``mean``: of the thesis's scores (5.2) as they are, the plainest "linear combination".
    ``linear``: each part brought to [0, 1] by its least and largest score, then the mean, as the
    figure's "normalised LBP score" may be meant. ``trained``: logistic regression. Both learn from
    other people than those of the comparison: cross-validated by subject.
    """
    parts = [table.trial(case, matcher, attribute) for matcher, attribute in SETS[name]]
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return []
    ways = {}
    if name in OF_THESIS:
        ways["mean"] = known[0].other("", np.mean([part.similarity for part in known], axis=0))
    systems = [scores_of(table.pairs, part.similarity, part.name) for part in known]
    for way in ("linear", "trained"):
        try:
            fused = fuse(systems, "minmax" if way == "linear" else way, seed)
        except BadInput:  # too few people to learn from others
            continue
        ways[way] = replace(known[0], similarity=fused.scores.score, gated=None)
    return [replace(trial, attribute=f"{name}, {way}") for way, trial in ways.items()]
