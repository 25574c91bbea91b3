"""``splitknit simulate population``: laid out as an enrolment, the same however it was made,
resumable."""

import csv
import fcntl
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from enrolled import refusal_of
from splitknit.cli.main import main
from splitknit.io.capture import read_capture
from splitknit.io.enrolment import FINGERS, open_enrolment
from splitknit.io.images import write_image
from splitknit.io.npz import read_npz
from splitknit.settings import override
from splitknit_simulator.finger.master_print import ink_print, master_print
from splitknit_simulator.population.folder import _population_hash, choose_prints
from splitknit_simulator.population.sessions import PopulationSettings, population_capture

SMALL = (
    "--scale",
    "0.08",
    "--subjects",
    "2",
    "--fingers",
    "right_index,left_thumb",
    "--sessions",
    "2",
)


def words(out, *more, small=SMALL):
    return [*f"simulate population --out {out}".split(), *small, *more]


def refused(capsys, *arguments):
    capsys.readouterr()
    return refusal_of(capsys, *arguments)


def digests(folder):
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def population(tmp_path_factory):
    """Two people, two fingers, two sessions, by one process."""
    out = tmp_path_factory.mktemp("population") / "made"
    assert main(words(out, "--workers", "1")) == 0
    return out


def test_it_is_laid_out_as_an_enrolment(population):
    enrolment = open_enrolment(population)
    assert (enrolment.plan.subjects, enrolment.plan.sessions) == (2, 2)
    assert enrolment.plan.fingers == ("right_index", "left_thumb")
    assert enrolment.waiting() == []
    for place in enrolment.places():
        capture = read_capture(enrolment.path(place))
        assert capture.subject == {
            "id": place.subject,
            "finger": place.finger,
            "session": place.session,
        }
        facts = json.loads((enrolment.path(place) / "impression.json").read_text())
        assert (facts["subject"], facts["finger"], facts["session"]) == (
            place.subject,
            place.finger,
            place.session,
        )
        truth = read_npz(enrolment.path(place) / "truth.npz")
        assert truth["height_mm"].shape == capture.shape
        assert float(truth["impression_roll_deg"]) == facts["roll_deg"]
        assert str(truth["impression_finger"]) == place.finger
    document = json.loads((population / "population.json").read_text())
    assert document["settings"]["scale"] == 0.08
    assert document["settings_sha256"] == _population_hash(PopulationSettings(scale=0.08))


def test_the_table_lists_all_captures(population):
    rows = list(csv.DictReader((population / "population.csv").read_text().splitlines()))
    assert [row["folder"] for row in rows] == [
        place.folder for place in open_enrolment(population).places()
    ]
    first = json.loads((population / rows[0]["folder"] / "impression.json").read_text())
    assert float(rows[0]["roll_deg"]) == first["roll_deg"]
    assert {
        row["pattern"] for row in rows if row["subject"] == "S01" and row["finger"] == "left_thumb"
    } == {rows[1]["pattern"]}


@pytest.mark.slow
def test_a_killed_run_goes_on_with_other_workers_to_the_same_bytes(population, tmp_path):
    out = tmp_path / "killed"
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    run = subprocess.Popen(
        [sys.executable, "-m", "splitknit.cli.main", *words(out, "--workers", "2")],
        env=environment,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
    )
    until = time.monotonic() + 60
    while not list(out.glob("S*/session_*/[!.]*/capture.json")) and time.monotonic() < until:
        time.sleep(0.02)
    run.send_signal(signal.SIGKILL)  # the parent alone: its workers must notice
    run.wait()
    while list_of_processes(out) and time.monotonic() < until:
        time.sleep(0.05)
    assert not list_of_processes(out)
    captures = sorted(path.parent for path in out.glob("S*/session_*/[!.]*/capture.json"))
    assert 1 <= len(captures) < 8, "the run was to be killed half-way"
    for folder in captures:
        assert digests(folder) == digests(population / folder.relative_to(out))
    (out / "S01" / "session_1").mkdir(parents=True, exist_ok=True)
    left = out / "S01" / "session_1" / ".splitknit-0123456789ab.tmp"  # what a killed worker leaves
    (left / "new").mkdir(parents=True)
    (left / "mark.json").write_text(
        '{"format": "splitknit-temporary", "version": 1, "target": "left_thumb"}'
    )
    mine = left.with_name(".left_thumb.0123456789ab.tmp")  # and what it does not
    mine.mkdir()
    stamps = {folder: (folder / "capture.json").stat().st_mtime_ns for folder in captures}
    assert main(words(out, "--workers", "1")) == 0
    assert digests(out) == digests(population)
    assert list(out.rglob("*.tmp")) == [mine]
    assert all(
        (folder / "capture.json").stat().st_mtime_ns == stamp for folder, stamp in stamps.items()
    )


@pytest.mark.slow
def test_a_table_that_is_not_ours_and_links_are_not_written(population, tmp_path, capsys):
    out, mine = tmp_path / "people", tmp_path / "mine.csv"
    shutil.copytree(population, out)
    mine.write_text("my own")
    table = out / "population.csv"
    table.write_text("my own")
    assert "is not the table of a population" in refused(capsys, *words(out))
    assert table.read_text() == "my own"
    table.unlink()
    table.symlink_to(mine)
    assert "is not the table of a population" in refused(capsys, *words(out))
    table.unlink()
    (out / "S02" / "session_2").rename(tmp_path / "away")
    (out / "S02" / "session_2").symlink_to(tmp_path / "away")
    shutil.rmtree(tmp_path / "away" / "left_thumb")
    for workers in ("1", "2"):
        assert "session_2' is a link inside a folder" in refused(
            capsys, *words(out, "--workers", workers)
        )
    assert [path.name for path in (tmp_path / "away").iterdir()] == ["right_index"]
    assert mine.read_text() == "my own"


def list_of_processes(out):
    """Processes whose command line or parent's names `out`; spawned workers name only their
    parent's pipe."""
    alive = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            line = (entry / "cmdline").read_bytes()
            opened = (
                [str(link.readlink()) for link in (entry / "fd").iterdir()]
                if b"spawn_main" in line
                else []
            )
        except OSError:
            continue
        if str(out).encode() in line or any(str(out) in name for name in opened):
            alive.append(entry.name)
    return alive


@pytest.mark.slow
def test_a_plan_may_grow(population, tmp_path, capsys):
    out = tmp_path / "grown"
    shutil.copytree(population, out)
    capsys.readouterr()
    more = (
        "--scale",
        "0.08",
        "--subjects",
        "2",
        "--fingers",
        "right_index,left_thumb,left_little",
        "--sessions",
        "2",
    )
    assert main(words(out, "--workers", "1", "--json", small=more)) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["found"], facts["simulated"], facts["total"]) == (8, 4, 12)
    before, after = digests(population), digests(out)
    assert all(after[name] == digest for name, digest in before.items() if name.startswith("S"))


def test_finished_populations_are_left_alone(population, capsys):
    before = digests(population)
    assert main(f"simulate population --out {population} --scale 0.08 --json".split()) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["simulated"], facts["seconds_per_capture"]) == (0, None)
    assert digests(population) == before


def test_other_settings_are_refused(population, capsys):
    before = digests(population)
    assert "other settings (scale)" in refused(
        capsys, *words(population, small=("--scale", "0.09"))
    )
    assert "other settings (seed)" in refused(capsys, *words(population, "--seed", "3"))
    changed = words(population, "--set", "sessions.roll_sd_deg=2")
    assert "other settings (sessions.roll_sd_deg)" in refused(capsys, *changed)
    assert "may grow but not shrink" in refused(capsys, *words(population, "--subjects", "1"))
    assert digests(population) == before


def test_settings_change_the_hash_and_threads_do_not():
    settings = PopulationSettings()
    assert _population_hash(override(settings, {"render.workers": 7})) == _population_hash(settings)
    assert _population_hash(override(settings, {"people.men": 0.4})) != _population_hash(settings)


def test_what_cannot_be_a_population_is_refused(tmp_path, capsys):
    enrolment = tmp_path / "other"
    open_enrolment(enrolment, subjects=1, sessions=1)
    (enrolment / "S01" / "session_1" / "right_index").mkdir(parents=True)
    assert "something else than a simulated population" in refused(capsys, *words(enrolment))
    new = tmp_path / "new"
    assert "Expected right_thumb or right_index" in refused(
        capsys, *words(new, small=("--fingers", "toe"))
    )
    assert "workers must be 1 to 256" in refused(capsys, *words(new, "--workers", "0"))
    assert "--pattern does not go with a population" in refused(
        capsys, *words(new, "--pattern", "loop")
    )
    assert "--bench does not go with a population" in refused(capsys, *words(new, "--bench"))
    assert "--subjects is for 'splitknit simulate population'" in refused(
        capsys, "simulate", "--out", str(new), "--subjects", "2"
    )
    assert not new.exists()
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    (damaged / "population.json").write_text("{")
    assert "it is damaged" in refused(capsys, *words(damaged))


def test_two_runs_do_not_write_one_population(population, capsys):
    with (population / "population.json").open("rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        assert "another run is simulating" in refused(capsys, *words(population))


def test_a_damaged_capture_is_named(population, tmp_path, capsys):
    out = tmp_path / "spoilt"
    shutil.copytree(population, out)
    (out / "S02" / "session_1" / "left_thumb" / "impression.json").write_text("[1")
    assert "S02/session_1/left_thumb/impression.json' is damaged" in refused(capsys, *words(out))


@pytest.mark.slow
def test_one_finger_is_simulated_as_before(tmp_path, capsys):
    for name, what in (("plain", []), ("named", ["finger"])):
        assert (
            main(
                ["simulate", *what, "--out", str(tmp_path / name), "--scale", "0.08", "--seed", "4"]
            )
            == 0
        )
        assert (
            f"Next: splitknit reconstruct {tmp_path / name} --out RESULT" in capsys.readouterr().out
        )
    assert digests(tmp_path / "plain") == digests(tmp_path / "named")


PRINTED = ("--scale", "0.08", "--subjects", "3", "--fingers", "right_index", "--sessions", "2")


@pytest.fixture(scope="module")
def prints(tmp_path_factory):
    """One real finger in two impressions."""
    folder = tmp_path_factory.mktemp("prints")
    for number, seed in enumerate((5, 6), 1):
        write_image(folder / f"101_{number}.png", ink_print(master_print("whorl", seed)))
    return folder


@pytest.mark.slow
def test_a_third_of_the_fingers_have_ridges_of_real_prints(population, tmp_path, prints, capsys):
    """One real finger is one finger in all sessions; all else is as without prints, and it goes on
    as it was begun."""
    out = tmp_path / "printed"
    seeded = ("--prints", str(prints), "--workers", "1", "--seed", "1")
    assert main(words(out, *seeded, small=PRINTED)) == 0
    assert "1 of 3 fingers have the ridges of a real print." in capsys.readouterr().out
    rows = list(csv.DictReader((out / "population.csv").read_text().splitlines()))
    real = {row["subject"] for row in rows if row["print"] == "101_1.png"}
    assert len(real) == 1 and sum(row["print"] == "" for row in rows) == 4
    subject = real.pop()
    document = json.loads((out / "population.json").read_text())
    settings = PopulationSettings(scale=0.08, seed=1)
    assert list(document["prints"]) == [f"{subject}/right_index"]
    assert document["settings_sha256"] != _population_hash(settings)
    for row in rows[:3]:
        drawn = population_capture(
            settings, settings.person(int(row["subject"][1:])), "right_index", 1
        )
        truth = read_npz(out / row["folder"] / "truth.npz")
        both = truth["mask"] & drawn.truth["mask"]
        np.testing.assert_allclose(
            truth["shape_mm"][both], drawn.truth["shape_mm"][both], atol=1e-5
        )
        same = np.abs(truth["height_mm"] - drawn.truth["height_mm"])[both].max() < 1e-9
        assert same == (row["subject"] != subject)
        assert (
            (truth["landmark_pattern"] == "print")
            == (row["pattern"] == "print")
            == (row["subject"] == subject)
        )
        assert float(row["roll_deg"]) == drawn.facts["roll_deg"]

    before = digests(out)
    shutil.rmtree(out / subject / "session_2" / "right_index")
    assert main(words(out, *seeded, small=PRINTED)) == 0
    assert digests(out) == before
    assert "other settings (prints)" in refused(capsys, *words(out, "--seed", "1", small=PRINTED))
    assert "begun without real prints" in refused(
        capsys, *words(population, "--prints", str(prints))
    )
    others = tmp_path / "others"
    others.mkdir()
    shutil.copy(prints / "101_2.png", others / "101_1.png")
    assert "is not the print" in refused(
        capsys, *words(out, "--seed", "1", "--prints", str(others), small=PRINTED)
    )


def test_prints_that_cannot_be_used_are_refused(tmp_path, prints, capsys):
    out, empty = tmp_path / "out", tmp_path / "empty"
    assert "is not a folder of prints" in refused(capsys, *words(out, "--prints", str(empty)))
    empty.mkdir()
    assert "holds no prints" in refused(capsys, *words(out, "--prints", str(empty)))
    write_image(empty / "1_1.png", np.full((300, 300), 255, dtype=np.uint8))
    assert "1_1.png: the image shows no ridges" in refused(
        capsys, *words(out, "--prints", str(empty))
    )
    assert "--prints is for 'splitknit simulate population'" in refused(
        capsys, "simulate", "--out", str(out), "--prints", str(prints)
    )
    assert not out.exists()


@pytest.mark.slow
def test_prints_are_dealt_evenly_and_one_finger_is_one_identity(tmp_path):
    ink = ink_print(master_print("whorl", 5))
    for name in ("a_1", "a_2", "a_10", "b_c_3", "b_c_4", "d"):
        write_image(tmp_path / f"{name}.png", ink)
    subjects, fingers = (
        tuple(f"S{k:02d}" for k in range(1, 5)),
        ("left_ring", "right_ring", "left_index"),
    )
    dealt = choose_prints(tmp_path, 3, subjects, fingers).of_finger
    assert [
        sum(real_print.mirrored is mirrored for real_print in dealt.values())
        for mirrored in (False, True)
    ] == [3, 1]
    assert {real_print.file for real_print in dealt.values() if not real_print.mirrored} == {
        "a_1.png",
        "b_c_3.png",
        "d.png",
    }
    assert sorted(finger.split("/")[0] for finger in dealt) == list(subjects)
    assert choose_prints(tmp_path, 3, subjects, fingers).of_finger == dealt
    assert choose_prints(tmp_path, 4, subjects, fingers).of_finger != dealt
    few = choose_prints(tmp_path, 3, subjects, FINGERS).of_finger
    assert len(few) == 6, "thirteen would be a third, but there are three real fingers"
