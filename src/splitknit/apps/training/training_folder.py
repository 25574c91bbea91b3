"""The folder that a training grows in: every file whole or not there; taken up again with the same settings alone."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit.errors import read_bytes, refusing, require
from splitknit.io import atomic_file
from splitknit.io.fields import parse_json
from splitknit.report.charts import Line, line_chart

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Progress = Callable[[str, float], None]
"""Hears what is being done, and the share of the whole that is done."""

_MAX_BYTES = 2_000_000_000
"""A state with its optimiser has three times the network's bytes."""
FREE = ("threads", "device", "precision")
"""Settings of a training that may change on the way."""


def files_of(network: str, photographed: str) -> dict[str, str]:
    """What a training of `network` leaves in its folder, in words."""
    return {
        f"{network}.onnx": "the network",
        f"{network}.json": "its card",
        "curve.svg": "the learning curve",
        "curve.csv": "the same in numbers",
        "data": f"the {photographed}; may be deleted when the training is done",
        "checkpoint.pt": "to go on from; may be deleted as well",
    }


def open_folder(
    out: Path,
    data: DataclassInstance,
    settings: DataclassInstance,
    resume: bool,
    *,
    free: Collection[str] = FREE,
) -> None:
    """Make the folder, or see that what is in it is this very training.

    Parameters
    ----------
    out : folder
    data, settings : dataclasses that say what is trained on, and how
    resume : whether a training may be there already
    free : settings that may differ from those of the training that is there

    Raises
    ------
    BadInput
        If `out` is a file or holds something else, a training that shall not be resumed, or one with other settings.
    """
    run = plain({"format": "splitknit-training", "data": asdict(data), "training": asdict(settings)})
    file = out / "run.json"
    require(not out.exists() or out.is_dir(), f"'{out}' is a file; name a folder to train in.")
    if not out.is_dir() or not any(out.iterdir()):
        write_file(file, (json.dumps(run, indent=1) + "\n").encode())
        return
    require(file.is_file(), f"'{out}' is not empty and holds no training of ours; name another folder.")
    require(resume, f"'{out}' holds a training already; add --resume to go on with it, or name another folder.")
    with refusing(f"'{file}' is damaged; train anew in another folder."):
        before = parse_json(read_file(file), str(file))
        changed = [
            f"{part}.{name}"
            for part in ("data", "training")
            for name in sorted({*run[part], *before[part]})
            if before[part].get(name) != run[part].get(name) and name not in free
        ]
    require(
        not changed,
        f"the training in '{out}' has other settings ({', '.join(changed)}); resume with the same ones.",
    )
    if before != run:
        write_file(file, (json.dumps(run, indent=1) + "\n").encode())


def read_file(file: Path) -> bytes:
    """Content of a file of a training.

    Raises
    ------
    BadInput
        If it cannot be read.
    """
    return read_bytes(file, _MAX_BYTES)


def write_file(file: Path, content: bytes) -> None:
    """Write a file that is whole, on the disk, or not there."""
    with atomic_file(file) as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def plain(facts: Mapping[str, Any]) -> Any:
    """`facts` as they come back from a JSON file: lists for tuples."""
    return json.loads(json.dumps(facts))


def curve_table(curve: Sequence[Mapping[str, float]]) -> bytes:
    """The learning curve as a CSV file, one line an entry."""
    table = io.StringIO()
    writer = csv.DictWriter(table, list(curve[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(curve)
    return table.getvalue().encode()


def curve_chart(lines: Sequence[Line], x_label: str, y_label: str) -> bytes:
    """The learning curve as an SVG file."""
    # plain text first: the markup's own replace() would escape what is put in
    chart = str(line_chart(lines, x_label, y_label, width=560, height=260))
    return chart.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1).encode()
