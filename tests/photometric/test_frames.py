"""The frame in which lights were measured, found by curl and convexity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.model import Band, Camera, Capture, Led, Rig
from splitknit.photometric.frames import FRAMES, fit_light_frame, rig_of_frame
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
    """What somebody measures whose axes point as the frame says."""
    measured = np.array(vectors, dtype=float)
    measured[..., :2] = measured[..., :2] @ MATRICES[frame]
    return measured


@pytest.mark.parametrize("frame", FRAMES)
def test_every_frame_is_found(egg, frame):
    normals, inside = egg
    rng = np.random.default_rng(1)
    noisy = in_frame(normals, frame) + 0.02 * rng.standard_normal(normals.shape)
    assert fit_light_frame(noisy, inside).frame == frame


@pytest.mark.parametrize("frame", FRAMES)
def test_the_rig_is_brought_back(frame):
    lights = np.array([[0.1, 0.2, 0.9], [-0.5, 0.3, 0.8], [0.4, -0.6, 0.7]])
    rig = Rig(Camera(10.0, SHAPE), tuple(Led("white", direction=tuple(v)) for v in in_frame(lights, frame)))
    np.testing.assert_allclose([led.direction for led in rig_of_frame(rig, frame).leds], lights, atol=1e-12)
    near = Rig(Camera(10.0, SHAPE), (Led("white", position_mm=(1.0, 2.0, 3.0), aim=(0.0, -1.0, -1.0)),))
    (led,) = rig_of_frame(near, "right-down").leds
    assert (led.position_mm, led.aim) == ((1.0, -2.0, 3.0), (0.0, 1.0, -1.0))


def test_an_unknown_frame_is_refused():
    with pytest.raises(BadInput, match="must be one of right-up, right-down"):
        rig_of_frame(Rig(Camera(10.0, SHAPE), (Led("white", direction=(0.0, 0.0, 1.0)),)), "up")


def test_a_flat_plate_is_no_alarm():
    normals = np.zeros((*SHAPE, 3), dtype=np.float32)
    normals[..., 2] = 1.0
    assert fit_light_frame(normals, np.ones(SHAPE, dtype=bool)).frame == "right-up"
    normals[..., :2] = 0.05 * np.random.default_rng(0).standard_normal((*SHAPE, 2))
    assert fit_light_frame(normals, np.ones(SHAPE, dtype=bool)).frame == "right-up"


def test_a_reconstruction_warns_and_names_the_frame(egg):
    normals, inside = egg
    angles = 2.0 * np.pi * np.arange(6) / 6.0
    lights = np.stack([0.4 * np.cos(angles), 0.4 * np.sin(angles), np.full(6, 0.9)], axis=1)
    light = np.where(inside, np.clip(normals @ lights.T, 0.0, None).transpose(2, 0, 1), 0.0)
    pixels = np.round(200.0 * light).astype(np.uint8)[..., None]
    band = Band("white", pixels, tuple((k,) for k in range(6)), np.ones(6), np.zeros(6))
    rig = Rig(Camera(10.0, SHAPE), tuple(Led("white", direction=tuple(v)) for v in in_frame(lights, "right-down")))
    capture = Capture(rig, {"white": band}, material="opaque", mask=inside)
    warned = [text for text in reconstruct(capture, "ea").warnings if "--light-frame" in text]
    assert len(warned) == 1
    assert "--light-frame right-down" in warned[0]
    mended = replace(capture, rig=rig_of_frame(rig, "right-down"))
    assert not [text for text in reconstruct(mended, "ea").warnings if "--light-frame" in text]
