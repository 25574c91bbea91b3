"""Direct and global light from a film in which the shadow of a line or a mesh sweeps over the scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.separation.stacks import (
    DEFAULTS,
    EDGE,
    Separation,
    StackSettings,
    check_contrast,
    check_fraction,
    from_extremes,
    light_stack,
)
from splitknit.separation.states import check_patterns

KINDS = ("line", "mesh")


def occluder(
    sequence: Any,
    kind: str = "line",
    *,
    alpha: float | None = None,
    shadow_percent: float = 0.0,
    patterns: Any = None,
    mask: Any = None,
    settings: StackSettings = DEFAULTS,
) -> Separation:
    """Separate direct from global light by a moving shadow (S. K. Nayar et al. 2006, section 5.1).

    A thin line takes away hardly any of the global light: direct = greatest - least, global = least. A mesh that lets
    the fraction `alpha` of the light through takes the rest of the global light with it in *every* image: global =
    least / alpha.

    Minimum and maximum over noisy images are biased outwards. Two remedies: `shadow_percent`, the fraction of the
    images in which every pixel is surely in full shadow: the median of that many darkest images is its shadow, the
    median of the upper half its light (robust against a passing fly, less biased). Or `patterns`, known or from
    :func:`splitknit.separation.states.estimate_patterns`: the means over a pixel's lit and shadowed images, unbiased.

    `sequence`: (N, H, W) or (N, H, W, C) linear light, black level removed, lamp and camera fixed, or an iterable of
    images, two at least; `kind`: ``line`` or ``mesh``; `alpha`, in (0, 1], is to be given for a mesh; `shadow_percent`:
    0 (plain extremes) to 50; `patterns`: (N, H, W), 1 lit, 0 in the shadow, left out between; `mask`: (H, W) bool.
    Raises BadInput if pixels were never shadowed (fraction and first of them), or the images are unusable.
    """
    require(kind in KINDS, f"kind must be 'line' or 'mesh', but it is '{kind}'.")
    require(kind == "line" or alpha is not None, "a mesh needs alpha, the fraction of the light that passes it.")
    require(0 <= shadow_percent <= 50, f"shadow_percent must lie in [0, 50], but it is {shadow_percent}.")
    fraction = check_fraction(1.0 if alpha is None else alpha, "alpha")
    images = light_stack(sequence, least=2, mask=mask, settings=settings)
    light = images.light
    if patterns is not None:
        states = check_patterns(patterns, images, distinct=False)
        low, high = _mean_where(light, states <= EDGE), _mean_where(light, states >= 1 - EDGE)
    elif shadow_percent == 0:
        low, high = light.min(axis=0), light.max(axis=0)
    else:
        low, high = _robust_extremes(light, shadow_percent)
    words = ("never shadowed (or never lit)", "sweep the occluder over them, or leave them out with a mask")
    check_contrast(low, high, images.mask, settings, words)
    direct, global_ = from_extremes(low, high, fraction, 0.0)
    return Separation(images.shaped(direct), images.shaped(global_))


def _mean_where(light: FloatArray, used: Any) -> FloatArray:
    """Mean (H, W, C) of the images in which `used` (N, H, W) holds."""
    total = np.zeros(light.shape[1:], dtype=np.float64)
    for image, here in zip(light, used, strict=True):
        total += np.where(here[..., None], image, np.float32(0))
    return np.asarray(total / np.maximum(used.sum(axis=0), 1)[..., None], dtype=np.float32)


def _robust_extremes(light: FloatArray, percent: float) -> tuple[FloatArray, FloatArray]:
    """Medians (H, W, C) of the darkest `percent` and of the brighter half of the images."""
    count = len(light)
    darkest = max(1, int(count * percent / 100))
    low = np.empty(light.shape[1:], dtype=np.float32)
    high = np.empty_like(low)
    for row in range(light.shape[1]):
        ordered = np.sort(light[:, row], axis=0)
        low[row] = np.median(ordered[:darkest], axis=0)
        high[row] = np.median(ordered[count // 2 :], axis=0)
    return low, high
