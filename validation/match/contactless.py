"""Contactless prints of simulated fingers against presses of the same fingers on six models of
sensors.

    python validation/match/contactless.py --work FOLDER                   # 24 fingers, a table
    python validation/match/contactless.py --work FOLDER --fingers 3  # a quick look, three at least

Contactless: one capture of each finger in a pose of its own, and of it four prints: the relief of
``metric``, on the plane and unrolled, and the photograph, on the plane and unrolled. Contact: one
press of each finger on each sensor. A sensor is a range of areas, of moisture and of stretch
(``pressed_prints.py``). All pairs are compared by the default matcher. Both sides are our
simulator's. Intervals of 95 % draw fingers. FOLDER keeps what is made, so an interrupted run goes
on.
"""

from __future__ import annotations

import argparse
import pickle
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fvc import FAR_0, REAL, kept
from pressed_prints import SENSORS, press

from splitknit import reconstruct
from splitknit.errors import BadInput
from splitknit.io.csv_table import csv_text
from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.scores import Scores, ids_of
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template
from splitknit_match.prints.make import make_print
from splitknit_match.prints.sources import Source, source_of, source_of_capture
from splitknit_simulator import simulate_capture
from splitknit_simulator.finger.finger import draw_finger

OUT = Path(__file__).parent / "tables" / "contactless.csv"
SEED = 96_000
KINDS = {
    "relief": ("relief", None),
    "relief, unrolled": ("unroll", None),
    "photograph": ("photo", None),
    "photograph, unrolled": ("photo", "free"),
}

HEADER = [
    "print",
    "sensor",
    *(
        f"{rate}_percent{end}"
        for rate in ("eer", "gar_at_far_1", "gar_at_far_0.1")
        for end in ("", "_low", "_high")
    ),
    "genuine",
    "impostors",
]


def captured(number: int, folder: Path, scale: float) -> dict[str, Template]:
    """Templates of a finger's contactless prints; those that cannot be made are missing."""
    file = folder / f"finger_{number}_{scale:g}.pickle"
    if not file.is_file():
        capture, _ = simulate_capture(SEED + number, settings={"scale": scale})
        result = reconstruct(capture)
        of_surface = source_of(result)
        photo = source_of_capture(capture, surface=False, photo=True).photo
        source: Source = replace(of_surface, photo=photo)
        by_kind = {}
        for kind, (method, surface) in KINDS.items():
            try:
                by_kind[kind] = print_template(make_print(source, method, surface).image)
            except BadInput as error:
                print(f"finger {number}, {kind}: {error}", flush=True)
        kept(file, by_kind)
    templates: dict[str, Template] = pickle.loads(file.read_bytes())
    return templates


def pressed(number: int, folder: Path) -> dict[str, Template]:
    """Templates of a finger's presses."""
    file = folder / f"presses_{number}.pickle"
    if not file.is_file():
        master = draw_finger(SEED + number).master()
        kept(
            file,
            {
                name: print_template(press(master, k, SENSORS[name]))
                for k, name in enumerate(SENSORS)
            },
        )
    templates: dict[str, Template] = pickle.loads(file.read_bytes())
    return templates


def rates(scores: Scores, settings: BootstrapSettings) -> dict[str, Any]:
    """EER and GAR with intervals by finger, percent."""
    figures = bootstrap(scores, "finger", settings).figures
    names = {"eer": "eer", "gar_far_1": "gar@0.01", "gar_far_0.1": "gar@0.001"}
    row = {name: [round(100 * v, 1) for v in (figures[of].value, figures[of].low, figures[of].high)]
           for name, of in names.items()}  # fmt: skip
    return {**row, "genuine": int(scores.genuine.size), "impostors": int(scores.impostor.size),
            "far_at_0": round(100 * float(np.nanmean(scores.impostor >= 0)), 2)}  # fmt: skip


def table_row(row: dict[str, Any]) -> list[object]:
    """Cells of the table after the print and the sensor."""
    return [*row["eer"], *row["gar_far_1"], *row["gar_far_0.1"], row["genuine"], row["impostors"]]


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--fingers", type=int, default=24)
    parser.add_argument("--scale", type=float, default=0.3, help="of the camera")
    parser.add_argument("--write", action="store_true", help=f"write {OUT.name}")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    settings = BootstrapSettings(replicates=300, targets=(0.01, 0.001, FAR_0), curve_points=0)
    options.work.mkdir(parents=True, exist_ok=True)
    fingers = range(options.fingers)
    presses = [pressed(k, options.work) for k in fingers]
    captures = [captured(k, options.work, options.scale) for k in fingers]
    rows: list[list[object]] = []
    ready = {name: [Prepared(press[name]) for press in presses] for name in REAL}
    for kind in KINDS:
        probes = [Prepared(capture[kind]) if kind in capture else None for capture in captures]
        parts: dict[str, tuple[list[str], list[str], list[float]]] = {}
        for name in REAL:
            pairs = [(i, j) for i in fingers for j in fingers]
            similarities = []
            for i, j in pairs:
                probe, similarity = probes[i], float("nan")
                if probe is not None:
                    match = fused_match(probe, ready[name][j])
                    similarity = match.similarity if match.compared else float("nan")
                similarities.append(similarity)
            parts[name] = [f"{i}" for i, _ in pairs], [f"{j}" for _, j in pairs], similarities
        left, right, score = zip(*(parts[name] for name in REAL), strict=True)
        parts["all"] = [*chain(*left)], [*chain(*right)], [*chain(*score)]
        for name, (own, pressed_fingers, similarity) in parts.items():
            ids = ids_of(own, pressed_fingers)
            row = rates(
                Scores(ids.same, np.array(similarity), finger=ids, name=f"{kind} {name}"), settings
            )
            print(f"{kind:22s}{name:14s}", row, flush=True)
            rows.append([kind, name, *table_row(row)])
    if options.write:
        OUT.write_text(csv_text([HEADER, *rows]), encoding="utf-8")


if __name__ == "__main__":
    main()
