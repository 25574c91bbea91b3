"""Pores of two fingers, compared where their ridges lie on each other."""

from __future__ import annotations

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from spiral_prints import spiral_print
from splitknit.model import Surface

with scripts_of(VALIDATION / "match") as script:
    pore = script("pore_match")
pore_match, pore_template = pore.pore_match, pore.pore_template
PITCH_MM, DOWN_PX = 25.4 / 500, 12


def side(seed: int, pores: np.ndarray, down_px: int = 0) -> object:
    """A flat finger with known pores, `down_px` further down."""
    ridge = -spiral_print((0, down_px)).astype(np.float32)[100:400] * np.float32(1e-4)
    flat, normals = np.zeros_like(ridge), np.zeros((*ridge.shape, 3), np.float32)
    normals[..., 2] = 1
    rng = np.random.default_rng(seed)
    found = pores + rng.normal(0, 0.5, pores.shape) + [0, down_px]
    kept = found[rng.random(len(found)) < 0.8]
    surface = Surface(ridge, flat, normals, np.ones(ridge.shape, bool), PITCH_MM, np.eye(3), ridge.shape)
    return pore_template(surface, np.column_stack([kept, np.ones(len(kept))]))


@pytest.fixture(scope="module")
def pores() -> np.ndarray:
    return np.random.default_rng(0).uniform([60, 60], [320, 240], (400, 2))


def test_the_same_pores_are_paired(pores: np.ndarray) -> None:
    a, b = side(1, pores), side(2, pores, DOWN_PX)
    found, back = pore_match(a, b), pore_match(b, a)
    assert found.similarity > 0.7
    assert (back.pairs, back.pores) == (found.pairs, found.pores[::-1])
    assert found.pores[0] == pytest.approx(320, abs=40)


def test_other_pores_on_the_same_ridges_are_not(pores: np.ndarray) -> None:
    others = np.random.default_rng(9).uniform([60, 60], [320, 240], (400, 2))
    assert pore_match(side(1, pores), side(2, others, DOWN_PX)).similarity < 0.5


def test_nothing_to_compare(pores: np.ndarray) -> None:
    none = side(1, pores[:0])
    assert pore_match(none, side(2, pores)).similarity == 0.0
