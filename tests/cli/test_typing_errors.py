"""``--version`` of every verb, and what is suggested for a typo."""

import pytest

from splitknit.cli.main import main


@pytest.mark.parametrize("verb", ["", "demo", "gallery", "gallery import", "calibrate lights"])
def test_every_verb_has_the_version(verb, capsys):
    assert main([*verb.split(), "--version"]) == 0
    assert capsys.readouterr().out.startswith("splitknit 0.")


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("recontsruct x", "did you mean 'reconstruct'?"),
        ("calibrate lihgts", 'Did you mean "lights"?'),
        ("match a b --methd ridge", "Did you mean --method?"),
        ("reconstruct x --outt=y", "Did you mean --out instead of --outt=y?"),
        ("match a b --method rigde", "did you mean 'ridge'?"),
    ],
)
def test_a_typo_is_answered_with_what_was_meant(line, meant, capsys):
    assert main(line.split()) == 2
    error = capsys.readouterr().err
    assert error.startswith("splitknit: error: ") and meant in error
    assert error.count("\n") == 1  # and no usage of twenty lines


@pytest.mark.parametrize("line", ["zzz", "match a b --zzz", "match a b c"])
def test_nothing_is_suggested_for_what_is_like_nothing(line, capsys):
    assert main(line.split()) == 2
    assert "did you mean" not in capsys.readouterr().err.lower()
