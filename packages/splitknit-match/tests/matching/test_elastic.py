"""Patches of two ridge bands: known shifts, the support of neighbours, the affine fit."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from splitknit_match.matching.elastic import (
    Agreement,
    better_affine,
    compare_patches,
    patch_grid,
    rigid,
)
from splitknit_match.matching.ridge_band import RidgeBand

IDENTITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def texture(seed: int, rows: int = 160, columns: int = 140) -> RidgeBand:
    noise = np.random.default_rng(seed).normal(size=(rows, columns)).astype(np.float32)
    band = cv2.GaussianBlur(noise, (0, 0), 1.2) - cv2.GaussianBlur(noise, (0, 0), 3.0)
    return RidgeBand(band / band.std(), np.ones(band.shape, np.bool_), 0.1)


@pytest.mark.parametrize("shift", [(0, 0), (3, -2), (-4, 4), (2, 1)])
def test_shifts_of_patches_are_recovered(shift: tuple[int, int]) -> None:
    b = texture(1)
    # A's content lies `shift` (columns, rows) further
    a = replace(b, value=np.roll(b.value, shift[::-1], axis=(0, 1)))
    agreement = compare_patches(patch_grid(b), a, IDENTITY)
    assert np.median(agreement.correlation[20:-20]) == pytest.approx(1.0, abs=0.02)
    # it must move back
    moved = np.median(agreement.shift, axis=0)
    np.testing.assert_allclose(moved, [-shift[0], -shift[1]], atol=0.1)


def test_too_little_valid_skin_is_not_compared() -> None:
    b = texture(3)
    half = b.valid.copy()
    half[:, 70:] = False
    patches = patch_grid(b)
    a = replace(b, value=np.where(half, b.value, np.float32(0)), valid=half)
    used = compare_patches(patches, a, IDENTITY).used
    assert 0.3 < len(used) / len(patches.corner) < 0.6
    assert patches.corner[used, 1].max() + 0.6 * patches.side <= 71
    nothing = compare_patches(patches, replace(b, valid=np.zeros_like(half)), IDENTITY)
    assert nothing.mean == 0.0
    assert len(nothing.used) == 0


def test_affine_fit_follows_a_stretched_skin() -> None:
    b = texture(4, 220, 200)
    true = np.array([[1.03, 0.01, -4.0], [-0.015, 0.98, 3.0]])  # place in B to place in A
    # A at true(p) shows B at p
    a = replace(b, value=cv2.warpAffine(b.value, true, (200, 220), flags=cv2.INTER_CUBIC))
    patches = patch_grid(b, search_mm=0.8)
    agreement = compare_patches(patches, a, IDENTITY)
    fitted = better_affine(patches, agreement, IDENTITY)
    fitted = better_affine(patches, compare_patches(patches, a, fitted), fitted)
    corners = np.array([[30, 30, 1], [170, 30, 1], [30, 190, 1], [170, 190, 1]], float)
    np.testing.assert_allclose(corners @ fitted.T, corners @ true.T, atol=0.5)
    few = (getattr(agreement, name)[:3] for name in ("used", "correlation", "shift", "weight"))
    assert better_affine(patches, Agreement(*few), IDENTITY) is IDENTITY


def test_a_rigid_map_takes_middle_to_middle_and_turns() -> None:
    turn = rigid(texture(0, 41, 61), texture(0, 101, 81), np.pi / 2, 0.5, -0.3)
    # B's middle, moved by the shift, shows A's middle
    np.testing.assert_allclose(turn @ [40 + 5, 50 - 3, 1], [30, 20], atol=1e-9)
    # content to the right of A's middle is seen above (a smaller row)
    np.testing.assert_allclose(turn @ [45, 47 - 10, 1], [40, 20], atol=1e-9)


def test_shifts_by_chance_have_no_support() -> None:
    """Dissimilar textures: each patch alone finds some shift that fits; its neighbours do not share
    it."""
    agreement = compare_patches(patch_grid(texture(6)), texture(5), IDENTITY)
    assert abs(agreement.mean) < 0.205  # 0.22 if every patch chose for itself
