"""``splitknit rig circuit``."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from splitknit.cli.main import main
from splitknit.io.rig import read_rig, write_rig
from splitknit.model import default_rig
from splitknit_rig.capture.pins import DEFAULT_PINS, pins_of


def test_the_board_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "board"
    assert main(["rig", "circuit", "--out", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert sorted(p.name for p in out.iterdir() if p.name != ".splitknit") == sorted(facts["files"])
    assert facts["stages"]["white"]["resistors"]["emitter"]["ohm"] > 20
    assert json.loads((out / "circuit.json").read_text())["stages"] == facts["stages"]
    assert pins_of(read_rig(out / "rig.json")) == (*DEFAULT_PINS["white"], *DEFAULT_PINS["nir"])
    drawing = ElementTree.fromstring((out / "schematic.svg").read_text())
    words = [element.text or "" for element in drawing.iter("{http://www.w3.org/2000/svg}text")]
    for k in range(1, 15):
        assert f"Q{k}" in words
    assert "GPIO 17" in words
    first = (out / "circuit.net").read_bytes()
    assert main(["rig", "circuit", "--out", str(out)]) == 0
    assert (out / "circuit.net").read_bytes() == first
    assert "90 mA" in capsys.readouterr().out


def test_a_rig_file_and_settings_are_followed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.json"
    write_rig(default_rig(), rig)
    call = ["rig", "circuit", "--rig", str(rig), "--out", str(tmp_path / "b"), "--topology", "switch", "--json"]
    assert main([*call, "--set", "circuit.supply_v=7.5"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["settings"]["supply_v"] == 7.5
    assert set(facts["stages"]["nir"]["resistors"]) == {"base", "series", "pull_down"}


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (["--supply-v", "5"], "too little for the white LEDs"),
        (["--set", "circuit.suply_v=5"], "did you mean 'supply_v'"),
        (["--rig", "nowhere.json"], "nowhere.json"),
    ],
)
def test_refusals(call: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", "circuit", "--out", str(tmp_path / "b"), *call]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not (tmp_path / "b").exists()
