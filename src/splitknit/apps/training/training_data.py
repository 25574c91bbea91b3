"""Simulated fingers in the folder of a training: photographed one by one, each once, and read back."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.apps.training.training_folder import write_file
from splitknit.errors import BadInput, require
from splitknit.io.fields import read_json
from splitknit.io.npz import map_npy

HELD_OUT_FROM = 1_000_000
"""Fingers from this number on are never trained on."""
Samples = dict[int, NDArray[np.float16]]
Subject = tuple[str, int]
"""What is kept of a finger (``finger``: the whole, ``pieces``), and its number."""
Photograph = Callable[[str, int], tuple[NDArray[np.float16], dict[str, Any]]]
"""From a subject to its sample and facts; raises BadInput where the finger cannot be used."""


def make_data(
    out: Path, subjects: Sequence[Subject], photograph: Photograph, tick: Callable[[float], None]
) -> list[str]:
    """Photograph the fingers that are not there yet; return why those are not used that cannot be."""
    refused = []
    for done, subject in enumerate(subjects):
        tick(done / len(subjects))
        file = _name(out, *subject).with_suffix(".json")
        if not file.exists():
            facts = _store(_name(out, *subject), *subject, photograph)
            write_file(file, (json.dumps(facts) + "\n").encode())  # last: it says that all is there
        facts = _facts(out, *subject)
        if "refused" in facts:
            refused.append(f"{subject[1]}: {facts['refused']}")
    return refused


def load_data(out: Path, kind: str, numbers: Sequence[int], fits: Callable[[tuple[int, ...]], bool]) -> Samples:
    """The fingers that were not refused, read as they are needed: they may be larger than the memory.

    Parameters
    ----------
    out : folder of the training
    kind, numbers : of the subjects
    fits : says whether an array may have this shape

    Raises
    ------
    BadInput
        If a file is damaged.
    """
    found = {}
    for number in numbers:
        if "refused" in _facts(out, kind, number):
            continue
        file = _name(out, kind, number).with_suffix(".npy")
        sample = map_npy(file, f"'{file}' is damaged (no array of numbers); delete it and its .json, and resume.")
        require(
            sample.dtype == np.float16 and fits(sample.shape),
            f"'{file}' is damaged (it holds {sample.dtype} of the shape {sample.shape}); delete it and its .json, and "
            "resume.",
        )
        found[number] = sample
    return found


def require_fingers(count: int, words: str, refused: Sequence[str]) -> None:
    """See that there are any.

    Raises
    ------
    BadInput
        If there are none, with the reasons.
    """
    require(count > 0, f"not one finger to {words} could be used ({'; '.join(refused)}); take more fingers.")


def _store(name: Path, kind: str, number: int, photograph: Photograph) -> dict[str, Any]:
    """Photograph one finger and keep it; return its facts, or why it was refused."""
    try:
        sample, facts = photograph(kind, number)
    except BadInput as error:
        return {"finger": number, "refused": str(error)}
    buffer = io.BytesIO()
    np.save(buffer, sample, allow_pickle=False)
    write_file(name.with_suffix(".npy"), buffer.getvalue())
    return facts


def _name(out: Path, kind: str, number: int) -> Path:
    return out / "data" / f"{kind}_{number:07d}"


def _facts(out: Path, kind: str, number: int) -> dict[str, Any]:
    file = _name(out, kind, number).with_suffix(".json")
    damaged = f"'{file}' is damaged; delete it and resume."
    facts, _ = read_json(file, damaged)
    require(isinstance(facts, dict), damaged)
    return dict(facts)
