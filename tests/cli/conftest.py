"""Enrolled people, made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from enrolled import people
from perfect_results import write_perfect
from splitknit.model import default_rig
from splitknit.simulator.finger.finger import Pose, draw_finger, finger_surface


@pytest.fixture(scope="session")
def people_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Enrolment of two people, three fingers, two sessions, as result folders; not to be changed."""
    return people(tmp_path_factory.mktemp("people"))


@pytest.fixture(scope="session")
def impressions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two impressions of one finger and one of another, as result folders, perfect; not to be changed."""
    pytest.importorskip("nbis")
    folder = tmp_path_factory.mktemp("impressions")
    camera = default_rig(0.27).camera
    for seed, pose, name in (
        (731, Pose(insertion_mm=27.0), "a"),
        (731, Pose(insertion_mm=26.0, yaw_rad=0.12, roll_rad=0.05), "again"),
        (732, Pose(insertion_mm=27.0), "other"),
    ):
        write_perfect(folder / name, finger_surface(draw_finger(seed, "right_loop"), pose, camera), camera)
    return folder
