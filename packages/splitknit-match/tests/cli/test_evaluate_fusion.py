"""``splitknit evaluate --fuse``: one system more."""

import csv
import json

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit_match.evaluation.protocol import comparisons


def write(path, seed, *, ids=True, subjects=True):
    """Twelve subjects, two fingers each, two sessions; errors by `seed`, every fiftieth score
    missing."""
    rng = np.random.default_rng(seed)
    finger, session = np.tile(np.arange(24), 2), np.repeat([1, 2], 24)
    pairs = comparisons(finger, session)
    names = ["finger_a", "finger_b", "session_a", "session_b"] + (
        ["subject_a", "subject_b"] if subjects else []
    )
    with path.open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["label", "score", *(names if ids else [])])
        for k, (a, b) in enumerate(zip(pairs.a, pairs.b, strict=True)):
            score = f"{2.0 * pairs.genuine[k] + rng.normal():.4f}" if (k + seed) % 50 else ""
            who = [finger[a], finger[b], session[a], session[b]] + (
                [finger[a] // 2, finger[b] // 2] if subjects else []
            )
            rows.writerow([int(pairs.genuine[k]), score, *(who if ids else [])])
    return path


def run(capsys, *arguments):
    code = main(["evaluate", "--replicates", "20", *map(str, arguments)])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


@pytest.mark.slow
@pytest.mark.parametrize("method", ["linear", "trained", "minmax"])
def test_the_fusion_stands_in_the_report(tmp_path, capsys, method):
    files = [write(tmp_path / f"s{k}.csv", k) for k in (1, 2)]
    code, out, _ = run(
        capsys, "--scores", *files, "--fuse", method, "--out", tmp_path / "report", "--json"
    )
    assert code == 0
    facts = json.loads(out)
    name = f"fused, {method}"
    eers = {system: figures["eer"]["value"] for system, figures in facts["systems"].items()}
    assert list(eers) == ["s1", "s2", name]
    assert eers[name] < min(eers["s1"], eers["s2"])
    fusion = facts["fusions"][method]
    assert fusion["models"] == 15
    assert fusion["dealt_by"] == "subject"
    assert fusion["missing"] == {"s1": 11, "s2": 11}
    assert facts["system"] == "s1"  # the first stays the first
    assert {(difference["first"], difference["second"]) for difference in facts["differences"]} >= {
        ("s1", name),
        ("s2", name),
    }
    assert any("saw nothing of the folds" in finding["message"] for finding in facts["findings"])
    assert name in (tmp_path / "report" / "report.html").read_text()


@pytest.mark.slow
def test_files_of_several_traits(tmp_path, capsys):
    files = [write(tmp_path / f"s{k}.csv", k) for k in (1, 2)]
    code, out, _ = run(capsys, "--fuse", *files, "--out", tmp_path / "report", "--json")
    assert code == 0
    facts = json.loads(out)
    fused = [f"fused, {method}" for method in ("minmax", "linear")]
    assert list(facts["systems"]) == ["s1", "s2", *fused]
    assert list(facts["fusions"]) == ["minmax", "linear"]
    assert {system["bootstrap"]["method"] for system in facts["systems"].values()} == {"subject"}


def test_fingers_alone_are_said_to_be_less(tmp_path, capsys):
    files = [write(tmp_path / f"s{k}.csv", k, subjects=False) for k in (1, 2)]
    code, out, _ = run(capsys, "--scores", *files, "--fuse", "linear", "--out", tmp_path / "report")
    assert code == 0
    assert "Subjects are not named" in out


CASES = {
    "one": "two systems at least",
    "nameless": "subject_a",
    "both": "in place of --scores",
    "none": "--gallery",
}


@pytest.mark.parametrize("case", CASES)
def test_what_cannot_be_fused_is_one_sentence(tmp_path, capsys, case):
    files = [write(tmp_path / "s1.csv", 1, ids=case != "nameless")]
    if case == "nameless":
        files.append(write(tmp_path / "s2.csv", 2, ids=False))
    options = ["--scores", *files, "--fuse", *(files if case == "both" else ["trained"])]
    code, _, err = run(capsys, *([] if case == "none" else options), "--out", tmp_path / "report")
    assert code == 2
    assert err.count("\n") == 1
    assert CASES[case] in err
    assert not (tmp_path / "report").exists()
