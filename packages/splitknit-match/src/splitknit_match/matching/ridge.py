"""Comparison of two ridge templates: coarse alignment, an affine refinement, local correlation, one
similarity.

A higher similarity means more similar fingers; 1 is the same picture. Comparing A with B gives what
B with A gives.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace

import numpy as np

from splitknit.errors import require
from splitknit.imaging.geometry import gaussian_mean
from splitknit_match.matching.coarse import CoarseViews, inverse, likely_alignments
from splitknit_match.matching.elastic import (
    Affine,
    Agreement,
    PatchGrid,
    Positions,
    better_affine,
    compare_patches,
    patch_grid,
)
from splitknit_match.matching.minutia_pairs import Cylinders, Places, minutia_cylinders
from splitknit_match.matching.ridge_band import RidgeBand
from splitknit_match.matching.template import Template, pack
from splitknit_match.threads import made_once


@dataclass(frozen=True, slots=True)
class RidgeMatch:
    """How similar two fingers are, and how they were laid on each other."""

    similarity: float
    """At most 1; other fingers give about 0.2; -1 where a finger could not be acquired."""
    correlation: float = 0.0
    """Mean local correlation over the overlap."""
    overlap_mm2: float = 0.0
    """Skin compared."""
    rotation_deg: float = 0.0
    """By which A is turned, counter-clockwise as the camera sees it."""
    right_mm: float = 0.0
    """From the centre of B's template to the centre of A's."""
    up_mm: float = 0.0
    compared: bool = False
    """False where one side is a failure to acquire."""


_FIRST_STEP_MM = 2.4
"""Step of the patches that refine the coarse alignment. Chosen on: real prints (FVC2002 DB1_B)."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A template with all that comparisons need and that does not depend on the other side, made
    when first used."""

    template: Template

    @made_once
    def key(self) -> bytes:
        """By which sides are ordered, so that the result does not depend on the order of
        arguments."""
        ridges = replace(self.template, minutiae=None, flat=None)
        return hashlib.sha256(pack(ridges)[1:]).digest()  # whatever they are of

    @made_once
    def printed(self) -> Prepared:
        """As prints are compared with it: a surface by its print."""
        return self if self.template.flat is None else Prepared(self.template.flat)

    @made_once
    def band(self) -> RidgeBand:
        """Its ridges with the steps of their levels smoothed away, zero outside."""
        smooth = gaussian_mean(self.template.value(), 0.6)
        value = np.where(self.template.valid, smooth, 0.0)
        return RidgeBand(value, self.template.valid, self.template.pitch_mm)

    @made_once
    def views(self) -> CoarseViews:
        """The band on the coarse grid."""
        return CoarseViews(self.band)

    @made_once
    def first(self) -> PatchGrid:
        """Patches for the refinement."""
        # largest shift of the patches that refine the coarse alignment
        return patch_grid(self.band, _FIRST_STEP_MM, 0.8)

    @made_once
    def close(self) -> PatchGrid:
        """Patches that bend a small print."""
        # step, and largest shift, of the patches that bend a small print
        return patch_grid(self.band, 1.2, 0.4)

    @made_once
    def patches(self) -> PatchGrid:
        """Patches for the score."""
        return patch_grid(self.band)

    @made_once
    def cylinders(self) -> Cylinders | None:
        """Cylinders of its minutiae; None where there are too few."""
        minutiae = self.template.minutiae
        # fewest minutiae of a small print that are compared; of other prints it is ten
        if minutiae is None or minutiae.count < 3:
            return None
        return minutia_cylinders(minutiae, self.template.valid, self.template.pitch_mm)

    def pixels(self, place: Places) -> Positions:
        """(N, 2) column and row in the template of places, mm from its centre."""
        rows, columns = self.template.valid.shape
        pitch_mm = self.template.pitch_mm
        return np.stack(
            [(columns - 1) / 2 + place.real / pitch_mm, (rows - 1) / 2 - place.imag / pitch_mm],
            axis=1,
        )


def prepared(side: Template | Prepared) -> Prepared:
    """A side of a comparison with all that it needs."""
    return side if isinstance(side, Prepared) else Prepared(side)


def ridge_match(a: Template | Prepared, b: Template | Prepared) -> RidgeMatch:
    """Compare two templates, two surfaces or two prints; prepare one that is compared more than
    once.

    The `similarity` is the mean, over the patches of the overlap, of the local correlation at the
    shift that the neighbouring patches support, times sqrt(min(1, overlap / limit)) with limit =
    min(60 mm2, half of the smaller template). Raises BadInput if the templates have different
    pitches.

    Source: Bazen et al. 2000, A correlation-based fingerprint verification system (local patches).
    """
    left, right = prepared(a), prepared(b)
    if left.template.kind != right.template.kind:
        left, right = left.printed, right.printed
    if left.template.empty or right.template.empty:
        return RidgeMatch(-1.0)
    pitches = left.template.pitch_mm, right.template.pitch_mm
    require(
        pitches[0] == pitches[1],
        f"templates have pitches of {pitches[0]:g} and {pitches[1]:g} mm; make both new.",
    )
    if left.key <= right.key:
        result, affine = lay(left, right)
    else:
        result, affine = lay(right, left)
        affine = inverse(affine)
    return placed(result, affine, left, right)


def placed(result: RidgeMatch, affine: Affine, a: Prepared, b: Prepared) -> RidgeMatch:
    """`result` with how A lies on B; `affine`: position in B to position in A."""
    centre_a, centre_b = ((np.array(side.template.valid.shape[::-1]) - 1) / 2 for side in (a, b))
    seen_in_b = np.linalg.solve(affine[:, :2], centre_a - affine[:, 2])
    right, down = (seen_in_b - centre_b) * a.template.pitch_mm
    return replace(
        result,
        rotation_deg=float(np.rad2deg(turn_of(affine))),
        right_mm=float(right),
        up_mm=float(-down),
    )


def lay(a: Prepared, b: Prepared) -> tuple[RidgeMatch, Affine]:
    """Compare `a` with `b`, in this order, and the affine map from b's positions to a's."""
    starts = likely_alignments(a.views, b.views)
    tried = [(start, compare_patches(b.first, a.band, start)) for start in starts]
    affine = refined(a, b, *max(tried, key=lambda start: start[1].evidence))
    return scored(a, b, b.patches, compare_patches(b.patches, a.band, affine)), affine


def turn_of(affine: Affine) -> float:
    """By which A is turned, counter-clockwise, radians."""
    return math.atan2(affine[1, 0] - affine[0, 1], affine[0, 0] + affine[1, 1])


_REFINEMENTS = 2
"""Affine fits to the patches' shifts. Chosen on: real prints (FVC2002 DB1_B)."""


def refined(a: Prepared, b: Prepared, start: Affine, agreement: Agreement) -> Affine:
    """Affine map that follows the shifts of large patches."""
    affine = better_affine(b.first, agreement, start)
    for _ in range(_REFINEMENTS - 1):
        affine = better_affine(b.first, compare_patches(b.first, a.band, affine), affine)
    return affine


_MIN_OVERLAP_MM2 = 60.0
"""Where less skin overlaps, and it is not all that the smaller template has, the similarity is
lowered."""


def scored(a: Prepared, b: Prepared, patches: PatchGrid, agreement: Agreement) -> RidgeMatch:
    """Similarity by the patches of an alignment."""
    overlap_mm2 = float(agreement.weight.sum()) * (patches.step * patches.pitch_mm) ** 2
    smaller_mm2 = min(a.template.area_mm2, b.template.area_mm2)
    limit_mm2 = max(min(_MIN_OVERLAP_MM2, 0.5 * smaller_mm2), 1e-9)
    similarity = agreement.mean * float(np.sqrt(min(1.0, overlap_mm2 / limit_mm2)))
    return RidgeMatch(similarity, agreement.mean, overlap_mm2, compared=True)
