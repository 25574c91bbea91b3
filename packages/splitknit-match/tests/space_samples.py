"""Invented minutiae in space: on a bent patch of skin, laid down again with noise, losses and a motion of its own."""

from __future__ import annotations

import numpy as np

from splitknit_match.matching.minutiae_record import SpaceMinutiae


def finger(seed: int, count: int = 60) -> SpaceMinutiae:
    """Minutiae of a finger: about 14 x 20 mm of skin, bent across and along, directions in the skin."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-7, 7, count), rng.uniform(-10, 10, count)
    z = -(x**2) / 14 - y**2 / 60
    ahead = rng.uniform(0, 2 * np.pi, count)
    along = np.stack([np.cos(ahead), np.sin(ahead), -x / 7 * np.cos(ahead) - y / 30 * np.sin(ahead)], axis=1)
    return minutiae(np.stack([x, y, z], axis=1), along, rng)


def minutiae(places: np.ndarray, along: np.ndarray, rng: np.random.Generator) -> SpaceMinutiae:
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    kind = rng.integers(1, 3, len(places)).astype(np.uint8)
    quality = rng.integers(1, 101, len(places)).astype(np.uint8)
    theta = np.arctan2(along[:, 1], along[:, 0]) % (2 * np.pi)
    return SpaceMinutiae(places, theta, np.arcsin(np.clip(along[:, 2], -1, 1)), kind, quality)


def again(one: SpaceMinutiae, seed: int, noise_mm: float = 0.1, kept: float = 0.75) -> SpaceMinutiae:
    """The same finger another time: some minutiae lost, others wrongly there, all a little off."""
    rng = np.random.default_rng([seed, 1])
    chosen = rng.permutation(one.count)[: round(kept * one.count)]
    places = one.position_mm[chosen] + rng.normal(0, noise_mm, (len(chosen), 3))
    along = one.direction[chosen] + rng.normal(0, 0.08, (len(chosen), 3))
    wrong = finger(seed + 10_000, max(one.count - len(chosen), 1))
    return minutiae(np.concatenate([places, wrong.position_mm]), np.concatenate([along, wrong.direction]), rng)


def turned(one: SpaceMinutiae, seed: int) -> SpaceMinutiae:
    """The same minutiae, moved rigidly to anywhere."""
    rng = np.random.default_rng([seed, 2])
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation[:, 0] *= np.linalg.det(rotation)
    along = one.direction @ rotation.T
    theta = np.arctan2(along[:, 1], along[:, 0]) % (2 * np.pi)
    phi = np.arcsin(np.clip(along[:, 2], -1, 1))
    return SpaceMinutiae(one.position_mm @ rotation.T + rng.uniform(-30, 30, 3), theta, phi, one.type, one.quality)
