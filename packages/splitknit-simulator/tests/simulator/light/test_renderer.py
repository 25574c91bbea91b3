"""Light through and off the skin."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from refusals import bad_input
from script_folder import VALIDATION, scripts_of
from splitknit.model import Camera, Led
from splitknit.nominal import default_rig
from splitknit_simulator.light.renderer import RenderSettings, render_ambient, render_band
from splitknit_simulator.light.skin import (
    CHANNELS,
    Boundary,
    Medium,
    SkinOptics,
    diffuse_transmittance,
    diffusion_profile,
    fresnel,
)
from splitknit_simulator.surface import SimulatedSurface, Texture
from surfaces import plane, ridged_egg

OVERHEAD = Led("white", position_mm=(0.0, 0.0, 1e5), intensity=1e6)
CONTRAST = {
    "red": (0.013, 0.039),
    "green": (0.034, 0.067),
    "blue": (0.052, 0.087),
    "nir": (0.007, 0.033),
}
"""Local standard deviation over mean, volume only and with glare (measurements.md)."""


@pytest.fixture(scope="module")
def egg():
    return ridged_egg()


def _all_channels():
    return [SkinOptics().channel(c) for c in CHANNELS]


def test_flat_even_skin_reflects_its_albedo():
    """Energy: under even light from above, radiance = T(0) T(0) E albedo / (pi T diffuse)."""
    optics = _all_channels()
    image = render_band(plane(), [OVERHEAD], Medium(optics, 0.25, 0.0))
    passed = 1.0 - float(fresnel(np.array(1.0)))
    for c, medium in enumerate(optics):
        albedo = diffusion_profile(medium.scattering_per_mm, medium.absorption_per_mm).albedo
        expected = passed**2 * 1.0 * albedo / (np.pi * diffuse_transmittance())
        assert_allclose(image.diffuse[0, c], expected, rtol=0.005)


@pytest.mark.slow
def test_ridge_contrast_follows_the_measurements(egg):
    """Relative contrast of 75 um ridges over the same finger without them, within what the boundary
    model allows."""
    leds = default_rig().leds[:7]
    smooth = ridged_egg(depth_um=0.0)
    with_ridges, without = (
        render_band(surface, leds, Medium(_all_channels(), 0.25, 1.0)) for surface in (egg, smooth)
    )
    flat = egg.shape_normals[with_ridges.window][..., 2] > 0.8

    def contrast(light, base):
        ratio = np.where(base > 0.05 * base.max(), light / np.maximum(base, 1e-9), 1.0)
        return float(
            (ratio - cv2.GaussianBlur(ratio, (0, 0), 0.32 * egg.camera.px_per_mm))[flat].std()
        )

    inside, outside = {}, {}
    for c, channel in enumerate(CHANNELS):
        light, base = with_ridges.diffuse[:, c], without.diffuse[:, c]
        volume, glossy = CONTRAST[channel]
        inside[channel] = np.mean([contrast(light[k], base[k]) for k in range(7)])
        outside[channel] = np.mean(
            [
                contrast(light[k] + with_ridges.glare[k], base[k] + without.glare[k])
                for k in range(7)
            ]
        )
        assert volume / 1.6 < inside[channel] < volume * 1.6
        assert glossy / 1.6 < outside[channel] < glossy * 1.6
    assert inside["blue"] > inside["green"] > inside["red"] > inside["nir"]
    assert outside["blue"] > outside["green"] > outside["red"] > outside["nir"]


def test_specular_reflection_of_a_plane_follows_the_microfacet_equation():
    """At normal incidence and view, D G F / (4 n.v) = F / (4 pi alpha^2)."""
    image = render_band(plane(), [OVERHEAD], Medium(_all_channels()[:1], 0.3, 1.0))
    expected = (0.42 / 2.42) ** 2 / (4 * np.pi * 0.3**2)
    assert_allclose(image.glare[0, 48, 64], expected, rtol=0.01)


def test_relief_term_brightens_ridges(egg):
    """Under even light from everywhere above, ridges are brighter than valleys by 1 + k h."""
    medium = SkinOptics().channel("blue")
    with_term = render_ambient(egg, 1.0, Medium([medium], 0.25))
    without = render_ambient(egg, 1.0, Medium([replace(medium, relief_gain_per_um=0.0)], 0.25))
    inside = with_term[0] > 0
    ratio = (with_term[0][inside] / without[0][inside]) - 1.0
    relief = egg.relief_um[40:-40, 40:-40]
    assert ratio.std() == pytest.approx(
        medium.relief_gain_per_um * relief[relief < 0].std(), rel=0.35
    )
    assert np.corrcoef(ratio, egg.relief_um[14:-14, 16:-16][inside])[0, 1] > 0.8
    assert with_term.max() < 1.2


def test_an_empty_mask_and_zero_workers_are_refused():
    empty = replace(plane(), mask=np.zeros((96, 128), dtype=np.bool_))
    with bad_input("outside the picture"):
        render_band(empty, [OVERHEAD], Medium(_all_channels(), 0.25, 1.0))
    with bad_input("workers"):
        RenderSettings(workers=0)


def _wave(slope, height=0.02, size=240, pitch_mm=0.0264):
    """A plane that is tilted about y by its slope along x, with a wave of `height` (mm) every 0.45
    mm across x."""
    x = (np.arange(size) - size / 2) * pitch_mm
    period = 0.45
    relief = height * np.sin(2 * np.pi * x / period)
    gradient = slope + height * 2 * np.pi / period * np.cos(2 * np.pi * x / period)

    def normals(gx):
        n = np.stack([-gx, 0 * gx, np.ones_like(gx)], axis=-1) / np.sqrt(1 + gx * gx)[..., None]
        return np.broadcast_to(n, (size, size, 3)).astype(np.float32).copy()

    def full(row):
        return np.broadcast_to(row, (size, size)).astype(np.float32).copy()

    return SimulatedSurface(
        camera=Camera(1 / pitch_mm, (size, size)),
        height_mm=full(slope * x + relief),
        shape_mm=full(slope * x),
        normals=normals(gradient),
        shape_normals=normals(np.full(size, slope)),
        relief_um=full(0 * x),
        mask=np.ones((size, size), dtype=bool),
        pigment=full(np.ones(size)),
    )


def _diffuse(surface, led, boundary):
    media = [replace(optics, relief_gain_per_um=0.0) for optics in _all_channels()[:3]]
    settings = RenderSettings(rim_exponent=0.0, reach_mm=1.0)
    image = render_band(surface, [led], Medium(media, 0.25, 0.0, boundary), settings)
    return image.diffuse[0][:, 60:-60, 60:-60]


@pytest.mark.parametrize("slope", [0.8, 1.5])
def test_ridges_lower_the_contrast_of_a_slope_only_if_blurred(slope):
    """As much light enters and leaves a ridged slope as a smooth one: facets that look small are
    large."""
    leds = [Led("white", direction=(side, 0.0, 0.95)) for side in (-0.3, 0.3)]
    ridged = _wave(slope)
    smooth = replace(ridged, normals=ridged.shape_normals, height_mm=ridged.shape_mm)

    def contrast(surface, blurred):
        boundary = Boundary(blurred=blurred, entry_power=0.0)
        near, far = (float(_diffuse(surface, led, boundary).mean()) for led in leds)
        return (near - far) / (near + far)

    assert contrast(ridged, False) == pytest.approx(contrast(smooth, False), rel=0.005)
    assert contrast(ridged, True) < 0.99 * contrast(smooth, True)


def test_refracted_light_reverses_the_shading_of_slopes():
    """Behind a smooth boundary red light is brighter on the far flank, blue light on neither."""
    led = Led("white", direction=(0.3, 0.0, 0.95))
    wave, flat = _wave(0.0), _wave(0.0, height=1e-6)
    shading = wave.normals[0, 60:-60, 0]

    def signal(boundary):
        rows = (_diffuse(wave, led, boundary) / _diffuse(flat, led, boundary))[:, 60]
        return np.array([np.polyfit(shading, row / row.mean(), 1)[0] for row in rows])

    matt, smooth = (signal(Boundary(refraction=r, entry_power=0.0)) for r in (0.0, 1.0))
    assert (matt > 0).all()
    assert_allclose(smooth / matt, [-1.3, -0.65, 0.0], atol=0.05)


def test_texture_changes_single_colours_and_gloss_single_places():
    wave = _wave(0.0)
    blood = np.zeros_like(wave.height_mm)
    blood[:, 120:] = 0.1
    gloss = np.ones_like(blood)
    gloss[120:] = 0.0
    grain = np.ones((4, *blood.shape), dtype=np.float32)
    grain[1, :, :60] = 1.2
    marked = replace(wave, texture=Texture(gloss=gloss, blood=blood, grain=grain))
    plain, textured = (
        render_band(s, [OVERHEAD], Medium(_all_channels()[:3], 0.3, 1.0)) for s in (wave, marked)
    )
    assert_allclose(textured.glare, plain.glare * gloss, rtol=1e-5)
    ratio = (textured.diffuse / plain.diffuse)[0, :, 0, :]
    assert_allclose(ratio[:, 60:120], 1.0, rtol=1e-5)
    assert_allclose(ratio[:, 30], [1.0, 1.2, 1.0], rtol=1e-5)
    assert_allclose(-np.log(ratio[:, 130]), [0.015, 0.1, 0.08], rtol=1e-3)


@pytest.mark.slow
def test_light_on_the_far_side_of_a_cylinder_agrees_with_random_walks():
    """On the side away from the LED, where a blurred image has a third too much; the walks share no
    code with it."""
    with scripts_of(VALIDATION / "twin") as script:
        volume = script("volume")
        optics = SkinOptics().channel("red")
        led = Led("white", position_mm=volume.LIGHTS[0])
        settings = RenderSettings(reach_mm=20.0)

        def at(boundary):
            image = render_band(
                volume.cylinder(), [led], Medium([optics], 0.25, 0.0, boundary), settings
            )
            x = (np.arange(*image.window[1].indices(221)[:2]) - 110.0) / 10.0
            dark, top = np.interp([-7.4, 0.0], x, image.diffuse[0, 0, 100])
            return dark / top

        rng = np.random.default_rng(0)
        dark, top = (
            volume.volume_radiance(x, optics.scattering_per_mm, optics.absorption_per_mm, rng)[0]
            for x in (-7.4, 0.0)
        )
    assert at(Boundary()) == pytest.approx(dark / top, rel=0.08)
    assert at(Boundary(blurred=True)) > 1.2 * dark / top
