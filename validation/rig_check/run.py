"""Does the acceptance test pass sound rigs, and name what is wrong with others?

    python validation/rig_check/run.py                      # 30 sound rigs, one with each defect
    python validation/rig_check/run.py --new                # the new defects, alone and in pairs
    python validation/rig_check/run.py --faulty 3001:3006 --defects "focus 6 mm off"
    python validation/rig_check/run.py --sound 100:110 --faulty 100:102 --out /tmp/chosen.csv

Card, ball, phantom and finger are rendered with twins as people build them (:mod:`twins`), and
judged as `splitknit rig check` does. Limits were chosen on seeds from 100 on; seeds from 1000 on
were looked at when questions were changed; reported seeds begin at 3000. A row of the table is a
question of one rig. A run that was interrupted continues: rigs in the table are not tested again.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from twins import (  # noqa: E402
    BEHIND_FILMS,
    DEFECTS,
    NEW,
    PAIRS,
    Twin,
    behind_films,
    defective,
    twin,
)

from splitknit.io.csv_table import csv_text  # noqa: E402
from splitknit_rig.acceptance.questions import (  # noqa: E402
    Answer,
    answers_of_ball,
    answers_of_card,
    answers_of_finger,
    answers_of_phantom,
    answers_of_sensor,
)
from splitknit_rig.calibration.card_model import CardPlane  # noqa: E402
from splitknit_rig.calibration.radiometry_folder import base_tilt_deg  # noqa: E402

SOUND, WITH_FILMS = "sound", "sound, with films"
TABLES = HERE / "tables"


def judged(rig: Twin, fingers: dict[Any, tuple[Any, list[Answer]]]) -> list[Answer]:
    """All answers of a twin; those of a finger that an earlier one had too are kept in
    `fingers`."""
    card, ball, phantom, series = rig.bench()
    plane = CardPlane(0.0, base_tilt_deg(rig.file))
    answers = answers_of_sensor(card, *series) + answers_of_card(card, rig.file, plane)
    answers += answers_of_ball(ball, rig.file, 16.0) + answers_of_phantom(phantom)
    parts = (rig.finger, rig.file, rig.films)
    same = (*map(id, parts), rig.store, rig.exposure, rig.moving_mm, rig.flicker)
    if same not in fingers:
        fingers[same] = parts, answers_of_finger(*rig.fingers())  # parts: so that ids stay theirs
    return answers + fingers[same][1]


def rows_of(seed: int, rigs: Sequence[str]) -> list[dict[str, Any]]:
    """Answers of a twin: sound, with films, with a defect or with two."""
    sound = twin(seed)
    rows: list[dict[str, Any]] = []
    fingers: dict[Any, tuple[Any, list[Answer]]] = {}
    with_films = {WITH_FILMS, BEHIND_FILMS} & {*rigs}
    films = replace(sound, films=behind_films(sound)) if with_films else sound
    for name in rigs:
        rig = films if name in (WITH_FILMS, BEHIND_FILMS) else sound
        if name not in (SOUND, WITH_FILMS):
            rig = defective(rig, name)
        print(f"seed {seed}: {name}", file=sys.stderr, flush=True)
        for answer in judged(rig, fingers):
            rows.append(
                {
                    "seed": seed,
                    "rig": name,
                    "question": answer.question,
                    "measured": "" if answer.measured is None else answer.measured,
                    "limit": answer.limit,
                    "passed": int(answer.passed),
                    "note": answer.note,
                }
            )
    return rows


def names(rows: Sequence[dict[str, Any]], name: str) -> bool:
    """Whether, of a rig with one or two new defects, each is named by a question of its own."""
    failed = [row["question"] for row in rows if not int(row["passed"])]
    parts = name.split(" + ")
    return all(any(q.startswith(NEW[part][1]) for q in failed) for part in parts)


def summary(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """A line for each kind of rig: rigs, how many failed, and the questions that failed."""
    lines = [["rig", "rigs", "failed", "named", "questions that failed (rigs)"]]
    for name in dict.fromkeys(row["rig"] for row in rows):
        own = [row for row in rows if row["rig"] == name]
        failed = [row for row in own if not int(row["passed"])]
        counts = {q: sum(r["question"] == q for r in failed) for q in (r["question"] for r in own)}
        questions = "; ".join(f"{q} ({n})" for q, n in counts.items() if n)
        seeds = {row["seed"] for row in own}
        named = ""
        if name.split(" + ")[0] in NEW:
            of_rigs = [[row for row in own if row["seed"] == seed] for seed in seeds]
            named = str(sum(names(each, name) for each in of_rigs))
        fails = len({row["seed"] for row in failed})
        lines.append([name, str(len(seeds)), str(fails), named, questions])
    return lines


def _seeds(text: str) -> range:
    first, last = text.split(":")
    return range(int(first), int(last))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sound", type=_seeds, default=range(3000, 3030), help="seeds, FIRST:END")
    parser.add_argument("--faulty", type=_seeds, default=range(3000, 3001), help="seeds, FIRST:END")
    parser.add_argument("--defects", nargs="+", help="only these")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=TABLES / "answers.csv")
    parser.add_argument("--new", action="store_true", help="new defects and pairs, in new.csv")
    chosen = parser.parse_args(arguments)
    if chosen.new:
        chosen.out = chosen.out.with_name("new.csv")
    defects = [WITH_FILMS, *DEFECTS]
    if chosen.new:
        defects = [*NEW, *map(" + ".join, PAIRS)]
    defects = chosen.defects or defects
    rows: list[dict[str, Any]] = []
    if chosen.out.is_file():
        with chosen.out.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if "note" in row]  # else of older questions
    done = {(int(row["seed"]), row["rig"]) for row in rows}
    waiting = [(seed, SOUND) for seed in chosen.sound if not chosen.new]
    waiting += [(seed, name) for seed in chosen.faulty for name in defects]
    waiting = [each for each in waiting if each not in done]
    groups = [waiting[k : k + 6] for k in range(0, len(waiting), 6)]
    groups = [
        [each for each in group if each[0] == seed] for group in groups for seed in dict(group)
    ]
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(chosen.workers) as pool:
        seeds = [group[0][0] for group in groups]
        of_seeds = [[name for _, name in group] for group in groups]
        for own_rows in pool.map(rows_of, seeds, of_seeds):
            rows += own_rows
            table = csv_text([rows[0], *(row.values() for row in rows)])
            chosen.out.write_text(table, encoding="utf-8")
    lines = summary(rows)
    of_rigs = chosen.out.with_stem(f"{chosen.out.stem}_summary")
    of_rigs.write_text(csv_text(lines), encoding="utf-8")
    for line in lines:
        print("  ".join(line))
    return 0


if __name__ == "__main__":
    sys.exit(main())
