"""Directions of lights from photographs of a ball: from the highlight on chrome, or the shading of
matt grey.

Directions point from the ball's middle to the light, x right, y up, z to the camera. Without a
scale the view is taken as parallel (along z) and the light as distant. With it `eye` (3,) is the
camera's centre, and `away` (L,) the distances of the lights as drawn, both from the ball's middle,
in radii of the ball; near lights then cause no error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from splitknit.checks import check_mask, check_stack
from splitknit.errors import require
from splitknit.imaging.robust import deviation
from splitknit.model import Array, BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Ball:
    """A ball's outline in the image."""

    column: float
    row: float
    radius_px: float

    def normals(self, shape: tuple[int, int], eye: Array | None = None) -> Array:
        """(H, W, 3) unit normals; NaN outside the outline."""
        rows, columns = np.mgrid[: shape[0], : shape[1]]
        return self.seen(columns, rows, eye)[0]

    def seen(self, column: Any, row: Any, eye: Array | None = None) -> tuple[Array, Array]:
        """Unit normals (..., 3) where lines of sight meet the ball, NaN where they miss it, and
        unit vectors to the camera."""
        x, y = (column - self.column) / self.radius_px, (self.row - row) / self.radius_px
        level = np.stack(np.broadcast_arrays(x, y, 0.0), axis=-1)
        view = np.array([0.0, 0.0, 1.0]) if eye is None else eye - level
        view = view / np.linalg.norm(view, axis=-1, keepdims=True)
        along = np.sum(level * view, axis=-1)
        inner = along**2 - np.sum(level**2, axis=-1) + 1.0
        ahead = np.sqrt(np.where(inner >= 0, inner, np.nan)) - along
        return level + ahead[..., None] * view, view


def balls_of_mask(mask: Any) -> list[Ball]:
    """Balls whose images are the discs of `mask` (H, W): circles through their borders. Raises
    BadInput if a region is not a disc."""
    array = np.asarray(mask)
    require(
        array.ndim == 2, f"the ball's mask must have the shape (H, W), but it has {array.shape}."
    )
    inside = check_mask(array, (array.shape[0], array.shape[1]), name="the ball's mask")
    small = "the ball's mask is too small; it must be white where the ball is."
    count, labels = cv2.connectedComponents(inside.astype(np.uint8), connectivity=8)
    balls = []
    for label in range(1, count):
        ball, off = _ball_in(labels == label, small)
        require(
            float(off.mean()) < 0.05 * (ball.radius_px - 0.5),
            "the ball's mask is not a disc; it must be white where the whole ball is and black"
            " elsewhere.",
        )
        balls.append(ball)
    return balls


_MIN_BALL_PX = 8.5  # radius of a ball that is found without a mask


def find_ball(stack: Any) -> Ball:
    """Outline of the largest ball in photographs (L, H, W) against a dark background, or raise
    BadInput."""
    images = check_stack(stack, least=1, name="the photographs of the ball")
    bright = images.max(axis=0)
    top = float(np.percentile(bright, 99.5))
    require(top > 0, "the photographs of the ball are black.")
    level = cv2.GaussianBlur(np.asarray(np.clip(bright / top, 0, 1), dtype=np.float32), (0, 0), 1.0)
    grey = np.rint(255 * np.sqrt(level)).astype(np.uint8)
    _, split = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(split, connectivity=8)
    missing = "no ball was found in the photographs; give its outline with `ball` or `mask`."
    require(count > 1, missing)
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    ball, off = _ball_in(labels == largest, missing)
    is_round = float(np.median(off)) < 0.03 * (ball.radius_px - 0.5)
    require(
        is_round and ball.radius_px >= _MIN_BALL_PX,
        "nothing round stands out in the photographs; give the ball's outline with `ball` or"
        " `mask`.",
    )
    return ball


_RIM_RAYS = 360  # from a ball's middle
_ANGLES = 2.0 * np.pi * np.arange(_RIM_RAYS)[:, None] / _RIM_RAYS
MIN_RIM_PX = 40.0
"""Smallest radius for which the rim is searched: 5 of 12 smaller balls came out 3 to 12 % wrong.
Chosen on: simulated objects (drawn balls on textures)."""


def rim_of(stack: Any, ball: Ball) -> tuple[Ball, float]:
    """Ball whose rim is visible in photographs (L, H, W) near a given one, and the fraction of rays
    from its middle that agree on it, 0 if the ball is small. A ray's edge is where sqrt(I) is
    steepest, squares added over photographs (Di Zenzo 1986), so that edges which move with the
    light count little; the circle is the one through three of them on which most lie.
    """
    images = check_stack(stack, least=1, name="the photographs of the ball")
    rows, columns = images.shape[1:]
    agreed = 0.0
    if ball.radius_px < MIN_RIM_PX:
        return ball, agreed
    for _ in range(2):  # from a better middle more rays meet the rim squarely
        # the rim lies within a tenth of the radius off the outline
        reach, step = 0.1 * ball.radius_px, max(0.5, ball.radius_px / 300.0)
        radii = np.arange(ball.radius_px - reach, ball.radius_px + reach, step)
        x, y = _on_rays(ball, radii)
        energy = np.zeros(x.shape)
        for image in images:
            root = np.sqrt(np.maximum(image, 0.0)).astype(np.float32)
            drawn = cv2.remap(root, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
            energy += (
                np.gradient(
                    cv2.GaussianBlur(drawn, (0, 0), sigmaX=1.0 / min(step, 1.0), sigmaY=1.0), axis=1
                )
                ** 2
            )
        ray, best = np.arange(_RIM_RAYS), np.clip(energy.argmax(axis=1), 1, len(radii) - 2)
        low, top, high = (energy[ray, best + k] for k in (-1, 0, 1))
        bent = np.minimum(low - 2.0 * top + high, -1e-12)
        edge = radii[best] + step * np.clip(0.5 * (low - high) / bent, -0.5, 0.5)
        points = np.column_stack(_on_rays(ball, edge[:, None]))
        seen = ((x > 0) & (x < columns - 1) & (y > 0) & (y < rows - 1)).all(axis=1)
        triples = (
            np.array(
                [(k, k + s, k + 2 * s) for s in (45, 60, 75, 90, 120) for k in range(_RIM_RAYS)]
            )
            % _RIM_RAYS
        )
        triples = triples[seen[triples].all(axis=1)]
        if not len(triples):
            return ball, 0.0
        terms = np.concatenate([2.0 * points[triples], np.ones((*triples.shape, 1))], axis=2)
        terms = np.linalg.pinv(terms) @ np.sum(points[triples] ** 2, axis=2)[..., None]
        a, b, c = terms[..., 0].T
        circles = np.stack([a, b, np.sqrt(np.maximum(c + a * a + b * b, 0.0))], axis=1)
        near = np.abs(circles - (ball.column, ball.row, ball.radius_px)).max(axis=1) <= reach
        if not near.any():
            return ball, 0.0
        off = (
            np.linalg.norm(points[seen] - circles[near, None, :2], axis=2) - circles[near, None, 2]
        )
        on = np.abs(off) < max(0.007 * ball.radius_px, 1.0)
        most = on[int(on.sum(axis=1).argmax())]
        ball, agreed = Ball(*_circle(points[seen][most])), float(most.mean())
    return ball, agreed


def _on_rays(ball: Ball, radii: Array) -> tuple[Array, Array]:
    """Columns and rows (rays, R) of places at radii (R,), or (rays, 1), from a ball's middle."""
    return ball.column + radii * np.cos(_ANGLES), ball.row + radii * np.sin(_ANGLES)


def smear_px(image: FloatArray, ball: Ball) -> float:
    """Length of the straight path along which an image of a ball on dark ground is smeared.

    Light that falls outside the rim of an edge of standard deviation s lies 0.627 s from it, on
    average. A path of length l adds the variance l^2 / 12 along it, which varies with the direction
    t as cos 2 t; an error of the middle varies as cos t.
    """
    away = np.linspace(0.0, 0.06 * ball.radius_px, 49)
    x, y = (axis.astype(np.float32) for axis in _on_rays(ball, ball.radius_px + away))
    light = cv2.remap(image, x, y, cv2.INTER_CUBIC)
    light = np.maximum(light - np.median(light[:, -8:], axis=1, keepdims=True), 0.0)
    distance = light @ away / np.maximum(light.sum(axis=1), 1e-9)
    turns = np.hstack([np.ones_like(_ANGLES), np.cos(2 * _ANGLES), np.sin(2 * _ANGLES)])
    _, a, b = np.linalg.lstsq(turns, (distance / 0.627) ** 2, rcond=None)[0]
    return float(np.sqrt(12.0 * 2.0 * np.hypot(a, b)))


def _ball_in(mask: BoolArray, small: str) -> tuple[Ball, Array]:
    """Circle through the longest outline of a mask, and distances (N,) of its pixels from the
    circle; `small` is the message that refuses short outlines."""
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=len)[:, 0].astype(np.float64)
    require(len(outline) >= 20, small)
    column, row, radius = _circle(outline)
    # the contour runs through the centres of the outermost pixels, half a pixel inside the outline
    return Ball(column, row, radius + 0.5), np.abs(
        np.hypot(outline[:, 0] - column, outline[:, 1] - row) - radius
    )


_FRONT = 0.5
"""Smallest z of the normal at a highlight of a light above the ground: the normal bisects the angle
to the camera, which may be 30 deg off the axis. Further out the outline may include ground."""


def glints_of(stack: Any, ball: Ball) -> Array:
    """(L, 2) column and row of the highlight on a chrome ball in linear images (L, H, W); NaN if
    there is none, as with a light behind the ball."""
    images = check_stack(stack, least=1, name="the photographs of the ball")
    facing = np.nan_to_num(ball.normals(images.shape[1:])[..., 2])
    require(facing.max() > _FRONT, "the ball lies outside the photographs.")
    rows, columns = np.nonzero(facing)
    top, left = rows.min(), columns.min()
    box = slice(top, rows.max() + 1), slice(left, columns.max() + 1)
    inside = facing[box] > _FRONT
    highlights = [_highlight(image[box], inside) for image in images]
    return np.asarray(np.array(highlights) + (left, top))  # noqa: RUF005


def chrome_directions(
    stack: Any, ball: Ball, eye: Array | None = None, away: Array | None = None
) -> Array:
    """Directions (L, 3), l = 2 (n . v) n - v, from the highlights on a chrome ball in `stack` (L,
    H, W), linear: there the normal n halves the angle between light and view v. NaN where an image
    has none.
    """
    column, row = glints_of(stack, ball).T
    normal, view = ball.seen(column, row, eye)
    ray: Array = 2.0 * np.sum(normal * view, axis=1, keepdims=True) * normal - view
    if away is None:
        return ray
    # the ray leaves the highlight, the direction the ball's middle
    along = np.sum(normal * ray, axis=1)
    ahead = np.sqrt(along**2 + away**2 - 1.0) - along
    return np.asarray((normal + ahead[:, None] * ray) / away[:, None])


def grey_directions(
    stack: Any,
    ball: Ball,
    clip_level: float = 0.98,
    *,
    eye: Array | None = None,
    away: Array | None = None,
) -> tuple[Array, Array]:
    """Directions (L, 3) and strengths (L,) of lights from the shading of a matt ball, I = l . n by
    least squares.

    `stack` (L, H, W): linear, ambient light removed. Taken as distant, a near light seems to stand
    further out (by 2.4 deg in the twin, a ball of 8 mm radius under LEDs 132 mm above its middle);
    with `away` each pixel has its own distance. Used are pixels that the light reaches, away from
    the ball's edge and below `clip_level`; the selection is repeated with every estimate. Raises
    BadInput if too little of the ball is lit in an image (numbered).
    """
    images = check_stack(stack, name="the photographs of the ball")
    normals = ball.normals(images.shape[1:], eye)
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
                f"image {number}: too little of the ball is lit and not clipped to determine the"
                " light's direction.",
            )
            # I d^3 = strength (n . l - 1 / d0), in distances d0 of the ball's middle
            far = np.ones(len(n)), 0.0
            if away is not None and light.any():
                unit = light / np.linalg.norm(light)
                far = (
                    np.linalg.norm(unit - n / away[number], axis=1) ** 3,
                    float(np.linalg.norm(light)) / away[number],
                )
            before, light = (
                light,
                np.linalg.lstsq(n[lit], (values * far[0] + far[1])[lit], rcond=None)[0],
            )
            expected = (n @ light - far[1]) / far[0]
            strength = float(np.linalg.norm(light))
            spread = deviation(values[lit] - expected[lit]) + 1e-9
            # in the light by a margin, no gloss and no cast shadow
            lit = good & (expected > 0.15 * strength) & (np.abs(values - expected) < 3.0 * spread)
            if float(np.linalg.norm(light - before)) < 1e-9 * strength:
                break
        lights.append(light)
    array = np.array(lights)
    strengths = np.linalg.norm(array, axis=1)
    return array / strengths[:, None], strengths


def _circle(points: Array) -> tuple[float, float, float]:
    """Centre and radius of a circle through points (N, 2), by least squares that repeatedly drop
    points far from it."""
    kept = np.ones(len(points), dtype=np.bool_)
    for _ in range(10):
        x, y = points[kept].T
        terms = np.stack([2 * x, 2 * y, np.ones_like(x)], axis=1)
        a, b, c = np.linalg.lstsq(terms, x * x + y * y, rcond=None)[0]
        radius = float(np.sqrt(max(c + a * a + b * b, 0.0)))
        off = np.abs(np.hypot(points[:, 0] - a, points[:, 1] - b) - radius)
        kept = off <= max(3.0 * float(np.median(off)), 1.0)
    return float(a), float(b), radius


_MIN_HIGHLIGHT = 0.03  # of the largest value


def _highlight(image: FloatArray, inside: BoolArray) -> tuple[float, float]:
    """Centroid of what stands out most from its surroundings on a ball's front: pale ground that a
    ball mirrors is as bright under a low lamp, but wider."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.2)
    usual = float(np.median(smooth[inside]))
    # a sixth of the radius, and 0.6 of the top: mirrored ground often touches the highlight
    values = np.subtract(smooth, cv2.GaussianBlur(smooth, (0, 0), len(inside) / 12.0))
    front = np.where(inside, values, 0.0)
    top = float(front.max())
    if top <= max(4.0 * usual, _MIN_HIGHLIGHT):
        return np.nan, np.nan
    above = values - 0.6 * top
    _, labels = cv2.connectedComponents((above >= 0).astype(np.uint8), connectivity=8)
    highlight = labels == labels[np.unravel_index(np.argmax(front), front.shape)]
    rows, columns = np.nonzero(highlight)
    weights = above[highlight] + 1e-9
    return float(np.average(columns, weights=weights)), float(np.average(rows, weights=weights))
