"""The thesis's experiments, tables and figures, made again in one folder, with one page that shows
his beside ours.

    python validation/thesis/reproduce.py --out DIR  # as the thesis: 17 people, ten fingers
    python validation/thesis/reproduce.py --out DIR --people 3 --sessions 2  # 10 minutes of one core
    python validation/thesis/reproduce.py --out DIR --figures 5.4,5.5     # what these figures need
    python validation/thesis/reproduce.py --out DIR --scheduler tls://HOST:8786  # on a cluster

It states time and disk before it begins, may be stopped at any moment, and goes on with the same
command, or with fewer people: what was made beyond them stays, and what was compared counts.
Everything is written below DIR; ``DIR/index.html`` is the page. Fewer than ten people show the
fingers of the right hand; fewer than three have too few impostors for a rate.
"""

from __future__ import annotations

import argparse
import html
import json
import os
import shlex
import shutil
import string
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT / "tools"))

import run as parts  # noqa: E402
from claims import AVERAGED, CLAIMS, SINGLE, cell  # noqa: E402
from make_claims_page import counted, criterion, shown, verdict  # noqa: E402

from report import read  # noqa: E402
from splitknit.io.enrolment import PLAN_FILE, fingers_named  # noqa: E402

CASES = ("snk", "pr", "ea", "ea-split", "metric")
RIGHT_HAND = "right_thumb,right_index,right_middle,right_ring,right_little"
SEED = 3170

SIMULATE_S = 3.4  # processor time of a capture at scale 0.4, `docs/experiments/simulator.md`
RECONSTRUCT_S = 11.0  # of a capture in all cases
COMPARE_S = 0.28  # of a pair in all cases, three attributes each
SPECTRA_S = 30.0  # of a capture of the part `figures`
CAPTURE_MB = 18.0


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure or table of the thesis."""

    number: str
    shows: str
    thesis: str  # what it states in numbers
    claims: tuple[str, ...]
    part: str  # of `run.py`, or `steps` of one capture, made here; else `command` makes it
    pictures: tuple[str, ...]  # that the part writes, or tables of the repository
    command: str


FIGURES = HERE / "tables" / "reproduced.csv"
"""The thesis's figures that state or show a result; the others are diagrams and photographs of
parts."""


@dataclass(frozen=True, slots=True)
class Size:
    """How much is made."""

    people: int
    sessions: int
    fingers: str

    @property
    def captures(self) -> int:
        """Of all people."""
        return self.people * self.sessions * self._fingers

    @property
    def _fingers(self) -> int:
        return len(self.fingers.split(",")) if self.fingers else 10

    @property
    def pairs(self) -> int:
        """Comparisons of each earlier with each later session."""
        return self.sessions * (self.sessions - 1) // 2 * (self.people * self._fingers) ** 2

    def seconds(self, examined: int) -> float:
        """Processor time; `examined`: captures of the part ``figures``."""
        return (
            self.captures * (SIMULATE_S + RECONSTRUCT_S)
            + self.pairs * COMPARE_S
            + examined * SPECTRA_S
        )

    def words(self, examined: int, jobs: int) -> str:
        """What is stated before anything is made."""
        hours = self.seconds(examined) / jobs / 3600
        time_needed = f"{60 * hours:.0f} minutes" if hours < 2 else f"{hours:.0f} hours"
        return (
            f"{self.captures} captures, {self.pairs:,} comparisons in {len(CASES)} cases: about"
            f" {time_needed} on {jobs} cores, {self.captures * CAPTURE_MB / 1000:.1f} GB on disk."
        )


ONE_FINGER = Size(1, 1, "right_index")
"""Whose steps before photometric stereo are shown."""


def main(arguments: Sequence[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    wanted = chosen_figures(options.figures)
    named = (
        options.fingers
        if options.fingers is not None
        else ("" if options.people >= 10 else RIGHT_HAND)
    )
    needed = [
        name
        for name in ("steps", "cases", "fusion", "figures")
        if any(figure.part == name for figure in wanted)
    ]
    size = Size(options.people, options.sessions, named)
    if needed == ["steps"]:
        size = ONE_FINGER
    examined = (
        min(options.captures, 2 * size.people, size.captures // size.sessions)
        if "figures" in needed
        else 0
    )
    if not needed:
        print("Nothing is made: these figures have commands of their own.")
    elif needed == ["steps"]:
        print("One capture, reconstructed once: a minute.")
    else:
        print(size.words(examined, options.jobs))
    if options.dry_run:
        return 0
    if needed and not find_spec("matplotlib"):
        raise SystemExit("figures need matplotlib: run make install EXTRAS=plot first.")
    plan_anew(options.out / "people", size)
    started = time.perf_counter()
    if needed:
        for k, step in enumerate(steps := list(_steps(options, size, needed, examined))):
            print(f"[{k + 1} of {len(steps)}] {' '.join(map(shlex.quote, step))}", flush=True)
            _do(step)
    options.out.mkdir(parents=True, exist_ok=True)
    page = options.out / "index.html"
    page.write_text(page_of(options.out, wanted, size), encoding="utf-8")
    print(f"{time.perf_counter() - started:.0f} seconds. Open {page} in a browser.")
    return 0


def plan_anew(people: Path, size: Size) -> None:
    """Plan what is wanted now where an earlier run planned more: a plan may grow, but not shrink by
    itself."""
    file = people / PLAN_FILE
    if file.is_file():
        fingers = fingers_named(size.fingers or "all")
        plan = json.loads(file.read_text(encoding="utf-8"))
        plan |= {"subjects": size.people, "sessions": size.sessions, "fingers": fingers}
        file.write_text(json.dumps(plan, indent=1), encoding="utf-8")


def chosen_figures(names: str | None) -> list[Figure]:
    """Figures by number, all where None; an unknown number ends the program."""
    known = {
        row["figure"]: Figure(
            row["figure"],
            row["shows"],
            row["thesis"],
            tuple(row["claims"].split()),
            row["part"],
            tuple(row["pictures"].split()),
            row["command"],
        )
        for row in read(FIGURES)
    }
    if names is None:
        return list(known.values())
    unknown = [name for name in names.split(",") if name not in known]
    if unknown:
        raise SystemExit(f"no figure {', '.join(unknown)}; there are {', '.join(known)}.")
    return [known[name] for name in names.split(",")]


def _steps(
    options: argparse.Namespace, size: Size, needed: Sequence[str], examined: int
) -> Iterator[list[str]]:
    """The commands, each of which goes on where it was stopped."""
    out, python = shlex.quote(str(options.out)), shlex.quote(sys.executable)
    verb = f"{python} -m splitknit"
    if "steps" in needed:
        yield _simulation(options, verb, f"{out}/finger", ONE_FINGER)
        capture = f"{out}/finger/S01/session_1/{ONE_FINGER.fingers}"
        yield shlex.split(
            f"{verb} reconstruct {capture} --preset snk --keep-steps --out {out}/steps"
        )
    if needed == ["steps"]:
        return
    yield _simulation(options, verb, f"{out}/people", size)
    cluster = f"--scheduler {options.scheduler}" if options.scheduler else f"--jobs {options.jobs}"
    yield shlex.split(
        f"{verb} batch {out}/people --out {out}/store --cases {','.join(CASES)} --matchers thesis"
        f" --impostors 1 --seed {SEED} {cluster}"
    )
    for part in (name for name in needed if name != "steps"):
        yield shlex.split(
            f"{python} {shlex.quote(str(HERE / 'run.py'))} {part} --population {out}/people"
            f" --store {out}/store --out {out}/tables --scratch {out}/scratch"
            f" --cases {' '.join(CASES)} --captures {examined} --jobs {options.jobs}"
        )


def _simulation(options: argparse.Namespace, verb: str, out: str, size: Size) -> list[str]:
    """The command that simulates a population of this size."""
    fingers = f"--fingers {size.fingers}" if size.fingers else ""
    return shlex.split(
        f"{verb} simulate population --out {out} --seed {SEED} --scale {options.scale}"
        f" --subjects {size.people} --sessions {size.sessions} {fingers}"
        f" --set sessions.partial_share=0 --workers {options.jobs}"
    )


def _do(step: Sequence[str]) -> None:
    if step[1].endswith("run.py"):
        options = parts.parse(step[2:])
        if parts.finished(options.out, options.part, parts.inputs_of(options, options.part)):
            print("is finished")
            return
    environment = {"OMP_NUM_THREADS": "1", **os.environ}
    done = subprocess.run(
        list(step), check=False, env=environment, cwd=ROOT if step[1] != "-m" else None
    )
    if done.returncode:
        raise SystemExit(done.returncode)


def page_of(out: Path, wanted: Sequence[Figure], size: Size) -> str:
    """HTML: one section a figure, his numbers beside ours, claims with their verdicts, and the
    command."""
    known = read(HERE / "tables" / "claims.csv")
    tables = {
        name: read(out / "tables" / f"{name}.csv")
        for name in ("cases", "cases_differences", "fusion", "figures")
    }
    sections = [_section(figure, out, known, tables) for figure in wanted]
    population = html.escape(f"{size.people} people, {size.captures} captures, simulated")
    his = [row for row in known if not row["qualifier"]]
    return PAGE.substitute(size=population, counted=counted(his), sections="\n".join(sections))


def _section(
    figure: Figure,
    out: Path,
    known: Sequence[Mapping[str, str]],
    tables: Mapping[str, Sequence[dict[str, str]]],
) -> str:
    rows = []
    for number in figure.claims:
        here: dict[str, str] = {}
        for words, judged in (("averaged", AVERAGED), ("single", SINGLE)):
            values = [
                f"{label}"
                f" {cell(tables[name], wanted | (judged if name != 'figures' else {}), what)}"
                for label, name, wanted, what in CLAIMS.get(int(number), ())
                if tables.get(name)
            ]
            here[words] = "; ".join(values)
        if here["single"] == here["averaged"]:
            here["single"] = ""
        for k, row in enumerate(row for row in known if row["number"].rstrip("abcdef") == number):
            this_run = (here["averaged"], here["single"]) if k == 0 else ("", "")
            judged = verdict(row["rule"], row["measured"], row["fingers"])
            qualified = ", ".join(filter(None, (judged, row["qualifier"])))
            published = (row["number"], row["claim"], criterion(row), shown(row), qualified)
            cells = (*published, *this_run)
            rows.append(
                "<tr>" + "".join(f"<td>{html.escape(text)}</td>" for text in cells) + "</tr>"
            )
    table = f"<table>{_HEAD}{''.join(rows)}</table>" if rows else ""
    pictures = "".join(_picture(out, name) for name in figure.pictures)
    command = (
        figure.command or f"validation/thesis/reproduce.py --out DIR --figures {figure.number}"
    )
    python = "" if command.startswith("splitknit") else "python "
    stated = f"<b>The thesis shows</b> {html.escape(figure.thesis)}."
    return (
        f"<section><h2>Figure {figure.number}:"
        f" {html.escape(figure.shows)}</h2><p>{stated}</p>{pictures}{table}"
        f"<pre>{html.escape(python + command)}</pre></section>"
    )


def _picture(out: Path, name: str) -> str:
    """A picture of this run, or a committed table; nothing where it was not made."""
    if name.endswith(".csv"):
        return _table(ROOT / name)
    capture = out / "finger" / "S01" / "session_1" / ONE_FINGER.fingers
    places = (
        *(out / "tables" / name, out / "steps" / "steps" / name, out / "steps" / name),
        capture / name,
    )
    file = next((place for place in places if place.is_file()), None)
    if file is None:
        return ""
    shutil.copyfile(file, out / name)
    return f'<img src="{name}" alt="{name}">'


def _table(file: Path) -> str:
    """A committed table: what was measured once, at its full size."""
    rows = read(file)[:TABLE_ROWS]
    if not rows:
        return ""
    lines = [list(rows[0]), *(list(row.values()) for row in rows)]
    cells = ("".join(f"<td>{html.escape(text)}</td>" for text in line) for line in lines)
    name = file.relative_to(ROOT).as_posix()
    return f"<p>{name}:</p><table><tr>{'</tr><tr>'.join(cells)}</tr></table>"


TABLE_ROWS = 15
"""Of a committed table that the page shows."""
_HEAD = (
    "<tr><th>#</th><th>claim</th><th>criterion</th><th>on the page of claims</th><th>verdict</th>"
    "<th>this run, gate and averages</th><th>this run, single</th></tr>"
)
PAGE = string.Template((HERE / "reproduce.html").read_text(encoding="utf-8"))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=lambda text: Path(text).resolve(), required=True)
    parser.add_argument("--people", type=int, default=17)
    parser.add_argument("--sessions", type=int, default=4)
    parser.add_argument(
        "--fingers",
        help="names with commas; default: all, of fewer than ten people the right hand's",
    )
    parser.add_argument("--figures", help="numbers with commas; default: all")
    parser.add_argument(
        "--captures",
        type=int,
        default=24,
        help="that the figures on spectra and surfaces examine, two a person at most",
    )
    parser.add_argument(
        "--scale", type=float, default=0.4, help="size of the images, 1 = the thesis's"
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--scheduler", help="of a cluster that reconstructs and compares")
    parser.add_argument("--dry-run", action="store_true", help="state time and disk, and end")
    return parser


if __name__ == "__main__":
    sys.exit(main())
