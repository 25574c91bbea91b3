"""Weighted integration by a sparse direct solver in double precision: what `poisson` must reach."""

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

FLOOR = 1e-3
"""Smaller weights are raised to this, and their slopes are not used."""


def edges_of(slopes, weights, mask):
    """First and second pixel of every edge, its weight, and the difference of height that its
    slopes predict."""
    index, floored = np.full(mask.shape, -1), np.maximum(weights, np.float32(FLOOR)).astype(float)
    index[mask] = np.arange(mask.sum())
    used, parts = (weights > FLOOR).astype(float), []
    for axis, slope in ((1, slopes[0]), (0, -slopes[1])):
        first = [slice(None, -1) if k == axis else slice(None) for k in range(2)]
        second = [slice(1, None) if k == axis else slice(None) for k in range(2)]
        first, second = tuple(first), tuple(second)
        both = mask[first] & mask[second]
        weight = 0.5 * (floored[first] + floored[second])[both]
        count = used[first] + used[second]
        target = (used[first] * slope[first] + used[second] * slope[second]) / np.maximum(count, 1)
        parts.append((index[first][both], index[second][both], weight, target[both]))
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def solved(slopes, weights, mask):
    """Heights of the pixels of a mask, the differences along edges, and the weights and targets of
    these."""
    first, second, weight, target = edges_of(slopes, weights, mask)
    count, edge = int(mask.sum()), np.arange(len(first))
    ends = np.tile(edge, 2), np.concatenate([first, second])
    operator = scipy.sparse.csr_matrix(
        (np.repeat([-1.0, 1.0], len(edge)), ends), shape=(len(edge), count)
    )
    normal = operator.T @ scipy.sparse.diags(weight) @ operator
    ground = 1e-12 * max(float(normal.diagonal().mean()), 1e-9)
    factors = scipy.sparse.linalg.splu(
        (normal + ground * scipy.sparse.identity(count)).tocsc(),
        "MMD_AT_PLUS_A",
        options={"SymmetricMode": True},
    )
    best = factors.solve(operator.T @ (weight * target))
    best += factors.solve(operator.T @ (weight * (target - operator @ best)))
    return best, operator, weight, target
