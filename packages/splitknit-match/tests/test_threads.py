"""One thread of BLAS while fingers are compared, as many as before afterwards."""

from __future__ import annotations

import threading

import pytest

from splitknit_match.threads import one_blas_thread


def test_the_limit_ends_with_the_last_of_several_calls(monkeypatch) -> None:
    controller = pytest.importorskip("threadpoolctl").ThreadpoolController
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)

    def threads() -> set[int]:
        return {library["num_threads"] for library in controller().select(user_api="blas").info()}

    before = threads()
    inside, done = threading.Event(), threading.Event()

    @one_blas_thread()
    def other() -> None:
        inside.set()
        done.wait(10)

    thread = threading.Thread(target=other)
    with one_blas_thread():
        assert threads() == {1}
        thread.start()
        inside.wait(10)
    assert threads() == {1}  # the other call still runs
    done.set()
    thread.join()
    assert threads() == before
