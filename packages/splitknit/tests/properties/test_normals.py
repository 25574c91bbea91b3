"""Photometric stereo: what must hold whatever the scene."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from splitknit.model import Camera, Led, Rig
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.near_light import near_light
from splitknit.photometric.robust import robust

quick = settings(max_examples=20, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def scene(seed, count=8, shape=(9, 11)):
    """A noisy stack with shadows under random lights that span a cone."""
    rng = np.random.default_rng(seed)
    azimuth = 2 * np.pi * (np.arange(count) + rng.uniform(0, 0.5, count)) / count
    elevation = rng.uniform(0.6, 1.2, count)
    lights = np.column_stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    lights *= rng.uniform(0.5, 1.5, (count, 1))
    normals = np.dstack([rng.normal(0, 0.4, (*shape, 2)), np.ones(shape)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    stack = np.clip(np.einsum("hwi,li->lhw", normals, lights), 0, None) * rng.uniform(
        0.3, 0.9, shape
    )
    return np.clip(stack + rng.normal(0, 0.002, stack.shape), 0, None).astype(np.float32), lights


def close(a, b, tolerance=2e-3):
    """Same normals and albedo, up to rounding."""
    assert np.abs(a[0] - b[0]).max() < tolerance
    assert np.abs(a[1] - b[1]).max() < tolerance * max(1.0, float(np.abs(a[1]).max()))


def near_rig(lights, shape):
    """LEDs along the lights, some 100 mm away and above the surface."""
    leds = tuple(
        Led(
            "white",
            position_mm=tuple(100 * v / np.linalg.norm(v)),
            intensity=float(np.linalg.norm(v)),
        )
        for v in lights
    )
    return Rig(Camera(4.0, shape), leds)


@quick
@given(seeds)
def test_order_of_the_lights_does_not_matter(seed):
    stack, lights = scene(seed)
    order = np.random.default_rng(seed + 1).permutation(len(lights))
    for method in (lambertian, robust):
        close(method(stack, lights), method(stack[order], lights[order]))
    shape = stack.shape[1:]
    close(
        near_light(stack, near_rig(lights, shape), 1.0),
        near_light(stack[order], near_rig(lights[order], shape), 1.0),
    )


@quick
@given(seeds, st.sampled_from([0.125, 0.5, 8.0, 1024.0]))
def test_brighter_images_scale_the_albedo_alone(seed, scale):
    stack, lights = scene(seed)
    for method in (lambertian, robust):
        normals, albedo = method(stack * np.float32(scale), lights)
        close(method(stack, lights), (normals, albedo / scale))


@quick
@given(seeds, st.floats(-np.pi, np.pi))
def test_turning_the_lights_turns_the_normals(seed, angle):
    stack, lights = scene(seed)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    for method in (lambertian, robust):
        normals, albedo = method(stack, lights)
        close((normals @ turn.T, albedo), method(stack, lights @ turn.T), 5e-3)


@quick
@given(seeds)
def test_each_pixel_is_solved_independently(seed):
    stack, lights = scene(seed)
    order = np.random.default_rng(seed).permutation(stack.shape[1])
    for method in (lambertian, robust):
        normals, albedo = method(stack, lights)
        shuffled, shuffled_albedo = method(stack[:, order], lights)
        assert np.array_equal(shuffled, normals[order])
        assert np.array_equal(shuffled_albedo, albedo[order])


@quick
@given(seeds)
def test_normals_have_unit_length(seed):
    stack, lights = scene(seed)
    for method in (lambertian, robust):
        assert np.allclose(np.linalg.norm(method(stack, lights)[0], axis=2), 1, atol=1e-5)
