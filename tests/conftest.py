"""Shared fixtures."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable
from functools import lru_cache, wraps
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import enrolled
from splitknit.batch.simulate import simulate_population
from splitknit.io.capture import read_capture, write_capture
from splitknit.matching import methods, minutiae
from splitknit.model import Capture
from splitknit.prints import from_file
from splitknit.prints.pressed import pressed_ridges
from splitknit.simulator.finger import finger
from splitknit.simulator.finger.finger import FingerPose
from splitknit.simulator.finger.master_print import MasterPrint, MasterPrintSettings, master_print
from splitknit.simulator.population.sessions import PopulationSettings
from splitknit.simulator.scene import TwinSettings
from splitknit.simulator.twin import simulate_capture
from splitknit.steps import Memory

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # started in the background by a shell: what tests interrupt would inherit the deafness
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGINT, signal.default_int_handler)


@lru_cache(maxsize=12)
def drawn_once(pattern: str, seed: int, settings: MasterPrintSettings) -> MasterPrint:
    """Ridges of a finger: the same at every call (test_master_print.py), so one drawing serves all tests."""
    master = master_print(pattern, seed, settings)
    for name in ("ridge", "pores", "u_mm", "v_mm", "minutiae"):
        getattr(master, name).setflags(write=False)
    return master


finger.master_print = drawn_once  # type: ignore[assignment]


def once(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of a print, the same at every call (test_minutiae.py), which so is called once for all tests."""
    kept: dict[bytes, Any] = {}

    @wraps(function)
    def called(image: np.ndarray, *others: float) -> Any:
        key = sha256(repr((image.shape, others)).encode() + image.tobytes()).digest()
        if key not in kept:
            kept[key] = function(image, *others)
        return kept[key]

    return called


minutiae.nfiq2 = methods.nfiq2 = once(minutiae.nfiq2)
minutiae.pressed_ridges = from_file.pressed_ridges = once(pressed_ridges)


@pytest.fixture(scope="session")
def twin_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Capture folder of a simulated finger, 330 x 480 pixels, its crease in view; not to be changed."""
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
def twin_memory(twin_capture: Capture) -> Memory:
    """What the cases of `twin_capture` share."""
    return Memory(twin_capture)


@pytest.fixture(scope="session")
def people_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Enrolment of two people, three fingers, two sessions, as result folders; not to be changed."""
    return enrolled.people(tmp_path_factory.mktemp("people"))


@pytest.fixture(scope="session")
def people(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people's right index fingers in two sessions, simulated; not to be changed."""
    folder = tmp_path_factory.mktemp("batch") / "people"
    settings = PopulationSettings(seed=3, scale=0.08)
    simulate_population(folder, settings, subjects=2, sessions=2, fingers=("right_index",), workers=1)
    return folder


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of independent data (SPLITKNIT_DATA, else ../shared/data beside the checkout); skips where absent."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("SPLITKNIT_DATA") or default)
    if not folder.is_dir():
        pytest.skip(f"independent data not found at {folder} (set SPLITKNIT_DATA)")
    return folder


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs the built rig."""
    if os.environ.get("SPLITKNIT_HARDWARE"):
        return
    skip = pytest.mark.skip(reason="needs the built rig on a Raspberry Pi (set SPLITKNIT_HARDWARE=1)")
    for item in items:
        if "hardware" in item.keywords:
            item.add_marker(skip)
