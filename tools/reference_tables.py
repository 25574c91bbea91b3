"""The tables of docs/reference that are made of the code when the site is built: every setting,
every code of a finding, every tuned constant.

    python tools/reference_tables.py settings      # prints one: settings, findings or parameters

The words are the docstrings below the fields of the settings' dataclasses and below constants, and
the tables of codes.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import json
import re
import runpy
import sys
import textwrap
from collections import Counter
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

from splitknit.diagnosis.codes import CODES, Code
from splitknit.presets import PRESETS
from splitknit_match.codes import CODES as MATCH_CODES
from splitknit_match.matching.surface import MatchingSettings
from splitknit_rig.capture.pi import PiCameraSettings
from splitknit_rig.capture.session import SessionSettings
from splitknit_rig.codes import CODES as RIG_CODES
from splitknit_simulator.bench_photos import BenchPhotos
from splitknit_simulator.population.sessions import PopulationSettings
from splitknit_simulator.scene import TwinSettings

PACKAGES = Path(__file__).resolve().parents[1] / "packages"
FACTS = re.compile(r"(.*?) ?(?:Source|Chosen on): (.+?)\.(?: Range: (.+?)\.)?")
"""Docstring of a constant that states where its value comes from."""
SIMULATED = "simulated"
UNSTATED = re.compile("definition|derived|judgement$|not known")
"""Statements that leave a constant out of the table: nothing was measured or read."""
LONGEST_VALUE = 60
"""Characters; a longer value is a table."""


@cache
def field_words(settings: type) -> dict[str, str]:
    """Docstrings below the fields of a dataclass and its bases, by field."""
    words = {}
    for kind in settings.__mro__[:-1]:
        body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
        assert isinstance(body, ast.ClassDef)
        for line, following in zip(body.body, [*body.body[1:], ast.Pass()], strict=True):
            is_field = isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)
            is_text = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
            if is_field and is_text:
                text = " ".join(str(following.value.value).split()).replace("``", "`")
                words[line.target.id] = re.sub(r":\w+:`", "`", text)
    return words


def rows(settings: Any, prefix: str = "") -> list[tuple[str, Any, str]]:
    """Name, value and words of every single setting, groups opened.

    Raises
    ------
    ValueError
        If a setting has no docstring below it.
    """
    words = field_words(type(settings))
    table: list[tuple[str, Any, str]] = []
    for field in fields(settings):
        value = getattr(settings, field.name)
        if is_dataclass(value):
            table += rows(value, f"{prefix}{field.name}.")
        else:
            if not words.get(field.name):
                raise ValueError(
                    f"{type(settings).__qualname__}.{field.name} needs a docstring below it."
                )
            table.append((prefix + field.name, value, words[field.name]))
    return table


def typed(value: Any) -> str:
    """A value as it is typed behind ``--set name=``."""
    return value if isinstance(value, str) else json.dumps(value)


def preset_table() -> str:
    """Settings of ``metric`` with what other presets change."""
    tables = {name: rows(settings) for name, settings in PRESETS.items()}
    lines = ["| setting | default | what it does |", "| --- | --- | --- |"]
    for k, (name, value, words) in enumerate(tables["metric"]):
        others: dict[str, list[str]] = {}
        for preset, table in tables.items():
            if table[k][1] != value:
                others.setdefault(typed(table[k][1]), []).append(f"`{preset}`")
        changed = "; ".join(f"{', '.join(presets)}: {values}" for values, presets in others.items())
        lines.append(
            f"| `{name}` | {typed(value)}{f' ({changed})' if changed else ''} |"
            f" {words.replace('|', ' or ')} |"
        )
    return "\n".join(lines)


def plain_table(settings: Any, prefix: str = "") -> str:
    """Settings of one dataclass, its groups opened."""
    lines = ["| setting | default | what it does |", "| --- | --- | --- |"]
    lines += [
        f"| `{name}` | {typed(value)} | {words.replace('|', ' or ')} |"
        for name, value, words in rows(settings, prefix)
    ]
    return "\n".join(lines)


SECTIONS: tuple[tuple[str, str, tuple[tuple[str, Any], ...]], ...] = (
    (
        "`splitknit simulate`",
        "Ranges (low, high) are drawn from, finger by finger.",
        (("", TwinSettings()),),
    ),
    (
        "`splitknit simulate population`",
        "Where they come from: [population model](../explain/population.md).",
        (("", PopulationSettings()),),
    ),
    ("`splitknit simulate --bench`", "How many photographs of what.", (("", BenchPhotos()),)),
    (
        "`splitknit capture`",
        "With `--device twin` the settings of `simulate` as well.",
        (("capture.", SessionSettings()), ("pi.", PiCameraSettings())),
    ),
    (
        "`splitknit match`, `enroll` and `identify`",
        (
            "What each is: [matching](../guide/matching.md). Captures are reconstructed with"
            " `--preset` as it is."
        ),
        (("", MatchingSettings()),),
    ),
)
"""Heading, words, and what the names begin with, for every verb but ``reconstruct``."""


def settings_table() -> str:
    """Every setting of every verb."""
    parts = [
        "## `splitknit reconstruct`",
        "Defaults are those of `metric`; in brackets, what other presets change.",
        preset_table(),
    ]
    for heading, words, tables in SECTIONS:
        parts += [
            f"## {heading}",
            words,
            *(plain_table(settings, prefix) for prefix, settings in tables),
        ]
    return "\n\n".join(parts)


MEMBERS: tuple[tuple[str, dict[str, Code], str], ...] = (
    (
        "splitknit-rig",
        RIG_CODES,
        "What `calibrate` and `capture` find, in `findings` of their results and of `--json`. A"
        " `doubt` comes first; what was measured is written all the same. `ambient-light`,"
        " `assumed-encoding`, `dark-photographs`, `drifted-led` and `odd-camera-height` are as"
        " above.",
    ),
    (
        "splitknit-match",
        MATCH_CODES,
        "What the verbs of prints, comparisons, galleries and evaluations find, in the same way;"
        " those of a capture or a photograph are the core's.",
    ),
)
"""Name, codes and words of each member that has codes of its own."""


def code_table(codes: dict[str, Code]) -> str:
    """One row a code, by name."""
    lines = [
        "| code | what it means | what to do | how often on sound captures |",
        "| --- | --- | --- | --- |",
    ]
    lines += [
        f"| `{name}` | {code.meaning} | {code.remedy} | {code.wrong} |"
        for name, code in sorted(codes.items())
    ]
    return "\n".join(lines)


def findings_table() -> str:
    """Every code, the core's first."""
    parts = [code_table(CODES)]
    for member, codes, words in MEMBERS:
        parts += [f"## {member}", words, code_table(codes)]
    return "\n\n".join(parts)


def parameters_table() -> str:
    """How many tuned constants there are, and every one that states what it was chosen on."""
    constants = runpy.run_path(str(Path(__file__).with_name("measure_house.py")))["constants"]
    members: Counter[str] = Counter()
    tables: dict[str, list[str]] = {}
    simulated = 0
    for source in sorted(PACKAGES.glob("*/src")):
        for constant in constants(source):
            members[constant.module.partition(".")[0]] += constant.tuned
            facts = FACTS.fullmatch(constant.words)
            if facts is None or UNSTATED.match(facts[2]):
                continue
            simulated += facts[2].startswith(SIMULATED)
            module = constant.module.removesuffix(".parameters")
            tables.setdefault(module, []).append(
                _row(constant.name, ast.unparse(constant.value), *facts.groups())
            )
    head = (
        f"**{members.total()} tuned constants** ("
        + ", ".join(f"`{member}` {count}" for member, count in members.items())
        + f"). {simulated} were chosen on this project's simulator alone. Those that state what"
        " they were chosen on, or a source:"
    )
    columns = (
        "| constant | value | what it is | chosen on, or source | hardly changes |",
        "| --- | --- | --- | --- | --- |",
    )
    return "\n\n".join(
        [
            head,
            *(
                f"## {module}\n\n" + "\n".join([*columns, *table])
                for module, table in tables.items()
            ),
        ]
    )


def _row(name: str, value: str, words: str, basis: str, interval: str | None) -> str:
    cells = (
        f"`{name}`",
        value if len(value) <= LONGEST_VALUE else "a table",
        re.sub(r":\w+:`", "`", words).replace("``", "`"),
        basis,
        "" if interval in (None, "not known") else interval,
    )
    return "| " + " | ".join(cell.replace("|", " or ") for cell in cells) + " |"


TABLES = {
    "settings": settings_table,
    "findings": findings_table,
    "parameters": parameters_table,
}


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", choices=TABLES)
    sys.stdout.write(TABLES[parser.parse_args().table]() + "\n")


if __name__ == "__main__":
    main()
