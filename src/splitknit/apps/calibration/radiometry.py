"""What ``splitknit calibrate radiometry`` does: files in, a rig file or a verdict out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit.apps.calibration.radiometry_camera import (
    black_level_of,
    black_level_warning,
    camera_json,
    measure_camera,
)
from splitknit.apps.calibration.radiometry_folder import read_radiometry_plan
from splitknit.apps.commands import Progress, no_progress
from splitknit.apps.pictures import ColourArray, colour
from splitknit.apps.targets import check_picture, check_rig_file
from splitknit.apps.verb import Outcome
from splitknit.calibration.card_check import check_card, check_facts
from splitknit.calibration.card_light import CardPlane
from splitknit.calibration.radiometry import (
    PROVENANCE,
    RadiometricCalibration,
    RadiometrySettings,
    calibrate_radiometry,
)
from splitknit.errors import BadInput, require
from splitknit.io import provenance, read_capture, read_rig, write_image, write_rig
from splitknit.model import FloatArray, Rig

_MOST_TILT_DEG = 5.0
_SCALE_PERCENT = 2.0
"""Ends of the colours in the picture of residuals."""


def calibrate_to_file(
    folder: Path,
    out: Path,
    *,
    rig_file: Path | None = None,
    card: tuple[float, tuple[float, float] | None] = (0.0, None),
    limit_percent: float | None = None,
    residuals: Path | None = None,
    progress: Progress = no_progress,
) -> Outcome:
    """Calibrate the rig with the card in `folder` and write it to `out`.

    Parameters
    ----------
    folder : capture folder of the card, see :mod:`splitknit.apps.calibration.radiometry_folder`
    out : rig file to write
    rig_file : rig to calibrate; the folder's own by default
    card : height in mm and tilt in deg of the card; None for the tilt of the base that the rig file tells
    limit_percent : largest rms of an LED's residuals
    residuals : picture to write

    Raises
    ------
    BadInput
        Naming the folder or file at fault; nothing is written then.
    """
    check_rig_file(out)
    check_picture(residuals, folder)
    require(
        residuals is None or residuals.suffix.lower() in (".png", ".tif", ".tiff"),
        f"'{residuals}' must end in .png or .tif: it is a picture.",
    )
    progress("reading", 0.0)
    plan = read_radiometry_plan(folder)
    capture = read_capture(folder)
    rig = capture.rig if rig_file is None else read_rig(rig_file)
    height_mm, tilt_deg = card
    tilt_deg, told = (base_tilt_deg(rig), True) if tilt_deg is None else (tilt_deg, False)
    progress("camera", 0.3)
    camera = measure_camera(plan, capture)
    black = black_level_of(camera, capture)
    settings = RadiometrySettings() if limit_percent is None else RadiometrySettings(limit_percent=limit_percent)
    progress("flat field", 0.6)
    try:
        found = calibrate_radiometry(capture, rig, CardPlane(height_mm, tilt_deg), black, settings)
    except BadInput as error:
        raise BadInput(f"{folder}: {error}") from error
    warnings = [*found.warnings, *black_level_warning(black, capture)]
    facts = {
        **found.facts,
        "camera": camera_json(camera),
        "warnings": warnings,
        **provenance({"radiometry": settings}, {**capture.hashes, **camera.hashes}),
    }
    progress("writing", 0.9)
    written = replace(found.rig, provenance={**found.rig.provenance, PROVENANCE: facts})
    if residuals is not None:
        write_image(residuals, residual_picture(found))
    write_rig(written, out)
    progress("done", 1.0)
    files = [str(out)] + ([str(residuals)] if residuals is not None else [])
    lines = _lines(found, facts, files)
    if told and any(tilt_deg):
        lines.insert(
            -1,
            f"The card is taken to lie as the camera's calibration found the base: {tilt_deg[0]:.2f}, "
            f"{tilt_deg[1]:.2f} deg.",
        )
    return {**facts, "out": str(out), "files": files}, lines


def base_tilt_deg(rig: Rig) -> tuple[float, float]:
    """Turn of the base about x and y as ``splitknit calibrate camera`` left it in the rig, where it is certain.

    A tilt that is less than twice its deviation is none: the noise that it would bring in is larger than itself.
    """
    found: Any = rig.provenance
    for name in ("camera", "residuals", "plane"):
        found = found.get(name) if isinstance(found, Mapping) else None
    if not isinstance(found, Mapping):
        return 0.0, 0.0
    try:
        x, y = (float(value) for value in found["tilt_xy_deg"])
        deviation = float(found["tilt_deg_deviation"])
    except (KeyError, TypeError, ValueError):
        return 0.0, 0.0
    certain = math.isfinite(x) and math.isfinite(y) and 2.0 * deviation < math.hypot(x, y) <= _MOST_TILT_DEG
    return (x, y) if certain else (0.0, 0.0)


def check_folder(
    folder: Path, rig_file: Path, *, limit_percent: float | None = None, progress: Progress = no_progress
) -> Outcome:
    """Compare the card in `folder` with the calibration in `rig_file`.

    Raises
    ------
    BadInput
        If the rig carries no calibration, or the folder cannot be used.
    """
    progress("reading", 0.0)
    rig = read_rig(rig_file)
    plan = read_radiometry_plan(folder)
    capture = read_capture(folder)
    camera = measure_camera(plan, capture)
    settings = RadiometrySettings() if limit_percent is None else RadiometrySettings(drift_percent=limit_percent)
    progress("comparing", 0.7)
    try:
        check = check_card(capture, rig, black_level_of(camera, capture), settings)
    except BadInput as error:
        raise BadInput(f"{rig_file} and {folder}: {error}") from error
    facts = {**check_facts(check, rig), "limit_percent": settings.drift_percent, "inputs": dict(capture.hashes)}
    progress("done", 1.0)
    span = f"{100 * float(check.own.min()):.1f} to {100 * float(check.own.max()):.1f} %"
    lines = [f"The LEDs show the card at {span} of their calibrated brightness."]
    if None in check.common.values():
        lines.append("Only LEDs of one band are compared with each other: the exposures are not known on both days.")
    lines += [f"Please note: {sentence}" for sentence in check.sentences]
    if not check.sentences:
        lines.append(f"All LEDs are as calibrated, within {settings.drift_percent:g} %.")
    return facts, lines


def _lines(found: RadiometricCalibration, facts: Mapping[str, Any], files: Sequence[str]) -> list[str]:
    flat = found.flat_field
    lines = ["LED        intensity  beam   aim off  residuals rms, largest"]
    for led in facts["leds"]:
        lines.append(
            f"{led['name']:10s} {led['intensity']:9.3f} {led['lobe_exponent']:5.1f} {led['aim_off_deg']:6.1f} deg"
            f"  {led['rms_percent']:.2f} %, {led['largest_percent']:.2f} %: {led['verdict']}"
        )
    tried = ", ".join(f"{one['rms_percent']:.2f} %" for one in facts["model"]["tried"])
    lines += [
        f"Model: {flat.order.name} (residuals from the simplest to the richest model: {tried}).",
        f"The lens shows the corners at {100 * facts['lens']['corner']:.0f} % of the middle's brightness.",
    ]
    for band, share in facts["ambient_percent"].items():
        if share is not None:
            lines.append(f"Light from elsewhere: {share:.2f} % of the {band} LEDs'.")
    lines += _camera_lines(facts["camera"])
    lines += [f"Please note: {warning}" for warning in facts["warnings"]]
    lines.append(f"Written: {', '.join(files)}.")
    return lines


def _camera_lines(camera: Mapping[str, Any]) -> list[str]:
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


def residual_picture(found: RadiometricCalibration, side: int = 240) -> ColourArray:
    """Residuals of every LED side by side, a band a row: blue 2 % darker than the model, orange 2 % brighter.

    Cells that were left out as dust are black.
    """
    flat, shape = found.flat_field, found.images.shape
    bands = [led.band for led in flat.leds]
    rows = []
    widest = max(bands.count(band) for band in bands)
    for band in dict.fromkeys(bands):
        tiles = [_tile(100 * flat.residual[k], flat.dust, shape, side) for k, b in enumerate(bands) if b == band]
        tiles += [np.full_like(tiles[0], 255)] * (widest - len(tiles))
        rows.append(np.concatenate(tiles, axis=1))
    return np.concatenate(rows, axis=0)


def _tile(residual: Any, dust: Any, shape: tuple[int, int], side: int) -> ColourArray:
    values: FloatArray = np.asarray(residual, dtype=np.float32).reshape(shape)
    small = colour(values, -_SCALE_PERCENT, _SCALE_PERCENT, diverging=True)
    small[np.asarray(dust).reshape(shape)] = 0
    size = (side, round(side * shape[0] / shape[1]))
    tile = np.asarray(cv2.resize(small, size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
    return np.asarray(cv2.copyMakeBorder(tile, 4, 4, 4, 4, cv2.BORDER_CONSTANT, value=(255, 255, 255)), dtype=np.uint8)
