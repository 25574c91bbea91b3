"""From a white card's capture folder to a calibrated rig file."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from splitknit import Capture, Rig, read_capture, read_rig, write_rig
from splitknit.errors import naming, require
from splitknit.io.fields import Version1, inside, read_document
from splitknit.io.provenance import file_hash, provenance
from splitknit.model import Array, PixelArray, Progress
from splitknit.observation.light import FULL_SCALE
from splitknit_rig.calibration.card_model import CardPlane
from splitknit_rig.calibration.nail_photos import image_of_size
from splitknit_rig.calibration.radiometry import (
    MAX_RESIDUAL_PERCENT,
    PROVENANCE,
    RadiometricCalibration,
    fit_radiometry,
    rounded,
)
from splitknit_rig.calibration.sensor import MIN_EXPOSURES, fit_response
from splitknit_rig.calibration.written import check_rig_file


def calibrate_to_file(
    folder: Path,
    out: Path,
    *,
    rig_file: Path | None,
    limit_percent: float | None,
    card_height_mm: float,
    card_tilt_deg: tuple[float, float] | None,
    progress: Progress,
) -> RadiometricCalibration:
    """Calibrate a rig with a card, and write it. BadInput names the folder or file at fault;
    nothing is then written."""
    check_rig_file(out)
    progress("reading", 0.0)
    capture = read_capture(folder)
    rig = capture.rig if rig_file is None else read_rig(rig_file)
    plane = CardPlane(card_height_mm, card_tilt_deg or base_tilt_deg(rig))
    progress("camera", 0.3)
    hashes = dict(capture.hashes)
    response = _measured_response(folder, capture, hashes)
    limit = limit_percent or MAX_RESIDUAL_PERCENT
    progress("flat field", 0.6)
    calibration = naming(folder, lambda: fit_radiometry(capture, rig, plane, limit))
    facts = {
        **calibration.facts,
        "response": response,
        "findings": [finding.facts for finding in calibration.findings],
        **provenance({"limit_percent": limit}, hashes),
    }
    progress("writing", 0.9)
    rig = replace(calibration.rig, provenance={**calibration.rig.provenance, PROVENANCE: facts})
    write_rig(rig, out)
    progress("done", 1.0)
    return replace(
        calibration,
        rig=rig,
        facts={**facts, "out": str(out)},
        base_tilt=card_tilt_deg is None,
    )


def base_tilt_deg(rig: Rig) -> tuple[float, float]:
    """Turn of the base about x and y as measured by ``splitknit calibrate camera``; zero if below
    twice its standard deviation."""
    try:
        plane: Any = rig.provenance["camera"]["residuals"]["plane"]
        x, y = (float(value) for value in plane["tilt_xy_deg"])
        deviation = float(plane["tilt_deg_deviation"])
    except (KeyError, TypeError, ValueError):
        return 0.0, 0.0
    # a base that is tilted by more than 5 deg is not taken for the card
    return (x, y) if 2.0 * deviation < math.hypot(x, y) <= 5.0 else (0.0, 0.0)


# The camera's response, measured on the images that ``radiometry.json`` names.


def _measured_response(
    folder: Path, capture: Capture, hashes: dict[str, str]
) -> dict[str, Any] | None:
    """The camera's response from its exposure series, compared with the encoding that the capture
    states; None without a series."""
    series = exposure_series(folder, capture, hashes)
    if series is None:
        return None
    values, times = series
    document = folder / DOCUMENT
    response = fit_response(values, times, name=str(document))
    require(
        response.encoding == capture.encoding,
        f"the exposures in {document} are {response.encoding.replace('srgb', 'sRGB')}, but"
        " capture.json "
        f'states "encoding": "{capture.encoding}"; write "encoding": "{response.encoding}" there'
        " and in all "
        f"captures of this camera.",
    )
    return {
        "encoding": response.encoding,
        "linear_departure_percent": rounded(response.linear_percent),
        "srgb_departure_percent": rounded(response.srgb_percent),
        "residual_percent": rounded(response.residual_percent),
        "values_percent": [rounded(100 * end) for end in response.span],
    }


def exposure_series(
    folder: Path, capture: Capture, hashes: dict[str, str]
) -> tuple[Array, Array] | None:
    """Values (J, N) of small patches in the images that ``radiometry.json`` names, as fractions of
    full scale, NaN where clipped, and time times gain (J,) of each; None if it names none."""
    exposures = read_exposures(folder)
    if not exposures:
        return None
    # one at a time: a series does not fit into a Raspberry Pi's memory
    rows = [patches(_image(path, capture, hashes)) for path, _ in exposures]
    values, spread = map(np.stack, zip(*rows, strict=True))
    # patches within 4 % of full scale are even
    even = spread.max(axis=0) <= 0.04
    hashes[DOCUMENT] = file_hash(folder / DOCUMENT)
    # all, if few are even in all images
    values = values[:, even] if int(even.sum()) >= 100 else values
    return values, np.array([time for _, time in exposures])


def _image(path: Path, capture: Capture, hashes: dict[str, str]) -> PixelArray:
    require(
        path.is_file(),
        f"{path}, which {DOCUMENT} names, does not exist; add it or remove its entry.",
    )
    like = capture.bands["white"].pixels
    other = (
        f"the card's images have {like.shape[1]} x {like.shape[2]}; take all with the same settings"
    )
    pixels, hashes[path.name] = image_of_size(path, (like.shape[1], like.shape[2]), other)
    require(
        pixels.shape == like.shape[1:] and pixels.dtype == like.dtype,
        f"{path} has {pixels.shape[0]} x {pixels.shape[1]} pixels, {pixels.shape[2]} channels of"
        f" {pixels.dtype.itemsize * 8} bits, but the card's images have {like.shape[1]} x"
        f" {like.shape[2]}, {like.shape[3]} of {like.dtype.itemsize * 8}; take all with the same"
        " settings.",
    )
    return pixels


def patches(frame: PixelArray) -> tuple[Array, Array]:
    """Means (n * C,) of small squares as fractions of full scale, NaN where clipped at either end,
    and their standard deviation."""
    full = np.float32(np.iinfo(frame.dtype).max)
    side = max(2, max(frame.shape[:2]) // 40)  # 40 patches along the longer side
    rows, columns = (size // side for size in frame.shape[:2])
    cut = frame[: rows * side, : columns * side].astype(np.float32) / full
    squares = (
        cut.reshape(rows, side, columns, side, -1).transpose(0, 2, 4, 1, 3).reshape(-1, side * side)
    )
    mean = squares.mean(axis=1).astype(np.float64)
    clipped = (squares.max(axis=1) >= FULL_SCALE) | ((squares == 0).mean(axis=1) > 0.02)
    return np.where(clipped, np.nan, mean), squares.std(axis=1).astype(np.float64)


DOCUMENT = "radiometry.json"


class _Exposure(Struct):
    file: str
    exposure_s: Annotated[float, Meta(ge=1e-9, le=1e6)]
    gain: Annotated[float, Meta(ge=1e-6, le=1e6)] = 1.0


class _Document(Struct, forbid_unknown_fields=True):
    format: Annotated[str, Meta(pattern="^(splitknit-radiometry)$")]
    version: Version1
    exposures: tuple[_Exposure, ...] = ()


def read_exposures(folder: Path) -> tuple[tuple[Path, float], ...]:
    """Images of the series in ``radiometry.json``, and time times gain of each; none if there is no
    such file. Raises BadInput naming the file and the field.
    """
    file = folder / DOCUMENT
    if not file.is_file():
        return ()
    document, _ = read_document(file, _Document)
    exposures: dict[Path, float] = {}
    for k, entry in enumerate(document.exposures):
        image = inside(folder, entry.file, str(file), f"exposures[{k}].file")
        require(
            image not in exposures, f"{file} names {image.name} twice; every image serves once."
        )
        exposures[image] = entry.exposure_s * entry.gain
    few = (
        f"{file}: exposures names {len(exposures)} images, but at least {MIN_EXPOSURES} different"
        " ones are needed."
    )
    require(len(exposures) == 0 or len(exposures) >= MIN_EXPOSURES, few)
    return tuple(exposures.items())
