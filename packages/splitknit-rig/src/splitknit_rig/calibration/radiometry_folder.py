"""A white card's folder in, a calibrated rig file or a verdict out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit import (
    Array,
    Capture,
    ColourArray,
    Fields,
    FloatArray,
    PixelArray,
    Progress,
    Rig,
    check_picture,
    check_rig_file,
    colour,
    file_hash,
    inside,
    naming,
    no_progress,
    path,
    provenance,
    read_capture,
    read_image,
    read_json,
    read_rig,
    require,
    write_image,
    write_rig,
)
from splitknit_rig.calibration.card_model import CardPlane
from splitknit_rig.calibration.jobs import RadiometryJob
from splitknit_rig.calibration.radiometry import (
    DRIFT_PERCENT,
    LIMIT_PERCENT,
    PROVENANCE,
    RadiometricCalibration,
    check_card,
    fit_radiometry,
)
from splitknit_rig.calibration.sensor import (
    MIN_EXPOSURES,
    Dark,
    NoiseModel,
    Response,
    dark_frames,
    fit_response,
    noise_model,
    noise_samples,
)

_MAX_TILT_DEG = 5.0
_SCALE_PERCENT = 2.0  # ends of the colours in the picture of residuals
_TILE_PX = 240


def calibrate_to_file(job: RadiometryJob, progress: Progress = no_progress) -> RadiometricCalibration:
    """Calibrate a rig with a card, and write it; BadInput names the folder or file at fault, and nothing is written."""
    folder, out, residuals = path(job.folder), path(job.out), path(job.residuals)
    check_rig_file(out)
    check_picture(residuals, folder)
    progress("reading", 0.0)
    plan = _read_radiometry_plan(folder)
    capture = read_capture(folder)
    rig = capture.rig if job.rig is None else read_rig(job.rig)
    plane = CardPlane(job.card_height_mm, job.card_tilt_deg or _base_tilt_deg(rig))
    progress("camera", 0.3)
    camera = _measure_camera(plan, capture)
    black = _black_level_of(camera, capture)
    limit_percent = LIMIT_PERCENT if job.limit_percent is None else job.limit_percent
    progress("flat field", 0.6)
    found = naming(folder, lambda: fit_radiometry(capture, rig, plane, black, limit_percent))
    warnings = [*found.warnings, *_black_level_warning(black, capture)]
    facts = {
        **found.facts,
        "camera": _camera_json(camera),
        "warnings": warnings,
        **provenance({"radiometry": {"limit_percent": limit_percent}}, {**capture.hashes, **camera.hashes}),
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
    try:
        found: Any = rig.provenance["camera"]["residuals"]["plane"]
        x, y = (float(value) for value in found["tilt_xy_deg"])
        deviation = float(found["tilt_deg_deviation"])
    except (KeyError, TypeError, ValueError):
        return 0.0, 0.0
    return (x, y) if 2.0 * deviation < math.hypot(x, y) <= _MAX_TILT_DEG else (0.0, 0.0)


def check_folder(
    folder: Path, rig_file: Path, *, limit_percent: float | None = None, progress: Progress = no_progress
) -> dict[str, Any]:
    """Compare the card in `folder` with the calibration in `rig_file`; return the facts."""
    progress("reading", 0.0)
    rig, plan, capture = read_rig(rig_file), _read_radiometry_plan(folder), read_capture(folder)
    black = _black_level_of(_measure_camera(plan, capture), capture)
    limit_percent = DRIFT_PERCENT if limit_percent is None else limit_percent
    progress("comparing", 0.7)
    found = naming(f"{rig_file} and {folder}", lambda: check_card(capture, rig, black, limit_percent))
    progress("done", 1.0)
    return {**found, "limit_percent": limit_percent, "inputs": dict(capture.hashes)}


def _residual_picture(found: RadiometricCalibration) -> ColourArray:
    """Residuals of every LED, a band a row: blue 2 % darker than the model, orange 2 % brighter, black left out."""
    flat, shape = found.flat_field, found.images.shape
    bands = [led.band for led in flat.leds]
    tiles = [residual_tile(100 * one, flat.dust, shape) for one in flat.residual]
    rows = [[tile for tile, b in zip(tiles, bands, strict=True) if b == band] for band in dict.fromkeys(bands)]
    blank, widest = np.full_like(tiles[0], 255), max(map(len, rows))
    return np.concatenate([np.concatenate(row + [blank] * (widest - len(row)), axis=1) for row in rows], axis=0)


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
_MAX_TEXTURE = 0.04  # deviation within a patch, as a part of full scale, up to which it counts as even


@dataclass(frozen=True, slots=True, eq=False)
class _CameraFacts:
    """Results of dark frames and exposures; None where there are none."""

    dark: Dark | None
    response: Response | None
    noise: dict[str, NoiseModel]  # by the channel's name; only of linear images
    hashes: dict[str, str]


def _measure_camera(plan: _RadiometryPlan, capture: Capture) -> _CameraFacts:
    """Measure dark frames and exposures, and compare the response with what the capture states of its images."""
    hashes: dict[str, str] = {}
    dark = None
    if plan.dark:
        dark = dark_frames([_image(path, capture, hashes) for path in plan.dark], name=str(plan.dark[0]))
    response, samples = None, []
    if plan.exposures:
        rows = []
        for path, _ in plan.exposures:  # one at a time: a series does not fit into a Raspberry Pi's memory
            frame = _image(path, capture, hashes)
            rows.append(_patches(frame))
            samples += _noise(frame, dark)
        values, spread = map(np.stack, zip(*rows, strict=True))
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


def _patches(frame: PixelArray) -> tuple[Array, Array]:
    """Means (n * C,) of small squares as parts of full scale, NaN where clipped at either end, and their deviation."""
    full = np.float32(np.iinfo(frame.dtype).max)
    side = max(2, max(frame.shape[:2]) // _PATCHES_ACROSS)
    rows, columns = (size // side for size in frame.shape[:2])
    cut = frame[: rows * side, : columns * side].astype(np.float32) / full
    squares = cut.reshape(rows, side, columns, side, -1).transpose(0, 2, 4, 1, 3).reshape(-1, side * side)
    mean = squares.mean(axis=1).astype(np.float64)
    clipped = (squares.max(axis=1) >= 0.985) | ((squares == 0).mean(axis=1) > 0.02)
    return np.where(clipped, np.nan, mean), squares.std(axis=1).astype(np.float64)


def _noise(frame: PixelArray, dark: Dark | None) -> list[tuple[int, Array, Array]]:
    black = dark.black_level if dark is not None else (0.0,) * frame.shape[2]
    return [(c, *noise_samples(frame, c, black[c])) for c in range(frame.shape[2])]


def _noise_models(samples: list[tuple[int, Array, Array]]) -> dict[str, NoiseModel]:
    count = 1 + max(c for c, _, _ in samples)
    found: dict[str, NoiseModel] = {}
    for c, name in enumerate(("red", "green", "blue") if count == 3 else ("grey",)):
        light, variance = (np.concatenate([one[part] for one in samples if one[0] == c]) for part in (1, 2))
        if (model := noise_model(light, variance)) is not None:
            found[name] = model
    return found


def _camera_json(camera: _CameraFacts) -> dict[str, Any]:
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
    return [rounded(100 * one) for one in parts] if isinstance(parts, tuple) else parts and rounded(100 * parts)


def _black_level_of(camera: _CameraFacts, capture: Capture) -> float | None:
    """Stored value of no light by the dark frames, or None without them."""
    if camera.dark is None:
        return None
    return float(np.mean(camera.dark.black_level)) * float(np.iinfo(capture.bands["white"].pixels.dtype).max)


def _black_level_warning(black_level: float | None, capture: Capture) -> list[str]:
    if black_level is None:
        return []
    full = float(np.iinfo(capture.bands["white"].pixels.dtype).max)
    stated = [float(value) for band in capture.bands.values() for value in band.black_level if value != 0]
    words = (
        f"capture.json states a black level of {stated[0] if stated else 0:g}, but the dark frames show "
        f"{black_level:.1f}; correct it in this and all captures of this camera."
    )
    return [words] if any(abs(value - black_level) > 0.005 * full for value in stated) else []


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
    exposures: tuple[tuple[Path, float], ...] = ()  # images of the series, and time times gain of each
    document: Path | None = None


def _read_radiometry_plan(folder: Path) -> _RadiometryPlan:
    """Read ``radiometry.json``; an empty plan where there is none. Raises BadInput naming the file and the field."""
    file = folder / DOCUMENT
    if not file.is_file():
        return _RadiometryPlan()
    fields = Fields(read_json(file)[0], str(file))
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
    files = [*dark, *(one for one, _ in exposures)]
    for k, image in enumerate(files):
        require(files.index(image) == k, f"{file} names {image.name} twice; every image serves once.")
    return _RadiometryPlan(tuple(dark), tuple(exposures), file)
