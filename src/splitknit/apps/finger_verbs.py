"""``splitknit demo``, ``simulate`` and ``reconstruct``: options in, files and facts out."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from splitknit.apps.verb import PRESETS, Outcome, Progress, add_settings, natural, new_verb, scale
from splitknit.errors import BadInput, require


def add_demo(verbs: Any) -> None:
    """Add ``splitknit demo``."""
    verb = new_verb(verbs, "demo", "simulate a finger, reconstruct it, compare it with the truth", run_demo)
    verb.add_argument("--out", type=Path, default=Path("demo"), metavar="DIR", help="folder to write (default: demo)")
    verb.add_argument("--seed", type=natural, default=1, help="which finger (default: 1)")
    verb.add_argument(
        "--scale", type=scale, default=0.5, help="size of the images, 1 = 3200 x 2200 pixels (default: 0.5)"
    )


def add_simulate(verbs: Any) -> None:
    """Add ``splitknit simulate``."""
    from splitknit.apps.simulate_population_verb import add_population_options  # noqa: PLC0415

    verb = new_verb(
        verbs,
        "simulate",
        "photograph a simulated finger, a population of them, or what calibrates a simulated rig",
        run_simulate,
    )
    verb.add_argument(
        "what",
        nargs="?",
        choices=("finger", "population"),
        default="finger",
        help="one capture (finger, the default), or many people's fingers in several sessions",
    )
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="capture folder to write")
    verb.add_argument("--seed", type=natural, default=0, help="which finger, or which population (default: 0)")
    verb.add_argument(
        "--bench",
        action="store_true",
        help="not a finger, but all that calibrates the rig that person SEED built: board, disc, nail, white card",
    )
    verb.add_argument("--rig", type=Path, default=None, metavar="RIG", help="rig file that photographs the finger")
    verb.add_argument(
        "--pattern", default=None, help="loop, whorl, arch or another master print the twin knows (default: drawn)"
    )
    verb.add_argument(
        "--scale", type=scale, default=None, help="size of the images, 1 = 3200 x 2200 pixels (default: the twin's)"
    )
    verb.add_argument(
        "--motion",
        type=float,
        default=None,
        metavar="MM",
        help="the finger moves by MM during the capture, as a hand does that is held still (0.5 is much)",
    )
    verb.add_argument(
        "--lights",
        choices=("white", "coloured", "coloured9"),
        default="white",
        help="LEDs of the visible band: seven white ones (the default), or six or nine coloured ones, of which a red, "
        "a green and a blue one share an exposure",
    )
    verb.add_argument(
        "--condition",
        choices=("none", "wet", "dry", "dusty", "scarred", "glossy"),
        default=None,
        help="what is the matter with the finger's skin (default: none)",
    )
    verb.add_argument(
        "--severity", type=float, default=None, metavar="S", help="of the condition: 0 (nothing) to 1 (default: 1)"
    )
    verb.add_argument(
        "--mirrors",
        default=None,
        metavar="NAMES",
        help="mirrors beside the finger, seen in the same picture: left, right, tip, or several with commas between",
    )
    verb.add_argument("--no-nir", action="store_true", help="a rig with mirrors does without NIR LEDs")
    verb.add_argument(
        "--impression", type=natural, default=0, help="which capture of the finger: pose and noise change (default: 0)"
    )
    add_settings(verb)
    add_population_options(verb)


def add_reconstruct(verbs: Any) -> None:
    """Add ``splitknit reconstruct``."""
    verb = new_verb(verbs, "reconstruct", "turn a capture folder into a 3D fingerprint in millimetres", run_reconstruct)
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help="capture folder (with capture.json)")
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write the results into")
    verb.add_argument(
        "--preset",
        choices=PRESETS,
        default="metric",
        help="metric (ours, the default), or the thesis's snk (all of it), pr (direct light, no split), ea (plain), or "
        "another published case: kumar, zheng, lin, xie",
    )
    verb.add_argument(
        "--rig", type=Path, default=None, metavar="RIG", help="rig file instead of the capture's, such as a calibration"
    )
    verb.add_argument(
        "--shape",
        choices=("nir", "white", "mirror"),
        default=None,
        help="where the finger's shape comes from: near-infrared (nir, the default), white light, or its outlines in "
        "mirrors beside it (mirror)",
    )
    add_settings(verb)


def run_demo(options: argparse.Namespace) -> Outcome:
    """Simulate, reconstruct, compare."""
    from splitknit.apps.demo import demo  # noqa: PLC0415 - verbs import what they need, so that --help is quick

    with Progress(options) as progress:
        facts = demo(options.out, seed=options.seed, scale=options.scale, progress=progress.update)
    figures = facts["comparison"]
    lines = [
        f"A simulated finger was photographed, reconstructed and compared with the truth in {facts['total_s']:.0f} s."
    ]
    for preset, figure in figures.items():
        lines.append(
            f"  {preset:7s} surface rms {figure['surface_rms_mm']:.3f} mm, "
            f"ridge correlation {figure['ridge_correlation']:.2f}, ridge gain {figure['ridge_gain']:.2f}"
        )
    lines += [f"Open {options.out / 'report.html'} in a browser. Also written:"]
    lines += [f"  {options.out / name}: {what}" for name, what in facts["written"].items()]
    return facts, lines


def run_simulate(options: argparse.Namespace) -> Outcome:
    """Write a simulated capture."""
    from splitknit.apps.commands import simulate_to_folder  # noqa: PLC0415
    from splitknit.apps.options import read_changes  # noqa: PLC0415
    from splitknit.apps.simulate_population_verb import refuse_population_options, run_population  # noqa: PLC0415

    if options.what == "population":
        return run_population(options)
    refuse_population_options(options)
    changes = read_changes(options.settings, options.assignments)
    if options.motion is not None:
        require(not options.bench, "--bench and --motion do not go together: the bench has no finger.")
        changes = {**changes, "motion.amplitude_mm": options.motion}
    require(
        options.severity is None or options.condition not in (None, "none"),
        "--severity says how bad a --condition is; name one.",
    )
    if options.condition is not None:
        require(not options.bench, "--bench and --condition do not go together: the bench has no finger.")
        worst = {} if options.severity is None else {"condition.severity": options.severity}
        changes = {**changes, "condition.kind": options.condition, **worst}
    changes = _mirror_changes(options) | changes
    if options.lights != "white":
        require(not options.bench, "--bench and --lights do not go together: what is calibrated has white LEDs.")
    if options.bench:
        return _run_bench(options, changes)
    with Progress(options) as progress:
        facts = simulate_to_folder(
            options.out,
            seed=options.seed,
            pattern=options.pattern,
            scale=options.scale,
            rig=options.rig,
            lights=options.lights,
            impression=options.impression,
            changes=changes,
            progress=progress.update,
        )
    rows, columns = facts["image_size"]
    lines = [
        f"Simulated capture of a {facts['pattern']} written to {options.out}: "
        f"{facts['images']} images of {columns} x {rows} pixels, with truth.",
        f"Next: splitknit reconstruct {options.out} --out RESULT"
        + (" --preset lin" if options.lights != "white" else ""),
    ]
    return facts, lines


def _mirror_changes(options: argparse.Namespace) -> dict[str, Any]:
    """Settings that ``--mirrors`` and ``--no-nir`` stand for."""
    asked = [name for name in ("mirrors", "no_nir", "impression") if getattr(options, name)]
    if options.bench and asked:
        option = asked[0].replace("_", "-")
        raise BadInput(f"--bench and --{option} do not go together: the bench has no finger.")
    changes: dict[str, Any] = {}
    if options.mirrors is not None:
        changes["mirrors.names"] = tuple(part.strip() for part in options.mirrors.split(","))
    if options.no_nir:
        require(
            options.mirrors is not None or options.rig is not None,
            "--no-nir needs --mirrors: without mirrors the shape of the finger comes from its NIR images.",
        )
        changes["mirrors.nir"] = False
    return changes


def _run_bench(options: argparse.Namespace, changes: Mapping[str, Any]) -> Outcome:
    """Write the photographs that calibrate a simulated rig."""
    from splitknit.apps.calibration.bench_photos import BenchPhotos, bench_to_folder  # noqa: PLC0415
    from splitknit.settings import override  # noqa: PLC0415

    unused = [name for name in ("pattern", "rig") if getattr(options, name) is not None]
    require(not unused, f"--bench and --{unused[0] if unused else ''} do not go together: the bench has no finger.")
    photos = override(BenchPhotos(), changes)
    with Progress(options) as progress:
        facts = bench_to_folder(
            options.out, seed=options.seed, scale=options.scale or 0.5, photos=photos, progress=progress.update
        )
    out = options.out
    lines = [
        f"The bench of rig {facts['seed']} written to {out}: {facts['boards']} photographs of a board of "
        f"{facts['board']} inner corners and {facts['square_mm']:g} mm, the nail in {facts['nails']} places, a card.",
        f"Next: splitknit calibrate camera {out}/board --board {facts['board']} --plane {out}/plane.png "
        f"--rig {out}/rig_drawn.json --out rig.json",
    ]
    return facts, lines


def run_reconstruct(options: argparse.Namespace) -> Outcome:
    """Write a reconstruction."""
    from splitknit.apps.commands import reconstruct_to_folder  # noqa: PLC0415
    from splitknit.apps.options import read_changes  # noqa: PLC0415

    changes = read_changes(options.settings, options.assignments)
    if options.shape is not None:
        changes = {**changes, "shape.source": options.shape}
    with Progress(options) as progress:
        facts = reconstruct_to_folder(
            options.capture,
            options.out,
            preset=options.preset,
            rig=options.rig,
            changes=changes,
            progress=progress.update,
        )
    lines = [
        f"{facts['area_mm2']:.0f} mm² reconstructed with preset {facts['preset']} in {facts['total_s']:.1f} s.",
        f"Written to {options.out}: {', '.join(facts['files'])}.",
    ]
    lines += [f"Please note: {warning}" for warning in facts["warnings"]]
    for preset, figure in facts["comparison"].items():
        lines.append(
            f"Against the truth ({preset}): surface rms {figure['surface_rms_mm']:.3f} mm, "
            f"ridge correlation {figure['ridge_correlation']:.2f}, ridge gain {figure['ridge_gain']:.2f}."
        )
    lines.append(f"Open {options.out / 'report.html'} in a browser.")
    return facts, lines
