"""``splitknit rig optimise``: a sweep from the command line to the page."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import splitknit_rig.rig.optimise as module
from splitknit.cli.main import main

Captured = pytest.CaptureFixture[str]
SMALL = ["--heights-mm", "100,140", "--radii-mm", "52.5,80", "--powers-w", "1", "--resolutions", "6", "--fingers", "2"]

ONE = [*SMALL, "--heights-mm", "140", "--radii-mm", "52.5"]


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished sweep of 2 x 2 x 1 rigs at 6 px/mm (scale 0.08)."""
    out = tmp_path_factory.mktemp("rig") / "out"
    assert main(["rig", "optimise", "--out", str(out), *SMALL, "--workers", "1", "--json"]) == 0
    return out


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished sweep of one of them."""
    out = tmp_path_factory.mktemp("quick") / "out"
    assert main(["rig", "optimise", "--out", str(out), *ONE, "--workers", "1", "--json"]) == 0
    return out


@pytest.mark.slow
def test_a_small_sweep_gives_a_result(swept: Path) -> None:
    results = json.loads((swept / "results.json").read_text())
    assert results["counts"] == {"done": 4, "refused": 0, "failed": 0}
    assert results["best"]["name"] in results["as_good"]
    assert results["best"]["name"] in results["pareto"]
    figures = [one["mean"]["surface_rms_mm"] for one in results["records"]]
    assert results["best"]["surface_rms_mm"] == min(figures)
    assert all(0.3 < value < 1.2 for value in figures)
    with (swept / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [one["candidate"]["name"] for one in results["records"]]
    assert float(rows[0]["surface_rms_mm"]) == pytest.approx(figures[0], rel=1e-5)
    assert {row["tilt_deg"] for row in rows} == {"centre"}


@pytest.mark.slow
def test_a_finished_sweep_is_not_done_again(swept: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    def never(*unused: object) -> None:
        raise AssertionError("measured again")

    monkeypatch.setattr(module, "evaluate_candidate", never)
    before = {path.name: path.read_bytes() for path in swept.iterdir() if path.is_file()}
    assert main(["rig", "optimise", "--out", str(swept), *SMALL]) == 0
    said = capsys.readouterr()
    assert "4 rigs in" in said.out and "100 mm" in said.out and "indistinguishable from the best" in said.out
    assert said.err == ""
    assert {path.name: path.read_bytes() for path in swept.iterdir() if path.is_file()} == before


def test_help_is_said(capsys: Captured) -> None:
    assert main(["rig", "optimise", "--help"]) == 0
    assert "every combination is tried" in " ".join(capsys.readouterr().out.split())


def test_json_is_one_object(quick: Path, capsys: Captured) -> None:
    assert main(["rig", "optimise", "--out", str(quick), *ONE, "--objective", "ridges", "--json"]) == 0
    said = capsys.readouterr()
    facts = json.loads(said.out)
    assert (
        facts["objective"] == "ridges"
        and facts["figure"] == "ridge_rms_um"
        and "results.csv" in facts["files"]
        and said.err == ""
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--heights-mm", ""], "--heights-mm is empty"),
        (["--radii-mm", " , "], "--radii-mm is empty"),
        (["--tilts-deg", ","], "--tilts-deg is empty"),
        (["--powers-w", "1,much"], "--powers-w must list numbers with commas between them, but it holds 'much'"),
        (["--tilts-deg", "centre,steep"], "it holds 'steep'"),
        (["--heights-mm", "-140"], "rig.height_mm must be from 20 to 1000, but it is -140"),
        (["--powers-w", "0"], "rig.power_w must be from 0.0001 to 100"),
        (["--radii-mm", "nan"], "rig.radius_mm must be from 1 to 1000"),
        (["--resolutions", "100"], "rig.px_per_mm must be from 3 to 75.7"),
        (["--fingers", "0"], "study.fingers must be from 1 to 200, but it is 0"),
        (["--workers", "0"], "the number of workers must lie between"),
        (["--f-number", "-2"], "photons.f_number must be positive"),
        (["--half-angle-deg", "2"], "build.half_angle_deg must be from 5 to 90, but it is 2.0"),
        (["--heights-mm", "300,400"], "not one of the 4 rigs can be built"),
        (["--led-drop-mm", "30", "--tilts-deg", "80"], "not one of the 4 rigs can be built"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_sentence(
    tmp_path: Path, arguments: list[str], words: str, capsys: Captured
) -> None:
    out = tmp_path / "out"
    assert main(["rig", "optimise", "--out", str(out), *SMALL, *arguments]) == 2
    said = capsys.readouterr()
    assert words in said.err and said.err.count("\n") == 1 and said.out == ""
    assert not out.exists()


def test_foreign_files_and_other_settings_are_left_alone(quick: Path, tmp_path: Path, capsys: Captured) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert main(["rig", "optimise", "--out", str(tmp_path), *SMALL]) == 2
    assert "mine.txt" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    assert main(["rig", "optimise", "--out", str(quick), *ONE, "--method", "metric"]) == 2
    assert "other settings (method)" in capsys.readouterr().err


@pytest.mark.slow
def test_an_interrupt_keeps_what_is_finished_and_the_next_run_completes_it(swept: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "splitknit.cli.main", "rig", "optimise", "--out", str(out), *SMALL]
    running = subprocess.Popen([*command, "--workers", "2"], stderr=subprocess.PIPE, start_new_session=True, text=True)
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not list(out.glob("candidates/h*.json")):
        time.sleep(0.02)
    os.killpg(running.pid, signal.SIGINT)  # as Ctrl-C does: to the workers as well
    _, said = running.communicate(timeout=120)
    kept = {path.name: path.read_bytes() for path in (out / "candidates").iterdir()}
    assert running.returncode == 130 and "interrupted" in said and "Traceback" not in said
    assert 1 <= len(kept) < 4 and not (out / "results.json").exists()
    assert main([*command[3:], "--workers", "1"]) == 0
    for path in (out / "candidates").iterdir():
        assert kept.get(path.name, path.read_bytes()) == path.read_bytes()
        assert path.read_bytes() == (swept / "candidates" / path.name).read_bytes()
    assert (out / "results.json").read_bytes() == (swept / "results.json").read_bytes()
