"""Directions of lights from photographs of a ball: of its highlight on chrome, of its shading on matt grey.

The view is taken as parallel (along z), as that of a camera far from a small ball is. Directions point towards the
light, x right, y up, z to the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, check_stack, require
from splitknit.model import BoolArray, FloatArray

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ball:
    """A ball's outline in the image."""

    column: float
    row: float
    radius_px: float

    def normals(self, shape: tuple[int, int]) -> Points:
        """(H, W, 3) unit normals; NaN outside the outline."""
        rows, columns = np.mgrid[: shape[0], : shape[1]]
        x, y = (columns - self.column) / self.radius_px, (self.row - rows) / self.radius_px
        inner = 1.0 - x * x - y * y
        z = np.sqrt(np.where(inner >= 0, inner, np.nan))
        return np.stack([x + 0.0 * z, y + 0.0 * z, z], axis=-1)


def ball_of_mask(mask: Any) -> Ball:
    """Ball whose image is the true part of `mask` (H, W): a circle through its border; BadInput if it is none."""
    array = np.asarray(mask)
    require(array.ndim == 2, f"the ball's mask must have the shape (H, W), but it has {array.shape}.")
    inside = check_mask(array, (array.shape[0], array.shape[1]), name="the ball's mask")
    ball, off = _ball_in(inside, "the ball's mask is too small; it must be white where the ball is.")
    require(
        float(off.mean()) < 0.05 * (ball.radius_px - 0.5),
        "the ball's mask is no disc; it must be white where the whole ball is and black elsewhere.",
    )
    return ball


def find_ball(stack: Any) -> Ball:
    """Find the ball's outline in photographs (L, H, W) against a dark background, or raise BadInput."""
    images = check_stack(stack, least=1, name="the photographs of the ball")
    bright = images.max(axis=0)
    top = float(np.percentile(bright, 99.5))
    require(top > 0, "the photographs of the ball are black.")
    level = cv2.GaussianBlur(np.asarray(np.clip(bright / top, 0, 1), dtype=np.float32), (0, 0), 1.0)
    grey = np.rint(255 * np.sqrt(level)).astype(np.uint8)
    _, split = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(split, connectivity=8)
    require(count > 1, "no ball was found in the photographs; give its outline with --mask.")
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    ball, off = _ball_in(labels == largest, "no ball was found in the photographs; give its outline with --mask.")
    radius = ball.radius_px - 0.5
    require(
        float(np.median(off)) < 0.03 * radius and radius >= 8,
        "nothing round stands out in the photographs; give the ball's outline with --mask.",
    )
    return ball


def _ball_in(mask: BoolArray, small: str) -> tuple[Ball, Points]:
    """Circle by the longest outline of a mask, and how far its pixels (N,) lie off; `small` refuses short ones."""
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=len)[:, 0].astype(np.float64)
    require(len(outline) >= 20, small)
    column, row, radius = _circle(outline)
    # the contour runs through the centres of the outermost pixels, half a pixel inside the outline
    return Ball(column, row, radius + 0.5), np.abs(np.hypot(outline[:, 0] - column, outline[:, 1] - row) - radius)


def chrome_directions(stack: Any, ball: Ball) -> Points:
    """Directions (L, 3) from the highlights on a chrome ball in `stack` (L, H, W), linear light: the mirror image of a
    light is seen where the normal n halves the angle between light and view v, so that l = 2 (n . v) n - v. Raises
    BadInput if an image (numbered) has no highlight.
    """
    images = check_stack(stack, name="the photographs of the ball")
    inside = np.isfinite(ball.normals(images.shape[1:])[..., 2])
    require(bool(inside.any()), "the ball lies outside the photographs.")
    directions = []
    for number, image in enumerate(images):
        column, row = _highlight(image, inside, number)
        x, y = (column - ball.column) / ball.radius_px, (ball.row - row) / ball.radius_px
        z = float(np.sqrt(max(1.0 - x * x - y * y, 0.0)))
        directions.append((2.0 * z * x, 2.0 * z * y, 2.0 * z * z - 1.0))
    return np.array(directions)


def grey_directions(stack: Any, ball: Ball, clip_level: float = 0.98) -> tuple[Points, Points]:
    """Directions (L, 3) and strengths (L,) of lights from the shading of a matt ball, I = l . n by least squares.

    `stack` (L, H, W): linear, ambient light removed. The light is taken as distant: one that is near lights the ball's
    rim too little, and seems to stand further out (by 2.4 deg in the twin, a ball of 8 mm radius under LEDs 132 mm
    above its middle). Only pixels take part that the light reaches, well away from the ball's edge and below
    `clip_level`; which these are is evaluated again with every estimate. Raises BadInput if too little of the ball is
    lit in an image (numbered).
    """
    images = check_stack(stack, name="the photographs of the ball")
    normals = ball.normals(images.shape[1:])
    usable = np.isfinite(normals[..., 2]) & (np.nan_to_num(normals[..., 2]) > 0.3)
    require(int(usable.sum()) >= 50, "the ball is too small in the photographs, or outside them.")
    n = normals[usable]
    lights = []
    for number, image in enumerate(images):
        values = image[usable].astype(np.float64)
        good = values < clip_level
        light = np.zeros(3)
        lit = good & (values > 0.1 * float(np.percentile(values, 99)))
        for _ in range(20):
            require(
                int(lit.sum()) >= 30,
                f"image {number}: too little of the ball is lit and not clipped to determine the light's direction.",
            )
            before, light = light, np.linalg.lstsq(n[lit], values[lit], rcond=None)[0]
            expected = n @ light
            strength = float(np.linalg.norm(light))
            spread = 1.4826 * float(np.median(np.abs(values[lit] - expected[lit]))) + 1e-9
            # in the light by a margin, no gloss and no cast shadow
            lit = good & (expected > 0.15 * strength) & (np.abs(values - expected) < 3.0 * spread)
            if float(np.linalg.norm(light - before)) < 1e-9 * strength:
                break
        lights.append(light)
    array = np.array(lights)
    strengths = np.linalg.norm(array, axis=1)
    return array / strengths[:, None], strengths


def _circle(points: Points) -> tuple[float, float, float]:
    """Centre and radius of a circle through points (N, 2), least squares, points far from it left out in turn."""
    kept = np.ones(len(points), dtype=np.bool_)
    for _ in range(10):
        x, y = points[kept].T
        terms = np.stack([2 * x, 2 * y, np.ones_like(x)], axis=1)
        a, b, c = np.linalg.lstsq(terms, x * x + y * y, rcond=None)[0]
        radius = float(np.sqrt(max(c + a * a + b * b, 0.0)))
        off = np.abs(np.hypot(points[:, 0] - a, points[:, 1] - b) - radius)
        kept = off <= max(3.0 * float(np.median(off)), 1.0)
    return float(a), float(b), radius


def _highlight(image: FloatArray, inside: BoolArray, number: int) -> tuple[float, float]:
    values = np.where(inside, image, 0.0).astype(np.float64)
    top, usual = float(values.max()), float(np.median(values[inside]))
    require(top > max(3.0 * usual, 0.05), f"image {number}: no highlight stands out on the chrome ball.")
    level = usual + 0.5 * (top - usual)
    _, labels = cv2.connectedComponents((values >= level).astype(np.uint8), connectivity=8)
    sums = np.bincount(labels.ravel(), weights=np.maximum(values - level, 0).ravel() + (values >= level).ravel())
    sums[0] = 0.0
    rows, columns = np.nonzero(labels == int(np.argmax(sums)))
    weights = np.maximum(values[rows, columns] - level, 0.0) + 1e-9
    return float(np.average(columns, weights=weights)), float(np.average(rows, weights=weights))
