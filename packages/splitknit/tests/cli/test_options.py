import json

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from refusals import bad_input
from splitknit.cli.options import parse_assignment, read_changes
from splitknit.errors import BadInput


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("a.b=3", "a.b", 3),
        ("a.b=0.5", "a.b", 0.5),
        ("a.b=true", "a.b", True),
        ("a.b=null", "a.b", None),
        ("a.b=robust", "a.b", "robust"),
        ('a.b="robust"', "a.b", "robust"),
        ("a.b='robust'", "a.b", "robust"),
        ("a.b=[1, 2.5]", "a.b", [1, 2.5]),
        (" a.b.c = x=y ", "a.b.c", "x=y"),
        ("scale=1e-3", "scale", 0.001),
        ("a.b=", "a.b", ""),
    ],
)
def test_values_of_assignments_are_json_toml_or_plain_text(text, name, value):
    assert parse_assignment(text) == (name, value)


@pytest.mark.parametrize("text", ["a.b", "=3", "a..b=3", "a b=3", "1.a=3", ".=1"])
def test_malformed_assignments_are_refused(text):
    with bad_input(r"stage\.field=value"):
        parse_assignment(text)


@pytest.mark.slow
@given(st.text(max_size=40))
@hypothesis_settings(max_examples=150, derandomize=True, deadline=None)
def test_no_text_breaks_the_parser(text):
    try:
        name, _ = parse_assignment(text)
    except BadInput:
        return
    assert all(part.isidentifier() for part in name.split("."))


def test_assignments_override_the_settings_file(tmp_path):
    file = tmp_path / "s.toml"
    file.write_text('[knit]\nmode = "addition"\nscales = 3\n')
    assert read_changes([("--settings", str(file)), ("--set", "knit.mode=crossover")]) == {
        "knit.mode": "crossover",
        "knit.scales": 3,
    }
    assert read_changes([]) == {}


def test_json_and_toml_give_the_same_settings(tmp_path):
    (tmp_path / "s.json").write_text(json.dumps({"knit": {"mode": "a"}, "x.y": [1]}))
    (tmp_path / "s.toml").write_text('"x.y" = [1]\n[knit]\nmode = "a"\n')
    for name in ("s.json", "s.toml"):
        assert read_changes([("--settings", str(tmp_path / name))]) == {
            "knit.mode": "a",
            "x.y": [1],
        }


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("s.json", b"{", "not valid JSON"),
        ("s.json", b'{"a": {"b": 1e999}}', "not valid JSON"),
        ("s.json", b"[1]", "must hold a table"),
        ("s.toml", b"a = ", "not sound TOML"),
        ("s.toml", b"\xff\xfe\x00", "not a text file"),
        ("s.json", b"[" * 60_000, "nested too deeply"),
        ("s.toml", b"a = " + b"[" * 60_000, "not sound TOML"),
        ("s.toml", b".".join([b"a"] * 3000) + b" = 1", "nested too deeply"),
        ("s.toml", b"#" * 64_001, "too large"),
    ],
)
def test_broken_settings_files_are_refused(tmp_path, name, data, words):
    (tmp_path / name).write_bytes(data)
    with bad_input(words):
        read_changes([("--settings", str(tmp_path / name))])


def test_missing_file_is_refused(tmp_path):
    with bad_input("does not exist"):
        read_changes([("--settings", str(tmp_path / "none.json"))])
