"""The pages say what is true: links lead somewhere, generated pages are current, examples on them
are read."""

import ast
import importlib
import importlib.util
import inspect
import itertools
import json
import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import splitknit
from splitknit.cli.app import build_app
from splitknit.io.images import write_image
from splitknit.registry import VERBS

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *ROOT.glob("packages/*/README.md"),
        *ROOT.glob("docs/**/*.md"),
        *ROOT.glob("benchmarks/*.md"),
    ]
)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_to_files(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), f"{page.name}: {target}"
        if anchor:
            headings = re.findall(
                r"^#+ (.*)$", file.read_text(encoding="utf-8"), flags=re.MULTILINE
            )
            slugs = {
                re.sub(r"[^\w\- ]", "", heading).lower().replace(" ", "-") for heading in headings
            }
            assert anchor in slugs, f"{page.name}: {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_files_that_are_named_exist(page):
    text = page.read_text(encoding="utf-8")
    named = set(
        re.findall(
            r"(?<![\w/-])(?:packages|examples|benchmarks|validation|tools|docs|tests)"
            r"/[\w/-]+\.(?:py|md|json|png|jpg)",
            text,
        )
    )
    missing = [
        name for name in named if not (ROOT / name).exists() and not (page.parent / name).exists()
    ]
    assert missing == []


def test_the_site_lists_every_page():
    listed = re.findall(
        r"(\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), flags=re.MULTILINE
    )
    pages = [
        *ROOT.glob("docs/**/*.md"),
        *(page.with_suffix(".md") for page in ROOT.glob("docs/**/*.ipynb")),
    ]
    assert sorted(listed) == sorted(page.relative_to(ROOT / "docs").as_posix() for page in pages)


def test_the_site_fetches_nothing_and_its_search_works_from_the_disk():
    """The plugin `offline` would fetch its Worker for pages on the disk; the one of `docs/assets`
    replaces it."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert "\n  - offline\n" in text and "\n  font: false\n" in text
    named = re.findall(r"^extra\w*: .*?\[(.*?)\]", text, flags=re.MULTILINE)
    assert any("iframe-worker" in name for name in named)
    for name in named:
        assert "http" not in (ROOT / "docs" / name).read_text(encoding="utf-8")


def test_tables_of_the_reference_are_made_of_the_code():
    tables = runpy.run_path(str(ROOT / "tools" / "reference_tables.py"))["TABLES"]
    rows = {"settings": "metric.rounds", "findings": "light-order", "parameters": "_RIM_AGREED"}
    for name, make in tables.items():
        page = (ROOT / "docs" / "reference" / f"{name}.md").read_text(encoding="utf-8")
        assert page.endswith(f"<!-- {name} -->\n")
        assert f"\n| `{rows[name]}` | " in make()


def test_the_page_of_the_command_line_lists_every_verb():
    text = (ROOT / "docs" / "reference" / "command-line.md").read_text(encoding="utf-8")
    verbs = set(re.findall(r"^\| `splitknit (\w+)", text, flags=re.MULTILINE))
    assert verbs == set(VERBS)


def commands_of(page):
    """Arguments of every `splitknit` line in the blocks of a page, but for usages with brackets or
    alternatives."""
    blocks = re.findall(r"```[a-z]*\n(.*?)```", page, flags=re.DOTALL)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    commands = [re.match(r"\s*(?:\$ )?(?:\.venv/bin/)?splitknit (.*)", line) for line in lines]
    words = [shlex.split(line[1], comments=True) for line in commands if line]
    cut = [
        list(itertools.takewhile(lambda word: word not in {"|", ">", "&&", ";"}, line))
        for line in words
    ]
    return [line for line in cut if not any(word.startswith("[") or "|" in word for word in line)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_commands_on_the_pages_are_understood(page):
    app = build_app()
    for line in commands_of(page.read_text(encoding="utf-8")):
        words = [
            word
            for word in line
            if word not in ("--help", "--json", "--exit-code", "--group-readable")
        ]
        if words:
            app.parse_args(words)


def test_commands_are_found_on_a_page():
    page = (
        "```sh\n.venv/bin/splitknit match a \\\n  b  # alike?\nsplitknit rig cad"
        " [--below]\n```\n`splitknit demo`"
    )
    assert commands_of(page) == [["match", "a", "b"]]


FENCE = re.compile(
    r"(?:<!-- ([^\n]+?) -->\n)?^```(\w*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE
)
"""A fenced block: the mark above it, its language, its text."""
VARIES = re.compile(r"(?<=preset metric in )[\d.]+(?= s)|[\d.]+(?= ms each)")
"""Times differ from machine to machine, but for those of the simulated device."""
MAKE = """#!/bin/sh
test "$1" = install || exec .venv/bin/splitknit "$1" --out "$1"
"""
"""What `make` does on the pages, without making an environment: extras are those of the environment
at hand."""


def work_through(page, folder):
    """Do in `folder` what a page says, from top to bottom; return the lines that it promises and
    that did not come.

    `sh` blocks run, but for those marked `by hand`; `python` blocks and those without language are
    files where a mark names one (`file NAME`). Else a `python` block runs and prints what its last
    comment says, and a block without language has lines of the output of the commands above it: all
    that are quoted, in their order, `...` for what is left out. `needs NAME` skips the rest of the
    section where `shared/data/NAME` or the module is not at hand.
    """
    programs = folder / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name, text in (
        ("make", MAKE),
        ("splitknit", f'#!/bin/sh\nexec {sys.executable} -m splitknit "$@"\n'),
        ("python", f'#!/bin/sh\nexec {sys.executable} "$@"\n'),
    ):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    environment = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}", "MPLBACKEND": "agg"}
    for part in ("packages", "hardware"):
        (folder / part).symlink_to(ROOT / part)
    data = Path(os.environ.get("SPLITKNIT_DATA", ROOT.parent / "shared" / "data"))
    output, missing = "", []
    for section in re.split(r"^(?=## )", page.read_text(encoding="utf-8"), flags=re.MULTILINE):
        for mark, language, text in FENCE.findall(section):
            kind, _, name = mark.partition(" ")
            if kind == "needs":
                if not ((data / name).is_dir() or importlib.util.find_spec(name)):
                    break
                if (data / name).is_dir():
                    (folder / name).symlink_to(data / name)
            elif kind == "file":
                (folder / name).write_text(text)
                continue
            if language in ("sh", "python") and mark != "by hand":
                command = (
                    ["bash", "-euc", text] if language == "sh" else [sys.executable, "-c", text]
                )
                done = subprocess.run(
                    command,
                    cwd=folder,
                    env=environment,
                    capture_output=True,
                    text=True,
                    check=False,
                )
                output = done.stdout + done.stderr
                if done.returncode != 0:
                    return [*missing, f"{text}\n  ends with {done.returncode}\n{output}"]
            promised = (
                text.splitlines() if not language else re.findall(r"print\(.*\)  # (.*)", text)
            )
            left = iter(VARIES.sub("", output).splitlines())
            for line in promised:
                words = [re.escape(part) for part in VARIES.sub("", line).split("...")]
                if not any(re.fullmatch(".*".join(words), came) for came in left):
                    missing.append(f"{line}\n  is not in (from there on)\n{output}")
                    break
    return missing


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "page",
    [
        ROOT / "README.md",
        *sorted(ROOT.glob("packages/*/README.md")),
        *sorted(ROOT.glob("docs/guide/tutorial-*.md")),
        ROOT / "docs/guide/batch.md",
    ],
    ids=lambda page: f"{page.parent.name}/{page.stem}",
)
def test_what_the_page_promises_comes(page, tmp_path):
    missing = work_through(page, tmp_path)
    assert missing == [], "\n".join(missing)


def test_a_promise_that_is_not_kept_is_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "<!-- file a/b.txt -->\n```\n1\n```\n```sh\necho one; echo two in 3.1 ms each; echo"
        " three\n```\n```\none\ntwo in 9 ms each\n...ree\n```\n```\nthree\none\n```\n<!-- by hand"
        " -->\n```sh\nfalse\n```\n```python\nprint(1 + 1)  # 3\n```\n## Next\n<!-- needs"
        " no_such_module -->\n```sh\nfalse\n```\n## Last\n```sh\nexit 3\n```\n```\nnever\n```\n"
    )
    (tmp_path / "work" / "a").mkdir(parents=True)
    missing = work_through(page, tmp_path / "work")
    assert [line.splitlines()[0] for line in missing] == ["one", "3", "exit 3"]
    assert (tmp_path / "work" / "a" / "b.txt").read_text() == "1\n"


def test_the_figures_of_the_readme_are_those_of_the_experiments():
    """Figures with intervals stand on a page of the experiments, those of any other row together on
    a line there."""
    pages = "\n".join(
        page.read_text(encoding="utf-8") for page in ROOT.glob("docs/experiments/*.md")
    )
    pages, lines = pages.replace("100.0", "100"), pages.splitlines()
    readme = (
        (ROOT / "README.md")
        .read_text(encoding="utf-8")
        .partition("## Results")[2]
        .partition("\n## ")[0]
    )
    rows = [line for line in readme.splitlines() if re.match(r"\|.*\d\.\d", line)]
    assert len(rows) >= 3
    for row in rows:
        figures = re.findall(r"[\d.]+ \[[\d., ]+\]", row.replace("100.0", "100"))
        assert [figure for figure in figures if figure not in pages] == []
        numbers = [number.strip("|, ") for number in re.findall(r"[|,] [\d.]+(?=[ ,])", row)]
        assert figures or any(set(numbers) <= set(re.findall(r"[\d.]+", line)) for line in lines), (
            row
        )


def faults_of_claim(row, page):
    """What a row of the claims' table states that is not so: verdict, page with its intervals,
    script and options."""
    number, verdict, again = row["number"], row["verdict"], row["again"]
    measured = "; ".join(row[name] for name in ("measured", "beside"))
    words = ("confirmed", "refuted", "consistent", "equal", "undecided")
    faults = [] if verdict.split()[0] in words else [f"no verdict: {verdict}"]
    faults += [f"no {name}" for name in ("section", "claim", "criterion", "why") if not row[name]]
    targets = [target.partition("#")[0] for target in row["page"].split()]
    pages = [(page.parent / target).read_text(encoding="utf-8") for target in targets]
    texts = " ".join("".join(pages).replace("**", "").split())
    stated = re.findall(
        r"[+-]?[\d.]+ \[[^\]]+\](?: \([^)\]]*\))?|[\d.]+ \([\d.]+(?: to |-)[\d.]+\)", measured
    )
    faults += [] if targets else ["no page"]
    faults += [
        f"not on the page: {figure}"
        for figure in stated
        if re.sub(r" \([^\d+-].*", "", figure) not in texts
    ]
    scripts = re.findall(r"((?:validation|benchmarks|training)/[\w/]+\.py)(.*)", again)
    faults += [] if scripts or "](" in again else [f"no command: {again}"]
    for script, arguments in scripts:
        source = (ROOT / script).read_text(encoding="utf-8") if (ROOT / script).is_file() else ""
        named = [word for word in arguments.split() if not word.isupper() and not word.isdecimal()]
        faults += [] if source else [f"no such script: {script}"]
        faults += [
            f"{script} does not know {word}"
            for word in named
            if not re.search(rf"['\"]{word}['\"]" if word[0] == "-" else rf"\b{word}\b", source)
        ]
    return [f"claim {number}: {fault}" for fault in faults]


def test_the_claims_stand_on_their_pages_and_their_commands_exist():
    script = runpy.run_path(str(ROOT / "tools" / "make_claims_page.py"))
    page, rows = script["PAGE"], script["read"]()
    numbers = [int(row["number"].rstrip("abcdef")) for row in rows]
    assert list(dict.fromkeys(numbers)) == list(range(1, 52)) and numbers == sorted(numbers)
    lines = re.findall(r"^\|(\d.*)\|$", page.read_text("utf-8"), re.MULTILINE)
    on_page = [line.split("|") for line in lines]
    assert [cells[0] for cells in on_page] == [row["number"] for row in rows]
    assert all(len(cells) == 6 and all(cells) for cells in on_page), "one criterion a row"
    assert [fault for row in rows for fault in faults_of_claim(row, page)] == []
    row = {
        **rows[0],
        "measured": "99.9 [1.2, 3.4]",
        "beside": "",
        "page": "conditions.md#motion",
        "verdict": "perhaps",
        "again": "validation/motion/run.py --never",
    }
    assert len(faults_of_claim(row, page)) == 3
    row.update(page="", again="validation/motion/walk.py --never")
    assert len(faults_of_claim(row, page)) == 5


def test_verdicts_follow_from_the_interval_and_the_page_is_made_of_the_table():
    script = runpy.run_path(str(ROOT / "tools" / "make_claims_page.py"))
    assert script["PAGE"].read_text(encoding="utf-8") == script["page"](), (
        "run tools/make_claims_page.py"
    )
    assert (
        script["joined"]("-0.3 [-3.0, +1.5] (-2.0, +1.9); 2 [1, 3]")
        == "-0.3 [-3.0, +1.9]; 2 [1, 3]"
    )
    rules = {
        ("> 0", "+1.0 [+0.4, +1.5] (+0.1, +2.0)"): "confirmed",
        ("> 0", "+1.0 [+0.4, +1.5] (-0.1, +2.0)"): "undecided",
        ("> 0 ~ 2", "+1.0 [+0.4, +1.5] (-0.1, +2.0)"): "equal within 2",
        ("> 0 ~ 2", "+1.0 [+0.4, +1.5] (-0.1, +2.1)"): "undecided",
        ("> 0 ~ 2", "0.0 [0.0, 0.0] (0.0, 0.0)", "170"): "equal within 1.8",
        ("> 0 ~ 2", "0.0 [0.0, 0.0] (0.0, 0.0)", "40"): "undecided",
        ("= 2", "0.0 [0.0, 0.0] (0.0, 0.0)", "170"): "refuted",
        ("< 0 ~ 1", "+0.000 [+0.000, +0.000]"): "equal within 0.0005",
        ("< 0", "+1.0 [+0.4, +1.5]"): "refuted",
        ("= 95", "91 [86, 94.9]"): "refuted",
        ("= 95", "91 [86, 95.0]"): "consistent",
        ("= 19 21", "20.6 exactly"): "confirmed",
        ("= 19 21", "20.6 [18, 20.8]"): "undecided",
        ("> 1.4 2.5", "2.6 (2.0 to 3.0)"): "undecided",
        ("> 40", "28.3 exactly"): "refuted",
        ("", "not measured"): "undecided",
    }
    assert {case: script["verdict"](*case) for case in rules} == rules


def test_the_sums_of_the_rigs_checklist_are_right():
    text = (ROOT / "docs" / "guide" / "rig-checklist.md").read_text(encoding="utf-8")
    order = text.partition("## Order")[2].partition("## Print")[0]
    prices = [
        (int(low), int(high))
        for low, high in re.findall(r"\| (\d+) to (\d+) \|$", order, flags=re.MULTILINE)
    ]
    low, high = (sum(column) for column in zip(*prices[:-1], strict=True))  # without the mirrors
    assert f"| **{low} to {high}** |" in order and f"cost {low} to {high} EUR" in text
    build = (ROOT / "docs" / "guide" / "rig-build.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| [\w ]+ \|[^|]* x [^|]*\| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$",
        build,
        flags=re.MULTILINE,
    )
    assert len(rows) == 7
    for mass, *hours in rows:
        for hour, rate in zip(hours, (5, 12), strict=True):
            assert abs(float(mass) / 1.24 / rate / 3.6 - float(hour)) < 0.1, mass
    total = re.findall(r"\*\*([\d.]+)\*\*", build)
    assert len(total) == 3
    for column, value in enumerate(total):
        assert abs(sum(float(row[column]) for row in rows) - float(value)) < 0.11, total


def test_captures_by_hand_are_read(tmp_path):
    text = (ROOT / "docs" / "reference" / "capture-format.md").read_text(encoding="utf-8")
    examples = re.findall(r"<!-- example (\S+) -->\n```json\n(.*?)```", text, flags=re.DOTALL)
    rigs = [body for name, body in examples if name == "rig.json"]
    captures = [body for name, body in examples if name == "capture.json"]
    assert len(rigs) == len(captures) == 1
    rows, columns = json.loads(rigs[0])["camera"]["image_size"]
    grey = np.tile(np.linspace(20, 200, columns).astype(np.uint8)[None, :, None], (rows, 1, 3))
    for k, name in enumerate(("a", "b", "c", "d")):
        write_image(tmp_path / f"{name}.png", grey + np.uint8(k))
    write_image(tmp_path / "dark.png", np.full_like(grey, 5))
    write_image(tmp_path / "mask.png", np.full((rows, columns), 255, dtype=np.uint8))
    (tmp_path / "rig.json").write_text(rigs[0])
    (tmp_path / "capture.json").write_text(captures[0])
    capture = splitknit.read_capture(tmp_path)
    assert len(capture.bands["white"].leds) == 4
    assert capture.bands["white"].exposure.tolist() == pytest.approx([0.02, 0.02, 0.04, 0.04])
    assert capture.tip_direction_deg == 20


@pytest.mark.parametrize(
    "name",
    [
        "pipeline.reconstruct",
        "methods.thesis.ea",
        "methods.thesis.snk",
        "methods.metric.metric_opaque",
        "methods.metric.metric_skin",
    ],
)
def test_the_architecture_page_quotes_the_algorithm(name):
    """Every line of the functions, docstrings left out, in a block of the page."""
    module, _, function = name.rpartition(".")
    source = inspect.getsource(getattr(importlib.import_module(f"splitknit.{module}"), function))
    lines = source.rstrip().split("\n")
    words = ast.parse("\n".join(lines)).body[0].body[0]
    code = "\n".join(lines[: words.lineno - 1] + lines[words.end_lineno :])
    page = (ROOT / "docs" / "explain" / "architecture.md").read_text(encoding="utf-8")
    assert f"```python\n{code}\n```" in page, (
        f"docs/explain/architecture.md does not quote {name} as it is"
    )
