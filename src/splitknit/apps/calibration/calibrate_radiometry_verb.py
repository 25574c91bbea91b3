"""The command line of ``splitknit calibrate radiometry``: a white card in, a calibrated rig or a verdict out."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from splitknit.apps.verb import Outcome, Progress, new_verb


def add_radiometry(kinds: Any) -> None:
    """Add ``calibrate radiometry``."""
    verb = new_verb(
        kinds,
        "radiometry",
        "lens fall-off, brightness, beam and aim of every LED, from a white card; the camera's response and noise",
        run_radiometry,
    )
    verb.add_argument("folder", type=Path, metavar="FOLDER", help="capture folder of a white card under every LED")
    verb.add_argument(
        "--rig", type=Path, default=None, metavar="RIG", help="rig file with camera and LED places (default: FOLDER's)"
    )
    what = verb.add_mutually_exclusive_group(required=True)
    what.add_argument("--out", type=Path, default=None, metavar="RIG2", help="rig file to write")
    what.add_argument(
        "--check", type=Path, default=None, metavar="RIG", help="compare with the calibration in RIG; writes nothing"
    )
    verb.add_argument(
        "--limit",
        type=_positive,
        default=None,
        metavar="PERCENT",
        help="of an LED's residuals (rms, default: 1), or with --check of its departure (default: 3)",
    )
    verb.add_argument(
        "--card-height-mm",
        type=_number,
        default=None,
        metavar="MM",
        help="height of the card's surface above the finger plane (default: 0)",
    )
    verb.add_argument(
        "--card-tilt-deg",
        type=_pair,
        default=None,
        metavar="X,Y",
        help="turn of the card about x and y (default: the base's, where 'calibrate camera' found it, else 0,0)",
    )
    verb.add_argument(
        "--residuals", type=Path, default=None, metavar="PNG", help="picture to write: residuals under every LED"
    )


def run_radiometry(options: argparse.Namespace) -> Outcome:
    """Calibrate, or check."""
    from splitknit.apps.calibration.radiometry import calibrate_to_file, check_folder  # noqa: PLC0415 - only this verb pays for it
    from splitknit.errors import require  # noqa: PLC0415

    with Progress(options) as progress:
        if options.check is not None:
            for name in ("rig", "card_height_mm", "card_tilt_deg", "residuals"):
                require(
                    getattr(options, name) is None,
                    f"--{name.replace('_', '-')} does not go with --check: the calibration is RIG's; leave it out.",
                )
            return check_folder(options.folder, options.check, limit_percent=options.limit, progress=progress.update)
        return calibrate_to_file(
            options.folder,
            options.out,
            rig_file=options.rig,
            card=(options.card_height_mm or 0.0, options.card_tilt_deg),
            limit_percent=options.limit,
            residuals=options.residuals,
            progress=progress.update,
        )


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"'{text}' must be a number")
    return value


def _positive(text: str) -> float:
    value = _number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"'{text}' must be positive")
    return value


def _pair(text: str) -> tuple[float, float]:
    parts = text.split(",")
    if len(parts) != 2:
        raise argparse.ArgumentTypeError(f"'{text}' must be two numbers with a comma between them")
    return _number(parts[0]), _number(parts[1])
