"""Sweat pores: small pits along the crests of the ridges, in a relief, or dark dots on a photograph of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput, BoolArray, FloatArray, blur, check_mask, json_text, require, write_file
from splitknit_match.matching.space_features import on_surface
from splitknit_match.prints.sources import Source

_DIAMETER_MM = 0.13
"""Diameter of a pore (0.06 to 0.25); the filter is a Gaussian of this width at half maximum."""
_ALONG_MM = 0.3
"""Sigma along the ridges over which a ridge without pores is the same."""
_DIRECTION_MM = 0.3
"""Sigma over which the direction of the ridges is found."""
_CONTRAST_MM = 0.5
"""Sigma over which the amplitude of the ridges is measured."""
_CREST = 0.25
"""Height of a crest's sides, in amplitudes: pores lie above."""
_DIRECTIONS = 16
_MAX_PITCH_MM = 0.034
_COARSE_UM = 27.0
_COARSE = (
    "a relief of pixels of {:.0f} um shows fewer pores (33 um: 43 % of simulated ones, 26 um: 52 %); `method` photo "
    "finds 82 %."
)
"""Noted from these pixels on: recall as in docs/experiments/prints.md."""


def find_pores(
    image: FloatArray, mask: BoolArray, pitch_mm: float, crests: FloatArray | None = None, *, least: float = 0.05
) -> NDArray[np.float32]:
    """Find sweat pores by what is left when a ridge is taken for the same along itself.

    The direction of the ridges is that of the structure tensor; along it the image is smoothed, which keeps ridges and
    loses pores. A pore is a minimum of the difference, at a pore's size, on a crest.

    `image`: (H, W) float32, a relief (``ridge_mm``) or a photograph on which pores are dark; `mask`: (H, W) bool;
    `pitch_mm`: side of a pixel, at most 0.034, as a pore has 0.06 to 0.25 mm; `crests`: (H, W) float32, relief whose
    crests hold the pores, where `image` is a photograph; `least`: depth of a pore, in standard deviations of the ridges
    around it. Returns (N, 3) float32: column, row and depth, the deepest first. Raises BadInput if shapes disagree or
    pixels are too large for pores.

    Source: Q. Zhao, D. Zhang, L. Zhang and N. Luo, "Adaptive fingerprint pore modeling and extraction", Pattern
    Recognition 43, 2010 (pores differ from the ridge along its direction); A. K. Jain, Y. Chen and M. Demirkus, "Pores
    and ridges", IEEE Trans. PAMI 29, 2007 (a band-pass at a pore's scale).

    >>> across = np.cos(2 * np.pi * np.arange(200, dtype=np.float32) / 30)[:, None] * np.ones((1, 200), np.float32)
    >>> pit = np.exp(-((np.arange(200) - 100) ** 2 + (np.arange(200)[:, None] - 90) ** 2) / 18).astype(np.float32)
    >>> find_pores(0.03 * (across - pit), np.ones((200, 200), bool), 0.015)[:, :2].tolist()
    [[100.0, 90.0]]
    """
    relief = image if crests is None else crests
    require(image.ndim == 2 and relief.shape == image.shape, "the image and its crests must be of one shape (H, W).")
    mask = check_mask(mask, (image.shape[0], image.shape[1]))
    require(
        0 < pitch_mm <= _MAX_PITCH_MM,
        f"pores need pixels of at most {1000 * _MAX_PITCH_MM:g} um, but these have {1000 * pitch_mm:.0f}.",
    )
    weight = blur(mask.astype(np.float32), _CONTRAST_MM / pitch_mm) + np.float32(1e-6)
    ridges, values = (_ridges(plane, mask, weight, pitch_mm) for plane in (relief, image))
    turn = _directions(ridges, pitch_mm)
    crest = _along(ridges, turn, pitch_mm)
    rest = blur(values - (crest if crests is None else _along(values, turn, pitch_mm)), _DIAMETER_MM / 2.355 / pitch_mm)
    depth = -rest
    reach = 2 * round(_DIAMETER_MM / pitch_mm / 2) + 1
    peak = depth >= cv2.dilate(depth, np.ones((reach, reach), np.uint8))
    edge = cv2.erode(mask.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    rows, columns = np.nonzero(peak & edge & (crest > _CREST) & (depth > least))
    found = np.stack([columns, rows, depth[rows, columns]], axis=1).astype(np.float32)
    return found[np.argsort(-found[:, 2], kind="stable")]


def write_pores(target: Path, source: Source, origin: Mapping[str, Any]) -> dict[str, Any]:
    """Find the pores of a surface, on its photograph where there is one, and write ``pores.json`` into a folder; return
    the facts. Raises BadInput where there is no surface, or its pixels are too large.
    """
    if source.ridge_mm is None or source.height_mm is None:
        raise BadInput(
            "`pores` needs the surface of the front view; leave it out for a file, a photograph or a rolled print."
        )
    where, image = ("relief", source.ridge_mm) if source.photo is None else ("photograph", source.photo)
    mask = source.mask & np.isfinite(source.ridge_mm)
    found = find_pores(image, mask, source.pitch_mm, None if source.photo is None else source.ridge_mm)
    places, pixel_um = found[:, :2].astype(np.float64), 1000.0 * source.pitch_mm
    space = on_surface(places, source.height_mm, source.pitch_mm, source.input_from_upright, source.xy_mm)
    known = np.isfinite(space).all(axis=1)
    x, y, z = (np.round(axis, 4).tolist() for axis in space[known].T)
    depth = [round(float(one), 3) for one in found[known, 2]]
    facts: dict[str, Any] = {"count": len(depth), "sought_in": where, "pixel_um": round(pixel_um, 1)}
    if pixel_um > _COARSE_UM and source.photo is None:
        facts["warning"] = _COARSE.format(pixel_um)
    record = {
        "format": "splitknit-pores", "version": 1, "x_mm": x, "y_mm": y, "z_mm": z, "depth": depth,
        **facts, "provenance": dict(origin),
    }  # fmt: skip
    write_file(target / "pores.json", json_text(record).encode("ascii"))
    return facts


def _ridges(image: FloatArray, mask: BoolArray, weight: FloatArray, pitch_mm: float) -> FloatArray:
    """What is faster than ridges' surroundings, in local standard deviations; 0 outside."""
    inside = np.where(mask & np.isfinite(image), image, np.float32(0)).astype(np.float32)
    flat = np.where(mask, inside - blur(inside, _CONTRAST_MM / pitch_mm) / weight, np.float32(0)).astype(np.float32)
    amplitude = np.sqrt(blur(flat * flat, 2 * _CONTRAST_MM / pitch_mm)) + np.float32(1e-9)
    return np.asarray(flat / amplitude, dtype=np.float32)


def _directions(ridges: FloatArray, pitch_mm: float) -> NDArray[np.intp]:
    """(H, W) number of the direction along the ridges, of :data:`_DIRECTIONS` in half a turn, rows running down."""
    smooth = blur(ridges, 0.06 / pitch_mm)
    right, down = (cv2.Sobel(smooth, cv2.CV_32F, *axes) for axes in ((1, 0), (0, 1)))
    sigma = _DIRECTION_MM / pitch_mm
    twice = np.arctan2(2 * blur(right * down, sigma), blur(right * right - down * down, sigma))
    along = 0.5 * twice + np.pi / 2
    return np.asarray(np.rint(along * _DIRECTIONS / np.pi).astype(np.intp) % _DIRECTIONS)


def _along(values: FloatArray, turn: NDArray[np.intp], pitch_mm: float) -> FloatArray:
    """Mean along the ridges, a Gaussian's: the ridge without its pores."""
    sigma, width = _ALONG_MM / pitch_mm, 0.02 / pitch_mm
    half = int(np.ceil(2.5 * sigma))
    down, right = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float32)
    result = np.zeros_like(values)
    for number in range(_DIRECTIONS):
        angle = np.pi * number / _DIRECTIONS
        on, beside = right * np.cos(angle) + down * np.sin(angle), down * np.cos(angle) - right * np.sin(angle)
        kernel = np.exp(-0.5 * ((on / sigma) ** 2 + (beside / max(width, 0.5)) ** 2))
        here = turn == number
        result[here] = cv2.filter2D(values, cv2.CV_32F, kernel / kernel.sum())[here]
    return result
