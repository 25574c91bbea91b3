"""Minutiae for chip cards (ISO/IEC 19794-2:2005): bare lists without any header, in millimetres instead of pixels.

Normal size, 5 bytes a minutia: 2 bits type and 14 of x, 2 bits 0 and 14 of y (0.01 mm, big-endian), direction in 256
steps. Compact size, 3 bytes: x, y (0.1 mm), 2 bits type and 6 of direction in 64 steps. Quality, finger and image are
not kept: the card and what surrounds the list know them. A list has no mark by which it could be told from other bytes.

References
----------
ISO/IEC 19794-2:2005, clause 8 (finger minutiae card formats).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.io.minutiae_record import BIFURCATION, MOST_MINUTIAE, FingerView

_NORMAL = np.dtype([("x", ">u2"), ("y", ">u2"), ("direction", "u1")])
_COMPACT = np.dtype([("x", "u1"), ("y", "u1"), ("packed", "u1")])
_NORMAL_MM, _COMPACT_MM = 0.01, 0.1
_NORMAL_STEPS, _COMPACT_STEPS = 256, 64


def encode_card(view: FingerView, compact: bool = True) -> bytes:
    """Bytes of a view's minutiae for a card: 3 bytes each where `compact`, 5 otherwise.

    Raises
    ------
    BadInput
        If there are more than 255, or one lies further right or down than the format reaches (25.5 mm, 163.83 mm).
    """
    require(
        view.count <= MOST_MINUTIAE, f"a card takes at most {MOST_MINUTIAE} minutiae, not {view.count}; see best()."
    )
    unit, steps, largest = (_COMPACT_MM, _COMPACT_STEPS, 255) if compact else (_NORMAL_MM, _NORMAL_STEPS, 16383)
    x_ppcm, y_ppcm = view.resolution_ppcm
    x, y = (
        np.round(np.asarray(pixels) * (10 / ppcm / unit)).astype(np.int64)
        for pixels, ppcm in ((view.x_px, x_ppcm), (view.y_px, y_ppcm))
    )
    reach = max((int(np.max(x)), int(np.max(y)))) if view.count else 0
    require(
        reach <= largest,
        f"a minutia lies {reach * unit:.1f} mm from the image's edge, but this format reaches {largest * unit:.2f} mm; "
        "crop the print.",
    )
    direction = np.round(np.asarray(view.direction_rad) * (steps / (2 * np.pi))).astype(np.int64) % steps
    table = np.zeros(view.count, dtype=_COMPACT if compact else _NORMAL)
    kind = np.asarray(view.type).astype(np.int64)
    if compact:
        table["x"], table["y"], table["packed"] = x, y, kind << 6 | direction
    else:
        table["x"], table["y"], table["direction"] = kind << 14 | x, y, direction
    return table.tobytes()


def decode_card(
    data: bytes, size: tuple[int, int], ppcm: tuple[int, int], compact: bool = True, name: str = "the list"
) -> FingerView:
    """Read minutiae of a card onto the pixels of an image.

    Parameters
    ----------
    data : the list
    size : (rows, columns) of the image
    ppcm : its pixels per cm along columns and rows
    compact : 3 bytes a minutia, otherwise 5
    name : of the list, for messages

    Returns
    -------
    FingerView
        Of an unknown finger and impression, with qualities of 0.

    Raises
    ------
    BadInput
        If the length is not that of a list, a reserved bit or type is used, or a minutia lies outside the image.
    """
    row = _COMPACT if compact else _NORMAL
    count, rest = divmod(len(data), row.itemsize)
    require(
        rest == 0 and count <= MOST_MINUTIAE,
        f"{name} has {len(data)} bytes, which is no list of at most {MOST_MINUTIAE} minutiae of {row.itemsize}.",
    )
    table = np.frombuffer(data, dtype=row)
    if compact:
        unit, steps, kind, direction = _COMPACT_MM, _COMPACT_STEPS, table["packed"] >> 6, table["packed"] & 63
        x, y = table["x"], table["y"]
    else:
        unit, steps, kind, direction = _NORMAL_MM, _NORMAL_STEPS, table["x"] >> 14, table["direction"]
        x, y = table["x"] & 16383, table["y"]
        require(not bool((y >> 14).any()), f"{name}: the reserved bits of a minutia are not zero.")
    require(not bool((kind > BIFURCATION).any()), f"{name}: a minutia has the reserved type 3.")
    require(min(ppcm) > 0, f"the resolution must be positive, but it is {ppcm} pixels per cm.")
    none: NDArray[np.uint8] = np.zeros(count, dtype=np.uint8)
    return FingerView(
        np.round(x * (unit * ppcm[0] / 10)).astype(np.int32),
        np.round(y * (unit * ppcm[1] / 10)).astype(np.int32),
        direction.astype(np.float64) * (2 * np.pi / steps),
        kind.astype(np.uint8),
        none,
        size,
        finger_quality=0,
        impression="unknown",
        resolution_ppcm=ppcm,
    )
