"""Test-time augmentation: the mean of a network's outputs on several orientations of its input."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from splitknit.model import FloatArray

QUARTER_TURNS = (0, 5, 3, 6)
"""Orientations turned by 0, 90, 180 and 270 degrees. Source: definition."""
_INVERSE = (0, 1, 2, 3, 4, 6, 5, 7)
"""The orientation that undoes each. Source: definition."""

_Pairs = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class Symmetry:
    """How fields (n, h, w) change when the image is turned or mirrored; those that are not named
    are scalars."""

    vectors: _Pairs
    """Pairs of fields that are a vector's x and y (up), or cos a and sin a of its azimuth."""
    second_harmonics: _Pairs
    """Pairs of fields that are parts of cos 2a and sin 2a."""
    third_harmonics: _Pairs
    """Pairs of fields that are parts of cos 3a and sin 3a."""

    def flipped(self, fields: FloatArray) -> FloatArray:
        """Swap left and right: x becomes -x, an azimuth a becomes pi - a."""
        turned: FloatArray = np.array(fields[:, :, ::-1], dtype=np.float32)
        for x, _ in self.vectors:
            turned[x] *= -1
        for _, sine in self.second_harmonics:
            turned[sine] *= -1
        for cosine, _ in self.third_harmonics:
            turned[cosine] *= -1
        return turned

    def transposed(self, fields: FloatArray) -> FloatArray:
        """Swap rows and columns: (x, y) becomes (-y, -x), for y points up against the rows; a
        becomes 3 pi / 2 - a."""
        old = fields.swapaxes(1, 2)
        turned = old.copy()
        for x, y in self.vectors:
            turned[x], turned[y] = -old[y], -old[x]
        for cosine, _ in self.second_harmonics:
            turned[cosine] *= -1
        for cosine, sine in self.third_harmonics:
            turned[cosine], turned[sine] = old[sine], old[cosine]
        return turned

    def oriented(self, fields: FloatArray, orientation: int) -> FloatArray:
        """Fields in one of the eight orientations of a square (0 to 7)."""
        return self.oriented_in_place(np.array(fields, dtype=np.float32, order="C"), orientation)

    def oriented_in_place(self, fields: FloatArray, orientation: int) -> FloatArray:
        """The same in the memory of `fields` (contiguous), which are lost."""
        # numbered, to see where each goes
        marks = np.arange(1, len(fields) + 1, dtype=np.float32)[:, None, None]
        if orientation & 1:
            marks = self.flipped(marks)
        if orientation & 2:
            marks = self.transposed(self.flipped(self.transposed(marks)))  # top and bottom swapped
        if orientation & 4:
            marks = self.transposed(marks)
        down, across = (slice(None, None, -1 if orientation & bit else 1) for bit in (2, 1))
        rows, columns = fields.shape[1:]
        turned = fields.reshape(-1, columns, rows) if orientation & 4 else fields
        sources = np.abs(marks.ravel()).astype(np.intp) - 1
        swapped = np.flatnonzero(sources != np.arange(len(fields)))
        fields[swapped] = fields[sources[swapped]]
        for field, result, mark in zip(fields, turned, marks.ravel(), strict=True):
            copy = field.copy()
            moved = cv2.transpose(copy)[across, down] if orientation & 4 else copy[down, across]
            np.multiply(moved, np.sign(mark), out=result)
        return turned

    def restored(self, fields: FloatArray, orientation: int) -> FloatArray:
        """Undo :meth:`oriented`."""
        return self.oriented(fields, _INVERSE[orientation]) if orientation else fields


def mean_over_orientations(
    network: Callable[[FloatArray], FloatArray],
    fields: FloatArray,
    symmetries: tuple[Symmetry, Symmetry],
    orientations: Sequence[int],
    earlier: FloatArray | None = None,
) -> FloatArray:
    """Mean of a network's output (m, h, w) over `orientations` (of the eight, 0 to 7) of its input
    `fields` (n, h, w).

    `fields`, contiguous float32, is turned in place: beside the network, which needs most memory,
    there is no copy. `symmetries`: of the network's input and of its output; `earlier`: output in
    one more orientation.
    """
    outputs = [] if earlier is None else [earlier]
    for orientation in orientations:
        fields = symmetries[0].oriented_in_place(fields, orientation)
        outputs.append(symmetries[1].restored(network(fields), orientation))
        fields = symmetries[0].oriented_in_place(fields, _INVERSE[orientation])
    return np.asarray(sum(outputs) / len(outputs))


_MAX_RESTORED = 0.25  # largest power that is restored, over the estimate's own


def shrinkage_gain(rms: float, error: float) -> float:
    """Factor sqrt(1 + error^2 / rms^2), at most sqrt(1 + `_MAX_RESTORED`), that restores the
    variance lost by a minimum-mean-square-error estimate (a posterior mean). `rms`: of the
    estimate; `error`: expected.
    """
    return float(np.sqrt(1 + min((error / max(rms, 1e-6)) ** 2, _MAX_RESTORED)))
