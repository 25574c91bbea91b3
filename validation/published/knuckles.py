"""Two traits of the same simulated people: prints, and knuckles as the rig sees them; alone and
fused.

    nice python validation/published/knuckles.py --work FOLDER # 12 people, 5 minutes of one core

Each person's finger is pressed twice (sessions 1 and 2), and its back is captured twice, in poses
of its own, and reconstructed by `metric` without the cut at the crease. Prints are compared by the
default matcher, knuckles by `ridge`. FOLDER keeps ``prints.csv`` and ``knuckles.csv``, as
``splitknit evaluate --fuse`` reads them. Intervals of 95 % draw people. All of it is our
simulator's: number, places and forms of the creases are our choice, after pictures of minor finger
knuckles (A. Kumar and Z. Xu, IEEE TIFS 11, 2016); the nail is kept out of view.
"""

from __future__ import annotations

import argparse
import csv
import json
import pickle
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d

sys.path.append(str(Path(__file__).resolve().parents[1] / "match"))
from pressed_prints import SENSORS, press

import splitknit
import splitknit_match
import splitknit_simulator
from splitknit.errors import require
from splitknit.reconstruction import surface_of
from splitknit_match.evaluation.fusion import FITS, Labels, Model, spread
from splitknit_match.evaluation.intervals import BootstrapSettings
from splitknit_match.evaluation.protocol import comparisons
from splitknit_match.evaluation.rates import Values
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.surface import surface_template
from splitknit_match.matching.template import Template
from splitknit_simulator.finger.finger import FingerPose, SimulatedFinger, draw_finger
from splitknit_simulator.finger.skin_map import FlexionCrease, SkinRelief
from splitknit_simulator.scene import TwinSettings

OUT = Path(__file__).with_suffix(".json")
SEED = 99_000
SENSOR = SENSORS["fvc2004_db2b"]
"""Dry and wet presses."""
BINS = 1024  # of the densities of scores


def draw_knuckle(seed: int, session: int = 0) -> SimulatedFinger:
    """Draw the back of the finger that :func:`splitknit_simulator.finger.finger.draw_finger` draws
    for `seed`.

    Creases stay; how deep all of them are changes by a fifth from `session` to session, as the
    joint bends.
    """
    finger = draw_finger(seed)
    rng = np.random.default_rng([seed, 0xD02])
    bent = float(np.exp(0.2 * np.random.default_rng([seed, session, 0xD03]).standard_normal()))
    count = int(rng.integers(9, 14))
    places = np.linspace(-6.5, 6.5, count) + rng.normal(0.0, 0.35, count)
    creases = tuple(
        FlexionCrease(
            v_mm=float(place),
            depth_mm=float(
                np.clip(
                    bent * 0.16 * np.exp(0.4 * rng.standard_normal() - (place / 6.0) ** 2),
                    0.02,
                    0.4,
                )
            ),
            width_mm=float(rng.uniform(0.14, 0.3)),
            tilt=float(rng.normal(0.0, 0.07)),
            bow_per_mm=float(np.sign(place) * rng.uniform(0.0, 0.012)),
            reach_mm=float(rng.uniform(3.0, 8.0)),
            side_lines=int(rng.integers(0, 4)),
            darkening=0.15,
        )
        for place in places
    )
    skin = SkinRelief(
        0.0, pore_depth_um=0.0, pore_darkening=0.0, undulation_mm=0.02, creases=creases
    )
    return replace(finger, skin=skin, shape=replace(finger.shape, pad_bulge=0.0, neck=-0.05))


def knuckle_pose(rng: np.random.Generator) -> FingerPose:
    """Draw how the back of a finger lies: its last joint in the middle of the picture, its tip
    beyond the border."""
    return FingerPose(
        yaw_rad=float(rng.uniform(-0.1, 0.1)), pitch_rad=float(rng.uniform(-0.05, 0.05)),
        roll_rad=float(rng.uniform(-0.1, 0.1)), x_mm=float(rng.uniform(-2.0, 2.0)),
        insertion_mm=float(rng.uniform(38.0, 41.0)), height_mm=float(rng.uniform(-0.5, 0.5)),
    )  # fmt: skip


def templates_of(
    person: int, session: int, folder: Path, scale: float
) -> tuple[Template, Template]:
    """Templates of a press and of the knuckle."""
    file = folder / f"person_{person}_{session}.pickle"
    if not file.is_file():
        seed = SEED + person
        pose = knuckle_pose(np.random.default_rng([seed, session, 0xD04]))
        finger = draw_knuckle(seed, session)
        settings = TwinSettings(scale=scale, pose=pose)
        capture, _ = splitknit_simulator.simulate_capture(
            seed, settings=settings, impression=session, finger=finger
        )
        result = splitknit.reconstruct(capture, settings={"cut_at_crease": False})
        knuckle = surface_template(surface_of(result))
        press_and_knuckle = (
            print_template(press(draw_finger(seed).master(), session, SENSOR)),
            knuckle,
        )
        file.with_suffix(".part").write_bytes(pickle.dumps(press_and_knuckle))
        file.with_suffix(".part").replace(file)
    templates: tuple[Template, Template] = pickle.loads(file.read_bytes())
    return templates


def fit_ratios(scores: Values, genuine: Labels) -> tuple[Values, Model]:
    """Sum of log-likelihood ratios; missing ones add nothing.

    Densities are estimated by Gaussian kernels of Silverman's width; one observation spread over
    the whole range is added to each class, so that no ratio is infinite. Source: K. Nandakumar, Y.
    Chen, S. Dass and A. Jain, "Likelihood ratio-based biometric score fusion", IEEE TPAMI 30, 2008,
    eq. 5; B. Silverman, "Density Estimation", 1986, eq. 3.31.
    """
    spread(scores)
    low = np.nanmin(scores, axis=0)
    high = np.nanmax(scores, axis=0)
    width = (high - low) / BINS

    def log_density(column: Values, k: int) -> Values:
        known = column[~np.isnan(column)]
        require(
            known.size > 0,
            f"system {k + 1} has only genuine or only impostor scores in the part to learn from.",
        )
        counts = np.histogram(known, BINS, (low[k], high[k]))[0].astype(np.float64)
        quartiles = float(np.subtract(*np.percentile(known, [75, 25]))) / 1.34
        sigma = min(float(known.std()), quartiles or np.inf)
        kernel = max(0.9 * sigma * known.size**-0.2 / width[k], 1.0)
        density = gaussian_filter1d(counts, kernel, mode="constant") + 1.0 / BINS
        return np.asarray(np.log(density / density.sum()))

    ratio = [
        log_density(side[genuine], k) - log_density(side[~genuine], k)
        for k, side in enumerate(scores.T)
    ]

    def scored(table: Values) -> Values:  # held at the training part's ends
        places = ((table - low) / width - 0.5).T
        log_ratios = [
            np.interp(place, np.arange(BINS), ratios)
            for place, ratios in zip(places, ratio, strict=True)
        ]
        return np.asarray(np.nansum(log_ratios, axis=0))

    return np.ones(len(ratio)), scored


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--people", type=int, default=12)
    parser.add_argument("--scale", type=float, default=0.2, help="of the camera")
    parser.add_argument("--write", action="store_true", help=f"write {OUT.name}")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    options.work.mkdir(parents=True, exist_ok=True)
    person = np.tile(np.arange(options.people), 2)
    session = np.repeat([1, 2], options.people)
    template_pairs = [
        templates_of(int(who), int(when), options.work, options.scale)
        for who, when in zip(person, session, strict=True)
    ]
    pairs = comparisons(person, session)
    files = []
    for name, place, match in (("prints", 0, fused_match), ("knuckles", 1, ridge_match)):
        sides = [Prepared(pair[place]) for pair in template_pairs]
        files.append(options.work / f"{name}.csv")
        with files[-1].open("w", newline="", encoding="utf-8") as stream:
            rows = csv.writer(stream)
            rows.writerow(["label", "score", "subject_a", "subject_b", "session_a", "session_b"])
            for a, b, genuine in zip(pairs.a, pairs.b, pairs.genuine, strict=True):
                comparison = match(sides[a], sides[b])
                score = f"{comparison.similarity:.5f}" if comparison.compared else ""
                rows.writerow([int(genuine), score, person[a], person[b], session[a], session[b]])
    FITS["llr"] = fit_ratios
    study = splitknit_match.evaluate(
        files, fuse="all", bootstrap=BootstrapSettings(targets=(0.01,), curve_points=0)
    )
    facts: dict[str, Any] = {"what": "simulated people", "people": options.people, "rates": {}}
    for fused_result in study.results:
        figures = {"eer": fused_result.eer, "gar_far_1": fused_result.gar_at(0.01)}
        row = {
            name: [round(100 * v, 1) for v in (f.value, f.low, f.high)]
            for name, f in figures.items()
        }
        facts["rates"][fused_result.scores.name] = row | {
            "d_prime": round(fused_result.intervals.figures["d_prime"].value, 2)
        }
        print(
            f"{fused_result.scores.name:16s}", facts["rates"][fused_result.scores.name], flush=True
        )
    if options.write:
        OUT.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
