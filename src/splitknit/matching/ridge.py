"""Comparison of two ridge templates: coarse alignment, an affine refinement, local correlation, one similarity.

A higher similarity means more similar fingers; 1 is the same picture. Comparing A with B gives what B with A gives.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

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
from splitknit.matching.ridge_band import blur
from splitknit.matching.template import Template, pack
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits

Spectra = NDArray[np.complex64]


_STEP_DEG = 2.5
"""Between two rotations."""
_ROTATIONS = 6
"""How many are tried on the ridges, after a ranking by their directions."""
_PITCH_MM = 0.15
"""Side of a pixel of the coarse grid."""
_PLANE_PX = (270, 243)
"""Rows and columns of the coarse grid; of a finger that is larger the middle is used."""
_BLOCK_PX = 7
"""Pixels of the coarse grid, each way, that share one direction."""
_CANDIDATES = 2
"""Peaks that are looked at closely."""


@dataclass(frozen=True, slots=True)
class PhaseSettings(Checked):
    """The coarse search."""

    limit_deg: Annotated[float, Limits(0, 45)] = 30.0
    """Largest rotation tried."""
    whitening: Annotated[float, Limits(0, 1)] = 0.5
    """Power of the magnitude that each spectrum is divided by: 0 correlates, 1 keeps phase alone."""

    def angles_deg(self) -> NDArray[np.float64]:
        """Rotations tried, zero among them."""
        count = int(np.floor(self.limit_deg / _STEP_DEG + 1e-9))
        return _STEP_DEG * np.arange(-count, count + 1, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Peak:
    """One alignment of A on B."""

    angle_deg: float
    """A is turned by it about its middle, counter-clockwise."""
    right_mm: float
    """Then its middle lies so far right of B's middle."""
    down_mm: float
    height: float
    """Of the correlation, relative to complete agreement."""


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """One finger under some rotations, as spectra."""

    ridges: Spectra
    """(A, rows, columns // 2 + 1) whitened; correlated with itself, one has a peak of 1."""
    directions: Spectra
    """(A, blocks down, blocks across) of the field of doubled directions."""


def views(value: FloatArray, pitch_mm: float, angles_deg: NDArray[np.float64], settings: PhaseSettings) -> Views:
    """Spectra of a ridge band (H, W) for some rotations (A,); its middle is brought to the grid's middle."""
    plane = _PLANE_PX
    factor = _PITCH_MM / pitch_mm
    soft = blur(value, 0.4 * factor)  # less of what the coarse grid cannot hold
    centre = (value.shape[1] - 1) / 2, (value.shape[0] - 1) / 2
    middle = (plane[1] - 1) / 2, (plane[0] - 1) / 2
    turned = np.empty((len(angles_deg), *plane), dtype=np.float32)
    for k, angle in enumerate(np.deg2rad(angles_deg)):
        cos, sin = factor * np.cos(angle), factor * np.sin(angle)
        # the content turns counter-clockwise as seen (rows run down): fetch from the clockwise place
        source = np.array(
            [
                [cos, -sin, centre[0] - cos * middle[0] + sin * middle[1]],
                [sin, cos, centre[1] - sin * middle[0] - cos * middle[1]],
            ]
        )
        turned[k] = cv2.warpAffine(soft, source, plane[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    directions = np.stack([_directions(picture, _BLOCK_PX) for picture in turned])
    return Views(_whitened(scipy.fft.rfft2(turned), settings), np.asarray(scipy.fft.fft2(directions)))


def peaks(rotated: Views, fixed: Views, settings: PhaseSettings) -> list[Peak]:
    """Best alignments, best first, at most one a rotation.

    Parameters
    ----------
    rotated : A, once for each of `settings.angles_deg()`
    fixed : B, once
    """
    angles = settings.angles_deg()
    agreement = scipy.fft.ifft2(rotated.directions.conj() * fixed.directions).real
    ranked = np.argsort(-agreement.reshape(len(angles), -1).max(axis=1), kind="stable")[:_ROTATIONS]
    rows, columns = _PLANE_PX
    correlation = scipy.fft.irfft2(rotated.ridges[ranked].conj() * fixed.ridges, s=_PLANE_PX)
    places = correlation.reshape(len(ranked), -1).argmax(axis=1)
    found = []
    for picture, place, angle in zip(correlation, places.tolist(), angles[ranked].tolist(), strict=True):
        row, column = divmod(place, columns)
        down = row if row <= rows // 2 else row - rows
        right = column if column <= columns // 2 else column - columns
        height = float(picture[row, column])
        found.append(Peak(angle, right * _PITCH_MM, down * _PITCH_MM, height))
    found.sort(key=lambda peak: -peak.height)
    return found[:_CANDIDATES]


def _whitened(spectrum: Spectra, settings: PhaseSettings) -> Spectra:
    plane, pitch = _PLANE_PX, _PITCH_MM
    cycles = np.hypot(np.fft.fftfreq(plane[0], pitch)[:, None], np.fft.rfftfreq(plane[1], pitch)[None, :])
    ridges = ((cycles > 1.2) & (cycles < min(3.8, 0.5 / pitch))).astype(np.float32)  # periods of 0.26 to 0.83 mm
    size = np.abs(spectrum)
    floor = np.maximum(0.05 * size.max(axis=(1, 2), keepdims=True), np.float32(1e-12))
    result = spectrum * (ridges / np.maximum(size, floor) ** settings.whitening)
    # twice the power of the half plane, but for its first column, where ridges have little
    power = 2 * (np.abs(result) ** 2).sum(axis=(1, 2), keepdims=True)
    result *= np.sqrt(plane[0] * plane[1] / np.maximum(power, 1e-30)).astype(np.float32)
    return np.asarray(result, dtype=np.complex64)


def _directions(picture: FloatArray, block: int) -> Spectra:
    """Doubled directions, as complex numbers of length at most about one, of blocks of `picture`."""
    across = cv2.Sobel(picture, cv2.CV_32F, 1, 0)
    up = -cv2.Sobel(picture, cv2.CV_32F, 0, 1)
    size = picture.shape[1] // block, picture.shape[0] // block
    cut = slice(0, size[1] * block), slice(0, size[0] * block)

    def mean(part: FloatArray) -> FloatArray:
        return np.asarray(cv2.resize(np.ascontiguousarray(part[cut]), size, interpolation=cv2.INTER_AREA))

    xx, yy, xy = mean(across * across), mean(up * up), mean(across * up)
    total = xx + yy
    inside = total > 0
    typical = float(np.median(total[inside])) if bool(inside.any()) else 1.0
    return np.asarray((xx - yy + 2j * xy) / np.maximum(total, 0.3 * typical), dtype=np.complex64)


def _band_of(value: FloatArray, valid: BoolArray) -> FloatArray:
    """Ridge band with the steps of its levels smoothed away, zero outside."""
    return np.where(valid, blur(value, 0.6), np.float32(0.0)).astype(np.float32)


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
        return _band_of(self.template.value(), self.template.valid)

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
