from __future__ import annotations

import json
from pathlib import Path

import pytest

from splitknit.apps.cli import main
from splitknit.apps.targets import check_target
from splitknit.check import BadInput
from splitknit.io import atomic_folder

WRITERS = (
    ["print", "RESULT"],
    ["evaluate", "--scores", "scores.csv"],
    ["gallery", "export", "gallery.skg"],
    ["rig", "circuit"],
    ["rig", "cad"],
    ["simulate"],
    ["simulate", "--bench"],
    ["demo"],
    ["reconstruct", "CAPTURE"],
)


@pytest.fixture
def taken(tmp_path: Path) -> Path:
    """A folder that splitknit wrote: photographs of a finger, as ``splitknit capture`` leaves them."""
    with atomic_folder(tmp_path / "finger") as folder:
        for name in ("capture.json", "session.json", "report.json", "white_0.png"):
            (folder / name).write_text("{}")
    return tmp_path / "finger"


@pytest.mark.parametrize("words", WRITERS, ids=lambda words: " ".join(words[:2]))
def test_no_verb_replaces_photographs(words: list[str], taken: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words, "--out", str(taken)]) == 2
    error = capsys.readouterr().err
    assert "is not empty and is not an earlier" in error and error.count("\n") == 1
    assert (taken / "white_0.png").is_file()


def test_the_same_kind_may_be_replaced(tmp_path: Path) -> None:
    check_target(tmp_path / "new", "map.npz", "an earlier print")
    check_target(tmp_path, "map.npz", "an earlier print")
    (tmp_path / "map.npz").touch()
    check_target(tmp_path, "map.npz", "an earlier print")
    (tmp_path / "map.npz").unlink()
    (tmp_path / "other").touch()
    with pytest.raises(BadInput, match="is not an earlier print; name another folder"):
        check_target(tmp_path, "map.npz", "an earlier print")


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", json.dumps({"format": "another"})])
def test_a_report_of_another_kind_is_told_apart(text: str, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    report.write_text(json.dumps({"format": "ours"}))
    check_target(tmp_path, "report.json", "an earlier one", form="ours")
    report.write_text(text)
    with pytest.raises(BadInput, match="is not an earlier one"):
        check_target(tmp_path, "report.json", "an earlier one", form="ours")


def test_what_is_read_is_kept(tmp_path: Path) -> None:
    source = tmp_path / "a" / "b"
    source.mkdir(parents=True)
    for out in (source, source.parent, source / ".." / "b"):
        with pytest.raises(BadInput, match="holds the input itself"):
            check_target(out, "x", "an earlier one", keep=source)
    check_target(source / "out", "x", "an earlier one", keep=source)
