"""Comparison of two ridge templates: coarse alignment, an affine refinement, local correlation, one similarity.

A higher similarity means more similar fingers; 1 is the same picture. Comparing A with B gives what B with A gives.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from splitknit.errors import require
from splitknit.matching.elastic import (
    Affine,
    Agreement,
    PatchGrid,
    PatchSettings,
    better_affine,
    compare_patches,
    patch_grid,
    rigid,
)
from splitknit.matching.phase import PhaseSettings, Views, band_of, peaks, views
from splitknit.matching.template import Template, pack
from splitknit.model import FloatArray

_REFINEMENTS = 2
"""Affine fits to the patches' shifts."""
_MIN_OVERLAP_MM2 = 60.0
"""Where less skin overlaps, and it is not all that the smaller template has, the similarity is lowered."""


FIRST_PATCHES = PatchSettings(patch_mm=2.4, step_mm=2.4, search_mm=0.8)
"""Patches that refine the coarse alignment."""


@dataclass(frozen=True, slots=True)
class RidgeMatchSettings:
    """How two templates are compared."""

    phase: PhaseSettings = field(default_factory=PhaseSettings)
    patches: PatchSettings = field(default_factory=PatchSettings)
    """Patches that give the score."""


@dataclass(frozen=True, slots=True)
class RidgeMatch:
    """How similar two fingers are, and how they were laid on each other."""

    similarity: float
    """At most 1; other fingers give about 0.2; -1 where a finger could not be acquired."""
    correlation: float
    """Mean local correlation over the overlap."""
    overlap_mm2: float
    """Skin compared."""
    rotation_deg: float
    """By which A is turned, counter-clockwise as the camera sees it."""
    right_mm: float
    """From the middle of B's template to the middle of A's."""
    up_mm: float
    compared: bool
    """False where one side is a failure to acquire."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A template with all that comparisons need and that does not depend on the other side, made when first used."""

    template: Template
    settings: RidgeMatchSettings = field(default_factory=RidgeMatchSettings)

    @cached_property
    def key(self) -> bytes:
        """By which sides are ordered, so that the result does not depend on the order of arguments."""
        return hashlib.sha256(pack(self.template)).digest()

    @cached_property
    def value(self) -> FloatArray:
        """(H, W) smooth ridge band."""
        return band_of(self.template.value(), self.template.valid)

    @cached_property
    def rotated(self) -> Views:
        """Views under all rotations."""
        phase = self.settings.phase
        return views(self.value, self.template.pitch_mm, phase.angles_deg(), phase)

    @cached_property
    def fixed(self) -> Views:
        """View without rotation."""
        return views(self.value, self.template.pitch_mm, np.zeros(1), self.settings.phase)

    @cached_property
    def first(self) -> PatchGrid:
        """Patches for the refinement."""
        return patch_grid(self.value, self.template.valid, self.template.pitch_mm, FIRST_PATCHES)

    @cached_property
    def patches(self) -> PatchGrid:
        """Patches for the score."""
        return patch_grid(self.value, self.template.valid, self.template.pitch_mm, self.settings.patches)


def ridge_match(
    a: Template | Prepared, b: Template | Prepared, settings: RidgeMatchSettings | None = None
) -> RidgeMatch:
    """Compare two templates.

    Parameters
    ----------
    a, b : Template or Prepared
        Prepare a template that is compared more than once; then its settings must be those given here.
    settings : RidgeMatchSettings, optional

    Returns
    -------
    RidgeMatch
        Its `similarity` is the mean, over the patches of the overlap, of the local correlation at the shift that the
        neighbouring patches support, times sqrt(min(1, overlap / least)) with least = min(`least_overlap_mm2`, half of
        the smaller template).

    Raises
    ------
    BadInput
        If the templates have different pitches.

    References
    ----------
    Kuglin and Hines 1975, The phase correlation image alignment method; Ito et al. 2004, A fingerprint matching
    algorithm using phase-only correlation (band limit, rotation search); Bazen et al. 2000, A correlation-based
    fingerprint verification system (local patches).
    """
    left, right = prepared(a, settings), prepared(b, settings)
    require(
        left.settings == right.settings,
        "the two sides were prepared with different settings; prepare both with the same.",
    )
    if left.template.empty or right.template.empty:
        return RidgeMatch(-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, compared=False)
    require(
        left.template.pitch_mm == right.template.pitch_mm,
        f"templates have pitches of {left.template.pitch_mm:g} and {right.template.pitch_mm:g} mm; make both new.",
    )
    swapped = left.key > right.key
    result, affine = _match(right, left) if swapped else _match(left, right)
    pitch = left.template.pitch_mm
    if swapped:
        inner = np.linalg.inv(affine[:, :2])
        affine = np.hstack([inner, -(inner @ affine[:, 2])[:, None]])
    # affine: place in b to place in a; where a's middle lies in b
    angle = float(np.arctan2(affine[1, 0] - affine[0, 1], affine[0, 0] + affine[1, 1]))
    shape, other = left.template.valid.shape, right.template.valid.shape
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    there = np.linalg.solve(affine[:, :2], middle - affine[:, 2])
    offset = (there - np.array([(other[1] - 1) / 2, (other[0] - 1) / 2])) * pitch
    return replace(result, rotation_deg=float(np.rad2deg(angle)), right_mm=float(offset[0]), up_mm=float(-offset[1]))


def prepared(side: Template | Prepared, settings: RidgeMatchSettings | None = None) -> Prepared:
    """`side`, ready for many comparisons."""
    if isinstance(side, Prepared):
        require(
            settings is None or side.settings == settings, "a side was prepared with other settings; prepare it again."
        )
        return side
    return Prepared(side, settings or RidgeMatchSettings())


def _match(a: Prepared, b: Prepared) -> tuple[RidgeMatch, Affine]:
    settings, pitch = a.settings, a.template.pitch_mm
    best: tuple[float, Affine, Agreement] | None = None
    for peak in peaks(a.rotated, b.fixed, settings.phase):
        start = rigid(
            a.template.valid.shape,
            b.template.valid.shape,
            float(np.deg2rad(peak.angle_deg)),
            (peak.right_mm / pitch, peak.down_mm / pitch),
        )
        found = compare_patches(b.first, a.value, a.template.valid, start)
        worth = found.mean * np.sqrt(len(found.used))
        if best is None or worth > best[0]:
            best = (float(worth), start, found)
    assert best is not None
    affine = better_affine(b.first, best[2], best[1])
    for _ in range(_REFINEMENTS - 1):
        again = compare_patches(b.first, a.value, a.template.valid, affine)
        affine = better_affine(b.first, again, affine)
    final = compare_patches(b.patches, a.value, a.template.valid, affine)
    overlap = float(final.weight.sum()) * settings.patches.step_mm**2
    smaller = min(a.template.area_mm2, b.template.area_mm2)
    least = max(min(_MIN_OVERLAP_MM2, 0.5 * smaller), 1e-9)
    correlation = final.mean
    similarity = correlation * float(np.sqrt(min(1.0, overlap / least)))
    return RidgeMatch(similarity, correlation, overlap, 0.0, 0.0, 0.0, compared=True), affine
