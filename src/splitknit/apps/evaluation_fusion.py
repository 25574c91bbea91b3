"""The systems of a report, fused: one system more, and what a reader has to know of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from splitknit.errors import require
from splitknit.evaluation.fusion import Fused, FusionSettings, fuse
from splitknit.evaluation.scores import Scores

_MISSING = {
    "linear": "its weight goes to the others",
    "trained": "it counts as the mean, and that it is missing as a feature of its own",
}


def fused_system(systems: Sequence[Scores], method: str, seed: int) -> tuple[Scores, dict[str, Any], list[str]]:
    """Fuse all systems: their fused scores, facts for ``report.json``, and notes.

    Raises
    ------
    BadInput
        If there is one system only, or as :func:`splitknit.evaluation.fusion.fuse`.
    """
    require(
        len(systems) >= 2, "--fuse needs two systems at least; give several score files, or one with a column system."
    )
    settings = FusionSettings(method=method, seed=seed)
    fused = fuse(systems, settings, name=f"fused, {method}")
    folds = len(set(fused.fold.tolist()) - {-1})
    weights = fused.mean_weights()
    facts = {
        "method": method,
        "systems": list(fused.systems),
        "dealt_by": fused.by,
        "folds": folds,
        "seed": seed,
        "models": len(fused.models),
        "mean_weights": weights,
        "missing": dict(zip(fused.systems, fused.missing, strict=True)),
    }
    return fused.scores, facts, _notes(fused, method, folds, weights)


def _notes(fused: Fused, method: str, folds: int, weights: dict[str, float]) -> list[str]:
    shares = ", ".join(f"{name} {weight:.2f}" for name, weight in weights.items())
    notes = [
        f"'{fused.scores.name}' joins {len(fused.systems)} systems. Each {fused.by} belongs to one of {folds} folds; "
        "every comparison was scored by a model that saw nothing of the folds of its two sides. Mean weights of the "
        f"normalised scores: {shares}."
    ]
    if fused.by == "finger":
        notes.append(
            "Subjects are not named, so that fusion may have learned from other fingers of who it was tested on."
        )
    if any(fused.missing):
        counts = ", ".join(f"{name} {count}" for name, count in zip(fused.systems, fused.missing, strict=True))
        notes.append(f"Missing scores in the fusion ({counts}): where one is missing, {_MISSING[method]}.")
    return notes
