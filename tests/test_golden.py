"""The comparison of ``tools/golden.py``; its cases take a minute and are run by ``.ci/run``."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

TOOL = Path(__file__).resolve().parents[1] / "tools" / "golden.py"


@pytest.fixture(scope="module")
def golden() -> Any:
    spec = importlib.util.spec_from_file_location("golden", TOOL)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_last_bits_may_differ_and_small_changes_on_another_machine_only(golden: Any) -> None:
    height = np.linspace(0.0, 1.0, 1000, dtype=np.float32).reshape(20, 50)
    nudged, changed, moved = height.copy(), height + np.float32(1e-5), height + np.float32(0.01)
    nudged[3, 4] = np.nextafter(nudged[3, 4], np.float32(2))

    def document(array: Any, processor: str = "one") -> dict[str, Any]:
        return {
            "machine": {"processor": processor},
            "cases": {"metric": {"height_mm": golden.entry(array)}},
        }

    assert golden.differences(document(height), document(height.copy())) == []
    assert golden.differences(document(height), document(nudged)) == []
    assert len(golden.differences(document(height), document(changed))) == 1
    assert golden.differences(document(height), document(changed, "other")) == []
    assert len(golden.differences(document(height), document(moved, "other"))) == 1
    assert len(golden.differences(document(height), document(height[:10], "other"))) == 1
    assert (
        len(golden.differences(document(height), {"machine": {"processor": "one"}, "cases": {}}))
        == 1
    )
