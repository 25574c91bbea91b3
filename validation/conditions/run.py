"""Fingers in every condition, photographed and reconstructed: ``python validation/conditions/run.py
SCRATCH``.

Six simulated fingers (or ``--seeds``) x five conditions x severities 0.25 to 1, clean ones beside
them; presets metric, snk and ea-split. A row of SCRATCH/rows.jsonl holds what one preset made of
one capture: error against the truth, quality of the unrolled print, similarity with another, clean
capture of the same finger, and all that the software said. Running it again goes on; ``--keep``
leaves the captures in SCRATCH/captures (84 MB each), for a later run of other presets. ``python
validation/conditions/summary.py SCRATCH`` makes ``conditions.csv`` and ``conditions.json``.
"""

from __future__ import annotations

import argparse
import json
import pickle
from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import splitknit_simulator.finger.finger as drawing
from splitknit.errors import BadInput
from splitknit.pipeline import reconstruct
from splitknit.reconstruction import Reconstruction, surface_of
from splitknit_match.matching.methods import rate
from splitknit_match.matching.ridge import ridge_match
from splitknit_match.matching.surface import surface_template
from splitknit_match.matching.template import Template, pack, unpack
from splitknit_match.prints.folder import advice
from splitknit_match.prints.make import enhance, make_print, measured
from splitknit_match.prints.minutiae import nfiq2
from splitknit_match.prints.sources import source_of
from splitknit_simulator.accuracy import compare
from splitknit_simulator.finger.conditions import Condition
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

SEEDS = (7301, 7302, 7303, 7304, 7305, 7306)
KINDS = ("wet", "dry", "dusty", "scarred", "glossy")
SEVERITIES = (1.0, 0.5, 0.25, 0.75)
PRESETS = ("metric", "snk", "ea-split")
SCALE = 0.35
"""The least at which metric uses its network for the relief, 26 px/mm."""
COMPARED = (
    "ridge_correlation",
    "ridge_gain",
    "normals_mean_deg",
    "shape_rms_mm",
    "surface_rms_mm",
    "ridge_good_area",
    "mask_overlap",
)


def tasks(
    seeds: tuple[int, ...], severities: tuple[float, ...] = SEVERITIES
) -> Iterator[tuple[int, int, str, float]]:
    """Seed, impression, condition and severity; the clean ones first, then the worst."""
    yield from ((seed, 1, "none", 0.0) for seed in seeds)
    yield from ((seed, 0, "none", 0.0) for seed in seeds)
    for severity in severities:
        yield from ((seed, 0, kind, severity) for kind in KINDS for seed in seeds)


def photographed(  # noqa: PLR0917
    scratch: Path,
    seed: int,
    impression: int,
    kind: str,
    severity: float,
    scale: float | None = None,
    *,
    keep: bool = False,
) -> tuple[Any, Any]:
    """A capture and its truth: kept from an earlier run, else simulated."""
    path = scratch / "captures" / f"{seed}_{impression}_{kind}_{severity:g}.pickle"
    if scale is None and path.is_file():
        return pickle.loads(path.read_bytes())
    settings = TwinSettings(scale=scale or SCALE, render=RenderSettings(workers=1))
    if kind != "none":
        settings = replace(settings, condition=Condition(kind, severity))
    both = simulate_capture(seed, settings=settings, impression=impression)
    if keep:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(both, protocol=5))
    return both


def findings_of(result: Reconstruction) -> dict[str, Any]:
    """Every sentence and the figures behind them."""
    white = result.quality["white"]
    return {
        "warnings": list(result.warnings),
        "saturated": max(white["saturated_per_image"]),
        "ridge_contrast": white["ridge_contrast"],
    }


def print_facts(result: Reconstruction) -> dict[str, Any]:
    """Our quality of the unrolled print, NFIQ 2, and the advice."""
    unrolled = make_print(source_of(result), "unroll")
    quality = measured(unrolled, enhance(unrolled))
    return {
        "print_quality": quality.score,
        "print_figures": asdict(quality.figures),
        "nfiq2": nfiq2(unrolled.image),
        "advice": list(map(str, advice(quality))),
    }


def row_of(
    capture: Any, truth: Any, preset: str, gallery_template: Template | None
) -> tuple[dict, Template | None]:
    """What one preset makes of a capture, and its template."""
    try:
        result = reconstruct(capture, preset)
    except BadInput as refusal:
        return {"exit": 2, "refused": str(refusal)}, None
    figures = compare(result, truth).figures
    row = {
        "exit": 0,
        **{name: figures[name] for name in COMPARED},
        **findings_of(result),
        **print_facts(result),
    }
    template = surface_template(surface_of(result))
    if gallery_template is not None:
        match = ridge_match(template, gallery_template)
        row |= {
            "similarity": match.similarity,
            "fmr": rate(match.similarity, "ridge", None).fmr if match.compared else 1.0,
        }
    return row, template


def main() -> None:
    """Simulate, reconstruct, measure, append."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--presets", nargs="+", default=PRESETS, choices=PRESETS)
    parser.add_argument("--severities", type=float, nargs="+", default=SEVERITIES)
    parser.add_argument("--scale", type=float, help="other than 0.35; captures are then not kept")
    parser.add_argument(
        "--keep", action="store_true", help="leave the captures in SCRATCH/captures"
    )
    parser.add_argument("--most", type=int, default=10**6, help="captures in this run")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    drawing.master_print = lru_cache(maxsize=8)(drawing.master_print)  # type: ignore[assignment]
    options.scratch.mkdir(parents=True, exist_ok=True)
    kept = options.scratch / "rows.jsonl"
    rows = [json.loads(line) for line in kept.read_text().splitlines()] if kept.is_file() else []
    done = {
        (row["seed"], row["impression"], row["kind"], row["severity"], row["preset"])
        for row in rows
    }
    gallery = options.scratch / "gallery"
    left = options.most
    for seed, impression, kind, severity in tasks(tuple(options.seeds), tuple(options.severities)):
        missing = [p for p in options.presets if (seed, impression, kind, severity, p) not in done]
        if not missing or left == 0:
            continue
        left -= 1
        capture, truth = photographed(
            options.scratch,
            seed,
            impression,
            kind,
            severity,
            options.scale,
            keep=options.keep and not options.scale,
        )
        for preset in missing:
            template_file = gallery / f"{seed}_{preset}.npz"
            gallery_template = None
            if impression != 1 and template_file.is_file():
                gallery_template = unpack(bytes(np.load(template_file)["payload"]))
            row, template = row_of(capture, truth, preset, gallery_template)
            if impression == 1 and template is not None:
                _keep(template_file, template)
            row = {
                "seed": seed,
                "impression": impression,
                "kind": kind,
                "severity": severity,
                "preset": preset,
                **row,
            }
            with kept.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(seed, impression, kind, severity, preset, flush=True)


def _keep(path: Path, template: Template) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, payload=np.frombuffer(pack(template), dtype=np.uint8))


if __name__ == "__main__":
    main()
