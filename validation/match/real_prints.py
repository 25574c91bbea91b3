"""Real prints by minutiae, ridges, their fusion, and nbis-py as it comes: FVC2002 DB1_B, five fingers, eight presses.

    python validation/match/real_prints.py                       # everything
    python validation/match/real_prints.py --parts real          # simulated | real | turned

writes ``real_prints.json`` beside this file. Settings of the enhancement were chosen on simulated presses of other
seeds (``pressed_prints.py``, seeds from 90,000); the fusion of minutiae and ridges is fitted on those of seeds from
92,000 (the fusion that splitknit ships is measured by ``fvc.py``). Reported are simulated presses that served for
neither (from 95,000), the real prints, and these turned by any angle. (Of the matcher ``ridge`` a few settings were
chosen with a look at the real ones.)
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pressed_prints import finger, press
from wilson import wilson

from splitknit.io.prints import read_print_png
from splitknit_match.evaluation.fusion import fit_linear, fit_logistic
from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap, differences
from splitknit_match.evaluation.scores import Scores, ids_of
from splitknit_match.matching.minutiae import extract, minutiae_match
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.ridge_band import print_band
from splitknit_match.matching.template import make_template
from splitknit_match.prints.from_file import print_minutiae

HERE = Path(__file__).resolve().parent
OUT = HERE / "real_prints.json"
FITTED, REPORTED = 92_000, 95_000
PARTS = ("simulated", "real", "turned")
TURNS_SEED = 5
FAR_0 = 1e-9
"""No impostor may be accepted."""
Image = NDArray[np.uint8]


def nbis_py(images: Sequence[Image]) -> Callable[[int, int], float]:
    """As nbis-py comes: PNG in, its own minutiae, its own comparison."""
    import nbis  # here to compare with; the library's way in is splitknit_match.matching.minutiae

    extractor = nbis.new_nbis_extractor(
        nbis.NbisExtractorSettings(
            min_quality=0.0, get_center=False, check_fingerprint=False, compute_nfiq2=False, ppi=500.0
        )
    )
    found = [extractor.extract_minutiae(cv2.imencode(".png", image)[1].tobytes()) for image in images]
    return lambda i, j: float(found[i].compare(found[j]))


def minutiae(images: Sequence[Image]) -> Callable[[int, int], float]:
    """As the fusion has them: enhanced, then mindtct and bozorth3."""
    found = [extract(image, 500.0, enhance=True) for image in images]
    return lambda i, j: minutiae_match(found[i], found[j])


def ridges(images: Sequence[Image]) -> Callable[[int, int], float]:
    """The matcher of ridges."""
    sides = [Prepared(make_template(print_band(image))) for image in images]
    return lambda i, j: ridge_match(sides[i], sides[j]).similarity


def phase(images: Sequence[Image]) -> Callable[[int, int], float]:
    """As ``match --method minutiae`` compares prints: found by the phase of the ridges, as ``print`` does."""
    found = [print_minutiae(image) for image in images]
    return lambda i, j: minutiae_match(found[i], found[j])


SYSTEMS = {"nbis-py": nbis_py, "minutiae": minutiae, "ridge": ridges, "minutiae by the phase": phase}


def measured(images: Sequence[Image], owner: Sequence[int], impostors: int | None, seed: int) -> list[Scores]:
    """Scores of all systems: all genuine pairs, and all impostor ones or some."""
    pairs = list(itertools.combinations(range(len(images)), 2))
    others = [pair for pair in pairs if owner[pair[0]] != owner[pair[1]]]
    if impostors is not None and impostors < len(others):
        chosen = np.random.default_rng([seed, 3]).permutation(len(others))[:impostors]
        others = [others[k] for k in sorted(chosen)]
    pairs = [pair for pair in pairs if owner[pair[0]] == owner[pair[1]]] + others
    ids = ids_of([owner[i] for i, _ in pairs], [owner[j] for _, j in pairs])
    found = []
    for name, system in SYSTEMS.items():
        score = system(images)
        found.append(Scores(ids.same, np.array([score(i, j) for i, j in pairs]), finger=ids, name=name))
        print(f"{name}: {len(pairs)} pairs of {len(images)} prints", flush=True)
    return found


def pressed(first: int, fingers: int, presses: int) -> tuple[list[Image], list[int]]:
    """Simulated presses and whose they are."""
    images, owner = [], []
    for k in range(fingers):
        master = finger(first + k)
        images += [press(master, number) for number in range(presses)]
        owner += [k] * presses
    return images, owner


def turned(image: Image, angle_deg: float) -> Image:
    """A print, turned counter-clockwise on a sheet that holds it, beyond its border as bright as its paper."""
    rows, columns = image.shape
    side = int(np.ceil(np.hypot(rows, columns))) + 2
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), angle_deg, 1.0)
    matrix[:, 2] += (side - columns) / 2, (side - rows) / 2
    paper = float(np.percentile(image, 95))
    return np.asarray(cv2.warpAffine(image, matrix, (side, side), flags=cv2.INTER_CUBIC, borderValue=paper), np.uint8)


def fused(systems: Sequence[Scores], models: dict[str, Any]) -> list[Scores]:
    """The systems, and minutiae joined with ridges by models that were fitted elsewhere."""
    table = np.stack([systems[1].score, systems[2].score], axis=1)
    joined = [
        Scores(systems[0].label, model(table), finger=systems[0].finger, name=f"minutiae + ridge, {name}")
        for name, model in models.items()
    ]
    return [*systems, *joined]


def rows(systems: Sequence[Scores]) -> dict[str, Any]:
    """Figures of each system, and its difference to nbis-py."""
    settings = BootstrapSettings(targets=(0.01, FAR_0), curve_points=0)
    result: dict[str, Any] = {}
    for one in systems:
        figures = bootstrap(one, "finger", settings).figures
        genuine = one.genuine
        passed = int((genuine > one.impostor.max()).sum())
        result[one.name] = {
            "genuine": int(genuine.size),
            "impostors": int(one.impostor.size),
            "impostor_median": round(float(np.median(one.impostor)), 4),
            "impostor_largest": round(float(one.impostor.max()), 4),
            "genuine_median": round(float(np.median(genuine)), 4),
            "gar_at_far_0": _rounded(figures[f"gar@{FAR_0:g}"]),
            "gar_at_far_0_wilson": [round(limit, 4) for limit in wilson(passed, genuine.size)],
            "gar_at_far_1_percent": _rounded(figures["gar@0.01"]),
            "eer": _rounded(figures["eer"]),
        }
        if one is not systems[0]:
            paired = differences(one, systems[0], "finger", settings)
            result[one.name]["gar_at_far_0_minus_nbis_py"] = _rounded(paired[f"gar@{FAR_0:g}"])
    return result


def _rounded(interval: Any) -> list[float]:
    return [round(float(value), 4) for value in (interval.value, interval.low, interval.high)]


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--fingers", type=int, default=24, help="simulated ones, to fit and to report")
    parser.add_argument("--presses", type=int, default=4)
    parser.add_argument("--impostors", type=int, default=800, help="simulated pairs at most")
    options = parser.parse_args()
    facts: dict[str, Any] = json.loads(OUT.read_text(encoding="utf-8")) if OUT.is_file() else {}
    drawn = pressed(FITTED, options.fingers, options.presses)
    fit = measured(*drawn, options.impostors, FITTED)
    table = np.stack([fit[1].score, fit[2].score], axis=1)
    models = {"linear": fit_linear(table), "trained": fit_logistic(table, fit[0].label)}
    folder = Path(os.environ.get("SPLITKNIT_DATA", HERE.parents[2] / "shared" / "data")) / "fvc2002_db1b"
    files = sorted(folder.glob("*.png"))
    images = [read_print_png(file).image for file in files]
    owner = [int(file.stem.split("_")[0]) for file in files]
    angles = np.random.default_rng(TURNS_SEED).uniform(0, 360, len(files))
    sheets = {"real": images, "turned": [turned(*one) for one in zip(images, angles.tolist(), strict=True)]}
    for part in sheets if files else ():
        if part not in options.parts:
            continue
        facts[part] = {"prints": len(files), "systems": rows(fused(measured(sheets[part], owner, None, 0), models))}
        OUT.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    if "simulated" in options.parts:
        drawn = pressed(REPORTED, options.fingers, options.presses)
        facts["simulated"] = {
            "fingers": options.fingers,
            "presses": options.presses,
            "first_seed": REPORTED,
            "systems": rows(fused(measured(*drawn, options.impostors, REPORTED), models)),
        }
        OUT.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    for part in PARTS:
        for name, row in facts.get(part, {}).get("systems", {}).items():
            print(part, name, "GAR at FAR 1 %", row["gar_at_far_1_percent"], "EER", row["eer"])


if __name__ == "__main__":
    main()
