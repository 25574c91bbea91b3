"""Gels: slopes from shading that was calibrated on balls, by a regression from intensities and place; and printed dots.

A gel with a matt coat, lit from its sides, is lit by broad near lights, and by what its own surface reflects: no three
numbers for each light describe that. A ball of known radius shows every slope under the very lights, so a small
polynomial of the intensities, fitted there (:mod:`splitknit_rig.calibration.shading`), carries what physics leaves out.

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
from splitknit.model import BoolArray, FloatArray

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
    """Degree of the polynomial of the intensities."""
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
    """What the fit found, for people; plain JSON."""


def shading_terms(images: FloatArray, relative: bool, degree: int) -> FloatArray:
    """Monomials (T, N), up to `degree`, of the square roots of images (L, N) less 1, their value on a flat surface.

    A square root makes photon noise uniform (Anscombe's transform) and the coat's specular lobe wider.
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


def place_polynomials(factors: NDArray[np.floating], size: tuple[int, ...]) -> FloatArray:
    """(K, H, W) sums of the monomials of :func:`place_terms` with `factors` (K, P), over a whole image."""
    powers = _powers(factors.shape[1])
    square = np.zeros((len(factors), powers[-1][1] + 1, powers[-1][1] + 1))
    for k, (i, j) in enumerate(powers):
        square[:, j, i] = factors[:, k]
    x, y = (np.vander(axis.astype(np.float64), square.shape[1], increasing=True) for axis in _axes(size))
    return np.asarray(y @ square @ x.T, dtype=np.float32)


def flat_of_fall_off(fall_off: Array, size: tuple[int, ...]) -> FloatArray:
    """(L, H, W) light of a flat surface from :attr:`Shading.fall_off` (L, 15)."""
    return np.exp(place_polynomials(fall_off, size))


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
    damaged = f"{name} is not a calibration of 'splitknit calibrate shading', or damaged; write it again."
    arrays = read_npz(path, max_bytes=_MAX_BYTES)
    known = {one.name for one in fields(Shading)} | {"format", "version"}
    require(known <= set(arrays) and str(arrays["format"]) == FORMAT, damaged)
    require(int(arrays["version"]) == _VERSION, f"{name} is of another version of splitknit; calibrate again.")
    try:
        values: dict[str, Any] = {
            "image_size": (int(arrays["image_size"][0]), int(arrays["image_size"][1])),
            "relative": bool(arrays["relative"]),
            "degree": int(arrays["degree"]),
            "facts": json.loads(str(arrays["facts"])),
        }
        for key in ("pitch_mm", "max_slope", "height_mm_per_slope"):
            values[key] = float(arrays[key])
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


# Printed dots on an elastomer's coat: found, and bridged in what is measured around them.

_MARGIN = 0.2
"""Margin masked around a dot, over its diameter: there its edge, blurred by the lens, still darkens the coat."""
_LONGEST = 2.0
"""Longest dot in diameters, seen obliquely or where two touch; scratches and shadows are longer."""
_LEAST_AREA = 0.15
"""Smallest area of a dot, over a disc of its diameter: noise and dust are smaller."""
_CONTRAST = 0.25
"""Least contrast of a dot against the coat beside it."""
_TRIANGLE = 2.45
"""Half width of a triangular kernel over the standard deviation of the Gaussian that it stands for."""
_ROUNDS = 3
"""How often holes are filled with means over a square; a linear field is then filled to 0.2 % of its change."""


def find_markers(light: NDArray[np.floating], diameter_px: float) -> BoolArray:
    """Pixels (H, W) bool that printed dark dots of `diameter_px` (2 at least) cover, their blurred edge included.

    A dot absorbs every colour; a slope that turns from one light is still lit by the others. So a pixel belongs to a
    dot where *all* images of linear `light` (L, H, W), not divided by a flat photograph, are darker than their
    surroundings (the closing of the image by a square of 1.5 diameters) by a quarter or more, and the spot is about as
    large as a dot. Raises BadInput if the diameter is out of range. Source: J. Serra, "Image analysis and mathematical
    morphology", Academic Press 1982, chapter XII (the top-hat transform).

    >>> import numpy as np
    >>> light = np.full((3, 60, 80), 0.5)
    >>> light[:, 20:28, 30:38] = 0.1
    >>> dots = find_markers(light, 8)
    >>> bool(dots[24, 34]), bool(dots[40, 40])
    (True, False)
    """
    shape = np.shape(light)
    require(
        len(shape) == 3 and 2 <= diameter_px <= min(shape[1:]) / 4,
        f"a marker's diameter must lie between 2 pixels and a quarter of the image, but it is {diameter_px:g}.",
    )
    side = 2 * int(0.75 * diameter_px) + 3
    square = np.ones((side, side), np.uint8)
    dark = np.ones(shape[1:], np.bool_)
    for one in light:
        image = cv2.GaussianBlur(np.asarray(one, dtype=np.float32), (0, 0), 0.15 * diameter_px)
        dark &= image < np.float32(1.0 - _CONTRAST) * cv2.morphologyEx(image, cv2.MORPH_CLOSE, square)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(dark.view(np.uint8), connectivity=4)
    sound = boxes[:, cv2.CC_STAT_AREA] >= _LEAST_AREA * np.pi / 4 * diameter_px**2
    sound &= boxes[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1) <= _LONGEST * diameter_px
    sound[0] = False  # what is not dark
    if count < 2 or not sound.any():
        return np.zeros(shape[1:], np.bool_)
    margin = 2 * round(_MARGIN * diameter_px) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (margin, margin))
    return cv2.dilate(sound[labels].view(np.uint8), disc).view(np.bool_)


def bridge(fields: NDArray[np.floating], mask: BoolArray, reach_px: float) -> FloatArray:
    """`fields` (N, H, W) float32 whose masked pixels are replaced by means of the others near them.

    The means have a bell-shaped kernel (triangles along rows and columns) of standard deviation `reach_px`, about half
    the diameter of the holes, and inside larger holes of two and four times that and so on, normalised by how much of
    it is not masked. Then each masked pixel becomes the mean of a square around it, a few times over: a field that is
    linear across a hole stays so. Raises BadInput if everything is masked. Source: H. Knutsson and C.-F. Westin,
    "Normalized and differential convolution", CVPR 1993.

    >>> import numpy as np
    >>> hole = np.zeros((30, 30), bool)
    >>> hole[12:16, 12:16] = True
    >>> filled = bridge(np.where(hole, 9.0, 2.0)[None], hole, 2.0)
    >>> round(float(filled.max()), 3)
    2.0
    """
    require(not bool(mask.all()), "no pixel is left beside the markers; check their diameter.")
    result = np.array(fields, dtype=np.float32)
    known, reach = ~mask, reach_px
    while not known.all():
        across = (2 * round(_TRIANGLE * reach) + 1,) * 2  # its cost is the same however wide it is
        weight = cv2.stackBlur(known.astype(np.float32), across)
        filled = ~known & (weight > 0.05)
        for part in result:
            near = cv2.stackBlur(np.where(known, part, np.float32(0.0)), across)
            part[filled] = near[filled] / weight[filled]
        known, reach = known | filled, 2 * reach
    side = 2 * round(0.5 * reach_px) + 3
    for part in result:
        for _ in range(_ROUNDS):
            cv2.copyTo(cv2.blur(part, (side, side)), mask.view(np.uint8), part)
    return result
