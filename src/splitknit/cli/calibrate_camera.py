"""The command line of ``splitknit calibrate camera``: options in, a job out."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, new_verb


def add_camera(kinds: Any) -> None:
    """Add the verb."""
    verb = new_verb(kinds, "camera", "measure the camera from photographs of a checkerboard (Zhang)", _run)
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


def _run(options: argparse.Namespace) -> Outcome:
    """Calibrate."""
    from splitknit.calibration.camera_photos import CameraJob, calibrate_to_rig  # noqa: PLC0415 - only this verb pays

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
    return facts, _lines_of(facts)


def _number(group: Any, name: str, default: float, words: str) -> None:
    group.add_argument(name, type=float, default=default, metavar="N", help=f"{words} (default: {default:g})")


def _lines_of(facts: Mapping[str, Any]) -> list[str]:
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
    from splitknit.calibration.camera import TERMS  # noqa: PLC0415 - only this verb pays

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
