"""The thesis's four ways to separate direct light, on small crops."""

from __future__ import annotations

import pytest

from script_folder import VALIDATION, scripts_of


@pytest.mark.slow
def test_the_checkerboard_comes_closest() -> None:
    with scripts_of(VALIDATION / "separation") as script:
        nayar, patches = script("nayar"), script("patches")
        finger_patches = {
            name: patch
            for name, patch in patches.draw_patches(True).items()
            if name.startswith("finger")
        }
        level = {row["way"]: float(row["no noise, dB"]) for row in nayar.compared(finger_patches)}
    assert level["checkerboard"] > 45 > level["sinusoid"] > 40
    assert level["line"] < level["single image"] < level["mesh"] < 30
