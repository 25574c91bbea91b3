"""Rendered photographs under a dome of near lamps: a thing, one or two polished balls, and ground.

The thing and its GGX lobe are those of glossy.py; the balls are spheres by ray casting, which
mirror the lamp and the ground. Lamps shine as a power of the cosine off their axes, which are aimed
some mm beside the picture's middle; the camera is a pinhole off the picture's middle, with a lens's
blur, shot and read noise, and JPEG.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from glossy import BRASS, LACQUER, MATT, STEEL, TARNISHED, WAX, Finish, height_of, reflected
from numpy.typing import NDArray
from render import PITCH_MM, Array, _lit, _smooth, normals_of

from splitknit.imaging.pixels import srgb_code

PX_PER_MM = 10.0
ROWS, COLUMNS = 860, 1300
THING_PX = 280
MAGNIFIED = 1 / (PX_PER_MM * PITCH_MM)
"""A thing of glossy.py is as much larger here."""
THINGS = (
    ("coin", BRASS),
    ("letters", WAX),
    ("egg", LACQUER),
    ("key", STEEL),
    ("coin", TARNISHED),
    ("letters", MATT),
)
BARE, LENS = 1.0, 5.0
"""Exponent of a lamp's beam: a bare LED, and one with a lens, 120 and 59 deg wide."""
PAPER_MM = 210.0, 148.0
GROUND, POLISHED = MATT, Finish(0.0, 0.6, 0.015)
_SAMPLES = 3  # of a ball, a pixel and axis


@dataclass(frozen=True, slots=True, eq=False)
class Dome:
    """What is under a dome, and its lamps."""

    lamps_mm: Array
    """(L, 3) from the picture's middle on the ground, x right, y up, z to the camera."""
    aims_mm: Array
    """(L, 3) points at which they are aimed."""
    strengths: Array
    eye_mm: Array
    balls_mm: Array
    """(B, 4) middles and radii."""
    shape: str
    finish: Finish
    seed: int

    def outlines(self) -> list[str]:
        """Of the balls as somebody draws them: column, row and radius in pixels."""
        rng = np.random.default_rng(self.seed)
        outlines = []
        for *middle, radius in self.balls_mm:
            nearer = self.eye_mm[2] / (self.eye_mm[2] - middle[2])
            x, y = self.eye_mm[:2] + (middle[:2] - self.eye_mm[:2]) * nearer
            drawn = np.array(
                [
                    (COLUMNS - 1) / 2 + x * PX_PER_MM,
                    (ROWS - 1) / 2 - y * PX_PER_MM,
                    radius * nearer * PX_PER_MM,
                ]
            ) + rng.normal(0.0, 1.0, 3)
            outlines.append(",".join(f"{each:.1f}" for each in drawn))
        return outlines


def dome(seed: int, lamps: int = 27, aim_mm: float = 5.0) -> Dome:
    """One of many: size, lamps off a sphere and aimed so far beside the picture's middle (sd),
    camera, balls."""
    rng = np.random.default_rng(seed)
    ring = np.arange(lamps) % 3
    elevation = np.deg2rad(rng.uniform((8, 32, 58), (20, 46, 72))[ring] + rng.uniform(-3, 3, lamps))
    azimuth = 2 * np.pi * (np.arange(lamps) + rng.uniform(-0.3, 0.3, lamps)) / lamps
    radius = rng.uniform(65, 95)
    places = (radius * (1 + 0.02 * rng.standard_normal(lamps)))[:, None] * np.column_stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    places += 0.03 * radius * rng.standard_normal(3) * (1, 1, 0.5)
    places[:, 2] = np.maximum(places[:, 2], 5.0)
    height = COLUMNS / PX_PER_MM * rng.uniform(0.6, 1.0)
    eye = np.array([*(0.03 * height * rng.standard_normal(2)), height])
    size = rng.uniform(3.7, 4.5)
    balls = [(side * rng.uniform(42, 52), rng.uniform(-15, 15), size, size) for side in (-1.0, 1.0)]
    strengths = np.exp(0.05 * rng.standard_normal(lamps))
    aims = aim_mm * rng.standard_normal(places.shape) * (1, 1, 0)
    return Dome(places, aims, strengths, eye, np.array(balls), *THINGS[seed % len(THINGS)], seed)


def photographs(scene: Dome, exponent: float, folder: Path) -> NDArray[np.bool_]:
    """Write ``00.jpg`` and so on into a folder; the thing's mask."""
    rng = np.random.default_rng(scene.seed)
    y, x = np.mgrid[:ROWS, :COLUMNS] / PX_PER_MM
    points = np.dstack(
        [x - (COLUMNS - 1) / 2 / PX_PER_MM, (ROWS - 1) / 2 / PX_PER_MM - y, np.zeros_like(x)]
    )
    pattern = np.exp(0.05 * _smooth(rng, x.shape, 2.0) + 0.1 * _smooth(rng, x.shape, 60.0))
    normals = np.dstack([np.zeros_like(x), np.zeros_like(x), np.ones_like(x)])
    height, inside = np.zeros_like(x), np.zeros(x.shape, bool)
    top, left = (ROWS - THING_PX) // 2, (COLUMNS - THING_PX) // 2
    box = slice(top, top + THING_PX), slice(left, left + THING_PX)
    height[box], inside[box] = height_of(scene.shape, THING_PX // 2, rng)
    height[~inside] = 0.0
    normals[inside] = normals_of(height)[inside]
    points[..., 2] = MAGNIFIED * height
    windows = [_window(scene, ball) for ball in scene.balls_mm]
    images = []
    lamps = zip(scene.lamps_mm, scene.aims_mm, scene.strengths, strict=True)
    for lamp, aim, strength in lamps:
        towards, light = _beam(points, lamp, aim, exponent)
        shadow = _shadow(points, lamp, scene.balls_mm) * _lit(
            height, inside, lamp / np.linalg.norm(lamp)
        )
        view = scene.eye_mm - points
        view /= np.linalg.norm(view, axis=2, keepdims=True)
        image = pattern * reflected(normals, towards, GROUND)
        image[inside] = reflected(normals[inside], towards[inside], scene.finish, view[inside])
        image *= light * shadow
        for place, covered, at, normal, to_eye in windows:
            seen = _mirrored(scene, (lamp, aim, exponent), at, normal, to_eye)
            image[place] += _of_pixels(covered * seen) - _of_pixels(covered) * image[place]
        images.append(strength * cv2.GaussianBlur(image, (0, 0), 0.8))
    stack = np.array(images)
    stack *= 0.85 / np.quantile(stack, 0.99)
    stack += 0.003 * rng.standard_normal(stack.shape) * np.sqrt(np.maximum(stack, 0.02))
    for k, image in enumerate(np.clip(stack, 0, 1)):
        code = np.rint(255 * srgb_code(image)).astype(np.uint8)
        cv2.imwrite(str(folder / f"{k:02d}.jpg"), code, [cv2.IMWRITE_JPEG_QUALITY, 93])
    return inside


def _beam(points: Array, lamp: Array, aim: Array, exponent: float) -> tuple[Array, Array]:
    """Unit vectors to an aimed lamp, and its irradiance on what faces it."""
    towards = lamp - points
    distance = np.linalg.norm(towards, axis=-1)
    towards /= distance[..., None]
    along = np.maximum(towards @ (lamp - aim) / np.linalg.norm(lamp - aim), 0.0)
    return towards, along**exponent * (75.0 / distance) ** 2


def _shadow(points: Array, lamp: Array, balls: Array) -> Array:
    """Zero where a ball stands before the lamp."""
    ray = lamp - points
    length = np.linalg.norm(ray, axis=-1)
    lit = np.ones(length.shape)
    for *middle, radius in balls:
        off = middle - points
        along = (off * ray).sum(axis=-1) / length
        apart = np.sqrt(np.maximum((off**2).sum(axis=-1) - along**2, 0.0))
        lit *= np.where(along > 1e-3, np.clip((apart - radius) / 0.15 + 0.5, 0.0, 1.0), 1.0)
    return lit


def _window(scene: Dome, ball: Array):
    """Pixels about a ball's image; of samples within them whether they show the ball, the points
    and normals that they show, and unit vectors to the camera."""
    *middle, radius = ball
    nearer = scene.eye_mm[2] / (scene.eye_mm[2] - middle[2])
    x, y = scene.eye_mm[:2] + (middle[:2] - scene.eye_mm[:2]) * nearer
    reach = int(1.3 * radius * nearer * PX_PER_MM)
    row, column = (
        round((ROWS - 1) / 2 - y * PX_PER_MM),
        round((COLUMNS - 1) / 2 + x * PX_PER_MM),
    )
    fine = (np.arange(_SAMPLES * (2 * reach + 1)) + 0.5) / _SAMPLES - 0.5 - reach
    x, y = np.meshgrid(
        (fine + column - (COLUMNS - 1) / 2) / PX_PER_MM,
        ((ROWS - 1) / 2 - row - fine) / PX_PER_MM,
    )
    ray = np.dstack([x, y, np.zeros_like(x)]) - scene.eye_mm
    ray /= np.linalg.norm(ray, axis=2, keepdims=True)
    off = middle - scene.eye_mm
    along = ray @ off
    inner = radius**2 - off @ off + along**2
    at = scene.eye_mm + (along - np.sqrt(np.maximum(inner, 0.0)))[..., None] * ray
    normal = at - middle
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    place = slice(row - reach, row + reach + 1), slice(column - reach, column + reach + 1)
    return place, (inner > 0).astype(np.float64), at, normal, -ray


def _mirrored(
    scene: Dome, lamp: tuple[Array, Array, float], at: Array, normal: Array, view: Array
) -> Array:
    """Light of a ball: the highlight of a lamp (place, aim, beam), and the ground it mirrors."""
    towards, light = _beam(at, *lamp)
    glint = light * reflected(normal, towards, POLISHED, view)
    ray = 2 * (normal * view).sum(axis=2, keepdims=True) * normal - view
    down = np.minimum(ray[..., 2:], -1e-3)
    ground = at - at[..., 2:] / down * ray
    ground[..., 2] = 0.0
    on_paper = (ray[..., 2] < -1e-3) & (np.abs(ground[..., :2]) * 2 < PAPER_MM).all(axis=2)
    to_lamp, of_ground = _beam(ground, *lamp)
    paper = GROUND.diffuse / np.pi * to_lamp[..., 2] * of_ground
    paper *= _shadow(ground, lamp[0], scene.balls_mm)
    return glint + POLISHED.specular * np.where(on_paper, paper, 0.0)


def _of_pixels(samples: Array) -> Array:
    side = samples.shape[0] // _SAMPLES
    return cv2.resize(samples, (side, side), interpolation=cv2.INTER_AREA)
