"""What each part of the light does to the surface: contrast, direct light, glare and blur, alone
and together.

    python validation/separation/ablation.py  # eight fingers, 17 ways each
    python validation/separation/ablation.py --clahe  # contrast enhancement of snk on 24 fingers
    python validation/separation/ablation_report.py

The first takes about seven minutes of one core. The second writes clahe.json; the third writes the
tables of docs/experiments/separation.md and docs/explain/reconstruction.md from both JSON files.

The fingers are those of ``validation/accuracy`` (seed 1000 and on, half scale). All ways see the
same finger in the same mask, found once in the images as they are; ``ablation_rows.py`` lists them.
One JSON a finger lands in ``validation/out/ablation`` under a hash of the code that it follows
from, so that a run that was stopped goes on where it was. One process a core; figures do not depend
on how many.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import hashlib
import json
import multiprocessing
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
OUT = HERE.parent / "out" / "ablation"
CONFIDENCE = 0.95
FIRST_SEED = 1000
RECIPES = ("ablation_rows", "ablation_light")
FingerFigures = Mapping[str, Mapping[str, Any]]
"""Figures of one finger by row; a row that was refused has only ``refused``."""


def main(arguments: Sequence[str] | None = None) -> int:
    # before numpy is imported: one thread of linear algebra a process
    os.environ.update(
        dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    )
    from ablation_rows import CHECK_MM, CONTRAST_ROWS, ROWS

    chosen = _parser().parse_args(arguments)
    names = [name for name in ROWS if (name in CONTRAST_ROWS) == chosen.clahe]
    fingers = chosen.fingers or (24 if chosen.clahe else 8)
    out = chosen.out or HERE / ("clahe.json" if chosen.clahe else "ablation.json")
    code = source_hash()
    seeds = list(range(FIRST_SEED, FIRST_SEED + fingers))
    by_finger = measure_all(
        seeds, names, chosen.scale, chosen.scratch / f"{code[:12]}_{chosen.scale:g}", chosen.workers
    )
    results = {
        "format": "splitknit-ablation",
        "version": 1,
        "source_sha256": code,
        "scale": chosen.scale,
        "check_mm": CHECK_MM,
        "seeds": seeds,
        **summarised(by_finger, names),
        "fingers": [
            {"seed": seed, "rows": figures} for seed, figures in zip(seeds, by_finger, strict=True)
        ],
    }
    text = json.dumps(_rounded(results), indent=1, allow_nan=False)
    out.write_text(text + "\n", encoding="ascii")
    from ablation_report import pairs_csv, rows_table

    results = json.loads(text)
    print(rows_table(results), pairs_csv(results), sep="\n\n")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--clahe", action="store_true", help="the contrast enhancement of snk, and nothing else"
    )
    parser.add_argument("--fingers", type=int, help="default: 8, of --clahe 24")
    parser.add_argument("--scale", type=float, default=0.5, help="1 = 3200 x 2200 pixels")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument(
        "--out", type=Path, help="default: ablation.json, of --clahe clahe.json, beside this file"
    )
    parser.add_argument("--scratch", type=Path, default=OUT, help="folder of the single results")
    return parser


def source_hash() -> str:
    """SHA-256 of the code that the figures follow from: results of other code are not mixed with
    these."""
    import ablation_rows  # noqa: F401

    import splitknit
    import splitknit_simulator

    members = {"splitknit": splitknit, "splitknit_simulator": splitknit_simulator}
    names = [name for name in sys.modules if name.split(".")[0] in members or name in RECIPES]
    tables = [
        file
        for member in members.values()
        for file in Path(str(member.__file__)).parent.rglob("*.npz")
    ]
    files = {Path(str(sys.modules[name].__file__)) for name in names} | set(tables)
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.name.encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def measure_all(
    seeds: Sequence[int], names: Sequence[str], scale: float, folder: Path, workers: int
) -> list[dict[str, Any]]:
    """Figures of every finger's rows; those that are on disk already are not measured again."""
    folder.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(
        workers, mp_context=context, initializer=_one_thread
    ) as pool:
        jobs = [pool.submit(measure_one, seed, names, scale, folder) for seed in seeds]
        return [job.result() for job in jobs]


def _one_thread() -> None:
    import cv2

    cv2.setNumThreads(1)


def measure_one(seed: int, names: Sequence[str], scale: float, folder: Path) -> dict[str, Any]:
    from ablation_rows import Bench

    file = folder / f"{seed:05d}.json"
    rows = dict(json.loads(file.read_text())) if file.is_file() else {}
    missing = [name for name in names if name not in rows]
    bench = Bench(seed, scale) if missing else None
    for name in missing:
        rows[name] = bench.figures(name)
        partial = file.with_suffix(".partial")
        partial.write_text(json.dumps(rows, indent=1))
        partial.replace(file)
    return {name: rows[name] for name in names}


def summarised(by_finger: Sequence[FingerFigures], names: Sequence[str]) -> dict[str, Any]:
    """Mean and interval over fingers of every figure of every row, and of the differences of
    :data:`PAIRS`."""
    from ablation_rows import FIGURES, PAIRS, ROWS

    rows: dict[str, Any] = {}
    for name in names:
        done = [finger[name] for finger in by_finger if "refused" not in finger[name]]
        figures = {key: statistics([row[key] for row in done]) for key in FIGURES} if done else {}
        row = ROWS[name]
        rows[name] = {
            "group": row.group,
            "words": row.words,
            "refused": len(by_finger) - len(done),
            "figures": figures,
        }
    pairs = []
    for words, first, second in PAIRS:
        if first not in names or second not in names:
            continue
        both = [(finger[first], finger[second]) for finger in by_finger]
        both = [
            (row_a, row_b)
            for row_a, row_b in both
            if "refused" not in row_a and "refused" not in row_b
        ]
        if both:
            figures = {
                key: statistics([row_a[key] - row_b[key] for row_a, row_b in both])
                for key in FIGURES
            }
            pairs.append(
                {
                    "words": words,
                    "row": first,
                    "against": second,
                    "fingers": len(both),
                    "figures": figures,
                }
            )
    return {"rows": rows, "pairs": pairs}


def statistics(values: Sequence[float]) -> dict[str, Any]:
    """Mean, and its 95 % interval by Student's t; one finger has no interval."""
    import numpy as np
    from scipy.stats import t

    mean = float(np.mean(values))
    if len(values) < 2:
        return {"mean": mean, "interval": None}
    half = float(
        t.ppf(0.5 + 0.5 * CONFIDENCE, len(values) - 1) * np.std(values, ddof=1) / len(values) ** 0.5
    )
    return {"mean": mean, "interval": [mean - half, mean + half]}


def _rounded(value: Any) -> Any:
    """Five digits: what is committed should not change where nothing did."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


if __name__ == "__main__":
    sys.exit(main())
