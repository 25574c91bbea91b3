"""Images of a small ridged dome of skin, made in a few lines of double precision of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.model import Camera, Led, Rig
from splitknit.skin.diffusion import SkinSettings, diffusion
from splitknit.skin.grid import BandImages, Grid

PITCH_MM = 0.04
COLOURS = ("red", "green", "blue")
ALBEDO = {"red": 0.62, "green": 0.42, "blue": 0.33, "nir": 0.66}
PERIOD_MM = 0.48
DEPTH_MM = 0.06
CUT_MM = -3.4


@dataclass(frozen=True, eq=False)
class Scene:
    grid: Grid
    white: BandImages
    nir: BandImages
    shape_mm: np.ndarray
    relief_mm: np.ndarray
    inner: np.ndarray
    """Where the surface is well seen."""


def ring(band: str, turn: float = 0.0) -> Rig:
    """Seven near LEDs on a circle of 52.5 mm, 140 mm above the finger plane."""
    leds = tuple(
        Led(
            band,
            position_mm=(52.5 * np.cos(a + turn), 52.5 * np.sin(a + turn), 140.0),
            intensity=1.0 + 0.05 * (k % 3),
        )
        for k, a in enumerate(2 * np.pi * np.arange(7) / 7)
    )
    return Rig(Camera(1 / PITCH_MM, (300, 300)), leds)


def dome(
    x: np.ndarray, y: np.ndarray, depth: float = DEPTH_MM
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Ellipsoid and oblique ridges on it (mm), the slopes of both together."""
    root = np.sqrt(np.maximum(1 - (x / 5.2) ** 2 - (y / 6.0) ** 2, 0.05))
    shape = 3.4 * root
    k = 2 * np.pi / PERIOD_MM
    phase = k * (0.5 * x + np.sqrt(0.75) * y)
    relief = depth / 2 * np.cos(phase)
    swing = -depth / 2 * k * np.sin(phase)
    slope_x = -3.4 * x / 5.2**2 / root + 0.5 * swing
    slope_y = -3.4 * y / 6.0**2 / root + np.sqrt(0.75) * swing
    return shape, relief, slope_x, slope_y


def fresnel(cosine: np.ndarray, index: float = 1.42) -> np.ndarray:
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (index * cosine - inside) / (index * cosine + inside)
    return 0.5 * (s**2 + p**2)


def ggx(normal: np.ndarray, light: np.ndarray, roughness: float) -> np.ndarray:
    """Cook-Torrance glare times the cosine of the light, viewer along z; vectors (3, ...) of unit
    length."""
    a2 = roughness**2
    half = light + np.array([0.0, 0.0, 1.0])[:, None, None]
    half = half / np.linalg.norm(half, axis=0)
    nl, nv = np.maximum((normal * light).sum(axis=0), 1e-3), np.maximum(normal[2], 0.05)
    nh = (normal * half).sum(axis=0)
    lobe = a2 / (np.pi * (nh**2 * (a2 - 1) + 1) ** 2)

    def smith(c: np.ndarray) -> np.ndarray:
        return 2 * c / (c + np.sqrt(a2 + (1 - a2) * c**2))

    return lobe * smith(nl) * smith(nv) * fresnel(np.clip(half[2], 0, 1)) / (4 * nl * nv) * nl


def photograph(
    rig: Rig,
    names: tuple[str, ...],
    glare: float,
    seed: int,
    *,
    scattering: float = 1.0,
    depth: float = DEPTH_MM,
) -> tuple[np.ndarray, ...]:
    """Images (C, L, H, W), mask, x, y and the heights; the window is cut at the bottom only
    afterwards."""
    x, y = (np.arange(-140, 140) + 0.5) * PITCH_MM, -(np.arange(-160, 160) + 0.5) * PITCH_MM
    gx, gy = np.meshgrid(x, y)
    shape, relief, slope_x, slope_y = dome(gx, gy, depth)
    mask = (gx / 5.2) ** 2 + (gy / 6.0) ** 2 < 0.86
    normal = np.stack([-slope_x, -slope_y, np.ones_like(gx)])
    normal /= np.linalg.norm(normal, axis=0)
    surface = shape - shape[mask].mean() + 1.0 + relief
    omega = np.hypot(
        2 * np.pi * np.fft.fftfreq(400, PITCH_MM)[:, None],
        2 * np.pi * np.fft.rfftfreq(400, PITCH_MM)[None, :],
    )
    skin = SkinSettings(scattering_factor=scattering)
    images = np.empty((len(names), len(rig.leds), *gx.shape))
    for k, led in enumerate(rig.leds):
        towards = np.asarray(led.position_mm)[:, None, None] - np.stack([gx, gy, surface])
        distance = np.linalg.norm(towards, axis=0)
        towards /= distance
        strength = led.intensity * (140.0 / distance) ** 2
        cosine = (normal * towards).sum(axis=0)
        enters = (1 - fresnel(np.clip(cosine, 1e-3, 1))) / (1 - fresnel(np.ones(1)))
        arriving = np.where(mask, strength * np.maximum(cosine, 0) * enters, 0.0)
        spectrum = np.fft.rfft2(arriving, (400, 400))
        mirrored = np.where(mask, strength * np.pi * ggx(normal, towards, 0.3), 0.0)
        for c, name in enumerate(names):
            spread = diffusion(skin.scattering(name), skin.absorption(name))(omega)
            blurred = np.fft.irfft2(spectrum * spread, (400, 400))[: gx.shape[0], : gx.shape[1]]
            images[c, k] = mask * (ALBEDO[name] * blurred + glare * mirrored)
    images += np.random.default_rng(seed).normal(0, 0.0005, images.shape)
    rows = y > CUT_MM
    return images[:, :, rows].astype(np.float32), mask[rows], x, y[rows], shape[rows], relief[rows]


def make_scene(glare: float = 0.5, scattering: float = 1.0, depth: float = DEPTH_MM) -> Scene:
    white, nir = ring("white"), ring("nir", np.pi / 7)
    stack, mask, x, y, shape, relief = photograph(
        white, COLOURS, glare, 1, scattering=scattering, depth=depth
    )
    invisible = photograph(nir, ("nir",), glare, 2, scattering=scattering, depth=depth)[0]
    grid = Grid(mask, x, y, PITCH_MM, (False, True, False, False))
    gx, gy = np.meshgrid(x, y)
    inner = ((gx / 5.2) ** 2 + (gy / 6.0) ** 2 < 0.45) & (y[:, None] > CUT_MM + 0.8)
    return Scene(
        grid,
        BandImages(COLOURS, stack, white),
        BandImages(("nir",), invisible, nir),
        shape,
        relief,
        inner,
    )


def shape_rms(estimated: np.ndarray, true: np.ndarray, where: np.ndarray) -> float:
    """Root mean square difference, means removed, mm."""
    difference = (estimated - true)[where]
    return float(np.sqrt(((difference - difference.mean()) ** 2).mean()))


def relief_gain(estimated: np.ndarray, true: np.ndarray, where: np.ndarray) -> tuple[float, float]:
    """Gain (regression on the truth) and correlation."""
    a, b = estimated[where] - estimated[where].mean(), true[where] - true[where].mean()
    return float((a * b).sum() / (b * b).sum()), float(
        (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum())
    )
