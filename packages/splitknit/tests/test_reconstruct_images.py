"""Arrays in, a surface out; a photograph that spoils it is named, and lights may differ in brightness."""

import numpy as np
import pytest

import splitknit
from rough_dome import scene, spoilt
from splitknit.errors import BadInput
from splitknit.methods.photographs import INVERTED
from splitknit.photometric.frames import HOLLOW

KINDS = {
    "uint8": lambda stack: np.rint(stack * 255).astype(np.uint8),
    "uint16": lambda stack: np.rint(stack * 65535).astype(np.uint16),
    "float32": lambda stack: stack,
    "float64": lambda stack: 7.0 * stack.astype(np.float64),
    "colour": lambda stack: np.repeat(np.rint(stack * 65535).astype(np.uint16)[..., None], 3, axis=3),
    "list": list,
}


def photographs(seed=0):
    stack, lights, mask = scene(seed, 100)
    return np.clip(0.6 * stack, 0, 1), lights, mask


def turned(one, other):
    cosine = (one.normals_measured * other.normals_measured).sum(axis=2)[one.mask & other.mask]
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())


@pytest.fixture(scope="module")
def sound():
    return splitknit.reconstruct_images(*photographs(), px_per_mm=10.0)


def test_an_inverted_mask_is_doubted():
    """A dome on a flat table; what is left out of a picture full of relief is no such thing."""
    stack, lights, mask = photographs()
    table = np.broadcast_to((0.4 * lights[:, 2])[:, None, None], stack.shape)
    noise = np.random.default_rng(0).normal(0, 0.003, stack.shape)
    on_table = np.clip(np.where(mask, stack, table) + noise, 0, 1).astype(np.float32)
    assert INVERTED in splitknit.reconstruct_images(on_table, lights, ~mask, 10.0).warnings
    assert INVERTED not in splitknit.reconstruct_images(on_table, lights, mask, 10.0).warnings
    hole = np.ones_like(mask)
    hole[40:60, 60:80] = False
    assert INVERTED not in splitknit.reconstruct_images(stack, lights, hole, 10.0).warnings


@pytest.mark.parametrize("kind", KINDS)
def test_arrays_of_every_kind(kind, sound):
    stack, lights, mask = photographs()
    result = splitknit.reconstruct_images(KINDS[kind](stack), lights, mask, 10.0)
    assert result.height_mm.shape == mask.shape
    assert turned(result, sound) < 0.5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"images": np.zeros((8, 9))}, "shape"),
        ({"images": np.zeros((8, 9, 9, 4))}, "shape"),
        ({"images": [np.zeros((9, 9)), np.zeros((8, 9))]}, "one shape"),
        ({"images": np.zeros((8, 100, 100), dtype=np.int64)}, "uint8, uint16 or floats"),
        ({"images": np.full((8, 100, 100), np.nan)}, "NaN"),
        ({"images": np.zeros((8, 100, 100))}, "black"),
        ({"images": np.linspace(-0.2, 1.0, 80_000).reshape(8, 100, 100)}, "negative"),
        ({"lights": np.ones((3, 3))}, "differ in number"),
        ({"lights": "no lights"}, "numbers"),
        ({"mask": np.ones((4, 4), dtype=bool)}, "mask must have the shape"),
        ({"px_per_mm": -1.0}, "px_per_mm"),
        ({"intensities": np.zeros(8)}, "positive"),
        ({"intensities": np.ones(7)}, "intensities"),
    ],
)
def test_arrays_that_cannot_be_used_are_refused(change, words):
    stack, lights, mask = photographs()
    with pytest.raises(BadInput, match=words):
        splitknit.reconstruct_images(**{"images": stack, "lights": lights, "mask": mask, **change})


@pytest.mark.parametrize("kind", ["moved", "blurred", "double"])
def test_a_spoilt_photograph_is_named_and_left_out(kind, sound):
    stack, lights, mask = photographs()
    stack[5] = spoilt(stack[5], kind)
    result = splitknit.reconstruct_images(stack, lights, mask, 10.0)
    assert sum("image 5" in warning and "left out" in warning for warning in result.warnings) == 1
    assert turned(result, sound) < 0.5


def test_clipped_values_are_not_used(sound):
    stack, lights, mask = photographs()
    stack[5] = np.minimum(stack[5] / np.quantile(stack[5][mask], 0.9), 1.0)
    pixels = np.rint(stack * 65535).astype(np.uint16)
    result = splitknit.reconstruct_images(pixels, lights, mask, 10.0)
    assert any("image 5 is overexposed" in warning for warning in result.warnings)
    assert turned(result, sound) < 1.0


def test_unequal_lights_are_estimated_or_taken_as_stated(sound):
    stack, lights, mask = photographs()
    bright = np.array([1, 0.5, 0.9, 0.7, 0.4, 1, 0.8, 0.6])
    stack = stack * bright[:, None, None]
    found = splitknit.reconstruct_images(stack, lights, mask, 10.0)
    assert found.facts["light_brightness"] == pytest.approx((bright / bright.mean()).tolist(), rel=0.03)
    assert turned(found, sound) < 0.5
    stated = splitknit.reconstruct_images(stack, lights, mask, 10.0, bright)
    assert "light_brightness" not in stated.facts
    assert turned(stated, sound) < 0.3


def test_lights_of_eight_colours(sound):
    stack, lights, mask = photographs()
    colours = np.random.default_rng(3).uniform(0.3, 1.0, (8, 3))
    images = stack[..., None] * colours[:, None, None, :]
    for given in (None, colours):
        assert turned(splitknit.reconstruct_images(images, lights, mask, 10.0, given), sound) < 0.5


def test_a_hollow_is_noted_and_not_spoilt(sound):
    stack, lights, mask = photographs()
    assert HOLLOW not in sound.warnings
    result = splitknit.reconstruct_images(stack, lights * [-1, -1, 1], mask, 10.0)
    assert HOLLOW in result.warnings and "spoilt" not in result.facts


def test_a_photograph_of_something_else_is_named_by_its_index(sound):
    stack, lights, mask = photographs()
    stack[5] = stack[5, ::-1, ::-1]
    result = splitknit.reconstruct_images(stack, lights, mask, 10.0)
    assert any(warning.startswith("image 5 ") for warning in result.warnings)
