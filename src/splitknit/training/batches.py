"""Patches from photographs: cut, turned, shifted, and stacked into batches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.training.data import Photograph
from splitknit.training.settings import TrainSettings

SHIFT_PX = 8
"""Random translation of a patch, each way."""
TURNED = 0.5
"""Part of the patches that are turned by any angle, which smooths their noise; the others by quarter turns."""

Batch = tuple[FloatArray, FloatArray]
"""Input and target, (B, 3, side, side)."""


class Patches:
    """All patches of a data set, in an order that can be shuffled."""

    def __init__(self, photographs: Sequence[Photograph], side: int) -> None:
        """Number the patches of `photographs`, each `side` pixels a side."""
        require(len(photographs) > 0, "there are no photographs to train on.")
        self.photographs, self.side = photographs, side
        self._owner = np.concatenate([np.full(len(p.corners), k) for k, p in enumerate(photographs)])
        self._corners = np.concatenate([p.corners for p in photographs])

    def __len__(self) -> int:
        return len(self._owner)

    def shuffled(self, settings: TrainSettings, epoch: int) -> Iterator[Batch]:
        """Yield the batches of one epoch: every patch once, augmented; the last, smaller batch too."""
        rng = np.random.default_rng(np.random.SeedSequence([settings.seed, 0xBA, epoch]))
        order = rng.permutation(len(self))
        for first in range(0, len(order), settings.batch):
            chosen = order[first : first + settings.batch]
            enhanced = rng.random(len(chosen)) < settings.enhanced_share
            yield _stacked([self._augmented(k, rng) for k in chosen], enhanced)

    def fixed(self, enhanced: bool, batch: int) -> Iterator[Batch]:
        """Yield all patches in their order as they are, linear or enhanced."""
        for first in range(0, len(self), batch):
            chosen = range(first, min(first + batch, len(self)))
            pieces = [self._plain(k) for k in chosen]
            yield _stacked(pieces, np.full(len(pieces), enhanced))

    def _plain(self, k: int) -> FloatArray:
        row, column = self._corners[k]
        pixels = self.photographs[self._owner[k]].pixels
        return np.asarray(pixels[row : row + self.side, column : column + self.side], dtype=np.float32)

    def _augmented(self, k: int, rng: np.random.Generator) -> FloatArray:
        """(side, side, 8) patch k, shifted, turned and mirrored."""
        pixels = self.photographs[self._owner[k]].pixels
        height, width = pixels.shape[:2]
        shift = rng.integers(-SHIFT_PX, SHIFT_PX + 1, 2)
        row, column = np.clip(self._corners[k] + shift, 0, (height - self.side, width - self.side))
        if rng.random() < TURNED:
            piece = _turned(pixels, (int(row), int(column)), self.side, 360.0 * rng.random())
        else:
            piece = np.asarray(pixels[row : row + self.side, column : column + self.side], dtype=np.float32)
            piece = np.rot90(piece, int(rng.integers(4)))
        if rng.random() < 0.5:
            piece = piece[:, ::-1]
        return piece


def _turned(pixels: NDArray[np.float16], corner: tuple[int, int], side: int, angle_deg: float) -> FloatArray:
    """The patch at `corner`, turned about its middle; black where the photograph ends."""
    around = int(np.ceil(0.5 * (np.sqrt(2.0) - 1.0) * side)) + 2
    window, padding = [], []
    for start, length in zip(corner, pixels.shape[:2], strict=True):
        low, high = start - around, start + side + around
        window.append(slice(max(low, 0), min(high, length)))
        padding.append((max(-low, 0), max(high - length, 0)))
    source = np.pad(np.asarray(pixels[tuple(window)], dtype=np.float32), (*padding, (0, 0)))
    middle = 0.5 * (source.shape[0] - 1)
    matrix = cv2.getRotationMatrix2D((middle, middle), angle_deg, 1.0)
    matrix[:, 2] -= around
    halves = (source[..., :4], source[..., 4:])  # OpenCV turns four channels at a time
    turned = [
        cv2.warpAffine(np.ascontiguousarray(half), matrix, (side, side), flags=cv2.INTER_LINEAR) for half in halves
    ]
    return np.concatenate(turned, axis=2)


def _stacked(pieces: Sequence[FloatArray], enhanced: NDArray[np.bool_]) -> Batch:
    """Input and target of each piece: linear colours, or three times the enhanced grey."""
    inputs, targets = [], []
    for piece, grey in zip(pieces, enhanced, strict=True):
        image, direct = (piece[..., [6, 6, 6]], piece[..., [7, 7, 7]]) if grey else (piece[..., :3], piece[..., 3:6])
        inputs.append(image.transpose(2, 0, 1))
        targets.append(direct.transpose(2, 0, 1))
    return np.stack(inputs), np.stack(targets)
