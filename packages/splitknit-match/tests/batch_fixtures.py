"""The small population reconstructed once, and a larger one whose templates are invented."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from batch_stores import EA, waves
from splitknit.io.enrolment import open_enrolment
from splitknit_match.batch.chunks import SUFFIX, write_chunk
from splitknit_match.batch.engine import run_batch
from splitknit_match.batch.features import BANDS, COLUMNS, QUALITY
from splitknit_match.batch.population import read_population
from splitknit_match.batch.settings import BatchSettings, preset_cases
from splitknit_match.batch.store import open_store


@pytest.fixture(scope="session")
def reconstructed(people: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Their store after the first stage, in two chunks; not to be changed."""
    out = tmp_path_factory.mktemp("batch") / "store"
    run_batch(people, out, EA, jobs=1)
    return out


@pytest.fixture
def store(reconstructed: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(reconstructed, tmp_path / "store"))


@pytest.fixture(scope="session")
def invented(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Population and store of 2 subjects x 2 fingers x 3 sessions: templates of waves, no captures; not to be changed.

    The second finger of the second subject could not be acquired in the third session.
    """
    folder = tmp_path_factory.mktemp("invented")
    population, out = folder / "people", folder / "store"
    enrolment = open_enrolment(population, subjects=2, sessions=3, fingers=("right_thumb", "right_index"))
    for place in enrolment.places():
        enrolment.path(place).mkdir(parents=True)
        (enrolment.path(place) / "capture.json").touch()
    out.mkdir()
    there = read_population(population)
    settings = BatchSettings(cases=preset_cases(("ea",)), matchers=())
    open_store(out, there, settings)
    rows = []
    for number, capture in enumerate(there.captures):
        failed = capture.name == "S02/session_3/right_index"
        row = dict.fromkeys(f"{name}_{band}" for band in BANDS for name in QUALITY)
        row |= {"capture": capture.name, "subject": capture.subject, "finger": capture.finger}
        row |= {"session": capture.session, "acquired": not failed, "failure": "no finger." if failed else ""}
        row |= {"area_mm2": 0.0 if failed else 70.0, "warnings": [], "input_sha256": f"{number:064x}"}
        row |= {"template": b"" if failed else waves(capture.finger, number), "print": b"", "images": b""}
        rows.append(row)
    write_chunk(out / "features" / "ea" / f"00000-invented{SUFFIX}", rows, COLUMNS, {"kind": "features"})
    return population, out


@pytest.fixture
def copies(invented: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    """Population and a copy of its store."""
    return invented[0], Path(shutil.copytree(invented[1], tmp_path / "invented"))
