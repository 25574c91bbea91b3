"""Minutiae of one finger in space, as matchers take them, and the bytes in which they are kept.

The bytes, little-endian: ``SKM3``, version and number of minutiae (uint16 each), CRC-32 of all that follows (uint32);
for each minutia x, y, z in mm, theta and phi in radians (float32 each), type and quality (a byte each). A finger
without any minutiae is zero bytes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.matching.minutiae_record import LEAST_MINUTIAE, MOST_MINUTIAE
from splitknit.matching.packed import Packing

MINUTIAE3D_VERSION = 1
"""Of the packed bytes; a reader refuses others."""
_PACKING = Packing("minutiae in space", b"SKM3", MINUTIAE3D_VERSION, "H", "make them from the surface again.")
_ROW = np.dtype([(name, "<f4") for name in ("x", "y", "z", "theta", "phi")] + [("type", "u1"), ("quality", "u1")])


@dataclass(frozen=True, slots=True, eq=False)
class SpaceMinutiae:
    """N minutiae of one finger, in any right-handed frame.

    As :class:`splitknit.io.minutiae3d.Minutiae3D` has them: the upright finger's frame where they come from a
    reconstruction (x to the right, y to the tip, z to the camera).
    """

    position_mm: NDArray[np.float64]
    """(N, 3)."""
    theta_rad: NDArray[np.float64]
    """(N,) azimuth of the minutia's direction, counter-clockwise from x."""
    phi_rad: NDArray[np.float64]
    """(N,) its elevation above the plane of x and y, in [-pi/2, pi/2]."""
    type: NDArray[np.uint8]
    """(N,) 1 ridge ending, 2 bifurcation, 0 other."""
    quality: NDArray[np.uint8]
    """(N,) 0 to 100."""

    def __post_init__(self) -> None:
        count = len(self.theta_rad)
        require(
            self.position_mm.shape == (count, 3)
            and all(one.shape == (count,) for one in (self.theta_rad, self.phi_rad, self.type, self.quality)),
            "minutiae in space must be (N, 3) places and lists of N angles, types and qualities; give them alike.",
        )
        require(count <= MOST_MINUTIAE, f"a finger has no {count} minutiae (at most {MOST_MINUTIAE} are compared).")
        finite = all(np.isfinite(one).all() for one in (self.position_mm, self.theta_rad, self.phi_rad))
        require(finite, "places and angles of minutiae in space must be finite; leave out those that are not known.")

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.theta_rad)

    @property
    def acquired(self) -> bool:
        """Whether they are enough to be compared (ten, as in the plane); false is a failure to acquire."""
        return self.count >= LEAST_MINUTIAE

    @property
    def direction(self) -> NDArray[np.float64]:
        """(N, 3) unit vectors."""
        flat = np.cos(self.phi_rad)
        return np.stack([flat * np.cos(self.theta_rad), flat * np.sin(self.theta_rad), np.sin(self.phi_rad)], axis=-1)


def no_space_minutiae() -> SpaceMinutiae:
    """Return what a finger without minutiae gives: a failure to acquire."""
    none, small = np.zeros(0), np.zeros(0, dtype=np.uint8)
    return SpaceMinutiae(np.zeros((0, 3)), none, none, small, small)


def pack_space_minutiae(minutiae: SpaceMinutiae) -> bytes:
    """Bytes of minutiae, 12 and 22 for each; none where there are none. Numbers keep single precision."""
    if not minutiae.count:
        return b""
    table = np.zeros(minutiae.count, dtype=_ROW)
    for axis, name in enumerate("xyz"):
        table[name] = minutiae.position_mm[:, axis]
    table["theta"], table["phi"] = minutiae.theta_rad, minutiae.phi_rad
    table["type"], table["quality"] = minutiae.type, minutiae.quality
    body = table.tobytes()
    return _PACKING.pack((minutiae.count,), body)


def unpack_space_minutiae(data: bytes) -> SpaceMinutiae:
    """Read what :func:`pack_space_minutiae` wrote.

    Raises
    ------
    BadInput
        If the bytes are damaged, of another version, or no minutiae in space.

    Examples
    --------
    >>> unpack_space_minutiae(b"").acquired
    False
    """
    if not data:
        return no_space_minutiae()
    _, body = _PACKING.unpack(data, lambda count: count * _ROW.itemsize)
    table = np.frombuffer(body, dtype=_ROW)
    with np.errstate(invalid="ignore"):  # NaN is refused below
        numbers = np.stack([table[name] for name in ("x", "y", "z", "theta", "phi")], axis=1).astype(np.float64)
    return SpaceMinutiae(numbers[:, :3], numbers[:, 3], numbers[:, 4], table["type"].copy(), table["quality"].copy())
