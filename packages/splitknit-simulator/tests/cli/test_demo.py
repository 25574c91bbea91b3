import json

import pytest

from handmade import capture_of, finger
from splitknit.cli.main import main
from splitknit.io.capture import read_capture
from splitknit.report.result import FILES


@pytest.fixture
def short_cut(monkeypatch):
    """Put a hand-made finger in the place of the twin and the pipeline."""
    result, truth = finger()

    def reconstruct(capture, preset):
        return finger(preset=preset)[0]

    def simulate(seed, pattern, settings):
        return capture_of(result), truth

    monkeypatch.setattr("splitknit.reconstruct", reconstruct)
    monkeypatch.setattr("splitknit_simulator.twin.simulate_capture", simulate)


@pytest.mark.usefixtures("short_cut")
def test_demo_writes_its_results_and_prints_their_places(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["demo"]) == 0
    printed = capsys.readouterr().out
    out = tmp_path / "demo"
    assert read_capture(out / "capture").shape == (440, 640)
    for preset in ("metric", "ea"):
        assert {path.name for path in (out / preset).iterdir()} >= set(FILES)
        assert json.loads((out / preset / "report.json").read_text())["comparison"][preset]
        assert f"demo/{preset}" in printed
    facts = json.loads((out / "report.json").read_text())
    assert set(facts["comparison"]) == {"metric", "ea"}
    page = (out / "report.html").read_text()
    assert "Ridge error, metric" in page
    assert "Ridge error, ea" in page
    assert "Open demo/report.html" in printed


@pytest.mark.slow
@pytest.mark.usefixtures("short_cut")
def test_demo_can_be_repeated_and_its_results_replaced(tmp_path, capsys):
    out = str(tmp_path / "demo")
    assert main(["demo", "--out", out]) == 0
    assert main(["demo", "--out", out, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out.partition("{")[2].join(["{", ""]))
    assert facts["written"]["capture"]
    (tmp_path / "demo" / "notes.txt").write_text("mine")
    assert main(["demo", "--out", out]) == 2
    assert (tmp_path / "demo" / "notes.txt").read_text() == "mine"
