"""Which captures of a gallery may show a probe's finger: by their minutiae, looked up in hash tables.

What lies around a minutia is a cylinder of numbers (:mod:`splitknit_match.matching.minutia_pairs`); the signs of its
products with random vectors are its keys, one a table. Minutiae of gallery and probe that share a key vote for a turn
and a shift of their capture; rare keys count more. Of the captures with most votes, minutiae are laid on the probe's
and those that agree are counted.

Source: R. Cappelli, M. Ferrara and D. Maltoni, "Fingerprint indexing based on minutia cylinder-code", IEEE TPAMI 33(5),
2011. Different from it: random vectors instead of chosen bits, votes by turn and shift, and agreeing minutiae.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import naming
from splitknit.io.images import cores
from splitknit.model import FloatArray
from splitknit_match.matching.minutia_pairs import CYLINDER, Cylinders, Places
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template, unpack

_TABLES, _BITS = 80, 12
_MEAN = 0.157
"""Of a cylinder's numbers, in real prints (``validation/gallery/index.py``)."""
_TURNS, _DOUBLE = 32, 6
"""Steps of turn; votes of two neighbours are added. Twice as many are 2 to the power of 6."""
_PEAKS = 2
"""Turns of a capture whose votes are counted by shift."""
_CELL_MM, _SHIFTS = 2.0, 15
"""Steps of shift, and how many there are each way; votes of two neighbours are added."""
_COMMON, _RARE = 2.0, 8
"""A key that more of the gallery's minutiae have than so many times the mean, and than so many, is left out."""
_TURNED, _LAID = 0.05, 200
"""Fraction of the captures whose shifts are looked at, and number of those whose minutiae are laid on the probe's."""
_AGREE = 20.0
"""What the root of the fraction of agreeing minutiae counts beside votes."""
_FITS_MM, _FITS_RAD, _FEW = 0.5, 0.35, 9.0
"""Differences at which a minutia laid on another counts 1/e; minutiae that are added to those that could agree."""
_REACH_MM2 = 2.25
"""Farther apart, squared, they do not count: less than 0.0002 each."""

Floats = NDArray[np.float32]
T = TypeVar("T")
R = TypeVar("R")


class MinutiaIndex:
    """Minutiae of captures in memory, 15 kB each. Threads may share it."""

    rows: NDArray[np.int64]
    """(M,) numbers of the captures' rows."""

    def __init__(
        self, payloads: Mapping[int, bytes], gallery: Path, earlier: MinutiaIndex | None = None,
        same: Container[int] = (),
    ) -> None:  # fmt: skip
        """Take templates by their rows, without failures to acquire; those that are the `same` as in an `earlier` index
        are not read again. Raises BadInput if one is damaged.
        """
        known = np.array([row in same for row in ([] if earlier is None else earlier.rows.tolist())], dtype=bool)
        taken = set() if earlier is None else set(earlier.rows[known].tolist())

        def minutiae(row: int) -> tuple[Places, NDArray[np.float64], NDArray[np.uint16]] | None:
            side = Prepared(unpacked(gallery, row, payloads[row])).cylinders
            return None if side is None else (side.place, side.turn, _keys(side))

        rows = sorted(row for row, payload in payloads.items() if payload and row not in taken)
        found = list(zip(rows, each(minutiae, rows), strict=True))
        self.others = [row for row, side in found if side is None]
        """Rows that hold too few minutiae to be found."""
        sides = [side for _, side in found if side is not None]
        place = np.concatenate([np.zeros(0, np.complex128), *(side[0] for side in sides)])
        turn = np.concatenate([np.zeros(0), *(side[1] for side in sides)])
        keys = np.concatenate([np.zeros((0, _TABLES), np.uint16), *(side[2] for side in sides)])
        self.rows = np.array([row for row, side in found if side is not None], dtype=np.int64)
        self.count = np.array([len(side[1]) for side in sides], dtype=np.int64)
        self.boxes = np.array([_box(side[0]) for side in sides], dtype=np.float32).reshape(-1, 4)
        self.x, self.y, self.turn = (part.astype(np.float32) for part in (place.real, place.imag, turn))
        if earlier is not None:
            kept = np.repeat(known, earlier.count)
            for name in ("rows", "count", "boxes"):
                setattr(self, name, np.concatenate([getattr(earlier, name)[known], getattr(self, name)]))
            for name in ("x", "y", "turn"):
                setattr(self, name, np.concatenate([getattr(earlier, name)[kept], getattr(self, name)]))
            keys = np.concatenate([earlier._keys()[kept], keys])
        self.first = np.cumsum(self.count) - self.count
        self.code = np.repeat(np.arange(len(self), dtype=np.int32), self.count) * (2 * _TURNS)
        self.code += _steps(self.turn) + _TURNS
        self.lists = np.stack([np.argsort(one, kind="stable").astype(np.int32) for one in keys.T])
        sizes = [np.bincount(one, minlength=1 << _BITS) for one in keys.T]
        self.ends = np.pad(np.cumsum(sizes, axis=1), ((0, 0), (1, 0)))

    def _keys(self) -> NDArray[np.uint16]:
        """(N, tables) keys of all minutiae."""
        keys = np.empty(self.lists.T.shape, dtype=np.uint16)
        for table, (minutiae, ends) in enumerate(zip(self.lists, self.ends, strict=True)):
            keys[minutiae, table] = np.repeat(np.arange(1 << _BITS, dtype=np.uint16), np.diff(ends))
        return keys

    def __len__(self) -> int:
        return len(self.rows)

    def nearest(self, probe: Cylinders, k: int) -> list[int]:
        """Rows of the `k` captures that agree with the probe best, best first, equal ones in the order of rows."""
        if not len(self.turn) or not len(probe.turn):
            return []
        found, shared, minutia, weight, code = self._sharing(probe)
        captures, slot, count = self._turned(code)
        slot = slot.take(code)
        voting = np.flatnonzero(slot >= 0)
        slot, found, code = slot.take(voting), found.take(voting), code.take(voting)
        shared = shared.take(voting)
        minutia, weight = minutia.take(shared), weight.take(shared)
        turned = (probe.place[:, None] * np.exp(2j * np.pi / _TURNS * np.arange(_TURNS))).astype(np.complex64)
        start = turned.ravel().take(minutia * _TURNS + code % _TURNS)
        right, up = (
            np.clip((shift / _CELL_MM + _SHIFTS / 2).astype(np.int32), 0, _SHIFTS - 1)
            for shift in (self.x.take(found) - start.real, self.y.take(found) - start.imag)
        )
        votes = np.bincount((slot * _SHIFTS + right) * _SHIFTS + up, weight, minlength=count * _SHIFTS**2)
        votes = votes.reshape(count, _SHIFTS, _SHIFTS)
        votes = votes[:, 1:] + votes[:, :-1]
        votes = (votes[..., 1:] + votes[..., :-1]).reshape(len(captures), -1)
        most = votes.max(axis=1) / np.maximum(self.count[captures], 1) ** 0.25
        kept = _largest(most, max(_LAID, 2 * k))
        captures, most = captures[kept], most[kept]
        # how these lie on the probe, by the pairs that voted for it
        peak, *at = np.unravel_index(votes[kept].argmax(axis=1), (_PEAKS, _SHIFTS - 1, _SHIFTS - 1))
        where = np.full(count, -1)
        where[kept * _PEAKS + peak] = np.arange(len(kept))
        laid = where.take(slot)
        fits = (laid >= 0) & ((right - at[0][laid]) // 2 == 0) & ((up - at[1][laid]) // 2 == 0)
        laid, found, minutia, weight = laid[fits], found[fits], minutia[fits], weight[fits]

        def total_of(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
            parts = [np.bincount(laid, weight * part, minlength=len(kept)) for part in (values.real, values.imag)]
            return parts[0] + 1j * parts[1]

        turns = np.exp(1j * np.angle(total_of(np.exp(1j * (self.turn[found] - probe.turn[minutia])))))
        shifts = total_of(self.x[found] + 1j * self.y[found] - probe.place[minutia] * turns[laid])
        shifts /= np.maximum(total_of(np.ones(len(laid), dtype=np.complex128)), 1e-9)
        score = most + _AGREE * self._agreeing(captures, probe, turns, shifts)
        order = np.lexsort((self.rows[captures], -score))[:k]
        return [int(row) for row in self.rows[captures[order]]]

    def _sharing(
        self, probe: Cylinders
    ) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64], NDArray[np.float64], NDArray[np.int32]]:
        """Minutiae that share a key which is not too common, which of these it is, minutiae of the probe and weights of
        these keys, and the code of what was found: its capture's number times the steps, and how many it is turned by.
        """
        keys, tables = _keys(probe), np.arange(_TABLES)
        mean = len(self.turn) / (1 << _BITS)
        starts, ends = self.ends[tables, keys], self.ends[tables, keys + 1]
        telling = np.flatnonzero(ends - starts <= max(_COMMON * mean, _RARE))  # the probe's minutiae by tables
        starts, size = (starts + tables * len(self.turn)).ravel()[telling], (ends - starts).ravel()[telling]
        lists = self.lists.ravel()
        parts = [lists[start:end] for start, end in zip(starts.tolist(), (starts + size).tolist(), strict=True)]
        found = np.concatenate([lists[:0], *parts])
        minutia, weight = telling // _TABLES, np.sqrt(mean / np.maximum(size, 1))
        shared = np.repeat(np.arange(len(telling), dtype=np.int32), size)
        steps = _steps(probe.turn.astype(np.float32))[minutia]
        code = self.code.take(found) - steps.take(shared)
        return found, shared, minutia, weight, (code >> _DOUBLE << _DOUBLE - 1) | (code & _TURNS - 1)

    def _turned(self, code: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int32], int]:
        """Captures with most votes for some turn; by code the number of a capture's best turn, -1 for others; and how
        many of these there are.
        """
        votes = np.bincount(code, minlength=_TURNS * len(self)).reshape(-1, _TURNS)
        votes += np.roll(votes, -1, axis=1)
        most = votes.max(axis=1) / np.sqrt(np.maximum(self.count, 1))
        captures = _largest(most, max(_LAID, round(_TURNED * len(self))))
        every = np.arange(len(captures))
        slot = np.full((len(self), _TURNS), -1, dtype=np.int32)
        free = votes[captures]
        for peak in range(_PEAKS):
            top = free.argmax(axis=1)
            for step in (-1, 0, 1):
                at = (top + step) % _TURNS
                free[every, at] = -1
                if step >= 0:
                    slot[captures, at] = every * _PEAKS + peak
        return captures, slot.ravel(), len(captures) * _PEAKS

    def _agreeing(
        self, captures: NDArray[np.int64], probe: Cylinders, turns: Places, shift: Places
    ) -> NDArray[np.float64]:
        """How many minutiae agree where the probe is laid on each capture, over the root of those that could."""
        count = self.count[captures]
        width = int(count.max())
        column = np.arange(width)
        at = np.minimum(self.first[captures][:, None] + column, len(self.turn) - 1)
        x, y, turn = self.x[at], self.y[at], self.turn[at]
        laid = (probe.place * turns[:, None] + shift[:, None]).astype(np.complex64)
        there = column < count[:, None]
        apart = laid.real[:, :, None] - np.where(there, x, np.inf)[:, None]
        apart *= apart
        apart += (laid.imag[:, :, None] - y[:, None]) ** 2
        near = np.flatnonzero(apart < _REACH_MM2)
        one, other = near // width, near // laid[0].size // width * width + near % width  # of the probe, the captures
        miss = (np.angle(turns)[:, None] + probe.turn).ravel()[one] - turn.ravel()[other]
        miss -= 2 * np.pi * np.rint(miss / (2 * np.pi))
        like = np.exp(-apart.ravel()[near] / _FITS_MM**2 - (miss / _FITS_RAD) ** 2)
        both = np.ones(len(near), dtype=bool)
        for side, size in ((one, laid.size), (other, x.size)):
            most = np.zeros(size)
            np.maximum.at(most, side, like)
            both &= like == most[side]
        agreeing = np.bincount(one[both] // laid[0].size, like[both], minlength=len(captures))
        back = (x + 1j * y - shift[:, None]) * turns.conj()[:, None]
        inside = _inside(back, np.array(_box(probe.place))) & there
        seen = _inside(laid, self.boxes[captures].T[:, :, None]).sum(axis=1)
        return np.asarray(agreeing / np.sqrt(np.sqrt(inside.sum(axis=1) * seen) + _FEW))


@cache
def _vectors() -> Floats:
    rng = np.random.default_rng(1)
    return rng.standard_normal((CYLINDER, _TABLES * _BITS), dtype=np.float32)


def _keys(side: Cylinders) -> NDArray[np.uint16]:
    """(N, tables) of cylinders."""
    signs = (side.value - _MEAN * side.known) @ _vectors() > 0
    return signs.reshape(-1, _TABLES, _BITS) @ (1 << np.arange(_BITS, dtype=np.uint16))


def _steps(turn: Floats) -> NDArray[np.int32]:
    return np.asarray(np.floor(turn * (_TURNS / (2 * np.pi))).astype(np.int32) % _TURNS)


def _largest(values: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Places of the largest values, ascending; all that equal the last of them."""
    if count >= len(values):
        return np.arange(len(values))
    return np.flatnonzero(values >= np.partition(values, len(values) - count)[len(values) - count])


def _box(place: NDArray[np.complex128]) -> tuple[float, float, float, float]:
    """Left, right, lower and upper end of places, and half a millimetre more."""
    if not len(place):
        return 0.0, 0.0, 0.0, 0.0
    ends = place.real.min() - 0.5, place.real.max() + 0.5, place.imag.min() - 0.5, place.imag.max() + 0.5
    return tuple(map(float, ends))  # type: ignore[return-value]


def _inside(place: NDArray[np.complexfloating], box: FloatArray | NDArray[np.float64]) -> NDArray[np.bool_]:
    left, right, lower, upper = box
    return np.asarray((place.real > left) & (place.real < right) & (place.imag > lower) & (place.imag < upper))


def each(work: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
    """Do it with each, by a thread for each core: what takes the time lets others run. The results come in order."""
    if len(items) < 2:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(cores(), thread_name_prefix="splitknit-match") as pool:
        yield from pool.map(work, items)


def unpacked(gallery: Path, row: int, payload: bytes) -> Template:
    """Template of a row. Raises BadInput, naming the row."""
    return naming(f"row {row} of '{gallery}'", lambda: unpack(payload))
