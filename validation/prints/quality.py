"""Does the quality of a print foretell how well it serves? ``python validation/prints/quality.py POPULATION STORE``.

For captures of a population that are reconstructed in a store (``splitknit batch``): rank correlation of our score, of
each of its figures, and of NFIQ 2 with the mean ridge-template similarity with the same finger's other sessions, and
with the fraction of the true minutiae that mindtct finds on the unrolled print (within 5 pixels, half a ridge period).
The 95 % intervals are those of a bootstrap over captures. ``--faults FOLDER`` (made by ``quality_faults.py``) adds what
is said of fingers with one known fault; without it, what ``quality.json`` says of them stays. Writes
``validation/prints/quality.json``.

What the thresholds were chosen on is left out: subjects 1 and 9, nine single captures, fingers 9101 and 9102.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
from quality_measure import capture_facts, facts_of
from scipy.stats import spearmanr

from splitknit.io.npz import read_npz
from splitknit_match.batch.reading import stored_places
from splitknit_match.batch.store import Store
from splitknit_match.prints.folder import advice
from splitknit_match.prints.print_quality import PrintQuality, QualityFigures, score_of
from splitknit_match.prints.sources import Source

CHOSEN_ON = {"S01", "S09"}
LOOKED_AT = {
    "S02/session_3/left_middle", "S04/session_1/left_thumb", "S06/session_3/right_middle",
    "S08/session_1/right_thumb", "S11/session_1/left_thumb", "S13/session_3/right_middle",
    "S14/session_3/left_middle",
}  # fmt: skip
OUT = Path(__file__).with_name("quality.json")


def drawn(store: Store, count: int, seed: int = 2) -> list[str]:
    """Names of captures to report on."""
    names = sorted(stored_places(store.files("features", "metric")))
    usable = [name for name in names if name.split("/")[0] not in CHOSEN_ON and name not in LOOKED_AT]
    return [str(name) for name in np.random.default_rng(seed).choice(usable, min(count, len(usable)), replace=False)]


def earlier() -> list[str]:
    """Names of the captures of the last report: it was drawn while the store was still filling up."""
    return [row["capture"] for row in json.loads(OUT.read_text())["rows"]]


def rank_correlation(a: np.ndarray, b: np.ndarray, rounds: int = 2000) -> dict:
    """Spearman's rho of (N,) and (N,) with the 2.5th and 97.5th percentile of a bootstrap over N."""
    rng = np.random.default_rng(0)
    values = []
    for _ in range(rounds):
        index = rng.integers(0, len(a), len(a))
        if len(set(a[index])) > 1 and len(set(b[index])) > 1:
            values.append(spearmanr(a[index], b[index]).statistic)
    low, high = np.percentile(values, [2.5, 97.5])
    middle = float(spearmanr(a, b).statistic)
    return {"rho": round(middle, 2), "low": round(float(low), 2), "high": round(float(high), 2), "n": len(a)}


def correlations(rows: list[dict]) -> dict:
    """Table of rank correlations, all captures and without partial views."""
    table: dict = {}
    for which, some in (("all", rows), ("without partial views", [row for row in rows if not row["partial"]])):
        for target in ("similarity", "recall"):
            known = [row for row in some if row[target] is not None]
            wanted = np.array([row[target] for row in known])
            for name in ("ours", "nfiq2", *known[0]["worth"]):
                of = [row[name] if name in row else row["worth"][name] for row in known]
                if len(set(of)) > 2:
                    table.setdefault(which, {}).setdefault(target, {})[name] = rank_correlation(np.array(of), wanted)
    return table


def scored(row: dict) -> dict:
    """A row with our score of its figures by the settings of today."""
    figures = QualityFigures(**row["figures"])
    score, worth = score_of(figures)
    words = advice(PrintQuality(score, figures, worth))
    return {**row, "ours": score, "worth": worth, "advice": list(words)}


def fault_rows(folder: Path) -> list[dict]:
    """Facts of every finger with a fault."""
    rows = []
    for path in sorted(folder.glob("*_*.npz")):
        arrays = read_npz(path)
        source = Source(
            "result", arrays["mask"], float(arrays["pitch_mm"]), arrays["input_from_upright"],
            tuple(int(side) for side in arrays["upright_size"]), None, arrays["ridge_mm"], arrays["shape_mm"],
        )  # fmt: skip
        seed, fault = path.stem.split("_")
        rows.append({"seed": int(seed), "fault": fault, **facts_of(source, arrays.get("minutiae_px"))})
    return rows


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("population", type=Path)
    parser.add_argument("store", type=Path)
    parser.add_argument("--captures", type=int, default=60)
    parser.add_argument("--draw", action="store_true", help="draw captures anew; else those of quality.json")
    parser.add_argument("--faults", type=Path)
    parser.add_argument("--rows", type=Path, help="kept between runs: captures that are in it are not measured again")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    store = Store(options.store)
    kept = {}
    if options.rows and options.rows.is_file():
        kept = {row["capture"]: row for row in json.loads(options.rows.read_text())}
        names = list(kept)
    else:
        names = drawn(store, options.captures) if options.draw else earlier()
    for name in names:
        if name not in kept:
            kept[name] = capture_facts(store, options.population, [name])[0]
            if options.rows:
                options.rows.write_text(json.dumps(list(kept.values())))
    rows = [scored(kept[name]) for name in names]
    result: dict = {
        "captures": len(rows),
        "partial": sum(row["partial"] for row in rows),
        "medians": {
            name: round(float(np.median([row[name] for row in rows])), 3)
            for name in ("ours", "nfiq2", "similarity", "recall")
        },
        "range": {
            name: [round(float(f([row[name] for row in rows])), 3) for f in (np.min, np.max)]
            for name in ("ours", "nfiq2", "similarity", "recall")
        },
        "rank_correlation": correlations(rows),
        "spoken_of": sum(bool(row["advice"]) for row in rows),
    }
    if options.faults:
        result["faults"] = fault_rows(options.faults)
    elif OUT.is_file() and "faults" in (before := json.loads(OUT.read_text())):
        result["faults"] = before["faults"]
    OUT.write_text(json.dumps({**result, "rows": rows}, indent=1) + "\n")
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
