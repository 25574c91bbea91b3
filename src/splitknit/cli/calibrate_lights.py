"""The command line of ``splitknit calibrate lights``."""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, add_settings, new_verb


def add_lights(kinds: Any) -> None:
    """Add the verb."""
    verb = new_verb(kinds, "lights", "where the LEDs are: from a nail's shadows, a ball, or the rig's drawing", _run)
    source = verb.add_argument_group("from what (one of them)")
    source.add_argument("--table", type=Path, metavar="CSV", help="nail and shadow tips, typed")
    source.add_argument(
        "--images", type=Path, metavar="FOLDER", help="photographs: of the nail, or with --sphere of a ball"
    )
    source.add_argument("--sphere", choices=("chrome", "grey"), help="the photographs show a ball of this kind")
    source.add_argument("--geometry", action="store_true", help="nothing is measured: LEDs where the drawing has them")
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
        "--out", type=Path, metavar="FILE", help="rig file to write (default: none, only report what was found)"
    )
    add_settings(verb)


def _run(options: argparse.Namespace) -> Outcome:
    """Calibrate, write the rig, report what was found."""
    from splitknit.calibration.lights_found import LightSettings  # noqa: PLC0415 - only this verb pays
    from splitknit.calibration.lights_job import LightsJob, lights_to_rig  # noqa: PLC0415
    from splitknit.cli.options import read_changes  # noqa: PLC0415
    from splitknit.settings import override  # noqa: PLC0415

    given = {
        "limits.limit_deg": options.limit_deg,
        "nail.nail_height_mm": options.nail_height_mm,
        "nail.nail_seen": options.nail_seen,
    }
    changes = dict(read_changes(options.settings, options.assignments))
    settings = override(LightSettings(), changes)
    settings = override(settings, {name: value for name, value in given.items() if value is not None})
    names = [one.name for one in fields(LightsJob) if one.name != "settings"]
    job = LightsJob(**{name: getattr(options, name) for name in names}, settings=settings)
    with Progress(options) as progress:
        facts = lights_to_rig(job, progress.update)
    return facts, _words(facts)


def _words(facts: dict[str, Any]) -> list[str]:
    """What was found, in lines for people."""
    if facts["method"] == "geometry":
        return [f"{len(facts['leds'])} LEDs where the drawing has them, not measured; written to {facts['out']}."]
    written = f"Written to {facts['out']}." if facts["written"] else "No rig was written; name one with --out FILE."
    if "ball" in facts:
        lines = [f"{len(facts['leds'])} lights from a {facts['method']} ball:"]
        for one in facts["leds"]:
            x, y, z = one["direction"]
            lines.append(f"  {one['image']}  towards ({x:+.4f}, {y:+.4f}, {z:+.4f})")
        return [*lines, written]
    lines = [*_led_lines(facts), written]
    if "shadows_out_of_the_picture" in facts:
        lost, show, table = facts["shadows_out_of_the_picture"], facts["show"], facts["tips_out"]
        lines += [f"Please note: the shadow leaves the picture for {', '.join(lost)}."] if lost else []
        lines += [f"Please look at {show}: nail (cross), shadow tip (ring), ray to the LED (line)."] if show else []
        lines += [f"Correct {table} where it is wrong, and give it to --table."] if table else []
    return lines


def _led_lines(facts: dict[str, Any]) -> list[str]:
    lines = [f"{len(facts['leds'])} LEDs from {facts['nail_positions']} nail position(s), method {facts['method']}:"]
    for one in facts["leds"]:
        x, y, z = one["direction"]
        apart = "      -" if one["disagreement_deg"] is None else f"{one['disagreement_deg']:7.2f}"
        bound = "" if one["interval_deg"] is None else f" +-{one['interval_deg']:.2f} deg"
        kept = "" if one["kept"] else ", left out"
        lines.append(
            f"  {one['band']:5s} {one['led']}  towards ({x:+.4f}, {y:+.4f}, {z:+.4f}){bound}, positions disagree by "
            f"{apart} deg: {one['verdict']}{kept}"
        )
    if facts["nail_height_mm"] is not None:
        lines.append(f"The nail is {facts['nail_height_mm']:.1f} mm high, from its shadows.")
    return lines + [f"Please note: {warning}" for warning in facts["warnings"]]


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"'{text}' must be a positive number")
    return value
