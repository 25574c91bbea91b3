"""Impressions, made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from perfect_results import write_impressions
from splitknit_simulator.finger.finger import FingerPose


@pytest.fixture(scope="session")
def impressions(tmp_path_factory) -> Path:
    """Two impressions of one finger and one of another, as result folders, perfect; not to be
    changed."""
    turned = FingerPose(insertion_mm=26.0, yaw_rad=0.12, roll_rad=0.05)
    return write_impressions(tmp_path_factory.mktemp("impressions"), 0.27, 731, turned)
