"""Sweat pores of two fingers, compared where their ridges lie on each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splitknit import Surface, bounding_box
from splitknit_match.matching.elastic import bent, bent_by, compare_patches, shown_in_a
from splitknit_match.matching.minutia_pairs import on_ridges
from splitknit_match.matching.ridge import Prepared, lay
from splitknit_match.matching.ridge_band import RidgeBandSettings, band_places, ridge_band
from splitknit_match.matching.template import make_template

_REACH_MM = (0.4, 0.3, 0.2)
"""Within which pores are paired in each round of the alignment."""
_NEAR_MM = 0.12
"""At most between two pores that are the same: a pore's diameter."""


@dataclass(frozen=True, slots=True, eq=False)
class PoreTemplate:
    """Ridges and pores of one finger."""

    ridges: Prepared
    pores: NDArray[np.float64]
    """(N, 2) column and row in the template of the ridges."""


@dataclass(frozen=True, slots=True)
class PoreMatch:
    """How many pores two fingers share."""

    similarity: float
    """Pairs over the geometric mean of both numbers of pores, 0 to 1; 0 where there is nothing to compare."""
    pairs: int
    pores: tuple[int, int]  # of each side, where the other shows skin
    ridges: float
    """Similarity of the ridges, by which they were laid on each other."""


def pore_template(surface: Surface, pores: NDArray[np.floating]) -> PoreTemplate:
    """Lay a surface's pores flat with its ridges.

    `pores`: (N, 2 or more) column and row first, as ``find_pores`` gives them for the
    surface's relief or a photograph on its pixels. Raises BadInput as
    :func:`splitknit_match.matching.ridge_band.ridge_band`.
    """
    settings, mask = RidgeBandSettings(), surface.mask & np.isfinite(surface.ridge_mm) & np.isfinite(surface.shape_mm)
    pitch, transform, size = surface.pitch_mm, surface.input_from_upright, surface.upright_size
    band = ridge_band(surface.ridge_mm, mask, pitch, surface.shape_mm, transform, size)
    template = make_template(band)
    if template.empty or not len(pores):
        return PoreTemplate(Prepared(template), np.zeros((0, 2)))
    columns, rows, _ = band_places(mask, surface.shape_mm, transform, size, pitch_mm=pitch, settings=settings)
    box = bounding_box(band.valid)
    shown = np.stack([columns[box], rows[box]], axis=-1).reshape(-1, 2)
    # about bilinear between the band's four nearest pixels
    away, near = (np.asarray(one) for one in cKDTree(shown).query(pores[:, :2], k=4))
    row, column = np.divmod(near, template.valid.shape[1])
    places = np.stack([np.average(one, axis=1, weights=1 / (away + 1e-6)) for one in (column, row)], axis=1)
    places = places[away[:, 0] < settings.pitch_mm / pitch]
    return PoreTemplate(Prepared(template), places[on_ridges(template.valid, places)])


def pore_match(a: PoreTemplate, b: PoreTemplate) -> PoreMatch:
    """Compare two fingers by their pores, where their ridges put them on each other.

    Alignment: that of the ridges, bent as they agree, then in three rounds as the pairs of nearest pores ask for,
    smoothly. Score: pores that are each other's nearest within 0.12 mm. Source: A. K. Jain, Y. Chen and M. Demirkus,
    "Pores and ridges", IEEE Trans. PAMI 29, 2007 (iterative closest points where the ridges agree, then pairs).
    """
    swapped = a.ridges.key > b.ridges.key
    left, right = (b, a) if swapped else (a, b)
    if left.ridges.template.empty or right.ridges.template.empty:
        return PoreMatch(0.0, 0, (0, 0), -1.0)
    valid, pitch, grid = left.ridges.template.valid, left.ridges.template.pitch_mm, right.ridges.patches
    found, affine = lay(left.ridges, right.ridges)
    bend, back = bent(grid, compare_patches(grid, left.ridges.value, valid, affine)), np.linalg.inv(affine[:, :2]).T
    for reach in _REACH_MM:
        there = shown_in_a(grid, affine, bend, right.pores)
        one, other = _nearest(there, left.pores, reach / pitch)
        bend = bend + bent_by(grid, right.pores[one], (there[one] - left.pores[other]) @ back)
    there = shown_in_a(grid, affine, bend, right.pores)
    pairs = len(_nearest(there, left.pores, _NEAR_MM / pitch)[0])
    shown = on_ridges(right.ridges.template.valid, (left.pores - affine[:, 2]) @ back), on_ridges(valid, there)
    counts = [int(one.sum()) for one in shown]
    similarity = pairs / float(np.sqrt(max(1, counts[0] * counts[1])))
    return PoreMatch(similarity, pairs, (counts[swapped], counts[not swapped]), found.similarity)


def _nearest(a: NDArray[np.float64], b: NDArray[np.float64], reach: float) -> tuple[NDArray[np.intp], ...]:
    """Numbers of the points (N, 2), (M, 2) that are each other's nearest within a reach."""
    if not len(a) or not len(b):
        return (np.zeros(0, np.intp),) * 2
    (away, near), (_, back) = ((np.asarray(part) for part in cKDTree(p).query(q)) for p, q in ((b, a), (a, b)))
    one = np.flatnonzero((away <= reach) & (back[near] == np.arange(len(a))))
    return one, near[one]
