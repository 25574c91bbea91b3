"""Finger surface codes after Kumar and Kwong: what kind of surface lies at each place, in four
bits.

    python validation/published/surface_code.py A B [--preset kumar]
    python validation/published/surface_code.py PEOPLE --out scores.csv

The shape index (0 a cup, 0.25 a valley, 0.5 a saddle, 0.75 a ridge, 1 a cap) falls into nine zones,
each with a Gray code of four bits. The score is 1 - the smallest fraction of unequal bits over
shifts and small turns: all are tried on a coarser grid by Fourier transforms, and counted around
the best of these at the full grid.

A. Kumar and C. Kwong, IEEE Trans. PAMI 37(3), 2015; V. Kanhangad, A. Kumar and D. Zhang, IEEE
Trans. IFS 6(3), 2011 (nine surface types in four bits). Which bits stand for which type, and turns,
are our choice.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scored import run, surface_at

from splitknit.imaging.geometry import smoothed
from splitknit.model import BoolArray, FloatArray
from splitknit.reconstruction import Surface
from splitknit_match.prints.curvature import REFERENCE_PX_PER_MM, curvature

ZONES = 9
"""Zones of the shape index."""
PLANES = 4
"""Bits of a code, one a plane."""
PITCH_MM = 0.1
"""Pitch of the grid of places."""
COARSE_MM = 0.15
"""Pitch of the first level of the search."""
SMOOTH_MM = 0.03
"""Sigma over the surface before its curvature is taken."""
WINDOW_MM = 0.25
"""Side of the window to which quadratics are fitted."""
MIN_AREA_MM2 = 30.0
"""A smaller code is a failure to acquire."""
MAX_TURN_DEG = 18.0
TURN_STEP_DEG = 3.0
MAX_SHIFT_MM = (5.0, 3.0)
"""Largest shifts along and across the finger."""
CANDIDATES = 2
"""Turns and shifts that are counted exactly."""
MIN_OVERLAP = 0.4
"""Fraction of the smaller finger that must overlap."""


class Code:
    """Codes (H, W) and where there is one, upright."""

    def __init__(self, code: NDArray[np.uint8], mask: BoolArray) -> None:
        self.code, self.mask = code, mask
        self.area = int(np.count_nonzero(mask))
        self.turned = cache(self._turned)
        self.planes = cache(self._planes)

    def grid(self, pitch_mm: float) -> tuple[int, int]:
        """Rows and columns of a grid that holds the code and a little more, both odd."""
        rows, columns = (
            2 * int(side * 1.1 * PITCH_MM / pitch_mm / 2) + 1 for side in self.code.shape
        )
        return rows, columns

    def _turned(self, turn_deg: float, pitch_mm: float) -> tuple[NDArray[np.uint8], BoolArray]:
        """Code and mask on a grid of this pitch about the middle, turned counter-clockwise; far
        corners are lost."""
        scale = pitch_mm / PITCH_MM
        rows, columns = self.grid(pitch_mm)
        cosine, sine = (scale * f(np.deg2rad(turn_deg)) for f in (np.cos, np.sin))
        back = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0]])
        middle = (np.array(self.code.shape[::-1]) - 1) / 2
        back[:, 2] = middle - back[:, :2] @ np.array([(columns - 1) / 2, (rows - 1) / 2])
        both = self.code | (self.mask.astype(np.uint8) << 7)
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        there = np.asarray(cv2.warpAffine(both, back, (columns, rows), flags=flags), dtype=np.uint8)
        return there & np.uint8(15), (there >> np.uint8(7)).astype(np.bool_)

    def _planes(
        self, turn_deg: float, size: tuple[int, int]
    ) -> tuple[NDArray[np.complex64], NDArray[np.complex64]]:
        """Transforms of the coarse planes (4, ...), as plus and minus one, zero without a code; and
        the mask's."""
        code, mask = self.turned(turn_deg, COARSE_MM)
        signs = [np.where(mask, 1.0 - 2.0 * ((code >> plane) & 1), 0.0) for plane in range(PLANES)]
        return tuple(
            scipy.fft.rfft2(np.asarray(part, np.float32), size) for part in (np.stack(signs), mask)
        )  # type: ignore[return-value]


def code_of(index: FloatArray, mask: BoolArray) -> Code | None:
    """Code of a shape index (H, W) on an upright grid; NaN has none. None where it is too small."""
    known = mask & np.isfinite(index)
    zone = np.floor(np.clip(np.where(known, index, 0.0), 0.0, 1.0) * (ZONES - 1) + 0.5).astype(
        np.uint8
    )
    code = np.where(known, zone ^ (zone >> 1), 0).astype(np.uint8)
    return Code(code, known) if np.count_nonzero(known) * PITCH_MM**2 >= MIN_AREA_MM2 else None


def surface_code(surface: Surface) -> Code | None:
    """Code of the shape index of a smoothed surface, on an upright grid about its middle."""
    height = smoothed(
        surface.shape_mm + surface.ridge_mm, surface.mask, SMOOTH_MM / surface.pitch_mm
    )
    index = curvature(
        height, surface.mask, surface.pitch_mm, window_px=WINDOW_MM * REFERENCE_PX_PER_MM
    ).shape_index
    step = PITCH_MM / surface.pitch_mm
    rows, columns = (max(1, round(side / step)) for side in surface.upright_size)
    across, down = (
        (size - 1) / 2 - step * (count - 1) / 2
        for size, count in zip(surface.upright_size[::-1], (columns, rows), strict=True)
    )
    matrix = surface.input_from_upright @ np.array(
        [[step, 0.0, across], [0.0, step, down], [0.0, 0.0, 1.0]]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    there = cv2.warpAffine(
        index, matrix[:2], (columns, rows), flags=flags, borderValue=float("nan")
    )
    return code_of(np.asarray(there, np.float32), np.isfinite(there))


def similarity(a: Code, b: Code) -> float:
    """1 - the fraction of unequal bits at the best shift and turn; 0 where the two cannot overlap
    enough."""
    if a.code.tobytes() > b.code.tobytes():  # the order of the two changes nothing
        a, b = b, a
    least = MIN_OVERLAP * min(a.area, b.area)
    return 1.0 - min(
        (_counted(a, b, candidate, least) for candidate in _candidates(a, b, least)), default=1.0
    )


def _candidates(a: Code, b: Code, least: float) -> list[tuple[float, float, float]]:
    """Turn of `a` in degrees and its shift along rows and columns in mm, of the best of the first
    level.

    The overlap is taken to be that of the outlines as they came, whatever the turn.
    """
    grids = a.grid(COARSE_MM), b.grid(COARSE_MM)
    reach = [int(limit / COARSE_MM) for limit in MAX_SHIFT_MM]
    sides = [
        max(side_a, side_b, (side_a + side_b + 1) // 2 + limit)
        for side_a, side_b, limit in zip(*grids, reach, strict=True)
    ]
    # in large steps, so that the transforms of a side serve nearly all that it is compared with
    size = max(-(-sides[0] // 64) * 64, 256), max(-(-sides[1] // 64) * 64, 192)
    # both grids begin at their corner; their middles lie half the difference of the sides apart
    shifts = [np.arange(-limit, limit + 1) for limit in reach]
    chosen = np.ix_(*((shifts[k] + (grids[1][k] - grids[0][k]) // 2) % size[k] for k in (0, 1)))
    planes, outline = b.planes(0.0, size)
    common = scipy.fft.irfft2(a.planes(0.0, size)[1].conj() * outline, size)[chosen]
    common = np.maximum(np.rint(common), 1.0)
    enough = common * (COARSE_MM / PITCH_MM) ** 2 >= least
    if not bool(enough.any()):
        return []
    scored = []
    for turn in np.arange(-MAX_TURN_DEG, MAX_TURN_DEG + 0.1, TURN_STEP_DEG).tolist():
        equal = scipy.fft.irfft2((a.planes(turn, size)[0].conj() * planes).sum(axis=0), size)[
            chosen
        ]
        agreement = equal / common
        # how far above what is usual, in units of what chance gives at this overlap
        scores = np.where(
            enough, (agreement - np.median(agreement[enough])) * np.sqrt(common), -np.inf
        )
        row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
        scored.append(
            (-float(scores[row, column]), turn, int(shifts[0][row]), int(shifts[1][column]))
        )
    return [
        (turn, COARSE_MM * row, COARSE_MM * column)
        for _, turn, row, column in sorted(scored)[:CANDIDATES]
    ]


def _counted(a: Code, b: Code, start: tuple[float, float, float], least: float) -> float:
    """Smallest fraction of unequal bits around a candidate: turns within a step, shifts within a
    coarse place."""
    turned = [a.turned(start[0] + TURN_STEP_DEG * k / 4, PITCH_MM) for k in (-2, -1, 0, 1, 2)]
    codes, masks = (np.stack(part) for part in zip(*turned, strict=True))
    code, mask = b.turned(0.0, PITCH_MM)
    near = int(COARSE_MM / PITCH_MM) + 1
    best = 1.0
    sides = zip(masks[0].shape, code.shape, start[1:], strict=True)
    down, across = (
        (side_a - side_b) // 2 - round(shift / PITCH_MM) for side_a, side_b, shift in sides
    )
    size = masks[0].shape[::-1]
    for row in range(down - near, down + near + 1):
        for column in range(across - near, across + near + 1):
            move = np.array([[1.0, 0.0, column], [0.0, 1.0, row]])
            code_b, known = (
                np.asarray(cv2.warpAffine(image, move, size, flags=cv2.INTER_NEAREST))
                for image in (code, mask.view(np.uint8))
            )
            common = masks & (known > 0)
            total = np.count_nonzero(common, axis=(1, 2))
            unequal = np.where(common, np.bitwise_count(codes ^ code_b), 0).sum(
                axis=(1, 2), dtype=np.int64
            )
            distance = np.where(total >= least, unequal / np.maximum(PLANES * total, 1), 1.0)
            best = min(best, float(distance.min()))
    return best


def features(finger: Path, preset: str) -> Code | None:
    """Code of a finger."""
    return surface_code(surface_at(finger, preset))


if __name__ == "__main__":
    raise SystemExit(run(features, similarity, "kumar"))
