"""Distant lights that nobody listed: their directions follow from the photographs, but for how deep
the surface is.

Photographs of a matt surface are I = S B: S (L, 3) lights, B (3, n) normals times albedo, both up
to a matrix A. Slopes without curl leave of it the bas-relief transformation f' = a f + m x + k y of
the heights. What chooses among these are lights of equal brightness, and albedo that does not
depend on the slope; lights on a ring leave it to the albedo alone.

References
----------
A. Yuille and D. Snow, "Shape and albedo from multiple images using integrability", CVPR 1997 (curl
of B's slopes is zero); P. N. Belhumeur, D. J. Kriegman and A. L. Yuille, "The bas-relief
ambiguity", IJCV 35 (1999), section 2 (the transformation); H. Hayakawa, "Photometric stereo under a
light source with arbitrary motion", JOSA A 11 (1994), for
|s_k| = 1; N. Alldrin, S. Mallick and D. Kriegman, CVPR 2007, for the distribution of the albedo.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from splitknit.capture import Capture
from splitknit.checks import check_mask, check_stack
from splitknit.errors import refusing, require
from splitknit.imaging.geometry import bounding_box
from splitknit.imaging.pixels import bin_mean
from splitknit.imaging.robust import cauchy
from splitknit.model import Array, BoolArray, FloatArray, Rig
from splitknit.observation.observe import observe

_UNDETERMINED = (
    "the photographs do not determine their lights; give a list of directions as `lights`."
)
_AMBIGUOUS = (
    "other lights explain the photographs as well; give a list of their directions as `lights`."
)
_REDUCED_SIDE = 220
"""Longest side of the reduced images, in px. Chosen on: speed."""


def with_estimated_lights(capture: Capture) -> Capture:
    """The capture; where its lights are unknown, with their directions by :func:`unknown_lights`,
    which may refuse."""
    if capture.rig.provenance.get("lights") != "unknown":
        return capture
    alone = capture.material == "opaque" and len(capture.bands) == 1
    require(
        alone,
        "unknown lights go with opaque things and white photographs alone; give a list of the"
        " lights.",
    )
    white = observe(capture).white
    binning = max(1, max(capture.shape) // (2 * _REDUCED_SIDE))
    mask = None
    if capture.mask is not None:
        mask = bin_mean(capture.mask.astype(np.float32), binning) > 0.99
    intensity = np.array([led.intensity for led in capture.rig.leds])
    stack = white.at(binning).grey
    stack /= intensity[:, None, None].astype(np.float32)
    ceilings = white.clips_at / intensity
    directions, deviation = unknown_lights(stack, mask, ceilings)
    leds = tuple(
        replace(led, direction=tuple(direction))
        for led, direction in zip(capture.rig.leds, directions.tolist(), strict=True)
    )
    origin = {**capture.rig.provenance, "lights": "estimated", "bas_relief": list(deviation)}
    return replace(capture, rig=replace(capture.rig, leds=leds, provenance=origin))


def bas_relief_of(rig: Rig) -> tuple[float, float, float] | None:
    """The deviation of :func:`unknown_lights` in a rig with such lights. Raises BadInput if it is
    damaged."""
    if "bas_relief" not in rig.provenance:
        return None
    with refusing(
        damaged
        := "the rig's provenance names no three numbers as bas_relief; read the photographs again."
    ):
        a, m, k = map(float, rig.provenance["bas_relief"])
        require(min(a, m, k) >= 0 and max(a, m, k) < np.inf, damaged)
    return a, m, k


def bas_relief_note(deviation: tuple[float, float, float]) -> str:
    """What lights that were estimated leave open."""
    deep, tilt = 100 * deviation[0], float(np.rad2deg(np.hypot(*deviation[1:])))
    return (
        "the lights' directions were estimated from the photographs: all heights may be off by one"
        f" factor, by {deep:.0f} % (standard deviation), and the whole tilted by {tilt:.1f} deg"
        " (bas-relief ambiguity); a hollow comes out as a hill, unless `light_frame` is left-down."
    )


def bas_relief_um(
    height_mm: FloatArray, inside: BoolArray, pitch_mm: float, deviation: Any
) -> FloatArray:
    """(H, W) standard deviation in um of heights whose bas-relief transformation has a `deviation`
    (a, m, k)."""
    rows, columns = np.indices(height_mm.shape, dtype=np.float32)
    fields = np.stack([height_mm, pitch_mm * columns, pitch_mm * rows])
    fields -= fields[:, inside].mean(axis=1)[:, None, None]
    variance = np.einsum("k,khw->hw", np.square(deviation), fields * fields)
    return np.asarray(1000.0 * np.sqrt(variance), dtype=np.float32)


_FEWEST = 6  # photographs that lights need which nobody knows
_SEARCHED_PLACES = 500
"""Places of the object that the search for the fit's start looks at. Chosen on: speed."""


def unknown_lights(
    stack: Any, mask: Any = None, ceilings: Any = np.inf
) -> tuple[Array, tuple[float, float, float]]:
    """Unit vectors (L, 3) towards distant lights of equal brightness, from photographs of a matt,
    mostly convex object; and the standard deviation of the bas-relief transformation: of its factor
    a, and of its slopes m and k.

    `stack`: (L, H, W) linear light, six images or more; `mask`: (H, W) the object, by default what
    is brighter than the background; `ceilings`: value, or (L,), from which images are clipped.
    Raises BadInput if the photographs do not determine the lights: there are fewer than six, too
    little is lit by four lights, or other lights explain them too.
    """
    images = check_stack(stack)
    require(
        len(images) >= _FEWEST,
        f"lights that nobody knows need {_FEWEST} photographs, but there are {len(images)}.",
    )
    inside = check_mask(mask, (images.shape[1], images.shape[2]))
    if mask is None:  # what is brighter than the background, by Otsu's threshold
        mean = images.mean(axis=0)
        grey = np.rint(
            255 * np.clip(mean / max(float(np.quantile(mean, 0.99)), 1e-12), 0, 1)
        ).astype(np.uint8)
        inside = np.asarray(cv2.threshold(grey, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[1] > 0)
    with refusing(_UNDETERMINED):  # singular matrices
        lights, fields, places = _factors(images, inside, np.broadcast_to(ceilings, len(images)))
        few = [field[:: max(1, len(field) // _SEARCHED_PLACES)] for field in fields]
        brightness = np.exp(np.log(np.linalg.norm(lights, axis=1)).mean())
        _, start = _fitted(lights, few, np.eye(3) * brightness, 0.0)
        solutions = [_fitted(lights, fields, turn @ start) for turn in _turns(few, start)]
        best, matrix = min(solutions, key=lambda solution: solution[0].cost)
        deviation = _deviation(best, matrix)
        unit = _directions(lights, matrix, fields[0], places)
    for rival, rival_matrix in solutions:
        cosine = (_directions(lights, rival_matrix, fields[0], places) * unit).sum(axis=1)
        # rivals are other lights that explain the photographs nearly as well
        near = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))).mean() < 10.0
        require(near or rival.cost > 1.5 + best.cost, _AMBIGUOUS)
    require((unit[:, 2] > 0).all(), _UNDETERMINED)
    return unit, deviation


_RANK = 2.0
"""Third singular value of the photographs over the fourth, at least: 4 on a glazed bear, 1 of
copies and of noise. Chosen on: real photographs (DiLiGenT's bear). Range: 1 to 4."""


def _factors(
    images: FloatArray, inside: BoolArray, ceilings: Any
) -> tuple[Array, list[Array], Array]:
    """S (L, 3); B, its derivatives to the right and upwards (n, 3) each; and places (n, 2), x
    right, y up: weighted alternating least squares, without shadows, clipped values and gloss."""
    box = bounding_box(inside)
    binning = max(1, int(np.ceil(max(inside[box].shape) / _REDUCED_SIDE)))
    clipped = (images[:, box[0], box[1]] >= np.asarray(ceilings)[:, None, None]).astype(np.float32)
    small, over = (bin_mean(part, binning) for part in (images[:, box[0], box[1]], clipped))
    small = np.stack([cv2.GaussianBlur(image, (0, 0), 1.0) for image in small])
    within = (
        cv2.erode(
            (bin_mean(inside[box].astype(np.float32), binning) > 0.99).astype(np.uint8),
            np.ones((7, 7)),
        )
        > 0
    )
    light = small[:, within].astype(np.float64)
    # a light is in shadow where its image is below this part of the brightest one's
    lit = (light > 0.15 * light.max(axis=0)) & (over[:, within] == 0)
    lit &= lit.sum(axis=0) >= 4
    enough = int((lit.sum(axis=0) >= 4).sum()) >= 4 * _SEARCHED_PLACES and bool(
        lit.any(axis=1).all()
    )
    require(
        enough,
        "too little of the object is lit in four photographs; give a list of the lights as"
        " `lights`.",
    )
    light /= light[lit].mean()
    whole = lit.sum(axis=0) >= np.quantile(lit.sum(axis=0), 0.7)
    left, size, _ = np.linalg.svd(light[:, whole], full_matrices=False)
    require(size[2] > _RANK * size[3] and size[2] > 1e-3 * size[0], _UNDETERMINED)
    lights, weights = left[:, :3] * size[:3] / np.sqrt(whole.sum()), lit.astype(np.float64)

    def surface_of(lights: Array, weights: Array) -> Array:
        moments = np.einsum("kn,ki,kj->nij", weights, lights, lights) + 1e-9 * np.eye(3)
        return np.linalg.solve(moments, ((weights * light).T @ lights)[..., None])[..., 0]

    for _ in range(30):
        surface = surface_of(lights, weights)
        residual = light - lights @ surface.T
        width = 3.0 * float(np.median(np.abs(residual[lit]))) + 1e-9
        weights = lit * cauchy(residual, width)
        moments = np.einsum("kn,ni,nj->kij", weights, surface, surface)
        lights = np.linalg.solve(moments, ((weights * light) @ surface)[..., None])[..., 0]
        lights = lights @ np.linalg.cholesky(surface.T @ surface / len(surface))
    field = np.zeros((*within.shape, 3))
    field[within] = surface_of(lights, weights)
    known = np.zeros(within.shape, np.uint8)
    known[within] = lit.any(axis=0)
    rows, columns = np.nonzero(cv2.erode(known, np.ones((3, 3)), borderValue=0))
    some = slice(None, None, max(1, len(rows) // 1000))  # enough, and quick
    rows, columns = rows[some], columns[some]
    across = 0.5 * (field[rows, columns + 1] - field[rows, columns - 1])
    up = 0.5 * (field[rows - 1, columns] - field[rows + 1, columns])
    return (
        lights,
        [field[rows, columns], across, up],
        np.column_stack([columns - columns.mean(), rows.mean() - rows]),
    )


def _figures(matrix: Array, lights: Array, fields: list[Array]) -> tuple[Array, Array, Array]:
    """ln of the brightness of lights (L,) and of the albedo (n,), and the curl (n,) of slopes over
    their own change, where B is `matrix` times what was factored."""
    surface, across, up = (part @ matrix.T for part in fields)
    strength = np.log(np.linalg.norm(lights @ np.linalg.inv(matrix), axis=1))
    albedo = np.log(np.linalg.norm(surface, axis=1))
    deep = surface[:, 2:]
    least = 0.05 * float(np.median(np.abs(deep)))
    deep = np.where(np.abs(deep) < least, least, deep)
    slope_x, slope_y = (
        (part * deep - surface * part[:, 2:])[:, :2] / deep**2 for part in (across, up)
    )
    change = float(np.median(np.hypot(np.hypot(*slope_x.T), np.hypot(*slope_y.T))))
    return (
        strength,
        albedo - np.median(albedo),
        (slope_y[:, 0] - slope_x[:, 1]) / max(change, 1e-12),
    )


_CURL_LEFT = 0.05  # curl over the slopes' own change that blur and gloss leave


def _fitted(
    lights: Array, fields: list[Array], matrix: Array, curls: float = 60.0
) -> tuple[Any, Array]:
    """Least squares of lights of one brightness, even albedo and slopes without curl (places as
    many as `curls`), by Cauchy's loss that narrows; and the matrix."""
    from scipy.optimize import least_squares  # slow to import, and needed here alone

    def residuals(values: Array, wide: float) -> Array:
        strength, albedo, curl = _figures(values.reshape(3, 3), lights, fields)
        # 30 independent places of albedo, whose logarithm deviates by 0.15; curl that blur leaves
        parts = (30.0, albedo / (wide * 0.15)), (curls, curl / (wide * _CURL_LEFT))
        robust = [np.sqrt(n / len(r) * np.log1p(r**2)) * np.sign(r) for n, r in parts]
        return np.concatenate([strength / 0.05, *robust])  # lights differ by 5 %

    for wide in (6.0, 2.0, 1.0):
        solution = least_squares(residuals, matrix.ravel(), args=(wide,), max_nfev=40)
        matrix = solution.x.reshape(3, 3)
    return solution, matrix


def _turns(fields: list[Array], matrix: Array, most: int = 3) -> list[Array]:
    """The rotations, some of them with a mirroring, after which slopes have the least curl; the
    best first."""
    normals = fields[0] @ matrix.T
    mean = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).mean(axis=0)
    facing = np.linalg.svd(mean[None])[2][[1, 2, 0]]
    facing[2] = mean / np.linalg.norm(mean)
    none = np.ones((1, 3))
    candidates = []
    for x, y in np.mgrid[-0.5:0.6:0.25, -0.5:0.6:0.25].reshape(2, -1).T:
        lean = cv2.Rodrigues(np.array([x, y, 0.0]))[0]
        for angle in np.pi * np.arange(12) / 12:
            for side in (1.0, -1.0):
                spin = cv2.Rodrigues(np.array([0.0, 0.0, angle]))[0]
                turn = lean @ spin @ np.diag([1.0, side, 1.0]) @ facing
                curl = _figures(turn @ matrix, none, fields)[2]
                candidates.append((float(np.log1p((curl / _CURL_LEFT) ** 2).mean()), turn))
    candidates.sort(key=lambda candidate: candidate[0])
    chosen: list[Array] = []
    for _, turn in candidates:
        if all(np.sum(turn * better) < 2.6 for better in chosen):
            chosen.append(turn)
    return chosen[:most]


_GLOSSY_SD = 0.2
"""Standard deviation of the factor a of the heights that is not noise: a glazed bear comes out 1.23
times too deep. Chosen on: real photographs (DiLiGenT's bear)."""


def _deviation(solution: Any, matrix: Array) -> tuple[float, float, float]:
    """Standard deviations of the bas-relief transformation of :func:`_fitted`: of its factor, and
    of its slopes."""
    normal = solution.jac.T @ solution.jac
    covariance = np.linalg.inv(normal + 1e-9 * np.trace(normal) * np.eye(9))
    # what changes of the matrix do to normals
    turns = np.eye(9).reshape(9, 3, 3) @ np.linalg.inv(matrix)
    factor = 0.5 * (turns[:, 0, 0] + turns[:, 1, 1]) - turns[:, 2, 2]
    reads = np.stack([factor, turns[:, 0, 2], turns[:, 1, 2]])
    a, m, k = np.sqrt(np.diag(reads @ covariance @ reads.T)).tolist()
    return float(np.hypot(a, _GLOSSY_SD)), m, k


def _directions(lights: Array, matrix: Array, surface: Array, places: Array) -> Array:
    """(L, 3) unit vectors, by which the surface faces the camera and is convex."""
    normals = surface @ matrix.T
    facing = np.sign(normals[:, 2].mean())
    directions = lights @ np.linalg.inv(matrix) * facing
    convex = np.sum(normals[:, :2] * places) * facing > 0
    directions[:, :2] *= 1.0 if convex else -1.0
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))
