"""What codes are learned by: how impressions of one finger differ, and how fingers do."""

from __future__ import annotations

import numpy as np
from flat_fingers import Laid

from splitknit.model import FloatArray
from splitknit_match.matching.code import CELLS, COLUMNS, ROWS, FactorModel, code_field, origin_of, sampled
from splitknit_match.matching.template import Template

JITTER_MM, JITTER_DEG = 0.5, 2.5
"""What is left of a probe's alignment between its variants: half their steps."""
STILL = np.zeros(1)


def mirrored(channels: FloatArray) -> FloatArray:
    """Fields (..., 3, CELLS) of the same finger of the other hand."""
    flipped = channels.reshape(*channels.shape[:-1], ROWS, COLUMNS)[..., ::-1].reshape(channels.shape).copy()
    flipped[..., 1, :] *= -1
    return flipped


def relation(a: Laid, b: Laid) -> tuple[float, float, float]:
    """Turn and shifts of :func:`sampled` that bring `a` to the frame of `b`."""
    below = np.array([0.0, 100.0])
    full = [np.vstack([laid.wave_from_template, [0.0, 0.0, 1.0]]) for laid in (a, b)]
    both = np.linalg.inv(full[1]) @ full[0]
    turn = float(np.arctan2(both[0, 1] - both[1, 0], both[0, 0] + both[1, 1]))
    there = both @ np.append(np.array(origin_of(a.template)) + below, 1.0)
    shift = (there[:2] - np.array(origin_of(b.template)) - below) * a.template.pitch_mm
    return turn, float(shift[0]), float(shift[1])


def within(pairs: list[Laid], rng: np.random.Generator, copies: int = 2) -> FloatArray:
    """(3, CELLS) variance of the channels between impressions of one finger that lie on each other but for jitter."""
    squares, weights = np.zeros((3, CELLS)), np.full(CELLS, 1e-3)
    for a, b in zip(pairs[::2], pairs[1::2], strict=True):
        if a.template.empty or b.template.empty:
            continue
        turn, right, down = relation(b, a)
        jitter = rng.uniform(-1.0, 1.0, (3, copies)) * np.array([np.deg2rad(JITTER_DEG), JITTER_MM, JITTER_MM])[:, None]
        other, seen = sampled(code_field(b.template), turn + jitter[0], right + jitter[1], down + jitter[2])
        own, known = sampled(code_field(a.template), STILL, STILL, STILL)
        weight = np.minimum(known, seen)
        squares += ((own - other) ** 2 * weight[:, None]).sum(axis=0)
        weights += weight.sum(axis=0)
    return np.asarray(0.5 * squares / weights, dtype=np.float32)


def offset(templates: list[Template], complete: FloatArray) -> FloatArray:
    """(3, CELLS) by which fields seen on true surfaces differ, on average, from fields as drawn.

    Few surfaces know it: cells that only some show are drawn towards zero (five surfaces' worth).
    """
    seen = [sampled(code_field(template), STILL, STILL, STILL) for template in templates if not template.empty]
    channels, weights = (np.concatenate(parts) for parts in zip(*seen, strict=True))
    away = (channels - complete.mean(axis=0)) * weights[:, None]
    return np.asarray(away.sum(axis=0) / (weights.sum(axis=0) + 5.0), dtype=np.float32)


def factor_model(complete: FloatArray, noise: FloatArray, size: int, temper: float) -> FactorModel:
    """Model of complete fields (N, 3, CELLS) of different fingers and the noise (3, CELLS) of impressions.

    Noise is not independent from cell to cell, as the model takes it: its variance is raised by `temper`, so that the
    posterior does not believe in what many neighbours repeat.
    """
    everyone = np.concatenate([complete, mirrored(complete)])
    mean = everyone.mean(axis=0)
    scale = np.sqrt(noise).ravel()
    away = (everyone - mean).reshape(len(everyone), -1) / scale
    values, axes = np.linalg.eigh(away.T @ away / len(away))
    values, axes = values[::-1][:size], axes[:, ::-1][:, :size]
    loading = (axes * np.sqrt(np.maximum(values, 0.0))) * scale[:, None]
    rest = np.maximum((away**2).mean(axis=0) * scale**2 - (loading**2).sum(axis=1), 0.0)
    total = temper * noise + rest.reshape(noise.shape)
    return FactorModel(
        mean.astype(np.float32), loading.reshape(3, CELLS, size).astype(np.float32), total.astype(np.float32)
    )
