"""The shape's grid: lights at a surface, integration, and one comparison of prediction and
images."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skin_scene import ALBEDO, COLOURS, fresnel, make_scene
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.imaging.pixels import bin_mean
from splitknit.skin.diffusion import SkinSettings, diffusion
from splitknit.skin.grid import BandImages, coarsen
from splitknit.skin.light import lighting
from splitknit.skin.shape import integrate, residual_of

FACTOR = 3
GLARE = 0.4
SKIN = SkinSettings()
OPTICS = {n: diffusion(SKIN.scattering(n), SKIN.absorption(n)) for n in (*COLOURS, "nir")}


def normals_of(height, grid):
    slopes = height_gradients(np.where(grid.mask, height, np.float32(np.nan)), grid.pitch_mm)
    return normals_from_gradients(*slopes) * grid.mask[..., None]


class Coarse:
    """A scene on the coarse grid, with its true height."""

    def __init__(self, scene):
        self.grid = coarsen(scene.grid, FACTOR)
        rows, columns = self.grid.shape
        part = np.s_[..., : rows * FACTOR, : columns * FACTOR]
        self.white, self.nir = (
            BandImages(b.channels, bin_mean(b.stack[part], FACTOR) * self.grid.mask, b.rig)
            for b in (scene.white, scene.nir)
        )
        height = bin_mean(scene.shape_mm[part].astype(np.float32), FACTOR)
        self.height = (height - height[self.grid.mask].mean() + 1.0).astype(
            np.float32
        ) * self.grid.mask
        # images are relative to the irradiance 140 mm away, light vectors to that at the origin
        self.at_origin = (
            np.mean([led.intensity for led in self.white.rig.leds]) * (140 / 149.52) ** 2
        )

    @property
    def grey(self):
        return BandImages(("green",), self.white.stack[1:2], self.white.rig)

    def compare(self, bands):
        return residual_of(bands, self.grid, self.height, OPTICS)


@pytest.fixture(scope="module")
def matt():
    return Coarse(make_scene(0.0, depth=0.0))


@pytest.fixture(scope="module")
def glossy():
    return Coarse(make_scene(GLARE, depth=0.0))


def test_lights_at_the_surface_are_near_and_enter_by_fresnel(matt):
    rig, grid = matt.white.rig, matt.grid
    normals = normals_of(matt.height, grid)
    light = lighting(rig, grid, matt.height, normals)
    at_origin = np.mean([led.intensity / 149.52**2 for led in rig.leds])
    for row, column in ((40, 46), (25, 30), (60, 70)):
        point = np.array([grid.x_mm[column], grid.y_mm[row], matt.height[row, column]])
        for k, led in enumerate(rig.leds):
            towards = np.asarray(led.position_mm) - point
            distance = np.linalg.norm(towards)
            vector = towards / distance * led.intensity / distance**2 / at_origin
            assert_allclose(light.vectors[k, :, row, column], vector, rtol=2e-3, atol=1e-3)
            cosine = towards @ normals[row, column] / distance
            enters = (1 - fresnel(cosine)) / (1 - fresnel(np.float64(1.0)))
            assert light.entering[k, row, column] == pytest.approx(enters, abs=2e-3)


def test_trust_falls_to_zero_at_grazing_light_and_outside_the_mask(matt):
    grid = matt.grid
    slanted = np.zeros((*grid.shape, 3), dtype=np.float32)
    angles = np.linspace(0, np.pi / 2, grid.shape[1]).astype(np.float32)
    slanted[..., 0], slanted[..., 2] = np.sin(angles), np.cos(angles)
    light = lighting(matt.white.rig, grid, matt.height, slanted)
    assert not light.trust[:, ~grid.mask].any()
    row = grid.shape[0] // 2
    first, last = np.flatnonzero(grid.mask[row])[[0, -1]]
    opposite = int(np.argmin([led.position_mm[0] for led in matt.white.rig.leds]))
    assert light.trust[opposite, row, first] > 0.99
    assert light.trust[opposite, row, last] < 0.01
    cosine = np.einsum("lihw,hwi->lhw", light.vectors, slanted) / np.linalg.norm(
        light.vectors, axis=1
    )
    half = (cosine > 0.12) & (cosine < 0.13) & grid.mask
    assert half.any()
    assert (np.abs(light.trust[half] - 0.5) < 0.04).all()
    assert (light.trust >= 0).all()
    assert (light.trust <= 1.001).all()


def test_lights_along_rays_are_in_the_frame_of_each_pixel(matt):
    rig, grid, apex = matt.white.rig, matt.grid, 140.0
    height = np.full(grid.shape, 14.0, dtype=np.float32)
    light = lighting(rig, replace(grid, apex_mm=apex), height, normals_of(matt.height, grid))
    row, column = 10, 4  # off the axis
    x, y = float(grid.x_mm[column]), float(grid.y_mm[row])
    # distance from the camera's centre at which h = D log(D / r) is 14 mm
    far = apex * np.exp(-14.0 / apex)
    ray = np.array([x, y, -apex]) / np.linalg.norm([x, y, apex])
    point = np.array([0, 0, apex]) + far * ray
    scale = np.mean(
        [
            np.linalg.norm(led.intensity * 1e4 / np.dot(led.position_mm, led.position_mm))
            for led in rig.leds
        ]
    )
    for k, led in enumerate(rig.leds):
        towards = np.asarray(led.position_mm) - point
        expected = led.intensity * 1e4 * towards / np.linalg.norm(towards) ** 3 / scale
        seen = light.vectors[k, :, row, column]
        assert_allclose(np.linalg.norm(seen), np.linalg.norm(expected), rtol=1e-4)
        # z is towards the camera
        assert_allclose(seen[2], -np.dot(ray, expected), rtol=1e-4)


def test_integrated_slopes_give_the_height_with_mean_zero(matt):
    grid = matt.grid
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    height = 0.1 * x - 0.03 * y * y + 0.02 * x * y
    slopes = (0.1 + 0.02 * y, -0.06 * y + 0.02 * x)
    integrated = integrate(
        *(s.astype(np.float32) for s in slopes), grid, np.ones(grid.shape, np.float32)
    )
    assert_allclose(
        integrated[grid.mask], (height - height[grid.mask].mean())[grid.mask], atol=2e-3
    )
    assert integrated[grid.mask].mean() == pytest.approx(0, abs=1e-4)
    assert not integrated[~grid.mask].any()


def test_brightness_follows_the_albedo(matt):
    step = matt.compare((matt.white, matt.nir))
    assert set(step.brightness) == {*COLOURS, "nir"}
    for name in ("green", "blue"):
        assert step.brightness[name] / step.brightness["red"] == pytest.approx(
            ALBEDO[name] / ALBEDO["red"], rel=0.01
        )
    assert step.brightness["red"] == pytest.approx(ALBEDO["red"] * matt.at_origin, rel=0.02)


@pytest.mark.parametrize("bands", ["white", "nir", "grey", "white and nir"])
def test_specular_reflection_of_a_smooth_dome_is_estimated(glossy, bands):
    chosen = {
        "white": (glossy.white,),
        "nir": (glossy.nir,),
        "grey": (glossy.grey,),
        "white and nir": (glossy.white, glossy.nir),
    }[bands]
    step, first = glossy.compare(chosen), chosen[0].channels[0]
    assert set(step.glare) == {band.channels[-1] for band in chosen}
    for strength in step.glare.values():
        assert strength == pytest.approx(GLARE * np.pi * glossy.at_origin, rel=0.1)
    assert step.brightness[first] == pytest.approx(ALBEDO[first] * glossy.at_origin, rel=0.02)


def test_matt_skin_has_little_specular_reflection(matt, glossy):
    for bands in ((matt.white,), (matt.nir,)):
        strength, *_ = matt.compare(bands).glare.values()
        assert strength < 0.4
    assert (
        matt.compare((matt.white,)).glare["blue"]
        < 0.3 * glossy.compare((glossy.white,)).glare["blue"]
    )
