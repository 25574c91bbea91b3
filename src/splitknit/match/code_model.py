"""Latent numbers of a finger from a partly seen ridge field: a factor model.

A field x (channels on a grid, D numbers) of a finger is taken as x = mean + loading z + noise, with K latent numbers z
of the finger (standard normal over fingers) and noise of each number that differs between impressions (deformation,
what is left of the alignment). Where nothing was seen, the noise is infinite. The posterior mean of z is what a code
keeps: it does not depend on which part was seen, but for being less certain.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.types import FloatArray


@dataclass(frozen=True, eq=False)
class FactorModel:
    """Mean, loading and noise; of C channels in M cells."""

    mean: FloatArray
    """(C, M)."""
    loading: FloatArray
    """(C, M, K)."""
    noise: FloatArray
    """(C, M) variance."""

    def __post_init__(self) -> None:
        same = self.mean.shape == self.noise.shape == self.loading.shape[:2]
        require(same and self.loading.ndim == 3, "mean, loading and noise of a factor model must have equal shapes.")
        require(bool((self.noise > 0).all()), "the noise of a factor model must be positive.")

    @property
    def size(self) -> int:
        """Latent numbers."""
        return int(self.loading.shape[2])

    @cached_property
    def weighted(self) -> FloatArray:
        """(C M, K) loading over noise."""
        return (self.loading / self.noise[:, :, None]).reshape(-1, self.size)

    @cached_property
    def precision(self) -> FloatArray:
        """(M, K K) what each cell adds to the precision of z."""
        parts = np.einsum("cmi,cmj->mij", self.loading, self.loading / self.noise[:, :, None], optimize=True)
        return np.ascontiguousarray(parts.reshape(parts.shape[0], -1), dtype=np.float32)

    def posterior(self, channels: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Posterior means (N, K) of z and their precisions (N, K, K), for N fields (N, C, M) with weights (N, M)."""
        seen = ((channels - self.mean) * weights[:, None, :]).reshape(len(channels), -1)
        size = self.size
        precisions = (weights @ self.precision).reshape(-1, size, size) + np.eye(size, dtype=np.float32)
        means = np.linalg.solve(precisions, (seen @ self.weighted)[:, :, None])[:, :, 0]
        return np.asarray(means, dtype=np.float32), precisions


def learned(
    channels: FloatArray,
    weights: FloatArray,
    owners: NDArray[np.int64],
    size: int,
    *,
    rounds: int = 12,
    seed: int = 0,
    least_noise: float = 1e-4,
) -> FactorModel:
    """Learn a factor model by expectation maximisation; all impressions of a finger share its z.

    Parameters
    ----------
    channels : (N, C, M) float32
    weights : (N, M) float32
        0 where nothing was seen.
    owners : (N,)
        Number of the finger of each.
    size : K
    rounds : passes
    seed : of the start
    least_noise : variance

    References
    ----------
    Rubin and Thayer 1982, EM algorithms for ML factor analysis; Prince and Elder 2007, Probabilistic linear
    discriminant analysis for inferences about identity.
    """
    fingers, place = np.unique(owners, return_inverse=True)
    count, (_, kinds, cells) = len(fingers), channels.shape
    total = np.maximum(weights.sum(axis=0), 1e-3)
    mean = (channels * weights[:, None, :]).sum(axis=0) / total
    away = (channels - mean) * weights[:, None, :]
    noise = (away**2).sum(axis=0) / total + least_noise
    # what a finger's impressions say together
    seen = np.zeros((count, kinds, cells), dtype=np.float32)
    weight = np.zeros((count, cells), dtype=np.float32)
    np.add.at(seen, place, away)
    np.add.at(weight, place, weights)
    squares = (away * (channels - mean)).sum(axis=0)
    flat = (seen / np.maximum(weight, 1.0)[:, None, :]).reshape(count, -1)
    _, values, axes = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)
    start = (axes[:size].T * (values[:size] / np.sqrt(count))).astype(np.float32)
    if start.shape[1] < size:
        more = np.random.default_rng(seed).standard_normal((start.shape[0], size - start.shape[1]))
        start = np.hstack([start, (1e-2 * more).astype(np.float32)])
    loading = start.reshape(kinds, cells, size)
    noise = 0.3 * noise
    for _ in range(rounds):
        model = FactorModel(mean.astype(np.float32), loading, noise.astype(np.float32))
        precisions = (weight @ model.precision).reshape(-1, size, size) + np.eye(size, dtype=np.float32)
        covariance = np.linalg.inv(precisions)
        z = np.einsum("nij,nj->ni", covariance, seen.reshape(count, -1) @ model.weighted)
        second = (covariance + z[:, :, None] * z[:, None, :]).reshape(count, -1)
        moments = (weight.T @ second).reshape(cells, size, size) + 1e-3 * np.eye(size, dtype=np.float32)
        cross = np.einsum("ncm,nk->mkc", seen, z, optimize=True)
        fitted = np.linalg.solve(moments, cross)
        loading = np.ascontiguousarray(fitted.transpose(2, 0, 1), dtype=np.float32)
        explained = np.einsum("cmk,mkc->cm", loading, cross, optimize=True)
        noise = np.maximum((squares - explained) / total, least_noise)
    return FactorModel(mean.astype(np.float32), loading, noise.astype(np.float32))
