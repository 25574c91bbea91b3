"""Real prints as ISO templates: error rates of a matcher of minutiae on what `splitknit export` makes of them.

    pip install 'splitknit-match[minutiae]'
    python validation/records/templates.py

writes ``templates.json`` beside this file: FVC2002 DB1_B (five fingers, eight presses each), exported to ISO 19794-2
with minutiae by phase and by mindtct; every pair compared by bozorth3. Intervals are 95 %, drawn by finger, of which
there are five. Minutiae by phase have no setting that was chosen with a look at these prints.
"""

from __future__ import annotations

import itertools
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.scores import Scores, ids_of
from splitknit_match.matching.minutiae import minutiae_match
from splitknit_match.matching.minutiae_record import Minutiae
from splitknit_match.prints.export import export_records
from splitknit_match.prints.export_job import ExportJob
from splitknit_match.prints.from_file import minutiae_of
from splitknit_match.records.minutiae_files import read_minutiae_record

HERE = Path(__file__).resolve().parent
FAR_0 = 1e-9
"""No impostor may be accepted."""


def rows(sides: list[Minutiae], others: list[Minutiae], owner: list[int]) -> dict[str, Any]:
    """Figures of all pairs, one of `sides` against one of `others`."""
    pairs = list(itertools.combinations(range(len(sides)), 2))
    score = np.array([minutiae_match(sides[i], others[j]) for i, j in pairs])
    ids = ids_of([owner[i] for i, _ in pairs], [owner[j] for _, j in pairs])
    scores = Scores(ids.same, score, finger=ids, name="templates")
    found = bootstrap(scores, "finger", BootstrapSettings(targets=(0.01, FAR_0), curve_points=0)).figures
    names = {"eer": "eer", "gar_at_far_1_percent": "gar@0.01", "gar_at_far_0": f"gar@{FAR_0:g}"}
    shown = {name: [round(float(v), 4) for v in (found[key].value, found[key].low, found[key].high)]
             for name, key in names.items()}  # fmt: skip
    return {"genuine": int(scores.genuine.size), "impostors": int(scores.impostor.size), **shown}


def main() -> None:
    """Run."""
    folder = Path(os.environ.get("SPLITKNIT_DATA", HERE.parents[2] / "shared" / "data")) / "fvc2002_db1b"
    files = sorted(folder.glob("*.png"))
    owner = [int(file.stem.split("_")[0]) for file in files]
    found: dict[str, list[Minutiae]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        ways: tuple[Any, ...] = ("phase", "mindtct")
        for name in ways:
            job = ExportJob(tuple(files), to="iso-19794-2", out=root / name, minutiae=name, input_ppi=500.0)
            facts = export_records(job)
            named = [root / name / one["file"] for one in facts["files"]]
            found[name] = [minutiae_of(read_minutiae_record(file)[0]) for file in named]
    facts = {name: {"minutiae": float(np.mean([one.count for one in sides])), **rows(sides, sides, owner)}
             for name, sides in found.items()}  # fmt: skip
    facts["phase against mindtct"] = rows(found["phase"], found["mindtct"], owner)
    (HERE / "templates.json").write_text(json.dumps({"prints": len(files), **facts}, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(facts, indent=1))


if __name__ == "__main__":
    main()
