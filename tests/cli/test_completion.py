"""The shell's completion, ``--version`` of every verb, and what is suggested for a typo."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from splitknit.cli.main import main

TRIES = """
try() {
  COMP_WORDS=(splitknit "$@"); COMP_CWORD=$(( ${#COMP_WORDS[@]} - 1 )); COMPREPLY=()
  _shtab_splitknit 2>/dev/null; echo "${COMPREPLY[*]}"
}
try ma; try calibrate l; try match a b --met; try match a b --method r; try demo --out fo; try view fo
"""


@pytest.mark.skipif(sys.platform == "win32" or shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_verbs_options_values_and_paths(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out + TRIES)
    (tmp_path / "folder").mkdir()
    (tmp_path / "fourth").write_text("")
    done = subprocess.run(["bash", "script"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert [sorted(line.split()) for line in done.stdout.splitlines()] == [
        ["match"], ["lights"], ["--method"], ["ridge"], ["folder"], ["folder", "fourth"],
    ]  # fmt: skip


@pytest.mark.parametrize("shell", ["zsh", "fish", "powershell"])
def test_other_shells_have_a_script(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "reconstruct" in script and "tip-direction" in script


@pytest.mark.parametrize("verb", ["", "demo", "gallery", "gallery import", "calibrate lights", "completion"])
def test_every_verb_has_the_version(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*verb.split(), "--version"]) == 0
    assert capsys.readouterr().out.startswith("splitknit 0.")


@pytest.mark.parametrize(
    ("line", "verb", "meant"),
    [
        ("recontsruct x", "splitknit", "did you mean 'reconstruct' instead of 'recontsruct'?"),
        ("calibrate lihgts", "splitknit calibrate", "did you mean 'lights' instead of 'lihgts'?"),
        ("match a b --methd ridge", "splitknit match", "did you mean '--method' instead of '--methd'?"),
        ("reconstruct x --outt=y", "splitknit reconstruct", "did you mean '--out' instead of '--outt'?"),
        ("match a b --method rigde", "splitknit match", "did you mean 'ridge' instead of 'rigde'?"),
    ],
)
def test_a_typo_is_answered_with_what_was_meant(
    line: str, verb: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    said = capsys.readouterr().err
    error, hint = said.splitlines()  # and no usage of twenty lines before them
    assert error.startswith(f"{verb}: error: ") and error.endswith(meant)
    assert hint == f"See '{verb} --help'."


@pytest.mark.parametrize("line", ["zzz", "match a b --zzz", "match a b c"])
def test_nothing_is_suggested_for_what_is_like_nothing(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 2
    assert "did you mean" not in capsys.readouterr().err
