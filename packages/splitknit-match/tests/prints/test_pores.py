"""Pores on ridges with pits at known places."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_match.prints.pores import find_pores, write_pores
from splitknit_match.prints.sources import Source

PITCH_MM, SIZE = 0.02, 300


def rings(places: np.ndarray) -> np.ndarray:
    """(H, W) mm: ridges around a core, 0.45 mm apart, 25 um high, with pits of 0.13 mm and 15 um on their crests."""
    down, right = np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2.0
    height = 0.0125 * np.cos(2 * np.pi * np.hypot(down, right) * PITCH_MM / 0.45)
    for column, row in places - (SIZE - 1) / 2.0:
        apart = np.hypot(right - column, down - row) * PITCH_MM
        height -= 0.015 * np.exp(-0.5 * (apart / 0.055) ** 2)
    return height.astype(np.float32)


def pits() -> np.ndarray:
    """(N, 2) columns and rows on the crests, 0.9 mm apart along them."""
    found = []
    for k in range(3, 6):
        radius = k * 0.45 / PITCH_MM
        turns = np.arange(0.1, 2 * np.pi, 0.9 / (k * 0.45))[:-1]
        found += [(radius * np.cos(turn), radius * np.sin(turn)) for turn in turns]
    return np.array(found) + (SIZE - 1) / 2.0


def test_pits_on_crests_are_found_and_nothing_else() -> None:
    true = pits()
    found = find_pores(rings(true), np.ones((SIZE, SIZE), np.bool_), PITCH_MM)
    apart = np.linalg.norm(found[:, None, :2] - true[None], axis=2) * PITCH_MM
    assert (apart.min(axis=0) < 0.1).mean() > 0.95
    assert (apart.min(axis=1) < 0.1).mean() > 0.9
    assert len(find_pores(rings(true[:0]), np.ones((SIZE, SIZE), np.bool_), PITCH_MM)) < 0.1 * len(true)


def test_dark_dots_of_a_photograph_are_found_on_the_crests_of_a_relief() -> None:
    true = pits()
    none = rings(true[:0])
    photograph = 100 + 500 * (rings(true) - none)
    found = find_pores(photograph.astype(np.float32), np.ones((SIZE, SIZE), np.bool_), PITCH_MM, none)
    apart = np.linalg.norm(found[:, None, :2] - true[None], axis=2) * PITCH_MM
    assert (apart.min(axis=0) < 0.1).mean() > 0.95


def test_the_file_has_places_on_the_skin_in_mm(tmp_path: Path) -> None:
    true = pits()
    relief = rings(true)
    height = relief + np.float32(3.0)
    turned = np.array([[0.0, -1.0, SIZE - 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # the tip points to the right
    source = Source("result", np.ones((SIZE, SIZE), np.bool_), PITCH_MM, turned, (SIZE, SIZE), height, relief)
    facts = write_pores(tmp_path, source, {"version": "0"})
    record = json.loads((tmp_path / "pores.json").read_text())
    assert facts["count"] == len(record["x_mm"]) == len(record["depth"])
    assert "warning" not in facts
    column, row = (np.linalg.inv(turned) @ np.column_stack([true, np.ones(len(true))]).T)[:2]
    expected = np.stack([column - (SIZE - 1) / 2, (SIZE - 1) / 2 - row], axis=1) * PITCH_MM
    found = np.stack([record["x_mm"], record["y_mm"]], axis=1)
    apart = np.linalg.norm(found[:, None] - expected[None], axis=2)
    assert (apart.min(axis=0) < 0.1).mean() > 0.95
    assert np.abs(np.array(record["z_mm"]) - 3.0).max() < 0.05
    coarse = replace(source, pitch_mm=0.03)
    assert "pixels of 30 um shows fewer pores" in write_pores(tmp_path, coarse, {})["warning"]
    with pytest.raises(BadInput, match="needs the surface of the front view"):
        write_pores(tmp_path, replace(source, ridge_mm=None), {})


def test_pixels_that_are_too_large_are_refused() -> None:
    with pytest.raises(BadInput, match="pores need pixels of at most 34 um, but these have 50"):
        find_pores(np.zeros((50, 50), np.float32), np.ones((50, 50), np.bool_), 0.05)
