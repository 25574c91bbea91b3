"""``splitknit evaluate``: from score files to the report, and from bad ones to one sentence."""

import csv
import json
import re
import sys

import numpy as np
import pytest

import splitknit_match
from splitknit.cli.main import main
from splitknit_match.evaluation.intervals import BootstrapSettings
from splitknit_match.evaluation.protocol import comparisons
from splitknit_match.evaluation.rates import roc

QUICK = ["--replicates", "50"]
HAND = "label,score\n1,0.9\n1,0.8\n1,0.7\n1,0.3\n0,0.1\n0,0.2\n0,0.4\n0,0.5\n"


def write_population(path, *, power=3.0, fingers=20, sessions=4, ids=True, turn=False):
    """Scores of a protocol, two fingers a subject, every fiftieth missing."""
    generator = np.random.default_rng(0)
    finger, session = np.tile(np.arange(fingers), sessions), np.repeat(np.arange(sessions), fingers)
    pairs = comparisons(finger, session)
    score = power * pairs.genuine + generator.normal(size=pairs.a.size)
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        names = (
            ["finger_a", "finger_b", "subject_a", "subject_b", "session_a", "session_b"]
            if ids
            else []
        )
        writer.writerow(["label", "score", *names])
        for k, (a, b) in enumerate(zip(pairs.a, pairs.b, strict=True)):
            text = "" if k % 50 == 0 else f"{-score[k] if turn else score[k]:.6f}"
            who = [("left", "right")[finger[a] % 2], ("left", "right")[finger[b] % 2]]
            who += [f"s{finger[a] // 2}", f"s{finger[b] // 2}", session[a] + 1, session[b] + 1]
            writer.writerow([int(pairs.genuine[k]), text, *(who if ids else [])])
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Score files: ours.csv, theirs.csv (the same pairs), plain.csv (no ids), hand.csv."""
    here = tmp_path_factory.mktemp("scores")
    write_population(here / "ours.csv")
    write_population(here / "theirs.csv", power=2.5)
    write_population(here / "plain.csv", ids=False)
    write_population(here / "distances.csv", turn=True)
    (here / "hand.csv").write_text(HAND)
    return here


def report(out):
    return json.loads((out / "report.json").read_text())


@pytest.mark.slow
def test_a_file_of_labels_and_scores(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert main([*f"evaluate --scores {folder}/hand.csv --out {out}".split(), *QUICK]) == 0
    output = capsys.readouterr()
    assert "EER 25.00 %" in output.out and "report.html" in output.out and output.err == ""
    facts = report(out)
    assert set(facts["eer"]) == {"value", "low", "high"} and facts["eer"]["value"] == 0.25
    assert list(facts["gar_at_far"]) == ["0.01", "0.001", "0.0001"]
    for figure in (facts["eer"], *facts["gar_at_far"].values()):
        assert 0 <= figure["low"] <= figure["value"] <= figure["high"] <= 1
    assert [rate["value"] for rate in facts["gar_at_far"].values()] == [0.75] * 3
    system = facts["systems"]["hand"]
    assert system["bootstrap"]["method"] == "plain"
    assert (
        system["operating_points"]["0.01"]["far_upper"] == 0.75
        and not system["operating_points"]["0.01"]["resolved"]
    )
    assert any("cannot resolve a FAR of 1 %" in finding["message"] for finding in facts["findings"])
    written = [path.name for path in sorted(out.iterdir())]
    assert written == [
        ".splitknit",
        "det.svg",
        "report.html",
        "report.json",
        "roc.svg",
        "scores.svg",
    ]


def test_figures_are_those_of_the_scores(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert (
        main([*f"evaluate --scores {folder}/ours.csv --out {out}".split(), *QUICK, "--json"]) == 0
    )
    output = capsys.readouterr()
    printed, facts = json.loads(output.out), report(out)
    assert output.err == "" and printed["eer"] == facts["eer"] and printed["out"] == str(out)
    with (folder / "ours.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    sides = [
        np.array([float(row["score"] or "nan") for row in rows if row["label"] == label])
        for label in ("1", "0")
    ]
    assert facts["eer"]["value"] == roc(*sides).equal_error().value
    assert facts["gar_at_far"]["0.01"]["value"] == roc(*sides).at_far(0.01).gar
    assert facts["auc"]["value"] == roc(*sides).auc()
    assert facts["d_prime"]["value"] == pytest.approx(roc(*sides).d_prime())
    system = facts["systems"]["ours"]
    point = roc(*sides).scored().at_far(0.01)
    assert system["fnmr_at_fmr"]["0.01"]["value"] == pytest.approx(1 - point.gar)
    lost = [int(np.isnan(side).sum()) for side in sides]
    failures = system["failures_to_acquire"]
    assert [failures["genuine"], failures["impostor"]] == lost and sum(lost) == 48
    assert failures["rate"] == 0.02
    assert system["bootstrap"]["method"] == "finger" and system["bootstrap"]["drawn"] == 20
    assert any(
        "48 of 2400 comparisons gave no score" in finding["message"]
        for finding in facts["findings"]
    )


def test_the_page_needs_nothing_else(folder, tmp_path):
    out = tmp_path / "out"
    assert main([*f"evaluate --scores {folder}/ours.csv --out {out}".split(), *QUICK]) == 0
    page = (out / "report.html").read_text()
    assert not re.search(r"<script|https?://|@import|url\(", page)
    assert re.findall(r'src="([^,]*),', page) == ["data:image/svg+xml;base64"] * 3
    assert "nan" not in re.sub(r'"data:[^"]*"', "", page).lower() and "None" not in page


def test_without_matplotlib_the_page_has_no_curves(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    out = tmp_path / "out"
    assert main([*f"evaluate --scores {folder}/hand.csv --out {out}".split(), *QUICK]) == 0
    assert "Curves need matplotlib" in (out / "report.html").read_text()
    assert report(out)["files"] == ["report.html", "report.json"]


@pytest.mark.slow
def test_same_input_same_report_but_for_date_and_time(folder, tmp_path):
    outs = [tmp_path / name for name in ("a", "b", "c")]
    for out, seed in zip(outs, ("3", "3", "4"), strict=True):
        done = main(
            [*f"evaluate --scores {folder}/ours.csv --out {out} --seed".split(), seed, *QUICK]
        )
        assert done == 0
    facts = [report(out) for out in outs]
    for each in facts:
        assert each.pop("written_at")
    assert facts[0] == facts[1] and facts[0]["eer"]["low"] != facts[2]["eer"]["low"]
    assert facts[0]["eer"]["value"] == facts[2]["eer"]["value"]
    pages = [
        re.sub(r"\d{4}-\d\d-\d\dT[\d:+]*", "", (out / "report.html").read_text())
        for out in outs[:2]
    ]
    assert pages[0] == pages[1]  # the curves as well


def test_two_files_are_compared_pair_by_pair(folder, tmp_path):
    out, files = tmp_path / "out", [str(folder / "ours.csv"), str(folder / "theirs.csv")]
    assert main(["evaluate", "--scores", *files, "--out", str(out), *QUICK]) == 0
    facts = report(out)
    assert list(facts["systems"]) == ["ours", "theirs"] and facts["system"] == "ours"
    (difference,) = facts["differences"]
    assert (difference["first"], difference["second"], difference["method"]) == (
        "ours",
        "theirs",
        "finger",
    )
    single = facts["systems"]
    assert difference["eer"]["value"] == pytest.approx(
        single["ours"]["eer"]["value"] - single["theirs"]["eer"]["value"]
    )
    assert difference["auc"]["low"] > 0
    assert "Differences" in (out / "report.html").read_text()
    assert set(facts["inputs_sha256"]) == set(files)


def test_systems_of_other_pairs_are_not_compared(folder, tmp_path):
    files = [str(folder / "ours.csv"), str(folder / "hand.csv")]
    assert main(["evaluate", "--scores", *files, "--out", str(tmp_path / "out"), *QUICK]) == 0
    facts = report(tmp_path / "out")
    assert facts["differences"] == []
    assert any(
        "did not score the same pairs" in finding["message"] for finding in facts["findings"]
    )


def test_files_of_one_name_are_distinguished(folder, tmp_path):
    (tmp_path / "hand.csv").write_text(HAND.replace("0.3", "0.6"))
    files = [str(folder / "hand.csv"), str(tmp_path / "hand.csv")]
    assert (
        main(
            [
                "evaluate",
                "--scores",
                files[0],
                "--scores",
                files[1],
                "--out",
                str(tmp_path / "o"),
                *QUICK,
            ]
        )
        == 0
    )
    facts = report(tmp_path / "o")
    assert list(facts["systems"]) == ["hand (1)", "hand (2)"]
    assert (
        facts["differences"][0]["eer"]["value"] == 0.25
        and facts["differences"][0]["method"] == "plain"
    )


def test_the_function_takes_one_file_or_several(folder):
    evaluation = splitknit_match.evaluate(
        folder / "ours.csv", bootstrap=BootstrapSettings(replicates=20)
    )
    two = splitknit_match.evaluate(
        [str(folder / "ours.csv")], cluster="auto", bootstrap=BootstrapSettings(replicates=20)
    )
    assert evaluation.results[0].eer.value == two.results[0].eer.value


@pytest.mark.slow
def test_distances_are_turned_round(folder, tmp_path):
    for name, more in (("distances", ["--dissimilarity"]), ("ours", []), ("distances", [])):
        out = tmp_path / f"{name}{len(more)}"
        assert (
            main([*f"evaluate --scores {folder}/{name}.csv --out {out}".split(), *QUICK, *more])
            == 0
        )
    turned, right, wrong = (
        report(tmp_path / name) for name in ("distances1", "ours0", "distances0")
    )
    assert turned["eer"] == right["eer"] and turned["gar_at_far"] == right["gar_at_far"]
    assert wrong["eer"]["value"] > 0.8
    assert any("`dissimilarity`" in finding["message"] for finding in wrong["findings"])
    assert "turned round" in (tmp_path / "distances1" / "report.html").read_text()


def test_what_is_drawn_can_be_chosen(folder, tmp_path, capsys):
    arguments = [*f"evaluate --scores {folder}/ours.csv --out {tmp_path}/out".split(), *QUICK]
    assert main([*arguments, "--cluster", "subject"]) == 0
    facts = report(tmp_path / "out")
    system = facts["systems"]["ours"]
    assert system["bootstrap"]["method"] == "subject"
    plain = [*f"evaluate --scores {folder}/plain.csv --out {tmp_path}/no".split(), *QUICK]
    assert main([*plain, "--cluster", "finger"]) == 2
    assert "finger_a and finger_b" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_averaged_and_not(folder, tmp_path):
    arguments = [*f"evaluate --scores {folder}/ours.csv --out {tmp_path}/out".split(), *QUICK]
    assert main([*arguments, "--average-sessions"]) == 0
    facts = report(tmp_path / "out")
    averaged = facts["systems"]["ours, averaged over sessions"]
    assert averaged["comparisons"] == {"genuine": 20, "impostor": 380}
    assert facts["eer"] == facts["systems"]["ours"]["eer"] and facts["differences"] == []
    assert averaged["eer"]["value"] <= facts["eer"]["value"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("label,score\n1,0.5\n0,nan\n", "line 3"),
        ("label,score,finger_a,finger_b\n1,2,x,x\n0,1,x,x\n", "line 3: label and ids"),
    ],
)
def test_bad_files_give_one_sentence(tmp_path, capsys, text, words):
    path, out = tmp_path / "bad.csv", tmp_path / "out"
    path.write_text(text)
    assert main([*f"evaluate --scores {path} --out {out}".split(), *QUICK]) == 2
    output = capsys.readouterr()
    assert (
        output.out == ""
        and output.err.count("\n") == 1
        and words in output.err
        and str(path) in output.err
    )
    assert not out.exists() and sorted(tmp_path.iterdir()) == [path]


def test_other_bad_requests(folder, tmp_path, capsys):
    hand, out = str(folder / "hand.csv"), str(tmp_path / "out")
    requests = {
        "does not exist": ["--scores", str(tmp_path / "none.csv"), "--out", out],
        "named twice": ["--scores", hand, hand, "--out", out],
        "replicates": ["--scores", hand, "--out", out, "--replicates", "3"],
        "sessions are needed": ["--scores", hand, "--out", out, "--average-sessions"],
        "is not an earlier evaluation": ["--scores", hand, "--out", str(tmp_path)],
    }
    (tmp_path / "notes.txt").write_text("mine")
    for words, request in requests.items():
        assert main(["evaluate", *request]) == 2, words
        output = capsys.readouterr()
        assert words in output.err and output.err.count("\n") == 1
    assert main(["evaluate", "--out", out]) == 2
    capsys.readouterr()
    assert not (tmp_path / "out").exists()
