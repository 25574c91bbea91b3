"""The service over TLS under load: no error, every broken request refused, memory flat."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("starlette")
pytest.importorskip("httpx")

VALIDATION = Path(__file__).resolve().parents[4] / "validation" / "gallery"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_a_thousand_requests_and_ten_thousand_broken_ones(monkeypatch) -> None:
    monkeypatch.syspath_prepend(str(VALIDATION))
    sys.modules.pop("serve", None)
    from serve import load

    found = load(1000, 10_000)
    assert (found["errors"], found["refused"], found["other_codes"]) == (0, 10_000, [])
    memory = found["memory_mb_by_tenths"]
    assert memory[-1] < 1.02 * memory[0] + 1.0, memory
