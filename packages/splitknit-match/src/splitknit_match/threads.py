"""One thread of BLAS once fingers are compared: its matrices are small, and a second thread waits
more than it works."""

from __future__ import annotations

import os
from functools import cache


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
