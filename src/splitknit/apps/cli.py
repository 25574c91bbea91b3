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
from collections.abc import Sequence
from typing import Any

from splitknit import __version__
from splitknit.apps.batch_verb import add_batch
from splitknit.apps.capture_verb import add_capture
from splitknit.apps.enroll_verb import add_enroll
from splitknit.apps.evaluate_verb import add_evaluate
from splitknit.apps.finger_verbs import add_demo, add_reconstruct, add_simulate
from splitknit.apps.gallery_verb import add_gallery_verbs
from splitknit.apps.identify_verb import add_identify
from splitknit.apps.match_verb import add_match
from splitknit.apps.print_verb import add_print
from splitknit.apps.separate_verb import add_separate
from splitknit.apps.training.verbs import add_train
from splitknit.apps.verb import Refused, group, run_verb
from splitknit.apps.view_verb import add_view
from splitknit.check import BadInput

DONE, OUR_FAILURE, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


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
    add_demo(verbs)
    add_simulate(verbs)
    add_reconstruct(verbs)
    add_separate(verbs)
    add_train(verbs)
    add_capture(verbs)
    _add_calibrate(verbs)
    _add_rig(verbs)
    add_evaluate(verbs)
    add_match(verbs)
    add_enroll(verbs)
    add_identify(verbs)
    add_gallery_verbs(verbs)
    add_batch(verbs)
    add_view(verbs)
    add_print(verbs)
    return parser


def _add_calibrate(verbs: Any) -> None:
    from splitknit.apps.calibration.calibrate_camera_verb import add_camera  # noqa: PLC0415
    from splitknit.apps.calibration.calibrate_lights_verb import add_lights  # noqa: PLC0415
    from splitknit.apps.calibration.calibrate_radiometry_verb import add_radiometry  # noqa: PLC0415

    kinds = group(verbs, "calibrate", "measure a rig: its camera, its lights, its sensor")
    add_camera(kinds)
    add_radiometry(kinds)
    add_lights(kinds)


def _add_rig(verbs: Any) -> None:
    from splitknit.apps.building.rig_cad_verb import add_cad  # noqa: PLC0415
    from splitknit.apps.building.rig_circuit_verb import add_circuit  # noqa: PLC0415
    from splitknit.apps.building.rig_optimise_verb import add_optimise  # noqa: PLC0415
    from splitknit.apps.building.rig_target_verb import add_target  # noqa: PLC0415

    kinds = group(verbs, "rig", "plan and build a rig: parts, circuit, dimensions")
    add_target(kinds)
    add_optimise(kinds)
    add_circuit(kinds)
    add_cad(kinds)


def _guarded(options: argparse.Namespace) -> int:
    """Run the verb; turn what goes wrong into one line and an exit code."""
    try:
        facts, lines = run_verb(options)
        if facts or lines:  # `view` says what there is to say when it starts
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
