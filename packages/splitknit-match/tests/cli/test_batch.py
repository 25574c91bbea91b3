"""``splitknit batch`` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit_match.cli.batch import _case


def test_a_population_on_the_command_line(people: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = tmp_path / "store"
    words = ["batch", str(people), "--out", str(store), "--cases", "ea", "--jobs", "1"]
    assert main([*words, "--matchers", "ridge", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["reconstructed"] == 4
    assert facts["scores"][0]["compared"] == 4
    assert facts["peak_memory_mb"] > 50
    assert main([*words, "--matchers", "none"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("0 reconstructions made now, 4 were there")
    assert err == ""
    assert main(["evaluate", "--scores", facts["csv"][0], "--out", str(tmp_path / "page"), "--json"]) == 0
    capsys.readouterr()
    assert main([*words, "--matchers", "eyes"]) == 2
    assert "no matcher 'eyes'" in capsys.readouterr().err
    assert main([*words[:2], "--out", str(people), "--jobs", "1"]) == 2
    assert "is not a store" in capsys.readouterr().err
    assert main([*words, "--impostors", "2"]) == 2
    for option in ("--cases", "--matchers"):
        assert main([*words, option, " , "]) == 2
        assert f"{option} needs a name at least" in capsys.readouterr().err


def test_cases_of_ones_own() -> None:
    case = _case("near=ea:normals.method=near_light,shapelets.scales=5")
    assert (case.name, case.preset) == ("near", "ea")
    assert case.changes == {"normals.method": "near_light", "shapelets.scales": 5}
    assert _case("plain=pr").changes == {}
    with pytest.raises(BadInput, match="NAME=PRESET"):
        _case("plain")
    with pytest.raises(BadInput, match="not of the form"):
        _case("a=ea:rubbish")
