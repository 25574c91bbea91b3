"""A fingertip's shape from a rolled print alone: two silhouettes, and an ellipse across each row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from splitknit.errors import check_mask, require
from splitknit.model import BoolArray

_SMOOTH_MM = 0.5
"""Gaussian along the finger: the edge of the ink is ragged."""


def fingertip_of_print(
    inside: BoolArray, pitch_mm: float, *, aspect: float = 0.8, turn_deg: float = 180.0
) -> NDArray[np.float64]:
    """Shape of the finger that left a rolled print.

    A row of the print was rolled off an ellipse, so its length gives the half width: the frontal silhouette. The
    half height is `aspect` times that: the lateral one. Rows are one pitch apart along the skin of that profile.

    Parameters
    ----------
    inside : (H, W) bool
        Where there is ink, tip up; each row from its first to its last place.
    pitch_mm : float
        Side of a pixel.
    aspect : float
        Height of a section over its half width, from 0.2 to 2. A print does not tell it; 0.8 is the mean finger's of
        this simulator.
    turn_deg : float
        By how much the finger was rolled, from 60 to 300; 180 from nail to nail.

    Returns
    -------
    (H, W, 3) float64
        Place of each pixel on the finger, mm, from the axis at the last row: x to the right, y to the tip, z to the
        pad's top; NaN where there is no ink.

    Raises
    ------
    BadInput
        If there is no ink, or a number is out of its range.

    References
    ----------
    The thesis, chapter 2, on Donida Labati et al. [18], whose virtual views were made from a rolled print's
    silhouettes; the ellipses are this function's choice.

    Examples
    --------
    >>> import numpy as np
    >>> points = fingertip_of_print(np.ones((40, 63), bool), 0.5, aspect=1.0)  # half a cylinder of 10 mm radius
    >>> round(float(np.hypot(points[20, 3, 0], points[20, 3, 2])), 1)
    10.0
    """
    inside = check_mask(inside, (inside.shape[0], inside.shape[1]))
    require(bool(inside.any()), "the print is empty: not one pixel is ink.")
    require(0.0 < pitch_mm < 10.0, f"`pitch_mm` must lie between 0 and 10, but it is {pitch_mm:g}.")
    require(0.2 <= aspect <= 2.0, f"The aspect must lie in 0.2 to 2, but it is {aspect:g}.")
    require(60.0 <= turn_deg <= 300.0, f"A roll must turn by 60 to 300 deg, but it is {turn_deg:g}.")
    rows = np.arange(*(np.flatnonzero(inside.any(axis=1))[[0, -1]] + (0, 1)))
    known = rows[inside[rows].any(axis=1)]
    first = inside[known].argmax(axis=1)
    last = inside.shape[1] - 1 - inside[known, ::-1].argmax(axis=1)
    length, middle = (
        gaussian_filter1d(np.interp(rows, known, values), _SMOOTH_MM / pitch_mm, mode="nearest")
        for values in ((last - first + 1) * pitch_mm, 0.5 * (first + last))
    )
    angle = np.deg2rad(np.linspace(-0.5 * turn_deg, 0.5 * turn_deg, 721))
    speed = np.hypot(np.cos(angle), aspect * np.sin(angle))  # of the ellipse of half width 1
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(angle))])
    half = length / arc[-1]
    fall = np.clip(np.gradient(aspect * half, pitch_mm), -1.0, 1.0) if len(rows) > 1 else np.zeros(1)
    along = np.cumsum((np.sqrt(1.0 - fall**2) * pitch_mm)[::-1])[::-1]
    points = np.full((*inside.shape, 3), np.nan)
    for row, wide, centre, y in zip(rows, half, middle, along - along[-1], strict=True):
        columns = np.flatnonzero(inside[row])
        turn = np.interp((columns - centre) * pitch_mm / wide, arc - 0.5 * arc[-1], angle)
        x = (centre - 0.5 * (inside.shape[1] - 1)) * pitch_mm + wide * np.sin(turn)
        points[row, columns] = np.stack([x, np.full(columns.shape, y), aspect * wide * np.cos(turn)], axis=1)
    return points
