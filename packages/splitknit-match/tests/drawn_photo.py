"""A drawn photograph of a finger: an elliptic cylinder with ridges at known distances."""

from __future__ import annotations

import numpy as np
from scipy.special import ellipeinc

HALF, PX_PER_MM, PERIOD_MM = 110.0, 220.0 / 17.0, 0.5
SKIN, PAPER = (215.0, 160.0, 140.0), (120.0, 130.0, 140.0)


def drawn(
    turn_deg: float = 0.0, *, across: bool = True, minutiae: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Photograph (520, 460, 3) uint8 and mask; ridges run along the finger (`across` is their
    distance) or round it.

    `minutiae`: so many ridge endings at random places of the pad, as phase dislocations.
    """
    row, column = np.indices((520, 460)).astype(np.float64)
    angle = np.deg2rad(turn_deg)
    x = np.cos(angle) * (column - 230) - np.sin(angle) * (row - 250)
    y = np.sin(angle) * (column - 230) + np.cos(angle) * (row - 250)
    inside = (np.abs(x) < HALF) & ((y > -60) | ((x / HALF) ** 2 + ((y + 60) / HALF) ** 2 < 1))
    polar = np.arcsin(np.clip(x / HALF, -1, 1))
    along = HALF * ellipeinc(polar, 1 - 0.8**2) if across else y
    phase = 2 * np.pi * along / (PERIOD_MM * PX_PER_MM)
    rng = np.random.default_rng(1)
    for sign in rng.choice((-1, 1), minutiae):
        phase += sign * np.arctan2(y - rng.uniform(-100, 160), x - rng.uniform(-80, 80))
    ridges = 1 + 0.12 * np.cos(phase)
    light = (0.45 + 0.55 * np.cos(polar)) * ridges
    picture = np.where(inside[..., None], light[..., None] * SKIN, np.array(PAPER))
    noisy = picture + np.random.default_rng(0).normal(0, 2, picture.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), inside
