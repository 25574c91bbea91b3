"""Least squares over all lights."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.photometric.equations import conditioning, moment_matrix, solve
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.robust import robust


def ring(count=7, elevation_deg=55.0):
    azimuth, elevation = 2 * np.pi * np.arange(count) / count, np.deg2rad(elevation_deg)
    return np.column_stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.full(count, np.sin(elevation)),
        ]
    )


def gentle(rows=40, columns=50):
    """Normals within 25 deg of the camera, and an albedo: no light of the ring is ever shadowed."""
    i, j = np.mgrid[0:rows, 0:columns]
    normals = np.dstack([0.3 * np.sin(j / 7), 0.3 * np.cos(i / 9), np.ones((rows, columns))])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return normals, 0.5 + 0.2 * np.sin(i / 5 + j / 8)


def test_exact_on_a_matt_surface():
    normals, albedo = gentle()
    lights = ring() * np.linspace(0.5, 1.5, 7)[:, None]
    got, got_albedo = lambertian(np.einsum("hwi,li,hw->lhw", normals, lights, albedo), lights)
    assert np.abs(got - normals).max() < 1e-5
    assert np.abs(got_albedo - albedo).max() < 1e-5
    assert got.dtype == got_albedo.dtype == np.float32


def test_three_lights_suffice():
    normals, albedo = gentle()
    lights = ring(3)
    got, _ = lambertian(np.einsum("hwi,li,hw->lhw", normals, lights, albedo), lights)
    assert np.abs(got - normals).max() < 1e-5


def test_equals_the_pseudo_inverse_on_any_stack():
    rng = np.random.default_rng(0)
    stack, lights = rng.random((5, 300, 123)).astype(np.float32), ring(5)
    got, albedo = lambertian(stack, lights)
    g = np.einsum("il,lhw->hwi", np.linalg.pinv(lights), stack)
    assert np.allclose(albedo, np.linalg.norm(g, axis=2), rtol=1e-4)
    assert np.allclose(got * albedo[..., None], g, atol=1e-4)


@pytest.mark.parametrize("method", [lambertian, robust])
def test_outside_the_mask(method):
    normals, albedo = gentle()
    mask = np.zeros(albedo.shape, dtype=bool)
    mask[10:20, 5:9] = True
    stack = np.einsum("hwi,li,hw->lhw", normals, ring(), albedo)
    got, got_albedo = method(stack, ring(), mask)
    assert not got[~mask].any()
    assert np.isnan(got_albedo[~mask]).all()
    assert np.abs(got - normals)[mask].max() < 1e-5


def test_black_pixels_face_the_camera():
    got, albedo = lambertian(np.zeros((4, 3, 3)), ring(4))
    assert (got == [0, 0, 1]).all()
    assert (albedo == 0).all()


@pytest.mark.parametrize("strength", [0.01, 1.0, 100.0])
def test_conditioning_depends_on_directions_and_not_on_strengths(strength):
    """The lights of the second pixel lie near one plane."""
    wide, near = [[1, 0, 0], [0, 1, 0], [0, 1, 1]], [[1, 0, 1], [-1, 0, 1], [0, 0.01, 1]]
    moments = moment_matrix(strength * np.stack([wide, near], axis=-1), None)
    assert conditioning(moments) == pytest.approx([1 / 4, 2e-4 / 3 / 5], rel=1e-2)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_light_alone_is_solved_along_its_axis(axis):
    light = np.eye(3)[axis]
    got = solve(np.full((1, 1), 0.7), light[None], None)
    assert np.abs(got[:, 0] - 0.7 * light).max() < 1e-6


@pytest.mark.parametrize(
    ("stack", "lights", "message"),
    [
        (np.ones((7, 4, 4)), ring(6), "6 lights for 7 images"),
        (np.ones((2, 4, 4)), ring(3)[:2], "stack must hold at least 3"),
        (np.ones((3, 4, 4)), np.array([[1, 0, 1], [0, 0, 1], [-1, 0, 1.0]]), "coplanar"),
        (np.ones((4, 4, 4)), ring(4)[[0, 1, 2, 2]], "same direction"),
        (np.full((3, 4, 4), np.nan), ring(3), "NaN"),
        (np.ones((3, 4, 4)), ring(3) * [1, np.nan, 1], "NaN"),
    ],
)
def test_bad_input_is_refused(stack, lights, message):
    with pytest.raises(BadInput, match=message):
        lambertian(stack, lights)
