"""Photometric stereo without each image in its turn is photometric stereo of the others."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.photometric.lambertian import lambertian, left_out


def around(count: int) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([0.35 * np.cos(angle), 0.35 * np.sin(angle), 0.9 + 0.05 * np.arange(count) / count], axis=1)


@pytest.mark.parametrize("count", [4, 7])
def test_each_set_is_solved_as_if_it_were_alone(count: int) -> None:
    rng = np.random.default_rng(count)
    stack = rng.uniform(0.05, 1.0, (count, 13, 17)).astype(np.float32)
    mask = rng.uniform(size=(13, 17)) < 0.8
    lights = around(count)
    found = list(left_out(stack, lights, mask))
    assert len(found) == count
    for k, (normals, albedo) in enumerate(found):
        others = [j for j in range(count) if j != k]
        expected, strength = lambertian(stack[others], lights[others], mask)
        np.testing.assert_allclose(normals, expected, atol=2e-4)
        np.testing.assert_allclose(albedo, strength, rtol=2e-4)
        assert normals.dtype == albedo.dtype == np.float32


def test_an_image_that_lies_is_missed_by_its_own_set_alone() -> None:
    truth = np.array([0.2, -0.1, 0.97])
    truth /= np.linalg.norm(truth)
    lights = around(7)
    stack = np.tile((0.6 * lights @ truth)[:, None, None], (1, 3, 3)).astype(np.float32)
    stack[4] += 0.3
    errors = [float(np.arccos(np.clip(normals[1, 1] @ truth, -1, 1))) for normals, _ in left_out(stack, lights)]
    assert errors[4] < 1e-3
    assert min(error for k, error in enumerate(errors) if k != 4) > 0.02


def test_too_few_lights_are_refused() -> None:
    with pytest.raises(BadInput, match="4"):
        next(left_out(np.ones((3, 4, 4), np.float32), around(3)))
    plane = np.array([[-0.5, 0, 0.8], [0.5, 0, 0.8], [0, 0, 1.0], [0.2, 0.6, 0.7]])
    with pytest.raises(BadInput, match="without image 3 the lights lie in one plane"):
        next(left_out(np.ones((4, 4, 4), np.float32), plane))
