"""A verb is a function: its signature makes the options, its docstring the help, its result what is
printed."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from cyclopts import Parameter
from numpy.typing import NDArray

from splitknit import registry
from splitknit.arguments import (
    PYTHON_ONLY,
    SEVERAL,
    AnyPath,
    Natural,
    Progress,
    Settings,
    checked,
    refuse_given,
    silent,
)
from splitknit.cli.app import build_app, help_of
from splitknit.cli.main import main
from splitknit.errors import BadInput, require
from splitknit.io.images import read_image
from splitknit.io.results import read_result
from splitknit.observation.stored import decode_table
from splitknit.settings import Limits


@dataclass(frozen=True)
class Lamp:
    """Options that belong together."""

    power_mw: Annotated[float | None, Parameter("--power")] = None
    """Of each LED."""
    hue: str = "white"
    """Of all."""


@dataclass(frozen=True)
class Lit:
    """What came out."""

    out: str
    seed: int
    note: str | None = None

    def __str__(self) -> str:
        return f"{self.out} by `colour`"


CALLS: list[dict[str, Any]] = []


@checked
def shine(
    folders: Sequence[AnyPath],
    *,
    out: AnyPath,
    colour: Literal["red", "blue"] = "red",
    size: Annotated[float, Limits(0.0, 1.0)] | None = None,
    seed: Natural = 3,
    shadows: Annotated[bool, Parameter(negative="--no-shadows")] = True,
    marks: Sequence[str] = (),
    scores: Annotated[Sequence[AnyPath], SEVERAL] = (),
    settings: Settings = None,
    lamp: Annotated[Lamp, Parameter("*", group="Lamp")] = Lamp(),
    memory: Annotated[Any, PYTHON_ONLY] = None,
    progress: Progress = silent,
) -> Lit:
    """Light a finger.

    Parameters
    ----------
    folders
        Where; see `power_mw` (100 %).
    out
        File to write.
    seed
        Which.
    """
    CALLS.append(dict(locals()))
    progress("light", 0.5)
    power = lamp.power_mw
    require(
        power is None or power >= 0,
        f"`power_mw` must not be negative, but it is {power} (`unknown`).",
    )
    if colour == "blue":
        refuse_given("is for red light.", marks=tuple(marks))
    return Lit(str(out), seed, "`seed`" if seed else None)


@pytest.fixture(autouse=True)
def entry_points(monkeypatch) -> None:
    """Two verbs of somebody else's, by entry points."""
    points = importlib.metadata.EntryPoints(
        importlib.metadata.EntryPoint(name, "test_verbs:shine", registry.GROUP)
        for name in ("shine", "light shine")
    )
    actual = importlib.metadata.entry_points

    def registered(**named: Any) -> Any:
        return points if named == {"group": registry.GROUP} else actual(**named)

    monkeypatch.setattr(importlib.metadata, "entry_points", registered)


def test_words_become_arguments():
    words = (
        "shine a b --out c --colour blue --size 0.5 --seed 0 --no-shadows --scores x y --power 3"
    )
    assert main([*words.split(), "--set", "a.b=1", "--set", "c=x"]) == 0
    call = CALLS[-1]
    assert list(call["folders"]) == [Path("a"), Path("b")]
    assert list(call["scores"]) == [Path("x"), Path("y")]
    assert (call["out"], call["colour"], call["size"], call["seed"]) == (Path("c"), "blue", 0.5, 0)
    assert (call["shadows"], call["settings"], call["lamp"]) == (
        False,
        {"a.b": 1, "c": "x"},
        Lamp(3.0),
    )
    assert main(["shine", "a", "--out", "c", "--marks", "x", "--marks", "y"]) == 0
    assert list(CALLS[-1]["marks"]) == ["x", "y"]
    assert (CALLS[-1]["shadows"], CALLS[-1]["memory"]) == (True, None)


def test_help_comes_from_signature_and_docstring(capsys):
    assert main(["shine", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for words in (
        "Light a finger.",
        "FOLDERS",
        "--no-shadows",
        "Which. [default: 3]",
        "[choices: red, blue] [default: red]",
        "see --power (100 %)",
        "--out PATH File to write. [required]",
        "--power FLOAT Of each LED.",
        "--json",
    ):
        assert words in text, words
    assert "memory" not in text and "progress" not in text
    assert main(["--help"]) == 0
    assert "\n  shine" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--seed -1", "--seed must be from 0 to 2^63 - 1, but it is -1."),
        ("--seed 1.5", "'1.5' must be a whole number"),
        ("--seed 1e99999", "'1e99999' must be a whole number"),
        ("--size 2", "--size must be from 0 to 1, but it is 2.0."),
        ("--size x", 'unable to convert "x" into float'),
        ("--colour green", 'Invalid value "green" for --colour. Choose from: "red", "blue".'),
        ("--power -1", "--power must not be negative, but it is -1.0 (unknown)."),
        ("--colour blue --marks x", "--marks is for red light."),
        ("--colou blue", "Unknown option: --colou. Did you mean --colour?"),
    ],
)
def test_messages_name_options(words, sentence, capsys):
    assert main([*["shine", "a", "--out", "b"], *words.split()]) == 2
    error = capsys.readouterr().err
    assert error.startswith("splitknit: error: ") and error.count("\n") == 1
    assert sentence in error


def test_a_verb_of_two_words_and_its_facts(capsys):
    assert main(["light", "shine", "a", "--out", "b"]) == 0
    assert capsys.readouterr().out == "b by --colour\n"
    assert main(["light", "shine", "a", "--out", "b", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"out": "b", "seed": 3, "note": "--seed"}
    assert main(["light", "shine", "a", "--json", "--out", "b", "--seed", "0"]) == 0
    assert json.loads(capsys.readouterr().out) == {"out": "b", "seed": 0}
    assert main(["light"]) == 2
    assert "shine" in capsys.readouterr().err


def test_python_has_the_same_checks():
    assert shine(["a"], out=Path("b"), size=1.0) == Lit("b", 3, "`seed`")
    for wrong, sentence in (
        ({"size": 2.0}, "`size` must be from 0 to 1"),
        ({"colour": "x"}, "one of red, blue, but"),
    ):
        with pytest.raises(BadInput, match=sentence):
            shine(["a"], out="b", **wrong)  # type: ignore[arg-type]


def test_a_member_that_is_missing_is_one_sentence(monkeypatch, capsys):
    assert main(["--help"]) == 0
    before = capsys.readouterr().out
    monkeypatch.setitem(registry.VERBS, "match", ("no-such-member", registry.VERBS["match"][1]))
    for words in (["match"], ["match", "--help"], ["match", "a", "b", "--json", "--set", "x=1"]):
        assert main(words) == 2
        assert (
            capsys.readouterr().err
            == "splitknit: error: 'splitknit match' comes with no-such-member, which is not"
            " installed; add it, in splitknit's folder, with 'pip install"
            " ./packages/no-such-member'.\n"
        )
    assert main(["--help"]) == 0
    assert capsys.readouterr().out == before


def test_the_table_and_the_functions_say_the_same():
    app = build_app()
    for name, (_, line) in registry.VERBS.items():
        if app[name].default_command is not None:
            words = " ".join(help_of(app, [name]).split("\n\n")[1].split()).rstrip(".")
            assert words.lower() == line.lower(), name


def test_steps_are_kept_where_a_preset_has_them(twin_folder, tmp_path):
    out = tmp_path / "result"
    options = ["--out", str(out), "--keep-steps"]
    assert main([*f"reconstruct {twin_folder} --preset snk".split(), *options]) == 0
    report = json.loads((out / "report.json").read_text())
    steps = report["facts"]["steps"]
    assert set(steps) == {"chromaticity", "raw_mask", "enhanced", "direct", "global"}
    raw_mask = srgb_light(out / steps["raw_mask"]["files"][0])
    assert set(np.unique(raw_mask)) == {0.0, 1.0}
    assert 0.1 < raw_mask.mean() < 0.6
    light = {
        name: srgb_light(out / steps[name]["files"][0]) * steps[name]["white"]
        for name in ("enhanced", "direct", "global")
    }
    assert all(len(steps[name]["files"]) == 7 for name in light)
    sum_error = light["direct"] + light["global"] - light["enhanced"]
    assert np.abs(sum_error[light["direct"] > 0]).max() < 1e-3 * light["enhanced"].max()
    assert {file for step in steps.values() for file in step["files"]} <= set(report["files"])
    assert main([*f"reconstruct {twin_folder} --preset ea".split(), *options]) == 0
    names = [file.name for file in (out / "steps").iterdir()]
    assert sorted(names) == ["chromaticity.png", "raw_mask.png"]
    assert main(f"reconstruct {twin_folder} --preset ea --out {out}".split()) == 0
    assert not (out / "steps").exists()


def test_snk_takes_a_network_file_by_its_path(twin_folder, tmp_path, capsys):
    shipped = resources.files("splitknit.networks") / "shipped"
    mine = tmp_path / "mine.onnx"
    for file in (mine, mine.with_suffix(".json")):
        file.write_bytes((shipped / f"direct{file.suffix}").read_bytes())

    def heights(name, *changes):
        options = ["--preset", "snk", *changes, "--out", str(tmp_path / name)]
        assert main(["reconstruct", str(twin_folder), *options]) == 0
        return read_result(tmp_path / name).height_mm

    by_path = heights("by_path", "--set", f"direct.network={mine}")
    np.testing.assert_array_equal(by_path, heights("shipped"))
    report = json.loads((tmp_path / "by_path" / "report.json").read_text())
    assert report["facts"]["separation"] == f"direct light by the network '{mine}'"

    mine.write_bytes(b"not a network")
    refused = {mine: "are damaged or not those of their card", tmp_path / "none.onnx": "cannot be"}
    capsys.readouterr()
    for file, sentence in refused.items():
        options = ["--set", f"direct.network={file}", "--out", str(tmp_path / "refused")]
        assert main([*f"reconstruct {twin_folder} --preset snk".split(), *options]) == 2
        printed = capsys.readouterr().err
        assert printed.startswith("splitknit: error: ") and printed.count("\n") == 1
        assert str(file) in printed and sentence in printed
        assert not (tmp_path / "refused").exists()


def srgb_light(file: Path) -> NDArray[np.float32]:
    """Linear light of a picture of 16 bits."""
    pixels = read_image(file)[..., 0]
    return decode_table(pixels.dtype, "srgb")[pixels]
