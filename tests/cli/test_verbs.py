"""A verb is declared once: options, function, docstring and messages come from the fields of its job."""

from __future__ import annotations

import importlib.metadata
import inspect
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest

from splitknit import registry
from splitknit.cli.main import build_parser, main
from splitknit.cli.verb import Verb, job_of
from splitknit.errors import BadInput, require
from splitknit.settings import Limits
from splitknit.verbs import AnyPath, Help, Job, Natural, Progress, Settings, function_of, refuse_given


@dataclass(frozen=True, slots=True)
class Light(Job):
    """A group of fields."""

    power_mw: Annotated[float | None, Help("of each LED", "MW", option="--power")] = None
    places: Annotated[tuple[float, float], Help("of the first")] = (0.0, 1.0)


@dataclass(frozen=True, slots=True)
class ShineJob(Job):
    """Light a finger.

    Returns
    -------
    ShineJob

    Raises
    ------
    BadInput
        If `power_mw` is negative.
    """

    folders: Annotated[tuple[AnyPath, ...], Help("where", "DIR", positional=True)]
    out: Annotated[AnyPath, Help("file to write", "FILE")]
    _: KW_ONLY
    colour: Annotated[Literal["red", "blue"], Help("of the light")] = "red"
    size: Annotated[Annotated[float, Limits(0.0, 1.0)] | None, Help("of the images")] = None
    seed: Annotated[Natural, Help("which")] = 3
    shadows: Annotated[bool, Help("leave out shadows")] = True
    marks: Annotated[tuple[str, ...], Help("marks; see `power_mw` (100 %)", "MARK")] = ()
    settings: Settings = None
    light: Annotated[Light, Help("lights", about="All of them.")] = field(default_factory=Light)
    memory: Annotated[Any, Help("of earlier runs", python_only=True)] = None

    def run(self, progress: Progress) -> ShineJob:
        """Return itself."""
        progress("light", 0.5)
        power = self.light.power_mw
        require(power is None or power >= 0, f"`power_mw` must not be negative, but it is {power} (`unknown`).")
        if self.colour == "blue":
            refuse_given(self, ("seed", "shadows"), "is for red light.")
        return self


shine = function_of(ShineJob)
SHINE = Verb(ShineJob, lambda job, same: ({"out": str(job.out), "note": "`seed`"}, [f"{job.out} by `colour`"]))


@pytest.fixture(autouse=True)
def entry_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two verbs of somebody else's, by entry points."""
    points = importlib.metadata.EntryPoints(
        importlib.metadata.EntryPoint(name, "test_verbs:SHINE", registry.GROUP) for name in ("shine", "light shine")
    )
    actual = importlib.metadata.entry_points

    def found(**named: Any) -> Any:
        return points if named == {"group": registry.GROUP} else actual(**named)

    monkeypatch.setattr(importlib.metadata, "entry_points", found)


def made(*words: str) -> ShineJob:
    options = build_parser("shine").parse_args(["shine", *words])
    return job_of(ShineJob, options)  # type: ignore[no-any-return]


def test_words_become_the_job() -> None:
    assert made("a", "b", "--out", "c") == ShineJob(("a", "b"), "c")
    words = "a --out c --colour blue --size 0.5 --seed 0 --no-shadows --marks x --marks y --power 3 --places 1 2"
    assert made(*words.split(), "--set", "a.b=1") == ShineJob(
        (Path("a"),), Path("c"), colour="blue", size=0.5, seed=0, shadows=False, marks=("x", "y"), settings={"a.b": 1},
        light=Light(3.0, (1.0, 2.0)),
    )  # fmt: skip


def test_help_comes_from_the_fields(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["shine", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for words in (
        "Light a finger.", "DIR [DIR ...]", "--no-shadows leave out shadows", "which (default: 3)", "lights: All of",
        "of the light (default: red)", "see --power (100 %)", "--places PLACES PLACES",
    ):  # fmt: skip
        assert words in text, words
    assert "memory" not in text
    assert main(["--help"]) == 0
    assert "\n    shine" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--seed -1", "argument --seed: '-1' must be a whole number from 0 to 2^63 - 1"),
        ("--seed 1.5", "'1.5' must be a whole number"),
        ("--size 2", "argument --size: '2' must be a number from 0 to 1"),
        ("--size x", "'x' must be a number from 0 to 1"),
        ("--colour green", "invalid choice: 'green'"),
        ("--power -1", "splitknit: error: --power must not be negative, but it is -1.0 (unknown)."),
        ("--colour blue --no-shadows", "splitknit: error: --no-shadows is for red light."),
    ],
)
def test_messages_name_options(words: str, sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["shine", "a", "--out", "b", *words.split()]) == 2
    assert sentence in capsys.readouterr().err


def test_a_verb_of_two_words_and_its_facts(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["light", "shine", "a", "--out", "b"]) == 0
    assert capsys.readouterr().out == "b by --colour\n"
    assert main(["light", "shine", "a", "--out", "b", "--json"]) == 0
    assert '"note": "--seed"' in capsys.readouterr().out


def test_the_function_has_the_fields() -> None:
    assert shine.__name__ == "shine"
    found = shine(["a"], Path("b"), size=1.0)
    assert found == ShineJob((Path("a"),), Path("b"), size=1.0)
    assert list(inspect.signature(shine).parameters) == [
        "folders", "out", "colour", "size", "seed", "shadows", "marks", "settings", "light", "memory"
    ]  # fmt: skip
    words = inspect.getdoc(shine) or ""
    assert words.index("Light a finger.") < words.index("Parameters\n") < words.index("Returns\n")
    assert "folders : sequence of path\n    where\n" in words
    assert "seed : int, optional\n    which (default: 3)\n" in words
    for wrong, sentence in (({"size": 2.0}, "`size` must be from 0 to 1"), ({"colour": "x"}, "one of red, blue, but")):
        with pytest.raises(BadInput, match=sentence):
            shine("a", "b", **wrong)  # type: ignore[arg-type]


def test_a_member_that_is_missing_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--help"]) == 0
    before = capsys.readouterr().out
    monkeypatch.setitem(registry.VERBS, "match", ("no-such-member", registry.VERBS["match"][1]))
    for words in (["match"], ["match", "--help"], ["match", "a", "b", "--json", "--set", "x=1"]):
        assert main(words) == 2
        assert capsys.readouterr().err == (
            "splitknit: error: 'splitknit match' comes with no-such-member, which is not installed; add it, in "
            "splitknit's folder, with 'pip install ./packages/no-such-member'.\n"
        )
    assert main(["--help"]) == 0
    assert capsys.readouterr().out == before


def test_the_table_and_the_jobs_say_the_same() -> None:
    verbs = build_parser()._subparsers._group_actions[0]  # type: ignore[union-attr]
    lines = {action.dest: action.help for action in verbs._choices_actions}  # type: ignore[attr-defined]
    assert {name: lines[name] for name in registry.VERBS} == {name: line for name, (_, line) in registry.VERBS.items()}
