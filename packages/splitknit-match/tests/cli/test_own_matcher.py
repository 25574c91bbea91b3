"""Somebody's own matcher and preset: named, never written into the source."""

import json
from pathlib import Path

import numpy as np
import pytest

import splitknit_match
from refusals import bad_input
from splitknit import preset_settings
from splitknit.cli.main import main
from splitknit_simulator.finger.master_print import MasterPrintSettings, ink_print, master_print

MODULE = '''
import numpy as np
from dataclasses import replace
from splitknit import preset_settings

def compare(a, b):
    """Correlation of the middles of two prints."""
    a, b = (x[x.shape[0] // 2 - 60 :][:120, x.shape[1] // 2 - 40 :][:, :80] for x in (a, b))
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])

def plain():
    return preset_settings("ea")

def broken():
    return 7
'''


@pytest.fixture(autouse=True)
def module(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")


def test_an_own_matcher_decides_by_its_own_rates(tmp_path, capsys):
    rng = np.random.default_rng(0)
    size = MasterPrintSettings(half_width_mm=7.0, distal_mm=16.0, proximal_mm=1.0)
    pictures = [ink_print(master_print("left_loop", seed, size)) for seed in (1, 2)]
    same = splitknit_match.match(
        pictures[0], pictures[0], method="mine:compare", resolution_ppi=500
    )
    assert (same.method, same.answer) == ("mine:compare", "undecided")
    assert "rates of the method mine:compare were not measured" in (same.undecided or "")
    assert same.similarity == pytest.approx(1)
    scores = ["label,score", *(f"0,{score:.4f}" for score in rng.normal(0, 0.1, 300)), *["1,1"] * 9]
    (tmp_path / "scores.csv").write_text("\n".join(scores) + "\n")
    rates, out = str(tmp_path / "rates.json"), str(tmp_path / "report")
    words = [*f"evaluate --scores {tmp_path}/scores.csv --out".split(), out]
    words += ["--calibrate", rates, "--method", "mine:compare", "--least-mm2", "0"]
    assert main(words) == 0
    for number, answer in ((0, "match"), (1, "no match")):
        report = splitknit_match.match(
            pictures[0],
            pictures[number],
            method="mine:compare",
            decision=rates,
            fmr=0.01,
            resolution_ppi=500,
        )
        assert report.decision is not None
        assert report.decision.match == (answer == "match")
    capsys.readouterr()


def test_names_that_are_none_are_refused():
    with bad_input(r"no matcher 'voted'; known are auto, ridge.*MODULE:NAME"):
        splitknit_match.match(
            np.zeros((90, 90), np.uint8),
            np.zeros((90, 90), np.uint8),
            method="voted",
            resolution_ppi=500,
        )
    assert preset_settings("mine:plain") == preset_settings("ea")
    for name, words in (
        ("other:x", "cannot be imported"),
        ("mine:x", "cannot be imported"),
        ("mine:broken", "must return PipelineSettings"),
    ):
        with bad_input(words):
            preset_settings(name)


@pytest.mark.slow
def test_a_batch_takes_both(people, tmp_path, capsys):
    words = f"batch {people} --out {tmp_path}/store --jobs 1 --json".split()
    words += ["--cases", "mine:plain"]
    assert main([*words, "--matchers", "mine:compare"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [scores["compared"] for scores in facts["scores"]] == [4]
    scores = Path(facts["csv"][0]).read_text()
    assert scores.count("\n") == 5
