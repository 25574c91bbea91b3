"""Codes of fixed length: what a search through very many fingers compares first.

A gallery finger has one code. A probe is coded in many variants, turned and shifted, because neither the upright
direction nor the place of the tip is known well; its similarity to a gallery finger is the best variant's inner
product.
The numbers behind the code (a factor model of ridge fields) were learned on simulated fingers: ``code_model.npz``, and
its card ``code_model.json`` beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.matching.code_field import ridge_field, sampled
from splitknit.matching.template import Template
from splitknit.model import FloatArray
from splitknit.settings import Checked, Limits, check_fields

CODE_VERSION = 1
"""Of the code: codes of different versions cannot be compared. It rises with every change of field or model."""
SCALE = 360.0
"""A code is the direction of the latent numbers times this, rounded; longer numbers than 127 are cut (hardly any)."""
_FILE = Path(__file__).with_name("code_model.npz")


_TURN_STEP_DEG = 5.0
"""Between two turns."""
_STEP_MM = 1.0
"""Between two shifts."""


@dataclass(frozen=True, slots=True)
class ProbeSettings(Checked):
    """The variants of a probe."""

    turn_deg: Annotated[float, Limits(0)] = 10.0
    """Largest turn."""
    right_mm: Annotated[float, Limits(0)] = 1.0
    """Largest shift across."""
    down_mm: Annotated[float, Limits(0)] = 1.0
    """Largest shift along."""

    def __post_init__(self) -> None:
        check_fields(self)
        require(self.count <= 10_000, f"a probe would have {self.count} variants; at most 10000 go.")

    @property
    def count(self) -> int:
        """Variants."""
        return int(np.prod([len(_steps(*pair)) for pair in self._pairs()]))

    def variants(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """(V,) turns in radians, shifts to the right and shifts down in millimetres."""
        turns, right, down = np.meshgrid(*(_steps(*pair) for pair in self._pairs()), indexing="ij")
        return np.deg2rad(turns.ravel()), right.ravel(), down.ravel()

    def _pairs(self) -> tuple[tuple[float, float], ...]:
        return (
            (self.turn_deg, _TURN_STEP_DEG),
            (self.right_mm, _STEP_MM),
            (self.down_mm, _STEP_MM),
        )


def _steps(limit: float, step: float) -> NDArray[np.float64]:
    count = int(np.floor(limit / step + 1e-9))
    return step * np.arange(-count, count + 1, dtype=np.float64)


@lru_cache(maxsize=1)
def code_model() -> FactorModel:
    """Read the model that is shipped (once)."""
    with np.load(_FILE, allow_pickle=False) as arrays:
        require(int(arrays["version"]) == CODE_VERSION, f"{_FILE.name} is of another version; install splitknit again.")
        return FactorModel(*(arrays[name].astype(np.float32) for name in ("mean", "loading", "noise")))


def code_size() -> int:
    """Bytes of a code."""
    return code_model().size


def code_of(template: Template) -> NDArray[np.int8]:
    """Code of a gallery finger.

    Parameters
    ----------
    template : Template

    Returns
    -------
    (K,) int8 with K = :func:`code_size`; zeros for a failure to acquire, which a search never finds. The same template
    gives the same code (of this `CODE_VERSION`); a code says roughly how a finger's ridges run, and should be
    protected like the template.

    References
    ----------
    Cappelli 2011, Fast and accurate fingerprint indexing based on ridge orientation and frequency (what is described);
    Prince and Elder 2007, Probabilistic linear discriminant analysis (how it is reduced).
    """
    if template.empty:
        return np.zeros(code_size(), dtype=np.int8)
    still = np.zeros(1)
    directions = _directions(*sampled(ridge_field(template), still, still, still))[0]
    return np.asarray(np.clip(np.rint(SCALE * directions), -127, 127), dtype=np.int8)


def probe_codes(template: Template, settings: ProbeSettings | None = None) -> FloatArray:
    """(V, K) float32 variants of a probe, so scaled that the product with a finger's own code is about 1.

    Raises
    ------
    BadInput
        If the template is a failure to acquire.
    """
    settings = settings or ProbeSettings()
    require(not template.empty, "the probe is a failure to acquire; lay the finger down again.")
    return _directions(*sampled(ridge_field(template), *settings.variants())) * np.float32(1.0 / SCALE)


def _directions(channels: FloatArray, weights: FloatArray) -> FloatArray:
    """(V, K) unit vectors."""
    found, _ = code_model().posterior(channels, weights)
    return np.asarray(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9), dtype=np.float32)


# Latent numbers of a finger from a partly seen ridge field: a factor model.
#
# A field x (channels on a grid, D numbers) of a finger is taken as x = mean + loading z + noise, with K latent numbers
# z
# of the finger (standard normal over fingers) and noise of each number that differs between impressions (deformation,
# what is left of the alignment). Where nothing was seen, the noise is infinite. The posterior mean of z is what a code
# keeps: it does not depend on which part was seen, but for being less certain.
#
# References
# ----------
# Rubin and Thayer 1982, EM algorithms for ML factor analysis (the model); Prince and Elder 2007, Probabilistic linear
# discriminant analysis for inferences about identity.


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
