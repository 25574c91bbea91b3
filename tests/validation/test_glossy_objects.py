"""Gloss and metal of validation/objects: what is sound is called so, and what is wrong is found."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import cv2
import numpy as np
import pytest

import splitknit
from script_folder import VALIDATION, scripts_of
from splitknit.errors import BadInput
from splitknit.findings import Severity
from splitknit.observation.plain import capture_of_arrays
from splitknit.reconstruction import Reconstruction

with scripts_of(VALIDATION / "objects") as script:
    GLOSSY: ModuleType = script("glossy")
    MISTAKES: ModuleType = script("mistakes")

NOT_OF_GLOSS = {
    "unequal-lights",
    "estimated-brightness",
    "blurred-photograph",
    "moved-photograph",
    "double-photograph",
    "unlike-photograph",
    "underexposed-photograph",
    "strange-photograph",
    "other-encoding",
    "part-left-out",
}


def measured(target, intensities=None, **changes) -> Reconstruction:
    """The surface of rendered photographs; `changes` are made to their capture."""
    units = target.lights / np.linalg.norm(target.lights, axis=1, keepdims=True)
    capture, _ = capture_of_arrays(target.images, units, target.mask, 16.0, intensities)
    return splitknit.reconstruct(replace(capture, **changes))


def codes(result: Reconstruction) -> dict[str, Severity]:
    return {finding.code: finding.severity for finding in result.findings}


@pytest.mark.parametrize(
    ("name", "stated"),
    [
        *((name, False) for name in GLOSSY.THINGS),
        ("satin letters, near", True),
        ("steel key", True),
    ],
)
def test_nothing_is_said_of_lamps_focus_or_encoding_of_sound_gloss(name: str, *, stated) -> None:
    """A steel key's lamps were said to differ 46-fold, which turned its surface by 50 deg; a coin's
    photograph to be blurred by 3 px."""
    target = GLOSSY.photographed(*GLOSSY.THINGS[name])
    intensities = np.ones(len(target.images)) if stated else None
    encoding = "srgb" if target.images.dtype == np.uint8 else "linear"
    assert not NOT_OF_GLOSS & codes(measured(target, intensities, encoding=encoding)).keys()


@pytest.mark.parametrize("spread", [0.1, 0.3])
@pytest.mark.parametrize("shape", ["key", "coin", "egg", "bowl", "ring", "letters"])
def test_lamps_that_differ_are_found_on_matt_things(shape: str, spread: float) -> None:
    """They are taken out where the photographs then fit to their noise, else it is doubted."""
    target = GLOSSY.photographed(shape, GLOSSY.MATT, strengths=spread)
    result = measured(target)
    if "light_brightness" in result.facts:
        estimated = np.array(result.facts["light_brightness"])
        assert estimated == pytest.approx(target.intensities / target.intensities.mean(), rel=0.02)
        (effect,) = (each for each in result.findings if each.code == "estimated-brightness")
        assert effect.effect_deg
    else:
        (doubt,) = (each for each in result.findings if each.code == "unequal-lights")
        assert doubt.severity == Severity.DOUBT
        assert "give `brightness` estimate" in str(doubt)
        several_fold = target.intensities.max() > 3.0 * target.intensities.min()
        assert several_fold or (doubt.effect_deg and doubt.effect_deg > 10.0)


@pytest.mark.parametrize(
    ("name", "limit_deg"),
    # matt normals are 26, 21, 24, 5 and 24 deg off
    [
        ("steel key", 3.0),
        ("brass key, JPEG", 4.5),
        ("steel coin", 1.0),
        ("glazed bowl", 1.5),
        ("satin bowl", 6.0),
    ],
)
def test_normals_of_gloss_and_metal(name: str, limit_deg: float) -> None:
    target = GLOSSY.photographed(*GLOSSY.THINGS[name])
    result = measured(target, encoding="srgb" if target.images.dtype == np.uint8 else "linear")
    cosine = (result.normals_measured * target.normals).sum(axis=2)[target.mask]
    assert np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))) < limit_deg
    assert codes(result)["glossy"] == Severity.NOTE


def test_an_estimate_that_was_asked_for_is_doubted_on_metal() -> None:
    target = GLOSSY.photographed(*GLOSSY.THINGS["steel key"])
    capture, _ = capture_of_arrays(target.images, target.lights, target.mask, 16.0)
    rig = replace(capture.rig, provenance={"intensities": "estimate"})
    result = measured(target, rig=rig)
    assert codes(result)["estimated-brightness"] == Severity.DOUBT


@pytest.mark.parametrize("shape", ["coin", "letters"])
def test_a_spoilt_photograph_is_still_named_on_lacquer(shape: str) -> None:
    target = GLOSSY.photographed(shape, GLOSSY.LACQUER)
    image = cv2.GaussianBlur(target.images[3].astype(np.float32), (0, 0), 4)
    target.images[3] = np.rint(image).astype(np.uint16)
    result = measured(target)
    assert ("blurred-photograph", ("image 3",)) in {
        (each.code, each.files) for each in result.findings
    }


@pytest.mark.parametrize(
    ("shape", "stored", "stated"),
    [
        ("egg", "linear", "srgb"),
        ("egg", "srgb", "linear"),
        ("ring", "srgb", "linear"),
        ("key", "linear", "srgb"),
    ],
)
def test_a_wrong_encoding_spoils_a_matt_thing(shape: str, stored: str, stated: str) -> None:
    """It was a note, as if the surface held."""
    target = GLOSSY.photographed(shape, GLOSSY.MATT, jpeg=stored == "srgb")
    assert "other-encoding" not in codes(measured(target, encoding=stored))
    with pytest.raises(BadInput, match=f"shade as {stored}, not as {stated}"):
        measured(target, encoding=stated)


@pytest.mark.parametrize("shape", ["egg", "key"])
@pytest.mark.parametrize(
    ("code", "answer"),
    [("tone-curve", lambda light: light**0.7), ("ambient-light", lambda light: light + 0.08)],
)
def test_a_response_that_alone_makes_a_thing_matt_is_named(shape: str, code: str, answer) -> None:
    """Under a dome; both were silent, and turned the surface by some degrees."""
    target = GLOSSY.photographed(shape, GLOSSY.MATT, 32)
    light = 0.8 * target.images / 65535.0
    assert MISTAKES.said(light, target.lights, target.mask) == ""
    assert MISTAKES.said(answer(light), target.lights, target.mask) == code


@pytest.mark.parametrize(("shape", "part"), [("key", 0.31), ("coin", 0.0), ("ring", 0.0)])
@pytest.mark.parametrize("finish", [GLOSSY.STEEL, GLOSSY.MATT], ids=["steel", "matt"])
def test_what_the_outline_leaves_out_is_said(shape: str, part: float, finish) -> None:
    """A key's blade was missing without a word."""
    target = GLOSSY.photographed(shape, finish)
    result = measured(replace(target, mask=None))
    words = [str(each) for each in result.findings if each.code == "part-left-out"]
    assert len(words) == bool(part)
    if part:
        true = GLOSSY.photographed(shape, finish).mask
        left_out = 1 - (result.mask & true).sum() / true.sum()
        assert left_out == pytest.approx(part, abs=0.05)
        stated = float(words[0].split("leaves out ")[1].split(" %")[0]) / 100
        assert stated == pytest.approx(left_out, abs=0.06)


@pytest.mark.parametrize("name", ["steel ring", "satin bowl", "brass egg"])
def test_another_order_is_found_on_metal(name: str) -> None:
    """Least squares of the highlights showed none on a photographed coin and a ball of lacquer."""
    target = GLOSSY.photographed(*GLOSSY.THINGS[name])
    result = measured(replace(target, lights=target.lights[::-1]))
    (advice,) = (str(each) for each in result.findings if each.code == "light-order")
    numbers = " ".join(str(k) for k in range(len(target.lights), 0, -1))
    assert numbers in advice


@pytest.mark.parametrize("brightness", [0.4, 2.2])
def test_one_odd_lamp_of_sixteen_is_taken_out_alone(brightness: float) -> None:
    """The others outvote it, so that the misfit of all photographs hardly shows it."""
    target = GLOSSY.photographed("egg", GLOSSY.WAX, 16)
    odd = (0.4 * target.images).astype(np.uint16)
    odd[5] = (0.4 * brightness * target.images[5]).astype(np.uint16)
    result = measured(replace(target, images=odd))
    lamps = np.array(result.facts["light_brightness"])
    assert np.delete(lamps, 5) == pytest.approx(lamps[0], abs=0.002)
    assert lamps[5] / lamps[0] == pytest.approx(brightness, rel=0.05)


def test_heights_of_what_is_not_matt_have_an_uncertain_factor() -> None:
    matt, satin = (
        measured(GLOSSY.photographed("bowl", finish, 20)) for finish in (GLOSSY.MATT, GLOSSY.SATIN)
    )
    assert matt.facts["height_factor_sd"] < 0.1 < satin.facts["height_factor_sd"]
    assert "height-factor" not in codes(matt)
    assert codes(satin)["height-factor"] == Severity.NOTE
    depth_um = 1000 * np.ptp(satin.height_mm[satin.mask])
    largest_um = np.nanmax(satin.uncertainty_um[satin.mask])
    assert 0.1 * depth_um < largest_um < 0.5 * depth_um


def test_light_of_the_room_is_named_where_a_ball_faces_away() -> None:
    y, x = np.mgrid[60:-61:-1, -60:61] / 60.0
    normals = np.dstack([x, y, np.sqrt(np.clip(1.0 - x * x - y * y, 0.0, 1.0))])
    angles = 2 * np.pi * np.arange(12) / 12
    lights = np.column_stack([0.8 * np.cos(angles), 0.8 * np.sin(angles), np.full(12, 0.6)])
    light = 0.8 * np.clip(np.moveaxis(normals @ lights.T, -1, 0), 0.0, None)
    light += 0.002 * np.random.default_rng(0).random(light.shape)
    mask = normals[..., 2] > 0.2
    assert "ambient-light" not in MISTAKES.said(light, lights, mask)
    assert "ambient-light" in MISTAKES.said(light + 0.06, lights, mask)


def test_mistakes_with_a_sound_set_are_named() -> None:
    """validation/objects/mistakes.py, which needs real photographs, on a rendered egg."""
    target = GLOSSY.photographed("egg", GLOSSY.MATT, 12)
    images = target.images / 65535.0
    named = {
        mistake: MISTAKES.said(spoilt, lights, target.mask)
        for mistake, spoilt, lights in MISTAKES.mistakes(images, target.lights, target.mask)
    }
    assert named["none"] == ""
    for mistake in ("lights reversed", "lights shifted by one", "two neighbours exchanged"):
        assert named[mistake] == "light-order"
    assert named["y points down"] == named["turned by 90 deg"] == "light-frame"
    assert named["lamps differ by 12 %"] == named["one lamp at 0.4"] == "estimated-brightness"
