"""Voted minutiae of a chunk's captures: found once a capture, from its images, kept beside the features."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from splitknit.batch.chunks import SUFFIX, read_chunk, write_timings
from splitknit.batch.execution import peak_memory_mb
from splitknit.batch.prints import MinutiaeDone, write_minutiae
from splitknit.batch.settings import Case
from splitknit.errors import BadInput
from splitknit.io import read_capture
from splitknit.matching.minutiae_record import Minutiae, no_minutiae
from splitknit.pipeline import PipelineSettings
from splitknit.recipe.leave_one_out import voted_minutiae
from splitknit.recipe.matchable import MatchingSettings

VERSION = 1


@dataclass(frozen=True, slots=True)
class VotedTask:
    """A chunk of features whose captures' voted minutiae are wanted."""

    store: Path
    population: Path
    case: Case
    name: str
    matching: MatchingSettings


def extract_voted(task: VotedTask) -> MinutiaeDone:
    """Find the voted minutiae of all captures of a chunk and write them under the same name."""
    case, settings = task.case.name, task.case.settings()
    file = task.store / "features" / case / f"{task.name}{SUFFIX}"
    table = read_chunk(file, ["capture", "acquired"])
    captures = table.column("capture").to_pylist()
    seconds, found = {}, []
    for capture, acquired in zip(captures, table.column("acquired").to_pylist(), strict=True):
        started = time.perf_counter()
        found.append(_voted(task.population / capture, settings, task.matching) if acquired else no_minutiae())
        seconds[capture] = round(time.perf_counter() - started, 3)
    write_timings(task.store / "timings" / case / "voting", task.name, seconds)
    write_minutiae(file, task.store / "voted" / case, captures, found, ("voted", VERSION))
    return MinutiaeDone(len(captures), peak_memory_mb())


def _voted(folder: Path, settings: PipelineSettings, matching: MatchingSettings) -> Minutiae:
    """Voted minutiae of a capture; none where leaving out an image leaves nothing."""
    capture = read_capture(folder)
    try:
        return voted_minutiae(capture, settings, matching.leave_one_out, matching.voted)
    except BadInput as error:
        if "nbis-py" in str(error):  # not the capture's fault
            raise
        return no_minutiae()
