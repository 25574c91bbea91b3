"""Figures of one replicate from the weights of its cells: what :mod:`splitknit.evaluation.rates` does with scores."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.evaluation.cells import Cells
from splitknit.evaluation.rates import SLACK

Row = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Layout:
    """Which number of a replicate's row is what."""

    targets: tuple[float, ...]
    """FARs at which the GAR is asked."""
    curve: tuple[float, ...] = ()
    """FARs of the band around the ROC."""

    @property
    def names(self) -> list[str]:
        """``eer``, ``auc``, ``d_prime``, ``gar@...``; with ``_made`` failures left out; ``curve@...``."""
        gars = [f"gar@{target:g}" for target in self.targets]
        made = [f"{name}_made" for name in ("eer", *gars)]
        return ["eer", *gars, *made, "auc", "d_prime", *(f"curve@{far!r}" for far in self.curve)]


def figures_of(cells: Cells, genuine: Row, impostor: Row, layout: Layout) -> Row:
    """One row of figures, in the order of `layout.names`, from the weights (count + 1,) of the cells.

    All are NaN where a class weighs nothing, d' also where no score varies.
    """
    g, i = genuine[:-1], impostor[:-1]
    made_g, made_i = float(g.sum()), float(i.sum())
    if made_g <= 0 or made_i <= 0:
        return np.full(len(layout.names), np.nan)
    accepted_g, accepted_i = (np.concatenate([[0.0], np.cumsum(side)]) for side in (g, i))
    all_g, all_i = made_g + float(genuine[-1]), made_i + float(impostor[-1])

    def gars(fars: tuple[float, ...], total_g: float, total_i: float) -> list[float]:
        k = np.searchsorted(accepted_i, np.array(fars) * total_i * (1 + SLACK), side="right") - 1
        return [float(value) for value in accepted_g[k] / total_g]

    eers = [
        _equal_error(accepted_g / total_g, accepted_i / total_i, cells.crowded)
        for total_g, total_i in ((all_g, all_i), (made_g, made_i))
    ]
    area = _dot(g, made_i - accepted_i[1:] + 0.5 * i) / (made_g * made_i)
    return np.array(
        [
            eers[0],
            *gars(layout.targets, all_g, all_i),
            eers[1],
            *gars(layout.targets, made_g, made_i),
            area,
            _d_prime(cells, g / made_g, i / made_i),
            *gars(layout.curve, all_g, all_i),
        ]
    )


def _equal_error(gar: Row, far: Row, crowded: NDArray[np.bool_]) -> float:
    """(FAR + FRR) / 2 beside the crossing, whichever sum is smaller; (count + 1,) rates, rising."""
    both = gar + far
    k1 = int(np.searchsorted(both, 1.0 - SLACK))  # the highest threshold with FRR <= FAR
    if k1 == both.size:
        return float(far[-1] + 1.0 - gar[-1]) / 2
    if k1 == 0 or both[k1] <= 1.0 + SLACK:
        return float(far[k1] + 1.0 - gar[k1]) / 2
    if crowded[k1 - 1]:  # the crossing lies among many impostors of one cell, where FRR stands still
        return float(1.0 - gar[k1])
    sums = far[k1] + 1.0 - gar[k1], far[k1 - 1] + 1.0 - gar[k1 - 1]
    return float(min(sums)) / 2


def _d_prime(cells: Cells, genuine: Row, impostor: Row) -> float:
    means, spreads = [], []
    for share, (mean, variance) in zip((genuine, impostor), cells.moments, strict=True):
        means.append(_dot(share, mean))
        spreads.append(_dot(share, variance + (mean - means[-1]) ** 2))
    spread = float(np.sqrt(sum(spreads) / 2))
    return (means[0] - means[1]) / spread if spread > 1e-9 else float("nan")


def _dot(a: Row, b: Row) -> float:
    """Sum of products, in one thread: the same for any number of cores, and threads cost more than they save here."""
    return float(np.einsum("c,c->", a, b))
