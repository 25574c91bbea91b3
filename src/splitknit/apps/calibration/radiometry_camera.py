"""What a camera does by itself: its response and noise, measured on the images that ``radiometry.json`` names."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.apps.calibration.radiometry_folder import DOCUMENT, RadiometryPlan
from splitknit.calibration.response import Response, ResponseSettings, fit_response
from splitknit.calibration.sensor_noise import Dark, NoiseModel, dark_frames, noise_model, noise_samples
from splitknit.errors import require
from splitknit.io import file_hash, read_image
from splitknit.model import Capture, PixelArray

_PATCHES_ACROSS = 40
_MOST_TEXTURE = 0.04
"""Deviation within a patch, as a part of full scale, up to which it counts as even."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraFacts:
    """What dark frames and exposures say; None where there are none."""

    dark: Dark | None
    response: Response | None
    noise: dict[str, NoiseModel]
    """By the channel's name; only of linear images."""
    hashes: dict[str, str]


def measure_camera(plan: RadiometryPlan, capture: Capture, limit_percent: float = 1.0) -> CameraFacts:
    """Measure dark frames and exposures, and compare the response with what the capture says of its images.

    Raises
    ------
    BadInput
        Naming the file, if an image is missing or unlike the card's, light fell on a dark frame, or the response is
        not the one that the capture names.
    """
    hashes: dict[str, str] = {}
    dark = None
    if plan.dark:
        frames = [_image(path, capture, hashes) for path in plan.dark]
        dark = dark_frames(frames, name=str(plan.dark[0]))
    response, samples = None, []
    if plan.exposures:
        rows = []
        for one in plan.exposures:
            frame = _image(one.file, capture, hashes)
            rows.append(_patches(frame))
            samples += _noise(frame, dark)
        values, even = (np.stack([row[part] for row in rows]) for part in (0, 1))
        chosen = ResponseSettings(limit_percent=limit_percent)
        response = fit_response(
            _even_patches(values, even), [one.exposure for one in plan.exposures], chosen, name=str(plan.document)
        )
        require(
            response.encoding == capture.encoding,
            f"the exposures in {plan.document} are {_WORDS[response.encoding]}, but capture.json says "
            f'"encoding": "{capture.encoding}"; write "encoding": "{response.encoding}" there and in all captures '
            f"of this camera.",
        )
    if not samples:
        samples = [item for band in capture.bands.values() for frame in band.pixels for item in _noise(frame, dark)]
    if plan.document is not None:
        hashes[plan.document.name] = file_hash(plan.document)
    return CameraFacts(dark, response, _noise_models(samples) if capture.encoding == "linear" else {}, hashes)


_WORDS = {"linear": "linear", "srgb": "sRGB"}


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


def _even_patches(values: NDArray[np.float64], spread: NDArray[np.float64]) -> NDArray[np.float64]:
    """Patches (J, n) that are even in all images, or all if these are few."""
    even = spread.max(axis=0) <= _MOST_TEXTURE
    return values[:, even] if int(even.sum()) >= 100 else values


def _noise(frame: PixelArray, dark: Dark | None) -> list[tuple[int, NDArray[np.float64], NDArray[np.float64]]]:
    black = dark.black_level if dark is not None else (0.0,) * frame.shape[2]
    return [(c, *noise_samples(frame, c, black[c])) for c in range(frame.shape[2])]


def _noise_models(
    samples: list[tuple[int, NDArray[np.float64], NDArray[np.float64]]],
) -> dict[str, NoiseModel]:
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


def camera_json(camera: CameraFacts) -> dict[str, Any]:
    """Return what was measured as plain JSON, parts of full scale in per cent."""
    dark, response = camera.dark, camera.response
    return {
        "dark": None
        if dark is None
        else {
            "frames": dark.frames,
            "black_level_percent": [_round(100 * value) for value in dark.black_level],
            "read_noise_percent": None if dark.read_noise is None else [_round(100 * v) for v in dark.read_noise],
            "hot_pixels": dark.hot_pixels,
            "hot_share": _round(dark.hot_share),
            "row_noise_percent": _round(100 * dark.row_noise),
            "column_noise_percent": _round(100 * dark.column_noise),
            "fixed_pattern_percent": None if dark.fixed_pattern is None else _round(100 * dark.fixed_pattern),
        },
        "response": None
        if response is None
        else {
            "encoding": response.encoding,
            "linear_departure_percent": _round(response.linear_percent),
            "srgb_departure_percent": _round(response.srgb_percent),
            "residual_percent": _round(response.residual_percent),
            "black_level_percent": _round(100 * response.black_level),
            "values_percent": [_round(100 * value) for value in response.span],
        },
        "noise": {
            name: {
                "electrons_at_full_scale": _round(model.electrons),
                "read_noise_percent": _round(100 * model.read_noise),
                "light_percent": [_round(100 * value) for value in model.span],
            }
            for name, model in camera.noise.items()
        },
    }


def black_level_of(camera: CameraFacts, capture: Capture) -> float | None:
    """Stored value of no light by the dark frames, or None without them."""
    if camera.dark is None:
        return None
    return float(np.mean(camera.dark.black_level)) * float(np.iinfo(capture.bands["white"].pixels.dtype).max)


def black_level_warning(black_level: float | None, capture: Capture) -> list[str]:
    """Say that the capture's black level is not the dark frames'."""
    if black_level is None:
        return []
    full = float(np.iinfo(capture.bands["white"].pixels.dtype).max)
    stated = [float(value) for band in capture.bands.values() for value in band.black_level if value != 0]
    worst = max((abs(value - black_level) for value in stated), default=0.0)
    if worst <= 0.005 * full:
        return []
    return [
        f"capture.json says a black level of {stated[0]:g}, but the dark frames show {black_level:.1f}; correct it "
        f"in this and all captures of this camera."
    ]


def _round(value: float) -> float:
    return float(f"{value:.5g}")
