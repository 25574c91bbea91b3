"""The thesis's experiment at a tenth of its size, its table of claims."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from script_folder import Script, scripts_of

THESIS = Path(__file__).resolve().parents[2] / "validation" / "thesis"


@pytest.fixture
def thesis() -> Iterator[Script]:
    """Import a script of validation/thesis by its name."""
    with scripts_of(THESIS) as named:
        yield named


def test_the_dry_run_lists_the_steps_and_makes_nothing(tmp_path: Path) -> None:
    out = tmp_path / "again"
    listed = subprocess.run(
        [THESIS / "reproduce.sh", "--dry-run", out], capture_output=True, text=True, check=True, timeout=20
    ).stdout
    steps = [
        "simulate population",
        " batch ",
        "run.py cases",
        "run.py fusion",
        "run.py figures",
        "claims",
    ]
    assert [word for word in steps if word in listed] == steps
    assert not out.exists()


def test_the_claims_of_the_committed_tables_are_those_of_the_page(thesis: Script) -> None:
    claims, report = thesis("claims"), thesis("report")
    names = {part[1] for parts in claims.CLAIMS.values() for part in parts}
    known = report.read(claims.KNOWN)
    lines = claims.table({name: report.read(THESIS / f"{name}.csv") for name in names}, known)
    assert "not measured" not in lines
    first = next(line for line in lines.splitlines() if line.startswith("| 1 |"))
    page, here = first.split(" | ")[2:4]
    assert here == f"snk {page}"
    assert re.search(r"not measured", claims.table({name: [] for name in names}, known)) is not None


def test_figure_5_6_has_the_thesis_s_bars_beside_ours(thesis: Script) -> None:
    figures, plots, report = thesis("figures"), thesis("plots"), thesis("report")
    groups = figures.accuracies(report.read(THESIS / "cases.csv"))
    assert [[name for name, *_ in bars] for _, bars in groups] == [["ea", "snk", "ea, thesis", "snk, thesis"]] * 3
    assert plots.bars_figure(groups) != plots.bars_figure(figures.accuracies([]))


def test_closed_set_scores_are_of_a_query_over_one_session(thesis: Script) -> None:
    trials, authors = thesis("trials"), thesis("authors")
    fingers, sessions = ("S01/a", "S02/a", "S03/a"), ("1", "2")
    names = [(f"{finger}/{session}", finger, session) for finger in fingers for session in sessions]
    columns = zip(*((name, finger[:3], finger, session) for name, finger, session in names), strict=True)
    captures = trials.Captures(*(np.array(column) for column in columns))
    a, b = np.triu_indices(6, 1)
    pairs = trials.Pairs(captures, a, b)
    similarity = np.where(pairs.genuine, 5.0, 1.0 + 0.1 * (a + b))
    across = authors.across_sessions(pairs)
    assert across.sum() == 9
    those, scaled = authors.closed_set(pairs.taken(across), similarity[across])
    assert len(scaled) == 6 * 3
    assert scaled.min() == 0.0
    np.testing.assert_array_equal(scaled[those.genuine], 1.0)
    ends = {"normals": np.array([0.0, 1.0, 0.5]), "shape_normals": np.array([1.0, 3.0, 2.0])}
    np.testing.assert_allclose(authors.fused(ends), [0.0, 0.5, 0.25])
