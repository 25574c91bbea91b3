"""The command line: ``splitknit VERB``.

Exit code 0: done; 2: the input cannot be used (one sentence on stderr says why and what to do); 1: our failure;
130: interrupted. Results go to files, facts to stdout, everything else to stderr.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import sys
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from splitknit import __version__
from splitknit.apps.capture_verb import add_capture
from splitknit.apps.evaluate_verb import add_evaluate
from splitknit.apps.match_verb import add_match
from splitknit.apps.verb import Outcome, Progress, Refused, add_settings, natural, new_verb, scale
from splitknit.check import BadInput, require

DONE, OUR_FAILURE, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
PRESETS = ("metric", "snk", "pr", "ea")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code."""
    if arguments is None:  # we are the program: a polite kill cleans up as Ctrl-C does
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    parser = build_parser()
    try:
        options = parser.parse_args(arguments)
        if options.verb is None:
            parser.print_help(sys.stderr)
            return BAD_INPUT
    except SystemExit as stop:
        return int(stop.code or 0)
    return _guarded(options)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with all verbs."""
    parser = argparse.ArgumentParser(
        prog="splitknit",
        description="Metric 3D fingerprints from photographs of a finger under one light after another.",
        epilog="Exit code: 0 done, 2 the input cannot be used, 1 our failure. 'splitknit VERB --help' tells more.",
    )
    parser.add_argument("--version", action="version", version=f"splitknit {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", title="verbs")
    _add_demo(verbs)
    _add_simulate(verbs)
    _add_reconstruct(verbs)
    _add_separate(verbs)
    _add_train(verbs)
    add_capture(verbs)
    _add_calibrate(verbs)
    _add_rig(verbs)
    add_evaluate(verbs)
    add_match(verbs)
    return parser


def _add_demo(verbs: Any) -> None:
    verb = new_verb(verbs, "demo", "simulate a finger, reconstruct it, compare it with the truth", run_demo)
    verb.add_argument("--out", type=Path, default=Path("demo"), metavar="DIR", help="folder to write (default: demo)")
    verb.add_argument("--seed", type=natural, default=1, help="which finger (default: 1)")
    verb.add_argument(
        "--scale", type=scale, default=0.5, help="size of the images, 1 = 3200 x 2200 pixels (default: 0.5)"
    )


def _add_simulate(verbs: Any) -> None:
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
    add_settings(verb)
    add_population_options(verb)


def _add_reconstruct(verbs: Any) -> None:
    verb = new_verb(verbs, "reconstruct", "turn a capture folder into a 3D fingerprint in millimetres", run_reconstruct)
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help="capture folder (with capture.json)")
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write the results into")
    verb.add_argument(
        "--preset",
        choices=PRESETS,
        default="metric",
        help="metric (ours, the default), or the thesis's snk (all of it), pr (direct light, no split), ea (plain)",
    )
    verb.add_argument(
        "--rig", type=Path, default=None, metavar="RIG", help="rig file instead of the capture's, such as a calibration"
    )
    add_settings(verb)


def _add_separate(verbs: Any) -> None:
    verb = new_verb(verbs, "separate", "split images under fine patterns into direct and global light", run_separate)
    verb.add_argument("folder", type=Path, metavar="FOLDER", help="folder of images, with or without separation.json")
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write the results into")
    verb.add_argument(
        "--method",
        choices=("checkerboard", "symmetry", "sinusoid", "occluder", "single"),
        default=None,
        help="how the light was patterned (default: what separation.json says, else checkerboard); symmetry: "
        "checkerboards without noise, an odd number of equal steps a period each way",
    )
    verb.add_argument("--alpha", type=float, default=None, help="share of the pattern that is lit (default: 0.5)")
    verb.add_argument("--dark", type=float, default=None, help="brightness of its unlit part (default: 0)")
    verb.add_argument(
        "--patterns",
        default=None,
        metavar="WHERE",
        help="folder of state images, white = lit, or 'estimate' to find the states in the images: no bias by noise",
    )
    verb.add_argument("--encoding", choices=("linear", "srgb"), default=None, help="of the images (default: linear)")
    verb.add_argument(
        "--check-px",
        type=float,
        default=None,
        help="side of a check on the images: for one image, and for noisy checkerboards on skin (whose states are "
        "found in the images unless --patterns gives them)",
    )
    verb.add_argument("--block", type=natural, default=None, help="side of a block of the result, for one image")


def _add_train(verbs: Any) -> None:
    from splitknit.apps.training.train_relief_verb import add_relief_options  # noqa: PLC0415
    from splitknit.apps.training.train_shape_verb import add_shape_options  # noqa: PLC0415
    from splitknit.apps.training.train_verb import add_separation_options  # noqa: PLC0415

    kinds = _group(verbs, "train", "train a network on simulated skin (needs torch)")
    verb = new_verb(kinds, "separation", "the thesis's U-Net, which separates direct light", run_train_separation)
    add_separation_options(verb)
    verb = new_verb(kinds, "relief", "the network of the preset metric, which draws relief and glare", run_train_relief)
    add_relief_options(verb)
    verb = new_verb(kinds, "shape", "the network of the preset metric that mends the shape", run_train_shape)
    add_shape_options(verb)


def _add_calibrate(verbs: Any) -> None:
    from splitknit.apps.calibration.calibrate_camera_verb import add_camera  # noqa: PLC0415
    from splitknit.apps.calibration.calibrate_lights_verb import add_lights  # noqa: PLC0415
    from splitknit.apps.calibration.calibrate_radiometry_verb import add_radiometry  # noqa: PLC0415

    kinds = _group(verbs, "calibrate", "measure a rig: its camera, its lights, its sensor")
    # one line a kind: from splitknit.apps.calibrate_KIND_verb import add_KIND; add_KIND(kinds)
    add_camera(kinds)
    add_radiometry(kinds)
    add_lights(kinds)


def _add_rig(verbs: Any) -> None:
    from splitknit.apps.building.rig_cad_verb import add_cad  # noqa: PLC0415
    from splitknit.apps.building.rig_circuit_verb import add_circuit  # noqa: PLC0415
    from splitknit.apps.building.rig_optimise_verb import add_optimise  # noqa: PLC0415
    from splitknit.apps.building.rig_target_verb import add_target  # noqa: PLC0415

    kinds = _group(verbs, "rig", "plan and build a rig: parts, circuit, dimensions")
    # one line a kind: from splitknit.apps.rig_KIND_verb import add_KIND; add_KIND(kinds)
    add_target(kinds)
    add_optimise(kinds)
    add_circuit(kinds)
    add_cad(kinds)


def _group(verbs: Any, name: str, does: str) -> Any:
    """A verb that is followed by another."""
    group = verbs.add_parser(name, help=does, description=does[0].upper() + does[1:] + ".")
    return group.add_subparsers(dest="kind", metavar="WHAT", title="what", required=True)


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
    if options.bench:
        return _run_bench(options, changes)
    with Progress(options) as progress:
        facts = simulate_to_folder(
            options.out,
            seed=options.seed,
            pattern=options.pattern,
            scale=options.scale,
            rig=options.rig,
            changes=changes,
            progress=progress.update,
        )
    rows, columns = facts["image_size"]
    lines = [
        f"Simulated capture of a {facts['pattern']} written to {options.out}: "
        f"{facts['images']} images of {columns} x {rows} pixels, with truth.",
        f"Next: splitknit reconstruct {options.out} --out RESULT",
    ]
    return facts, lines


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


def run_separate(options: argparse.Namespace) -> Outcome:
    """Write direct and global light."""
    from splitknit.apps.separate import separate_to_folder  # noqa: PLC0415

    names = ("method", "alpha", "dark", "patterns", "encoding", "check_px", "block")
    with Progress(options) as progress:
        facts = separate_to_folder(
            options.folder,
            options.out,
            changes={name: getattr(options, name) for name in names},
            progress=progress.update,
        )
    lines = [
        f"{len(facts['images'])} images separated by {facts['method']}: "
        f"{100 * facts['direct_share']:.0f} % of the light is direct in the median.",
        f"Written to {options.out}: {', '.join(facts['files'])}.",
    ]
    if facts["against_white"] is not None:
        error = facts["against_white"]["median_error"]
        lines.append(f"Direct and global light add up to the white image within {100 * error:.1f} % in the median.")
    lines += [f"Please note: {warning}" for warning in facts["warnings"]]
    return facts, lines


def run_train_separation(options: argparse.Namespace) -> Outcome:
    """Build the data set and train the network for direct light."""
    from splitknit.apps.training.train_verb import run_separation  # noqa: PLC0415

    with Progress(options) as progress:
        return run_separation(options, progress.update)


def run_train_relief(options: argparse.Namespace) -> Outcome:
    """Simulate the fingers and train the network for relief and glare."""
    from splitknit.apps.training.train_relief_verb import run_relief  # noqa: PLC0415

    with Progress(options) as progress:
        return run_relief(options, progress.update)


def run_train_shape(options: argparse.Namespace) -> Outcome:
    """Simulate and reconstruct the fingers, and train the network that mends the shape."""
    from splitknit.apps.training.train_shape_verb import run_shape  # noqa: PLC0415

    with Progress(options) as progress:
        return run_shape(options, progress.update)


def _guarded(options: argparse.Namespace) -> int:
    """Run the verb; turn what goes wrong into one line and an exit code."""
    try:
        facts, lines = options.run(options)
        _say(json.dumps(facts, indent=1, allow_nan=False) if options.json else "\n".join(lines))
    except BadInput as error:
        if options.json and isinstance(error, Refused):
            with contextlib.suppress(BrokenPipeError):
                _say(json.dumps(error.facts, indent=1, allow_nan=False))
        return _fail(options, f"splitknit: error: {_one_line(error)}", BAD_INPUT)
    except KeyboardInterrupt:
        return _fail(options, "splitknit: interrupted; nothing was left half-written.", INTERRUPTED)
    except BrokenPipeError:
        # the reader of stdout has gone (`splitknit ... | head`): the work is done, so this is no error
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except MemoryError:
        message = "splitknit: error: not enough memory for this capture; use smaller images or more memory."
        return _fail(options, message, OUR_FAILURE)
    except Exception as error:
        message = (
            f"splitknit: {type(error).__name__}: {_one_line(error)} (this is our failure; --traceback shows where)"
        )
        return _fail(options, message, OUR_FAILURE)
    return DONE


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _fail(options: argparse.Namespace, message: str, code: int) -> int:
    if options.traceback:
        traceback.print_exc()
    print(message, file=sys.stderr)
    return code


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or "no further words"


if __name__ == "__main__":
    sys.exit(main())
