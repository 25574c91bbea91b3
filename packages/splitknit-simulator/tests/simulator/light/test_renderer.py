"""Light through and off the skin."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.errors import BadInput
from splitknit.model import Camera, Led, default_rig
from splitknit_simulator.camera.lens import blur_sigma_px, defocus
from splitknit_simulator.light.lighting import cut_out, white_card
from splitknit_simulator.light.renderer import RenderSettings, SubsurfaceScattering, _Sheet, render_ambient, render_band
from splitknit_simulator.light.skin import (
    CHANNELS,
    Boundary,
    ChannelOptics,
    Medium,
    SkinOptics,
    diffuse_transmittance,
    diffusion_profile,
    fresnel,
)
from splitknit_simulator.surface import SimulatedSurface, Texture
from surfaces import plane, ridged_egg

OVERHEAD = Led("white", position_mm=(0.0, 0.0, 1e5), intensity=1e6)
CONTRAST = {"red": (0.013, 0.039), "green": (0.034, 0.067), "blue": (0.052, 0.087), "nir": (0.007, 0.033)}
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
        np.testing.assert_allclose(image.diffuse[0, c], expected, rtol=0.005)


def test_dense_scattering_gives_lambert(egg):
    """Where light leaves where it entered, the picture is the irradiance times the Fresnel transmittances."""
    dense = ChannelOptics(scattering_per_mm=3000.0, absorption_per_mm=60.0, relief_gain_per_um=0.0)
    led = default_rig().leds[0]
    image = render_band(egg, [led], Medium([dense], 0.25, 0.0))
    rows, columns = image.window
    n = egg.normals[rows, columns]
    x = ((np.arange(480) - 239.5) * egg.camera.pitch_mm)[None, columns]
    y = ((274.5 - np.arange(550)) * egg.camera.pitch_mm)[rows, None]
    z = np.nan_to_num(egg.height_mm[rows, columns])
    to = np.stack(np.broadcast_arrays(led.position_mm[0] - x, led.position_mm[1] - y, led.position_mm[2] - z), -1)
    squared = np.sum(to**2, -1)
    cosine = np.maximum(np.sum(to * n, -1) / np.sqrt(squared), 0)
    irradiance = 1e4 * cosine / squared * (1 - fresnel(cosine)) * (1 - fresnel(n[..., 2]))
    albedo = diffusion_profile(3000.0, 60.0).albedo
    expected = irradiance * albedo / (np.pi * diffuse_transmittance())
    inner = cv2.erode(egg.mask[image.window].astype(np.uint8), np.ones((9, 9))) > 0
    error = np.abs(image.diffuse[0, 0] - expected)[inner]
    assert error.mean() < 0.004 * expected[inner].mean()


def test_ridge_contrast_follows_the_measurements(egg):
    """Relative contrast of 75 um ridges over the same finger without them, within what the boundary model allows."""
    leds = default_rig().leds[:7]
    smooth = ridged_egg(depth_um=0.0)
    with_ridges, without = (render_band(one, leds, Medium(_all_channels(), 0.25, 1.0)) for one in (egg, smooth))
    flat = egg.shape_normals[with_ridges.window][..., 2] > 0.8

    def contrast(light, base):
        ratio = np.where(base > 0.05 * base.max(), light / np.maximum(base, 1e-9), 1.0)
        return float((ratio - cv2.GaussianBlur(ratio, (0, 0), 0.32 * egg.camera.px_per_mm))[flat].std())

    inside, outside = {}, {}
    for c, channel in enumerate(CHANNELS):
        light, base = with_ridges.diffuse[:, c], without.diffuse[:, c]
        volume, glossy = CONTRAST[channel]
        inside[channel] = np.mean([contrast(light[k], base[k]) for k in range(7)])
        outside[channel] = np.mean(
            [contrast(light[k] + with_ridges.glare[k], base[k] + without.glare[k]) for k in range(7)]
        )
        assert volume / 1.6 < inside[channel] < volume * 1.6
        assert glossy / 1.6 < outside[channel] < glossy * 1.6
    assert inside["blue"] > inside["green"] > inside["red"] > inside["nir"]
    assert outside["blue"] > outside["green"] > outside["red"] > outside["nir"]


def test_glare_is_positive_white_and_moves_with_the_light(egg):
    rig = default_rig()
    image = render_band(egg, [rig.leds[0], rig.leds[3]], Medium(_all_channels()[:1], 0.2, 1.0))
    assert image.glare.min() == 0.0
    assert image.glare.max() > 0.1 * image.diffuse.max()
    smooth = [cv2.GaussianBlur(g, (0, 0), 15) for g in image.glare]
    columns = np.arange(smooth[0].shape[1])
    centre = [float((s.sum(axis=0) * columns).sum() / s.sum()) for s in smooth]
    assert centre[0] > centre[1] + 20  # LED 0 is on the right, LED 3 on the left
    none = render_band(egg, [rig.leds[0]], Medium(_all_channels()[:1], 0.2, 0.0))
    assert not none.glare.any()
    np.testing.assert_array_equal(none.diffuse[0], image.diffuse[0])


def test_glare_of_a_mirror_like_plane_obeys_the_microfacet_equation():
    """At normal incidence and view, D G F / (4 n.v) = F / (4 pi alpha^2)."""
    image = render_band(plane(), [OVERHEAD], Medium(_all_channels()[:1], 0.3, 1.0))
    expected = (0.42 / 2.42) ** 2 / (4 * np.pi * 0.3**2)
    np.testing.assert_allclose(image.glare[0, 48, 64], expected, rtol=0.01)


def test_several_leds_in_one_exposure_add(egg):
    rig = default_rig(seed=1)
    both = replace(rig.leds[0], also=(rig.leds[2],))
    optics = _all_channels()[:1]
    image = render_band(egg, [rig.leds[0], rig.leds[2], both], Medium(optics, 0.25, 1.0))
    np.testing.assert_allclose(image.diffuse[2], image.diffuse[0] + image.diffuse[1], rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(image.glare[2], image.glare[0] + image.glare[1], rtol=1e-5, atol=1e-9)


def test_near_light_falls_with_distance_and_lobe():
    near = Led("white", position_mm=(0.0, 0.0, 50.0))
    far = Led("white", position_mm=(0.0, 0.0, 100.0))
    camera = Camera(10.0, (64, 64))
    assert white_card(camera, near)[32, 32] == pytest.approx(4 * white_card(camera, far)[32, 32], rel=1e-3)
    assert white_card(camera, far)[32, 32] == pytest.approx(1 / np.pi, rel=1e-3)
    lobed = white_card(camera, replace(near, lobe_exponent=20.0))
    assert lobed[0, 0] < white_card(camera, near)[0, 0]
    distant = Led("white", direction=(0.0, 0.6, 0.8))
    np.testing.assert_allclose(white_card(camera, distant), 0.8 / np.pi, rtol=1e-6)


def test_relief_term_brightens_ridges(egg):
    """Under even light from everywhere above, ridges are brighter than valleys by 1 + k h."""
    medium = SkinOptics().channel("blue")
    with_term = render_ambient(egg, 1.0, Medium([medium], 0.25))
    without = render_ambient(egg, 1.0, Medium([replace(medium, relief_gain_per_um=0.0)], 0.25))
    inside = with_term[0] > 0
    ratio = (with_term[0][inside] / without[0][inside]) - 1.0
    relief = egg.relief_um[40:-40, 40:-40]
    assert ratio.std() == pytest.approx(medium.relief_gain_per_um * relief[relief < 0].std(), rel=0.35)
    assert np.corrcoef(ratio, egg.relief_um[14:-14, 16:-16][inside])[0, 1] > 0.8
    assert with_term.max() < 1.2


def test_skin_goes_on_beyond_the_picture():
    """A finger that the picture cuts is not darker at the cut."""
    surface = plane((96, 128))
    mask = surface.mask.copy()
    mask[:, :40] = mask[:, 88:] = False
    image = render_band(replace(surface, mask=mask), [OVERHEAD], Medium([SkinOptics().channel("nir")], 0.25, 0))
    column = image.diffuse[0, 0][:, image.diffuse.shape[3] // 2]
    assert column[0] == pytest.approx(column[48], rel=0.02)


def test_workers_do_not_change_the_bytes(egg):
    leds = default_rig().leds[:3]
    one, three = (render_band(egg, leds, Medium(_all_channels(), 0.25, 1.0), RenderSettings(workers=w)) for w in (1, 3))
    assert one.diffuse.tobytes() == three.diffuse.tobytes()
    assert one.glare.tobytes() == three.glare.tobytes()


def test_defocus_keeps_the_plane_in_focus_and_the_light():
    rng = np.random.default_rng(0)
    image = rng.random((60, 60, 3), dtype=np.float32)
    assert defocus(image, np.zeros((60, 60), np.float32)) is image
    depth = np.linspace(5, -5, 60, dtype=np.float32)[:, None].repeat(60, axis=1)
    sigma = blur_sigma_px(depth, 5.0, 140.0, 5.5, 40.0)
    assert sigma[0].max() == 0.0
    # similar triangles: 10 mm below a plane at 135 mm, a pupil of 5.5 mm
    assert sigma[-1, 0] == pytest.approx(40.0 * 5.5 * 10 / 145 / 4, rel=1e-4)
    blurred = defocus(image, sigma)
    np.testing.assert_array_equal(blurred[0], image[0])
    spread = blurred.std(axis=(1, 2))
    assert spread[-1] < 0.25 * spread[0]
    even = defocus(image, np.full((60, 60), 2.0, np.float32))
    np.testing.assert_allclose(even, cv2.GaussianBlur(image, (0, 0), 2.0, borderType=cv2.BORDER_REPLICATE), atol=1e-5)


def test_a_finger_outside_the_picture_is_refused():
    empty = replace(plane(), mask=np.zeros((96, 128), dtype=np.bool_))
    with pytest.raises(BadInput, match="outside the picture"):
        render_band(empty, [OVERHEAD], Medium(_all_channels(), 0.25, 1.0))
    with pytest.raises(BadInput, match="workers"):
        RenderSettings(workers=0)


def _wave(slope: float, height: float = 0.02, size: int = 240, pitch_mm: float = 0.0264) -> SimulatedSurface:
    """A plane that is tilted about y by its slope along x, with a wave of `height` (mm) every 0.45 mm across x."""
    x = (np.arange(size) - size / 2) * pitch_mm
    period = 0.45
    relief = height * np.sin(2 * np.pi * x / period)
    gradient = slope + height * 2 * np.pi / period * np.cos(2 * np.pi * x / period)

    def normals(gx: np.ndarray) -> np.ndarray:
        n = np.stack([-gx, 0 * gx, np.ones_like(gx)], axis=-1) / np.sqrt(1 + gx * gx)[..., None]
        return np.broadcast_to(n, (size, size, 3)).astype(np.float32).copy()

    def full(row: np.ndarray) -> np.ndarray:
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


def _diffuse(surface: SimulatedSurface, led: Led, boundary: Boundary | None) -> np.ndarray:
    media = [replace(one, relief_gain_per_um=0.0) for one in _all_channels()[:3]]
    settings = RenderSettings(rim_exponent=0.0, reach_mm=1.0)
    image = render_band(surface, [led], Medium(media, 0.25, 0.0, boundary), settings)
    return image.diffuse[0][:, 60:-60, 60:-60]


@pytest.mark.parametrize("slope", [0.8, 1.5])
def test_ridges_flatten_a_slope_in_a_blurred_image_only(slope):
    """As much light enters and leaves a ridged slope as a smooth one: facets that look small are large."""
    leds = [Led("white", direction=(side, 0.0, 0.95)) for side in (-0.3, 0.3)]
    ridged = _wave(slope)
    smooth = replace(ridged, normals=ridged.shape_normals, height_mm=ridged.shape_mm)

    def contrast(surface: SimulatedSurface, blurred: bool) -> float:
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

    def signal(boundary: Boundary) -> np.ndarray:
        rows = (_diffuse(wave, led, boundary) / _diffuse(flat, led, boundary))[:, 60]
        return np.array([np.polyfit(shading, row / row.mean(), 1)[0] for row in rows])

    matt, smooth = (signal(Boundary(refraction=r, entry_power=0.0)) for r in (0.0, 1.0))
    assert (matt > 0).all()
    np.testing.assert_allclose(smooth / matt, [-1.3, -0.65, 0.0], atol=0.05)


def test_light_that_slants_along_the_ridges_brightens_their_heights():
    """By ln(1 / cos t) times 0.7 of the root of the attenuation (1/mm), beside what upright light shows."""
    x = _wave(0.0).height_mm[0] * 1e3
    wave = replace(_wave(0.0), relief_um=np.broadcast_to(x, (x.size, x.size)).astype(np.float32).copy())
    media = _all_channels()[:3]

    def heights(slant_deg: float) -> np.ndarray:
        angle = np.deg2rad(slant_deg)
        led = Led("white", direction=(0.0, float(np.sin(angle)), float(np.cos(angle))))
        image = render_band(wave, [led], Medium(media, 0.25, 0.0))
        rows = image.diffuse[0, :, 100, 40:-40]
        return np.array([np.polyfit(x[40:-40], row / row.mean(), 1)[0] for row in rows])

    added = heights(60) - heights(0)
    expected = [0.7e-3 * np.sqrt(one.attenuation_per_mm) * np.log(2) for one in media]
    np.testing.assert_allclose(added, expected, rtol=0.12)


def test_texture_is_seen_by_colour_and_gloss_by_place():
    wave = _wave(0.0)
    blood = np.zeros_like(wave.height_mm)
    blood[:, 120:] = 0.1
    gloss = np.ones_like(blood)
    gloss[120:] = 0.0
    grain = np.ones((4, *blood.shape), dtype=np.float32)
    grain[1, :, :60] = 1.2
    marked = replace(wave, texture=Texture(gloss=gloss, blood=blood, grain=grain))
    plain, other = (render_band(s, [OVERHEAD], Medium(_all_channels()[:3], 0.3, 1.0)) for s in (wave, marked))
    np.testing.assert_allclose(other.glare, plain.glare * gloss, rtol=1e-5)
    ratio = (other.diffuse / plain.diffuse)[0, :, 0, :]
    np.testing.assert_allclose(ratio[:, 60:120], 1.0, rtol=1e-5)
    np.testing.assert_allclose(ratio[:, 30], [1.0, 1.2, 1.0], rtol=1e-5)
    np.testing.assert_allclose(-np.log(ratio[:, 130]), [0.015, 0.1, 0.08], rtol=1e-3)


def _arch(size: int = 160, pitch_mm: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """x of the columns of a half cylinder of 4.5 mm radius, and the length of the skin from its top."""
    x = (np.arange(size) - size / 2) * pitch_mm
    return x, 4.5 * np.arcsin(x / 4.5)


def test_skin_is_laid_out_to_its_length_and_back():
    x, arc = _arch()
    slope = np.broadcast_to(-x / np.sqrt(4.5**2 - x**2), (90, x.size))
    mask = np.ones(slope.shape, dtype=bool)
    sheet = _Sheet(slope, np.zeros_like(slope), mask, np.s_[5:-5, 5:-5])
    assert abs(sheet.shape[1] * 0.05 - (arc[-1] - arc[0])) < 0.3 and sheet.shape[0] == 90
    field = np.broadcast_to(np.cos(2 * np.pi * arc / 0.8), mask.shape).astype(np.float32)
    flat = sheet.laid_out(field)[20]
    u = (np.arange(flat.size) - np.argmax(flat[flat.size // 2 - 4 : flat.size // 2 + 5]) - flat.size // 2 + 4) * 0.05
    np.testing.assert_allclose(flat[5:-5], np.cos(2 * np.pi * u / 0.8)[5:-5], atol=0.08)
    error = sheet.laid_back(sheet.laid_out(field)) - field[5:-5, 5:-5]
    assert np.abs(error).max() < 0.02 and error.std() < 0.006  # places are rounded to a 32nd of a pixel


def test_evenly_lit_skin_is_evenly_bright_whatever_its_ridges():
    egg = ridged_egg((240, 220), 16.0)
    patch = cut_out(egg)
    blur = SubsurfaceScattering(patch, Medium(_all_channels()[:3], 0.25), RenderSettings())
    for light, out in zip(blur.spread(blur.pad(patch.mask.astype(np.float32))), blur.out, strict=True):
        seen = light * out / ((1 - fresnel(np.sqrt(patch.nv**2 + 0.125**2 * (1 - patch.nv**2)))) + 1e-9)
        inner = cv2.erode(patch.mask.astype(np.uint8), np.ones((61, 61))) > 0
        assert seen[inner].std() < 0.01 * seen[inner].mean()


def test_light_beside_a_cylinder_is_that_of_random_walks_in_it():
    """On the side away from the LED, where a blurred image has a third too much; the walks share no code with it."""
    with scripts_of(VALIDATION / "twin") as script:
        volume = script("volume")
        optics = SkinOptics().channel("red")
        led = Led("white", position_mm=volume.LIGHTS[0])
        settings = RenderSettings(reach_mm=20.0)

        def at(boundary: Boundary) -> np.ndarray:
            image = render_band(volume.cylinder(), [led], Medium([optics], 0.25, 0.0, boundary), settings)  # fmt: skip
            x = (np.arange(*image.window[1].indices(221)[:2]) - 110.0) / 10.0
            dark, top = np.interp([-7.4, 0.0], x, image.diffuse[0, 0, 100])
            return dark / top

        rng = np.random.default_rng(0)
        dark, top = (
            volume.volume_radiance(x, optics.scattering_per_mm, optics.absorption_per_mm, rng)[0] for x in (-7.4, 0.0)
        )
    assert at(Boundary()) == pytest.approx(dark / top, rel=0.08)
    assert at(Boundary(blurred=True)) > 1.2 * dark / top
