"""Latent numbers of a finger from a partly seen ridge field: a factor model.

A field x (channels on a grid, D numbers) of a finger is taken as x = mean + loading z + noise, with K latent numbers z
of the finger (standard normal over fingers) and noise of each number that differs between impressions (deformation,
what is left of the alignment). Where nothing was seen, the noise is infinite. The posterior mean of z is what a code
keeps: it does not depend on which part was seen, but for being less certain.

References
----------
Rubin and Thayer 1982, EM algorithms for ML factor analysis (the model); Prince and Elder 2007, Probabilistic linear
discriminant analysis for inferences about identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray


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
