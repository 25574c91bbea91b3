"""The command line of ``splitknit calibrate radiometry``: a white card in, a calibrated rig or a verdict out."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, new_verb


def add_radiometry(kinds: Any) -> None:
    """Add ``calibrate radiometry``."""
    verb = new_verb(
        kinds,
        "radiometry",
        "lens fall-off, brightness, beam and aim of every LED, from a white card; the camera's response and noise",
        _run,
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


def _run(options: argparse.Namespace) -> Outcome:
    """Calibrate, or check."""
    from splitknit.calibration.radiometry_folder import (  # noqa: PLC0415 - only this verb pays for it
        calibrate_to_file,
        check_folder,
    )
    from splitknit.errors import require  # noqa: PLC0415

    with Progress(options) as progress:
        if options.check is not None:
            for name in ("rig", "card_height_mm", "card_tilt_deg", "residuals"):
                require(
                    getattr(options, name) is None,
                    f"--{name.replace('_', '-')} does not go with --check: the calibration is RIG's; leave it out.",
                )
            facts = check_folder(options.folder, options.check, limit_percent=options.limit, progress=progress.update)
            return facts, _check_lines(facts)
        facts = calibrate_to_file(
            options.folder,
            options.out,
            rig_file=options.rig,
            card=(options.card_height_mm or 0.0, options.card_tilt_deg),
            limit_percent=options.limit,
            residuals=options.residuals,
            progress=progress.update,
        )
    return facts, _lines(facts, options.card_tilt_deg is None)


def _check_lines(facts: dict[str, Any]) -> list[str]:
    own = [led["own_ratio"] for led in facts["leds"]]
    lines = [
        f"The LEDs show the card at {100 * min(own):.1f} to {100 * max(own):.1f} % of their calibrated brightness."
    ]
    if None in facts["common_ratio"].values():
        lines.append("Only LEDs of one band are compared with each other: the exposures are not known on both days.")
    lines += [f"Please note: {sentence}" for sentence in facts["warnings"]]
    if not facts["warnings"]:
        lines.append(f"All LEDs are as calibrated, within {facts['limit_percent']:g} %.")
    return lines


def _lines(facts: dict[str, Any], base_tilt: bool) -> list[str]:
    lines = ["LED        intensity  beam   aim off  residuals rms, largest"]
    for led in facts["leds"]:
        lines.append(
            f"{led['name']:10s} {led['intensity']:9.3f} {led['lobe_exponent']:5.1f} {led['aim_off_deg']:6.1f} deg"
            f"  {led['rms_percent']:.2f} %, {led['largest_percent']:.2f} %: {led['verdict']}"
        )
    tried = ", ".join(f"{one['rms_percent']:.2f} %" for one in facts["model"]["tried"])
    lines += [
        f"Model: {facts['model']['chosen']} (residuals from the simplest to the richest model: {tried}).",
        f"The lens shows the corners at {100 * facts['lens']['corner']:.0f} % of the middle's brightness.",
    ]
    for band, fraction in facts["ambient_percent"].items():
        if fraction is not None:
            lines.append(f"Light from elsewhere: {fraction:.2f} % of the {band} LEDs'.")
    lines += _camera_lines(facts["camera"])
    lines += [f"Please note: {warning}" for warning in facts["warnings"]]
    if base_tilt and any(facts["card"]["tilt_deg"]):
        x, y = facts["card"]["tilt_deg"]
        lines.append(f"The card is taken to lie as the camera's calibration found the base: {x:.2f}, {y:.2f} deg.")
    lines.append(f"Written: {', '.join(facts['files'])}.")
    return lines


def _camera_lines(camera: dict[str, Any]) -> list[str]:
    lines = []
    response, dark = camera["response"], camera["dark"]
    if response is not None:
        low, high = response["values_percent"]
        kind = "linear" if response["encoding"] == "linear" else "sRGB"
        departure = response[f"{response['encoding']}_departure_percent"]
        lines.append(
            f"The camera is {kind}: it departs by {departure:.2f} % of full scale at most, between {low:.0f} and "
            f"{high:.0f} % of it."
        )
    if dark is not None:
        black = ", ".join(f"{value:.2f}" for value in dark["black_level_percent"])
        noise = dark["read_noise_percent"]
        words = "cut off at zero" if noise is None else f"{max(noise):.2f} %"
        lines.append(
            f"In the dark: level {black} % of full scale, noise {words}, {dark['hot_pixels']} hot pixels "
            f"({1e6 * dark['hot_share']:.0f} in a million)."
        )
    for name, model in camera["noise"].items():
        lines.append(f"Noise of {name} is that of {model['electrons_at_full_scale']:.0f} electrons at full scale.")
    return lines


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
