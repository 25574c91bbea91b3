"""The command line of ``splitknit rig optimise``: which rig gives the truest surface."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, natural, new_verb
from splitknit.errors import BadInput, require

BUDGETS: dict[str, dict[str, Any]] = {
    "quick": {
        "heights": (100.0, 140.0, 180.0),
        "radii": (35.0, 52.5, 70.0),
        "powers": (1.0,),
        "resolutions": (8.0,),
        "fingers": 2,
    },
    "full": {
        "heights": (100.0, 120.0, 140.0, 170.0, 200.0),
        "radii": (35.0, 45.0, 52.5, 65.0, 80.0, 100.0),
        "powers": (0.1, 0.4, 1.0, 2.0),
        "resolutions": (10.0,),
        "fingers": 4,
    },
}


def add_optimise(kinds: Any) -> None:
    """Add ``splitknit rig optimise``."""
    verb = new_verb(kinds, "optimise", "sweep the rig's dimensions on simulated fingers and find the best", _run)
    verb.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder to write; a sweep left in it goes on"
    )
    verb.add_argument(
        "--budget",
        choices=tuple(BUDGETS),
        default="quick",
        help="what is swept where no list is given (default: quick)",
    )
    axes = verb.add_argument_group("rigs to compare: numbers with commas between them, every combination is tried")
    axes.add_argument("--heights-mm", metavar="LIST", help="of camera and LEDs above the finger plane")
    axes.add_argument("--radii-mm", metavar="LIST", help="of the circle of LEDs")
    axes.add_argument("--powers-w", metavar="LIST", help="electrical power of one LED")
    axes.add_argument(
        "--tilts-deg", metavar="LIST", help="of the beams from the vertical to the axis, or 'centre' (the default)"
    )
    axes.add_argument("--resolutions", metavar="LIST", help="of the camera, pixels per mm on the finger, 3 to 75.7")
    study = verb.add_argument_group("how they are compared")
    study.add_argument("--fingers", type=natural, default=None, metavar="N", help="simulated fingers a rig")
    study.add_argument(
        "--method", choices=("ea", "ea-poisson", "metric"), default="ea", help="of reconstruction (default: ea)"
    )
    study.add_argument("--material", choices=("opaque", "skin"), default="opaque", help="(default: opaque)")
    study.add_argument(
        "--camera",
        choices=("sensor", "renderer"),
        default="sensor",
        help="sensor: photons and shutter (default); renderer: a fixed exposure without noise, as in Blender",
    )
    study.add_argument("--view", choices=("perspective", "orthographic"), default="perspective", help="of the camera")
    study.add_argument(
        "--objective",
        choices=("hausdorff", "hausdorff95", "rms", "whole", "normals"),
        default="hausdorff",
        help="what is minimised: Hausdorff distance of the print (the default), its 95 %% variant, the rms distance, "
        "the Hausdorff distance of the whole phalange, or the error of the normals",
    )
    study.add_argument("--f-number", type=float, default=None, metavar="N", help="of the lens (default: 4)")
    study.add_argument(
        "--half-angle-deg", type=float, default=None, metavar="N", help="of the LEDs' beams (default: 30)"
    )
    study.add_argument("--led-drop-mm", type=float, default=None, metavar="N", help="LEDs below the lens (default: 0)")
    verb.add_argument("--workers", type=natural, default=2, metavar="N", help="processes (default: 2)")


def _run(options: argparse.Namespace) -> Outcome:
    """Sweep, write, and report what came out."""
    from splitknit.io.atomic import atomic_file  # noqa: PLC0415
    from splitknit.io.provenance import plain_json  # noqa: PLC0415
    from splitknit.report.rig_study import describe, verdict, write_all  # noqa: PLC0415
    from splitknit.rig.candidates import grid  # noqa: PLC0415
    from splitknit.rig.optimise import summarise, sweep  # noqa: PLC0415

    started = time.perf_counter()
    budget = BUDGETS[options.budget]
    candidates = grid(
        _numbers("--heights-mm", options.heights_mm, budget["heights"]),
        _numbers("--radii-mm", options.radii_mm, budget["radii"]),
        _numbers("--powers-w", options.powers_w, budget["powers"]),
        _tilts(options.tilts_deg),
        _numbers("--resolutions", options.resolutions, budget["resolutions"]),
    )
    study = _study(options, budget)
    with Progress(options) as progress:
        records = sweep(options.out, candidates, study, workers=options.workers, progress=progress.update)
    summary = summarise(records, study, options.objective)
    files = write_all(options.out, records, summary, study)
    best = next(one for one in records if one["candidate"]["name"] == summary["best"])
    facts = {
        "counts": summary["counts"],
        "objective": summary["objective"],
        "best": {**best["candidate"], **best["mean"], **summary["compared"][summary["best"]]},
        "thesis": summary["thesis"],
        "as_good": summary["as_good"],
        "pareto": summary["pareto"],
        "reasons": summary["reasons"],
    }
    document = {"format": "splitknit-rig-results", "version": 1, "study": plain_json(study), **facts}
    with atomic_file(options.out / "results.json") as stream:
        full = {**document, "compared": summary["compared"], "records": records}
        stream.write((json.dumps(plain_json(full), indent=1, allow_nan=False) + "\n").encode())
    files["results.json"] = "all figures, finger by finger"
    counts = summary["counts"]
    seconds = time.perf_counter() - started
    lines = [
        f"{len(records)} rigs in {seconds:.0f} s: {counts['done']} measured, {counts['refused']} refused by a "
        f"constraint, {counts['failed']} failed.",
        f"Best: {describe(best)} ({best['mean'][summary['figure']]:.3g} {summary['figure'].split('_')[-1]}).",
        verdict(summary),
    ]
    if study.fingers > 1:
        lines.append(f"{len(summary['as_good'])} of {counts['done']} rigs are indistinguishable from the best.")
    lines += [f"{number} left out: {words}" for words, number in list(summary["reasons"].items())[:3]]
    lines.append(f"Open {options.out / 'index.html'} in a browser; figures are in results.csv and results.json.")
    return {**facts, "out": str(options.out), "files": sorted(files), "total_s": seconds}, lines


def _study(options: argparse.Namespace, budget: dict[str, Any]) -> Any:
    from splitknit.rig.candidates import BuildSettings, Study  # noqa: PLC0415
    from splitknit.rig.photography import PhotonSettings  # noqa: PLC0415

    return Study(
        method=options.method,
        material=options.material,
        camera=options.camera,
        fingers=budget["fingers"] if options.fingers is None else options.fingers,
        build=BuildSettings(
            view=options.view, **_given(half_angle_deg=options.half_angle_deg, led_drop_mm=options.led_drop_mm)
        ),
        photons=PhotonSettings(**_given(f_number=options.f_number)),
    )


def _given(**values: float | None) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _numbers(option: str, text: str | None, default: tuple[float, ...]) -> tuple[float, ...]:
    """Numbers with commas between them."""
    if text is None:
        return default
    words = [word.strip() for word in text.split(",") if word.strip()]
    require(len(words) > 0, f"{option} is empty; list numbers with commas between them, as {option} 100,140.")
    try:
        return tuple(float(word) for word in words)
    except ValueError as error:
        wrong = next(word for word in words if not _is_number(word))
        raise BadInput(f"{option} must list numbers with commas between them, but it holds '{wrong}'.") from error


def _tilts(text: str | None) -> tuple[float | None, ...]:
    if text is None:
        return (None,)
    words = [word.strip() for word in text.split(",") if word.strip()]
    require(len(words) > 0, "--tilts-deg is empty; list angles or 'centre', as --tilts-deg 0,20,centre.")
    return tuple(None if word == "centre" else _numbers("--tilts-deg", word, ())[0] for word in words)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
