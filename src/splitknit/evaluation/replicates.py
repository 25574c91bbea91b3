"""Resampling: how often each comparison counts in a replicate of the bootstrap.

``plain``: comparisons are drawn, genuine and impostor ones apart. Right only if they are independent, which they are
not where a finger takes part in several.

``finger``, ``subject``: fingers (or subjects) are drawn with replacement, and a comparison counts as often as the
product of how often its finger, or each of its two fingers, was drawn: w_a for a genuine pair of finger a, w_a w_b for
an impostor pair of a and b. (Two fingers of one subject, drawn by subject, count w_s: they come along together.)
Impostor scores that share either finger thus rise and fall together. Copies of one finger in a replicate are not
compared with each other: there is no score for it.

References
----------
T. A. B. Snijders, S. P. Borgatti, "Non-parametric standard errors and tests for network statistics", Connections
22(2), 1999 (the vertex bootstrap). A. B. Owen, "The pigeonhole bootstrap", Annals of Applied Statistics 1(2), 2007
(two-way; the variance is right or a little large). R. M. Bolle, N. K. Ratha, S. Pankanti, "Error analysis of pattern
recognition systems - the subsets bootstrap", Computer Vision and Image Understanding 93(1), 2004 (one-way: by one
finger of a pair, which is too narrow for impostors). N. Poh, A. Martin, S. Bengio, "Performance generalization in
biometric authentication using joint user-specific and sample bootstraps", IEEE PAMI 29(3), 2007.
R. Fogliato, P. Patil, P. Perona, "Confidence intervals for error rates in 1:1 matching tasks", International Journal
of Computer Vision, 2024 (a review: bootstraps cover too often or too rarely where errors are few).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from splitknit.evaluation.cells import Cells
from splitknit.evaluation.scores import Ids

Weights = NDArray[np.float64]
BATCH = 1_000_000
"""Numbers held at a time for one side, about."""


@dataclass(frozen=True, slots=True, eq=False)
class Units:
    """What is drawn, for both sides: each comparison belongs to a unit."""

    genuine: NDArray[np.int64]
    """(N,) unit of each genuine comparison"""
    impostor: NDArray[np.int64]
    """(M,)"""
    clusters: int
    """Things that are drawn: comparisons of the smaller side, fingers or subjects."""
    sizes: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None
    """Plain: comparisons in each unit, of both sides."""
    cluster: NDArray[np.int64] | None = None
    """Clustered: (U,) cluster of each unit of genuine comparisons."""
    pairs: NDArray[np.int64] | None = None
    """Clustered: (V, 2) clusters of each unit of impostor comparisons."""

    def draw(self, generator: np.random.Generator, count: int) -> tuple[Weights, Weights]:
        """How often each unit counts in `count` replicates: (U, count) and (V, count)."""
        if self.sizes is not None:
            genuine, impostor = (_multinomial(generator, sizes, count) for sizes in self.sizes)
            return genuine, impostor
        assert self.cluster is not None and self.pairs is not None
        drawn = _multinomial(generator, np.ones(self.clusters, dtype=np.int64), count)
        a, b = self.pairs.T
        return drawn[self.cluster], np.where((a == b)[:, None], drawn[a], drawn[a] * drawn[b])

    def batch(self) -> int:
        """Replicates at a time."""
        largest = max(int(self.genuine.max(initial=0)), int(self.impostor.max(initial=0))) + 1
        return max(1, min(32, BATCH // largest))


def plain_units(cells: Cells) -> Units:
    """Comparisons are drawn; those of one cell are alike and need not be told apart."""
    sizes = (
        np.bincount(cells.genuine, minlength=cells.count + 1),
        np.bincount(cells.impostor, minlength=cells.count + 1),
    )
    return Units(cells.genuine, cells.impostor, min(cells.genuine.size, cells.impostor.size), sizes)


def pair_units(genuine: int, impostor: int) -> Units:
    """Comparisons are drawn one by one, so that several systems can be given the same ones."""
    sizes = (np.ones(genuine, dtype=np.int64), np.ones(impostor, dtype=np.int64))
    return Units(np.arange(genuine), np.arange(impostor), min(genuine, impostor), sizes)


def cluster_units(label: NDArray[np.bool_], ids: Ids) -> Units:
    """Fingers, or subjects, are drawn."""
    _, codes = np.unique(ids.codes, return_inverse=True)
    codes = codes.reshape(ids.codes.shape)
    clusters = int(codes.max()) + 1
    cluster, genuine = np.unique(codes[label, 0], return_inverse=True)
    low, high = codes[~label].min(axis=1), codes[~label].max(axis=1)
    keys, impostor = np.unique(low * clusters + high, return_inverse=True)
    pairs = np.stack([keys // clusters, keys % clusters], axis=1)
    return Units(genuine.ravel(), impostor.ravel(), clusters, None, cluster, pairs)


def cell_weights(
    units: Units, systems: list[Cells], replicates: int, seed: int
) -> Iterator[list[tuple[Weights, Weights]]]:
    """Draw replicates and give, for each system, the weight of its cells: (count + 1, R) of both sides, in batches.

    All systems get the same draws. The last cell holds the failures.
    """
    generator = np.random.default_rng(seed)
    gather = [
        (_sums(cells.genuine, units.genuine, cells.count + 1), _sums(cells.impostor, units.impostor, cells.count + 1))
        for cells in systems
    ]
    size = min(units.batch(), max(1, BATCH // (max(cells.count for cells in systems) + 1)))
    for start in range(0, replicates, size):
        genuine, impostor = units.draw(generator, min(size, replicates - start))
        yield [(_apply(of_genuine, genuine), _apply(of_impostor, impostor)) for of_genuine, of_impostor in gather]


def _sums(cell: NDArray[np.int64], unit: NDArray[np.int64], cells: int) -> csr_array | None:
    """(cells, units) matrix of how many comparisons of a unit lie in a cell; None where cells are the units."""
    if cell is unit:
        return None
    ones = np.ones(cell.size, dtype=np.float64)
    return csr_array((ones, (cell, unit)), shape=(cells, int(unit.max()) + 1))


def _apply(matrix: csr_array | None, weights: Weights) -> Weights:
    return weights if matrix is None else np.asarray(matrix @ weights)


def _multinomial(generator: np.random.Generator, sizes: NDArray[np.int64], count: int) -> Weights:
    """(units, count): as many draws as there are comparisons, each unit as likely as it is large."""
    total, units = int(sizes.sum()), sizes.size
    drawn = np.empty((units, count), dtype=np.float64)
    if total > 4 * units:
        drawn[:] = generator.multinomial(total, sizes / total, size=count).T
        return drawn
    member = np.repeat(np.arange(units), sizes)
    for k in range(count):
        drawn[:, k] = np.bincount(member[generator.integers(0, total, total)], minlength=units)
    return drawn
