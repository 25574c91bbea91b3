"""The twin's relief term against random walks under a ridged surface.

Run ``python validation/twin/ridges.py``: two to three minutes. Walks start at the camera, wander
below parallel ridges and end at a distant light 20.6 deg off the axis, across the ridges or along
them. Printed, for each ridge profile and channel: the gain k that makes the twin's convolution
follow the walks best, the twin's k, and the contrast of both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from volume import into

from splitknit_simulator.light.skin import (
    REFRACTIVE_INDEX,
    Channel,
    ChannelOptics,
    SkinOptics,
    diffusion_profile,
    fresnel,
)

Array = NDArray[np.float64]
PERIOD_MM = 0.43
SAMPLES = 4096
PLACES = 32
WALKS = 30_000
TILT_RAD = np.arcsin(52.5 / 149.5)
LIGHTS = np.array(
    [[np.sin(TILT_RAD), 0.0, np.cos(TILT_RAD)], [0.0, np.sin(TILT_RAD), np.cos(TILT_RAD)]]
)
STEP_FRACTIONS = (np.arange(32) + 1) / 32.0
"""Where along a step the walk looks whether it has left the skin."""


def ridges(kind: str, depth_um: float) -> tuple[Array, Array]:
    """Height in mm (0 at the tops) and slope over one period: a cosine, or flat ridges with narrow
    valleys."""
    wave = np.cos(2.0 * np.pi * np.arange(SAMPLES) / SAMPLES)
    if kind == "flat":
        wave = np.tanh(2.2 * (wave + 0.35))
    height = depth_um * 1e-3 * ((wave - wave.min()) / np.ptp(wave) - 1.0)
    around = np.concatenate([height[-1:], height, height[:1]])
    return height, (around[2:] - around[:-2]) * SAMPLES / (2.0 * PERIOD_MM)


def _at(table: Array, x: Array) -> Array:
    place = (x / PERIOD_MM) % 1.0 * SAMPLES
    low = place.astype(np.intp)
    fraction = place - low
    return table[low % SAMPLES] * (1.0 - fraction) + table[(low + 1) % SAMPLES] * fraction


def _normals(slope: Array) -> Array:
    length = np.sqrt(1.0 + slope * slope)
    return np.stack([-slope / length, 0.0 * slope, 1.0 / length])


def _entering(normals: Array) -> Array:
    cosine = np.maximum(LIGHTS @ normals, 0.0)
    return cosine * (1.0 - fresnel(cosine))


def _first_exit(
    points: Array, directions: Array, step: Array, height: Array
) -> tuple[NDArray[np.intp], Array]:
    """Which walks leave the skin on this step, and after which length."""
    close = np.flatnonzero(
        (points[2] > height.min()) | (points[2] + step * directions[2] > height.min())
    )
    p, d = points[:, close], directions[:, close]
    rise = np.maximum(d[2], 1e-9)
    reach = np.where(d[2] > 1e-9, np.minimum(step[close], (1e-6 - p[2]) / rise), step[close])
    along = reach[:, None] * STEP_FRACTIONS
    gap = p[2][:, None] + along * d[2][:, None] - _at(height, p[0][:, None] + along * d[0][:, None])
    left = np.flatnonzero((gap > 1e-7).any(axis=1))
    k = (gap[left] > 1e-7).argmax(axis=1)
    start = np.minimum(p[2, left] - _at(height, p[0, left]), -1e-9)
    before = np.where(k > 0, gap[left, np.maximum(k - 1, 0)], start)
    fraction = (k + before / (before - gap[left, k])) / STEP_FRACTIONS.size
    return close[left], np.maximum(reach[left] * fraction, 0.0)


def walked(
    x_mm: float, optics: ChannelOptics, relief: tuple[Array, Array], rng: np.random.Generator
) -> Array:
    """Light towards the camera at `x_mm`, a value a light."""
    height, slope = relief
    x = np.full(WALKS, x_mm)
    normals = _normals(_at(slope, x))
    out = 1.0 - float(fresnel(normals[2, 0]))
    points = np.stack([x, 0.0 * x, _at(height, x)])
    directions = into(normals, rng)
    lengths = np.zeros(WALKS)
    total = np.zeros(len(LIGHTS))
    while lengths.size:
        step = rng.standard_exponential(lengths.size) / optics.scattering_per_mm
        gone, reach = _first_exit(points, directions, step, height)
        step[gone] = reach
        points = points + step * directions
        lengths = lengths + step
        z = 2.0 * rng.random(lengths.size) - 1.0
        turn = 2.0 * np.pi * rng.random(lengths.size)
        side = np.sqrt(1.0 - z * z)
        scattered = np.stack([side * np.cos(turn), side * np.sin(turn), z])
        keep = optics.absorption_per_mm * lengths < 8.0
        points[2, gone] = _at(height, points[0, gone])
        normals = _normals(_at(slope, points[0, gone]))
        cosine = np.clip(np.sum(directions[:, gone] * normals, axis=0), 0.0, 1.0)
        leaves = rng.random(gone.size) >= fresnel(cosine, 1.0 / REFRACTIVE_INDEX)
        weight = np.exp(-optics.absorption_per_mm * lengths[gone[leaves]])
        total += np.sum(weight * _entering(normals[:, leaves]), axis=1)
        back = gone[~leaves]
        scattered[:, back] = into(normals[:, ~leaves], rng)
        points[2, back] -= 1e-7
        keep[gone[leaves]] = False
        points, directions, lengths = points[:, keep], scattered[:, keep], lengths[keep]
    return total / WALKS * out


def convolved(optics: ChannelOptics, relief: tuple[Array, Array]) -> Array:
    """The twin's light without its relief term, at the places (PLACES, lights)."""
    normals = _normals(relief[1])
    profile = diffusion_profile(optics.scattering_per_mm, optics.absorption_per_mm)
    transfer = profile.transfer(np.fft.rfftfreq(SAMPLES, PERIOD_MM / SAMPLES))
    light = np.fft.irfft(np.fft.rfft(_entering(normals)) * transfer, SAMPLES) * (
        1.0 - fresnel(normals[2])
    )
    return light[:, :: SAMPLES // PLACES].T


def main() -> None:
    """Print the comparison."""
    rng = np.random.default_rng(0)
    places = np.arange(PLACES) * PERIOD_MM / PLACES
    channels: tuple[Channel, ...] = ("blue", "green", "red")
    for kind, depth_um in (("cosine", 75.0), ("cosine", 40.0), ("flat", 75.0)):
        relief = ridges(kind, depth_um)
        h = (relief[0] - relief[0].mean())[:: SAMPLES // PLACES, None] * 1e3
        for channel in channels:
            optics = SkinOptics().channel(channel)
            volume = np.stack([walked(float(x), optics, relief, rng) for x in places])
            plain = convolved(optics, relief)
            ratio = volume / plain
            fitted = 100.0 * np.sum((ratio / ratio.mean(axis=0) - 1.0) * h, axis=0) / np.sum(h * h)
            twin = plain * (1.0 + optics.relief_gain_per_um * h)
            contrast = [
                (light / light.mean(axis=0)).std(axis=0).round(4) for light in (volume, twin)
            ]
            used = round(100.0 * optics.relief_gain_per_um, 3)
            print(
                kind,
                depth_um,
                channel,
                "k fitted",
                fitted.round(3),
                "used",
                used,
                "%/um, contrast walks",
                end=" ",
            )
            print(contrast[0], "twin", contrast[1], "(light across, along)")


if __name__ == "__main__":
    main()
