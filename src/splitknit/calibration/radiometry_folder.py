"""A white card's folder in, a calibrated rig file or a verdict out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.card_model import CardPlane
from splitknit.calibration.radiometry import (
    PROVENANCE,
    RadiometricCalibration,
    RadiometrySettings,
    check_card,
    fit_radiometry,
)
from splitknit.calibration.sensor import (
    MIN_EXPOSURES,
    Dark,
    NoiseModel,
    Response,
    dark_frames,
    fit_response,
    noise_model,
    noise_samples,
)
from splitknit.errors import naming, require
from splitknit.io.capture import read_capture
from splitknit.io.fields import Fields, inside, read_json
from splitknit.io.images import read_image, write_image
from splitknit.io.pictures import ColourArray, colour
from splitknit.io.provenance import file_hash, provenance
from splitknit.io.rig import read_rig, write_rig
from splitknit.io.targets import check_picture, check_rig_file
from splitknit.model import Capture, FloatArray, PixelArray, Progress, Rig, no_progress

_MAX_TILT_DEG = 5.0
_SCALE_PERCENT = 2.0
"""Ends of the colours in the picture of residuals."""
_TILE_PX = 240


def calibrate_to_file(
    folder: Path,
    out: Path,
    *,
    rig_file: Path | None = None,
    card: tuple[float, tuple[float, float] | None] = (0.0, None),
    limit_percent: float | None = None,
    residuals: Path | None = None,
    progress: Progress = no_progress,
) -> RadiometricCalibration:
    """Calibrate the rig with the card in `folder` and write it to `out`. `rig_file`: the folder's own by default;
    `card`: its height in mm and tilt in deg, None for the tilt of the base in the rig file. Raises BadInput naming the
    folder or file at fault; nothing is written then.
    """
    check_rig_file(out)
    check_picture(residuals, folder)
    progress("reading", 0.0)
    plan = _read_radiometry_plan(folder)
    capture = read_capture(folder)
    rig = capture.rig if rig_file is None else read_rig(rig_file)
    height_mm, tilt_deg = card
    tilt_deg = _base_tilt_deg(rig) if tilt_deg is None else tilt_deg
    progress("camera", 0.3)
    camera = _measure_camera(plan, capture)
    black = _black_level_of(camera, capture)
    settings = RadiometrySettings() if limit_percent is None else RadiometrySettings(limit_percent=limit_percent)
    progress("flat field", 0.6)
    found = naming(folder, lambda: fit_radiometry(capture, rig, CardPlane(height_mm, tilt_deg), black, settings))
    warnings = [*found.warnings, *_black_level_warning(black, capture)]
    facts = {
        **found.facts,
        "camera": _camera_json(camera),
        "warnings": warnings,
        **provenance({"radiometry": settings}, {**capture.hashes, **camera.hashes}),
    }
    progress("writing", 0.9)
    rig = replace(found.rig, provenance={**found.rig.provenance, PROVENANCE: facts})
    if residuals is not None:
        write_image(residuals, _residual_picture(found))
    write_rig(rig, out)
    progress("done", 1.0)
    return replace(found, rig=rig, facts=facts, warnings=tuple(warnings))


def _base_tilt_deg(rig: Rig) -> tuple[float, float]:
    """Turn of the base about x and y as ``splitknit calibrate camera`` left it; zero below twice its deviation."""
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
    certain = math.isfinite(x) and math.isfinite(y) and 2.0 * deviation < math.hypot(x, y) <= _MAX_TILT_DEG
    return (x, y) if certain else (0.0, 0.0)


def check_folder(
    folder: Path, rig_file: Path, *, limit_percent: float | None = None, progress: Progress = no_progress
) -> dict[str, Any]:
    """Compare the card in `folder` with the calibration in `rig_file`; return the facts."""
    progress("reading", 0.0)
    rig = read_rig(rig_file)
    plan = _read_radiometry_plan(folder)
    capture = read_capture(folder)
    camera = _measure_camera(plan, capture)
    settings = RadiometrySettings() if limit_percent is None else RadiometrySettings(drift_percent=limit_percent)
    progress("comparing", 0.7)
    black = _black_level_of(camera, capture)
    found = naming(f"{rig_file} and {folder}", lambda: check_card(capture, rig, black, settings))
    facts = {**found, "limit_percent": settings.drift_percent, "inputs": dict(capture.hashes)}
    progress("done", 1.0)
    return facts


def _residual_picture(found: RadiometricCalibration) -> ColourArray:
    """Residuals of every LED, a band a row: blue 2 % darker than the model, orange 2 % brighter, black left out."""
    flat, shape = found.flat_field, found.images.shape
    bands = [led.band for led in flat.leds]
    rows = []
    widest = max(bands.count(band) for band in bands)
    for band in dict.fromkeys(bands):
        tiles = [residual_tile(100 * flat.residual[k], flat.dust, shape) for k, b in enumerate(bands) if b == band]
        tiles += [np.full_like(tiles[0], 255)] * (widest - len(tiles))
        rows.append(np.concatenate(tiles, axis=1))
    return np.concatenate(rows, axis=0)


def residual_tile(residual: Any, dust: Any, shape: tuple[int, int]) -> ColourArray:
    """Residuals of one light in per cent, as a picture: blue too dark, orange too bright by 2 %, black where unused."""
    values: FloatArray = np.asarray(residual, dtype=np.float32).reshape(shape)
    small = colour(values, -_SCALE_PERCENT, _SCALE_PERCENT, diverging=True)
    small[np.asarray(dust).reshape(shape)] = 0
    size = (_TILE_PX, round(_TILE_PX * shape[0] / shape[1]))
    tile = np.asarray(cv2.resize(small, size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
    return np.asarray(cv2.copyMakeBorder(tile, 4, 4, 4, 4, cv2.BORDER_CONSTANT, value=(255, 255, 255)), dtype=np.uint8)


# What a camera does by itself: its response and noise, measured on the images that ``radiometry.json`` names.

_PATCHES_ACROSS = 40
_MAX_TEXTURE = 0.04
"""Deviation within a patch, as a part of full scale, up to which it counts as even."""


@dataclass(frozen=True, slots=True, eq=False)
class _CameraFacts:
    """Results of dark frames and exposures; None where there are none."""

    dark: Dark | None
    response: Response | None
    noise: dict[str, NoiseModel]
    """By the channel's name; only of linear images."""
    hashes: dict[str, str]


def _measure_camera(plan: _RadiometryPlan, capture: Capture) -> _CameraFacts:
    """Measure dark frames and exposures, and compare the response with what the capture states of its images."""
    hashes: dict[str, str] = {}
    dark = None
    if plan.dark:
        frames = [_image(path, capture, hashes) for path in plan.dark]
        dark = dark_frames(frames, name=str(plan.dark[0]))
    response, samples = None, []
    if plan.exposures:
        rows = []
        for path, _ in plan.exposures:
            frame = _image(path, capture, hashes)
            rows.append(_patches(frame))
            samples += _noise(frame, dark)
        values, spread = (np.stack([row[part] for row in rows]) for part in (0, 1))
        even = spread.max(axis=0) <= _MAX_TEXTURE
        values = values[:, even] if int(even.sum()) >= 100 else values  # all, if few are even in all images
        response = fit_response(values, [time for _, time in plan.exposures], name=str(plan.document))
        require(
            response.encoding == capture.encoding,
            f"the exposures in {plan.document} are {response.encoding.replace('srgb', 'sRGB')}, but capture.json "
            f'states "encoding": "{capture.encoding}"; write "encoding": "{response.encoding}" there and in all '
            f"captures of this camera.",
        )
    if not samples:
        samples = [item for band in capture.bands.values() for frame in band.pixels for item in _noise(frame, dark)]
    if plan.document is not None:
        hashes[plan.document.name] = file_hash(plan.document)
    return _CameraFacts(dark, response, _noise_models(samples) if capture.encoding == "linear" else {}, hashes)


def _image(path: Path, capture: Capture, hashes: dict[str, str]) -> PixelArray:
    require(path.is_file(), f"{path}, which {DOCUMENT} names, does not exist; add it or remove its entry.")
    pixels = read_image(path)
    like = capture.bands["white"].pixels
    require(
        pixels.shape == like.shape[1:] and pixels.dtype == like.dtype,
        f"{path} has {pixels.shape[0]} x {pixels.shape[1]} pixels, {pixels.shape[2]} channels of "
        f"{pixels.dtype.itemsize * 8} bits, but the card's images have {like.shape[1]} x {like.shape[2]}, "
        f"{like.shape[3]} of {like.dtype.itemsize * 8}; take all with the same settings.",
    )
    hashes[path.name] = file_hash(path)
    return pixels


def _patches(frame: PixelArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Means (n * C,) of small squares as parts of full scale, NaN where clipped at either end, and their deviation."""
    full = np.float32(np.iinfo(frame.dtype).max)
    side = max(2, max(frame.shape[:2]) // _PATCHES_ACROSS)
    rows, columns = (size // side for size in frame.shape[:2])
    cut = frame[: rows * side, : columns * side].astype(np.float32) / full
    squares = cut.reshape(rows, side, columns, side, -1).transpose(0, 2, 4, 1, 3).reshape(-1, side * side)
    mean = squares.mean(axis=1).astype(np.float64)
    clipped = (squares.max(axis=1) >= 0.985) | ((squares == 0).mean(axis=1) > 0.02)
    return np.where(clipped, np.nan, mean), squares.std(axis=1).astype(np.float64)


def _noise(frame: PixelArray, dark: Dark | None) -> list[tuple[int, NDArray[np.float64], NDArray[np.float64]]]:
    black = dark.black_level if dark is not None else (0.0,) * frame.shape[2]
    return [(c, *noise_samples(frame, c, black[c])) for c in range(frame.shape[2])]


def _noise_models(samples: list[tuple[int, NDArray[np.float64], NDArray[np.float64]]]) -> dict[str, NoiseModel]:
    channels = sorted({c for c, _, _ in samples})
    names = ("red", "green", "blue") if len(channels) == 3 else ("grey",)
    found: dict[str, NoiseModel] = {}
    for c in channels:
        light = np.concatenate([x for k, x, _ in samples if k == c])
        variance = np.concatenate([y for k, _, y in samples if k == c])
        model = noise_model(light, variance)
        if model is not None:
            found[names[c]] = model
    return found


def _camera_json(camera: _CameraFacts) -> dict[str, Any]:
    """Return what was measured as plain JSON, parts of full scale in per cent."""
    dark, response = camera.dark, camera.response
    levels = ("black_level", "read_noise", "row_noise", "column_noise", "fixed_pattern")
    return {
        "dark": dark
        and {
            "frames": dark.frames,
            "hot_pixels": dark.hot_pixels,
            "hot_share": rounded(dark.hot_share),
            **{f"{name}_percent": _percent(getattr(dark, name)) for name in levels},
        },
        "response": response
        and {
            "encoding": response.encoding,
            "linear_departure_percent": rounded(response.linear_percent),
            "srgb_departure_percent": rounded(response.srgb_percent),
            "residual_percent": rounded(response.residual_percent),
            "black_level_percent": _percent(response.black_level),
            "values_percent": _percent(response.span),
        },
        "noise": {
            name: {
                "electrons_at_full_scale": rounded(model.electrons),
                "read_noise_percent": _percent(model.read_noise),
                "light_percent": _percent(model.span),
            }
            for name, model in camera.noise.items()
        },
    }


def _percent(parts: float | tuple[float, ...] | None) -> Any:
    """Parts of full scale in per cent."""
    return [rounded(100 * one) for one in parts] if isinstance(parts, tuple) else parts and rounded(100 * parts)


def _black_level_of(camera: _CameraFacts, capture: Capture) -> float | None:
    """Stored value of no light by the dark frames, or None without them."""
    if camera.dark is None:
        return None
    return float(np.mean(camera.dark.black_level)) * float(np.iinfo(capture.bands["white"].pixels.dtype).max)


def _black_level_warning(black_level: float | None, capture: Capture) -> list[str]:
    """Report that the capture's black level is not the dark frames'."""
    if black_level is None:
        return []
    full = float(np.iinfo(capture.bands["white"].pixels.dtype).max)
    stated = [float(value) for band in capture.bands.values() for value in band.black_level if value != 0]
    worst = max((abs(value - black_level) for value in stated), default=0.0)
    if worst <= 0.005 * full:
        return []
    return [
        f"capture.json states a black level of {stated[0]:g}, but the dark frames show {black_level:.1f}; correct it "
        f"in this and all captures of this camera."
    ]


def rounded(value: float) -> float:
    """A number for a report, to five digits."""
    return float(f"{value:.5g}")


DOCUMENT = "radiometry.json"
FORMAT, VERSION = "splitknit-radiometry", 1
_KNOWN = {"format", "version", "dark", "exposures"}


@dataclass(frozen=True, slots=True)
class _RadiometryPlan:
    """What ``radiometry.json`` names."""

    dark: tuple[Path, ...] = ()
    exposures: tuple[tuple[Path, float], ...] = ()
    """Images of the series, and time times gain of each."""
    document: Path | None = None


def _read_radiometry_plan(folder: Path) -> _RadiometryPlan:
    """Read ``radiometry.json``; an empty plan where there is none. Raises BadInput naming the file and the field."""
    file = folder / DOCUMENT
    if not file.is_file():
        return _RadiometryPlan()
    document, _ = read_json(file)
    fields = Fields(document, str(file))
    fields.format(FORMAT, VERSION)
    unknown = sorted(set(fields.keys()) - _KNOWN)
    require(not unknown, f"{file}: the field '{unknown[0] if unknown else ''}' is not known; correct or remove it.")
    dark: list[Path] = []
    if fields.has("dark"):
        given = fields.get("dark")
        names = given if isinstance(given, list) else [given]
        require(len(names) > 0, f"{file}: dark names no file; name one, or remove the field.")
        dark = [inside(folder, name, str(file), f"dark[{k}]") for k, name in enumerate(names)]
    exposures = []
    if fields.has("exposures"):
        for k, item in enumerate(fields.items("exposures")):
            entry = Fields(item, str(file), f"exposures[{k}]")
            time = entry.number("exposure_s", 1e-9, 1e6) * entry.number("gain", 1e-6, 1e6, 1.0)
            exposures.append((inside(folder, entry.get("file"), str(file), entry.path("file")), time))
        require(
            len(exposures) >= MIN_EXPOSURES,
            f"{file}: exposures names {len(exposures)} images, but at least {MIN_EXPOSURES} different ones are needed.",
        )
    files = [*dark, *(image for image, _ in exposures)]
    for k, path in enumerate(files):
        require(files.index(path) == k, f"{file} names {path.name} twice; every image serves once.")
    return _RadiometryPlan(tuple(dark), tuple(exposures), file)
