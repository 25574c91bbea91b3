"""Seconds of every stage, and word of it to whoever shows progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

STAGES = {"finger": 0.0, "light": 0.1, "normals": 0.2, "surface": 0.25, "result": 0.9}
"""Share of the work that is done when a stage begins."""


class Stopwatch:
    """Times stages and reports the share done."""

    def __init__(self, progress: Callable[[str, float], None] | None = None) -> None:
        """Start with nothing timed; `progress` is called with a stage and the share of all work done."""
        self.seconds: dict[str, float] = {}
        self._progress = progress

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time what happens inside; a stage may be entered several times."""
        self.report(stage, 0.0)
        started = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - started

    def report(self, stage: str, within: float) -> None:
        """Say that `within` (0 to 1) of a stage is done."""
        if self._progress is not None:
            following = [share for share in (*STAGES.values(), 1.0) if share > STAGES[stage]]
            self._progress(stage, STAGES[stage] + within * (following[0] - STAGES[stage]))
