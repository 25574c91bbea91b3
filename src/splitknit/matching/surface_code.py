"""Finger surface codes after Kumar and Kwong: what kind of surface lies at each place, in four bits.

The shape index (0 a cup, 0.25 a valley, 0.5 a saddle, 0.75 a ridge, 1 a cap) falls into nine zones; each zone has a
code of four bits, and every place of the finger one code. The bits are kept packed, 64 places of a row to a word.

The packed payload, little-endian: ``SKSC``, version, rows and columns (uint16 each), pitch in um (uint16), CRC-32 of
all that follows (uint32); the mask and the four planes in bits. A finger without any code is zero bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, require
from splitknit.matching.packed import Packing
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits

SURFACE_CODE_VERSION = 1
"""Of the packed bytes; a reader refuses others."""
ZONES, PLANES = 9, 4
NATURAL = np.arange(ZONES, dtype=np.uint8)
GRAY = NATURAL ^ (NATURAL >> 1)
CODINGS = {"gray": GRAY, "binary": NATURAL}
LARGEST_SIDE_PX = 4096
_PACKING = Packing(
    "surface code", b"SKSC", SURFACE_CODE_VERSION, "HHH", "make it from the surface again.", plural=False
)


CODE_PITCH_MM = 0.1
"""Of the grid of places; a ridge's period has four to five of them."""
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
    """A smaller code is a failure to acquire."""


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
            f"a surface code must be (H, W) uint8 with a mask alike, but they are {self.code.shape} {self.code.dtype} "
            f"and {self.mask.shape}.",
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
    """Code of a shape index on an upright grid of the settings' pitch.

    Parameters
    ----------
    shape_index : (H, W) 0 to 1; ignored where it is NaN or outside `mask`
    mask : (H, W) bool
    settings : SurfaceCodeSettings, optional

    References
    ----------
    A. Kumar and C. Kwong, "Towards contactless, low-cost and accurate 3D fingerprint identification", IEEE Trans. PAMI
    37(3), 2015: finger surface codes; V. Kanhangad, A. Kumar and D. Zhang, "A unified framework for contactless hand
    verification", IEEE Trans. IFS 6(3), 2011: nine surface types in four bits; J. Koenderink and A. van Doorn, "Surface
    shape and curvature scales", Image and Vision Computing 10, 1992. Which bits stand for which type is not printed
    where we could read it: the Gray code is ours.

    Examples
    --------
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


def packed_planes(code: NDArray[np.uint8], mask: BoolArray) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
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


def _body_size(rows: int, columns: int, pitch_um: int) -> int:
    """Bytes of mask and planes; none where there is no scale, or more places than a finger has."""
    possible = pitch_um > 0 and max(rows, columns) <= LARGEST_SIDE_PX
    return (1 + PLANES) * ((rows * columns + 7) // 8) if possible else 0


def unpack_surface_code(data: bytes) -> SurfaceCode:
    """Read what :func:`pack_surface_code` wrote.

    Raises
    ------
    BadInput
        If the bytes are damaged, of another version, or no surface code.

    Examples
    --------
    >>> unpack_surface_code(b"").empty
    True
    """
    if not data:
        return SurfaceCode(np.zeros((1, 1), np.uint8), np.zeros((1, 1), np.bool_), CODE_PITCH_MM)
    (rows, columns, pitch_um), body = _PACKING.unpack(data, _body_size)
    size = len(body) // (1 + PLANES)
    words = np.frombuffer(body, np.uint8).reshape(1 + PLANES, size)
    mask, *planes = np.unpackbits(words, axis=1, count=rows * columns).reshape(1 + PLANES, rows, columns)
    code = sum((plane << number for number, plane in enumerate(planes)), np.zeros((rows, columns), np.uint8))
    return SurfaceCode(np.asarray(code, dtype=np.uint8), mask.astype(np.bool_), pitch_um / 1000)


def _words(bits: NDArray[np.uint8] | BoolArray) -> NDArray[np.uint64]:
    return np.ascontiguousarray(np.packbits(bits.astype(np.bool_), axis=-1)).view(np.uint64)
