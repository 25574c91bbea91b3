"""The frame in which lights were measured, found by curl and convexity."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from splitknit.capture import Band, Capture
from splitknit.diagnosis.frames import FRAMES, SPOILT_DEG, doubt_of_lights, fit_lights, rig_of_frame
from splitknit.errors import BadInput
from splitknit.model import Camera, Led, Rig
from splitknit.pipeline import reconstruct

SHAPE = (120, 100)
MATRICES = {name: np.array(matrix, dtype=float) for name, matrix in FRAMES.items()}


@pytest.fixture(scope="module")
def egg() -> tuple[np.ndarray, np.ndarray]:
    """Normals and mask of half an egg that lies at a slant."""
    rows, columns = np.indices(SHAPE)
    x, y = (columns - 49.5) / 40.0, (59.5 - rows) / 40.0
    u, v = 0.8 * x + 0.6 * y, -0.6 * x + 0.8 * y
    inside = u**2 + (v / 1.3) ** 2 < 0.9
    z = np.sqrt(np.maximum(1.0 - u**2 - (v / 1.3) ** 2, 1e-3))
    nu, nv = u / z, v / 1.69 / z
    normals = np.dstack([0.8 * nu - 0.6 * nv, 0.6 * nu + 0.8 * nv, np.ones(SHAPE)])
    return normals / np.linalg.norm(normals, axis=2, keepdims=True), inside


def in_frame(vectors: np.ndarray, frame: str) -> np.ndarray:
    """Vectors as measured in another frame."""
    measured = np.array(vectors, dtype=float)
    measured[..., :2] = measured[..., :2] @ MATRICES[frame]
    return measured


def rig_under(lights: np.ndarray) -> Rig:
    return Rig(Camera(10.0, SHAPE), tuple(Led("white", direction=tuple(v)) for v in lights))


def capture_of(pixels: np.ndarray, rig: Rig, inside: np.ndarray) -> Capture:
    """Opaque capture of light in [0, 1], stored in eight bits; its files are 0.png, 1.png ..."""
    count = len(pixels)
    band = Band(
        "white",
        np.round(200.0 * pixels).astype(np.uint8)[..., None],
        tuple((k,) for k in range(count)),
        np.ones(count),
        np.zeros(count),
        files=tuple(f"photos/{k}.png" for k in range(count)),
    )
    return Capture(rig, {"white": band}, material="opaque", mask=inside)


@pytest.mark.parametrize("frame", FRAMES)
def test_the_frame_of_the_lights_is_found(egg, frame):
    normals, inside = egg
    lights = around(8, uneven=True)
    noisy = normals + 0.02 * np.random.default_rng(1).standard_normal(normals.shape)
    assert fit_lights(photographs(noisy, lights), in_frame(lights, frame), inside).frame == frame


@pytest.mark.parametrize("frame", FRAMES)
def test_rig_of_frame_restores_the_lights(frame):
    lights = np.array([[0.1, 0.2, 0.9], [-0.5, 0.3, 0.8], [0.4, -0.6, 0.7]])
    leds = rig_of_frame(rig_under(in_frame(lights, frame)), frame).leds
    np.testing.assert_allclose([led.direction for led in leds], lights, atol=1e-12)
    near = Rig(
        Camera(10.0, SHAPE), (Led("white", position_mm=(1.0, 2.0, 3.0), aim=(0.0, -1.0, -1.0)),)
    )
    (led,) = rig_of_frame(near, "right-down").leds
    assert (led.position_mm, led.aim) == ((1.0, -2.0, 3.0), (0.0, 1.0, -1.0))


def test_an_unknown_frame_is_refused():
    with pytest.raises(BadInput, match="must be one of right-up, right-down"):
        rig_of_frame(rig_under(np.array([[0.0, 0.0, 1.0]])), "up")


def test_a_flat_plate_keeps_its_stated_frame():
    lights = around(8, uneven=True)
    for roughness in (0.0, 0.05):
        slopes = roughness * np.random.default_rng(0).standard_normal((*SHAPE, 2))
        normals = np.dstack([slopes, np.ones(SHAPE)])
        fit = fit_lights(photographs(normals, lights), lights, np.ones(SHAPE, dtype=bool))
        assert fit.frame == "right-up"


def test_a_reconstruction_warns_and_names_the_frame(egg):
    normals, inside = egg
    angles = 2.0 * np.pi * np.arange(6) / 6.0
    lights = np.stack([0.4 * np.cos(angles), 0.4 * np.sin(angles), np.full(6, 0.9)], axis=1)
    light = np.where(inside, np.clip(normals @ lights.T, 0.0, None).transpose(2, 0, 1), 0.0)
    rig = rig_under(in_frame(lights, "right-down"))
    capture = capture_of(light, rig, inside)
    (order,) = (
        finding for finding in reconstruct(capture, "ea").findings if finding.code == "light-order"
    )
    assert "`light_frame` right-down" in str(order)
    refined = replace(capture, rig=rig_of_frame(rig, "right-down"))
    findings = reconstruct(refined, "ea").findings
    assert not any(finding.code.startswith("light-") for finding in findings)


def around(count: int, *, uneven: bool) -> np.ndarray:
    """Lights around the camera: on a ring, or at several heights."""
    angles = 2.0 * np.pi * np.arange(count) / count
    slant = 0.45 + (0.2 * np.sin(2.3 * np.arange(count)) if uneven else 0.0)
    return np.stack(
        [slant * np.cos(angles), slant * np.sin(angles), np.sqrt(1.0 - slant**2) * np.ones(count)],
        axis=1,
    )


def photographs(normals: np.ndarray, lights: np.ndarray) -> np.ndarray:
    light = np.clip(np.moveaxis(normals @ lights.T, -1, 0), 0.0, None)
    return light + 0.01 * np.random.default_rng(4).standard_normal(light.shape)


ORDERS = {
    "reversed": tuple(range(11))[::-1],
    "shifted": tuple(np.roll(range(11), -3)),
    "two exchanged": (0, 1, 3, 2, *range(4, 11)),
    "shuffled": (3, 9, 0, 6, 1, 10, 4, 8, 2, 7, 5),
}


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("name", ORDERS)
def test_a_wrong_order_is_found_and_no_frame_advised(egg, name, uneven):
    normals, inside = egg
    lights, order = around(11, uneven=uneven), ORDERS[name]
    fit = fit_lights(photographs(normals, lights)[list(order)], lights, inside)
    assert fit.order == order
    words = str(doubt_of_lights(fit))
    if uneven or name in {"two exchanged", "shuffled"}:
        assert "`light_frame`" not in words
    assert {"two exchanged": "exchange the lights of image 2 and image 3"}.get(
        name, "order"
    ) in words


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("count", [3, 4, 5, 7, 12, 24])
def test_the_right_order_is_never_doubted(egg, count, uneven):
    normals, inside = egg
    lights = around(count, uneven=uneven)
    fit = fit_lights(photographs(normals, lights), lights, inside)
    assert (fit.order, fit.frame) == (tuple(range(count)), "right-up")
    assert doubt_of_lights(fit) is None


def test_unequal_brightness_is_estimated_and_not_taken_for_another_order(egg):
    normals, inside = egg
    for seed in range(5):
        gains = 1.0 + 0.15 * np.random.default_rng(seed).standard_normal(9)
        lights = around(9, uneven=True)
        fit = fit_lights(photographs(normals, lights) * gains[:, None, None], lights, inside)
        assert fit.order == tuple(range(9))
        assert np.allclose(fit.brightness, gains / gains.mean(), rtol=0.02)
        words = str(doubt_of_lights(fit))
        assert "not as bright as is stated" in words and fit.spoils_skin == (
            fit.turned_deg > SPOILT_DEG
        )


@pytest.mark.parametrize(("count", "seed"), [(4, 3), (5, 0), (5, 1)])
def test_few_lights_give_no_brightness(egg, count, seed):
    """Directions that are wrong by some degrees are not brightness, though one for each photograph
    explains them."""
    normals, inside = egg
    lights = around(count, uneven=True)
    wrong = lights + 0.15 * np.random.default_rng(seed).standard_normal(lights.shape)
    fit = fit_lights(photographs(normals, lights), wrong, inside)
    assert fit.residual > 0.05 and fit.brightness == ()


def test_a_photograph_of_something_else_is_named(egg):
    normals, inside = egg
    lights = around(8, uneven=True)
    stack = photographs(normals, lights)
    stack[5] = np.indices(SHAPE)[0] // 6 % 2
    fit = fit_lights(stack, lights, inside)
    assert np.argmax(fit.residual_per_image) == 5
    words = str(doubt_of_lights(fit, [f"{k}.png" for k in range(8)]))
    assert fit.strange == 5 and "5.png does not belong" in words and "deg (median)" in words
    words = str(doubt_of_lights(replace(fit, strange=None), [f"{k}.png" for k in range(8)]))
    assert (
        "do not fit the lights" in words
        and "most in 5.png" in words
        and "`light_frame`" not in words
    )


@pytest.mark.parametrize("frame", FRAMES)
def test_a_field_of_balls_keeps_its_stated_frame(frame):
    rows, columns = np.indices((200, 200))
    x, y = (columns % 40 - 19.5) / 14.0, (19.5 - rows % 40) / 14.0
    ball = x**2 + y**2 < 0.9
    normals = np.dstack([x * ball, y * ball, np.sqrt(np.where(ball, 1.0 - x**2 - y**2, 1.0))])
    normals += 0.02 * np.random.default_rng(2).standard_normal(normals.shape)
    lights = around(6, uneven=True)
    fit = fit_lights(
        photographs(normals, lights), in_frame(lights, frame), np.ones((200, 200), bool)
    )
    assert fit.frame == "right-up"


def relief() -> np.ndarray:
    """Normals of a plate of random bumps and dents."""
    height = cv2.GaussianBlur(np.random.default_rng(7).standard_normal((200, 200)), (0, 0), 6)
    dy, dx = np.gradient(height * (3.0 / height.std()))
    normals = np.dstack([-dx, dy, np.ones((200, 200))])
    return normals / np.linalg.norm(normals, axis=2, keepdims=True)


@pytest.mark.parametrize("frame", FRAMES)
def test_a_relief_determines_the_frame_up_to_a_half_turn(frame):
    lights, inside = around(8, uneven=True), np.ones((200, 200), bool)
    fit = fit_lights(photographs(relief(), lights), in_frame(lights, frame), inside, relief=True)
    if frame in {"right-up", "left-down"}:
        assert fit.frame == "right-up" and doubt_of_lights(fit, material="opaque") is None
        return
    words = str(doubt_of_lights(fit, material="opaque"))
    assert (
        f"`light_frame` {frame}" in words
        or f"({frame} if what is raised comes out hollow)" in words
    )


@pytest.mark.parametrize("uneven", [False, True])
def test_lights_shifted_by_one_are_named_on_a_relief(uneven):
    lights, inside = around(8, uneven=uneven), np.ones((200, 200), bool)
    stack = photographs(relief(), lights)
    fit = fit_lights(stack, np.roll(lights, 1, axis=0), inside, relief=True)
    words = str(doubt_of_lights(fit, material="opaque"))
    assert "2 3 4 5 6 7 8 1" in words
    turned = lights @ np.array([[0.87, 0.5, 0.0], [-0.5, 0.87, 0.0], [0.0, 0.0, 1.0]])
    words = str(doubt_of_lights(fit_lights(stack, turned, inside, relief=True), material="opaque"))
    assert "belongs to no surface" in words


def test_a_report_holds_the_residual_of_every_photograph(egg):
    normals, inside = egg
    lights = around(6, uneven=True)
    light = np.clip(photographs(normals, lights), 0, 1)[[1, 0, 2, 3, 4, 5]] * inside
    result = reconstruct(capture_of(light, rig_under(lights), inside), "ea")
    assert any("exchange the lights of 0.png and 1.png." in text for text in result.warnings)
    assert len(result.facts["light_residual_per_image"]) == 6
