"""Lights that nobody listed: their directions and what they leave open of the surface, or a
refusal."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import splitknit
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.observation.plain import capture_of_arrays, spread_lights
from splitknit.photometric.uncalibrated import (
    bas_relief_note,
    bas_relief_of,
    bas_relief_um,
    unknown_lights,
    with_estimated_lights,
)

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


def apart_deg(estimated: np.ndarray, true: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((estimated * true).sum(axis=1), -1, 1))).mean())


def test_lights_are_found_where_no_mask_is_given_and_one_image_is_clipped() -> None:
    true = spread_lights(6)
    images = photographs(HEIGHT, true).astype(np.float32) / 65535
    ceiling = np.full(6, np.inf)
    ceiling[2] = 0.9 * images[2].max()
    images[2] = np.minimum(images[2], ceiling[2])
    lights, deviation = unknown_lights(images, ceilings=ceiling)
    assert apart_deg(lights, true) < 1
    assert np.allclose(np.linalg.norm(lights, axis=1), 1)
    assert deviation == pytest.approx((0.2386, 0.0556, 0.0725), rel=0.02)


def test_a_capture_of_unknown_lights_gets_their_directions() -> None:
    """Before a bright background, with some places clipped under the brightest light."""
    bright = np.array([0.5, 1, 0.7, 1.4, 0.4, 1, 0.8])
    images = photographs(HEIGHT, spread_lights(7)[::-1]) * bright[:, None, None]
    images = np.where(INSIDE, images, 40_000).clip(0, 65535).astype(np.uint16)
    capture, _ = capture_of_arrays(images, None, INSIDE, 49.5, bright)
    rig = with_estimated_lights(capture).rig
    directions = np.array([led.direction for led in rig.leds])
    assert apart_deg(directions, spread_lights(7)[::-1]) < 1
    assert [led.intensity for led in rig.leds] == [led.intensity for led in capture.rig.leds]
    assert rig.provenance["lights"] == "estimated"
    assert bas_relief_of(rig) == tuple(rig.provenance["bas_relief"])


def test_a_capture_of_known_lights_is_left_as_it_is() -> None:
    capture, _ = capture_of_arrays(photographs(HEIGHT, spread_lights(3)), spread_lights(3))
    assert with_estimated_lights(capture) is capture
    assert bas_relief_of(capture.rig) is None


def test_unknown_lights_on_skin_are_refused() -> None:
    capture, _ = capture_of_arrays(photographs(HEIGHT, spread_lights(6)), None)
    with pytest.raises(BadInput, match="unknown lights go with opaque things"):
        with_estimated_lights(replace(capture, material="skin"))


@pytest.mark.parametrize(
    "damaged", [None, [0.1, 0.2], *(0.1 - np.eye(3)), *(0.1 + np.diag([np.inf] * 3))]
)
def test_a_damaged_deviation_in_a_rig_is_refused(damaged: object) -> None:
    rig = capture_of_arrays(photographs(HEIGHT, spread_lights(3)), spread_lights(3))[0].rig
    assert bas_relief_of(replace(rig, provenance={"bas_relief": [0.1, 0, 0.2]})) == (0.1, 0, 0.2)
    with pytest.raises(BadInput, match="names no three numbers"):
        bas_relief_of(replace(rig, provenance={"bas_relief": damaged}))


def test_the_note_gives_the_factor_and_the_tilt_of_both_slopes() -> None:
    note = bas_relief_note((0.75, 0.03, 0.04))
    assert "by 75 % (standard deviation), and the whole tilted by 2.9 deg" in note


def test_deviation_of_heights_grows_with_height_and_distance_from_the_middle() -> None:
    height, inside = np.outer([1.0, 3.0], np.ones(5)), np.ones((2, 5), dtype=bool)
    inside[:, 4] = False
    height[:, 4] = np.nan
    um = bas_relief_um(height.astype(np.float32), inside, 0.1, (0.2, 0.3, 0.4))
    right, up = 0.1 * (np.arange(4) - 1.5), 0.1 * np.array([[0.5], [-0.5]])
    expected = 1000 * np.sqrt(0.2**2 + (0.3 * right) ** 2 + (0.4 * up) ** 2)
    np.testing.assert_allclose(um[:, :4], expected, rtol=1e-5)


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
    command = f"reconstruct --images {folder} --lights unknown --px-per-mm 8".split()
    assert main([*command, "--out", str(tmp_path / "out"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["facts"]["lights"] == "estimated"
    assert "bas-relief" in {each["code"] for each in facts["findings"]}
    assert main([*command, "--material", "skin", "--out", str(tmp_path / "skin")]) == 2
    assert "unknown lights go with opaque things" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ("few", "need 6 photographs, but there are 5"),
        ("copies", "do not determine their lights"),
        ("noise", "do not determine their lights"),
        ("one dark", "too little of the object is lit in four"),
        ("small", "too little of the object is lit in four"),
        pytest.param("waves", "other lights explain", marks=pytest.mark.slow),
    ],
)
def test_photographs_that_determine_no_lights_are_refused(case: str, message: str) -> None:
    images, inside = photographs(HEIGHT, spread_lights(8)), INSIDE
    if case == "few":
        images = images[:5]
    elif case == "copies":
        images = np.repeat(images[:1], 8, axis=0)
    elif case == "noise":
        images = np.random.default_rng(1).integers(1, 60_000, images.shape).astype(np.uint16)
    elif case == "one dark":
        images[3] = 0
    elif case == "small":
        images, inside = images[:, ::2, ::3], INSIDE[::2, ::3]
    else:  # turned by a quarter, these slopes have no curl either
        images = photographs(0.1 * np.cos(6 * X) * np.cos(6 * Y), spread_lights(8))
    with pytest.raises(BadInput, match=message):
        unknown_lights(images.astype(np.float32) / 65535, inside)


def test_the_bear_needs_no_list(data_dir: Path) -> None:
    data = np.load(data_dir / "diligent" / "bear.npz")
    true = data["lights"] / np.linalg.norm(data["lights"], axis=1, keepdims=True)
    lights, deviation = unknown_lights(data["images"].astype(np.float32) / 65535, data["mask"])
    assert apart_deg(lights, true) < 8
    assert deviation[0] > 0.2
