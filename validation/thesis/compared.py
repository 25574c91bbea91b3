"""Pairs of captures by the thesis's rule with any features; what is finished is kept."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from trials import Captures, Pairs, Table, Trial, Values
from variants import GATE

from splitknit.io.paging import one_heap
from splitknit.model import BoolArray, FloatArray
from splitknit_match.evaluation.protocol import comparisons
from splitknit_match.matching.score import dissimilarity
from splitknit_match.matching.thesis import FingerImages, align_masks, to_box

Extract = Callable[[FloatArray, float], NDArray[np.float32]]
"""Features of a channel (h, w) at a number of pixels per mm."""
Read = Callable[[str], FingerImages | None]
"""Images of a capture by its name; None where it could not be acquired."""


@dataclass(frozen=True, slots=True)
class Way:
    """What is compared: an attribute (its channels) by a feature."""

    name: str
    extract: Extract
    attribute: str
    channels: tuple[str, ...]


def captures_of(names: Sequence[str]) -> Captures:
    """Captures by their names (``S01/session_1/right_index``)."""
    parts = [name.split("/") for name in sorted(names)]
    return Captures(
        np.array(sorted(names)),
        np.array([part[0] for part in parts]),
        np.array([f"{part[0]}/{part[2]}" for part in parts]),
        np.array([part[1].removeprefix("session_") for part in parts]),
    )


def compare_all(
    names: Sequence[str], read: Read, ways: Sequence[Way], scratch: Path, jobs: int
) -> tuple[Table, NDArray[np.bool_]]:
    """Trials of all ways on all comparisons of captures, and (N,) those that are made without the
    gate, too: all of sessions 1 and 2.

    Parameters
    ----------
    names : of captures (``S01/session_1/right_index``)
    read, ways, scratch, jobs : as :func:`compare_pairs`
    """
    captures = captures_of(names)
    every = comparisons(captures.finger.tolist(), captures.session.tolist())
    pairs = Pairs(captures, every.a, every.b)
    ungated = np.isin(captures.session, ("1", "2"))[np.stack([pairs.a, pairs.b])].all(axis=0)
    return Table(pairs, compare_pairs(pairs, read, ways, scratch, jobs, ungated), ()), ungated


def compare_pairs(  # noqa: PLR0917
    pairs: Pairs,
    read: Read,
    ways: Sequence[Way],
    scratch: Path,
    jobs: int,
    ungated: NDArray[np.bool_] | None = None,
) -> tuple[Trial, ...]:
    """One trial for each way.

    Parameters
    ----------
    pairs : what is compared
    read : images of a capture; a function that another process can be given
    ways : the same everywhere
    scratch : folder of finished comparisons; another one for other captures or other images
    jobs : processes
    ungated : (N,) those that are compared even if they do not pass the gate; of the others, five
    sixths of the
        impostors, the similarity is NaN. None: all
    """
    always = np.ones(pairs.a.shape, dtype=np.bool_) if ungated is None else ungated
    order = np.argsort(pairs.a, kind="stable")
    starts = np.flatnonzero(np.diff(pairs.a[order])) + 1  # of the database fingers
    names = pairs.captures.names
    tasks = [
        [(str(names[pairs.a[k]]), str(names[pairs.b[k]]), bool(always[k])) for k in block]
        for block in np.split(order, starts[7::8])
    ]
    rows = np.concatenate(each(partial(_compare, read, tuple(ways), scratch), tasks, jobs))
    by_capture = np.empty_like(rows)
    by_capture[order] = rows
    ratio = by_capture[:, 0]
    gated = 1.0 - np.exp(2.0 - ratio)
    return tuple(
        Trial(way.name, "thesis", way.attribute, 1.0 - by_capture[:, 1 + k], ratio, gated)
        for k, way in enumerate(ways)
    )


def _compare(
    read: Read, ways: tuple[Way, ...], scratch: Path, task: list[tuple[str, str, bool]]
) -> Values:
    """(N, 1 + ways) overlap of the masks and dissimilarities (5.2) of pairs; NaN where a capture
    failed, or where the overlap is too small and the pair is not to be compared without the gate.

    Queries are read once each, beside the features of all fingers that they are compared with.
    """
    key = repr(
        ([pair[:2] for pair in task], [(way.name, way.attribute, way.channels) for way in ways])
    )
    file = scratch / (hashlib.sha256(key.encode()).hexdigest()[:24] + ".npy")
    result, waiting = (
        np.full((len(task), 1 + len(ways)), np.nan),
        np.ones(len(task), dtype=np.bool_),
    )
    if file.is_file():  # what did not pass the gate then may be asked for now
        result = np.asarray(np.load(file))
        waiting = (
            np.isfinite(result[:, 0]) & np.isnan(result[:, 1]) & [always for *_, always in task]
        )
    if not waiting.any():
        return result
    rows = np.flatnonzero(waiting).tolist()
    databases = {name: _known(read(name), ways) for name in dict.fromkeys(task[k][0] for k in rows)}
    of_query: dict[str, list[int]] = {}
    for k in rows:
        of_query.setdefault(task[k][1], []).append(k)
    needed = dict.fromkeys(name for way in ways for name in way.channels)
    for second, against in of_query.items():
        query = read(second)
        for k in against:
            database = databases[task[k][0]]
            if database is None or query is None:
                continue
            mask, px_per_mm, known = database
            _, ratio = align_masks(mask, query.mask)
            result[k, 0] = ratio
            if ratio < GATE and not task[k][2]:
                continue
            boxed = {
                name: to_box(query.channels[name], (mask.shape[0], mask.shape[1]))
                for name in needed
            }
            on_database = FingerImages(boxed, mask, px_per_mm)
            for j, way in enumerate(ways):
                both = zip(known[j], features_of(on_database, way), strict=True)
                result[k, 1 + j] = dissimilarity(
                    ratio, [float(np.linalg.norm(a - b)) for a, b in both]
                )
    keep(file, lambda stream: np.save(stream, result))
    return result


def _known(
    images: FingerImages | None, ways: tuple[Way, ...]
) -> tuple[BoolArray, float, list[list[NDArray[np.float32]]]] | None:
    return (
        None
        if images is None
        else (images.mask, images.px_per_mm, [features_of(images, way) for way in ways])
    )


def features_of(images: FingerImages, way: Way) -> list[NDArray[np.float32]]:
    """Features of each channel."""
    return [way.extract(images.channels[name], images.px_per_mm) for name in way.channels]


def keep(file: Path, write: Callable[[Any], Any]) -> None:
    """Write a file whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    partial_file = file.with_name(f".{file.name}.{os.getpid()}.tmp")
    with partial_file.open("wb") as stream:
        write(stream)
    partial_file.replace(file)


def each(work: Any, tasks: Sequence[Any], jobs: int) -> list[Any]:
    """Do all tasks, in processes of one thread each."""
    if jobs <= 1 or len(tasks) <= 1:
        cv2.setNumThreads(1)
        return [work(task) for task in tasks]
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_alone) as pool:
        return list(pool.map(work, tasks))


def _alone() -> None:
    """One thread, and a heap that keeps what is freed: patterns and gradients take a third of the
    time."""
    cv2.setNumThreads(1)
    one_heap()


def kept_images(file: Path, make: Callable[[], FingerImages | None]) -> None:
    """Keep a capture's images in a file, unless they are there; a failure to acquire is kept as
    well."""
    if file.is_file():
        return
    try:
        images = make()
    except ValueError:
        images = None
    if images is None:
        keep(file, lambda stream: np.savez(stream, mask=np.zeros((0, 0), np.bool_), px_per_mm=1.0))
    else:
        keep(
            file,
            lambda stream: np.savez(
                stream, mask=images.mask, px_per_mm=images.px_per_mm, **images.channels
            ),
        )


def read_images(file: Path) -> FingerImages | None:
    """What :func:`kept_images` kept."""
    with np.load(file) as arrays:
        if not arrays["mask"].size:
            return None
        channels = {
            name: arrays[name] for name in arrays.files if name not in ("mask", "px_per_mm")
        }
        return FingerImages(channels, arrays["mask"], float(arrays["px_per_mm"]))
