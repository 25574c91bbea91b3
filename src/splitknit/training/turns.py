"""The eight ways to lay down a square of fields, some of which are vectors and waves over an azimuth.

A finger and its mirror image are equally likely, and so are a capture and its quarter turns; vectors and waves of the
light's azimuth turn with the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.model import FloatArray

Pairs = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class Turns:
    """Which fields (n, h, w) turn with the image, and how; all others are scalars."""

    vectors: Pairs
    """Pairs of fields that are a vector's x and y (up), or cos a and sin a of its azimuth."""
    second_waves: Pairs
    """Pairs of fields that are parts of cos 2a and sin 2a."""
    third_waves: Pairs
    """Pairs of fields that are parts of cos 3a and sin 3a."""

    def mirrored(self, fields: FloatArray) -> FloatArray:
        """Swap left and right: x becomes -x, an azimuth a becomes pi - a."""
        turned: FloatArray = np.array(fields[:, :, ::-1], dtype=np.float32)
        for x, _ in self.vectors:
            turned[x] *= -1
        for _, sine in self.second_waves:
            turned[sine] *= -1
        for cosine, _ in self.third_waves:
            turned[cosine] *= -1
        return turned

    def transposed(self, fields: FloatArray) -> FloatArray:
        """Swap rows and columns: (x, y) becomes (-y, -x), for y points up against the rows; a becomes 3 pi / 2 - a."""
        old = np.asarray(fields.swapaxes(1, 2), dtype=np.float32)
        turned = old.copy()
        for x, y in self.vectors:
            turned[x], turned[y] = -old[y], -old[x]
        for cosine, _ in self.second_waves:
            turned[cosine] *= -1
        for cosine, sine in self.third_waves:
            turned[cosine], turned[sine] = old[sine], old[cosine]
        return turned

    def turned_by(self, fields: FloatArray, way: int) -> FloatArray:
        """One of the eight ways (0 to 7) to lay down a square."""
        if way & 1:
            fields = self.mirrored(fields)
        if way & 2:
            fields = self.transposed(self.mirrored(self.transposed(fields)))  # top and bottom swapped
        return self.transposed(fields) if way & 4 else fields


def cut_out(sample: FloatArray, row: int, column: int, side: int) -> FloatArray:
    """The square (n, side, side) of a sample (n, h, w) whose corner is there; zero beyond the sample."""
    first = [max(start, 0) for start in (row, column)]
    part = np.asarray(sample[:, first[0] : max(row + side, 0), first[1] : max(column + side, 0)], dtype=np.float32)
    before = [low - start for low, start in zip(first, (row, column), strict=True)]
    missing = [(low, side - low - length) for low, length in zip(before, part.shape[1:], strict=True)]
    return np.pad(part, ((0, 0), *missing)) if any(map(any, missing)) else part
