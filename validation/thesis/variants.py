"""The same scores judged in several ways: gate, sessions, roll, partial views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from trials import Pairs, Table, Trial, Values, scores_of

from splitknit_match.evaluation.protocol import average_sessions
from splitknit_match.evaluation.scores import Scores

GATE = 0.9
FINGER_LIMIT_DEG = 15.0
"""A finger is discarded if its roll differs by more between any two of its sessions."""
PAIR_LIMIT_DEG = 10.0
"""A genuine comparison is discarded if its two rolls differ by more."""


SIMILAR_FRACTION = 0.75
"""Comparisons of a pair of two fingers over those of one finger with itself, at least, for averages
to be given."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One way of judging."""

    gate: str
    """``none``: all pairs are compared. ``gate``: pairs that overlap by less than 0.9 are rejected,
    as the thesis does. ``passing``: likewise, and of the impostor pairs only those count that pass
    in every case of the table."""
    sessions: str
    """``single``: every comparison of two captures. ``averaged``: the mean over pairs of sessions,
    as the thesis."""
    kept: str
    """``all``; ``fingers``: without fingers whose roll differs; ``pairs``: without such genuine
    comparisons; ``whole``: without comparisons with a partial view; ``printed``: of fingers with
    the ridges of a real print, impostor pairs where one of the two has them; ``drawn``: the
    others."""


VARIANTS = tuple(
    Variant(gate, *rest)
    for gate, rest in product(
        ("none", "gate", "passing"),
        (
            *product(("single", "averaged"), ("all", "whole")),
            ("single", "pairs"),
            ("averaged", "fingers"),
        ),
    )
) + tuple(Variant("none", "single", kept) for kept in ("printed", "drawn"))
THESIS = Variant("gate", "averaged", "all")
GATED = Variant("gate", "single", "all")
PLAIN = Variant("none", "single", "all")
PASSING = Variant("passing", "single", "all")
WHOLE = Variant("none", "single", "whole")
THESIS_WHOLE = Variant("gate", "averaged", "whole")


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """The truth of the captures on each comparison."""

    roll_difference_deg: Values
    """(N,) of the two captures."""
    discarded: NDArray[np.bool_]
    """(N,) comparisons with a finger that the rule for fingers discards."""
    partial: NDArray[np.bool_]
    """(N,) comparisons with a partial view."""
    printed: NDArray[np.bool_]
    """(N,) comparisons with a finger that has the ridges of a real print."""


def known_of(pairs: Pairs, truth: Mapping[str, Mapping[str, Any]]) -> Known:
    """Apply the rule for fingers; `truth` is ``impression.json`` by capture."""
    captures = pairs.captures
    rolls = np.array(
        [float(truth.get(str(name), {}).get("roll_deg", np.nan)) for name in captures.names]
    )
    partial, printed = (
        np.array([bool(truth.get(str(name), {}).get(key, False)) for name in captures.names])
        for key in ("partial", "print")
    )
    sides = pairs.of_both(rolls)
    roll_difference = np.abs(sides[:, 0] - sides[:, 1])
    gone = [
        name
        for name, spread in spreads(captures.finger, rolls).items()
        if spread > FINGER_LIMIT_DEG
    ]
    out = np.isin(captures.finger, gone)
    either = [failed[pairs.a] | failed[pairs.b] for failed in (out, partial, printed)]
    return Known(roll_difference, *either)


def spreads(finger: NDArray[np.str_], rolls: Values) -> dict[str, float]:
    """Largest difference between two sessions, by finger."""
    return {
        str(name): float(np.nanmax(of_one) - np.nanmin(of_one))
        for name in np.unique(finger)
        if np.isfinite(of_one := rolls[finger == name]).any()
    }


def refused_by_gate(table: Table) -> dict[str, dict[str, int]]:
    """By case: genuine comparisons whose masks overlap too little, and fingers that have one."""
    pairs = table.pairs
    fingers, finger = np.unique(pairs.captures.finger[pairs.a], return_inverse=True)
    counts = {}
    for trial in table.trials:
        if trial.ratio is None:
            continue
        refused = pairs.genuine & (np.nan_to_num(trial.ratio, nan=1.0) < GATE)
        counts[trial.case] = {
            "fingers": fingers.size,
            "fingers_refused": int(np.unique(finger[refused]).size),
            "pairs": int(pairs.genuine.sum()),
            "pairs_refused": int(refused.sum()),
        }
    return counts


def passing_everywhere(table: Table) -> NDArray[np.bool_]:
    """(N,) comparisons whose masks overlap enough in every case of a table; empty without
    overlaps."""
    passing = np.ones(table.pairs.a.shape, dtype=np.bool_)
    for trial in table.trials:
        if trial.ratio is not None:
            passing &= np.nan_to_num(trial.ratio) >= GATE
    return passing


def judged(
    pairs: Pairs, trial: Trial, variant: Variant, known: Known, passing: NDArray[np.bool_]
) -> Scores | None:
    """Scores of a trial in one way; None where it cannot be (no overlaps known, or a class is
    empty)."""
    similarity = trial.similarity
    if variant.gate != "none":
        if trial.ratio is None:
            return None
        floor = (
            np.full(similarity.shape, np.nanmin(similarity)) if trial.gated is None else trial.gated
        )
        similarity = np.where(trial.ratio < GATE, floor, similarity)
    genuine = pairs.genuine
    kept = (
        genuine | passing if variant.gate == "passing" else np.ones(genuine.shape, dtype=np.bool_)
    )
    if variant.kept == "fingers":
        kept &= ~known.discarded
    elif variant.kept == "pairs":
        kept &= ~(genuine & (known.roll_difference_deg > PAIR_LIMIT_DEG))
    elif variant.kept == "whole":
        kept &= ~known.partial
    elif variant.kept in ("printed", "drawn"):
        kept &= known.printed == (variant.kept == "printed") if known.printed.any() else False
    compared = np.isfinite(similarity)
    if not (kept & compared & genuine).any() or not (kept & compared & ~genuine).any():
        return None
    if variant.sessions == "averaged":
        if not averages_agree(pairs):
            return None
        return average_sessions(scores_of(pairs.taken(kept), similarity[kept], trial.name))
    return scores_of(pairs.taken(kept), similarity[kept], trial.name)


def averages_agree(pairs: Pairs) -> bool:
    """Whether a pair of two fingers was compared in about as many pairs of sessions as one finger
    with itself.

    A mean over one or two comparisons scatters more than one over six: where single comparisons of
    impostors were drawn instead of pairs of fingers, averaged scores of both kinds cannot be judged
    by one threshold.
    """
    finger = np.unique(pairs.captures.finger, return_inverse=True)[1]
    key = finger[pairs.a] * pairs.captures.names.size + finger[pairs.b]
    genuine = pairs.genuine
    genuine_share, impostor_share = (
        np.sum(side) / max(1, np.unique(key[side]).size) for side in (genuine, ~genuine)
    )
    return bool(impostor_share >= SIMILAR_FRACTION * genuine_share)
