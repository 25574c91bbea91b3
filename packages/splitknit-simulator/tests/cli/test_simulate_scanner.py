"""``splitknit simulate --scanner``: clouds as other scanners deliver them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from splitknit.cli.main import main

Captured = pytest.CaptureFixture[str]


@pytest.mark.slow
def test_silhouettes_become_a_cloud_that_import_reads(tmp_path: Path, capsys: Captured) -> None:
    """The hull is wider than the finger that it holds, and never narrower than a fingertip."""
    cloud, result = tmp_path / "hull.xyz", tmp_path / "result"
    command = ["simulate", "--scanner", "hull", "--seed", "9", "--out", str(cloud)]
    assert main([*command, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    points = np.loadtxt(cloud)
    assert len(points) == facts["points"] > 10_000
    assert cloud.stat().st_mode & 0o077 == 0  # biometric data
    assert 10 < np.ptp(points[:, 0]) < 28
    assert main(command) == 2
    assert "exists; give --overwrite" in capsys.readouterr().err
    assert main(["import", str(cloud), "--out", str(result), "--json"]) == 0
    assert 200 < json.loads(capsys.readouterr().out)["result"]["area_mm2"] < 700


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--motion", "0.3"], "--motion does not go with --scanner"),
        (["--scale", "0.2"], "--scale does not go with --scanner"),
        (["--bench"], "--scanner does not go with --bench"),
        (["population"], "--scanner does not go with a population"),
    ],
)
def test_what_does_not_go_with_a_scanner(tmp_path: Path, capsys: Captured, options: list[str], words: str) -> None:
    out = tmp_path / "cloud.xyz"
    assert main(["simulate", "--scanner", "hull", *options, "--out", str(out)]) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_what_is_no_earlier_scan_is_not_replaced(tmp_path: Path, capsys: Captured) -> None:
    folder, foreign = tmp_path / "folder.xyz", tmp_path / "foreign.xyz"
    folder.mkdir()
    foreign.write_text("1 2 3\n")
    for out, words in (
        (folder, "is a folder"),
        (foreign, "not an earlier simulated scan"),
        (tmp_path / "a.ply", ".xyz"),
    ):
        assert main(["simulate", "--scanner", "hull", "--out", str(out), "--overwrite"]) == 2
        assert words in capsys.readouterr().err
    assert foreign.read_text() == "1 2 3\n"
