"""Lights that nobody listed: their directions and what they leave open of the surface, or a
refusal."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import splitknit
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.plain import spread_lights
from splitknit.photometric.uncalibrated import unknown_lights

Y, X = np.mgrid[1:-1:100j, -1:1:100j]
INSIDE = np.hypot(X, Y) < 0.9
HEIGHT = 0.9 - 0.5 * X**2 - 0.3 * Y**2 + 0.06 * np.sin(5 * X + 1) * np.cos(4 * Y)


def photographs(height: np.ndarray, lights: np.ndarray) -> np.ndarray:
    """(L, 100, 100) of uint16: a matt surface over the places X, Y, before black."""
    step = X[0, 1] - X[0, 0]
    slopes = [
        -np.gradient(height, step, axis=1),
        np.gradient(height, step, axis=0),
        np.ones_like(X),
    ]
    normals = np.dstack(slopes) / np.linalg.norm(slopes, axis=0)[..., None]
    light = np.einsum("ki,yxi->kyx", lights, normals).clip(0) * INSIDE
    noise = np.random.default_rng(0).normal(0, 100, light.shape)
    return np.clip(50_000 * light + noise, 0, 65535).astype(np.uint16)


def apart_deg(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((found * true).sum(axis=1), -1, 1))).mean())


@pytest.mark.slow
def test_arrays_without_lights_give_a_surface_and_what_is_not_known_of_it() -> None:
    bright = np.array([0.5, 1, 0.7, 1, 0.4, 1, 0.8, 1, 1])
    images = (photographs(HEIGHT, spread_lights(9)[::-1]) * bright[:, None, None]).astype(np.uint16)
    result = splitknit.reconstruct_images(images, None, INSIDE, 49.5, bright)
    error_um = 1000 * (result.height_mm - HEIGHT)[INSIDE]
    error_um -= error_um.mean()
    assert np.mean(np.abs(error_um) < 2 * result.uncertainty_um[INSIDE]) > 0.95
    assert np.std(error_um) < 0.15 * 1000 * np.std(HEIGHT[INSIDE])
    assert any("bas-relief" in text for text in result.warnings)
    assert result.facts["lights"] == "estimated"


@pytest.mark.slow
def test_the_command_line_takes_unknown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for k, image in enumerate(photographs(HEIGHT, spread_lights(7))):
        cv2.imwrite(str(folder / f"{k}.png"), image)
    given = ["reconstruct", "--images", str(folder), "--lights", "unknown", "--px-per-mm", "8"]
    assert main([*given, "--out", str(tmp_path / "out"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["facts"]["lights"] == "estimated"
    assert "bas-relief" in {each["code"] for each in facts["findings"]}
    assert main([*given, "--material", "skin", "--out", str(tmp_path / "skin")]) == 2
    assert "unknown lights go with opaque things" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("case", ["few", "copies", "noise", "waves"])
def test_photographs_that_determine_no_lights_are_refused(case: str) -> None:
    images = photographs(HEIGHT, spread_lights(8))
    if case == "few":
        images = images[:5]
    elif case == "copies":
        images = np.repeat(images[:1], 8, axis=0)
    elif case == "noise":
        images = np.random.default_rng(1).integers(1, 60_000, images.shape).astype(np.uint16)
    else:  # turned by a quarter, these slopes have no curl either
        images = photographs(0.1 * np.cos(6 * X) * np.cos(6 * Y), spread_lights(8))
    with pytest.raises(BadInput, match="lights"):
        unknown_lights(images.astype(np.float32) / 65535, INSIDE)


def test_the_bear_needs_no_list(data_dir: Path) -> None:
    data = np.load(data_dir / "diligent" / "bear.npz")
    true = data["lights"] / np.linalg.norm(data["lights"], axis=1, keepdims=True)
    found, deviation = unknown_lights(data["images"].astype(np.float32) / 65535, data["mask"])
    assert apart_deg(found, true) < 8
    assert deviation[0] > 0.2
