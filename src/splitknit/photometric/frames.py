"""In which frame the directions of the lights were measured, by the surface that they give."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from splitknit.errors import check_mask, require
from splitknit.model import BoolArray, FloatArray, Led, Rig

FRAMES: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "right-up": ((1, 0), (0, 1)),
    "right-down": ((1, 0), (0, -1)),
    "left-up": ((-1, 0), (0, 1)),
    "left-down": ((-1, 0), (0, -1)),
    "up-left": ((0, -1), (1, 0)),
    "down-right": ((0, 1), (-1, 0)),
    "up-right": ((0, 1), (1, 0)),
    "down-left": ((0, -1), (-1, 0)),
}
"""Where x and y point in the image, and the matrix that turns such a vector's x and y to x right, y up."""
_BLUR = 0.02
"""Blur (sigma) of the slopes, as a fraction of the mask's longer side: shape is judged, not noise and texture."""
_STEEPEST = 1.5
"""Normals beyond this slope, often in shadow, are shortened to it and left out of the curl."""
_WORSE = 2.0
"""Another frame must be more integrable by this factor to be named."""


@dataclass(frozen=True, slots=True)
class FrameFit:
    """The frame in which a field of normals is an integrable, convex surface."""

    frame: str
    """Name in :data:`FRAMES`; ``right-up`` where nothing speaks against it."""
    ratio: float
    """Curl in the stated frame over curl in the best one, as sums of squares."""


def fit_light_frame(normals: Any, mask: Any) -> FrameFit:
    """Find the frame in which the lights must have been measured, by the normals that they gave.

    Lights in another frame give normals in that frame. Of the eight frames whose axes run along the image's, only the
    right one, and that turned by 180 deg, give slopes without curl; of the two, the right one is convex: its slopes
    fall towards the outline.

    Parameters
    ----------
    normals : (H, W, 3)
        As :func:`splitknit.photometric.lambertian.lambertian` finds them: x right, y up, z to the camera.
    mask : (H, W) bool
        The whole object, so that its outline is where it turns away.

    Returns
    -------
    FrameFit

    Raises
    ------
    BadInput
        If the shapes disagree or the mask is empty.

    References
    ----------
    Integrability: R. T. Frankot and R. Chellappa, "A method for enforcing integrability in shape from shading
    algorithms", IEEE Trans. PAMI 10 (1988). The remaining ambiguity of concave and convex: P. N. Belhumeur,
    D. J. Kriegman and A. L. Yuille, "The bas-relief ambiguity", IJCV 35 (1999).

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[30:-31:-1, -30:31] / 40.0
    >>> ball = np.dstack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0.01))])
    >>> fit_light_frame(ball * [1, -1, 1], x**2 + y**2 < 0.5).frame
    'right-down'
    """
    field = np.asarray(normals, dtype=np.float32)
    require(field.ndim == 3 and field.shape[2] == 3, "normals must have the shape (H, W, 3).")
    inside = check_mask(mask, (field.shape[0], field.shape[1]))
    p, q, weight = _smooth_slopes(field, inside)
    curls = {name: _curl(*_turned(p, q, name), weight) for name in FRAMES}
    fits = {name: (curl, _falls(*_turned(p, q, name), weight)) for name, curl in curls.items()}
    convex = [name for name, (_, falls) in fits.items() if falls]
    best = min(convex, key=lambda name: curls[name], default="right-up")
    ratio = curls["right-up"] / max(curls[best], 1e-12)
    opposite = best == "left-down"  # without curl in both; only the outline distinguishes them
    return FrameFit(best if opposite or ratio > _WORSE else "right-up", float(ratio))


def rig_of_frame(rig: Rig, frame: str) -> Rig:
    """The rig whose LEDs (directions, positions, aims) were measured in `frame`, with x right and y up.

    Raises
    ------
    BadInput
        If the frame is none of :data:`FRAMES`.
    """
    require(frame in FRAMES, f"the frame of the lights must be one of {', '.join(FRAMES)}, but it is '{frame}'.")
    (a, b), (c, d) = FRAMES[frame]

    def turned(vector: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        return None if vector is None else (a * vector[0] + b * vector[1], c * vector[0] + d * vector[1], vector[2])

    def led(one: Led) -> Led:
        vectors = {name: turned(getattr(one, name)) for name in ("position_mm", "direction", "aim")}
        return replace(one, **vectors, also=tuple(led(other) for other in one.also))  # type: ignore[arg-type]

    return replace(rig, leds=tuple(led(one) for one in rig.leds))


def _turned(p: FloatArray, q: FloatArray, frame: str) -> tuple[FloatArray, FloatArray]:
    """Slopes as they are if x and y of `frame` were taken for x right and y up."""
    (a, b), (c, d) = FRAMES[frame]
    return a * p + b * q, c * p + d * q


def _smooth_slopes(normals: FloatArray, inside: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slopes (h, w) of the object, y up, blurred inside the mask, and the weight that is left of every pixel."""
    rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    part, cover = normals[window], inside[window].astype(np.float32)
    nz = np.maximum(part[..., 2], np.float32(1e-3))
    slopes = [-part[..., axis] / nz for axis in (0, 1)]
    steep = np.maximum(np.hypot(*slopes) / np.float32(_STEEPEST), np.float32(1.0))
    sigma = max(1.0, _BLUR * max(cover.shape))

    def blurred(values: FloatArray) -> FloatArray:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)

    mean = np.maximum(blurred(cover), np.float32(1e-3))
    p, q = (blurred(np.asarray(slope / steep * cover, dtype=np.float32)) / mean for slope in slopes)
    believed = cv2.erode((steep <= 1.0).astype(np.float32) * cover, np.ones((2 * round(sigma) + 1,) * 2))
    return np.asarray(p, np.float32), np.asarray(q, np.float32), np.asarray(believed, dtype=np.float32)


def _curl(p: FloatArray, q: FloatArray, weight: FloatArray) -> float:
    """Sum of the squared curl inside the mask."""
    dp_dy, dq_dx = -np.gradient(p, axis=0), np.gradient(q, axis=1)
    return float(np.sum(weight * (dp_dy - dq_dx) ** 2, dtype=np.float64))


def _falls(p: FloatArray, q: FloatArray, weight: FloatArray) -> bool:
    """Whether the surface falls towards the outline: the sum of its divergence is negative."""
    divergence = np.gradient(p, axis=1) - np.gradient(q, axis=0)
    return float(np.sum(weight * divergence, dtype=np.float64)) < 0.0
