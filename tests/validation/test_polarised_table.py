"""The table of heights with and without polarising films, on one small simulated finger."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import splitknit
import splitknit_simulator
from script_folder import VALIDATION, scripts_of
from splitknit.capture import Capture


@pytest.mark.slow
def test_both_ways_and_the_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    results: dict[bool, splitknit.Reconstruction] = {}
    reconstruct = splitknit.reconstruct

    def once(capture: Capture) -> splitknit.Reconstruction:
        polarised = "white_crossed" in capture.bands
        if polarised not in results:
            results[polarised] = reconstruct(capture)
        return results[polarised]

    monkeypatch.setattr(splitknit, "reconstruct", once)
    capture, truth = splitknit_simulator.simulate_capture(
        3, settings={"scale": 0.2, "films.kind": "analyser"}
    )
    splitknit.write_capture(capture, tmp_path / "finger")
    np.savez(
        tmp_path / "finger_truth.npz",
        **{name: truth[name] for name in ("height_mm", "shape_mm", "mask")},
    )
    with scripts_of(VALIDATION / "path_traced") as script:
        table = script("polarised")
        mean = table.without_films(capture)
        assert set(mean.bands) == {"white", "nir"}
        both = [capture.bands[name].pixels.astype(float) for name in ("white", "white_crossed")]
        assert np.abs(mean.bands["white"].pixels - (both[0] + both[1]) / 2).max() <= 0.5
        assert table.main([str(tmp_path)]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[1].startswith("finger | ")
        assert table.main([str(tmp_path / "nothing")]) == 2
        assert "give folders" in capsys.readouterr().err
        monkeypatch.setattr(
            table, "simulate_capture", lambda seed, settings: (capture, dict(truth))
        )
        assert table.main(["--twins", "3", "4"]) == 0
        lines = [line.split() for line in capsys.readouterr().out.splitlines()]
        assert [line[0] for line in lines] == ["3", "4", "mean"]
        assert all(len(line) == 22 for line in lines)
        assert table.main(["--twins", "4", "3"]) == 2
