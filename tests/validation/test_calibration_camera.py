"""The validation of the camera's calibration runs, on small pictures, and holds what the issue asks
for."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "validation" / "calibration" / "camera.py"


@pytest.mark.slow
def test_one_rig_at_a_seventh_of_the_size():
    spec = importlib.util.spec_from_file_location("validation_calibration_camera", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules[spec.name] = module  # its dataclass looks itself up
    try:
        spec.loader.exec_module(module)
        photos = module.photographs(3, 0.14, count=8)
        fit = module.fit_camera(photos.corners, module.BOARD, photos.rig.camera.image_size)
        errors = module.errors_of(photos, fit)
        table = module.summary(
            [{"a": errors}, {"a": {name: 2 * value for name, value in errors.items()}}]
        )
    finally:
        del sys.modules[spec.name]
    assert errors["focal_percent"] < 0.3
    assert errors["board_px_per_mm_percent"] < 0.1
    assert errors["board_tilt_deg"] < 0.1
    row = table["a"]["rms_px"]
    assert row["low"] <= row["mean"] <= row["high"] <= row["worst"]
    assert abs(row["mean"] - 1.5 * errors["rms_px"]) < 1e-4
