"""Attributes of the thesis's matcher joined into one score (figure 5.3)."""

from __future__ import annotations

import numpy as np
from trials import ATTRIBUTES, Table, Trial, Values

SETS = {"normals + relief": ("normals", "relief"), "all three": ATTRIBUTES}
"""What is joined; the thesis's figure 5.3 has all three, its further figures the first two apart."""


def linear(table: Table, case: str, chosen: tuple[str, ...]) -> dict[str, Trial]:
    """The thesis's "linear combination", whose weights it does not give, in the two ways that need no training.

    ``mean``: of the scores (5.2) as they are. ``scaled``: each attribute brought to [0, 1] by its least and its
    largest score (without labels), as the figure's "normalised LBP score" may be meant, then the mean.
    """
    parts = [table.trial(case, "thesis", name) for name in chosen]
    known = [part for part in parts if part is not None]
    if len(known) < len(chosen):
        return {}
    scores = np.stack([part.similarity for part in known])
    low, high = (limit[:, None] for limit in (np.nanmin(scores, axis=1), np.nanmax(scores, axis=1)))
    return {
        "mean": known[0].other("", scores.mean(axis=0)),
        "scaled": known[0].other("", _scaled(scores, low, high).mean(axis=0)),
    }


def _scaled(scores: Values, low: Values, high: Values) -> Values:
    return np.asarray((scores - low) / np.maximum(high - low, 1e-12))


def trained(table: Table, case: str, chosen: tuple[str, ...], seed: int) -> dict[str, Trial]:
    """A trained combination, cross-validated by subject."""
    return {}
