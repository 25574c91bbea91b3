"""``splitknit rig``: the printed target, the study of dimensions, the LED board and the parts of a rig."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, add_settings, group, natural, new_verb
from splitknit.errors import BadInput, require

_SHEET = "target.pdf"
_SHOWN = 10
"""Rigs of a sweep that are listed."""
_BUDGETS: dict[str, dict[str, Any]] = {
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


def add_rig(verbs: Any) -> None:
    """Add ``splitknit rig`` and its verbs."""
    kinds = group(verbs, "rig", "plan and build a rig: parts, circuit, dimensions")
    _add_target(kinds)
    _add_optimise(kinds)
    _add_circuit(kinds)
    _add_cad(kinds)
    verb = new_verb(kinds, "phantom", "write a finger with ridges of known height for a resin printer (STL)", _phantom)
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")


def _phantom(options: argparse.Namespace) -> Outcome:
    from splitknit.rig.phantom import phantom_to_folder

    facts = phantom_to_folder(options.out)
    size = " x ".join(f"{side:.1f}" for side in facts["size_mm"])
    line = f"{options.out / 'phantom.stl'}: {size} mm, {len(facts['fields'])} fields of ridges, {facts['triangles']} "
    return {"out": str(options.out), **facts}, [
        f"{line}triangles, closed; its heights as drawn are B of 'splitknit compare A {options.out} --out R'."
    ]


def _add_target(kinds: Any) -> None:
    verb = new_verb(
        kinds, "target", "write checkerboards and the calibration disc as a PDF at true scale", _write_target
    )
    verb.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder to write, for target.pdf; or a PDF file"
    )
    verb.add_argument("--board", default="9x6", metavar="CxR", help="inner corners each way (default: 9x6)")
    verb.add_argument("--square-mm", type=float, default=3.0, metavar="N", help="side of a square (default: 3)")
    verb.add_argument(
        "--dot-mm", type=float, default=10.0, metavar="N", help="spacing of the disc's dots (default: 10)"
    )


def _write_target(options: argparse.Namespace) -> Outcome:
    from splitknit.calibration.targets import Board
    from splitknit.io.atomic import atomic_folder, write_file
    from splitknit.io.targets import check_file, check_target
    from splitknit.rig.target import (
        DOT_MM,
        PRODUCER,
        RULER_MM,
        TargetSettings,
        dots_mm,
        target_pdf,
    )

    as_file = options.out.suffix.lower() == ".pdf"
    sheet = options.out if as_file else options.out / _SHEET
    if as_file:
        check_file(sheet, "a sheet of targets", lambda data: data.startswith(b"%PDF") and PRODUCER in data)
    else:
        check_target(options.out, _SHEET, "an earlier sheet of targets")
    board = Board.named(options.board, options.square_mm)
    settings = TargetSettings(
        columns=board.columns, rows=board.rows, square_mm=options.square_mm, spacing_mm=options.dot_mm
    )
    data = target_pdf(settings)
    if as_file:
        write_file(options.out, data)
    else:
        with atomic_folder(options.out) as folder:
            (folder / _SHEET).write_bytes(data)
    across, down = settings.copies
    width, height = settings.board_mm
    facts = {
        "out": str(options.out),
        "board": {"inner_corners": [board.columns, board.rows], "square_mm": options.square_mm},
        "board_mm": [width, height],
        "copies": across * down,
        "disc": {"dots": len(dots_mm(settings)), "dot_mm": DOT_MM, "spacing_mm": settings.spacing_mm},
        "ruler_mm": RULER_MM,
    }
    lines = [
        f"{sheet}: {across * down} checkerboards of {width:g} x {height:g} mm (--board "
        f"{board.columns}x{board.rows}: inner corners, where four squares meet; {board.columns + 1} x {board.rows + 1} "
        f"squares), and the disc with {len(dots_mm(settings))} dots, on one sheet of A4.",
        f"Print it at 100 %; the ruler must measure {RULER_MM:g} mm.",
    ]
    return facts, lines


def _add_optimise(kinds: Any) -> None:
    verb = new_verb(kinds, "optimise", "sweep the rig's dimensions on simulated fingers and find the best", _optimise)
    verb.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder to write; a sweep left in it goes on"
    )
    verb.add_argument(
        "--budget",
        choices=tuple(_BUDGETS),
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
    study.add_argument("--fingers", type=natural, metavar="N", help="simulated fingers a rig")
    study.add_argument("--method", choices=("ea", "metric"), default="ea", help="of reconstruction (default: ea)")
    study.add_argument("--view", choices=("perspective", "orthographic"), default="perspective", help="of the camera")
    study.add_argument(
        "--objective",
        choices=("rms", "ridges", "normals"),
        default="rms",
        help="error that is minimised: of the surface (rms, the default), of the ridges, or of the normals",
    )
    study.add_argument("--f-number", type=float, metavar="N", help="of the lens (default: 4)")
    study.add_argument("--half-angle-deg", type=float, metavar="N", help="of the LEDs' beams (default: 30)")
    study.add_argument("--led-drop-mm", type=float, metavar="N", help="LEDs below the lens (default: 0)")
    verb.add_argument("--workers", type=natural, default=2, metavar="N", help="processes (default: 2)")


def _optimise(options: argparse.Namespace) -> Outcome:
    """Sweep, write, and report what came out."""
    from splitknit.io.atomic import write_file
    from splitknit.io.provenance import json_text, plain_json
    from splitknit.rig.candidates import grid
    from splitknit.rig.optimise import OBJECTIVES, results_csv, summarise, sweep_rigs

    started = time.perf_counter()
    budget = _BUDGETS[options.budget]
    candidates = grid(
        _numbers("--heights-mm", options.heights_mm, budget["heights"]),
        _numbers("--radii-mm", options.radii_mm, budget["radii"]),
        _numbers("--powers-w", options.powers_w, budget["powers"]),
        _numbers("--tilts-deg", options.tilts_deg, (None,)),
        _numbers("--resolutions", options.resolutions, budget["resolutions"]),
    )
    study = _study(options, budget)
    with Progress(options) as progress:
        records = sweep_rigs(options.out, candidates, study, workers=options.workers, progress=progress.update)
    summary = summarise(records, OBJECTIVES[options.objective])
    compared = summary.pop("compared")
    best = next(one for one in records if one["candidate"]["name"] == summary["best"])
    facts = {
        **summary,
        "objective": options.objective,
        "best": {**best["candidate"], **best["mean"], **compared[summary["best"]]},
    }
    document = {"format": "splitknit-rig-results", "version": 2, "study": plain_json(study), **facts}
    write_file(options.out / "results.csv", results_csv(records, compared, summary["pareto"]))
    write_file(
        options.out / "results.json",
        json_text({**document, "compared": compared, "records": records}).encode("ascii"),
    )
    counts = summary["counts"]
    seconds = time.perf_counter() - started
    lines = [
        f"{len(records)} rigs in {seconds:.0f} s: {counts['done']} measured, {counts['refused']} refused by a "
        f"constraint, {counts['failed']} failed. Error {summary['figure']}, smallest first; x: on the Pareto front of "
        "error, power and size.",
        "  height  radius  power     beams  px/mm    error",
    ]
    done = {one["candidate"]["name"]: one["candidate"] for one in records if one["mean"] is not None}
    for name in sorted(done, key=lambda name: (compared[name]["value"], name))[:_SHOWN]:
        one, error = done[name], compared[name]["value"]
        tilt = "at centre" if one["tilt_deg"] is None else f"{one['tilt_deg']:g} deg"
        size = (
            f"{one['height_mm']:3g} mm {one['radius_mm']:4g} mm {one['power_w']:4g} W {tilt:>9} {one['px_per_mm']:6g}"
        )
        lines.append(f"  {size} {error:8.3g}{' x' if name in summary['pareto'] else ''}")
    if study.fingers > 1:
        lines.append(f"{len(summary['as_good'])} of {counts['done']} rigs are indistinguishable from the best.")
    lines += [f"{number} left out: {words}" for words, number in list(summary["reasons"].items())[:3]]
    lines.append(f"All figures: {options.out / 'results.csv'}; finger by finger: {options.out / 'results.json'}.")
    return {**facts, "out": str(options.out), "files": ["results.csv", "results.json"], "total_s": seconds}, lines


def _study(options: argparse.Namespace, budget: dict[str, Any]) -> Any:
    from splitknit.rig.candidates import BuildSettings, PhotonSettings
    from splitknit.rig.optimise import Study

    build = _given(half_angle_deg=options.half_angle_deg, led_drop_mm=options.led_drop_mm)
    return Study(
        method=options.method,
        fingers=budget["fingers"] if options.fingers is None else options.fingers,
        build=BuildSettings(view=options.view, **build),
        photons=PhotonSettings(**_given(f_number=options.f_number)),
    )


def _given(**values: float | str | None) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _numbers(option: str, text: str | None, default: tuple[Any, ...]) -> tuple[Any, ...]:
    """Numbers with commas between them; ``centre``, of beams, is None."""
    if text is None:
        return default
    words = [word.strip() for word in text.split(",") if word.strip()]
    require(len(words) > 0, f"{option} is empty; list numbers with commas between them, as {option} 100,140.")
    values: list[float | None] = []
    for word in words:
        try:
            values.append(None if option == "--tilts-deg" and word == "centre" else float(word))
        except ValueError as error:
            raise BadInput(f"{option} must list numbers with commas between them, but it holds '{word}'.") from error
    return tuple(values)


def _add_circuit(kinds: Any) -> None:
    verb = new_verb(
        kinds,
        "circuit",
        "the LED board: layout, Gerbers, schematic, parts, pin map, light on eye and skin",
        _design_circuit,
    )
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    verb.add_argument("--rig", type=Path, metavar="RIG", help="rig file (default: the thesis's 14 LEDs)")
    _add_films(verb)
    verb.add_argument(
        "--topology",
        choices=("sink", "switch"),
        help="sink: the current does not depend on supply and LED (the default); switch: the thesis's stage",
    )
    verb.add_argument("--supply-v", type=float, help="voltage of the LEDs' supply (default: 9)")
    add_settings(verb)


def _add_films(verb: Any) -> None:
    verb.add_argument(
        "--films",
        choices=("servo", "hand", "neighbours"),
        help="polarising films: an analyser that a servo or a hand turns, or crossed film on further white LEDs beside "
        "the first ones (default: as the rig file has it, else none)",
    )


def _design_circuit(options: argparse.Namespace) -> Outcome:
    """Design the board and write it."""
    from splitknit.cli.options import read_changes
    from splitknit.io.rig import read_rig
    from splitknit.model import default_rig
    from splitknit.rig.circuit import CircuitSettings
    from splitknit.rig.circuit_files import circuit_to_folder
    from splitknit.rig.films import with_films
    from splitknit.settings import flatten, override

    given = _given(topology=options.topology, supply_v=options.supply_v)
    # ``circuit.supply_v`` and ``supply_v`` are the same setting
    changes = flatten(read_changes(options.settings, options.assignments))
    named = {name.removeprefix("circuit."): value for name, value in changes.items()}
    settings = override(CircuitSettings(), {**given, **named})
    rig = with_films(read_rig(options.rig) if options.rig else default_rig(), options.films)
    facts = circuit_to_folder(options.out, rig, settings)
    lines = [f"LED board of {len(facts['leds'])} stages ({settings.topology}, {settings.supply_v:g} V):"]
    for band, stage in facts["stages"].items():
        low, middle, high = stage["current_ma"]
        values = ", ".join(f"{role} {r['ohm']:g} ohm {r['rating_w']:g} W" for role, r in stage["resistors"].items())
        lines.append(f"  {band:5s} {middle:.0f} mA ({low:.0f} to {high:.0f} over all tolerances): {values}")
    lines.append(f"  fuse {facts['fuse_ma']} mA, for one LED at a time")
    board = facts["board"]
    if "misfit" in board:
        lines.append(
            f"  the LED board is left out: {board['misfit']}; lay out your own with the values of circuit.json"
        )
    else:
        lines.append("  laid out on {:g} x {:g} mm with two layers; not yet made".format(*board["size_mm"]))
    lines.append(
        "Light on eye and skin, all LEDs on, against the exempt group of IEC 62471 (calculated, no certificate):"
    )
    for hazard in facts["safety"]:
        lines.append(
            f"  {hazard['leds']:5s} {hazard['hazard']:26s} {hazard['value']:9.4g} of {hazard['limit']:.4g} "
            f"{hazard['unit']}, margin {hazard['margin']:.3g} ({hazard['margin_with_a_shorted_transistor']:.3g} with a "
            "shorted transistor"
            + (f", {hazard['margin_without_films']:.3g} without films)" if "films" in facts else ")")
        )
    lines.append(f"Written to {options.out}: {', '.join(facts['files'])}; rig.json holds the pin map.")
    return facts, lines


def _add_cad(kinds: Any) -> None:
    verb = new_verb(kinds, "cad", "draw the parts of a rig for a 3D printer: STL, STEP, pictures, checks", _draw_parts)
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    verb.add_argument("--rig", type=Path, metavar="FILE", help="rig file (default: the thesis's rig, 14 cm, 14 LEDs)")
    _add_films(verb)
    verb.add_argument("--below", action="store_true", help="put the assembly together with the camera below the finger")
    verb.add_argument("--no-pictures", action="store_true", help="leave the pictures out")
    add_settings(verb)


def _draw_parts(options: argparse.Namespace) -> Outcome:
    """Draw, check and write the parts."""
    from splitknit.cli.options import read_changes  # verbs import what they need
    from splitknit.rig.cad import cad_to_folder

    changes = read_changes(options.settings, options.assignments)
    with Progress(options) as progress:
        facts = cad_to_folder(
            options.out,
            rig_file=options.rig,
            changes=changes,
            below=options.below,
            films=options.films,
            pictures=not options.no_pictures,
            progress=progress.update,
        )
    return facts, _part_lines(facts, options.out)


def _part_lines(facts: dict[str, Any], out: Path) -> list[str]:
    parts, dimensions = facts["parts"], facts["dimensions"]
    needed = sum(part["mass_g"] * part["quantity"] for part in parts.values() if part["needed"])
    tilts = sorted({led["tilt_deg"] for led in dimensions["leds"]})
    tilt = f"{tilts[0]:.1f} deg" if tilts[-1] - tilts[0] < 0.1 else f"{tilts[0]:.1f} to {tilts[-1]:.1f} deg"
    lines = [
        f"{len(parts)} parts drawn, all closed; the rig stands {dimensions['total_height_mm']:.0f} mm high, its "
        f"{len(dimensions['leds'])} LED holes are tilted by {tilt}, the nail is {dimensions['nail']['height_mm']:g} mm "
        f"high.",
        f"What the rig needs weighs {needed:.0f} g in solid PLA, less with infill.",
    ]
    for name, part in parts.items():
        size = " x ".join(f"{value:.0f}" for value in part["size_mm"])
        checks = part["checks"]
        lines.append(
            f"  {name:22s} {size} mm, {part['mass_g']:.0f} g, thinnest wall {checks['wall']['smallest_mm']:.1f} mm, "
            f"longest bridge {checks['overhang']['bridge_mm']:.1f} mm"
        )
        lines += [f"    {finding}" for finding in part["findings"]]
    pictures = "pictures/, " if facts["pictures"] else ""
    return [*lines, f"Written to {out}: stl/, step/, assembly.step, {pictures}parts.json."]
