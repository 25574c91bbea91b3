"""Slopes from shading that was calibrated on balls: a regression from measured intensities and place to slopes.

A gel with a matt coat, lit from its sides, is lit by broad near lights, and by what its own surface reflects: no three
numbers for each light describe that. A ball of known radius shows every slope under the very lights, so a small
polynomial of the intensities, fitted there (:mod:`splitknit.calibration.shading`), carries what physics leaves out.

References
----------
M. K. Johnson, F. Cole, A. Raj and E. H. Adelson, "Microgeometry capture using an elastomeric sensor", SIGGRAPH 2011,
section 4: a table from intensities to gradients, made with balls.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.io.npz import read_npz, write_npz
from splitknit.model import FloatArray

Array = NDArray[np.float64]
FORMAT = "splitknit-shading"
BETWEEN = "between the balls"
"""Where the light of the flat gel was measured, in a shading's facts, if no photograph of the flat gel was given."""
_VERSION = 2
FLAT_TERMS = 15
"""Monomials of the place in a fall-off: those up to degree 4."""
_STRIP = 1 << 14
"""Pixels at once: their terms stay in a core's cache."""
_EVERY = 16
"""Pixels between those at which the regression's own covariance is evaluated; it is smooth."""
_BEYOND = 1.5
"""Slopes beyond so many times the steepest that was seen are shortened to it."""
_MAX_BYTES = 16_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Shading:
    """How slopes shade the images of one sensor: what ``splitknit calibrate shading`` writes.

    L lights, T terms of :func:`shading_terms`, P monomials of the place (:func:`place_terms`) up to degree 0 to 3.
    """

    pitch_mm: float
    """Side of a pixel on the object."""
    image_size: tuple[int, int]
    """Rows, columns."""
    direction: Array
    """(L, 3) unit vectors towards the lights from the middle of the field."""
    nearness: Array
    """(L,) 1 / distance of the light in 1/mm; 0: it is distant."""
    ambient: Array
    """(L,) fraction of a flat surface's light that comes from everywhere: other lights' reflections between slopes."""
    fall_off: Array
    """(L, 15) ln of a flat surface's brightness: monomials of the place up to degree 4; zeros: not measured."""
    relative: bool
    """Whether images are divided by their mean over the lights: the surface's own brightness then does not matter."""
    degree: int
    """Of the polynomial of the intensities."""
    weights: Array
    """(P T, 2) of the terms, place slowest: dz/dx and dz/dy. Empty (0, 2) where only a flat card was seen."""
    covariance: Array
    """(P T, P T) of the weights, mean of both slopes, from balls left out in turns."""
    deviation: Array
    """(B,) standard deviation of a slope's part where the slope is 0 to `max_slope`, in equal steps."""
    max_slope: float
    """Steepest slope that the balls showed; beyond it slopes are extrapolated."""
    height_mm_per_slope: float
    """Standard deviation of a height over that of a slope, on balls that were left out."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Of the fit, for people; plain JSON."""


def shading_terms(images: FloatArray, relative: bool, degree: int) -> FloatArray:
    """Monomials (T, N) up to a degree of how far roots of images (L, N) depart from those of a flat surface, 1.

    The noise of photons is that of a root everywhere alike (Anscombe's transform), and lobes of a coat are less sharp.
    """
    values = images / np.maximum(images.mean(axis=0), np.float32(1e-6)) if relative else images
    values = np.sqrt(np.maximum(values, np.float32(0.0))) - np.float32(1.0)
    count = len(values)
    terms = np.empty((term_count(count, degree), values.shape[1]), dtype=values.dtype)
    terms[0] = 1.0
    terms[1 : 1 + count] = values
    start, ends, first = 1, 1 + count, list(range(count))
    for _ in range(1, degree):
        last, begin = first, start
        start, first, at = ends, [], ends
        for k, light in enumerate(last):
            more = count - light
            np.multiply(values[light:], terms[begin + k], out=terms[at : at + more])
            first += range(light, count)
            at += more
        ends = at
    return terms


def facing_level(images: FloatArray) -> float:
    """Brightness of images (L, H, W) where all lights show the same: on what faces the camera, as the flat surface did.

    How far a gel is pressed in, and exposure, change all light by a few percent, and the slopes with it: images are
    divided by this, the flat surface's own level being 1.
    """
    some = images[:, ::8, ::8].reshape(len(images), -1)
    mean = some.mean(axis=0)
    lit = mean > 0.5 * np.median(mean)
    contrast = some.std(axis=0)[lit] / mean[lit]
    facing = contrast <= np.percentile(contrast, 20.0) if contrast.size else np.zeros(0, dtype=bool)
    level = float(np.median(mean[lit][facing])) if facing.any() else 1.0
    return level if level > 0 else 1.0


def term_count(lights: int, degree: int) -> int:
    """Number of monomials of so many variables up to a degree: a binomial coefficient."""
    return math.comb(lights + degree, degree)


def shading_slopes(shading: Shading, images: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slopes (2, H, W) of a surface, dz/dx and dz/dy with y up, and the standard deviation (H, W) of either.

    `images`: (L, H, W) linear light divided by the flat surface's, of the sensor's L lights (or the colours of one
    frame); a common factor does not matter (:func:`facing_level`). Slopes beyond 1.5 times the steepest calibrated one
    are shortened to it. Raises BadInput if the images have another number of lights or another size than those of the
    calibration, or it holds no balls.
    """
    lights, rows, columns = check_shading(shading, images)
    count = term_count(lights, shading.degree)
    places = len(shading.weights) // count
    matrix = np.ascontiguousarray(shading.weights.reshape(places, count, 2).transpose(0, 2, 1), dtype=np.float32)
    x, y = _axes(shading.image_size)
    powers = _powers(places)
    by_row = np.zeros((rows, 1 + powers[-1][1], 2, count), dtype=np.float32)  # of 1, x, x^2 ...: y is fixed in a row
    for (i, j), one in zip(powers, matrix, strict=True):
        by_row[:, i] += (y**j)[:, None, None] * one
    limit, top = _BEYOND * shading.max_slope, np.float32(shading.max_slope)
    fine = np.linspace(0.0, 2.0 * limit, 256)  # beyond what was seen the deviation grows with the excess
    known = np.interp(fine, np.linspace(0.0, float(top), len(shading.deviation)), shading.deviation)
    table = ((known * np.maximum(fine / top, 1.0) ** 2) ** 2).astype(np.float32)
    gradient = np.empty((2, rows, columns), dtype=np.float32)
    scale = np.float32(1.0) if shading.relative else np.float32(1.0 / facing_level(images))
    deviation = _own_variance(shading, images, scale)
    step = max(1, _STRIP // columns)
    for first in range(0, rows, step):
        strip = slice(first, first + step)
        part = images[:, strip] * scale
        terms = shading_terms(part.reshape(lights, -1), shading.relative, shading.degree)
        lines = terms.reshape(count, *part.shape[1:]).transpose(1, 0, 2)
        found = np.matmul(by_row[strip].reshape(len(lines), -1, count), lines)
        across, up = found[:, -2], found[:, -1]
        for k in range(found.shape[1] - 4, -1, -2):  # Horner's rule
            across, up = across * x + found[:, k], up * x + found[:, k + 1]
        slope = np.sqrt(across * across + up * up)
        deviation[strip] += table[
            (np.minimum(slope, np.float32(2.0 * limit)) * np.float32(127.5 / limit)).astype(np.uint8)
        ]
        gradient[0, strip], gradient[1, strip] = across, up
        if float(slope.max()) > limit:
            gradient[:, strip] *= np.minimum(np.float32(1.0), np.float32(limit) / np.maximum(slope, np.float32(1e-6)))
    return gradient, np.sqrt(deviation, out=deviation)


def _own_variance(shading: Shading, images: FloatArray, scale: np.float32) -> FloatArray:
    """(H, W) what the covariance of the weights makes of the terms, evaluated on every sixteenth pixel."""
    half = min(_EVERY // 2, images.shape[1] - 1, images.shape[2] - 1)
    some = images[:, half::_EVERY, half::_EVERY] * scale
    terms = shading_terms(some.reshape(len(images), -1), shading.relative, shading.degree)
    rows, columns = np.mgrid[half : images.shape[1] : _EVERY, half : images.shape[2] : _EVERY].reshape(2, -1)
    place = place_terms(shading.image_size, columns, rows, len(shading.covariance) // len(terms))
    whole = (place[:, None] * terms).reshape(-1, terms.shape[1])
    own = np.maximum(np.einsum("tn,tn->n", whole, shading.covariance.astype(np.float32) @ whole), np.float32(0.0))
    fine = cv2.resize(own.reshape(some.shape[1:]), images.shape[:0:-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine, dtype=np.float32)


def _powers(count: int) -> list[tuple[int, int]]:
    """Powers of x and y of the first monomials: 1, x, y, x^2, x y, y^2 ..."""
    return [(n - j, j) for n in range(count) for j in range(n + 1)][:count]


def _axes(size: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    rows, columns = size
    x = (np.arange(columns, dtype=np.float32) - np.float32(0.5 * (columns - 1))) / np.float32(0.5 * columns)
    y = (np.float32(0.5 * (rows - 1)) - np.arange(rows, dtype=np.float32)) / np.float32(0.5 * columns)
    return x, y


def place_terms(size: tuple[int, ...], columns: Any, rows: Any, count: int) -> FloatArray:
    """The first `count` monomials (P, N) of places (N,): x and y, up, in half widths from the middle of the image."""
    x, y = (np.interp(at, np.arange(len(axis)), axis) for at, axis in zip((columns, rows), _axes(size), strict=True))
    return np.stack([x**i * y**j for i, j in _powers(count)]).astype(np.float32)


def flat_of_fall_off(fall_off: Array, size: tuple[int, ...]) -> FloatArray:
    """(L, H, W) light of a flat surface from :attr:`Shading.fall_off` (L, 15)."""
    rows, columns = np.mgrid[: size[0], : size[1]].reshape(2, -1)
    terms = place_terms(size, columns, rows, fall_off.shape[1])
    return np.asarray(np.exp(fall_off.astype(np.float32) @ terms).reshape(-1, *size), dtype=np.float32)


def check_shading(shading: Shading, images: Any) -> tuple[int, int, int]:
    """Number of lights, rows, columns of images that fit a calibration. Raises BadInput."""
    require(len(shading.weights) > 0, "this shading was calibrated without balls; it holds no slopes.")
    lights, size = len(shading.direction), shading.image_size
    shape = np.shape(images)
    require(
        len(shape) == 3 and shape[0] == lights and shape[1:] == size,
        f"the shading is that of {lights} images of {size[0]} x {size[1]} pixels (rows x columns), but the photographs "
        f"are {' x '.join(map(str, shape))}; calibrate with photographs of this sensor.",
    )
    return lights, size[0], size[1]


def write_shading(path: str | os.PathLike[str], shading: Shading) -> None:
    """Write a calibration as an ``.npz`` file. Raises BadInput if it cannot be written."""
    arrays = {one.name: getattr(shading, one.name) for one in fields(shading) if one.name != "facts"}
    text = json.dumps(shading.facts, sort_keys=True, ensure_ascii=False, allow_nan=False)
    write_npz(path, {"format": FORMAT, "version": _VERSION, **arrays, "facts": text})


def read_shading(path: str | os.PathLike[str]) -> Shading:
    """Read a calibration that ``splitknit calibrate shading`` wrote.

    Raises BadInput if the file is missing, damaged, of another kind, or its arrays do not fit each other.
    """
    name = os.fspath(path)
    damaged = f"{name} is no calibration of 'splitknit calibrate shading', or damaged; write it again."
    arrays = read_npz(path, max_bytes=_MAX_BYTES)
    known = {one.name for one in fields(Shading)} | {"format", "version"}
    require(known <= set(arrays) and str(arrays["format"]) == FORMAT, damaged)
    require(int(arrays["version"]) == _VERSION, f"{name} is of another version of splitknit; calibrate again.")
    try:
        values: dict[str, Any] = {
            "pitch_mm": float(arrays["pitch_mm"]),
            "image_size": (int(arrays["image_size"][0]), int(arrays["image_size"][1])),
            "relative": bool(arrays["relative"]),
            "degree": int(arrays["degree"]),
            "max_slope": float(arrays["max_slope"]),
            "height_mm_per_slope": float(arrays["height_mm_per_slope"]),
            "facts": json.loads(str(arrays["facts"])),
        }
        for key in ("direction", "nearness", "ambient", "fall_off", "weights", "covariance", "deviation"):
            values[key] = arrays[key].astype(np.float64)
            require(bool(np.isfinite(values[key]).all()), damaged)
    except (ValueError, TypeError, IndexError) as error:
        raise BadInput(damaged) from error
    lights, degree, weights = len(values["direction"]), values["degree"], values["weights"]
    sound = 1 <= lights <= 64 and 1 <= degree <= 3 and values["pitch_mm"] > 0 and min(values["image_size"]) > 0
    require(sound, damaged)
    terms = term_count(lights, degree)
    fits = (
        values["direction"].shape == (lights, 3)
        and values["fall_off"].shape == (lights, FLAT_TERMS)
        and values["nearness"].shape == values["ambient"].shape == (lights,)
        and weights.shape in ((0, 2), *((terms * n, 2) for n in (1, 3, 6, 10)))
        and values["covariance"].shape == (len(weights), len(weights))
        and (
            len(weights) == 0
            or (values["max_slope"] > 0 and values["deviation"].ndim == 1 and len(values["deviation"]) > 1)
        )
    )
    require(fits, damaged)
    return Shading(**values)
