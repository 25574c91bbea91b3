"""Finger surface codes after Kumar and Kwong: what kind of surface lies at each place, in four bits.

The shape index (0 a cup, 0.25 a valley, 0.5 a saddle, 0.75 a ridge, 1 a cap) falls into nine zones; each zone has a
code of four bits, and every place of the finger one code. The bits are kept packed, 64 places of a row to a word.

The packed payload, little-endian: ``SKSC``, version, rows and columns (uint16 each), pitch in um (uint16), CRC-32 of
all that follows (uint32); the mask and the four planes in bits. A finger without any code is zero bytes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import BoolArray, Checked, FloatArray, Limits, check_mask, require
from splitknit_match.matching.minutiae_record import Packing
from splitknit_match.matching.score import prepared_sides

SURFACE_CODE_VERSION = 1
"""Version of the packed bytes; a reader refuses others."""
ZONES, PLANES = 9, 4
NATURAL = np.arange(ZONES, dtype=np.uint8)
GRAY = NATURAL ^ (NATURAL >> 1)
CODINGS = {"gray": GRAY, "binary": NATURAL}
LARGEST_SIDE_PX = 4096
_PACKING = Packing("surface codes", b"SKSC", SURFACE_CODE_VERSION, "HHH", "make them from the surface again.")

CODE_PITCH_MM = 0.1
"""Spacing of the grid of places; a ridge's period spans four to five of them."""
CODE_SMOOTH_MM = 0.03
"""Sigma of the Gaussian over the surface before its curvature is taken."""
CODE_WINDOW_MM = 0.25
"""Side of the window to which quadratics are fitted."""


@dataclass(frozen=True, slots=True)
class SurfaceCodeSettings(Checked):
    """How surfaces become codes."""

    coding: Literal["gray", "binary"] = "gray"
    """``gray``: neighbouring zones differ in one bit; ``binary``: the zone's number."""
    least_area_mm2: Annotated[float, Limits(0)] = 30.0
    """Smallest area of a code; less is a failure to acquire."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceCode:
    """Codes of one finger on an upright grid (tip up)."""

    code: NDArray[np.uint8]
    """(H, W) four bits; 0 outside the mask."""
    mask: BoolArray
    """(H, W) where there is a code."""
    pitch_mm: float

    def __post_init__(self) -> None:
        require(
            self.code.ndim == 2 and self.code.shape == self.mask.shape and self.code.dtype == np.uint8,
            f"a surface code must be (H, W) uint8 with a mask of the same size, but they are {self.code.shape} "
            f"{self.code.dtype} and {self.mask.shape}.",
        )
        require(max(self.code.shape, default=0) <= LARGEST_SIDE_PX, "a surface code is too large; check its pitch.")
        require(self.pitch_mm > 0, "the pitch of a surface code must be positive.")

    @property
    def area_mm2(self) -> float:
        """Skin that has a code."""
        return float(np.count_nonzero(self.mask)) * self.pitch_mm**2

    @property
    def empty(self) -> bool:
        """Whether there is none: a failure to acquire."""
        return not bool(self.mask.any())


def make_surface_code(
    shape_index: FloatArray, mask: BoolArray, settings: SurfaceCodeSettings | None = None
) -> SurfaceCode:
    """Code of a shape index (H, W), 0 to 1, on an upright grid of `CODE_PITCH_MM`; NaN has none.

    Source: A. Kumar and C. Kwong, "Towards contactless, low-cost and accurate 3D fingerprint identification", IEEE
    Trans. PAMI 37(3), 2015: finger surface codes; V. Kanhangad, A. Kumar and D. Zhang, "A unified framework for
    contactless hand verification", IEEE Trans. IFS 6(3), 2011: nine surface types in four bits; J. Koenderink and A.
    van Doorn, "Surface shape and curvature scales", Image and Vision Computing 10, 1992. Which bits stand for which
    type is not printed in the accessible text: the Gray code is chosen by us.

    >>> ridge_and_valley = np.array([[0.75, 0.25]], dtype=np.float32)
    >>> make_surface_code(ridge_and_valley, np.ones((1, 2), bool), SurfaceCodeSettings(least_area_mm2=0)).code.tolist()
    [[5, 3]]
    """
    settings = settings or SurfaceCodeSettings()
    index = np.asarray(shape_index)
    known = check_mask(mask, (index.shape[0], index.shape[1])) & np.isfinite(index)
    safe = np.clip(np.where(known, index, 0.0), 0.0, 1.0)
    zone = np.clip(np.floor(safe * (ZONES - 1) + 0.5), 0, ZONES - 1).astype(np.intp)
    if np.count_nonzero(known) * CODE_PITCH_MM**2 < settings.least_area_mm2:
        known = np.zeros_like(known)
    code = np.where(known, CODINGS[settings.coding][zone], 0).astype(np.uint8)
    return SurfaceCode(code, known, CODE_PITCH_MM)


def _packed_planes(code: NDArray[np.uint8], mask: BoolArray) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Bits of codes (..., H, W) as words: planes (4, ..., H, words), and the mask (..., H, words)."""
    width = -(-code.shape[-1] // 64) * 64
    gap = [(0, 0)] * (code.ndim - 1) + [(0, width - code.shape[-1])]
    bits = np.stack([np.pad((code >> plane) & 1, gap) for plane in range(PLANES)])
    return _words(bits), _words(np.pad(mask, gap))


def pack_surface_code(surface_code: SurfaceCode) -> bytes:
    """Payload of a code, five bits a place; none where there is no code."""
    if surface_code.empty:
        return b""
    planes = [surface_code.mask, *((surface_code.code >> plane) & 1 for plane in range(PLANES))]
    body = b"".join(np.packbits(plane.astype(np.bool_)).tobytes() for plane in planes)
    pitch_um = round(1000 * surface_code.pitch_mm)
    rows, columns = surface_code.code.shape
    return _PACKING.pack((rows, columns, pitch_um), body)


def unpack_surface_code(data: bytes) -> SurfaceCode:
    """Read what :func:`pack_surface_code` wrote.

    Raises BadInput if the bytes are damaged, of another version, or no surface code.

    >>> unpack_surface_code(b"").empty
    True
    """
    if not data:
        return SurfaceCode(np.zeros((1, 1), np.uint8), np.zeros((1, 1), np.bool_), CODE_PITCH_MM)

    def body_size(rows: int, columns: int, pitch_um: int) -> int:
        possible = pitch_um > 0 and max(rows, columns) <= LARGEST_SIDE_PX  # a scale, and no more than a finger has
        return (1 + PLANES) * ((rows * columns + 7) // 8) if possible else 0

    (rows, columns, pitch_um), body = _PACKING.unpack(data, body_size)
    size = len(body) // (1 + PLANES)
    words = np.frombuffer(body, np.uint8).reshape(1 + PLANES, size)
    mask, *planes = np.unpackbits(words, axis=1, count=rows * columns).reshape(1 + PLANES, rows, columns)
    code = sum((plane << number for number, plane in enumerate(planes)), np.zeros((rows, columns), np.uint8))
    return SurfaceCode(np.asarray(code, dtype=np.uint8), mask.astype(np.bool_), pitch_um / 1000)


def _words(bits: NDArray[np.uint8] | BoolArray) -> NDArray[np.uint64]:
    return np.ascontiguousarray(np.packbits(bits.astype(np.bool_), axis=-1)).view(np.uint64)


# Comparison of finger surface codes: the normalised Hamming distance over shifts and small turns.
#
# Two levels. All shifts at turns of a few degrees are tried on a coarser grid, by Fourier transforms: with bits as plus
# and minus one, a correlation *is* the number of equal less the number of unequal bits. Around the best of these, the
# distance is counted on packed bits at the full grid, over small shifts and turns.


Words = NDArray[np.uint64]

_CANDIDATES = 2
"""Turns and shifts of the first level that are counted exactly."""
_MIN_OVERLAP = 0.4
"""Fraction of the smaller finger that must overlap."""


@dataclass(frozen=True, slots=True)
class SurfaceMatchSettings(Checked):
    """How two surface codes are compared."""

    turn_deg: Annotated[float, Limits(0, 90)] = 18.0
    """Largest turn to either side that is tried."""
    turn_step_deg: Annotated[float, Limits(0.5, 30)] = 3.0
    """Step of the turns of the first level."""
    shift_mm: Annotated[float, Limits(0, 30, above=True)] = 5.0
    """Largest shift along the finger."""
    side_shift_mm: Annotated[float, Limits(0, 30, above=True)] = 3.0
    """Largest shift across it."""
    coarse_mm: Annotated[float, Limits(0.05, 1)] = 0.15
    """Pitch of the first level."""


@dataclass(frozen=True, slots=True)
class _SurfaceMatch:
    """How similar two surface codes are."""

    similarity: float
    """1 - the distance; 0 where nothing was compared."""
    distance: float
    """Fraction of unequal bits where both fingers have codes, at the best shift and turn."""
    overlap_mm2: float
    """Skin compared."""
    rotation_deg: float
    """By which A is turned, counter-clockwise as the camera sees it."""
    compared: bool
    """False where one side is a failure to acquire, or the two cannot overlap enough."""


NOT_COMPARED = _SurfaceMatch(0.0, 1.0, 0.0, 0.0, compared=False)


@dataclass(frozen=True, eq=False)
class PreparedSurface:
    """A code with what comparisons need of it alone, made when first used."""

    surface_code: SurfaceCode
    settings: SurfaceMatchSettings = field(default_factory=SurfaceMatchSettings)
    _kept: dict[Any, Any] = field(default_factory=dict, repr=False)

    @cached_property
    def key(self) -> bytes:
        """By which sides are ordered, so that the result does not depend on the order of arguments."""
        return pack_surface_code(self.surface_code)

    def turned(self, turn_deg: float, pitch_mm: float) -> tuple[NDArray[np.uint8], BoolArray]:
        """Code and mask on a grid of this pitch about the middle, turned counter-clockwise; far corners are lost."""
        code = self.surface_code
        scale = pitch_mm / code.pitch_mm
        rows, columns = self.grid(pitch_mm)
        cosine, sine = (scale * f(np.deg2rad(turn_deg)) for f in (np.cos, np.sin))
        back = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0]])
        middle = np.array([(code.code.shape[1] - 1) / 2, (code.code.shape[0] - 1) / 2])
        back[:, 2] = middle - back[:, :2] @ np.array([(columns - 1) / 2, (rows - 1) / 2])
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        both = code.code | (code.mask.astype(np.uint8) << 7)
        there = np.asarray(cv2.warpAffine(both, back, (columns, rows), flags=flags, borderValue=0.0), dtype=np.uint8)
        return there & np.uint8(15), (there >> np.uint8(7)).astype(np.bool_)

    def grid(self, pitch_mm: float) -> tuple[int, int]:
        """Rows and columns of a grid that holds the code and a little more, both odd."""
        scale = 1.1 * self.surface_code.pitch_mm / pitch_mm
        rows, columns = (2 * int(side * scale / 2) + 1 for side in self.surface_code.code.shape)
        return rows, columns

    def planes(self, turn_deg: float, size: tuple[int, int]) -> NDArray[Any]:
        """Transforms (4, ...) of the planes of the coarse grid, as plus and minus one, zero where there is no code."""
        import scipy.fft  # a comparison of templates needs none of it

        if ("planes", turn_deg, size) not in self._kept:
            code, mask = self.turned(turn_deg, self.settings.coarse_mm)
            signs = [np.where(mask, 1.0 - 2.0 * ((code >> plane) & 1), 0.0) for plane in range(PLANES)]
            self._kept["planes", turn_deg, size] = scipy.fft.rfft2(np.stack(signs).astype(np.float32), size)
        found: NDArray[Any] = self._kept["planes", turn_deg, size]
        return found

    def outline(self, size: tuple[int, int]) -> NDArray[Any]:
        """Transform of the coarse grid's mask."""
        import scipy.fft  # a comparison of templates needs none of it

        if ("outline", size) not in self._kept:
            _, mask = self.turned(0.0, self.settings.coarse_mm)
            self._kept["outline", size] = scipy.fft.rfft2(mask.astype(np.float32), size)
        found: NDArray[Any] = self._kept["outline", size]
        return found

    def packed(self, turn_deg: float) -> tuple[Words, Words]:
        """Packed planes and mask at the full grid."""
        if turn_deg not in self._kept:
            self._kept[turn_deg] = _packed_planes(*self.turned(turn_deg, self.surface_code.pitch_mm))
        planes, mask = self._kept[turn_deg]
        return planes, mask


def surface_code_match(
    a: SurfaceCode | PreparedSurface, b: SurfaceCode | PreparedSurface, settings: SurfaceMatchSettings | None = None
) -> _SurfaceMatch:
    """Compare two surface codes.

    Comparing A with B gives what B with A gives. Prepare a side that is compared more than once; then its settings must
    be those given here. Raises BadInput if the codes have different pitches. Source: A. Kumar and C. Kwong, "Towards
    contactless, low-cost and accurate 3D fingerprint identification", IEEE Trans. PAMI 37(3), 2015: normalised Hamming
    distance of masked codes, minimum over shifts. Rotations are our addition.
    """
    left, right = prepared_sides(a, b, PreparedSurface, settings)
    pitch = left.surface_code.pitch_mm
    if left.surface_code.empty or right.surface_code.empty:
        return NOT_COMPARED
    require(
        pitch == right.surface_code.pitch_mm,
        f"surface codes have pitches of {pitch:g} and {right.surface_code.pitch_mm:g} mm; make both new.",
    )
    swapped = left.key > right.key
    if swapped:
        left, right = right, left
    least = _MIN_OVERLAP * min(left.surface_code.area_mm2, right.surface_code.area_mm2)
    best = NOT_COMPARED
    for turn, row, column in _candidates(left, right, least):
        best = min(best, _counted(left, right, (turn, row, column), least), key=lambda found: found.distance)
    return replace(best, rotation_deg=0.0 - best.rotation_deg) if swapped else best


def _candidates(a: PreparedSurface, b: PreparedSurface, min_mm2: float) -> list[tuple[float, float, float]]:
    """Turn of `a` in degrees and its shift along rows and columns in mm, of the best of the first level.

    The overlap is taken to be that of the outlines as they came, whatever the turn.
    """
    import scipy.fft  # a comparison of templates needs none of it

    settings, pitch = a.settings, a.settings.coarse_mm
    grids = a.grid(pitch), b.grid(pitch)
    reach = [int(limit / pitch) for limit in (settings.shift_mm, settings.side_shift_mm)]
    rows, columns = (
        max(one, other, (one + other + 1) // 2 + limit) for one, other, limit in zip(*grids, reach, strict=True)
    )
    # in large steps, so that the transforms of a side serve nearly all that it is compared with
    size = max(-(-rows // 64) * 64, 256), max(-(-columns // 64) * 64, 192)
    # both grids begin at their corner; their middles lie half the difference of the sides apart
    shifts = [np.arange(-limit, limit + 1) for limit in reach]
    chosen = np.ix_(*((shifts[k] + (grids[1][k] - grids[0][k]) // 2) % size[k] for k in (0, 1)))
    planes = b.planes(0.0, size)
    common = scipy.fft.irfft2(a.outline(size).conj() * b.outline(size), size)[chosen]
    common = np.maximum(np.rint(common), 1.0)
    enough = common * pitch**2 >= min_mm2
    if not bool(enough.any()):
        return []
    found: list[tuple[float, float, int, int]] = []
    count = int(settings.turn_deg / settings.turn_step_deg + 1e-9)
    for turn in (settings.turn_step_deg * k for k in range(-count, count + 1)):
        equal = scipy.fft.irfft2((a.planes(turn, size).conj() * planes).sum(axis=0), size)[chosen]
        agreement = equal / common
        # how far above what is usual, in units of what chance gives at this overlap
        scores = np.where(enough, (agreement - np.median(agreement[enough])) * np.sqrt(common), -np.inf)
        row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
        found.append((-float(scores[row, column]), turn, int(shifts[0][row]), int(shifts[1][column])))
    found.sort()
    return [(turn, pitch * row, pitch * column) for _, turn, row, column in found[:_CANDIDATES]]


def _counted(
    a: PreparedSurface, b: PreparedSurface, start: tuple[float, float, float], min_mm2: float
) -> _SurfaceMatch:
    """Minimum distance around a candidate: turns within a step, shifts within a coarse place."""
    settings, pitch = a.settings, a.surface_code.pitch_mm
    step = settings.turn_step_deg
    turns = [start[0] + step * k / 4 for k in (-2, -1, 0, 1, 2)]
    planes, masks = (np.stack(part) for part in zip(*(a.packed(turn) for turn in turns), strict=True))
    code, mask = b.turned(0.0, pitch)
    grid = a.grid(pitch)
    margin = [(one - other) // 2 for one, other in zip(grid, code.shape, strict=True)]
    rows, columns = (round(shift / pitch) for shift in start[1:])
    near = int(settings.coarse_mm / pitch) + 1
    best = NOT_COMPARED
    for d in range(-near, near + 1):
        # b, moved so that its places lie on those of a; with spare rows, among which a window slides
        at = (margin[0] - rows + near, margin[1] - columns - d)
        other, other_mask = _packed_planes(*_placed(code, mask, at, (grid[0] + 2 * near, grid[1])))
        for e in range(2 * near + 1):
            window = slice(e, e + grid[0])
            common = masks & other_mask[window]
            total = np.bitwise_count(common).sum(axis=(1, 2), dtype=np.int64)
            differ = (planes ^ other[:, window]) & common[:, None]
            unequal = np.bitwise_count(differ).sum(axis=(1, 2, 3), dtype=np.int64)
            area = total * pitch**2
            distance = np.where(area >= min_mm2, unequal / np.maximum(PLANES * total, 1), 1.0)
            k = int(np.argmin(distance))
            if distance[k] < best.distance:
                best = _SurfaceMatch(
                    1 - float(distance[k]), float(distance[k]), float(area[k]), turns[k], compared=True
                )
    return best


def _placed(
    code: NDArray[np.uint8], mask: BoolArray, at: tuple[int, int], shape: tuple[int, int]
) -> tuple[NDArray[np.uint8], BoolArray]:
    """Code and mask on a grid of `shape`, their corner at `at`; what is outside is lost."""
    move, size = np.array([[1.0, 0.0, at[1]], [0.0, 1.0, at[0]]]), shape[::-1]
    moved, covered = (
        np.asarray(cv2.warpAffine(part, move, size, flags=cv2.INTER_NEAREST), dtype=np.uint8)
        for part in (code, mask.view(np.uint8))
    )
    return moved, covered > 0
