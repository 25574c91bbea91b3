"""One thread of BLAS while fingers are compared, as many as before afterwards."""

from __future__ import annotations

import pytest

from splitknit_match.threads import one_blas_thread


def test_the_limit_ends_with_the_outermost_call(monkeypatch) -> None:
    controller = pytest.importorskip("threadpoolctl").ThreadpoolController
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)

    def threads() -> set[int]:
        return {library["num_threads"] for library in controller().select(user_api="blas").info()}

    before = threads()
    with one_blas_thread():
        with one_blas_thread():
            assert threads() == {1}
        assert threads() == {1}
    assert threads() == before
