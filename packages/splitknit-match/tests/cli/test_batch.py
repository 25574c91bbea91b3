"""``splitknit batch`` on the command line."""

import json
import shutil
from pathlib import Path

import pytest

from refusals import bad_input
from splitknit.cli.main import main
from splitknit_match.batch.verbs import _case


@pytest.mark.slow
def test_a_population_on_the_command_line(people, tmp_path, capsys):
    store = tmp_path / "store"
    words = f"batch {people} --out {store} --cases ea --jobs 1".split()
    assert main([*words, "--matchers", "ridge", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["reconstructed"] == 4
    assert facts["scores"][0]["compared"] == 4
    assert main([*words, "--matchers", "none"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("0 reconstructions made now, 4 were there")
    assert err == ""
    assert (
        main(["evaluate", "--scores", facts["csv"][0], "--out", str(tmp_path / "page"), "--json"])
        == 0
    )
    capsys.readouterr()
    assert main([*words, "--matchers", "eyes"]) == 2
    assert "no matcher 'eyes'" in capsys.readouterr().err
    assert main([*words[:2], "--out", str(people), "--jobs", "1"]) == 2
    assert "is not a store" in capsys.readouterr().err
    assert main([*words, "--impostors", "2"]) == 2
    for option in ("--cases", "--matchers"):
        assert main([*words, option, " , "]) == 2
        assert f"{option} needs a name at least" in capsys.readouterr().err


@pytest.mark.slow
def test_a_damaged_copy_is_named_and_done_again(people, tmp_path, capsys):
    """A copy that broke off is no failure to acquire: the others are done, and the next run finds
    it whole."""
    copies, store = tmp_path / "people", tmp_path / "store"
    shutil.copytree(people, copies)
    words = f"batch {copies} --out {store} --cases ea --jobs 1 --matchers ridge --json".split()
    whole = {}
    for name in ("S01/session_1/right_index/white_0.png", "S02/session_2/right_index/white_3.png"):
        whole[copies / name] = (copies / name).read_bytes()
        (copies / name).write_bytes(whole[copies / name][:5000])
    for done in (2, 0):  # and once more, while nothing was repaired
        assert main(words) == 2
        out, err = capsys.readouterr()
        facts = json.loads(out)
        assert (facts["captures"], facts["reconstructed"], facts["failures"]) == (4, done, [])
        named = [failure["capture"] for failure in facts["unreadable"]]
        assert named == ["S01/session_1/right_index", "S02/session_2/right_index"]
        assert (
            err.count("\n") == 1
            and "2 of 4 captures cannot be read (first: S01/session_1/right_index" in err
        )
        assert str(tmp_path) not in err and "the others are done" in err
        assert [table["compared"] for table in facts["scores"]] == [done // 2]
    for file, content in whole.items():
        file.write_bytes(content)
    assert main(words) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["reconstructed"], facts["found"], facts["unreadable"]) == (2, 2, [])
    assert facts["scores"][0]["compared"] == 3
    words[3] = str(tmp_path / "another")
    assert main(words) == 0
    again = json.loads(capsys.readouterr().out)
    assert Path(again["csv"][0]).read_bytes() == Path(facts["csv"][0]).read_bytes()


def test_of_damaged_copies_alone_nothing_is_kept(people, tmp_path, capsys):
    copies = tmp_path / "people"
    shutil.copytree(people, copies)
    for file in copies.rglob("white_1.png"):
        file.write_bytes(b"")
    assert main(f"batch {copies} --out {tmp_path}/store --cases ea --jobs 1".split()) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    assert "4 of 4 captures cannot be read" in err and "not compared" in err
    assert list((tmp_path / "store").rglob("*.npz")) == []


def test_cases_of_ones_own():
    case = _case("near=ea:normals.method=near_light,shapelets.scales=5")
    assert (case.name, case.preset) == ("near", "ea")
    assert case.changes == {"normals.method": "near_light", "shapelets.scales": 5}
    assert _case("plain=pr").changes == {}
    with bad_input("NAME=PRESET"):
        _case("plain")
    with bad_input("not of the form"):
        _case("a=ea:rubbish")
