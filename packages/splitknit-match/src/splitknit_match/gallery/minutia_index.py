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

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, naming
from splitknit.io.images import cores
from splitknit.model import Progress, no_progress
from splitknit_match.matching.minutia_pairs import CYLINDER, MAX_COMPARED, Cylinders, Places
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template, unpack

T = TypeVar("T")
R = TypeVar("R")


_TABLES = 80  # tables of the index
_BITS = 12  # bits of a key
_ROTATIONS = 32  # steps of a full turn; votes of two neighbours are added
_PEAKS = 2  # rotations of a capture whose votes are counted by shift
_ENTRY = np.dtype([("x", "<f4"), ("y", "<f4"), ("turn", "<f4"), ("keys", "<u2", _TABLES)])
"""A minutia as a gallery keeps it: place in mm, radians, and keys."""
_VERSION = b"\x01"
"""Begins a capture's minutiae; those of another version are found anew in its template. Source:
definition."""
_FARTHEST_MM = 200.0
"""No minutia lies farther from a print's middle. Source: largest template."""
_CELLS = 15  # shifts are counted in so many cells along x and y; votes of two neighbours are added
_COMMON = 2.0
"""A key that more minutiae have than so many times the mean is left out. Chosen on: speed."""
_RARE = 8
"""Such a key is kept where no more minutiae have it than these. Chosen on: speed."""
_ROTATED_FRACTION = 0.05
"""Fraction of the captures whose shifts are counted. Chosen on: speed."""
_ALIGNED = 200
"""Captures whose minutiae are laid on the probe's. Chosen on: speed."""
_MARGIN_MM = 0.5
"""So far beyond its minutiae a capture would show more of them."""
_REACH_MM2 = 2.25
"""Squared distance beyond which minutiae do not agree: they would count less than 0.0002 each.
Chosen on: speed."""


class MinutiaIndex:
    """Minutiae of captures in memory, 17 kB each. Threads may share it."""

    rows: NDArray[np.int64]
    """(M,) numbers of the captures' rows."""

    def __init__(
        self,
        templates: Mapping[int, bytes],
        gallery: Path,
        minutiae: dict[int, bytes | memoryview],
        progress: Progress = no_progress,
    ) -> None:
        """Take templates by their rows, but those of failures to acquire.

        `minutiae`: of some rows, as :func:`kept_minutiae` makes them; those of other rows are found
        in the templates, and added. Raises BadInput if one is damaged.
        """
        rows = sorted(row for row, template in templates.items() if template)
        missing = [row for row in rows if not _is_sound(minutiae.get(row, b""))]

        def found(row: int) -> bytes:
            return kept_minutiae(unpacked(gallery, row, templates[row]))

        for number, (row, own) in enumerate(zip(missing, each(found, missing), strict=True)):
            progress("finding minutiae", number / len(missing))
            minutiae[row] = own
        counts = {row: len(minutiae[row]) // _ENTRY.itemsize for row in rows}
        self.others = [row for row, count in counts.items() if not count]
        """Rows that hold too few minutiae to be searched."""
        self.rows = np.array([row for row, count in counts.items() if count], dtype=np.int64)
        self.count = np.array([count for count in counts.values() if count], dtype=np.int64)
        self.first = np.cumsum(self.count) - self.count
        kept = np.frombuffer(b"".join(minutiae[row][1:] for row in rows), _ENTRY)
        # whatever a damaged file holds, these are numbers of the size of a print's
        self.x, self.y, self.turn = (
            np.clip(np.nan_to_num(kept[name]), -_FARTHEST_MM, _FARTHEST_MM)
            for name in ("x", "y", "turn")
        )
        self.boxes = _boxes(self.x, self.y, self.first)
        # twice the steps, so that differences of rotation stay within the capture's own
        self.code = np.repeat(np.arange(len(self), dtype=np.int32), self.count) * (2 * _ROTATIONS)
        self.code += _steps(self.turn) + _ROTATIONS
        # of each table the minutiae in the order of their keys, and where those of a key end
        self.lists = np.empty((_TABLES, len(kept)), dtype=np.int32)
        self.ends = np.zeros((_TABLES, (1 << _BITS) + 1), dtype=np.int64)
        for order, ends, column in zip(self.lists, self.ends, kept["keys"].T, strict=True):
            keys = column & np.uint16((1 << _BITS) - 1)
            order[:] = np.argsort(keys, kind="stable")
            ends[1:] = np.bincount(keys, minlength=1 << _BITS).cumsum()

    def __len__(self) -> int:
        return len(self.rows)

    def nearest(self, probe: Cylinders, k: int) -> list[int]:
        """Rows of the `k` captures that agree with the probe best, best first; equal ones by
        rows."""
        if not len(self.turn) or not len(probe.turn):
            return []
        enrolled, key, bins, minutia, weight = self._hits(probe)
        captures, slot = self._rotated(bins)
        slots = len(captures) * _PEAKS
        slot = slot.take(bins)
        voting = np.flatnonzero(slot >= 0)
        slot = slot.take(voting)
        enrolled = enrolled.take(voting)
        rotation = bins.take(voting) % _ROTATIONS
        key = key.take(voting)
        minutia = minutia.take(key)
        weight = weight.take(key)

        # votes by shift
        angles = 2j * np.pi / _ROTATIONS * np.arange(_ROTATIONS)
        rotated = (probe.place[:, None] * np.exp(angles)).astype(np.complex64)
        start = rotated.ravel().take(minutia * _ROTATIONS + rotation)
        column = _cells(self.x.take(enrolled) - start.real)
        row = _cells(self.y.take(enrolled) - start.imag)
        votes = np.bincount(
            (slot * _CELLS + column) * _CELLS + row, weight, minlength=slots * _CELLS**2
        )
        votes = votes.reshape(slots, _CELLS, _CELLS)
        votes = votes[:, 1:] + votes[:, :-1]
        votes = (votes[..., 1:] + votes[..., :-1]).reshape(len(captures), -1)
        most = votes.max(axis=1) / np.maximum(self.count[captures], 1) ** 0.25
        kept = _largest(most, max(_ALIGNED, 2 * k))

        # how these lie on the probe, by the hits that voted for it
        shape = (_PEAKS, _CELLS - 1, _CELLS - 1)
        peak, best_column, best_row = np.unravel_index(votes[kept].argmax(axis=1), shape)
        number = np.full(slots, -1)
        number[kept * _PEAKS + peak] = np.arange(len(kept))
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
        score = most[kept] + 20.0 * agreement  # weight of agreeing minutiae beside votes
        rows = self.rows[captures[kept]]
        return [int(row) for row in rows[np.lexsort((rows, -score))[:k]]]

    def _hits(self, probe: Cylinders) -> tuple[NDArray[Any], ...]:
        """Minutiae of the gallery, V of them, that share one of the probe's K keys which is not
        too common.

        Returns
        -------
        enrolled : (V,) minutia of the gallery
        key : (V,) the key that is shared
        bins : (V,) number of the capture times the steps of rotation, plus how many it is rotated
            by
        minutia : (K,) minutia of the probe that has the key
        weight : (K,) of the key, more where it is rare
        """
        keys = _keys(probe)
        tables = np.arange(_TABLES)
        mean = len(self.turn) / (1 << _BITS)
        starts = self.ends[tables, keys]
        sizes = (self.ends[tables, keys + 1] - starts).ravel()
        # the probe's minutiae by tables
        telling = np.flatnonzero(sizes <= max(_COMMON * mean, _RARE))
        sizes = sizes[telling]
        starts = (starts + tables * len(self.turn)).ravel()[telling]
        lists = self.lists.ravel()
        ranges = zip(starts.tolist(), (starts + sizes).tolist(), strict=True)
        enrolled = np.concatenate([lists[:0], *(lists[start:end] for start, end in ranges)])
        minutia = telling // _TABLES
        key = np.repeat(np.arange(len(telling), dtype=np.int32), sizes)
        code = self.code.take(enrolled) - _steps(probe.turn.astype(np.float32))[minutia].take(key)
        capture = code // (2 * _ROTATIONS)
        rotation = code % _ROTATIONS
        weight = np.sqrt(mean / np.maximum(sizes, 1))
        return enrolled, key, capture * _ROTATIONS + rotation, minutia, weight

    def _rotated(self, bins: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """Captures with most votes for some rotation; and by bin the number of a capture's best
        rotation among all best ones, -1 for other rotations.
        """
        votes = np.bincount(bins, minlength=_ROTATIONS * len(self)).reshape(-1, _ROTATIONS)
        votes += np.roll(votes, -1, axis=1)
        most = votes.max(axis=1) / np.sqrt(np.maximum(self.count, 1))
        captures = _largest(most, max(_ALIGNED, round(_ROTATED_FRACTION * len(self))))
        number = np.arange(len(captures))
        slot = np.full((len(self), _ROTATIONS), -1, dtype=np.int32)
        free = votes[captures]
        for peak in range(_PEAKS):
            best = free.argmax(axis=1)
            free[number, best - 1] = -1
            for rotation in (best, (best + 1) % _ROTATIONS):
                free[number, rotation] = -1
                slot[captures, rotation] = number * _PEAKS + peak
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
        near = np.flatnonzero(distance < _REACH_MM2)  # of captures, the probe's minutiae, their own
        of_probe = near // width
        capture = of_probe // len(probe.turn)
        of_capture = capture * width + near % width
        angle = (np.angle(turns)[:, None] + probe.turn).ravel()[of_probe] - self.turn[at].ravel()[
            of_capture
        ]
        angle -= 2 * np.pi * np.rint(angle / (2 * np.pi))
        # a minutia laid on another counts 1/e at 0.5 mm, and at 0.35 rad
        likeness = np.exp(-distance.ravel()[near] / 0.5**2 - (angle / 0.35) ** 2)
        mutual = np.ones(len(near), dtype=bool)
        for minutia, size in ((of_probe, laid.size), (of_capture, x.size)):
            best = np.zeros(size)
            np.maximum.at(best, minutia, likeness)
            mutual &= likeness == best[minutia]
        agreeing = np.bincount(capture[mutual], likeness[mutual], minlength=len(captures))
        back = (x + 1j * y - shifts[:, None]) * turns.conj()[:, None]
        enrolled_overlap = (
            _inside(back, _boxes(probe.place.real, probe.place.imag, np.zeros(1, int))) & present
        ).sum(axis=1)
        probe_overlap = _inside(laid, self.boxes[:, captures, None]).sum(axis=1)
        # minutiae that are added to those that could agree
        return np.asarray(agreeing / np.sqrt(np.sqrt(enrolled_overlap * probe_overlap) + 9.0))


@cache
def _vectors() -> NDArray[np.float32]:
    rng = np.random.default_rng(1)
    return rng.standard_normal((CYLINDER, _TABLES * _BITS), dtype=np.float32)


_MEAN = 0.157
"""Mean of a cylinder's numbers. Chosen on: real prints (validation/gallery/index.py)."""


def _keys(side: Cylinders) -> NDArray[np.uint16]:
    """(N, tables) of cylinders."""
    signs = (side.value - _MEAN * side.known) @ _vectors() > 0
    return signs.reshape(-1, _TABLES, _BITS) @ (1 << np.arange(_BITS, dtype=np.uint16))


def kept_minutiae(template: Template) -> bytes:
    """Minutiae of a template with their keys, which a gallery keeps beside it; the version alone
    where it holds too few."""
    side = Prepared(template.printed).cylinders
    if side is None:
        return _VERSION
    minutiae = np.empty(len(side.turn), _ENTRY)
    minutiae["x"], minutiae["y"] = side.place.real, side.place.imag
    minutiae["turn"], minutiae["keys"] = side.turn, _keys(side)
    return _VERSION + minutiae.tobytes()


def minutiae_of(payload: bytes) -> bytes:
    """:func:`kept_minutiae` of a stored payload; empty where it is a failure to acquire, holds
    minutiae alone, or cannot be read."""
    try:
        return kept_minutiae(unpack(payload))
    except BadInput:
        return b""


def _is_sound(minutiae: bytes | memoryview) -> bool:
    """Whether the bytes are of this version and hold a whole number of minutiae, not too many."""
    return (
        minutiae[:1] == _VERSION
        and len(minutiae) % _ENTRY.itemsize == 1
        and len(minutiae) // _ENTRY.itemsize <= MAX_COMPARED
    )


def _steps(turn: NDArray[np.float32]) -> NDArray[np.int32]:
    return np.asarray(np.floor(turn * (_ROTATIONS / (2 * np.pi))).astype(np.int32) % _ROTATIONS)


def _cells(shift_mm: NDArray[np.float32]) -> NDArray[np.int32]:
    # side of a cell in which shifts are counted
    return np.clip((shift_mm / 2.0 + _CELLS / 2).astype(np.int32), 0, _CELLS - 1)


def _largest(values: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Places of the largest values, ascending; all that equal the last of them."""
    if count >= len(values):
        return np.arange(len(values))
    return np.flatnonzero(values >= np.partition(values, len(values) - count)[len(values) - count])


def _boxes(
    x: NDArray[np.floating], y: NDArray[np.floating], first: NDArray[np.int64]
) -> NDArray[np.floating]:
    """(4, N) left, right, lower and upper end of the places of each side, which begin at `first`
    (N,)."""
    ends = (np.minimum, -_MARGIN_MM), (np.maximum, _MARGIN_MM)
    return np.stack([end.reduceat(axis, first) + far for axis in (x, y) for end, far in ends])


def _inside(
    place: NDArray[np.complexfloating[Any, Any]], box: NDArray[np.floating]
) -> NDArray[np.bool_]:
    left, right, lower, upper = box
    return np.asarray(
        (place.real > left) & (place.real < right) & (place.imag > lower) & (place.imag < upper)
    )


_cores = threading.Lock()
"""Held by the request whose work is done by several threads."""


def each(work: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
    """Do it with each; of many by a thread for each core, unless another request has those;
    results in order."""
    # threads for sixteen comparisons cost a fifth of their processor time
    if len(items) <= 16 or not _cores.acquire(blocking=False):
        yield from map(work, items)
        return
    try:
        with ThreadPoolExecutor(cores(), thread_name_prefix="splitknit-match") as pool:
            yield from pool.map(work, items)
    finally:
        _cores.release()


def unpacked(gallery: Path, row: int, payload: bytes) -> Template:
    """Template of a row. Raises BadInput, naming the row."""
    return naming(f"row {row} of '{gallery}'", lambda: unpack(payload))
