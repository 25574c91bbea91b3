"""Reconstruction of a few captures in all cases: one chunk of the store for each case."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import BadInput, read_capture, reconstruct
from splitknit.errors import BadExposure, require
from splitknit.finger.ridges import surface_print
from splitknit.io.fields import inside
from splitknit.io.images import decode_image
from splitknit.io.prints import encode_print_png, provenance_texts
from splitknit.io.provenance import provenance, settings_hash
from splitknit.model import surface_of
from splitknit.networks.unet import running
from splitknit.steps import Memory
from splitknit_match.batch.chunks import SUFFIX, chunk_name, read_chunk, read_origin, write_chunk, write_timings
from splitknit_match.batch.execution import TaskDone
from splitknit_match.batch.population import CaptureRef
from splitknit_match.batch.settings import Case
from splitknit_match.batch.surfaces import pack_surface
from splitknit_match.matching.minutiae import extract
from splitknit_match.matching.minutiae_record import no_minutiae, pack_minutiae
from splitknit_match.matching.surface import MatchingSettings, surface_template
from splitknit_match.matching.template import pack

PRINT_PPI = 500.0
QUALITY = ("ridge_contrast", "sharpness", "brightness", "ambient_share", "length_mm", "width_mm")
BANDS = ("white", "nir")
VERSION = 1  # version of a chunk's columns
_EMPTY = "the ridge band that could be acquired is too small for a template."


@dataclass(frozen=True, slots=True)
class FeatureTask:
    """Captures that are reconstructed together, and where they go."""

    group: int
    population: Path
    population_sha256: str
    store: Path
    captures: tuple[CaptureRef, ...]
    cases: tuple[tuple[Case, tuple[str, ...]], ...]  # each case with the names of the captures that it lacks
    matching: MatchingSettings
    images: bool


COLUMNS = (
    "capture", "subject", "finger", "session", "acquired", "failure", "area_mm2",
    *(f"{name}_{band}" for band in BANDS for name in QUALITY),
    "warnings", "input_sha256", "template", "print", "images",
)  # fmt: skip
"""Of every chunk of features."""


def reconstruct_group(task: FeatureTask) -> TaskDone:
    """Reconstruct the captures of a task and write a chunk for each case; finished chunks are whole on the disk.

    A capture that cannot be read gets no row, so that a later run looks at it again; one whose sound images are black
    or overexposed is a failure to acquire.
    """
    rows: dict[str, list[dict[str, Any]]] = {case.name: [] for case, _ in task.cases}
    seconds: dict[str, dict[str, float]] = {case.name: {} for case, _ in task.cases}
    failures: list[str] = []
    unreadable: list[tuple[str, str]] = []
    threads = running().threads
    for ref in task.captures:
        memory: Memory | str
        try:
            folder = inside(task.population, ref.name, f"'{task.population}'", "the name of a capture")
            memory = Memory(read_capture(folder, threads=threads))
        except BadInput as error:
            memory = str(error).replace(f"{task.population}/", "")  # wherever the population lies, the row is the same
            if not isinstance(error, BadExposure):
                unreadable.append((ref.name, memory))
                continue
        cases = [case for case, wanted in task.cases if ref.name in wanted]
        for case in cases:
            started = time.perf_counter()
            row = _row(ref, memory, case, task, case is cases[-1])
            seconds[case.name][ref.name] = round(time.perf_counter() - started, 3)
            rows[case.name].append(row)
            if not row["acquired"]:
                failures.append(f"{case.name}, {ref.name}: {row['failure']}")
        del memory  # before the next capture is read
    for case, _ in task.cases:
        document, names = case.document(), [row["capture"] for row in rows[case.name]]
        if not names:
            continue
        name = chunk_name(f"{task.group:05d}", [document["settings_sha256"], names])
        origin = provenance(document, {row["capture"]: row["input_sha256"] for row in rows[case.name]})
        origin |= {"kind": "features", "kind_version": VERSION, "case": case.name}
        if running().device != "cpu":
            origin |= {"device": running().device}
        templates = settings_hash({"band": task.matching.band, "template": task.matching.template})
        origin |= {"population_sha256": task.population_sha256, "matching_sha256": templates}
        write_timings(task.store / "timings" / case.name, name, seconds[case.name])
        write_chunk(task.store / "features" / case.name / f"{name}{SUFFIX}", rows[case.name], COLUMNS, origin)
    return TaskDone(sum(map(len, rows.values())), failures=tuple(failures), unreadable=tuple(unreadable))


def _row(ref: CaptureRef, memory: Memory | str, case: Case, task: FeatureTask, last: bool) -> dict[str, Any]:
    """Row of one case of a capture, or of why it shows no finger; `last`: the images may go once they are read."""
    row: dict[str, Any] = {
        "capture": ref.name, "subject": ref.subject, "finger": ref.finger, "session": ref.session,
        "acquired": False, "failure": "", "area_mm2": 0.0, "warnings": [], "input_sha256": "",
        **{f"{name}_{band}": None for band in BANDS for name in QUALITY},
        "template": b"", "print": b"", "images": b"",
    }  # fmt: skip
    if isinstance(memory, str):
        return row | {"failure": memory}
    row["input_sha256"] = settings_hash(dict(sorted(memory.capture.hashes.items())))
    try:
        result = reconstruct(
            memory.hand_over() if last else memory.capture, case.preset, case.settings(), memory=memory
        )
    except BadInput as error:
        return row | {"failure": str(error)}
    surface = surface_of(result)
    template = surface_template(surface, task.matching)
    origin = provenance({"preset": result.preset, **result.settings}, result.hashes)
    quality = {f"{name}_{band}": result.quality.get(band, {}).get(name) for band in BANDS for name in QUALITY}
    return row | {
        "acquired": not template.empty,
        "failure": _EMPTY if template.empty else "",
        "area_mm2": float(np.sum(result.mask)) * result.pitch_mm**2,
        "warnings": list(result.warnings),
        "template": pack(template),
        # as ``splitknit reconstruct`` writes it
        "print": encode_print_png(surface_print(result, PRINT_PPI), PRINT_PPI, provenance_texts(origin)),
        "images": pack_surface(surface, result.height_mm) if task.images else b"",
        **{name: None if value is None else float(value) for name, value in quality.items()},
    }


# Minutiae of the prints of a chunk, kept beside it under the same name, for the matcher of minutiae.

_MINUTIAE_VERSION = 2
"""Version of the content. Minutiae of version 1 included ends at the outline."""


@dataclass(frozen=True, slots=True)
class MinutiaeTask:
    """A chunk of features beside which minutiae are wanted."""

    store: Path
    case: str
    name: str


def extract_minutiae(task: MinutiaeTask) -> TaskDone:
    """Find the minutiae of all captures of a chunk."""
    file = task.store / "features" / task.case / f"{task.name}{SUFFIX}"
    rows, seconds, started = [], {}, time.perf_counter()
    table = read_chunk(file, ["capture", "print"])
    for capture, data in zip(table["capture"].tolist(), table["print"].tolist(), strict=True):
        found = no_minutiae()
        if data:
            name = f"the print of '{capture}' in '{file}'"
            pixels = decode_image(data, name)
            require(pixels.shape[2] == 1 and pixels.dtype == np.uint8, f"{name} is not an 8-bit grey image.")
            found = extract(np.asarray(pixels[..., 0], dtype=np.uint8))
        rows.append({"capture": capture, "acquired": found.acquired, "minutiae": pack_minutiae(found)})
        seconds[capture] = round(time.perf_counter() - started, 3)
        started = time.perf_counter()
    write_timings(task.store / "timings" / task.case / "extraction", task.name, seconds)
    origin = {**read_origin(file), "kind": "minutiae", "kind_version": _MINUTIAE_VERSION}
    target = task.store / "minutiae" / task.case / file.name
    write_chunk(target, rows, ("capture", "acquired", "minutiae"), origin)
    return TaskDone(1)
