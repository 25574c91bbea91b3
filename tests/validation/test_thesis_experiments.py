"""The thesis's experiments run on a made-up store, and their rules are what they say."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from script_folder import Script, scripts_of

THESIS = Path(__file__).resolve().parents[2] / "validation" / "thesis"
SUBJECTS, FINGERS, SESSIONS = 6, ("left_thumb", "right_index"), 3


@pytest.fixture
def thesis() -> Iterator[Script]:
    """Import a script of validation/thesis by its name."""
    with scripts_of(THESIS) as named:
        yield named


class MadeUpStore:
    """Scores drawn at random: genuine ones higher, those of ``ea`` less so; ``pr`` lacks captures
    of one person."""

    def __init__(self) -> None:
        self.names = [
            f"S{s:02d}/session_{k}/{finger}"
            for s, k, finger in product(range(1, SUBJECTS + 1), range(1, SESSIONS + 1), FINGERS)
        ]

    def rows(self, case: str) -> list[list[str]]:
        names = [name for name in self.names if not (case == "pr" and name.startswith("S06"))]
        return [[name, *name.split("/")] for name in names]

    def features(self, case: str, columns: Any = None) -> Any:
        if case == "none":
            raise ValueError("nothing of this case")
        rows = self.rows(case)
        table = {
            "capture": [row[0] for row in rows],
            "subject": [row[1] for row in rows],
            "finger": [f"{row[1]}/{row[3]}" for row in rows],
            "session": [row[2][-1] for row in rows],
            "acquired": [k > 0 for k in range(len(rows))],
            "failure": ["" if k > 0 else "too dark" for k in range(len(rows))],
            "area_mm2": [300.0] * len(rows),
        }
        return {name: np.array(table[name]) for name in columns or table}

    def scores(self, case: str, matcher: str) -> Any:
        if matcher == "minutiae" or case == "none":
            raise ValueError("nothing of these")
        names = [row[0] for row in self.rows(case)]
        pairs = [(a, b) for a, b in product(names, names) if a.split("/")[1] < b.split("/")[1]]
        genuine = np.array([a.split("/")[::2] == b.split("/")[::2] for a, b in pairs])
        generator = np.random.default_rng([len(case), len(matcher)])
        good = generator.normal(size=(4, len(pairs))) + (1.0 if case == "ea" else 2.5) * genuine
        compared = np.array([names[0] not in pair for pair in pairs])
        table = {
            "a": [a for a, _ in pairs],
            "b": [b for _, b in pairs],
            "compared": compared,
            "similarity": good[3],
        }
        if matcher == "thesis":
            overlap = np.where(genuine, 0.95, generator.uniform(0.8, 1.0, len(pairs)))
            table |= {"ratio": overlap}
            for k, name in enumerate(("normals", "relief", "shape_normals")):
                table[f"dissimilarity_{name}"] = 0.9 - 0.02 * good[k]
        return {name: np.array(column) for name, column in table.items()}


def population(folder: Path, store: MadeUpStore) -> Path:
    generator = np.random.default_rng(1)
    for name in store.names:
        place = folder / name
        place.mkdir(parents=True)
        facts = {
            "roll_deg": generator.normal(0, 6),
            "glare": generator.uniform(0.5, 1.3),
            "moisture": generator.uniform(),
            "partial": bool(generator.uniform() < 0.2),
            "print": "101_1.png" if (name[:3], name[-5:]) == ("S02", "thumb") else "",
        }
        (place / "impression.json").write_text(json.dumps(facts))
    document = {"settings_sha256": "0" * 64, "settings": {"seed": 1, "scale": 0.1}}
    (folder / "population.json").write_text(json.dumps(document))
    return folder


def read(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
def test_all_parts_on_a_made_up_store(
    tmp_path: Path, thesis: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = thesis("run")
    store = MadeUpStore()
    people = population(tmp_path / "people", store)
    monkeypatch.setattr(run, "_store", lambda options: store)
    out = tmp_path / "out"
    parts = ("fusion", "cases", "matchers", "sensitivity", "failures")
    for part in parts:
        command = [
            part,
            "--population",
            str(people),
            "--out",
            str(out),
            "--replicates",
            "20",
            "--jobs",
            "1",
        ]
        assert run.main([*command, "--cases", "snk", "pr", "ea", "none"]) == 0
    monkeypatch.setattr(run, "PARTS", parts)
    monkeypatch.setattr(run, "run_part", lambda *_: pytest.fail("a finished part is made again"))
    command = f"all --population {people} --out {out} --replicates 20 --jobs 1".split()
    assert run.main([*command, "--cases", "snk", "pr", "ea", "none"]) == 0
    (out / "failures.csv").unlink()
    with pytest.raises(pytest.fail.Exception, match="made again"):
        run.main([*command, "--cases", "snk", "pr", "ea", "none"])
    rows = read(out / "cases.csv")
    real = [
        row
        for row in rows
        if row["kept"] == "printed" and (row["case"], row["attribute"]) == ("snk", "relief")
    ]
    # one finger has a real print, in three pairs of sessions
    assert [int(row["genuine"]) for row in real] == [3]
    assert [int(row["impostors"]) for row in real] == [2 * 9 * 3]
    assert {row["case"] for row in rows} == {"snk", "pr", "ea"}
    plain = {
        (row["case"], row["attribute"]): row
        for row in rows
        if (row["gate"], row["sessions"], row["kept"]) == ("none", "single", "all")
    }
    own = plain["snk", "relief"]
    # five people (pr lacks one) x two fingers, three pairs of sessions
    assert int(own["genuine"]) == 5 * 2 * 3
    assert int(own["impostors"]) == 10 * 9 * 3
    # one capture of the first session failed: two later sessions x ten fingers
    assert int(own["failures"]) == 2 * 10
    assert float(own["gar@0.01"]) > float(plain["ea", "relief"]["gar@0.01"])
    assert (
        float(own["gar@0.01_low_finger"])
        <= float(own["gar@0.01"])
        <= float(own["gar@0.01_high_finger"])
    )
    # 270 impostors support a FAR of 1 %, not of 0.1 %
    assert own["gar@0.001"] == "" and own["accepts@0.001"] == "0" and own["accepts@0.01"] == "2"
    passing = [
        row
        for row in rows
        if row["gate"] == "passing" and row["sessions"] == "single" and row["kept"] == "all"
    ]
    assert all(0 < int(row["impostors"]) < 270 for row in passing)
    assert len({row["impostors"] for row in passing}) == 1
    differences = read(out / "cases_differences.csv")
    two = next(
        row
        for row in differences
        if (row["first"], row["second"], row["gate"]) == ("snk", "ea", "none")
    )
    assert float(two["eer"]) < 0
    runs = json.loads((out / "runs.json").read_text())
    assert runs["cases"]["thesis"]["missing"] == ["none by thesis"]
    assert runs["failures"]["failures"] == {"snk": 1, "pr": 1, "ea": 1}
    # genuine pairs of the made-up store overlap by 0.95
    kept = {"fingers": 10, "fingers_refused": 0, "pairs": 30, "pairs_refused": 0}
    assert runs["failures"]["refused_by_gate"] == {"snk": kept, "pr": kept, "ea": kept}
    assert {row["matcher"] for row in read(out / "matchers.csv")} == {"ridge"}
    assert {row["factor"] for row in read(out / "sensitivity.csv")} == {
        "roll",
        "glare",
        "moisture",
        "partial",
    }
    thesis("report").write(out, out / "page.md")
    filled = (out / "page.md").read_text()
    assert "|5.4|normals, SnK|1 %|92|" in filled and "too few impostors (270)" in filled
    assert (out / "tables" / "ridge.csv").is_file()
    assert not (out / "tables" / "family.csv").exists(), "not measured"
    assert (out / "figure-5-4.svg").read_bytes().startswith(b"<?xml")


def test_the_gate_follows_the_thesis_and_only_impostors_that_pass_are_kept(thesis: Script) -> None:
    trials, variants = thesis("trials"), thesis("variants")
    captures = trials.Captures(
        np.array(["A/1", "A/2", "B/1", "B/2"]),
        np.array(["A", "A", "B", "B"]),
        np.array(["A", "A", "B", "B"]),
        np.array(["1", "2", "1", "2"]),
    )
    pairs = trials.Pairs(captures, np.array([0, 0, 2, 2]), np.array([1, 3, 1, 3]))  # AA AB BA BB
    ratio = np.array([0.95, 0.8, 0.92, 0.85])
    trial = trials.Trial(
        "snk", "thesis", "relief", np.array([0.1, 0.2, 0.3, 0.4]), ratio, 1 - np.exp(2 - ratio)
    )
    table = trials.Table(pairs, (trial,), ())
    known = variants.known_of(
        pairs,
        {
            "A/1": {"roll_deg": 0.0},
            "A/2": {"roll_deg": 12.0},
            "B/1": {"roll_deg": 0.0},
            "B/2": {"roll_deg": 3.0, "partial": True},
        },
    )

    def judged(*how: str) -> Any:
        return variants.judged(
            pairs, trial, variants.Variant(*how), known, variants.passing_everywhere(table)
        )

    assert judged("none", "single", "all").score.tolist() == [0.1, 0.2, 0.3, 0.4]
    gated = judged("gate", "single", "all").score
    assert gated.tolist() == pytest.approx([0.1, 1 - np.exp(1.2), 0.3, 1 - np.exp(1.15)])
    passing = judged("passing", "single", "all")
    assert passing.label.tolist() == [True, False, True] and passing.score[1] == 0.3
    # A's rolls differ by 12 deg
    assert judged("none", "single", "pairs").score.tolist() == [0.2, 0.3, 0.4]
    # without B's second capture
    assert judged("none", "single", "whole").score.tolist() == [0.1, 0.3]
    assert judged("none", "averaged", "all").score.size == 4  # AB and BA stay two
    refused = {"fingers": 2, "fingers_refused": 1, "pairs": 2, "pairs_refused": 1}  # B's
    assert variants.refused_by_gate(table) == {"snk": refused}


def test_averages_over_unlike_numbers_of_sessions_are_not_given(thesis: Script) -> None:
    trials, variants = thesis("trials"), thesis("variants")
    names = np.array([f"{finger}/{session}" for finger in "ABC" for session in "123"])
    finger, session = np.array([name[0] for name in names]), np.array([name[2] for name in names])
    a, b = np.nonzero(session[:, None] < session[None, :])
    pairs = trials.Pairs(trials.Captures(names, finger, finger, session), a, b)
    assert variants.averages_agree(pairs)
    drawn_one_by_one = pairs.taken(pairs.genuine | ((a + b) % 3 == 0))
    assert not variants.averages_agree(drawn_one_by_one)
    drawn_by_fingers = pairs.taken(pairs.genuine | (finger[a] == "A"))
    assert variants.averages_agree(drawn_by_fingers)


def test_a_finger_is_discarded_by_its_largest_difference(thesis: Script) -> None:
    variants = thesis("variants")
    finger = np.array(["A", "A", "A", "B", "B"])
    assert variants.spreads(finger, np.array([-8.0, 0.0, 9.0, 3.0, np.nan])) == {
        "A": 17.0,
        "B": 0.0,
    }


@pytest.mark.slow
def test_reliefs_of_all_scales_are_those_of_the_preset(thesis: Script) -> None:
    from splitknit.pipeline import reconstruct
    from splitknit.reconstruction import surface_of
    from splitknit_match.matching.surface import surface_images
    from splitknit_simulator.scene import TwinSettings
    from splitknit_simulator.twin import simulate_capture

    scales = thesis("scales")
    capture, _ = simulate_capture(5, None, TwinSettings(scale=0.1))
    scaled = scales.snk_images(capture)
    assert len(scaled.channels) == 10
    images = surface_images(surface_of(reconstruct(capture, "snk", {"shapelets.scales": 5})))
    np.testing.assert_array_equal(scaled.channels["snk5"], images.channels["relief"])
    np.testing.assert_array_equal(scaled.channels["snk3"], scaled.channels["relief"])
    images = surface_images(surface_of(reconstruct(capture, "snk")))
    np.testing.assert_array_equal(scaled.channels["normal_x"], images.channels["normal_x"])
    np.testing.assert_array_equal(scaled.mask, images.mask)
    assert not np.array_equal(scaled.channels["snk2"], scaled.channels["snk5"])


def test_the_share_of_impostors_is_drawn_by_pair_of_fingers(thesis: Script) -> None:
    drawn = thesis("normals").drawn
    a, b = (
        np.array([f"F{k // 60}" for k in range(3600)]),
        np.array([f"F{k % 60}" for k in range(3600)]),
    )
    first = drawn(a, b, 0.25, 3)
    assert 0.22 < first.mean() < 0.28
    np.testing.assert_array_equal(first[::-1], drawn(a[::-1], b[::-1], 0.25, 3))
    assert drawn(a, b, 1.0, 3).all() and not drawn(a, b, 0.0, 3).any()
    assert (first != drawn(a, b, 0.25, 4)).any()


def test_the_tables_for_reading_are_those_of_the_committed_figures(thesis: Script) -> None:
    report = thesis("report")
    for file, text in report.files(THESIS).items():
        assert file.read_text("utf-8") == text, f"{file.name}: run validation/thesis/report.py"
    page = report.PAGE.read_text("utf-8")
    assert report.fill(page, report.blocks(THESIS)) == page


def test_the_page_marks_what_too_few_impostors_cannot_support(thesis: Script) -> None:
    report = thesis("page_tables")
    row = {
        "gar@0.01": "0.9",
        "gar@0.01_low_finger": "0.8",
        "gar@0.01_high_finger": "0.95",
        "accepts@0.01": "9",
    }
    assert report.gar_cell(row, "0.01") == "90.0 [80.0, 95.0] †"
    assert report.gar_cell(row | {"accepts@0.01": "10"}, "0.01") == "90.0 [80.0, 95.0]"
    few = report.gar_cell({"gar@0.0001": "", "accepts@0.0001": "0", "impostors": "2700"}, "0.0001")
    assert few == "too few impostors (2,700)"


def handmade(seed: int, session: int) -> Any:
    """A finger's images: ridges of a direction and period of its own, noise of the session."""
    from splitknit_match.matching.thesis import FingerImages

    finger, day = np.random.default_rng(seed), np.random.default_rng([seed, session])
    y, x = np.mgrid[0:150, 0:100]
    turn, period = finger.uniform(0, np.pi), finger.uniform(11, 15)
    ridges = np.sin(
        2 * np.pi / period * (x * np.cos(turn) + y * np.sin(turn) + 0.002 * (x - 50) * (y - 70))
    )
    channels = {
        name: (ridges + 0.1 * k + 0.3 * day.standard_normal(ridges.shape)).astype(np.float32)
        for k, name in enumerate(("normal_x", "normal_y", "normal_z", "relief"))
    }
    return FingerImages(channels, np.ones((150, 100), np.bool_), 30.0)


def handmade_reader(name: str) -> Any:
    subject, session, _ = name.split("/")
    return None if subject == "S04" else handmade(int(subject[1:]), int(session[-1]))


def test_other_descriptors_are_compared_by_the_same_rule(
    tmp_path: Path, thesis: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every descriptor knows fingers again, and what is finished is not compared again."""
    compared, descriptors, trials = thesis("compared"), thesis("descriptors"), thesis("trials")
    names = [f"S{k:02d}/session_{day}/left_ring" for k in range(1, 5) for day in (1, 2)]
    captures = compared.captures_of(names)
    a, b = np.nonzero((captures.session[:, None] == "1") & (captures.session[None, :] == "2"))
    pairs = trials.Pairs(captures, a[::-1], b[::-1])
    ways = [
        compared.Way(name, extract, "normals", ("normal_x", "normal_y", "normal_z"))
        for name, extract in descriptors.DESCRIPTORS.items()
    ]
    trials = compared.compare_pairs(pairs, handmade_reader, ways, tmp_path, 1)
    assert [trial.case for trial in trials] == ["lbp", "hog", "gabor", "shape context"]
    failed = (captures.subject[pairs.a] == "S04") | (captures.subject[pairs.b] == "S04")
    for trial in trials:
        np.testing.assert_array_equal(np.isnan(trial.similarity), failed)
        known = trial.similarity[~failed]
        assert known[pairs.genuine[~failed]].min() > known[~pairs.genuine[~failed]].max(), (
            trial.case
        )
        assert (trial.ratio[~failed] == 1.0).all()
    again = compared.compare_pairs(
        pairs, lambda _: pytest.fail("compared again"), ways, tmp_path, 1
    )
    np.testing.assert_array_equal(again[2].similarity, trials[2].similarity)


def test_what_fails_the_gate_need_not_be_compared(tmp_path: Path, thesis: Script) -> None:
    """Unless asked for, pairs that overlap too little have no similarity, and what the gate judges
    is the same."""
    compared, trials, variants = thesis("compared"), thesis("trials"), thesis("variants")

    def narrow_second(name: str) -> Any:
        images = handmade_reader(name)
        return (
            replace(images, mask=images.mask & (np.arange(100) < 80))
            if name.startswith("S02")
            else images
        )

    captures = compared.captures_of(
        [f"S{k:02d}/session_{day}/left_ring" for k in range(1, 4) for day in (1, 2)]
    )
    a, b = np.nonzero((captures.session[:, None] == "1") & (captures.session[None, :] == "2"))
    pairs = trials.Pairs(captures, a, b)
    ways = [compared.Way("lbp", thesis("descriptors").hog_features, "relief", ("relief",))]
    asked = np.arange(pairs.a.size) == 1
    (none,), (gated,), (whole,) = (
        compared.compare_pairs(pairs, narrow_second, ways, tmp_path, 1, ungated=some)
        for some in (np.zeros_like(asked), asked, None)  # each adds to what the one before has kept
    )
    rejected = whole.ratio < variants.GATE
    assert rejected.sum() == 4 and rejected[1]  # the second finger with the others
    assert np.isfinite(whole.similarity).all()
    np.testing.assert_array_equal(none.similarity, np.where(rejected, np.nan, whole.similarity))
    np.testing.assert_array_equal(
        gated.similarity, np.where(rejected & ~asked, np.nan, whole.similarity)
    )
    known = variants.known_of(pairs, {})
    passing = variants.passing_everywhere(trials.Table(pairs, (whole,), ()))
    three = [*captures.names, *(f"S{k:02d}/session_3/left_ring" for k in range(1, 4))]
    table, ungated = compared.compare_all(three, narrow_second, ways, tmp_path, 1)
    # of sessions 1 and 2; 27 comparisons
    np.testing.assert_array_equal(ungated, (table.pairs.b % 3 == 1))
    assert ungated.sum() == 9 and np.isfinite(table.trials[0].similarity[ungated]).all()
    np.testing.assert_array_equal(
        np.isnan(table.trials[0].similarity), (table.trials[0].ratio < 0.9) & ~ungated
    )
    for variant in (variants.THESIS, variants.PASSING):
        both = [variants.judged(pairs, trial, variant, known, passing) for trial in (whole, gated)]
        np.testing.assert_array_equal(both[0].label, both[1].label)
        np.testing.assert_array_equal(both[0].score, both[1].score)


@pytest.mark.slow
def test_the_figures_of_pictures_are_measured(tmp_path: Path, thesis: Script) -> None:
    """A tiny population: ridges are found at their frequency, more scales take in more of the
    shape."""
    from splitknit_simulator.population.folder import simulate_population
    from splitknit_simulator.population.sessions import PopulationSettings

    figures = thesis("figures")
    simulate_population(
        tmp_path / "people",
        PopulationSettings(seed=2, scale=0.1),
        subjects=1,
        sessions=1,
        fingers=("left_ring",),
        workers=1,
    )
    out = tmp_path / "out"
    out.mkdir()
    names = ["S01/session_1/left_ring"]
    facts = figures.run(tmp_path / "people", names, out, tmp_path / "scratch", 1, 1)
    assert facts == {"captures": 1, "failures": 0}
    rows = {(row["figure"], row["what"]): float(row["mean"]) for row in read(out / "figures.csv")}
    first, second = "pr: error between, um", "snk: error between, um"
    difference = rows["5.9", first] - rows["5.9", second]
    assert rows["5.9", f"{first} less {second}"] == pytest.approx(difference, abs=0.1)
    assert 15 < rows["3.1", "true relief: peak, cycles per cm"] < 32
    assert rows["3.1", "true shape: peak, cycles per cm"] < 1.5
    assert (
        rows["3.20", "n = 7 power beside the ridges, %"]
        > 3 * rows["3.20", "n = 2 power beside the ridges, %"]
    )
    assert rows["3.22", "NIR: shape error, um"] < rows["5.9", "truth: shape, um"]
    for name in ("figure-3-1", "figure-3-20", "figure-5-9"):
        assert (out / f"{name}.svg").read_bytes().startswith(b"<?xml")
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "scratch").iterdir()}
    figures.run(tmp_path / "people", names, out, tmp_path / "scratch", 1, 1)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "scratch").iterdir()} == files
