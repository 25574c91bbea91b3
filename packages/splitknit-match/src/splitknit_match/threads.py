"""One thread of BLAS once fingers are compared (its matrices are small, and a second thread waits
more than it works), and properties that threads share."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from typing import Any, Generic, TypeVar

T = TypeVar("T")


@cache
def one_blas_thread() -> None:
    """Limit BLAS to one thread, once in a process; whoever wants more sets it again afterwards.

    OpenBLAS takes a change only from the thread that made the first one, or from the main thread
    (0.3.31), so that a limit for the duration of a call would not hold in every thread.
    """
    if os.environ.get("OPENBLAS_NUM_THREADS") == "1":
        return
    from threadpoolctl import threadpool_limits  # the command line needs none of it

    threadpool_limits(limits=1, user_api="blas")


class made_once(Generic[T]):  # noqa: N801 - a decorator
    """A property that is computed when first read, by any number of threads: the standard one's
    lock lets one of all objects do so at a time before Python 3.12."""

    def __init__(self, make: Callable[[Any], T]) -> None:
        """Take what computes the value."""
        self.make = make
        self.__doc__ = make.__doc__

    def __get__(self, owner: Any, kind: type | None = None) -> T:
        value: T = owner.__dict__.setdefault(self.make.__name__, self.make(owner))
        return value
