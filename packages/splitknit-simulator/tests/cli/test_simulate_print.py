"""``splitknit simulate --print``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.io.images import write_image
from splitknit.io.npz import read_npz
from splitknit_simulator.finger.master_print import ink_print, master_print


@pytest.mark.slow
def test_the_finger_that_left_a_print_is_photographed(tmp_path: Path) -> None:
    """Its ridges end where the print does, and are not those of the seed."""
    write_image(tmp_path / "print.png", ink_print(master_print("whorl", 5)))
    out = ["--seed", "3", "--scale", "0.15"]
    assert main(["simulate", "--out", str(tmp_path / "drawn"), *out]) == 0
    assert main(["simulate", "--out", str(tmp_path / "own"), *out, "--print", str(tmp_path / "print.png")]) == 0
    drawn, own = (read_npz(tmp_path / name / "truth.npz") for name in ("drawn", "own"))
    assert str(own["landmark_pattern"]) == "print"
    both = own["mask"] & drawn["mask"]
    np.testing.assert_allclose(own["shape_mm"][both], drawn["shape_mm"][both], atol=1e-5)
    relief = [np.where(both, truth["height_mm"] - truth["shape_mm"], 0.0) for truth in (drawn, own)]
    rows, columns = np.flatnonzero(both.any(axis=1)), np.flatnonzero(both.any(axis=0))
    middle = np.s_[rows[0] + 40 : rows[0] + 100, columns.mean().astype(int) - 30 : columns.mean().astype(int) + 30]
    assert relief[1][middle].std() > 0.5 * relief[0][middle].std()
    assert abs(np.corrcoef(relief[0][middle].ravel(), relief[1][middle].ravel())[0, 1]) < 0.5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--pattern", "whorl"], "leave out the pattern"),
        (["--bench"], "--print does not go with --bench"),
        (["population"], "--print does not go with a population"),
        ([], "no ridges"),
    ],
)
def test_what_does_not_go_is_said_in_one_sentence(tmp_path: Path, capsys, options: list[str], words: str) -> None:
    write_image(tmp_path / "white.png", np.full((300, 300), 255, dtype=np.uint8))
    first = options[:1] if options[:1] == ["population"] else []
    given = ["--out", str(tmp_path / "none"), "--print", str(tmp_path / "white.png"), *options[len(first) :]]
    assert main(["simulate", *first, *given]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert not (tmp_path / "none").exists()
