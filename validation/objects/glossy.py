"""Sound photographs of gloss and metal under equal lamps, with their truth.

Light is a cosine times the diffuse albedo and a GGX lobe (B. Walter et al., "Microfacet models for
refraction through rough surfaces", EGSR 2007; Fresnel after C. Schlick, 1994) with the attached and
cast shadows of render.py. Lamps are distant or near; the camera has shot and read noise, and stores
16 bits of linear light or sRGB through JPEG.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from render import (
    PITCH_MM,
    PX_PER_MM,
    Array,
    Rendered,
    _halved,
    _lit,
    _smooth,
    normals_of,
    truth_of,
)

from splitknit.imaging.pixels import srgb_code


@dataclass(frozen=True, slots=True)
class Finish:
    """What a surface is made of."""

    diffuse: float
    """Albedo of the matt part; 0.02 of metal, which reflects its surroundings a little."""
    specular: float
    """Reflectance straight on: 0.04 of lacquer, 0.6 to 0.9 of metal."""
    roughness: float
    """Alpha of GGX: 0.1 is polished, 0.5 satin."""


STEEL, BRASS, SATIN = Finish(0.02, 0.65, 0.25), Finish(0.03, 0.8, 0.35), Finish(0.02, 0.7, 0.5)
LACQUER, GLAZE, WAX = Finish(0.5, 0.05, 0.12), Finish(0.35, 0.08, 0.25), Finish(0.4, 0.15, 0.45)
TARNISHED = Finish(0.15, 0.3, 0.35)
MATT = Finish(0.6, 0.0, 0.5)

THINGS: dict[str, tuple[str, Finish, int, bool, bool]] = {
    # shape, finish, lights, near, JPEG
    "steel key": ("key", STEEL, 8, False, False),
    "brass key, JPEG": ("key", BRASS, 12, False, True),
    "steel coin": ("coin", STEEL, 12, False, False),
    "satin coin, JPEG": ("coin", SATIN, 8, False, True),
    "tarnished coin, near": ("coin", TARNISHED, 16, True, False),
    "brass egg": ("egg", BRASS, 12, False, False),
    "lacquered egg, JPEG": ("egg", LACQUER, 8, False, True),
    "glazed bowl": ("bowl", GLAZE, 12, False, False),
    "satin bowl": ("bowl", SATIN, 20, False, False),
    "steel ring": ("ring", STEEL, 16, False, False),
    "waxed letters": ("letters", WAX, 8, False, False),
    "brass letters, JPEG": ("letters", BRASS, 20, False, True),
    "satin letters, near": ("letters", SATIN, 12, True, False),
    "satin ring": ("ring", SATIN, 8, False, False),
}
"""Sound objects, on each of which nothing is to be said of brightness, blur, shift or encoding."""


def height_of(shape: str, side: int, rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
    """Height in mm and mask (2 side, 2 side), y up."""
    axis = (np.arange(2 * side) + 0.5) / (2 * PX_PER_MM)
    half = axis[-1] / 2
    x, y = np.meshgrid(axis - half, half - axis)
    reach = 0.86 * half
    radius = np.hypot(x, y)
    if shape == "egg":
        inside = (x / reach) ** 2 + (y / (0.7 * reach)) ** 2 < 0.96
        height = 0.6 * np.sqrt(
            np.maximum(reach**2 - x**2 - (y / 0.7) ** 2, 0.02 * reach**2)
        ) + 0.004 * _smooth(rng, x.shape, 5)
    elif shape == "bowl":
        inside = radius < reach
        height = 0.06 * radius**2 + 0.004 * _smooth(rng, x.shape, 4)
    elif shape == "ring":
        tube = 0.2 * reach
        inside = np.abs(radius - 0.75 * reach) < 0.95 * tube
        height = 0.8 * np.sqrt(np.maximum(tube**2 - (radius - 0.75 * reach) ** 2, 0.01))
    elif shape == "key":
        bow = np.hypot(x + 0.55 * reach, y) < 0.45 * reach
        hole = np.hypot(x + 0.75 * reach, y) < 0.1 * reach
        teeth = 0.05 * np.abs(((x * 2.2) % 1.0) - 0.5) * reach
        blade = (x > -0.2 * reach) & (x < reach) & (y < 0.15 * reach)
        blade &= y > -0.13 * reach + teeth
        inside = (bow | blade) & ~hole
        edge = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5) / (2 * PX_PER_MM)
        groove = -0.25 * np.exp(-(((y - 0.02 * reach) / 0.15) ** 2)) * (x > -0.3 * reach)
        height = 0.8 - 0.35 * np.exp(-edge / 0.25) + groove + 0.003 * _smooth(rng, x.shape, 2.5)
        height = np.where(inside, height, 0.0)
    else:
        inside = radius < reach if shape == "coin" else np.maximum(np.abs(x), np.abs(y)) < reach
        height = np.zeros(x.shape)
        picture = np.zeros(x.shape, np.uint8)
        for row, words in enumerate(("ROMA", "1889", "X+Z")):
            place = (int(0.45 * side), int(side * (0.75 + 0.45 * row)))
            cv2.putText(picture, words, place, cv2.FONT_HERSHEY_DUPLEX, side / 105, 255, side // 26)
        height += 0.18 * cv2.GaussianBlur(picture.astype(np.float64) / 255, (0, 0), 3.5)
        if shape == "coin":
            height += 0.25 / (1 + np.exp(-(radius - 0.93 * reach) / 0.06))
        height += 0.02 * _smooth(rng, x.shape, 20) + 0.002 * _smooth(rng, x.shape, 3)
    return height, inside


def lamps(count: int, rng: np.random.Generator, *, rings: bool) -> Array:
    """(L, 3) unit directions, on one ring or, as in a dome, two."""
    slant = np.deg2rad(rng.uniform(32, 48) + rng.uniform(-4, 4, count))
    if rings:
        slant[::2] -= np.deg2rad(18)
    azimuth = 2 * np.pi * (np.arange(count) + rng.uniform(-0.2, 0.2, count)) / count
    return np.column_stack(
        [np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.cos(slant)]
    )


def photographed(  # noqa: PLR0917
    shape: str,
    finish: Finish,
    count: int = 8,
    near: bool = False,
    jpeg: bool = False,
    seed: int = 0,
    *,
    side: int = 220,
    strengths: float = 0.0,
    table: float = 0.01,
) -> Rendered:
    """One object; `near`: lights are places in mm, 60 to 90 mm away; `jpeg`: images are sRGB of 8
    bits; `table`: albedo of the matt ground."""
    rng = np.random.default_rng(seed)
    height, inside = height_of(shape, side, rng)
    normals = normals_of(height)
    units = lamps(count, rng, rings=count > 10)
    lights = units * 75.0 if near else units
    half = side / (2 * PX_PER_MM)
    axis = (np.arange(2 * side) + 0.5) * PITCH_MM
    x, y = np.meshgrid(axis - half, half - axis)
    points = np.dstack([x, y, height])
    bright = np.exp(strengths * rng.standard_normal(count)) if strengths else np.ones(count)
    images = []
    for unit, light, strength in zip(units, lights, bright, strict=True):
        towards = np.broadcast_to(unit, points.shape)
        fall = 1.0
        if near:
            away = light - points
            distance = np.linalg.norm(away, axis=2, keepdims=True)
            towards, fall = away / distance, (75.0 / distance[..., 0]) ** 2
        image = fall * reflected(normals, towards, finish) * _lit(height, inside, unit)
        image = np.where(inside, image, table * unit[2])
        image = cv2.GaussianBlur(image, (0, 0), 1.2)
        images.append(strength * _halved(image))
    stack = np.stack(images)
    mask, *of_surface = truth_of(height, inside, normals)
    # exposed for the highlights, of which a few clip
    stack *= 0.9 / np.quantile(stack[:, mask], 0.995)
    stack += 0.003 * rng.standard_normal(stack.shape) * np.sqrt(np.maximum(stack, 0.02))
    stack = np.clip(stack, 0, 1)
    stored = np.stack([_jpeg(image) for image in stack]) if jpeg else np.rint(65535 * stack)
    kept = stored.astype(np.uint8 if jpeg else np.uint16)
    return Rendered(kept, lights, bright, mask, *of_surface)


def reflected(
    normals: Array, towards: Array, finish: Finish, to_camera: Any = (0.0, 0.0, 1.0)
) -> Array:
    """Light (...) to a camera, of a lamp in the direction `towards` (..., 3)."""
    middle = towards + to_camera
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    cosine = np.maximum((normals * towards).sum(axis=-1), 0.0)
    view = np.maximum((normals * to_camera).sum(axis=-1), 1e-3)
    across = np.maximum((normals * middle).sum(axis=-1), 0.0)
    squared = finish.roughness**2
    lobe = squared / (np.pi * (across**2 * (squared - 1) + 1) ** 2)
    masking = 1.0
    for each in (np.maximum(cosine, 1e-3), view):
        masking = masking * 2 * each / (each + np.sqrt(squared + (1 - squared) * each**2))
    fresnel = finish.specular + (1 - finish.specular) * (1 - (middle * to_camera).sum(axis=-1)) ** 5
    specular = lobe * masking * fresnel / (4 * view) * (cosine > 0)
    if not finish.specular:
        specular = 0.0 * specular
    return finish.diffuse * cosine / np.pi + specular


def _jpeg(image: Array) -> NDArray[np.uint8]:
    """An image of linear light as a camera's JPEG stores it."""
    _, data = cv2.imencode(
        ".jpg", np.rint(255 * srgb_code(image)).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 93]
    )
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))
