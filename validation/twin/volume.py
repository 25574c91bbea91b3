"""The twin's image-space skin against random walks in the volume of an elliptic cylinder, the shape
of a finger.

Run ``python validation/twin/volume.py``: about a minute. It prints, for each channel and light, the
twin's radiance over that of the walks along the cross-section, relative to the middle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.model import Camera, Led
from splitknit_simulator.light.renderer import RenderSettings, render_band
from splitknit_simulator.light.skin import (
    CHANNELS,
    REFRACTIVE_INDEX,
    Medium,
    SkinOptics,
    diffuse_transmittance,
    fresnel,
)
from splitknit_simulator.surface import SimulatedSurface

Array = NDArray[np.float64]
HALF_WIDTH_MM = 8.0
HALF_HEIGHT_MM = 5.5
LIGHTS = ((52.5, 0.0, 140.0), (0.0, 52.5, 140.0))
WALKS = 20_000


def _normals(points: Array) -> Array:
    n = np.stack([points[0] / HALF_WIDTH_MM**2, 0.0 * points[0], points[2] / HALF_HEIGHT_MM**2])
    return n / np.linalg.norm(n, axis=0)


def into(normals: Array, rng: np.random.Generator) -> Array:
    """Directions into the skin, drawn by the cosine to its normals."""
    fraction = rng.random(normals.shape[1])
    turn = 2.0 * np.pi * rng.random(normals.shape[1])
    across = np.stack([normals[2], 0.0 * normals[0], -normals[0]])
    along = np.array([[0.0], [1.0], [0.0]])
    side = np.sqrt(fraction)
    return -np.sqrt(1.0 - fraction) * normals + side * (
        np.cos(turn) * across + np.sin(turn) * along
    )


def _received(points: Array, normals: Array, light: tuple[float, float, float]) -> Array:
    to = np.array(light)[:, None] - points
    squared = np.sum(to * to, axis=0)
    cosine = np.maximum(np.sum(to * normals, axis=0) / np.sqrt(squared), 0.0)
    return 1e4 * cosine / squared * (1.0 - fresnel(cosine))


def volume_radiance(
    x_mm: float, scattering: float, absorption: float, rng: np.random.Generator
) -> Array:
    """Radiance towards the camera at `x_mm`, a value a light: walks start at the camera and end at
    the lights."""
    start = np.array([[x_mm], [0.0], [HALF_HEIGHT_MM * np.sqrt(1.0 - (x_mm / HALF_WIDTH_MM) ** 2)]])
    points = np.repeat(start, WALKS, axis=1)
    directions = into(_normals(points), rng)
    lengths = np.zeros(WALKS)
    axes = np.array([[1.0 / HALF_WIDTH_MM], [0.0], [1.0 / HALF_HEIGHT_MM]])
    total = np.zeros(len(LIGHTS))
    while lengths.size:
        step = rng.standard_exponential(lengths.size) / scattering
        p, d = points * axes, directions * axes
        a = np.sum(d * d, axis=0)
        b = np.sum(p * d, axis=0)
        c = np.minimum(np.sum(p * p, axis=0) - 1.0, 0.0)
        wall = (-b + np.sqrt(b * b - a * c)) / np.maximum(a, 1e-12)
        out = np.flatnonzero(step > wall)
        step[out] = wall[out]
        points = points + step * directions
        lengths = lengths + step
        z = 2.0 * rng.random(lengths.size) - 1.0
        turn = 2.0 * np.pi * rng.random(lengths.size)
        side = np.sqrt(1.0 - z * z)
        keep = absorption * lengths < 9.0
        normals = _normals(points[:, out])
        cosine = np.clip(np.sum(directions[:, out] * normals, axis=0), 0.0, 1.0)
        leaves = rng.random(out.size) >= fresnel(cosine, 1.0 / REFRACTIVE_INDEX)
        weight = np.exp(-absorption * lengths[out[leaves]])
        for k, light in enumerate(LIGHTS):
            total[k] += np.sum(
                weight * _received(points[:, out[leaves]], normals[:, leaves], light)
            )
        directions = np.stack([side * np.cos(turn), side * np.sin(turn), z])
        directions[:, out[~leaves]] = into(normals[:, ~leaves], rng)
        keep[out[leaves]] = False
        points, directions, lengths = points[:, keep], directions[:, keep], lengths[keep]
    out_share = 1.0 - float(fresnel(_normals(start)[2, 0]))
    return total / WALKS * out_share / (np.pi * diffuse_transmittance())


def cylinder(px_per_mm: float = 10.0) -> SimulatedSurface:
    """The cylinder as the twin sees it."""
    camera = Camera(px_per_mm=px_per_mm, image_size=(200, 221))
    x = (np.arange(221) - 110.0) / px_per_mm
    inside = np.abs(x) < HALF_WIDTH_MM
    z = HALF_HEIGHT_MM * np.sqrt(np.clip(1.0 - (x / HALF_WIDTH_MM) ** 2, 1e-9, 1.0))
    shape = camera.image_size
    mask = np.broadcast_to(inside, shape).copy()
    height = np.where(mask, z, np.nan).astype(np.float32)
    row = np.where(inside[:, None], _normals(np.stack([x, 0.0 * x, z])).T, 0.0)
    normals = np.broadcast_to(row, (*shape, 3)).astype(np.float32)
    zero = np.zeros(shape, dtype=np.float32)
    full_weight = np.ones(shape, dtype=np.float32)
    return SimulatedSurface(camera, height, height, normals, normals, zero, mask, full_weight)


def main() -> None:
    """Print the comparison."""
    rng = np.random.default_rng(0)
    places = np.linspace(-7.4, 7.4, 13)
    surface = cylinder()
    leds = [Led("white", position_mm=light) for light in LIGHTS]
    print("twin / volume, relative to the middle, at x =", places.round(1))
    for channel in CHANNELS:
        optics = SkinOptics().channel(channel)
        settings = RenderSettings(reach_mm=20.0)
        image = render_band(surface, leds, Medium([optics], 0.25, 0.0), settings)
        x = (np.arange(*image.window[1].indices(221)[:2]) - 110.0) / 10.0
        volume = np.stack(
            [
                volume_radiance(float(v), optics.scattering_per_mm, optics.absorption_per_mm, rng)
                for v in places
            ]
        )
        for k in range(len(LIGHTS)):
            twin = np.interp(places, x, image.diffuse[k, 0, 100])
            ratio = twin / volume[:, k]
            print(f"{channel:6s} light {k}: scale {ratio[6]:.3f}", (ratio / ratio[6]).round(3))


if __name__ == "__main__":
    main()
