"""Figure 3.21: the relief of case SnK with n = 2 to 7 scales of shapelets, compared by the thesis's matcher.

Only the last step differs between the six, so that images are enhanced and separated once for each capture:
:func:`relief_images` lets all n share what comes before. It gives the same relief as
``splitknit reconstruct --preset snk --set shapelets.scales=n`` (tests/validation/test_thesis_experiments.py).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from trials import Captures, Pairs, Table, Trial

from splitknit.evaluation.protocol import comparisons
from splitknit.io.capture import read_capture
from splitknit.io.provenance import settings_hash
from splitknit.matching.features import LbpSettings, lbp_features
from splitknit.matching.score import dissimilarity
from splitknit.matching.thesis import ThesisSettings, align_masks, finger_images, to_box
from splitknit.model import BoolArray, Capture, FloatArray
from splitknit.pipeline import reconstruct
from splitknit.presets import preset_settings
from splitknit.steps import Memory

SCALES = (2, 3, 4, 5, 6, 7)
SESSIONS = ("1", "2")
"""The thesis: "170 fingers recorded over 2 sessions"."""


@dataclass(frozen=True, slots=True, eq=False)
class Reliefs:
    """One capture, upright and cut to the finger."""

    channels: FloatArray
    """(6, h, w) relief by each number of scales, zero outside the mask."""
    mask: BoolArray
    px_per_mm: float


def relief_images(capture: Capture, scales: Sequence[int] = SCALES) -> Reliefs:
    """Reliefs of one capture.

    Raises
    ------
    BadInput
        If it shows no finger.
    """
    memory = Memory(capture)  # the scales share all but the shapelets
    channels = []
    for count in scales:
        # as snk up to the relief, without its near-infrared shape
        result = reconstruct(capture, "pr-split", {"shapelets.scales": count}, memory=memory)
        images = finger_images(
            result.normals, result.ridge_mm, result.mask, result.pitch_mm, result.input_from_upright,
            result.upright_size,
        )  # fmt: skip
        channels.append(images.channels["relief"])
    return Reliefs(np.stack(channels), images.mask, images.px_per_mm)


def scales_table(  # noqa: PLR0917
    population: Path, names: Sequence[str], scratch: Path, fraction: float, seed: int, jobs: int
) -> Table:
    """Trials ``n = 2`` to ``n = 7`` on sessions 1 and 2 of the captures `names`.

    Reliefs and scores are kept in `scratch`: what was stopped goes on.

    Parameters
    ----------
    population : folder of the captures
    names : of captures (``S01/session_1/right_index``)
    scratch : folder
    fraction : of the impostor pairs
    seed : which of them
    jobs : processes
    """
    names = sorted(name for name in names if name.split("/")[1].removeprefix("session_") in SESSIONS)
    parts = [name.split("/") for name in names]
    captures = Captures(
        np.array(names),
        np.array([part[0] for part in parts]),
        np.array([f"{part[0]}/{part[2]}" for part in parts]),
        np.array([part[1].removeprefix("session_") for part in parts]),
    )
    known = {"preset": "pr-split", "settings": preset_settings("pr-split"), "scales": SCALES}
    scratch = scratch / settings_hash(known)[:12]
    (scratch / "reliefs").mkdir(parents=True, exist_ok=True)
    _each(partial(_keep_relief, population, scratch), names, jobs)
    all_pairs = comparisons(captures.finger.tolist(), captures.session.tolist())
    kept = all_pairs.genuine | drawn(captures.finger[all_pairs.a], captures.finger[all_pairs.b], fraction, seed)
    pairs = Pairs(captures, all_pairs.a[kept], all_pairs.b[kept])
    groups = np.split(np.arange(pairs.a.size), np.flatnonzero(np.diff(pairs.a)) + 1)  # one database finger each
    tasks = [(names[int(pairs.a[group[0]])], [names[int(b)] for b in pairs.b[group]]) for group in groups]
    found = np.concatenate(_each(partial(_compare, scratch), tasks, jobs))
    ratio = found[:, 0]
    gated = 1.0 - np.exp(2.0 - ratio)
    trials = tuple(
        Trial(f"snk{count}", "thesis", "relief", 1.0 - found[:, 1 + k], ratio, gated, label=f"n = {count}")
        for k, count in enumerate(SCALES)
    )
    return Table(pairs, trials, ())


def drawn(finger_a: NDArray[np.str_], finger_b: NDArray[np.str_], fraction: float, seed: int) -> NDArray[np.bool_]:
    """(N,) a fraction of the pairs of fingers, the same whatever else is compared."""

    def chosen(a: str, b: str) -> bool:
        digest = hashlib.sha256(f"{seed}:{a}:{b}".encode()).digest()
        return int.from_bytes(digest[:8], "big") < fraction * 2.0**64

    return np.array([chosen(a, b) for a, b in zip(finger_a.tolist(), finger_b.tolist(), strict=True)], dtype=np.bool_)


def _keep_relief(population: Path, scratch: Path, name: str) -> None:
    file = _file(scratch, name)
    if file.is_file():
        return
    try:
        reliefs = relief_images(read_capture(population / name))
    except ValueError:  # a failure to acquire
        reliefs = Reliefs(np.zeros((len(SCALES), 0, 0), np.float32), np.zeros((0, 0), np.bool_), 1.0)
    partial_file = file.with_suffix(f".{os.getpid()}.partial.npz")
    np.savez(partial_file, channels=reliefs.channels, mask=reliefs.mask, px_per_mm=reliefs.px_per_mm)
    partial_file.replace(file)


def _compare(scratch: Path, task: tuple[str, list[str]]) -> NDArray[np.float64]:
    """(N, 7) overlap of the masks and dissimilarity by each number of scales; NaN where a capture failed."""
    first, others = task
    file = scratch / "scores" / (hashlib.sha256(repr(task).encode()).hexdigest()[:24] + ".npy")
    if file.is_file():
        return np.asarray(np.load(file))
    database = _read(scratch, first)
    settings = ThesisSettings().lbp
    known = _features(database.channels, database.px_per_mm, settings) if database.mask.size else []
    rows = []
    for other in others:
        query = _read(scratch, other)
        if not (database.mask.size and query.mask.size):
            rows.append([np.nan] * (1 + len(SCALES)))
            continue
        laid = align_masks(database.mask, query.mask)
        size = (database.mask.shape[0], database.mask.shape[1])
        features = _features([to_box(image, size) for image in query.channels], database.px_per_mm, settings)
        far = [float(np.linalg.norm(a - b)) for a, b in zip(known, features, strict=True)]
        rows.append([laid.ratio, *(dissimilarity(laid.ratio, [distance]) for distance in far)])
    result = np.array(rows)
    file.parent.mkdir(exist_ok=True)
    partial_file = file.with_suffix(f".{os.getpid()}.partial.npy")
    np.save(partial_file, result)
    partial_file.replace(file)
    return result


def _features(channels: Any, px_per_mm: float, settings: LbpSettings) -> list[NDArray[np.float32]]:
    return [lbp_features(channel, px_per_mm, settings) for channel in channels]


def _read(scratch: Path, name: str) -> Reliefs:
    with np.load(_file(scratch, name)) as arrays:
        return Reliefs(arrays["channels"], arrays["mask"], float(arrays["px_per_mm"]))


def _file(scratch: Path, name: str) -> Path:
    return scratch / "reliefs" / (name.replace("/", "_") + ".npz")


def _each(work: Any, tasks: Sequence[Any], jobs: int) -> list[Any]:
    if jobs <= 1 or len(tasks) <= 1:
        _one_thread()
        return [work(task) for task in tasks]
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_one_thread) as pool:
        return list(pool.map(work, tasks, chunksize=4))


def _one_thread() -> None:
    import cv2  # noqa: PLC0415

    cv2.setNumThreads(1)
