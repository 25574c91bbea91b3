"""Gains of LEDs and the surface they light, told apart: the best surface for given gains, patterns that show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, check_stack, require

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DriftSettings:
    """How gains are found and judged."""

    limit_percent: float = 3.0
    """An LED has drifted if it departs by more."""
    most_pixels: int = 5_000
    """Pixels that are looked at, on a regular grid."""
    dark_share: float = 0.15
    """An image shadows a pixel if it is darker than this share of the pixel's median image."""
    robust_sigmas: float = 2.0
    """Residuals beyond this many deviations count less and less (Cauchy's weights): gloss, soft shadows."""
    least_information: float = 0.2
    """Patterns of gains that keep less of their information are left out."""
    block_px: int = 24
    """Standard errors take squares of this side as independent of each other, not pixels: what is not matt about a
    surface is alike from pixel to pixel."""
    least_explained: float = 0.6
    """A single LED is named if it explains this share of the departure."""
    rounds: int = 15
    """Of the iteration."""

    def __post_init__(self) -> None:
        require(self.limit_percent > 0 and self.robust_sigmas > 0, "drift: limits must be positive.")
        require(self.most_pixels >= 100 and self.block_px >= 1, "drift.most_pixels must be at least 100.")
        require(0 <= self.dark_share < 1 and 0 <= self.least_information < 1, "drift: shares must lie in [0, 1).")
        require(self.rounds >= 1, "drift.rounds must be at least 1.")


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Pixels that are looked at."""

    light: Array
    """(L, P), mean one a pixel."""
    vectors: Array
    """(P, L, D): D = 3, or 1 where the normals are known."""
    lit: NDArray[np.bool_]
    """(L, P)."""
    block: NDArray[np.intp]
    """(P,) number of the square that a pixel lies in."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceState:
    """Surface and information at some gains."""

    matt: Array
    """(P, L) l . b."""
    residual: Array
    """(P, L)."""
    score: Array
    """(P, L) weighted residual times g l . b: derivative by relative gains."""
    information: Array
    """(L, L)."""
    known: Array
    """(L,) diagonal of the information if the surface were known."""


def drift_samples(stack: Any, light_vectors: Any, mask: Any, normals: Any, settings: DriftSettings) -> Samples:
    """Choose pixels that enough LEDs light; see :func:`splitknit.calibration.drift.led_drift`."""
    images = check_stack(stack, least=5)
    count, height, width = images.shape
    inside = check_mask(mask, (height, width))
    vectors = np.asarray(light_vectors, dtype=np.float64)
    require(
        vectors.shape in ((count, 3), (count, 3, height, width)),
        f"light_vectors must have the shape ({count}, 3) or ({count}, 3, {height}, {width}), but it has "
        f"{vectors.shape}.",
    )
    step = max(1, int(np.sqrt(inside.sum() / settings.most_pixels)))
    rows, columns = np.nonzero(inside[::step, ::step])
    rows, columns = rows * step, columns * step
    light = images[:, rows, columns].astype(np.float64)
    lit = light > np.maximum(settings.dark_share * np.median(light, axis=0), 1e-12)
    good = lit.sum(axis=0) >= 5
    require(
        int(good.sum()) >= 100,
        f"only {int(good.sum())} pixels are lit by five LEDs or more; the LEDs' brightness cannot be told from them.",
    )
    rows, columns = rows[good], columns[good]
    light, lit = light[:, good], lit[:, good]
    light = light / np.where(lit, light, 0.0).sum(axis=0) * lit.sum(axis=0)
    if vectors.ndim == 2:
        own = np.broadcast_to(vectors, (len(rows), count, 3))
    else:
        own = vectors[:, :, rows, columns].transpose(2, 0, 1)
    own = own / float(np.linalg.norm(own, axis=2).mean())
    if normals is not None:
        surface = np.asarray(normals, dtype=np.float64)
        require(surface.shape == (height, width, 3), f"normals must have the shape ({height}, {width}, 3).")
        own = np.maximum(np.einsum("pld,pd->pl", own, surface[rows, columns]), 0.0)[..., None]
    side = settings.block_px
    block = rows // side * (width // side + 1) + columns // side
    return Samples(light, np.ascontiguousarray(own), lit, np.unique(block, return_inverse=True)[1])


def project_surface(samples: Samples, gain: Array, weight: Array) -> SurfaceState:
    """Best surface of every pixel, and what it leaves."""
    scaled = samples.vectors * gain[None, :, None]  # (P, L, D)
    trust = weight.T
    weighted = scaled * trust[..., None]
    normal = np.einsum("pld,ple->pde", weighted, scaled)
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(normal.shape[1])
    inverse = np.linalg.inv(normal)
    surface = np.einsum("pde,ple,pl->pd", inverse, weighted, samples.light.T)
    predicted = np.einsum("pld,pd->pl", scaled, surface)
    residual = samples.light.T - predicted
    lean = weighted * predicted[..., None]  # (P, L, D)
    information = np.diag((predicted**2 * trust).sum(axis=0)) - np.einsum("pld,pde,pme->lm", lean, inverse, lean)
    return SurfaceState(
        predicted, residual, predicted * trust * residual, information, (predicted**2 * trust).sum(axis=0)
    )


def robust_weights(samples: Samples, state: SurfaceState, settings: DriftSettings) -> Array:
    """(L, P) Cauchy's weights by the residuals, as long as an image lights the pixel."""
    lit = samples.lit.T
    scale = robust_deviation(state.residual[lit])
    return np.asarray((lit / (1 + (state.residual / (settings.robust_sigmas * scale)) ** 2)).T)


def robust_deviation(residual: Array) -> float:
    """Standard deviation by the median, never zero."""
    return max(1.4826 * float(np.median(np.abs(residual))), 1e-6)


def gain_patterns(state: SurfaceState) -> tuple[Array, Array]:
    """Eigenpatterns of relative gains in the rows of (L, L), and the share of information that each keeps, ascending.

    Patterns p obey M p = share M_0 p and p^T M_0 p = 1.
    """
    root = 1.0 / np.sqrt(np.maximum(state.known, 1e-12 * float(state.known.max())))
    shares, vectors = np.linalg.eigh(root[:, None] * state.information * root[None, :])
    return (vectors * root[:, None]).T, np.clip(shares, 0.0, 1.0)


def gain_solver(patterns: Array, shares: Array, settings: DriftSettings) -> Array:
    """(L, L) from the score to relative gains, what cannot be told left as it is."""
    kept = shares >= settings.least_information
    return np.asarray(patterns[kept].T @ (patterns[kept] / shares[kept, None]))
