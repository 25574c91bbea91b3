"""``--version`` of every verb, and what is suggested for a typo."""

from __future__ import annotations

import pytest

from splitknit.cli.main import main


@pytest.mark.parametrize("verb", ["", "demo", "gallery", "gallery import", "calibrate lights"])
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
