"""Are the twin's fingers as different from each other as people's? Impostor scores of an independent matcher.

Prints of many drawn fingers (natural frequencies of the classes, 500 ppi) are matched all against all with NIST's
mindtct and bozorth3, and compared with real prints (FVC2002 DB1_B) where the independent data set is present.

    pip install nbis-py==0.1.3
    python validation/impostors/run.py

writes ``results.json`` beside this file.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit_simulator.finger.finger import FREQUENCIES
from splitknit_simulator.finger.master_print import ink_print, master_print

HERE = Path(__file__).resolve().parent


def classes(count: int) -> list[str]:
    """`count` classes in their natural frequencies (largest remainders)."""
    exact = {name: fraction * count for name, fraction in FREQUENCIES.items()}
    whole = {name: int(value) for name, value in exact.items()}
    for name in sorted(exact, key=lambda name: whole[name] - exact[name])[: count - sum(whole.values())]:
        whole[name] += 1
    return [name for name, number in whole.items() for _ in range(number)]


def population(count: int, first_seed: int) -> list[bytes]:
    """PNG files of `count` prints on a white border, as a 500-ppi sensor gives them."""
    files = []
    for k, pattern in enumerate(classes(count)):
        image = np.pad(ink_print(master_print(pattern, first_seed + k)), 20, constant_values=255)
        files.append(cv2.imencode(".png", image)[1].tobytes())
    return files


def matched(files: Sequence[bytes], labels: Sequence[str]) -> dict[str, Any]:
    """Score all pairs; pairs of one label are genuine."""
    import nbis  # a tool of this experiment alone

    extractor = nbis.new_nbis_extractor(
        nbis.NbisExtractorSettings(
            min_quality=0.0, get_center=False, check_fingerprint=False, compute_nfiq2=False, ppi=500.0
        )
    )
    templates = [extractor.extract_minutiae(file) for file in files]
    impostor, genuine = [], []
    for i, j in itertools.combinations(range(len(files)), 2):
        (genuine if labels[i] == labels[j] else impostor).append(templates[i].compare(templates[j]))
    counts = [len(template.get()) for template in templates]
    result: dict[str, Any] = {
        "prints": len(files),
        "minutiae_median": float(np.median(counts)),
        "impostor": _distribution(impostor),
    }
    if genuine:
        result["genuine"] = _distribution(genuine)
    return result


def _distribution(scores: Sequence[int]) -> dict[str, float]:
    values = np.asarray(scores)
    return {
        "pairs": len(values),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "p99": float(np.percentile(values, 99)),
        "max": float(values.max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prints", type=int, default=40)
    parser.add_argument("--populations", type=int, default=3, help="independent draws, each of --prints fingers")
    parser.add_argument("--out", type=Path, default=HERE / "results.json")
    arguments = parser.parse_args()
    results: dict[str, Any] = {"matcher": "mindtct + bozorth3 (nbis-py 0.1.3), 500 ppi, all minutiae"}
    for k in range(arguments.populations):
        files = population(arguments.prints, 1000 * k)
        results[f"simulated_{k}"] = matched(files, [str(i) for i in range(len(files))])
    data = Path(os.environ.get("SPLITKNIT_DATA", HERE.parents[2] / "shared" / "data")) / "fvc2002_db1b"
    real = sorted(data.glob("*.png"))
    if real:
        results["real_fvc2002_db1b"] = matched([p.read_bytes() for p in real], [p.stem.split("_")[0] for p in real])
    arguments.out.write_text(json.dumps(results, indent=2) + "\n")
    for name, value in results.items():
        print(name, value)


if __name__ == "__main__":
    main()
