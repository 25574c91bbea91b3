"""Specks on the skin: dark ones as dust makes them, bright ones as the scales of dry skin do.

A speck is dark, or bright, under every light, and short in every direction. Valleys, wrinkles, hairs and scars are
long in one direction; shading and glare change from light to light; pores are too small and too weak to count much.
Everything is measured on a copy of one scale, 12 px/mm, so that finer cameras see no other specks; lines are laid over
it at twice that scale, so that a thin hair does not fall into beads.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.finger.regions import blur, bounding_box, depth_inside, reduce_image, reduce_mask
from splitknit.model import BoolArray, FloatArray

DIRECTIONS = 16
_FINER = 2
_SMOOTH_MM = 0.04
"""Sigma of a Gaussian before lines are laid: pixels of the copy leave no steps."""
_LEVEL_MM = 0.3
"""Brightness is relative to its surroundings, smoothed by a Gaussian of this sigma."""
_EDGE_MM = 1.5
"""What is nearer to the outline is not looked at: skin is seen at a slant there."""


@dataclass(frozen=True, slots=True)
class SpeckSettings:
    """What counts as a speck, and how much of the finger they may cover."""

    px_per_mm: float = 12.0
    """Scale of the copy on which specks are sought; coarser images are not measured."""
    dark_mm: float = 0.35
    """Dark marks that are longer in any direction are valleys, wrinkles or hairs."""
    darker: float = 0.08
    """How much darker than what surrounds it a pixel of a dark speck is."""
    most_dark: float = 0.002
    """Share of the finger that dark specks may cover."""
    bright_mm: float = 0.5
    """Bright marks that are longer in any direction are ridges."""
    brighter: float = 0.08
    """How much brighter than what surrounds it a pixel of a bright speck is."""
    most_bright: float = 0.005
    """Share of the finger that bright specks may cover."""

    def __post_init__(self) -> None:
        for name in ("px_per_mm", "dark_mm", "bright_mm"):
            require(getattr(self, name) > 0, f"quality.specks.{name} must be positive.")
        for name in ("darker", "brighter", "most_dark", "most_bright"):
            value = getattr(self, name)
            require(0 < value < 1, f"quality.specks.{name} must lie between 0 and 1, but it is {value}.")


def speck_shares(
    stack: FloatArray, mask: BoolArray, px_per_mm: float, settings: SpeckSettings | None = None
) -> tuple[float | None, float | None]:
    """Measure how much of the finger dark and bright specks cover.

    Parameters
    ----------
    stack : (L, H, W) float32 linear grey
    mask : (H, W) bool
        The finger.
    px_per_mm : float
        Of the stack.
    settings : SpeckSettings, optional

    Returns
    -------
    dark, bright : float in [0, 1]
        Shares of the finger but for its edge; None where the images are coarser than `settings.px_per_mm` (by more than
        a twentieth).

    Notes
    -----
    Every image is divided by its own surroundings. A pixel counts as dark by the mean of its brighter half of the
    images, as bright by that of its darker half. Closing by a straight line fills every dark mark that does not hold
    the line; the smallest of the closings in all directions fills those that hold none of them. Bright marks are
    found the same way with openings.

    References
    ----------
    Soille, P. and Talbot, H., "Directional morphological filtering", IEEE PAMI 23(11), 2001.
    """
    settings = settings or SpeckSettings()
    if px_per_mm < 0.95 * settings.px_per_mm:
        return None, None
    scale = min(1.0, settings.px_per_mm / px_per_mm)
    px = px_per_mm * scale
    inside = reduce_mask(mask, scale) > 0.99
    depth = depth_inside(inside)
    core = depth > min(_EDGE_MM * px, 0.4 * float(depth.max()))
    if not core.any():
        return None, None
    box = bounding_box(inside)
    core = core[box]
    images = np.sort(np.stack([_relative(reduce_image(image, scale)[box], core, px) for image in stack]), axis=0)
    half = max(1, len(images) // 2)
    lit, dim = _finer(images[-half:].mean(axis=0), px), _finer(images[:half].mean(axis=0), px)
    core = np.repeat(np.repeat(core, _FINER, axis=0), _FINER, axis=1)
    filled = short_marks_filled(lit, settings.dark_mm * px * _FINER)
    levelled = -short_marks_filled(-dim, settings.bright_mm * px * _FINER)
    dark = lit[core] < (1.0 - settings.darker) * filled[core]
    bright = dim[core] > (1.0 + settings.brighter) * levelled[core]
    return float(dark.mean()), float(bright.mean())


def short_marks_filled(image: NDArray[np.float32], length_px: float) -> NDArray[np.float32]:
    """Fill the dark marks of an (H, W) image that hold no straight line of `length_px` in any direction."""
    closings = (cv2.morphologyEx(image, cv2.MORPH_CLOSE, line) for line in _lines(length_px))
    return np.asarray(np.minimum.reduce(list(closings)), dtype=np.float32)


def _lines(length_px: float) -> list[NDArray[np.uint8]]:
    """Straight lines through the middle of a small square, in all directions."""
    reach = int(np.ceil(0.5 * length_px))
    along = np.linspace(-0.5 * length_px, 0.5 * length_px, 4 * reach + 1)
    lines = []
    for angle in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        line = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
        rows, columns = np.rint(reach - along * np.sin(angle)), np.rint(reach + along * np.cos(angle))
        line[rows.astype(np.intp), columns.astype(np.intp)] = 1
        lines.append(line)
    return lines


def _finer(image: NDArray[np.float32], px: float) -> NDArray[np.float32]:
    large = cv2.resize(image, None, fx=_FINER, fy=_FINER, interpolation=cv2.INTER_LINEAR)
    return blur(np.asarray(large, dtype=np.float32), _SMOOTH_MM * px * _FINER)


def _relative(image: NDArray[np.float32], core: BoolArray, px: float) -> NDArray[np.float32]:
    """Brightness over that of the surroundings."""
    wide = blur(image, _LEVEL_MM * px)
    least = np.float32(0.05 * max(float(np.median(wide[core])), 1e-12))
    return np.asarray(image / np.maximum(wide, least), dtype=np.float32)
