"""The small population reconstructed once, and a larger one whose templates are invented."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from batch_stores import CASES, run, waves
from splitknit.io.enrolment import open_enrolment
from splitknit_match.batch.features import failed_row
from splitknit_match.batch.population import read_population
from splitknit_match.batch.store import open_store, write_table


@pytest.fixture(scope="session")
def reconstructed(people: Path, tmp_path_factory) -> Path:
    """Their store after the first stage, a file a capture; not to be changed."""
    out = tmp_path_factory.mktemp("batch") / "store"
    run(people, out)
    return out


@pytest.fixture
def store(reconstructed: Path, tmp_path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(reconstructed, tmp_path / "store"))


@pytest.fixture(scope="session")
def invented(tmp_path_factory) -> tuple[Path, Path]:
    """Population and store of 2 subjects x 2 fingers x 3 sessions: templates of waves, no captures;
    not to be changed.

    The second finger of the second subject could not be acquired in the third session.
    """
    folder = tmp_path_factory.mktemp("invented")
    population, out = folder / "people", folder / "store"
    enrolment = open_enrolment(
        population, subjects=2, sessions=3, fingers=("right_thumb", "right_index")
    )
    for place in enrolment.places():
        enrolment.path(place).mkdir(parents=True)
        (enrolment.path(place) / "capture.json").touch()
    out.mkdir()
    there = read_population(population)
    open_store(out, there.sha256, {case.name: case.document() for case in CASES}, {}, {})
    for number, capture in enumerate(there.captures):
        row = failed_row(capture, "no finger.")
        if capture.name != "S02/session_3/right_index":
            row |= {
                "acquired": True,
                "failure": "",
                "area_mm2": 70.0,
                "template": waves(capture.finger, number),
            }
        origin = {"kind": "features", "inputs": {capture.name: f"{number:064x}"}}
        write_table(out / "features" / "ea" / f"{capture.name}.npz", [row], origin)
    return population, out


@pytest.fixture
def copies(invented: tuple[Path, Path], tmp_path) -> tuple[Path, Path]:
    """Population and a copy of its store."""
    return invented[0], Path(shutil.copytree(invented[1], tmp_path / "invented"))
