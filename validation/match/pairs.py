"""Both matchers on a few simulated fingers: true surfaces, and reconstructions by the preset metric.

    python validation/match/pairs.py --fingers 10 --impressions 2 --scale 0.3

writes ``pairs.json`` beside this file: GAR at FAR 1 %, EER, the least genuine and the largest impostor similarity, with
intervals clustered by finger. Few fingers: this shows that the parts work together, not how good they are.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.finger.orientation import find_upright
from splitknit.model import Surface
from splitknit.pipeline import reconstruct
from splitknit_match.evaluation.intervals import bootstrap
from splitknit_match.evaluation.scores import Scores, ids_of
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.surface import MatchingSettings, surface_images, surface_template
from splitknit_match.matching.thesis import ThesisSettings, thesis_match
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

HERE = Path(__file__).resolve().parent


def surfaces(seed: int, impression: int, scale: float) -> dict[str, Surface]:
    """The true surface and the reconstruction of one capture; both cut where the reconstruction was cut."""
    capture, truth = simulate_capture(seed, None, TwinSettings(scale=scale), impression=impression)
    result = reconstruct(capture, "metric")
    mask = result.mask & truth["mask"]
    upright = find_upright(mask)
    frame = (upright.input_from_upright, upright.size)
    height, shape = truth["height_mm"], truth["shape_mm"]
    return {
        "truth": Surface(height - shape, shape, truth["normals"], mask, result.pitch_mm, *frame),
        "metric": Surface(
            result.ridge_mm, result.shape_mm, result.normals, result.mask, result.pitch_mm,
            result.input_from_upright, result.upright_size,
        ),
    }  # fmt: skip


def summary(name: str, pairs: list[tuple[int, int, float]]) -> dict[str, Any]:
    """Rates of one matcher on one kind of surface."""
    a, b = [str(pair[0]) for pair in pairs], [str(pair[1]) for pair in pairs]
    finger = ids_of(a, b)
    score = np.array([pair[2] for pair in pairs])
    scores = Scores(label=finger.same, score=score, finger=finger, name=name)
    figures = bootstrap(scores, "finger").figures
    return {
        "genuine": int(finger.same.sum()),
        "impostors": int((~finger.same).sum()),
        "least_genuine": float(scores.genuine.min()),
        "median_genuine": float(np.median(scores.genuine)),
        "median_impostor": float(np.median(scores.impostor)),
        "largest_impostor": float(scores.impostor.max()),
        "figures": {key: [figure.value, figure.low, figure.high] for key, figure in figures.items()},
    }


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fingers", type=int, default=10)
    parser.add_argument("--impressions", type=int, default=2)
    parser.add_argument("--scale", type=float, default=0.3)
    parser.add_argument("--seed", type=int, default=3000)
    options = parser.parse_args()
    sides: list[tuple[int, dict[str, Any]]] = []
    for finger, impression in itertools.product(range(options.fingers), range(options.impressions)):
        made = surfaces(options.seed + finger, impression, options.scale)
        ready = {
            kind: (Prepared(surface_template(surface, MatchingSettings())), surface_images(surface))
            for kind, surface in made.items()
        }
        sides.append((finger, ready))
        print(f"finger {finger}, impression {impression}", flush=True)
    matchers = {
        "ridge": lambda a, b: ridge_match(a[0], b[0]).similarity,
        "thesis": lambda a, b: thesis_match(a[1], b[1]).similarity,
        "thesis, no gate": lambda a, b: thesis_match(a[1], b[1], ThesisSettings(gate=0.0)).similarity,
    }
    rows = {}
    for (matcher, score), kind in itertools.product(matchers.items(), ("truth", "metric")):
        pairs = [(i, j, score(a[kind], b[kind])) for (i, a), (j, b) in itertools.combinations(sides, 2)]
        rows[f"{matcher}, {kind}"] = summary(f"{matcher} {kind}", pairs)
        print(matcher, kind, json.dumps(rows[f"{matcher}, {kind}"]), flush=True)
    facts = {"settings": vars(options), "rows": rows}
    (HERE / "pairs.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
