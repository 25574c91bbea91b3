"""One thread of BLAS while fingers are compared: its matrices are small, and a second thread waits
more than it works."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

_lock = threading.Lock()
_limits: list[Any] = []
"""One for each call that runs; the first one's holds."""


@cache
def _libraries() -> Any:
    from threadpoolctl import ThreadpoolController  # the command line needs none of it

    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread until the last of the calls that run at the same time ends.

    OpenBLAS takes a change from the thread alone that began it: where another one ends last, the
    limit stays.
    """
    if os.environ.get("OPENBLAS_NUM_THREADS") == "1":
        yield
        return
    with _lock:
        _limits.append(_limits[0] if _limits else _libraries().limit(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _lock:
            limit = _limits.pop()
            if not _limits:
                limit.restore_original_limits()


if hasattr(os, "register_at_fork"):  # another thread of the parent may hold it
    os.register_at_fork(
        before=_lock.acquire, after_in_parent=_lock.release, after_in_child=_lock.release
    )
