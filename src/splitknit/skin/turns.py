"""How the fields that the networks of the `metric` method see turn with the image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
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
        return self.turned_in_place(np.array(fields, dtype=np.float32, order="C"), way)

    def turned_in_place(self, fields: FloatArray, way: int) -> FloatArray:
        """The same in the memory of `fields` (contiguous), which are lost."""
        marks = np.arange(1, len(fields) + 1, dtype=np.float32)[:, None, None]  # numbered, to see where each goes
        if way & 1:
            marks = self.mirrored(marks)
        if way & 2:
            marks = self.transposed(self.mirrored(self.transposed(marks)))  # top and bottom swapped
        if way & 4:
            marks = self.transposed(marks)
        down, across = (slice(None, None, -1 if way & bit else 1) for bit in (2, 1))
        rows, columns = fields.shape[1:]
        turned = fields.reshape(-1, columns, rows) if way & 4 else fields
        sources = np.abs(marks.ravel()).astype(np.intp) - 1
        waiting: dict[int, FloatArray] = {}
        for k, (source, mark) in enumerate(zip(sources.tolist(), marks.ravel(), strict=True)):
            field = waiting.pop(source) if source in waiting else fields[source].copy()
            if k in sources[k + 1 :]:
                waiting[k] = fields[k].copy()
            seen = cv2.transpose(field)[across, down] if way & 4 else field[down, across]
            np.multiply(seen, np.sign(mark), out=turned[k])
        return turned

    def turned_back(self, fields: FloatArray, way: int) -> FloatArray:
        """Undo :meth:`turned_by`."""
        return self.turned_by(fields, {5: 6, 6: 5}.get(way, way))


def between(first: int, second: int) -> int:
    """The way (0 to 7) that leads from fields laid down in the `first` way to the same laid down in the `second`."""
    plain = Turns(vectors=(), second_waves=(), third_waves=())
    square = np.arange(4, dtype=np.float32).reshape(1, 2, 2)
    laid, wanted = (plain.turned_by(square, way) for way in (first, second))
    return next(way for way in range(8) if np.array_equal(plain.turned_by(laid, way), wanted))
