"""A newcomer's walks, with the environment of the tests."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from script_folder import VALIDATION, scripts_of


@pytest.fixture(scope="module")
def walk():
    with scripts_of(VALIDATION / "newcomer") as found:
        yield found("walk")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["photographs", "prints"])
def test_every_step_goes_as_it_must(walk, name: str, tmp_path: Path) -> None:
    log = tmp_path / "log.md"
    assert walk.main([name, "--python", sys.executable, "--out", str(tmp_path), "--log", str(log)]) == 0
    assert "    $ splitknit" in log.read_text(encoding="utf-8")


def test_steps_that_go_otherwise_are_counted(walk, tmp_path: Path, monkeypatch, capsys) -> None:
    """A message that is missing, another exit code, and a file that was not made."""
    steps = [
        walk.Step("match a.skt b.skt", 2, "a.skt"),
        walk.Step("match a.skt b.skt", 2, "nothing of the kind"),
        walk.Step("match a.skt b.skt", 0),
        walk.Step("--version", makes="page.html"),
    ]
    monkeypatch.setitem(walk.WALKS, "few", lambda folder: steps)
    assert walk.main(["few", "--python", sys.executable, "--out", str(tmp_path)]) == 1
    assert "3 of 4 steps went wrong." in capsys.readouterr().out
