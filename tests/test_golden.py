"""The comparison of ``tools/golden.py``; its cases take a minute and are run by ``.ci/run``."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

TOOL = Path(__file__).resolve().parents[1] / "tools" / "golden.py"


@pytest.fixture(scope="module")
def golden():
    spec = importlib.util.spec_from_file_location("golden", TOOL)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_results_may_differ_by_a_thousandth_of_their_spread(golden):
    height = np.linspace(0.0, 1.0, 1000, dtype=np.float32).reshape(20, 50)
    spread = np.float32(height.std())
    nudged, shifted, local, cut = (height.copy() for _ in range(4))
    nudged += 5e-4 * spread
    shifted += 2e-3 * spread
    local[:4, :6] += 0.01  # mean and spread hardly change
    cut[0, :] = np.nan

    def measured(array, case="metric"):
        return {case: {"height_mm": golden.entry(array)}}

    assert golden.differences(measured(height), measured(height.copy())) == []
    assert golden.differences(measured(height), measured(nudged)) == []
    for changed in (shifted, local, cut, height[:10], height.astype(np.float64)):
        assert len(golden.differences(measured(height), measured(changed))) == 1
    assert len(golden.differences(measured(height), {})) == 1


def test_a_score_is_compared_with_itself(golden):
    def scored(similarity):
        return {"match ridge": {"similarity": golden.entry(np.float64(similarity))}}

    assert golden.differences(scored(0.78), scored(0.787)) == []
    assert len(golden.differences(scored(0.78), scored(0.70))) == 1
