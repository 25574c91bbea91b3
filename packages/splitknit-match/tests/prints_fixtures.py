"""A simulated finger without photographs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bodies import Twin
from splitknit.nominal import default_rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface


@pytest.fixture(scope="session")
def twin() -> Twin:
    """A whorl, lying straight, at a quarter of full scale."""
    finger = draw_finger(731, "whorl")
    master = finger.master()
    finger = replace(finger, printed=master)
    return Twin(
        finger_surface(finger, FingerPose(insertion_mm=27.0), default_rig(0.25).camera), master
    )
