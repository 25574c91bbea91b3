"""How well the features in space of Kumar and of Lin separate fingers, on simulated people, and what they cost.

    python validation/family/features.py make --population people --work work --part tuned
    python validation/family/features.py make --population people --work work --part reported
    python validation/family/features.py report --work work
    python validation/family/features.py table

`people` is a folder of ``splitknit simulate population --seed 680 --scale 0.4``. The features of each capture are kept
in `work`, so that a run that was stopped goes on. The tolerances of the matchers were chosen on the part `tuned`
(subjects S01 and S02, case ea); `reported` (S03 and S04) and `more` (five others) were not looked at before. With
``--store`` the surfaces come from a store of ``splitknit batch``. ``report`` writes features.json beside this script:
d', the fraction of genuine pairs accepted at a false accept rate of 1 %, with intervals, and milliseconds.
"""

from __future__ import annotations

import argparse
import json
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.errors import BadInput
from splitknit.finger.ridges import surface_print
from splitknit.io.capture import read_capture
from splitknit.model import Surface, surface_of
from splitknit.pipeline import reconstruct
from splitknit_match.batch.chunks import read_chunk
from splitknit_match.batch.surfaces import unpack_surface
from splitknit_match.evaluation.fusion import FusionSettings, fuse
from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.protocol import comparisons, scores_of_comparisons
from splitknit_match.evaluation.scores import Scores
from splitknit_match.matching.minutiae import extract, minutiae_match
from splitknit_match.matching.minutiae3d import (
    PreparedMinutiae3D,
    PreparedTetrahedra,
    minutiae3d_match,
    tetrahedra_match,
)
from splitknit_match.matching.space_features import space_minutiae, surface_code
from splitknit_match.matching.surface_code import PreparedSurface, surface_code_match

RESULTS = Path(__file__).with_name("features.json")
FINGERS = ("right_thumb", "right_index", "right_middle", "right_ring", "right_little", "left_index")
PARTS = {"tuned": ("S01", "S02"), "reported": ("S03", "S04"), "more": ("S05", "S06", "S07", "S08", "S09")}
"""Subjects. `more` is reported too, where there is time or a store."""
SESSIONS = ("session_1", "session_2")
METHODS = ("minutiae", "minutiae3d", "tetrahedra", "surface-code")


def captures(part: str) -> list[str]:
    """Names of the captures of a part: subject, session, finger."""
    return [f"{subject}/{session}/{finger}" for subject in PARTS[part] for session in SESSIONS for finger in FINGERS]


def features_of(surface: Surface) -> dict[str, Any]:
    """Features of all methods, and the seconds that they took."""
    made: dict[str, Any] = {}
    seconds: dict[str, float] = {}
    for name, make in (
        ("minutiae", lambda: extract(surface_print(surface, 500.0))),
        ("space", lambda: space_minutiae(surface)),
        ("code", lambda: surface_code(surface)),
    ):
        started = time.thread_time()
        made[name] = make()
        seconds[name] = time.thread_time() - started
    return made | {"seconds": seconds}


def make(surface: Callable[[str], Surface], names: list[str], folder: Path) -> int:
    """Make the features that `folder` lacks; return how many."""
    folder.mkdir(parents=True, exist_ok=True)
    lacking = [name for name in names if not file_of(folder, name).is_file()]
    for number, name in enumerate(lacking):
        try:
            made = features_of(surface(name))
        except BadInput as error:
            made = {"failure": str(error)}
        partial = folder / ".partial"
        partial.write_bytes(pickle.dumps(made))
        partial.replace(file_of(folder, name))
        print(f"{number + 1} of {len(lacking)}: {name}", flush=True)
    return len(lacking)


def file_of(folder: Path, name: str) -> Path:
    return folder / f"{name.replace('/', '-')}.pickle"


def from_captures(population: Path, case: str) -> Callable[[str], Surface]:
    return lambda name: surface_of(reconstruct(read_capture(population / name), case))


def from_store(store: Path, case: str) -> Callable[[str], Surface]:
    """Surfaces that a batch has kept."""
    places: dict[str, tuple[Path, int]] = {}
    for file in sorted((store / "features" / case).glob("*.npz")):
        for row, name in enumerate(read_chunk(file, ["capture"])["capture"].tolist()):
            places[name] = (file, row)

    def read(name: str) -> Surface:
        file, row = places[name]
        payload = read_chunk(file, ["images"])["images"][row]
        if not payload:
            raise BadInput("it could not be acquired.")
        return unpack_surface(payload)

    return read


def compared(folder: Path, names: list[str]) -> tuple[dict[str, Scores], dict[str, float], dict[str, int]]:
    """Scores of all methods over all pairs of both sessions, milliseconds each, and failures to acquire."""
    sides = {name: pickle.loads(file_of(folder, name).read_bytes()) for name in names}
    finger = [f"{name.split('/')[0]}/{name.split('/')[2]}" for name in names]
    session = [name.split("/")[1] for name in names]
    pairs = comparisons(finger, session)
    ready: dict[str, list[Any]] = {
        "minutiae": [side.get("minutiae") for side in sides.values()],
        "minutiae3d": [side and PreparedMinutiae3D(side) for side in (one.get("space") for one in sides.values())],
        "tetrahedra": [side and PreparedTetrahedra(side) for side in (one.get("space") for one in sides.values())],
        "surface-code": [side and PreparedSurface(side) for side in (one.get("code") for one in sides.values())],
    }
    ways: dict[str, Callable[[Any, Any], float]] = {
        "minutiae": minutiae_match,
        "minutiae3d": lambda a, b: minutiae3d_match(a, b).similarity,
        "tetrahedra": lambda a, b: tetrahedra_match(a, b).similarity,
        "surface-code": lambda a, b: surface_code_match(a, b).similarity,
    }
    scores, cost, failures = {}, {}, {}
    for method in METHODS:
        side = ready[method]
        failures[method] = sum(one is None for one in side)
        started, values = time.thread_time(), []
        for a, b in zip(pairs.a.tolist(), pairs.b.tolist(), strict=True):
            values.append(np.nan if side[a] is None or side[b] is None else ways[method](side[a], side[b]))
        cost[method] = 1000 * (time.thread_time() - started) / len(values)
        scores[method] = scores_of_comparisons(pairs, np.array(values, dtype=np.float64), finger, session, name=method)
    return scores, cost, failures


def figures(scores: Scores, replicates: int) -> dict[str, Any]:
    """d' and the GAR at a FAR of 1 % with intervals drawn by finger."""
    drawn = BootstrapSettings(replicates=replicates, seed=7, targets=(0.01,), curve_points=0)
    found = bootstrap(scores, "finger", drawn).figures
    genuine, impostor = (side[~np.isnan(side)] for side in (scores.genuine, scores.impostor))
    return {
        "pairs": [int(genuine.size), int(impostor.size)],
        "least_and_median_genuine": [rounded(genuine.min()), rounded(np.median(genuine))],
        "median_and_largest_impostor": [rounded(np.median(impostor)), rounded(impostor.max())],
        **{
            name: [rounded(one.value), rounded(one.low), rounded(one.high)]
            for name, one in found.items()
            if name == "d_prime" or name.startswith(("gar", "eer"))
        },
    }


def rounded(value: float) -> float:
    return float(f"{float(value):.4g}")


def report(folder: Path, part: str, replicates: int = 1000) -> dict[str, Any]:
    """Figures of all methods and of Kumar's weighted sums of plane and space, equal weights of z-scores."""
    names = [name for name in captures(part) if file_of(folder, name).is_file()]
    scores, cost, failures = compared(folder, names)
    joined = FusionSettings(method="linear", folds=5, seed=7)
    for other in METHODS[1:]:
        if len(set(scores[other].label)) == 2:
            scores[f"minutiae + {other}"] = fuse([scores["minutiae"], scores[other]], joined).scores
    return {
        "captures": len(names),
        "failures_to_acquire": failures,
        "ms_per_comparison": {name: round(each, 2) for name, each in cost.items()},
        "methods": {name: figures(one, replicates) for name, one in scores.items()},
    }


def table(known: dict[str, Any]) -> list[str]:
    """Lines of Markdown: one for each case, part and method."""
    head = "| case | fingers | method | d' | GAR at FAR 1 % | genuine: least / median | others: median / largest | ms |"
    lines = [head, "| --- " * 8 + "|"]
    for case, parts in known.items():
        for part, found in parts.items():
            for method, one in found["methods"].items():
                gar = [f"{100 * value:.1f}" for value in one["gar@0.01"]]
                prime = [f"{value:.1f}" for value in one["d_prime"]]
                low, high = one["least_and_median_genuine"], one["median_and_largest_impostor"]
                cost = found["ms_per_comparison"].get(method)
                cells = [
                    case, f"{part}, {one['pairs'][0]}", method, f"{prime[0]} [{prime[1]}, {prime[2]}]",
                    f"{gar[0]} [{gar[1]}, {gar[2]}]", f"{low[0]:.3g} / {low[1]:.3g}", f"{high[0]:.3g} / {high[1]:.3g}",
                    "" if cost is None else f"{cost:.1f}",
                ]  # fmt: skip
                lines.append(f"| {' | '.join(cells)} |")
    return lines


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("make", "report", "table"))
    parser.add_argument("--work", type=Path, default=Path("work"))
    parser.add_argument("--population", type=Path)
    parser.add_argument("--store", type=Path, help="take the surfaces from a store of splitknit batch")
    parser.add_argument("--case", default="kumar")
    parser.add_argument("--part", choices=tuple(PARTS), action="append")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--replicates", type=int, default=1000)
    options = parser.parse_args(arguments)
    if options.what == "table":
        print("\n".join(table(json.loads(options.out.read_text()))))
        return 0
    parts = options.part or list(PARTS)
    folder = options.work / options.case
    if options.what == "make":
        if options.store is None and options.population is None:
            parser.error("name --population or --store.")
        read = (
            from_store(options.store, options.case)
            if options.store
            else from_captures(options.population, options.case)
        )
        for part in parts:
            make(read, captures(part), folder)
        return 0
    known = json.loads(options.out.read_text()) if options.out.is_file() else {}
    for part in parts:
        known.setdefault(options.case, {})[part] = report(folder, part, options.replicates)
        options.out.write_text(json.dumps(known, indent=1) + "\n")
        print(json.dumps(known[options.case][part]["methods"], indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
