"""``splitknit simulate --condition``."""

import json

import numpy as np
import pytest

from enrolled import refusal_of, words_of
from splitknit.cli.main import main
from splitknit.io.npz import read_npz


def simulate(options, out):
    return main(["simulate", "--seed", "3", *options.split(), "--out", str(out)])


@pytest.mark.slow
def test_a_scarred_finger_is_written_with_its_truth(tmp_path):
    out = tmp_path / "scarred"
    assert simulate("--scale 0.06 --condition scarred --severity 0.6", out) == 0
    truth = read_npz(out / "truth.npz")
    assert str(truth["condition_kind"]) == "scarred"
    assert float(truth["condition_severity"]) == 0.6
    fraction = truth["condition_share"].astype(np.float32)
    assert 0.001 < fraction[truth["mask"]].mean() < 0.3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--severity", "0.5"], "--severity sets how bad a --condition is"),
        (["--condition", "wet", "--severity", "1.5"], "condition.severity must be from 0 to 1"),
        (["--condition", "wet", "--bench"], "--condition does not go with --bench"),
        (["--condition", "wet", "--motion", "0.3"], "lies still in the twin"),
        (["population", "--condition", "wet"], "--condition does not go with a population"),
        (["--set", 'condition.kind="mud"'], "condition.kind' must be one of 'none', 'wet', 'dry'"),
    ],
)
def test_options_that_exclude_a_condition_are_refused(tmp_path, capsys, options, words):
    out = tmp_path / "none"
    assert words in refusal_of(capsys, "simulate", *options, "--out", out, "--scale", "0.1")
    assert not out.exists()


@pytest.mark.slow
def test_dust_gets_a_note_and_clean_skin_none(tmp_path, capsys):
    for condition in ("", "--condition dusty --severity 0.5"):
        folder, out = (tmp_path / f"{kind}{bool(condition)}" for kind in ("capture", "result"))
        assert simulate(f"--scale 0.165 {condition}", folder) == 0
        capsys.readouterr()
        printed = words_of(capsys, f"reconstruct {folder} --out {out} --preset ea")
        assert ("dark specks cover" in printed) == bool(condition)
        quality = json.loads((out / "report.json").read_text())["quality"]
        assert (quality["white"]["dark_specks"] > 0.002) == bool(condition)
