"""Which captures of a gallery may show a probe's finger: by their minutiae, looked up in hash
tables.

What lies around a minutia is a cylinder of numbers (:mod:`splitknit_match.matching.minutia_pairs`);
the signs of its products with random vectors are its keys, one a table. Minutiae of gallery and
probe that share a key vote for a rotation and a shift of their capture; rare keys count more. Of
the captures with most votes, minutiae are laid on the probe's and those that agree are counted.

Source: R. Cappelli, M. Ferrara and D. Maltoni, "Fingerprint indexing based on minutia
cylinder-code", IEEE TPAMI 33(5), 2011. Different from it: random vectors instead of chosen bits,
votes by rotation and shift, and agreeing minutiae.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import naming
from splitknit.io.images import cores
from splitknit_match.gallery.parameters import (
    AGREEMENT_WEIGHT,
    ALIGNED,
    ANGLE_RAD,
    BITS,
    CELL_MM,
    CELLS,
    COMMON,
    DISTANCE_MM,
    FEW,
    MEAN,
    PEAKS,
    RARE,
    REACH_MM2,
    ROTATED_FRACTION,
    ROTATIONS,
    TABLES,
)
from splitknit_match.matching.minutia_pairs import CYLINDER, Cylinders, Places
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template, unpack

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True, eq=False)
class CaptureMinutiae:
    """Minutiae of one capture that have a cylinder, N of them."""

    place: Places
    """(N,) x + iy, mm."""
    turn: NDArray[np.float64]
    keys: NDArray[np.uint16]
    """(N, tables)."""


@dataclass(frozen=True, slots=True, eq=False)
class _Hits:
    """Minutiae of the gallery, V of them, that share one of the probe's K keys."""

    enrolled: NDArray[np.int32]
    """(V,) minutia of the gallery."""
    key: NDArray[np.int32]
    """(V,) the key that is shared."""
    bin: NDArray[np.int32]
    """(V,) number of the capture times the steps of rotation, plus how many it is rotated by."""
    probe: NDArray[np.int64]
    """(K,) minutia of the probe that has the key."""
    weight: NDArray[np.float64]
    """(K,) of the key, more where it is rare."""


class MinutiaIndex:
    """Minutiae of captures in memory, 26 kB each. Threads may share it."""

    rows: NDArray[np.int64]
    """(M,) numbers of the captures' rows."""

    def __init__(
        self,
        templates: Mapping[int, bytes],
        gallery: Path,
        known: Mapping[int, CaptureMinutiae | None] | None = None,
    ) -> None:
        """Take templates by their rows, but those of failures to acquire.

        `known`: minutiae of some rows, of an earlier index. Raises BadInput if one is damaged.
        """
        known = known or {}

        def minutiae_of(row: int) -> CaptureMinutiae | None:
            if row in known:
                return known[row]
            side = Prepared(unpacked(gallery, row, templates[row])).cylinders
            return None if side is None else CaptureMinutiae(side.place, side.turn, _keys(side))

        rows = sorted(row for row, template in templates.items() if template)
        self.minutiae = dict(zip(rows, each(minutiae_of, rows), strict=True))
        self.others = [row for row, minutiae in self.minutiae.items() if minutiae is None]
        """Rows that hold too few minutiae to be searched."""
        indexed = {row: minutiae for row, minutiae in self.minutiae.items() if minutiae is not None}
        sides = list(indexed.values())
        place = np.concatenate([np.zeros(0, np.complex128), *(side.place for side in sides)])
        turn = np.concatenate([np.zeros(0), *(side.turn for side in sides)])
        keys = np.concatenate([np.zeros((0, TABLES), np.uint16), *(side.keys for side in sides)])
        self.rows = np.array(list(indexed), dtype=np.int64)
        self.count = np.array([len(side.turn) for side in sides], dtype=np.int64)
        self.boxes = np.array([_box(side.place) for side in sides], dtype=np.float32).reshape(-1, 4)
        self.x = place.real.astype(np.float32)
        self.y = place.imag.astype(np.float32)
        self.turn = turn.astype(np.float32)
        self.first = np.cumsum(self.count) - self.count
        # twice the steps, so that differences of rotation stay within the capture's own
        self.code = np.repeat(np.arange(len(self), dtype=np.int32), self.count) * (2 * ROTATIONS)
        self.code += _steps(self.turn) + ROTATIONS
        # of each table the minutiae in the order of their keys, and where those of a key end
        self.lists = np.stack(
            [np.argsort(table, kind="stable").astype(np.int32) for table in keys.T]
        )
        sizes = [np.bincount(table, minlength=1 << BITS) for table in keys.T]
        self.ends = np.pad(np.cumsum(sizes, axis=1), ((0, 0), (1, 0)))

    def __len__(self) -> int:
        return len(self.rows)

    def nearest(self, probe: Cylinders, k: int) -> list[int]:
        """Rows of the `k` captures that agree with the probe best, best first; equal ones by
        rows."""
        if not len(self.turn) or not len(probe.turn):
            return []
        hits = self._hits(probe)
        captures, slot = self._rotated(hits.bin)
        slots = len(captures) * PEAKS
        slot = slot.take(hits.bin)
        voting = np.flatnonzero(slot >= 0)
        slot = slot.take(voting)
        enrolled = hits.enrolled.take(voting)
        rotation = hits.bin.take(voting) % ROTATIONS
        key = hits.key.take(voting)
        minutia = hits.probe.take(key)
        weight = hits.weight.take(key)

        # votes by shift
        angles = 2j * np.pi / ROTATIONS * np.arange(ROTATIONS)
        rotated = (probe.place[:, None] * np.exp(angles)).astype(np.complex64)
        start = rotated.ravel().take(minutia * ROTATIONS + rotation)
        column = _cells(self.x.take(enrolled) - start.real)
        row = _cells(self.y.take(enrolled) - start.imag)
        votes = np.bincount(
            (slot * CELLS + column) * CELLS + row, weight, minlength=slots * CELLS**2
        )
        votes = votes.reshape(slots, CELLS, CELLS)
        votes = votes[:, 1:] + votes[:, :-1]
        votes = (votes[..., 1:] + votes[..., :-1]).reshape(len(captures), -1)
        most = votes.max(axis=1) / np.maximum(self.count[captures], 1) ** 0.25
        kept = _largest(most, max(ALIGNED, 2 * k))

        # how these lie on the probe, by the hits that voted for it
        shape = (PEAKS, CELLS - 1, CELLS - 1)
        peak, best_column, best_row = np.unravel_index(votes[kept].argmax(axis=1), shape)
        number = np.full(slots, -1)
        number[kept * PEAKS + peak] = np.arange(len(kept))
        aligned = number.take(slot)
        fits = aligned >= 0
        fits &= (column - best_column[aligned]) // 2 == 0
        fits &= (row - best_row[aligned]) // 2 == 0
        aligned = aligned[fits]
        enrolled = enrolled[fits]
        minutia = minutia[fits]
        weight = weight[fits]

        def weighted_sum(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
            real = np.bincount(aligned, weight * values.real, minlength=len(kept))
            return real + 1j * np.bincount(aligned, weight * values.imag, minlength=len(kept))

        difference = self.turn[enrolled] - probe.turn[minutia]
        turns = np.exp(1j * np.angle(weighted_sum(np.exp(1j * difference))))
        place = self.x[enrolled] + 1j * self.y[enrolled]
        shifts = weighted_sum(place - probe.place[minutia] * turns[aligned])
        shifts /= np.maximum(weighted_sum(np.ones(len(aligned), dtype=np.complex128)), 1e-9)
        agreement = self._agreement(captures[kept], probe, turns, shifts)
        score = most[kept] + AGREEMENT_WEIGHT * agreement
        rows = self.rows[captures[kept]]
        return [int(row) for row in rows[np.lexsort((rows, -score))[:k]]]

    def _hits(self, probe: Cylinders) -> _Hits:
        """Minutiae that share a key with the probe's which is not too common."""
        keys = _keys(probe)
        tables = np.arange(TABLES)
        mean = len(self.turn) / (1 << BITS)
        starts = self.ends[tables, keys]
        sizes = (self.ends[tables, keys + 1] - starts).ravel()
        # the probe's minutiae by tables
        telling = np.flatnonzero(sizes <= max(COMMON * mean, RARE))
        sizes = sizes[telling]
        starts = (starts + tables * len(self.turn)).ravel()[telling]
        lists = self.lists.ravel()
        ranges = zip(starts.tolist(), (starts + sizes).tolist(), strict=True)
        enrolled = np.concatenate([lists[:0], *(lists[start:end] for start, end in ranges)])
        minutia = telling // TABLES
        key = np.repeat(np.arange(len(telling), dtype=np.int32), sizes)
        code = self.code.take(enrolled) - _steps(probe.turn.astype(np.float32))[minutia].take(key)
        capture = code // (2 * ROTATIONS)
        rotation = code % ROTATIONS
        weight = np.sqrt(mean / np.maximum(sizes, 1))
        return _Hits(enrolled, key, capture * ROTATIONS + rotation, minutia, weight)

    def _rotated(self, bins: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """Captures with most votes for some rotation; and by bin the number of a capture's best
        rotation among all best ones, -1 for other rotations.
        """
        votes = np.bincount(bins, minlength=ROTATIONS * len(self)).reshape(-1, ROTATIONS)
        votes += np.roll(votes, -1, axis=1)
        most = votes.max(axis=1) / np.sqrt(np.maximum(self.count, 1))
        captures = _largest(most, max(ALIGNED, round(ROTATED_FRACTION * len(self))))
        number = np.arange(len(captures))
        slot = np.full((len(self), ROTATIONS), -1, dtype=np.int32)
        free = votes[captures]
        for peak in range(PEAKS):
            best = free.argmax(axis=1)
            free[number, best - 1] = -1
            for rotation in (best, (best + 1) % ROTATIONS):
                free[number, rotation] = -1
                slot[captures, rotation] = number * PEAKS + peak
        return captures, slot.ravel()

    def _agreement(
        self, captures: NDArray[np.int64], probe: Cylinders, turns: Places, shifts: Places
    ) -> NDArray[np.float64]:
        """How many minutiae agree where the probe is laid on each of C captures, over the root of
        those that could; `turns` (C,) and `shifts` (C,) lay it there.
        """
        count = self.count[captures]
        width = int(count.max())
        column = np.arange(width)
        present = column < count[:, None]
        at = np.minimum(self.first[captures][:, None] + column, len(self.turn) - 1)
        x = self.x[at]
        y = self.y[at]
        laid = (probe.place * turns[:, None] + shifts[:, None]).astype(np.complex64)
        distance = laid.real[:, :, None] - np.where(present, x, np.inf)[:, None]
        distance *= distance
        distance += (laid.imag[:, :, None] - y[:, None]) ** 2
        near = np.flatnonzero(distance < REACH_MM2)  # of captures, the probe's minutiae, their own
        of_probe = near // width
        capture = of_probe // len(probe.turn)
        of_capture = capture * width + near % width
        angle = (np.angle(turns)[:, None] + probe.turn).ravel()[of_probe] - self.turn[at].ravel()[
            of_capture
        ]
        angle -= 2 * np.pi * np.rint(angle / (2 * np.pi))
        likeness = np.exp(-distance.ravel()[near] / DISTANCE_MM**2 - (angle / ANGLE_RAD) ** 2)
        mutual = np.ones(len(near), dtype=bool)
        for minutia, size in ((of_probe, laid.size), (of_capture, x.size)):
            best = np.zeros(size)
            np.maximum.at(best, minutia, likeness)
            mutual &= likeness == best[minutia]
        agreeing = np.bincount(capture[mutual], likeness[mutual], minlength=len(captures))
        back = (x + 1j * y - shifts[:, None]) * turns.conj()[:, None]
        enrolled_overlap = (_inside(back, np.array(_box(probe.place))) & present).sum(axis=1)
        probe_overlap = _inside(laid, self.boxes[captures].T[:, :, None]).sum(axis=1)
        return np.asarray(agreeing / np.sqrt(np.sqrt(enrolled_overlap * probe_overlap) + FEW))


@cache
def _vectors() -> NDArray[np.float32]:
    rng = np.random.default_rng(1)
    return rng.standard_normal((CYLINDER, TABLES * BITS), dtype=np.float32)


def _keys(side: Cylinders) -> NDArray[np.uint16]:
    """(N, tables) of cylinders."""
    signs = (side.value - MEAN * side.known) @ _vectors() > 0
    return signs.reshape(-1, TABLES, BITS) @ (1 << np.arange(BITS, dtype=np.uint16))


def _steps(turn: NDArray[np.float32]) -> NDArray[np.int32]:
    return np.asarray(np.floor(turn * (ROTATIONS / (2 * np.pi))).astype(np.int32) % ROTATIONS)


def _cells(shift_mm: NDArray[np.float32]) -> NDArray[np.int32]:
    return np.clip((shift_mm / CELL_MM + CELLS / 2).astype(np.int32), 0, CELLS - 1)


def _largest(values: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Places of the largest values, ascending; all that equal the last of them."""
    if count >= len(values):
        return np.arange(len(values))
    return np.flatnonzero(values >= np.partition(values, len(values) - count)[len(values) - count])


def _box(place: Places) -> tuple[float, float, float, float]:
    """Left, right, lower and upper end of places, and half a millimetre more."""
    if not len(place):
        return 0.0, 0.0, 0.0, 0.0
    x = place.real
    y = place.imag
    return float(x.min() - 0.5), float(x.max() + 0.5), float(y.min() - 0.5), float(y.max() + 0.5)


def _inside(
    place: NDArray[np.complexfloating[Any, Any]], box: NDArray[np.floating]
) -> NDArray[np.bool_]:
    left, right, lower, upper = box
    return np.asarray(
        (place.real > left) & (place.real < right) & (place.imag > lower) & (place.imag < upper)
    )


def each(work: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
    """Do it with each by a thread for each core, for other requests go on; results in order."""
    with ThreadPoolExecutor(cores(), thread_name_prefix="splitknit-match") as pool:
        yield from pool.map(work, items)


def unpacked(gallery: Path, row: int, payload: bytes) -> Template:
    """Template of a row. Raises BadInput, naming the row."""
    return naming(f"row {row} of '{gallery}'", lambda: unpack(payload))
