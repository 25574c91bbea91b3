"""What the camera sees beside the finger: black cloth, dust, the hand's shadow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Camera, FloatArray


@dataclass(frozen=True, slots=True)
class BackgroundSettings:
    """The scene around the finger."""

    albedo: float = 0.006
    """Diffuse reflectance of the black background."""
    depth_mm: float = 10.0
    """Distance of the background below the finger plane."""
    gradient: float = 0.0
    """Relative change of the background's albedo from one edge of the frame to the other."""
    dust_per_cm2: float = 0.0
    """Bright specks on the background."""
    dust_albedo: float = 0.3
    """Largest albedo of a speck; they lie between a tenth of it and all of it."""
    hand_shadow: float = 0.0
    """Share of the light that the hand takes away at the finger's base, 0 to 1."""
    hand_shadow_share: float = 0.25
    """Share of the frame, from its last row, that the hand's shadow covers."""
    ambient: float = 0.002
    """Room light: radiance of a white card relative to the same card under one LED."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("albedo", 0.0, 1.0),
            ("depth_mm", 0.0, 200.0),
            ("gradient", -1.0, 1.0),
            ("dust_per_cm2", 0.0, 1000.0),
            ("dust_albedo", 0.0, 1.0),
            ("hand_shadow", 0.0, 1.0),
            ("hand_shadow_share", 0.01, 1.0),
            ("ambient", 0.0, 1.0),
        ):
            value = getattr(self, name)
            require(
                bool(np.isfinite(value)) and low <= value <= high,
                f"background.{name} must lie between {low} and {high}, but it is {value}.",
            )


def background_albedo(camera: Camera, settings: BackgroundSettings, rng: np.random.Generator) -> FloatArray:
    """(H, W) albedo of the background: even, with a gradient and specks of dust where the settings ask for them."""
    height, width = camera.image_size
    albedo = np.full((height, width), settings.albedo, dtype=np.float32)
    if settings.gradient:
        angle = 2.0 * np.pi * rng.random()
        across = np.linspace(-0.5, 0.5, width)[None, :] * np.cos(angle)
        along = np.linspace(-0.5, 0.5, height)[:, None] * np.sin(angle)
        albedo *= np.maximum(1.0 + settings.gradient * (across + along), 0.0).astype(np.float32)
    area_cm2 = height * width / (10.0 * camera.px_per_mm) ** 2
    for _ in range(int(rng.poisson(settings.dust_per_cm2 * area_cm2))):
        _speck(albedo, camera.px_per_mm, settings.dust_albedo, rng)
    return albedo


def hand_shadow(camera: Camera, settings: BackgroundSettings) -> FloatArray:
    """(H, 1) share of the light that reaches each row: the hand's shadow has a soft edge."""
    height = camera.image_size[0]
    below = (np.arange(height) / (height - 1) - (1.0 - settings.hand_shadow_share)) / (0.3 * settings.hand_shadow_share)
    share = np.clip(below, 0.0, 1.0)
    smooth = share * share * (3.0 - 2.0 * share)
    return (1.0 - settings.hand_shadow * smooth).astype(np.float32)[:, None]


def _speck(albedo: NDArray[np.float32], px_per_mm: float, brightest: float, rng: np.random.Generator) -> None:
    height, width = albedo.shape
    row, column = rng.random() * height, rng.random() * width
    long_px = px_per_mm * 0.02 * (0.4 / 0.02) ** rng.random()
    short_px = long_px * (0.2 + 0.8 * rng.random())
    angle = np.pi * rng.random()
    value = brightest * (0.1 + 0.9 * rng.random())
    reach = int(np.ceil(2.5 * long_px)) + 1
    top, left = max(int(row) - reach, 0), max(int(column) - reach, 0)
    bottom, right = min(int(row) + reach + 1, height), min(int(column) + reach + 1, width)
    dy = np.arange(top, bottom)[:, None] - row
    dx = np.arange(left, right)[None, :] - column
    u = (dx * np.cos(angle) + dy * np.sin(angle)) / long_px
    v = (dy * np.cos(angle) - dx * np.sin(angle)) / short_px
    patch = albedo[top:bottom, left:right]
    np.maximum(patch, value * np.exp(-0.5 * (u * u + v * v) ** 2), out=patch, casting="same_kind")
