"""The thesis's experiment at a tenth of its size, its table of claims."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from script_folder import Script, scripts_of
from splitknit.io.enrolment import open_enrolment
from splitknit_simulator.twin import lay_down, twin_settings

THESIS = Path(__file__).resolve().parents[2] / "validation" / "thesis"


@pytest.fixture
def thesis() -> Iterator[Script]:
    """Import a script of validation/thesis by its name."""
    with scripts_of(THESIS) as named:
        yield named


def reproduce(*arguments: object) -> str:
    command = [sys.executable, THESIS / "reproduce.py", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_time_and_disk_are_stated_and_a_dry_run_makes_nothing(tmp_path: Path) -> None:
    out = tmp_path / "again"
    stated = reproduce("--out", out, "--people", 2, "--dry-run")
    assert re.search(
        r"40 captures, 600 comparisons in 5 cases: about 7 minutes on 2 cores, 0\.7 GB on disk",
        stated,
    )
    assert not out.exists()


def test_figures_with_commands_of_their_own_and_every_claim_stand_on_the_page(
    tmp_path: Path, thesis: Script
) -> None:
    reproduce("--out", tmp_path, "--figures", "3.17,4.1")
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "python validation/separation/checkerboard.py" in page
    assert "LEDs best stand 14 cm high on a ring of 5.25 cm" in page and "Figure 5.4" not in page
    figures, known = (
        thesis("reproduce").chosen_figures(None),
        thesis("report").read(THESIS / "tables" / "claims.csv"),
    )
    assert len(figures) == 25 and all(figure.thesis and figure.pictures for figure in figures)
    numbers = {row["number"].rstrip("abcdef") for row in known}
    assert {claim for figure in figures for claim in figure.claims} <= numbers
    with pytest.raises(SystemExit, match=r"no figure 9\.9"):
        thesis("reproduce").chosen_figures("9.9")


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_figure_is_made_beside_the_thesis_and_a_second_run_has_nothing_to_do(
    tmp_path: Path,
) -> None:
    small = (
        "--people",
        2,
        "--sessions",
        2,
        "--fingers",
        "right_index,right_thumb",
        "--scale",
        0.2,
        "--figures",
        "5.4",
    )
    reproduce("--out", tmp_path, *small)
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "SnK 92, PR 90 and EA 86 % at FAR 1 %" in page and 'src="figure-5-4.svg"' in page
    assert (tmp_path / "figure-5-4.svg").read_text(encoding="utf-8").startswith("<")
    assert "is finished" in reproduce("--out", tmp_path, *small)


def test_the_claims_of_the_committed_tables_are_those_of_the_page(thesis: Script) -> None:
    claims, report = thesis("claims"), thesis("report")
    names = {part[1] for parts in claims.CLAIMS.values() for part in parts}
    tables = {name: report.read(THESIS / f"{name}.csv") for name in names}
    judged = {name: {} if name == "figures" else claims.AVERAGED for name in names}
    cells = {
        number: [
            claims.cell(tables[name], wanted | judged[name], figure)
            for _, name, wanted, figure in parts
        ]
        for number, parts in claims.CLAIMS.items()
    }
    assert not any("not measured" in each for each in cells.values())
    known = report.read(THESIS / "tables" / "claims.csv")
    assert cells[1] == [row["measured"] for row in known if row["number"] == "1"]
    assert claims.cell([], {}, "gar@0.01") == "not measured"


def test_figure_5_6_has_the_thesis_s_bars_beside_ours(thesis: Script) -> None:
    figures, plots, report = thesis("figures"), thesis("plots"), thesis("report")
    groups = figures.accuracies(report.read(THESIS / "cases.csv"))
    assert [[name for name, *_ in bars] for _, bars in groups] == [
        ["ea", "snk", "ea, thesis", "snk, thesis"]
    ] * 3
    assert plots.bars_figure(groups) != plots.bars_figure(figures.accuracies([]))


def test_closed_set_scores_are_of_a_query_over_one_session(thesis: Script) -> None:
    trials, authors = thesis("trials"), thesis("authors")
    fingers, sessions = ("S01/a", "S02/a", "S03/a"), ("1", "2")
    names = [(f"{finger}/{session}", finger, session) for finger in fingers for session in sessions]
    columns = zip(
        *((name, finger[:3], finger, session) for name, finger, session in names), strict=True
    )
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


def test_frankot_chellappa_with_mirrored_borders_is_poisson_on_the_rectangle(
    thesis: Script,
) -> None:
    paired = thesis("paired")
    errors = paired.integrated(lay_down(2001, settings=twin_settings(0.1, None))[0])
    assert abs(errors[paired.MIRRORED] - errors[paired.RECTANGLE]) < 0.01 * errors[paired.MASK]
    assert errors[paired.ZEROS] > errors[paired.MASK]
    summed = paired.row(f"{paired.NIR} - {paired.WHITE}", [-20.0, -30.0, -25.0], "+")
    assert summed["mean"] == "-25.0 [-37.4, -12.6]" and summed["negative"] == 3


def test_a_smaller_run_plans_anew_and_committed_tables_stand_on_the_page(
    tmp_path: Path, thesis: Script
) -> None:
    again = thesis("reproduce")
    plan = {"format": "splitknit-enrolment", "version": 1, "subjects": 17, "sessions": 4}
    (tmp_path / "enrolment.json").write_text(json.dumps(plan | {"fingers": ["right_index"]}))
    again.plan_anew(tmp_path, again.Size(3, 4, "right_index"))
    assert open_enrolment(tmp_path, subjects=3).plan.subjects == 3
    again.plan_anew(tmp_path / "nothing", again.ONE_FINGER)
    figures = again.chosen_figures("1.3,3.8,3.17,3.21,3.26,4.1,5.1,5.7")
    page = again.page_of(tmp_path, figures, again.ONE_FINGER)
    assert page.count("<p>validation/") == len(figures) + 1 and "Laser line" in page


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_benchmark_is_made_compared_with_the_frozen_one_and_packed(
    tmp_path: Path, thesis: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    benchmark, run = thesis("benchmark"), thesis("run")
    monkeypatch.setattr(benchmark, "POPULATION", "simulate population --seed 4171 --scale 0.1")
    monkeypatch.setattr(
        benchmark,
        "SIZES",
        {"small": "--subjects 3 --sessions 2 --fingers right_index"},
    )
    systems = "batch --cases metric,ea --matchers thesis,ridge --impostors 1"
    monkeypatch.setattr(benchmark, "SYSTEMS", systems)
    out = tmp_path / "bench"
    assert benchmark.main(["--out", str(out)]) == 1, "another scale: other photographs"
    monkeypatch.setattr(benchmark, "FACTS", tmp_path / "facts.csv")
    assert benchmark.main(["--out", str(out), "--freeze"]) == 0
    with (out / "pairs.csv").open(encoding="utf-8") as stream:
        pairs = list(csv.DictReader(stream))
    assert [row["label"] for row in pairs].count("1") == 3 and len(pairs) == 9
    assert {row["score"] for row in pairs} == {""}
    for row in pairs:
        assert (out / "prints" / f"{row['a'].replace('/', '_')}.png").is_file()
    with tarfile.open(out / "scores.tar.xz") as archive:
        archive.extractall(tmp_path, filter="data")
    people, store = tmp_path / "people", tmp_path / "store"
    options = f"cases --population {people} --store {store} --cases metric ea --out {tmp_path}"
    assert run.main([*options.split(), "--replicates", "20", "--jobs", "1"]) == 0
    packed = (tmp_path / "cases.csv").read_text(encoding="utf-8")
    options = options.replace(str(people), str(out / "people")).replace(
        str(store), str(out / "store")
    )
    assert run.main([*options.split(), "--replicates", "20", "--jobs", "1"]) == 0
    assert (tmp_path / "cases.csv").read_text(encoding="utf-8") == packed


def test_the_packed_scores_of_the_small_benchmark_give_the_rates_of_its_card(
    tmp_path: Path, thesis: Script
) -> None:
    run, report = thesis("run"), thesis("report")
    with tarfile.open(THESIS / "tables" / "benchmark_small_scores.tar.xz") as archive:
        archive.extractall(tmp_path, filter="data")
    options = f"cases --population {tmp_path}/people --store {tmp_path}/store --cases snk ea"
    assert run.main(f"{options} --out {tmp_path} --replicates 20 --jobs 1".split()) == 0
    rates = {
        row["case"]: float(row["gar@0.01"])
        for row in report.read(tmp_path / "cases.csv")
        if (row["attribute"], row["gate"], row["sessions"], row["kept"])
        == ("relief", "none", "single", "all")
    }
    card = (THESIS / "BENCHMARK.md").read_text(encoding="utf-8")
    assert f"| SnK's ridges, thesis's matcher | {100 * rates['snk']:.1f} [" in card
    assert f"| EA's whole height, thesis's matcher | {100 * rates['ea']:.1f} [" in card


def test_a_capture_differs_from_the_frozen_one_beyond_a_thousandth(thesis: Script) -> None:
    benchmark = thesis("benchmark")
    row = {"capture": "S01/session_1/right_index", "rig": "a", "height_mm": 5.0}
    row |= {"height_sd_mm": 2.0, "white": 30000.0, "nir": 20000.0}
    known = {row["capture"]: {name: str(value) for name, value in row.items()}}
    assert benchmark.differing_from(known, [row, row | {"capture": "unknown"}]) == []
    assert benchmark.differing_from(known, [row | {"white": 30020.0}]) == []
    for change in ({"white": 30040.0}, {"height_mm": 4.9}, {"rig": "b"}):
        assert benchmark.differing_from(known, [row | change]) == [row["capture"]], change


def test_every_view_of_the_harder_population_shows_the_crease(
    tmp_path: Path,
    thesis: Script,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    harder = thesis("harder")
    monkeypatch.setattr(harder, "SETTINGS", replace(harder.SETTINGS, scale=0.08))
    options = f"--out {tmp_path} --subjects 1 --fingers right_index --sessions 2".split()
    assert harder.main(options) == 0
    names = capsys.readouterr().out.split()
    assert names == [f"S01/session_{k}/right_index" for k in (1, 2)]
    facts = [json.loads((tmp_path / name / "impression.json").read_text()) for name in names]
    assert {each["worn"] for each in facts} == {facts[0]["worn"]}
    assert all((each["dryness"] > 0) != (each["motion_mm"] > 0) for each in facts)
    assert len({each["motion_mm"] > 0 for each in facts}) == 2, "both kinds"
    for name in names:
        with np.load(tmp_path / name / "truth.npz") as truth:
            rows = np.flatnonzero(truth["mask"].any(axis=1))
            pitch_mm = float(truth["pitch_mm"])
            assert "glare_white" not in truth
        assert (rows[-1] - rows[0]) * pitch_mm > harder.LONGEST_MM + 2
    assert harder.main(options) == 0
    assert capsys.readouterr().out == "", "nothing is left to do"
