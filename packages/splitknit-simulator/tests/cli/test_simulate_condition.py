"""``splitknit simulate --condition``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.io.npz import read_npz

Captured = pytest.CaptureFixture[str]


@pytest.mark.slow
def test_a_scarred_finger_is_written_with_its_truth(tmp_path: Path) -> None:
    out = tmp_path / "scarred"
    command = [
        "simulate",
        "--out",
        str(out),
        "--seed",
        "3",
        "--scale",
        "0.06",
        "--condition",
        "scarred",
    ]
    assert main([*command, "--severity", "0.6"]) == 0
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
def test_what_does_not_go_is_said_in_one_sentence(
    tmp_path: Path, capsys: Captured, options: list[str], words: str
) -> None:
    out = tmp_path / "none"
    first = options[:1] if options[0] == "population" else []
    assert (
        main(["simulate", *first, "--out", str(out), "--scale", "0.1", *options[len(first) :]]) == 2
    )
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not out.exists()


@pytest.mark.slow
def test_reconstruct_tells_of_dust_and_is_silent_about_clean_skin(
    tmp_path: Path, capsys: Captured
) -> None:
    for name, more in (("clean", []), ("dusty", ["--condition", "dusty", "--severity", "0.5"])):
        command = [
            "simulate",
            "--out",
            str(tmp_path / name),
            "--seed",
            "3",
            "--scale",
            "0.165",
            *more,
        ]
        assert main(command) == 0
        capsys.readouterr()
        made = tmp_path / f"{name}_result"
        assert (
            main(["reconstruct", str(tmp_path / name), "--out", str(made), "--preset", "ea"]) == 0
        )
        said = capsys.readouterr().out
        assert ("dark specks cover" in said) == (name == "dusty")
        fraction = json.loads((made / "report.json").read_text())["quality"]["white"]["dark_specks"]
        assert (fraction > 0.002) == (name == "dusty")
