"""The command line of ``splitknit calibrate lights``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.apps.verb import Outcome, Progress, add_settings, new_verb


def add_lights(kinds: Any) -> None:
    """Add the verb."""
    verb = new_verb(kinds, "lights", "where the LEDs are: from a nail's shadows, a ball, or the rig's drawing", run)
    way = verb.add_argument_group("from what (one of them)")
    way.add_argument("--table", type=Path, metavar="CSV", help="nail and shadow tips, typed")
    way.add_argument(
        "--images", type=Path, metavar="FOLDER", help="photographs: of the nail, or with --sphere of a ball"
    )
    way.add_argument("--sphere", choices=("chrome", "grey"), help="the photographs show a ball of this kind")
    way.add_argument("--geometry", action="store_true", help="nothing is measured: LEDs where the drawing has them")
    rig = verb.add_argument_group("the rig")
    rig.add_argument("--rig", type=Path, metavar="FILE", help="rig file with the calibrated camera")
    rig.add_argument("--px-per-cm", type=_positive, metavar="N", help="scale on the finger plane, without --rig")
    rig.add_argument("--image-size", metavar="ROWS,COLUMNS", help="of the photographs, without --rig")
    rig.add_argument("--led-height-cm", type=_positive, metavar="N", help="height of the LEDs above the finger plane")
    rig.add_argument("--led-radius-cm", type=_positive, metavar="N", help="radius of the circle on which they sit")
    rig.add_argument("--led-centre-px", metavar="X,Y", help="pixel of the circle's centre (default: the rig's origin)")
    rig.add_argument("--first-azimuth-deg", type=float, default=0.0, help="of white LED 0, for --geometry (default: 0)")
    nail = verb.add_argument_group("the nail")
    nail.add_argument("--nail-height-mm", type=_positive, metavar="N", help="where it is known (default: it is found)")
    nail.add_argument(
        "--nail-seen",
        choices=("tip", "base"),
        default=None,
        help="what the nail's pixel is (default: tip, the part of a cone that a camera above it sees)",
    )
    nail.add_argument(
        "--method",
        choices=("circle", "joint"),
        help="circle: the thesis's construction and mean; joint: least squares over all rows (default: joint for three "
        "nail positions or more, and with --rig)",
    )
    nail.add_argument(
        "--limit-deg", type=_positive, metavar="N", help="directions further apart are refused (default: 5)"
    )
    nail.add_argument("--keep", action="store_true", help="keep LEDs that would be refused")
    pictures = verb.add_argument_group("photographs")
    pictures.add_argument("--encoding", choices=("linear", "srgb"), default="linear", help="default: linear")
    pictures.add_argument("--mask", type=Path, metavar="FILE", help="image that is white where the ball is")
    pictures.add_argument("--show", type=Path, metavar="PNG", help="picture of what was found (default: beside --out)")
    pictures.add_argument(
        "--tips-out", type=Path, metavar="CSV", help="table of what was found, to correct and give to --table"
    )
    verb.add_argument(
        "--out", type=Path, metavar="FILE", help="rig file to write (default: none, only say what was found)"
    )
    add_settings(verb)


def run(options: argparse.Namespace) -> Outcome:
    """Calibrate, write the rig, say what was found."""
    from splitknit.apps.calibration.lights_inputs import check_way, circle_of, rig_inputs, settings_of  # noqa: PLC0415

    way = check_way(options)
    with Progress(options) as progress:
        if way == "sphere":
            from splitknit.apps.calibration.lights_of_sphere import lights_of_sphere  # noqa: PLC0415

            return lights_of_sphere(options)
        inputs = rig_inputs(options)
        if way == "geometry":
            from splitknit.apps.calibration.lights_inputs import nominal_lights  # noqa: PLC0415

            return nominal_lights(options, inputs)
        from splitknit.apps.calibration.lights_of_nail import Task, lights_of_table  # noqa: PLC0415

        task = Task(options, inputs, circle_of(options, inputs), settings_of(options))
        if way == "table":
            return lights_of_table(task, progress.update)
        from splitknit.apps.calibration.lights_of_images import lights_of_images  # noqa: PLC0415

        return lights_of_images(task, progress.update)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"'{text}' must be a positive number")
    return value
