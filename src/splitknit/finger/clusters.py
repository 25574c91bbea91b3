"""Two-class k-means that gives the same answer every time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.model import BoolArray


def two_means(features: NDArray[np.float32], iterations: int = 30) -> tuple[BoolArray, float]:
    """Split feature vectors into two clusters (Lloyd's algorithm, deterministic start).

    The start is the split at the middle of the direction of greatest variance, so no random number is involved.

    Parameters
    ----------
    features : (N, D) float32

    Returns
    -------
    second : (N,) bool, membership of the second cluster
    separation : distance of the two means in units of the pooled standard deviation along the line that joins them

    References
    ----------
    Lloyd, S., "Least squares quantization in PCM", IEEE Trans. Information Theory 28(2), 1982.
    """
    values = features.astype(np.float64)
    centred = values - values.mean(axis=0)
    covariance = np.einsum("ni,nj->ij", centred, centred) / len(values)
    axis = np.linalg.eigh(covariance)[1][:, -1]
    along = np.einsum("ni,i->n", centred, axis)
    low, high = np.percentile(along, [1.0, 99.0])
    second = along > 0.5 * (low + high)
    for _ in range(iterations):
        if not second.any() or second.all():
            return np.asarray(second, dtype=np.bool_), 0.0
        means = values[~second].mean(axis=0), values[second].mean(axis=0)
        axis = means[1] - means[0]
        middle = 0.5 * (means[1] + means[0])
        updated = np.einsum("ni,i->n", values - middle, axis) > 0.0
        if bool((updated == second).all()):
            break
        second = updated
    return np.asarray(second, dtype=np.bool_), _separation(values, second)


def _separation(values: NDArray[np.float64], second: NDArray[np.bool_]) -> float:
    if not second.any() or second.all():
        return 0.0
    first_values, second_values = values[~second], values[second]
    axis = second_values.mean(axis=0) - first_values.mean(axis=0)
    distance = float(np.sqrt(np.sum(axis * axis)))
    if distance == 0.0:
        return 0.0
    axis = axis / distance
    spread = np.einsum("ni,i->n", first_values, axis).var() + np.einsum("ni,i->n", second_values, axis).var()
    return distance / float(np.sqrt(0.5 * spread) + 1e-9)
