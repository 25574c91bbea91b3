"""Several touches of a small sensor as one wider template: each laid on what is joined already, the surest first.

A touch that fits nowhere stands beside the others, where a print is compared with it alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import bounding_box
from splitknit_match.matching.elastic import rigid
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.minutiae_record import PPI, Minutiae, no_minutiae
from splitknit_match.matching.template import Template, leveled, print_size

_JOINED = 1.5
"""Log-likelihood ratio from which on a touch is joined."""
_GAP_MM, _WIDEST_MM = 3.0, 25.0
"""Between touches that were not joined, and how wide they stand."""
_SAME_MM = 0.6
"""Minutiae of two touches that lie so near are one."""


def join_touches(touches: Sequence[Template]) -> tuple[Template, int]:
    """One template of several touches, in any order, and how many of them were joined to the largest."""
    order = sorted(range(len(touches)), key=lambda k: (-touches[k].area_mm2, k))
    left = [touches[k] for k in order if not touches[k].empty]
    if not left:
        return touches[0], 0
    whole, joined = left.pop(0), 1
    while left:
        found = [fused_match(one, whole) for one in left]
        best = max(range(len(left)), key=lambda k: (found[k].similarity, -k))
        if found[best].similarity < _JOINED:
            break
        laid = found[best].ridge
        whole = _added(whole, left.pop(best), np.deg2rad(laid.rotation_deg), (laid.right_mm, laid.up_mm))
        joined += 1
    right = down = 0.0
    below = whole.valid.shape[0] * whole.pitch_mm + _GAP_MM
    for one in left:  # beside each other, below what is joined
        high, wide = (side * one.pitch_mm for side in one.valid.shape)
        if right + wide > _WIDEST_MM:
            right, down = 0.0, down + high + _GAP_MM
        up, aside = (side * whole.pitch_mm / 2 for side in whole.valid.shape)
        place = right + wide / 2 - aside, up - (below + down + high / 2)
        whole, right = _added(whole, one, 0.0, place), right + wide + _GAP_MM
    return whole, joined


def _added(whole: Template, one: Template, angle_rad: float, middle_mm: tuple[float, float]) -> Template:
    """`whole` with what `one` shows beyond it: turned counter-clockwise, its middle right and up of the other's."""
    pitch = whole.pitch_mm
    affine = rigid(one.valid.shape, whole.valid.shape, angle_rad, (middle_mm[0] / pitch, -middle_mm[1] / pitch))
    rows, columns = one.valid.shape
    corners = np.array([[-1, -1], [columns, -1], [-1, rows], [columns, rows]]) - affine[:, 2]
    there = np.linalg.solve(affine[:, :2], corners.T).T
    first = np.minimum(np.floor(there.min(axis=0)), 0).astype(int)
    last = np.maximum(np.ceil(there.max(axis=0)) + 1, whole.valid.shape[::-1]).astype(int)
    size = tuple((last - first).tolist())
    moved = affine.copy()
    moved[:, 2] += affine[:, :2] @ first
    how = cv2.WARP_INVERSE_MAP
    value = np.asarray(cv2.warpAffine(one.value(), moved, size, flags=cv2.INTER_LINEAR | how), np.float32)
    valid = np.asarray(cv2.warpAffine(one.valid.view(np.uint8), moved, size, flags=cv2.INTER_NEAREST | how)) > 0
    known = tuple(slice(-start, -start + length) for start, length in zip(first[::-1], whole.valid.shape, strict=True))
    value[known], fresh = np.where(whole.valid, whole.value(), value[known]), valid.copy()
    valid[known] |= whole.valid
    fresh[known] &= ~whole.valid
    box = bounding_box(valid)
    made = leveled(value[box], np.ascontiguousarray(valid[box]), pitch)
    cut = np.array([box[1].start, box[0].start]) + first
    middle = np.array([(side - 1) / 2 for side in whole.valid.shape[::-1]]) - cut
    back = np.array([(side - 1) / 2 for side in made.valid.shape[::-1]])
    shift = (middle - back) * pitch * (1, -1)  # of the middle of `whole` from the middle of what is made
    places = [_placed(whole, 0.0, shift), _placed(one, angle_rad, shift + np.array(middle_mm))]
    return replace(made, minutiae=_together(places, print_size(made)))


_Places = tuple[NDArray[np.complex128], NDArray[np.float64], Minutiae]


def _placed(side: Template, angle_rad: float, shift_mm: NDArray[np.float64]) -> _Places:
    """Places (mm right, and up times i, as a camera sees them) and directions of minutiae, turned and moved."""
    found = side.minutiae or no_minutiae()
    place = (-found.x_mm + 1j * found.y_mm) * np.exp(1j * angle_rad) + complex(*shift_mm)
    return place, np.pi - found.direction_rad + angle_rad, found


def _together(parts: Sequence[_Places], size: tuple[int, int]) -> Minutiae:
    """Minutiae of both on a grid of `size`; of two that lie near each other the first."""
    (place, turn, first), (other, other_turn, second) = parts
    gap = np.abs(other[:, None] - place[None]).min(axis=1, initial=np.inf)
    new = gap > _SAME_MM
    place, turn = np.concatenate([place, other[new]]), np.concatenate([turn, other_turn[new]])
    step = PPI / 25.4
    x = np.rint((size[1] - 1) / 2 - step * place.real).astype(np.int32)
    y = np.rint((size[0] - 1) / 2 - step * place.imag).astype(np.int32)
    kind, quality = (np.concatenate([getattr(first, name), getattr(second, name)[new]]) for name in ("type", "quality"))
    inside = np.flatnonzero((x >= 0) & (y >= 0) & (x < size[1]) & (y < size[0]))
    kept = inside[np.lexsort((x[inside], y[inside]))]
    return Minutiae(x[kept], y[kept], (np.pi - turn[kept]) % (2 * np.pi), kind[kept], quality[kept], size)
