"""Simple drawn fingers: a capsule of skin under seven LEDs on black paper, with truth. Not the
twin, on purpose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest

TONES = {
    "very dark": (0.06, 0.035, 0.025),
    "dark": (0.15, 0.09, 0.06),
    "medium": (0.40, 0.27, 0.20),
    "very light": (0.70, 0.55, 0.45),
}


GREY = np.array([0.299, 0.587, 0.114], dtype=np.float32)


@dataclass(frozen=True)
class Scene:
    rgb: np.ndarray
    """(H, W, 3) mean of the shots."""
    mask: np.ndarray
    px_per_mm: float
    tip: tuple[float, float]
    lights: np.ndarray
    shot: Callable[[int], np.ndarray]
    """(H, W, 3) of the light k."""

    @property
    def grey(self) -> np.ndarray:
        return self.rgb @ GREY

    @cached_property
    def stack(self) -> np.ndarray:
        """(L, H, W) grey, which few tests look at."""
        return np.stack([self.shot(k) @ GREY for k in range(len(self.lights))])


def draw(
    tone: str | tuple[float, float, float] = "medium",
    *,
    px_per_mm: float = 12.0,
    size_mm: tuple[float, float] = (42.0, 29.0),
    yaw_deg: float = 0.0,
    half_width: float = 8.0,
    tip_at: tuple[float, float] = (0.0, 15.0),
    taper: float = 0.0,
    creases: tuple[tuple[float, float], ...] = ((25.0, 0.15),),
    crease_tilt_deg: float = 0.0,
    paper: float = 0.03,
    paper_slope: float = 0.0,
    noise: float = 0.002,
    specks: int = 0,
    shadow: str = "",
    glare: bool = False,
    infrared: float = 0.0,
    ridges: float = 0.03,
    seed: int = 0,
) -> Scene:
    """Draw a finger whose tip lies at `tip_at` (x, y in mm from the centre) and points `yaw_deg`
    counter-clockwise."""
    rng = np.random.default_rng(seed)
    height, width = round(size_mm[0] * px_per_mm), round(size_mm[1] * px_per_mm)
    x = (np.arange(width) - (width - 1) / 2)[None, :] / px_per_mm
    y = ((height - 1) / 2 - np.arange(height))[:, None] / px_per_mm
    yaw = np.deg2rad(yaw_deg)
    along = -(-(x - tip_at[0]) * np.sin(yaw) + (y - tip_at[1]) * np.cos(yaw))  # mm below the tip
    across = (x - tip_at[0]) * np.cos(yaw) + (y - tip_at[1]) * np.sin(yaw)
    length = 1.25 * half_width
    fade = np.clip((length - along) / length, 0.0, 1.0)
    half = (
        half_width
        * (1.0 + taper * (along - length) / 20.0)
        * np.sqrt(np.maximum(1.0 - fade**2, 0.0))
    )
    inside = (along > 0) & (np.abs(across) < half)
    section = np.clip(1.0 - (across / np.maximum(half, 1e-6)) ** 2, 0.0, 1.0)
    z = 0.7 * half * np.sqrt(section)
    dz_dy, dz_dx = np.gradient(np.where(inside, z, 0.0), 1.0 / px_per_mm)
    dz_dy = -dz_dy
    norm = np.sqrt(1.0 + dz_dx**2 + dz_dy**2)
    angles = 2 * np.pi * np.arange(7) / 7
    lights = np.stack([0.35 * np.cos(angles), 0.35 * np.sin(angles), np.full(7, 0.937)], axis=1)
    shade = (
        -dz_dx * lights[:, 0, None, None]
        - dz_dy * lights[:, 1, None, None]
        + lights[:, 2, None, None]
    ) / norm
    shade = (0.9 * np.maximum(shade, 0.0) + 0.1).astype(np.float32)
    albedo = np.ones_like(z)
    for distance, depth in creases:
        offset = along - distance - across * np.tan(np.deg2rad(crease_tilt_deg))
        albedo = albedo * (1.0 - depth * np.exp(-0.5 * (offset / 0.45) ** 2))
    albedo = albedo * (1.0 + ridges * np.sin(2 * np.pi * np.hypot(along - 11.0, across) / 0.5))
    light = np.ones_like(z)
    if shadow == "step":
        light = np.where(along > 14.0, 0.35, 1.0)
    elif shadow == "gradient":
        light = np.clip(1.2 - along / 30.0, 0.15, 1.0)
    elif shadow == "side":
        light = np.where(across > 2.0, 0.3, 1.0)
    skin = np.asarray(TONES[tone] if isinstance(tone, str) else tone, dtype=np.float32)
    backdrop = np.broadcast_to(np.maximum(paper * (1.0 + paper_slope * x / 15.0), 0.0), z.shape)
    brightness, spots = (light * albedo).astype(np.float32), []
    for _ in range(specks):
        spot = rng.uniform(-0.5, 0.5, 2) * np.array([size_mm[1], size_mm[0]])
        radius = rng.uniform(0.05, 0.4)
        speck = ((x - spot[0]) ** 2 + (y - spot[1]) ** 2 < radius**2) & ~inside
        spots.append((speck, rng.uniform(0.1, 0.6)))
    if glare:
        spots.append((((across - 1.0) ** 2 + (along - 9.0) ** 2 < 1.2**2) & inside, 1.0))

    def photographed(shade: np.ndarray, noise: float, seed: int) -> np.ndarray:
        rgb = (shade * brightness)[..., None] * skin
        rgb[~inside] = backdrop[~inside, None]
        if infrared:
            rgb += np.where(inside, infrared * shade, infrared * paper).astype(np.float32)[
                ..., None
            ]
        for where, value in spots:
            rgb[where] = value
        return rgb + np.float32(noise) * np.random.default_rng(seed).standard_normal(
            rgb.shape, dtype=np.float32
        )

    rgb = photographed(shade.mean(axis=0), noise / np.sqrt(len(shade)), seed)
    tip = ((width - 1) / 2 + tip_at[0] * px_per_mm, (height - 1) / 2 - tip_at[1] * px_per_mm)
    return Scene(
        rgb,
        inside,
        px_per_mm,
        tip,
        lights,
        lambda k: photographed(shade[k], noise, 1000 * (seed + 1) + k),
    )


@pytest.fixture(scope="session")
def draw_finger() -> Callable[..., Scene]:
    return draw
