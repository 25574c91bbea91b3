"""Sweat pores: small pits along the crests of the ridges, or dark dots on a photograph of them;
found and compared.

    python validation/published/pores.py A B                       # captures of at least 29 px/mm
    python validation/published/pores.py PEOPLE --out scores.csv

Found: what is left when a ridge is taken for the same along itself (Q. Zhao et al., Pattern
Recognition 43, 2010). Compared, as pairs where the ridges lie on each other: A. K. Jain, Y. Chen
and M. Demirkus, "Pores and ridges", IEEE Trans. PAMI 29, 2007. Beside ridges they added nothing
(docs/explain/tried.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scored import run

from splitknit.errors import BadInput
from splitknit.finger.regions import blur
from splitknit.imaging.geometry import bounding_box
from splitknit.io.capture import read_capture
from splitknit.model import BoolArray, FloatArray
from splitknit.pipeline import reconstruct
from splitknit.reconstruction import Surface, surface_of
from splitknit_match.matching.elastic import STILL, PatchGrid, bent, compare_patches, shown_in_a
from splitknit_match.matching.minutia_pairs import on_ridges
from splitknit_match.matching.ridge import Prepared, lay
from splitknit_match.matching.ridge_band import PITCH_MM, band_places, ridge_band
from splitknit_match.matching.template import make_template

DIAMETER_MM = 0.13
"""Diameter of a pore (0.06 to 0.25); the filter is a Gaussian of this width at half maximum."""
ALONG_SIGMA_MM = 0.3
"""Sigma along ridges, over which a ridge without pores hardly changes."""
DIRECTION_SIGMA_MM = 0.3
"""Sigma over which the ridges' direction is averaged."""
CONTRAST_SIGMA_MM = 0.5
"""Sigma over which the ridges' amplitude is averaged."""
MIN_CREST = 0.25
"""Height of a crest's sides, in amplitudes: pores lie above."""
DIRECTIONS = 16
MAX_PITCH_MM = 0.034
ROUND_PAIR_MM = (0.4, 0.3, 0.2)
"""Within which pores are paired in each round of the alignment."""
MAX_PAIR_MM = 0.12
"""At most between two pores that are the same: a pore's diameter."""


def find_pores(
    image: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    crests: FloatArray | None = None,
    *,
    least: float = 0.05,
) -> NDArray[np.float32]:
    """Find sweat pores by what is left when a ridge is taken for the same along itself.

    The direction of the ridges is that of the structure tensor; along it the image is smoothed,
    which keeps ridges and loses pores. A pore is a minimum of the difference, at a pore's size, on
    a crest.

    `image`: (H, W) float32, a relief (``ridge_mm``) or a photograph on which pores are dark;
    `mask`: (H, W) bool; `pitch_mm`: side of a pixel, at most 0.034, as a pore has 0.06 to 0.25 mm;
    `crests`: (H, W) float32, relief whose crests hold the pores, where `image` is a photograph;
    `least`: depth of a pore, in standard deviations of the ridges around it. Returns (N, 3)
    float32: column, row and depth, the deepest first.

    Source: Q. Zhao, D. Zhang, L. Zhang and N. Luo, "Adaptive fingerprint pore modeling and
    extraction", Pattern Recognition 43, 2010 (pores differ from the ridge along its direction); A.
    K. Jain, Y. Chen and M. Demirkus, "Pores and ridges", IEEE Trans. PAMI 29, 2007 (a band-pass at
    a pore's scale).
    """
    relief = image if crests is None else crests
    if not 0 < pitch_mm <= MAX_PITCH_MM:
        raise BadInput(
            f"pores need pixels of at most {1000 * MAX_PITCH_MM:g} um; these have"
            f" {1000 * pitch_mm:.0f}."
        )
    weight = blur(mask.astype(np.float32), CONTRAST_SIGMA_MM / pitch_mm) + np.float32(1e-6)
    ridges, values = (_ridges(plane, mask, weight, pitch_mm) for plane in (relief, image))
    turn = _directions(ridges, pitch_mm)
    crest = _along(ridges, turn, pitch_mm)
    rest = blur(
        values - (crest if crests is None else _along(values, turn, pitch_mm)),
        DIAMETER_MM / 2.355 / pitch_mm,
    )
    depth = -rest
    reach = 2 * round(DIAMETER_MM / pitch_mm / 2) + 1
    peak = depth >= cv2.dilate(depth, np.ones((reach, reach), np.uint8))
    edge = cv2.erode(mask.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    rows, columns = np.nonzero(peak & edge & (crest > MIN_CREST) & (depth > least))
    pores = np.stack([columns, rows, depth[rows, columns]], axis=1).astype(np.float32)
    return pores[np.argsort(-pores[:, 2], kind="stable")]


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
    """Pairs over the geometric mean of both numbers of pores, 0 to 1; 0 where there is nothing to
    compare."""
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
    mask = surface.mask & np.isfinite(surface.ridge_mm) & np.isfinite(surface.shape_mm)
    pitch, transform, size = surface.pitch_mm, surface.input_from_upright, surface.upright_size
    band = ridge_band(surface.ridge_mm, mask, pitch, surface.shape_mm, transform, size)
    template = make_template(band)
    if template.empty or not len(pores):
        return PoreTemplate(Prepared(template), np.zeros((0, 2)))
    columns, rows, _ = band_places(mask, surface.shape_mm, transform, size, pitch_mm=pitch)
    box = bounding_box(band.valid)
    band_px = np.stack([columns[box], rows[box]], axis=-1).reshape(-1, 2)
    # about bilinear between the band's four nearest pixels
    away, near = (np.asarray(part) for part in cKDTree(band_px).query(pores[:, :2], k=4))
    row, column = np.divmod(near, template.valid.shape[1])
    places = np.stack(
        [np.average(part, axis=1, weights=1 / (away + 1e-6)) for part in (column, row)], axis=1
    )
    places = places[away[:, 0] < PITCH_MM / pitch]
    return PoreTemplate(Prepared(template), places[on_ridges(template.valid, places)])


PAIR_WEIGHT = 0.16  # of a shift that two pores show: that of a patch whose correlation is 0.6


def bent_by(patches: PatchGrid, position: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Smooth shifts (rows, columns, 2) of the grid's patches, from shifts (N, 2) of positions (N,
    2) in B."""
    weighted = PAIR_WEIGHT * np.column_stack([shift, np.ones(len(shift))])
    total = np.zeros((*patches.grid, 3), dtype=np.float32)
    np.add.at(total, patches.nearest(position), weighted.astype(np.float32))
    total = cv2.GaussianBlur(total, (0, 0), 1.0, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(total[..., :2] / (total[..., 2:] + STILL))


def pore_match(a: PoreTemplate, b: PoreTemplate) -> PoreMatch:
    """Compare two fingers by their pores, where their ridges put them on each other.

    Alignment: that of the ridges, bent as they agree, then in three rounds as the pairs of nearest
    pores ask for, smoothly. Score: pores that are each other's nearest within 0.12 mm. Source: A.
    K. Jain, Y. Chen and M. Demirkus, "Pores and ridges", IEEE Trans. PAMI 29, 2007 (iterative
    closest points where the ridges agree, then pairs).
    """
    swapped = a.ridges.key > b.ridges.key
    left, right = (b, a) if swapped else (a, b)
    if left.ridges.template.empty or right.ridges.template.empty:
        return PoreMatch(0.0, 0, (0, 0), -1.0)
    band, grid = left.ridges.band, right.ridges.patches
    valid, pitch = band.valid, band.pitch_mm
    alignment, affine = lay(left.ridges, right.ridges)
    bend = bent(grid, compare_patches(grid, band, affine))
    back = np.linalg.inv(affine[:, :2]).T
    for reach in ROUND_PAIR_MM:
        there = shown_in_a(grid, affine, bend, right.pores)
        of_b, of_a = _nearest(there, left.pores, reach / pitch)
        bend = bend + bent_by(grid, right.pores[of_b], (there[of_b] - left.pores[of_a]) @ back)
    there = shown_in_a(grid, affine, bend, right.pores)
    pairs = len(_nearest(there, left.pores, MAX_PAIR_MM / pitch)[0])
    visible = (
        on_ridges(right.ridges.template.valid, (left.pores - affine[:, 2]) @ back),
        on_ridges(valid, there),
    )
    counts = [int(seen.sum()) for seen in visible]
    similarity = pairs / float(np.sqrt(max(1, counts[0] * counts[1])))
    return PoreMatch(
        similarity, pairs, (counts[swapped], counts[not swapped]), alignment.similarity
    )


def _nearest(
    a: NDArray[np.float64], b: NDArray[np.float64], reach: float
) -> tuple[NDArray[np.intp], ...]:
    """Numbers of the points (N, 2), (M, 2) that are each other's nearest within a reach."""
    if not len(a) or not len(b):
        return (np.zeros(0, np.intp),) * 2
    (away, near), (_, back) = (
        (np.asarray(part) for part in cKDTree(p).query(q)) for p, q in ((b, a), (a, b))
    )
    mutual = np.flatnonzero((away <= reach) & (back[near] == np.arange(len(a))))
    return mutual, near[mutual]


def _ridges(image: FloatArray, mask: BoolArray, weight: FloatArray, pitch_mm: float) -> FloatArray:
    """What is faster than ridges' surroundings, in local standard deviations; 0 outside."""
    inside = np.where(mask & np.isfinite(image), image, np.float32(0)).astype(np.float32)
    flat = np.where(
        mask, inside - blur(inside, CONTRAST_SIGMA_MM / pitch_mm) / weight, np.float32(0)
    ).astype(np.float32)
    amplitude = np.sqrt(blur(flat * flat, 2 * CONTRAST_SIGMA_MM / pitch_mm)) + np.float32(1e-9)
    return np.asarray(flat / amplitude, dtype=np.float32)


def _directions(ridges: FloatArray, pitch_mm: float) -> NDArray[np.intp]:
    """(H, W) number of the direction along the ridges, of :data:`DIRECTIONS` in half a turn, rows
    running down."""
    smooth = blur(ridges, 0.06 / pitch_mm)
    right, down = (cv2.Sobel(smooth, cv2.CV_32F, *axes) for axes in ((1, 0), (0, 1)))
    sigma = DIRECTION_SIGMA_MM / pitch_mm
    twice = np.arctan2(2 * blur(right * down, sigma), blur(right * right - down * down, sigma))
    along = 0.5 * twice + np.pi / 2
    return np.asarray(np.rint(along * DIRECTIONS / np.pi).astype(np.intp) % DIRECTIONS)


def _along(values: FloatArray, turn: NDArray[np.intp], pitch_mm: float) -> FloatArray:
    """Mean along the ridges, a Gaussian's: the ridge without its pores."""
    sigma, width = ALONG_SIGMA_MM / pitch_mm, 0.02 / pitch_mm
    half = int(np.ceil(2.5 * sigma))
    down, right = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float32)
    result = np.zeros_like(values)
    for number in range(DIRECTIONS):
        angle = np.pi * number / DIRECTIONS
        on = right * np.cos(angle) + down * np.sin(angle)
        beside = down * np.cos(angle) - right * np.sin(angle)
        kernel = np.exp(-0.5 * ((on / sigma) ** 2 + (beside / max(width, 0.5)) ** 2))
        here = turn == number
        result[here] = cv2.filter2D(values, cv2.CV_32F, kernel / kernel.sum())[here]
    return result


def features(finger: Path, preset: str) -> PoreTemplate | None:
    """Pores of a capture, on its mean white photograph; None without ridges."""
    capture = read_capture(finger)
    surface = surface_of(reconstruct(capture, preset))
    photograph = capture.bands["white"].pixels.astype(np.float32).mean(axis=(0, 3))
    template = pore_template(
        surface, find_pores(photograph, surface.mask, surface.pitch_mm, surface.ridge_mm)
    )
    return None if template.ridges.template.empty else template


if __name__ == "__main__":
    raise SystemExit(run(features, lambda a, b: pore_match(a, b).similarity, "metric"))
