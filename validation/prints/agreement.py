"""How far prints can be trusted: true minutiae in the prints, their quality, and how bozorth3
separates fingers.

    python validation/prints/agreement.py POPULATION STORE --scratch FOLDER
    python validation/prints/agreement.py --summary --scratch FOLDER  # only sum up

POPULATION is a folder of ``splitknit simulate population`` (here: seed 680, scale 0.4), STORE one
of ``splitknit batch`` with its reconstructions. Reported are fingers of the first ten people. Every
capture and preset is one file in the scratch folder, so a run may be stopped at any time. The
results are in ``agreement.json``.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
from agreement_measure import Surfaces, capture_record
from agreement_summary import summary
from agreement_truth import read_truth

HERE = Path(__file__).resolve().parent
OUT = HERE / "agreement.json"
VERSION = 3
"""Of what is kept; it rises when the measurement changes."""
FINGERS = ("right_index", "left_thumb", "right_ring", "left_middle")
REPORTED = tuple(f"S{k:02d}" for k in range(1, 11))
PARTS = (
    ("metric", 1),
    ("truth", 1),
    ("metric", 2),
    ("snk", 1),
    ("pr-split", 1),
    ("ea-split", 1),
    ("snk", 2),
    ("pr-split", 2),
    ("ea-split", 2),
)
"""Presets and sessions, the most important first; ``truth`` is the true surface."""


def jobs(fingers: int) -> Iterator[tuple[str, int, str, str]]:
    """Preset, session, subject, finger."""
    chosen = [(subject, finger) for subject in REPORTED for finger in FINGERS][:fingers]
    yield from ((*part, *finger) for part in PARTS for finger in chosen)


def measure(population: Path, store: Path, scratch: Path, fingers: int) -> int:
    """Measure what is not there yet; return how many captures the store lacked."""
    surfaces = Surfaces(store)
    missing = 0
    scratch.mkdir(parents=True, exist_ok=True)
    for preset, session, subject, finger in jobs(fingers):
        file = record_file(scratch, preset, session, subject, finger)
        if file.is_file():
            continue
        truth = read_truth(population, subject, session, finger)
        record = capture_record(population, surfaces, truth, (subject, session, finger), preset)
        if record is None:
            missing += 1
            continue
        partial = file.with_suffix(f".{os.getpid()}.tmp")
        partial.write_text(json.dumps(record), encoding="ascii")
        partial.replace(file)
        print(file.name, flush=True)
    return missing


def record_file(scratch: Path, preset: str, session: int, subject: str, finger: str) -> Path:
    """Where one capture's record is kept."""
    return scratch / f"v{VERSION}-{preset}-{session}-{subject}-{finger}.json"


def records(scratch: Path) -> dict[tuple[str, int], dict[str, Any]]:
    """Records by preset and session, then by finger, in order."""
    by_part: dict[tuple[str, int], dict[str, Any]] = {}
    for preset, session in PARTS:
        for subject in REPORTED:
            for finger in FINGERS:
                file = record_file(scratch, preset, session, subject, finger)
                if file.is_file():
                    row = json.loads(file.read_text(encoding="ascii"))
                    by_part.setdefault((preset, session), {})[f"{subject} {finger}"] = row
    return by_part


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("population", nargs="?", type=Path)
    parser.add_argument("store", nargs="?", type=Path)
    parser.add_argument("--scratch", type=Path, required=True)
    parser.add_argument("--fingers", type=int, default=len(REPORTED) * len(FINGERS))
    parser.add_argument("--summary", action="store_true", help="measure nothing")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    if not options.summary:
        if options.population is None or options.store is None:
            parser.error("name the population and the store, or --summary.")
        missing = measure(options.population, options.store, options.scratch, options.fingers)
        if missing:
            print(f"{missing} captures are not in the store yet; run the same again later")
    facts = {
        "population": {
            "seed": 680,
            "scale": 0.4,
            "people": list(REPORTED),
            "fingers": list(FINGERS),
        },
        **summary(records(options.scratch)),
    }
    options.out.write_text(json.dumps(facts, indent=1, allow_nan=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
