"""What wraps the steps of a reconstruction from outside: time and progress."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import ParamSpec, TypeVar

from splitknit.model import FloatArray, Progress

P = ParamSpec("P")
T = TypeVar("T")

BEGINS = {"finger": 0.0, "light": 0.1, "normals": 0.2, "surface": 0.25, "result": 0.9}
"""Fraction of the work that is done when a stage begins."""


@dataclass
class _Run:
    """One reconstruction under way."""

    progress: Progress | None
    kept: dict[str, FloatArray] | None
    """Images of steps, by name, where they are kept."""
    seconds: dict[str, float] = field(default_factory=dict)
    stage: str = ""
    """Stage under way."""
    done: float = 0.0
    """Fraction that was reported last: a stage may be entered again, but progress never goes
    back."""


_RUN: ContextVar[_Run | None] = ContextVar("run", default=None)


@contextmanager
def timed_run(
    progress: Progress | None,
    kept: dict[str, FloatArray] | None = None,
) -> Iterator[dict[str, float]]:
    """Time the steps inside, report them to `progress`, and put images into `kept`; yield the
    seconds of stages."""
    run = _Run(progress, kept)
    token = _RUN.set(run)
    try:
        yield run.seconds
    finally:
        _RUN.reset(token)


def keep(name: str, make: Callable[[], FloatArray]) -> None:
    """Keep images (L, h, w), or one picture, of a step, where the run keeps them."""
    run = _RUN.get()
    if run is not None and run.kept is not None:
        run.kept[name] = make()


def report(stage: str, within: float) -> None:
    """Report that a fraction `within` of a stage is done."""
    run = _RUN.get()
    if run is not None and run.progress is not None:
        following = [done for done in (*BEGINS.values(), 1.0) if done > BEGINS[stage]]
        run.done = max(run.done, BEGINS[stage] + within * (following[0] - BEGINS[stage]))
        run.progress(stage, run.done)


def step(stage: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorator of a step of a stage: outside of a run it changes nothing."""

    def wrap(function: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(function)
        def timed(*args: P.args, **kwargs: P.kwargs) -> T:
            run = _RUN.get()
            if run is None or run.stage == stage:
                return function(*args, **kwargs)
            report(stage, 0.0)
            outer, run.stage, started = run.stage, stage, time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                run.stage = outer
                run.seconds[stage] = run.seconds.get(stage, 0.0) + time.perf_counter() - started

        return timed

    return wrap
