"""``splitknit calibrate``: a rig's camera, the brightness of its LEDs, where they are, and films before them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, add_settings, from_options, group, new_verb, number, refuse_given


def add_calibrate(verbs: Any) -> None:
    """Add ``splitknit calibrate`` and its verbs."""
    kinds = group(verbs, "calibrate", "measure a rig: its camera, its lights, its sensor, its films")
    _add_camera(kinds)
    _add_radiometry(kinds)
    _add_lights(kinds)
    _add_polarisers(kinds)
    _add_shading(kinds)


def _add_camera(kinds: Any) -> None:
    verb = new_verb(kinds, "camera", "measure the camera from photographs of a checkerboard (Zhang)", _calibrate_camera)
    verb.add_argument(
        "folder", type=Path, nargs="?", metavar="FOLDER", help="photographs of one board, tilted differently in each"
    )
    verb.add_argument("--out", type=Path, required=True, metavar="FILE", help="rig file to write")
    verb.add_argument("--rig", type=Path, metavar="FILE", help="rig file whose other parts are kept")
    verb.add_argument(
        "--pattern",
        metavar="GLOB",
        help="only files of this name, such as 'left*.jpg', or 'board_*/white_0.png' in capture folders (default: all)",
    )
    board = verb.add_argument_group("the printed target ('splitknit rig target' makes it)")
    board.add_argument("--board", default="9x6", metavar="CxR", help="inner corners each way (default: 9x6)")
    _add_number(board, "--square-mm", 3.0, "side of a square, measured on the print")
    board.add_argument(
        "--plane",
        type=Path,
        action="append",
        default=[],
        metavar="IMAGE",
        help="photograph of the board lying on the finger plane: camera height, scale, tilt; may be repeated",
    )
    board.add_argument("--disc", type=Path, metavar="IMAGE", help="the same from the calibration disc")
    _add_number(board, "--dot-mm", 10.0, "spacing of the disc's dots")
    lens = verb.add_argument_group("depth of field")
    _add_number(lens, "--sensor-pixel-um", 1.12, "side of a pixel on the sensor; the IMX219's by default")
    lens.add_argument(
        "--binning",
        type=float,
        metavar="N",
        help="sensor pixels along a pixel of the image (default: 1 from 1920 columns, else 3280 / columns, rounded)",
    )
    _add_number(lens, "--aperture", 2.0, "f-number of the lens; the camera v2's by default")
    _add_number(lens, "--finger-depth-mm", 8.0, "depth of the finger that should be sharp")


def _calibrate_camera(options: argparse.Namespace) -> Outcome:
    from splitknit.calibration.camera_photos import CameraJob, calibrate_to_rig, camera_facts  # only this verb pays

    now = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    job = from_options(CameraJob, options, plane=tuple(options.plane), f_number=options.aperture, calibrated_at=now)
    with Progress(options) as progress:
        facts = camera_facts(calibrate_to_rig(job, progress.update))
    return facts, _camera_lines(facts)


def _add_number(group: Any, name: str, default: float, words: str) -> None:
    group.add_argument(name, type=float, default=default, metavar="N", help=f"{words} (default: {default:g})")


def _camera_lines(facts: Mapping[str, Any]) -> list[str]:
    """Return the facts as lines for people."""
    lines = []
    if facts["fit"] is not None:
        lines += _fit_lines(facts)
    if facts["plane"] is not None:
        lines += _plane_lines(facts)
    if facts["depth_of_field"] is not None:
        lines += _sharpness_lines(facts["depth_of_field"])
    lines += [f"Please note: {words}" for words in facts["warnings"]]
    lines.append(f"Measured: {', '.join(facts['measured'])}. Taken over: {', '.join(facts['nominal']) or 'nothing'}.")
    lines.append(f"Written: {facts['out']}")
    return lines


def _fit_lines(facts: Mapping[str, Any]) -> list[str]:

    fit = facts["fit"]
    per_image, deviations = fit["per_image_px"], fit["deviations"]
    count = len(per_image) + len(fit["rejected_px"]) + len(fit["repeated"]) + len(fit["without_board"])
    worst = max(per_image, key=lambda name: per_image[name])
    fx, fy = fit["focal_length_px"]
    cx, cy = fit["principal_point_px"]
    focal = f"{fx:.2f}" if fx == fy else f"{fx:.2f} x {fy:.2f}"
    around = [f" +- {deviations[name]:.2f}" if name in deviations else " (held)" for name in ("cx", "cy")]
    lines = [
        f"Camera calibrated from {fit['images']} of {count} photographs: corners lie {fit['rms_px']:.3f} px off (rms), "
        f"most in {worst} ({per_image[worst]:.3f} px).",
        f"  focal length {focal} +- {deviations['fx']:.2f} px, "
        f"principal point ({cx:.2f}{around[0]}, {cy:.2f}{around[1]}) px",
    ]
    from splitknit.calibration.camera import TERMS  # only this verb pays

    terms = zip(TERMS, facts["distortion"], strict=True)
    free = [f"{name} = {value:.4g} +- {deviations[name]:.2g}" for name, value in terms if name in fit["fitted"]]
    lines.append(f"  distortion {', '.join(free) or 'none'}")
    lines += [
        f"  held: {name} = {why}" if "point" not in name else f"  held: {name}, {why}"
        for name, why in fit["held"].items()
    ]
    lines += [f"  left out: {name}, corners {error:.2f} px off" for name, error in fit["rejected_px"].items()]
    lines += [f"  left out: {name}, the same view as {other}" for name, other in fit["repeated"].items()]
    board = facts["board"]["inner_corners"]
    lines += [f"  left out: {name}, no board of {board} inner corners in full view" for name in fit["without_board"]]
    return lines


def _plane_lines(facts: Mapping[str, Any]) -> list[str]:
    plane = facts["plane"]
    if "height_mm" not in plane:
        return [
            f"Scale of an orthographic camera: {plane['px_per_mm']:.4f} +- {plane['px_per_mm_deviation']:.4f} px/mm "
            f"(marks {plane['rms_px']:.2f} px off)."
        ]
    return [
        f"Finger plane: {plane['height_mm']:.3f} +- {plane['height_mm_deviation']:.3f} mm from the camera, "
        f"{plane['px_per_mm']:.4f} px/mm (marks {plane['rms_px']:.2f} px off).",
        f"  The camera looks on the base {plane['tilt_deg']:.2f} +- {plane['tilt_deg_deviation']:.2f} deg obliquely; "
        f"the base comes nearer towards the picture's {plane['nearer_at']}.",
    ]


def _sharpness_lines(field: Mapping[str, Any]) -> list[str]:
    far = "infinity" if field["far_mm"] is None else f"{field['far_mm']:.2f} mm"
    depth = "" if field["depth_mm"] is None else f" ({field['depth_mm']:.2f} mm)"
    first = (
        f"Depth of field at f/{field['f_number']:g}, focal length {field['focal_length_mm']:.2f} mm: from "
        f"{field['near_mm']:.2f} mm to {far}{depth} a point is at most one pixel ({field['confusion_um']:.2f} um) wide."
    )
    if field["fits"]:
        return [first, f"  A finger {field['finger_depth_mm']:g} mm deep fits."]
    return [
        first,
        f"  A finger {field['finger_depth_mm']:g} mm deep does not fit: focused in its middle, its ends are blurred "
        f"over {field['blur_px']:.1f} px. It would fit at f/{field['needed_f_number']:.0f}, where diffraction alone "
        f"blurs over {field['diffraction_px']:.0f} px; both are equal at f/{field['best_f_number']:.1f}.",
    ]


def _add_radiometry(kinds: Any) -> None:
    verb = new_verb(
        kinds,
        "radiometry",
        "lens fall-off, brightness, beam and aim of every LED, from a white card; the camera's response and noise",
        _calibrate_radiometry,
    )
    verb.add_argument("folder", type=Path, metavar="FOLDER", help="capture folder of a white card under every LED")
    verb.add_argument("--rig", type=Path, metavar="RIG", help="rig file with camera and LED places (default: FOLDER's)")
    what = verb.add_mutually_exclusive_group(required=True)
    what.add_argument("--out", type=Path, metavar="RIG2", help="rig file to write")
    what.add_argument("--check", type=Path, metavar="RIG", help="compare with the calibration in RIG; writes nothing")
    verb.add_argument(
        "--limit",
        type=_positive,
        metavar="PERCENT",
        help="of an LED's residuals (rms, default: 1), or with --check of its departure (default: 3)",
    )
    verb.add_argument(
        "--card-height-mm",
        type=_number,
        metavar="MM",
        help="height of the card's surface above the finger plane (default: 0)",
    )
    verb.add_argument(
        "--card-tilt-deg",
        type=_pair,
        metavar="X,Y",
        help="turn of the card about x and y (default: the base's, where 'calibrate camera' found it, else 0,0)",
    )
    verb.add_argument("--residuals", type=Path, metavar="PNG", help="picture to write: residuals under every LED")


def _calibrate_radiometry(options: argparse.Namespace) -> Outcome:
    from splitknit.calibration.radiometry_folder import (  # only this verb pays for it
        calibrate_to_file,
        check_folder,
    )

    with Progress(options) as progress:
        if options.check is not None:
            own = ("rig", "card_height_mm", "card_tilt_deg", "residuals")
            refuse_given(options, own, "does not go with --check: the calibration is RIG's; leave it out.")
            facts = check_folder(options.folder, options.check, limit_percent=options.limit, progress=progress.update)
            return facts, _check_lines(facts)
        found = calibrate_to_file(
            options.folder,
            options.out,
            rig_file=options.rig,
            card=(options.card_height_mm or 0.0, options.card_tilt_deg),
            limit_percent=options.limit,
            residuals=options.residuals,
            progress=progress.update,
        )
    files = [str(file) for file in (options.out, options.residuals) if file is not None]
    facts = {**found.facts, "out": str(options.out), "files": files}
    return facts, _radiometry_lines(facts, options.card_tilt_deg is None)


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


def _radiometry_lines(facts: dict[str, Any], base_tilt: bool) -> list[str]:
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
    lines += _sensor_lines(facts["camera"])
    lines += [f"Please note: {warning}" for warning in facts["warnings"]]
    if base_tilt and any(facts["card"]["tilt_deg"]):
        x, y = facts["card"]["tilt_deg"]
        lines.append(f"The card is taken to lie as the camera's calibration found the base: {x:.2f}, {y:.2f} deg.")
    lines.append(f"Written: {', '.join(facts['files'])}.")
    return lines


def _sensor_lines(camera: dict[str, Any]) -> list[str]:
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


_number = number(-1e300, 1e300, "a number")
_positive = number(1e-300, 1e9, "a positive number")


def _pair(text: str) -> tuple[float, float]:
    parts = text.split(",")
    if len(parts) != 2:
        raise argparse.ArgumentTypeError(f"'{text}' must be two numbers with a comma between them")
    return _number(parts[0]), _number(parts[1])


def _add_lights(kinds: Any) -> None:
    verb = new_verb(
        kinds, "lights", "where the LEDs are: from a nail's shadows, a ball, or the rig's drawing", _calibrate_lights
    )
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
    pictures.add_argument(
        "--encoding", choices=("linear", "srgb"), help="of the photographs (default: as for 'reconstruct --images')"
    )
    pictures.add_argument("--mask", type=Path, metavar="FILE", help="image that is white where the ball is")
    pictures.add_argument("--show", type=Path, metavar="PNG", help="picture of what was found (default: beside --out)")
    pictures.add_argument(
        "--tips-out", type=Path, metavar="CSV", help="table of what was found, to correct and give to --table"
    )
    verb.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="rig file (.json) or list of lights (.txt) to write; 'reconstruct --images PHOTOS --lights FILE' takes "
        "both (default: none, only report what was found)",
    )
    add_settings(verb)


def _calibrate_lights(options: argparse.Namespace) -> Outcome:
    """Calibrate, write the rig, report what was found."""
    from splitknit.calibration.lights_found import LightSettings, LightsJob  # only this verb pays
    from splitknit.calibration.lights_job import lights_to_rig
    from splitknit.cli.options import read_changes
    from splitknit.settings import override

    given = {
        "limits.limit_deg": options.limit_deg,
        "nail.nail_height_mm": options.nail_height_mm,
        "nail.nail_seen": options.nail_seen,
    }
    changes = dict(read_changes(options.settings, options.assignments))
    settings = override(LightSettings(), changes)
    settings = override(settings, {name: value for name, value in given.items() if value is not None})
    job = from_options(LightsJob, options, settings=settings)
    with Progress(options) as progress:
        facts = dict(lights_to_rig(job, progress.update).facts)
    return facts, _light_lines(facts)


def _light_lines(facts: dict[str, Any]) -> list[str]:
    """What was found, in lines for people."""
    if facts["method"] == "geometry":
        return [f"{len(facts['leds'])} LEDs where the drawing has them, not measured; written to {facts['out']}."]
    written = f"Written to {facts['out']}."
    if not facts["written"]:
        written = "Nothing was written; name a rig file (.json) or a list of lights (.txt) with --out FILE."
    if "ball" in facts:
        lines = [f"{len(facts['leds'])} lights from a {facts['method']} ball:"]
        for one in facts["leds"]:
            x, y, z = one["direction"]
            lines.append(f"  {one['image']}  towards ({x:+.4f}, {y:+.4f}, {z:+.4f})")
        lines += [f"Please note: {note}" for note in facts["notes"]]
        if facts["written"]:
            lines.append(written)
            written = f"Next: splitknit reconstruct --images PHOTOS --lights {facts['out']} --out RESULT"
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


def _add_polarisers(kinds: Any) -> None:
    verb = new_verb(
        kinds,
        "polarisers",
        "polarising films: extinction, angles, brightness and image shift, from a printed card and a glossy black ball",
        _calibrate_polarisers,
    )
    verb.add_argument(
        "folder",
        type=Path,
        metavar="FOLDER",
        help="holds the capture folders card and ball, analyser parallel (white) and crossed (white_crossed), and "
        "ball_85, ball_95 ...: the ball with the analyser at other angles",
    )
    verb.add_argument("--rig", type=Path, metavar="RIG", help="rig file to add the films to (default: the card's)")
    verb.add_argument("--out", type=Path, required=True, metavar="RIG2", help="rig file to write")
    verb.add_argument("--residuals", type=Path, metavar="PNG", help="picture to write: residuals under every LED")


def _calibrate_polarisers(options: argparse.Namespace) -> Outcome:
    from splitknit.calibration.polarisers import films_to_file  # only this verb pays for it

    with Progress(options) as progress:
        facts = films_to_file(
            options.folder,
            options.out,
            rig_file=options.rig,
            residuals=options.residuals,
            progress=progress.update,
        )
    return facts, _film_lines(facts)


def _film_lines(facts: Mapping[str, Any]) -> list[str]:
    films = facts["films"]
    lines = ["LED   specular light left  angle            crossed / parallel: red, green, blue  residuals rms"]
    for k, led in enumerate(films["leds"]):
        low, high = facts["leak_interval"][k]
        angle = "not measured"
        if films["angle_deg"]:
            angle = f"{films['angle_deg'][k]:+.2f} +- {facts['angle_interval_deg'][k]:.2f} deg"
        tint = ", ".join(f"{value:.4f}" for value in films["brightness"][k])
        lines.append(
            f"{led:3d}   {100 * low:.3f} to {100 * high:.3f} %      {angle:16s} {tint:37s} "
            f"{facts['residual_rms_percent'][k]:.2f} %"
        )
    if films["extinction_ratio"] is None:
        lines.append("Extinction and angles: photograph the ball at other angles of the analyser (ball_85, ball_95).")
    else:
        low, high = facts["extinction_interval"]
        span = f"at least {low:.0f}" if high is None else f"{low:.0f} to {high:.0f}"
        lines.append(f"Extinction ratio: {films['extinction_ratio']:.0f} ({span}).")
    x, y = films["shift_px"]
    lines.append(
        f"The crossed image lies {x:+.3f} px right of and {y:+.3f} px below the parallel one (+- "
        f"{max(facts['shift_interval_px']):.3f} px), and is {films['scale']:.5f} times its size."
    )
    lines += [f"Please note: {warning}" for warning in facts["warnings"]]
    return [*lines, f"Written: {', '.join(facts['files'])}."]


def _add_shading(kinds: Any) -> None:
    verb = new_verb(
        kinds,
        "shading",
        "how slopes shade a gel sensor's images, from balls of known radius; or the fall-off of its light, from a card",
        _calibrate_shading,
    )
    verb.add_argument(
        "--images",
        type=Path,
        nargs="+",
        default=[],
        metavar="DIR",
        help="photographs of balls, one for each light, or one of three colours; several folders of one ball pressed "
        "in many places; without --flat of one ball lying free before a dark background, or, with --pitch and "
        "--centres, of balls in a gel that is flat between them",
    )
    verb.add_argument(
        "--flat", type=Path, metavar="DIR", help="the same of the sensor pressed on nothing, or of a card"
    )
    verb.add_argument("--ball-radius", type=_positive, metavar="MM", help="radius of the balls")
    verb.add_argument(
        "--pitch",
        type=_positive,
        metavar="MM",
        help="distance of neighbouring balls (default: scale of their outlines)",
    )
    verb.add_argument(
        "--centres",
        type=Path,
        metavar="FILE",
        help="the balls' 'column row [radius]' in pixels, where they are not found",
    )
    verb.add_argument(
        "--encoding", choices=("linear", "srgb"), help="of the photographs (default: as their files state, else linear)"
    )
    verb.add_argument("--out", type=Path, required=True, metavar="FILE", help="calibration to write (.npz)")
    verb.add_argument("--report", type=Path, metavar="HTML", help="page to write (default: beside --out)")


def _calibrate_shading(options: argparse.Namespace) -> Outcome:
    from splitknit.calibration.shading_folder import ShadingJob, shading_to_file  # only this verb pays for it
    from splitknit.report.shading import check_page, write_page

    page = options.report or options.out.with_suffix(".html")
    check_page(page)
    job = from_options(ShadingJob, options, images=tuple(options.images))
    with Progress(options) as progress:
        fit = shading_to_file(job, progress.update)
        write_page(page, fit)
    facts = {**fit.shading.facts, "pitch_mm": fit.shading.pitch_mm, "out": str(options.out), "report": str(page)}
    lines = []
    if facts["balls"]:
        lines.append(
            f"{facts['balls_used']} of {facts['balls']} balls calibrate {len(fit.shading.direction)} lights, "
            f"{1000 * fit.shading.pitch_mm:.4f} um a pixel."
        )
        if facts["cap_rms_um"] is not None:
            low, middle, high = facts["cap_gain"]
            lines.append(
                f"Caps within 0.6 of the radius, {facts['left_out']} left out: {facts['cap_rms_um']:.2f} um rms, gain "
                f"{middle:.3f} ({low:.3f} to {high:.3f})."
            )
        lines.append(f"Slopes up to {facts['max_slope']:.2f} were seen; steeper ones are extrapolated.")
    lines += [f"Please note: {note}" for note in fit.notes]
    lines.append(f"Written: {options.out}, {page}.")
    return facts, lines
