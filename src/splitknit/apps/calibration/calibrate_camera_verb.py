"""The command line of ``splitknit calibrate camera``: options in, a job out."""

from __future__ import annotations

import argparse
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from splitknit.apps.verb import Outcome, Progress, new_verb


def add_camera(kinds: Any) -> None:
    """Add the verb."""
    verb = new_verb(kinds, "camera", "measure the camera from photographs of a checkerboard (Zhang)", run)
    verb.add_argument(
        "folder", type=Path, nargs="?", metavar="FOLDER", help="photographs of one board, tilted differently in each"
    )
    verb.add_argument("--out", type=Path, required=True, metavar="FILE", help="rig file to write")
    verb.add_argument("--rig", type=Path, default=None, metavar="FILE", help="rig file whose other parts are kept")
    verb.add_argument(
        "--pattern",
        default=None,
        metavar="GLOB",
        help="only files of this name, such as 'left*.jpg', or 'board_*/white_0.png' in capture folders (default: all)",
    )
    board = verb.add_argument_group("the printed target ('splitknit rig target' makes it)")
    board.add_argument("--board", default="9x6", metavar="CxR", help="inner corners each way (default: 9x6)")
    _number(board, "--square-mm", 3.0, "side of a square, measured on the print")
    board.add_argument(
        "--plane",
        type=Path,
        action="append",
        default=[],
        metavar="IMAGE",
        help="photograph of the board lying on the finger plane: camera height, scale, tilt; may be repeated",
    )
    board.add_argument("--disc", type=Path, default=None, metavar="IMAGE", help="the same from the calibration disc")
    _number(board, "--dot-mm", 10.0, "spacing of the disc's dots")
    lens = verb.add_argument_group("depth of field")
    _number(lens, "--sensor-pixel-um", 1.12, "side of a pixel on the sensor; the IMX219's by default")
    lens.add_argument(
        "--binning",
        type=float,
        default=None,
        metavar="N",
        help="sensor pixels along a pixel of the image (default: 1 from 1920 columns, else 3280 / columns, rounded)",
    )
    _number(lens, "--aperture", 2.0, "f-number of the lens; the camera v2's by default")
    _number(lens, "--finger-depth-mm", 8.0, "depth of the finger that should be sharp")


def run(options: argparse.Namespace) -> Outcome:
    """Calibrate."""
    from splitknit.apps.calibration.calibrated_camera import CameraJob, calibrate_to_rig  # noqa: PLC0415 - only this verb pays
    from splitknit.apps.calibration.camera_words import lines_of  # noqa: PLC0415

    job = CameraJob(
        out=options.out,
        folder=options.folder,
        board=options.board,
        square_mm=options.square_mm,
        pattern=options.pattern,
        rig=options.rig,
        plane=tuple(options.plane),
        disc=options.disc,
        dot_mm=options.dot_mm,
        sensor_pixel_um=options.sensor_pixel_um,
        binning=options.binning,
        f_number=options.aperture,
        finger_depth_mm=options.finger_depth_mm,
        calibrated_at=datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
    )
    with Progress(options) as progress:
        facts = calibrate_to_rig(job, progress.update)
    return facts, lines_of(facts)


def _number(group: Any, name: str, default: float, words: str) -> None:
    group.add_argument(name, type=float, default=default, metavar="N", help=f"{words} (default: {default:g})")
