"""How the fields that the networks of the `metric` method see turn with the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.model import FloatArray

_Pairs = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class Turns:
    """Which fields (n, h, w) turn with the image, and how; all others are scalars."""

    vectors: _Pairs
    """Pairs of fields that are a vector's x and y (up), or cos a and sin a of its azimuth."""
    second_waves: _Pairs
    """Pairs of fields that are parts of cos 2a and sin 2a."""
    third_waves: _Pairs
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
        """One of the eight orientations (0 to 7) to lay down a square."""
        if way & 1:
            fields = self.mirrored(fields)
        if way & 2:
            fields = self.transposed(self.mirrored(self.transposed(fields)))  # top and bottom swapped
        return self.transposed(fields) if way & 4 else fields

    def turned_back(self, fields: FloatArray, way: int) -> FloatArray:
        """Undo :meth:`turned_by`."""
        if way & 4:
            fields = self.transposed(fields)
        return self.turned_by(fields, way & 3)
