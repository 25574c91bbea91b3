"""How far prints can be trusted: true minutiae in the prints, their quality, and how bozorth3 separates fingers.

    python validation/prints/agreement.py POPULATION STORE --scratch FOLDER      # measure (resumes), then sum up
    python validation/prints/agreement.py --summary --scratch FOLDER             # sum up what there is

POPULATION is a folder of ``splitknit simulate population`` (here: seed 680, scale 0.4), STORE one of ``splitknit
batch`` with its reconstructions. Reported are fingers of the first ten people; where a threshold was chosen, on two
others (:data:`CHOOSING`). Every capture and preset is one file in the scratch folder, so a run may be stopped at any
time. The results are in ``agreement.json``.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
from agreement_measure import Surfaces, capture_record, pressed_record
from agreement_summary import summary
from agreement_truth import read_truth

HERE = Path(__file__).resolve().parent
OUT = HERE / "agreement.json"
VERSION = 3
"""Of what is kept; it rises when the measurement changes."""
FINGERS = ("right_index", "left_thumb", "right_ring", "left_middle")
REPORTED = tuple(f"S{k:02d}" for k in range(1, 11))
CHOOSING = ("S11", "S12")
PRESS_SEED = 1
PARTS = (
    ("metric", 1), ("truth", 1), ("metric", 2), ("pressed", 1), ("choosing", 1), ("snk", 1), ("pr-split", 1),
    ("ea-split", 1), ("snk", 2), ("pr-split", 2), ("ea-split", 2),
)  # fmt: skip
"""Presets and sessions, the most important first; ``pressed`` has a seed in the session's place, ``choosing`` is
``metric`` of the two others."""


def jobs(fingers: int, parts: list[str] | None) -> Iterator[tuple[str, int, str, str]]:
    """Preset, session, subject, finger."""
    chosen = [(s, f) for s in REPORTED for f in FINGERS][:fingers]
    others = [(s, f) for s in CHOOSING for f in FINGERS]
    for preset, session in PARTS:
        people = others if preset == "choosing" else chosen
        if parts is None or f"{preset}{session}" in parts:
            for subject, finger in people:
                yield "metric" if preset == "choosing" else preset, session, subject, finger


def measure(population: Path, store: Path, scratch: Path, fingers: int, parts: list[str] | None) -> int:
    """Measure what is not there yet; return how many captures the store lacked."""
    surfaces, lacking = Surfaces(store), 0
    scratch.mkdir(parents=True, exist_ok=True)
    for preset, session, subject, finger in jobs(fingers, parts):
        file = record_file(scratch, preset, session, subject, finger)
        if file.is_file():
            continue
        if preset == "pressed":
            record = pressed_record(population, subject, finger, PRESS_SEED)
        else:
            truth = read_truth(population, subject, session, finger)
            record = capture_record(population, surfaces, truth, (subject, session, finger), preset)
        if record is None:
            lacking += 1
            continue
        partial = file.with_suffix(f".{os.getpid()}.tmp")
        partial.write_text(json.dumps(record), encoding="ascii")
        partial.replace(file)
        print(file.name, flush=True)
    return lacking


def record_file(scratch: Path, preset: str, session: int, subject: str, finger: str) -> Path:
    """Where one capture's record is kept."""
    return scratch / f"v{VERSION}-{preset}-{session}-{subject}-{finger}.json"


def records(scratch: Path, people: tuple[str, ...]) -> dict[tuple[str, int], dict[str, Any]]:
    """Records by preset and session, then by finger, in order."""
    found: dict[tuple[str, int], dict[str, Any]] = {}
    for preset, session in PARTS:
        for subject in people:
            for finger in FINGERS:
                file = record_file(scratch, preset, session, subject, finger)
                if file.is_file():
                    row = json.loads(file.read_text(encoding="ascii"))
                    found.setdefault((preset, session), {})[f"{subject} {finger}"] = row
    return found


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("population", nargs="?", type=Path)
    parser.add_argument("store", nargs="?", type=Path)
    parser.add_argument("--scratch", type=Path, required=True)
    parser.add_argument("--fingers", type=int, default=len(REPORTED) * len(FINGERS))
    parser.add_argument("--parts", nargs="+", help="of " + " ".join(f"{p}{s}" for p, s in PARTS))
    parser.add_argument("--summary", action="store_true", help="measure nothing")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    if not options.summary:
        if options.population is None or options.store is None:
            parser.error("name the population and the store, or --summary.")
        lacking = measure(options.population, options.store, options.scratch, options.fingers, options.parts)
        if lacking:
            print(f"{lacking} captures are not in the store yet; run the same again later")
    facts = {
        "population": {"seed": 680, "scale": 0.4, "people": list(REPORTED), "fingers": list(FINGERS)},
        "chosen_on": list(CHOOSING),
        **summary(records(options.scratch, REPORTED), records(options.scratch, CHOOSING)),
    }
    options.out.write_text(json.dumps(facts, indent=1, allow_nan=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
