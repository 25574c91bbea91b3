"""Arrays in, a surface out; a photograph that spoils it is named, and lights may differ in
brightness."""

import cv2
import numpy as np
import pytest

from refusals import bad_input
from rough_dome import scene, spoilt
from splitknit import reconstruct_images

KINDS = {
    "uint8": lambda stack: np.rint(stack * 255).astype(np.uint8),
    "uint16": lambda stack: np.rint(stack * 65535).astype(np.uint16),
    "float32": lambda stack: stack,
    "float64": lambda stack: 7.0 * stack.astype(np.float64),
    "colour": lambda stack: np.repeat(
        np.rint(stack * 65535).astype(np.uint16)[..., None], 3, axis=3
    ),
    "list": list,
}


def photographs(seed=0):
    stack, lights, mask = scene(seed, 100)
    return np.clip(0.6 * stack, 0, 1), lights, mask


def codes(result):
    return {finding.code for finding in result.findings}


def normals_apart_deg(first, second):
    cosine = (first.normals_measured * second.normals_measured).sum(axis=2)[
        first.mask & second.mask
    ]
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())


@pytest.fixture(scope="module")
def sound():
    return reconstruct_images(*photographs(), px_per_mm=10.0)


def test_an_inverted_mask_is_doubted():
    """A dome on a flat table; what is left out of a picture full of relief is no such thing."""
    stack, lights, mask = photographs()
    table = np.broadcast_to((0.4 * lights[:, 2])[:, None, None], stack.shape)
    noise = np.random.default_rng(0).normal(0, 0.003, stack.shape)
    on_table = np.clip(np.where(mask, stack, table) + noise, 0, 1).astype(np.float32)
    assert "inverted-mask" in codes(reconstruct_images(on_table, lights, ~mask, 10.0))
    assert "inverted-mask" not in codes(reconstruct_images(on_table, lights, mask, 10.0))
    hole = np.ones_like(mask)
    hole[40:60, 60:80] = False
    assert "inverted-mask" not in codes(reconstruct_images(stack, lights, hole, 10.0))


@pytest.mark.parametrize("kind", KINDS)
def test_images_of_every_type_give_the_same_normals(kind, sound):
    stack, lights, mask = photographs()
    result = reconstruct_images(KINDS[kind](stack), lights, mask, 10.0)
    assert result.height_mm.shape == mask.shape
    assert normals_apart_deg(result, sound) < 0.5


@pytest.mark.parametrize("bright", [(1.0, 1.0, 1.0), (1.0, 0.9, 0.8)])
def test_grey_images_stored_as_colour_take_lights_of_any_colour(bright, sound):
    """Images of three equal channels become one of grey only where the lights are as grey."""
    stack, lights, mask = photographs()
    grey = np.repeat(stack[..., None], 3, axis=3)
    colours = np.tile(bright, (len(lights), 1))
    result = reconstruct_images(grey, lights, mask, 10.0, colours)
    assert normals_apart_deg(result, sound) < 0.5


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
        ({"lights": None}, "lights must have the shape"),
        ({"mask": np.ones((4, 4), dtype=bool)}, "mask must have the shape"),
        ({"px_per_mm": -1.0}, "px_per_mm"),
        ({"intensities": np.zeros(8)}, "positive"),
        ({"intensities": np.ones(7)}, "intensities"),
    ],
)
def test_arrays_that_cannot_be_used_are_refused(change, words):
    stack, lights, mask = photographs()
    with bad_input(words):
        reconstruct_images(**{"images": stack, "lights": lights, "mask": mask, **change})


@pytest.mark.parametrize("kind", ["moved", "blurred", "double"])
def test_a_spoilt_photograph_is_named_and_left_out(kind, sound):
    stack, lights, mask = photographs()
    stack[5] = spoilt(stack[5], kind)
    result = reconstruct_images(stack, lights, mask, 10.0)
    (fault,) = (finding for finding in result.findings if finding.code == f"{kind}-photograph")
    assert fault.files == ("image 5",) and "left out" in str(fault) and fault.effect_deg
    assert normals_apart_deg(result, sound) < 0.5


def test_clipped_values_are_not_used(sound):
    stack, lights, mask = photographs()
    stack[5] = np.minimum(stack[5] / np.quantile(stack[5][mask], 0.9), 1.0)
    pixels = np.rint(stack * 65535).astype(np.uint16)
    result = reconstruct_images(pixels, lights, mask, 10.0)
    assert ("overexposed-photograph", ("image 5",)) in {
        (each.code, each.files) for each in result.findings
    }
    assert normals_apart_deg(result, sound) < 1.0


def test_unequal_lights_are_estimated_or_taken_as_stated(sound):
    stack, lights, mask = photographs()
    bright = np.array([1, 0.5, 0.9, 0.7, 0.4, 1, 0.8, 0.6])
    stack = stack * bright[:, None, None]
    estimated = reconstruct_images(stack, lights, mask, 10.0)
    assert estimated.facts["light_brightness"] == pytest.approx(
        (bright / bright.mean()).tolist(), rel=0.03
    )
    assert normals_apart_deg(estimated, sound) < 0.5
    stated = reconstruct_images(stack, lights, mask, 10.0, bright)
    assert "light_brightness" not in stated.facts
    assert normals_apart_deg(stated, sound) < 0.3


def test_lights_of_eight_colours_are_estimated_or_taken_as_stated(sound):
    stack, lights, mask = photographs()
    colours = np.random.default_rng(3).uniform(0.3, 1.0, (8, 3))
    images = stack[..., None] * colours[:, None, None, :]
    for intensities in (None, colours):
        assert (
            normals_apart_deg(reconstruct_images(images, lights, mask, 10.0, intensities), sound)
            < 0.5
        )


def test_a_hollow_gets_a_note_and_nothing_worse(sound):
    stack, lights, mask = photographs()
    assert "hollow" not in codes(sound)
    result = reconstruct_images(stack, lights * [-1, -1, 1], mask, 10.0)
    assert {finding.code: finding.severity for finding in result.findings}["hollow"] == "note"
    assert all(finding.severity == "note" for finding in result.findings)


def test_a_photograph_of_something_else_is_named_by_its_index(sound):
    stack, lights, mask = photographs()
    stack[5] = stack[5, ::-1, ::-1]
    result = reconstruct_images(stack, lights, mask, 10.0)
    assert any(finding.files == ("image 5",) for finding in result.findings)


def coin(rim_deg, size=300):
    """Heights in pixels of a coin whose rim falls at `rim_deg`, its eight photographs, lights and
    outline."""
    rng = np.random.default_rng(4)
    i, j = np.mgrid[0:size, 0:size] - (size - 1) / 2
    radius, wide = np.hypot(i, j), 20 / np.tan(np.deg2rad(rim_deg))
    text = cv2.GaussianBlur(
        ((np.abs(i) < 60) & (np.abs(j) % 40 < 12) & (radius < 80)) * 2.5, (0, 0), 2.0
    )
    inside = radius < 0.46 * size
    height = text + 3 * np.exp(-(((radius - 0.42 * size) / 5) ** 2))
    height -= 20 * np.clip((radius - (0.46 * size - wide)) / wide, 0, 1)
    down, right = np.gradient(height)
    normals = np.dstack([-right, down, np.ones_like(height)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    angles = 2 * np.pi * np.arange(8) / 8
    lights = np.column_stack([0.75 * np.cos(angles), 0.75 * np.sin(angles), np.full(8, 0.66)])
    patina = np.exp(0.15 * cv2.GaussianBlur(rng.standard_normal((size, size)), (0, 0), 15) * 15)
    half = lights + np.array([0, 0, 1])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    stack = 0.6 * patina * np.clip(normals @ lights.T, 0, 1).transpose(2, 0, 1)
    stack += 0.2 * np.clip(normals @ half.T, 0, 1).transpose(2, 0, 1) ** 25
    stack = np.where(inside, stack, 0.03) + 0.004 * rng.standard_normal(stack.shape)
    return height, np.clip(stack, 0, 1).astype(np.float32), lights, inside


@pytest.mark.parametrize("rim_deg", [70, 85, 89])
@pytest.mark.parametrize("masked", [False, True])
def test_a_coin_keeps_its_height_and_its_steep_rim_is_noted(rim_deg, masked):
    height, stack, lights, inside = coin(rim_deg)
    result = reconstruct_images(stack, lights, inside if masked else None, 10.0)
    both = result.mask & inside & (np.hypot(*(np.mgrid[0:300, 0:300] - 149.5)) < 0.43 * 300)
    error = (10.0 * result.height_mm - height)[both]
    assert np.std(error) < 0.6  # px; the rim is 20 px high
    assert np.ptp(result.height_mm[result.mask]) < 3.5  # mm; it is 2.6 high
    steep = "steep-walls" in codes(result)
    assert steep == (rim_deg > 81)
