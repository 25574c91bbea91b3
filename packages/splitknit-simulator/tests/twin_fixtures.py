"""A simulated finger and two people, made once for all tests."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import pytest

from splitknit.capture import Capture
from splitknit.io.capture import read_capture, write_capture
from splitknit_simulator.finger import finger
from splitknit_simulator.finger.finger import FingerPose
from splitknit_simulator.finger.master_print import MasterPrint, MasterPrintSettings, master_print
from splitknit_simulator.population.folder import simulate_population
from splitknit_simulator.population.sessions import PopulationSettings
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture


@lru_cache(maxsize=12)
def drawn_once(pattern: str, seed: int, settings: MasterPrintSettings) -> MasterPrint:
    """Ridges of a finger: the same at every call (test_master_print.py), so one drawing serves all
    tests."""
    master = master_print(pattern, seed, settings)
    for name in ("ridge", "pores", "u_mm", "v_mm", "minutiae"):
        getattr(master, name).setflags(write=False)
    return master


finger.master_print = drawn_once  # type: ignore[assignment]


@pytest.fixture(scope="session")
def twin_folder(tmp_path_factory) -> Path:
    """Capture folder of a simulated finger, 330 x 480 pixels, its crease in view; not to be
    changed."""
    folder = tmp_path_factory.mktemp("twin") / "capture"
    settings = TwinSettings(scale=0.15, pose=FingerPose(insertion_mm=28.0, yaw_rad=0.1))
    capture, truth = simulate_capture(3, "whorl", settings)
    write_capture(capture, folder, truth)
    return folder


@pytest.fixture(scope="session")
def twin_capture(twin_folder: Path) -> Capture:
    """It, read; not to be changed."""
    return read_capture(twin_folder)


@pytest.fixture(scope="session")
def people(tmp_path_factory) -> Path:
    """Two people's right index fingers in two sessions, simulated; not to be changed."""
    folder = tmp_path_factory.mktemp("batch") / "people"
    settings = PopulationSettings(seed=3, scale=0.08)
    simulate_population(
        folder, settings, subjects=2, sessions=2, fingers=("right_index",), workers=1
    )
    return folder
