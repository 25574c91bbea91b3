"""Minutiae by the phase of the ridges against mindtct's: how many of the true ones, and how fingers are separated.

    python validation/prints/phase.py POPULATION STORE      # writes phase.json beside this file

The same 40 fingers, prints of `metric` and judging as in ``agreement.py``; the least quality of a minutia was chosen on
the two other people there. A capture's record is kept in ``--scratch``, so that a stopped run goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from agreement import FINGERS, REPORTED
from agreement_compare import agreed, counts
from agreement_measure import Surfaces, against_truth
from agreement_scores import told_apart
from agreement_summary import MARGIN_PX
from agreement_truth import read_truth

from splitknit_match.matching.minutiae import extract
from splitknit_match.prints.make import enhance, make_print
from splitknit_match.prints.phase_minutiae import by_phase

HERE = Path(__file__).resolve().parent
OUT = HERE / "phase.json"
METHODS = ("relief", "unroll")


def record(population: Path, surfaces: Surfaces, subject: str, session: int, finger: str) -> dict[str, Any] | None:
    """Minutiae of one capture by both ways; None where there is no surface."""
    source = surfaces.source("metric", f"{subject}/session_{session}/{finger}")
    if source is None:
        return None
    truth = read_truth(population, subject, session, finger)
    rows: dict[str, Any] = {}
    for method in METHODS:
        made = make_print(source, method)
        better = enhance(made, 500.0)
        rows[method] = {
            "mindtct": against_truth(extract(made.image), made, truth),
            "phase": against_truth(by_phase(made.image, better), made, truth),
        }
    return rows


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("population", type=Path)
    parser.add_argument("store", type=Path)
    parser.add_argument("--fingers", type=int, default=len(REPORTED) * len(FINGERS))
    parser.add_argument("--scratch", type=Path, default=Path(tempfile.gettempdir()) / "splitknit-phase")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    options.scratch.mkdir(parents=True, exist_ok=True)
    surfaces = Surfaces(options.store)
    found: dict[int, dict[str, Any]] = {1: {}, 2: {}}
    for subject, finger in [(s, f) for s in REPORTED for f in FINGERS][: options.fingers]:
        for session, rows_of_session in found.items():
            file = options.scratch / f"{session}-{subject}-{finger}.json"
            if not file.is_file():
                row = record(options.population, surfaces, subject, session, finger)
                file.write_text(json.dumps(row), encoding="ascii")
            row = json.loads(file.read_text(encoding="ascii"))
            if row is not None:
                rows_of_session[f"{subject} {finger}"] = row
    facts: dict[str, Any] = {"fingers": len(found[1])}
    for method in METHODS:
        for way in ("mindtct", "phase"):
            rows = [row[method][way] for row in found[1].values()]
            facts[f"{method} {way}"] = {
                **agreed([counts(row, MARGIN_PX) for row in rows]),
                "below_60_deg": agreed([counts(row, MARGIN_PX, (0.0, 60.0)) for row in rows]),
                "minutiae_median": float(np.median([len(row["found_hit"]) for row in rows])),
                "bozorth3": told_apart(found[1], found[2], (method, way), (method, way)),
            }
    options.out.write_text(json.dumps(facts, indent=1) + "\n", encoding="ascii")
    for name, row in facts.items():
        print(name, row if name == "fingers" else {key: row[key] for key in ("recall", "precision")})


if __name__ == "__main__":
    main()
