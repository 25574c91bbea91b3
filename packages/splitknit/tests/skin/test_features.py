"""What the networks see: exposure, pigment and the image's orientation drop out, slopes and glare
do not."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from skin_scene import make_scene
from splitknit.imaging.pixels import bin_mean
from splitknit.skin.grid import BandImages, Grid, coarsen
from splitknit.skin.learned import (
    COUNT,
    RELIEF_MM,
    RIDGE_BAND_MM,
    SLANT_DEG,
    SLANT_ERROR,
    azimuth_waves,
    can_learn,
    features,
    relief_by_network,
    stated_deviation,
)
from splitknit.skin.light import fine_lighting, slant_of
from splitknit.skin.relief import ReliefEstimate

FACTOR = 3
SLOPES, WAVES = slice(3, 9), slice(9, 21)


def light_on(scene, grid=None, rig=None, surface=None):
    grid = grid or scene.grid
    low = coarsen(grid, FACTOR)
    rows, columns = low.shape
    height = (surface if surface is not None else placed(scene))[
        : rows * FACTOR, : columns * FACTOR
    ]
    return fine_lighting(
        rig or scene.white.rig, low, bin_mean(np.ascontiguousarray(height), FACTOR), FACTOR, grid
    )


def placed(scene):
    shape = scene.shape_mm
    return (shape - shape[scene.grid.mask].mean() + 1.0).astype(np.float32)


def fields_of(scene, stack=None):
    band = BandImages(
        scene.white.channels, scene.white.stack if stack is None else stack, scene.white.rig
    )
    return features(band, scene.grid, placed(scene), light_on(scene)).fields


@pytest.fixture(scope="module")
def scene():
    return make_scene()


@pytest.fixture(scope="module")
def matt():
    return make_scene(glare=0.0)


def rms(fields, where):
    return np.sqrt((fields[:, where] ** 2).mean(axis=1))


def test_slopes_of_ridges_are_features_and_strongest_in_blue(matt):
    fields = fields_of(matt)
    assert fields.shape == (COUNT, *matt.grid.shape)
    assert fields.dtype == np.float32
    assert not fields[:, ~matt.grid.mask].any()
    strength = rms(fields, matt.inner)
    red, green, blue = (np.hypot(*strength[3 + 2 * c : 5 + 2 * c]) for c in range(3))
    assert red < green < blue
    true = np.gradient(matt.relief_mm, matt.grid.pitch_mm, axis=1)
    assert np.corrcoef(fields[7][matt.inner], true[matt.inner])[0, 1] > 0.97


def test_specular_reflection_raises_the_azimuth_waves(scene, matt):
    glossy, dull = (rms(fields_of(s), s.inner)[WAVES].mean() for s in (scene, matt))
    assert glossy > 4 * dull
    assert fields_of(scene)[31][scene.inner].mean() > fields_of(matt)[31][scene.inner].mean() + 0.3


def test_exposure_changes_no_feature_and_pigment_the_tint_alone(scene):
    plain = fields_of(scene)
    assert_allclose(fields_of(scene, scene.white.stack * 3.0), plain, atol=2e-4)
    browner = scene.white.stack * np.array([1.0, 0.8, 0.5], np.float32)[:, None, None, None]
    changed = np.abs(fields_of(scene, browner) - plain)[:, scene.inner].max(axis=1)
    tints = [25, 26]
    assert (np.delete(changed, tints) < 1e-3).all()
    assert changed[tints] == pytest.approx([-np.log(0.8) / 2, -np.log(0.5) / 2], abs=1e-3)


def test_a_mirrored_finger_has_mirrored_features(scene):
    """Scalars stay, x components turn their sign, and so do sin 2a and cos 3a."""
    grid = scene.grid
    across = Grid(grid.mask[:, ::-1].copy(), -grid.x_mm[::-1], grid.y_mm, grid.pitch_mm, grid.cut)
    leds = tuple(
        replace(led, position_mm=(-led.position_mm[0], *led.position_mm[1:]))
        for led in scene.white.rig.leds
    )
    rig = replace(scene.white.rig, leds=leds)
    surface = placed(scene)[:, ::-1].copy()
    band = BandImages(scene.white.channels, scene.white.stack[..., ::-1].copy(), rig)
    mirrored = features(band, across, surface, light_on(scene, across, rig, surface)).fields[
        ..., ::-1
    ]
    signs = np.ones(COUNT)
    signs[[3, 5, 7, 21]] = -1
    for c in range(3):
        signs[[9 + 4 * c + 1, 9 + 4 * c + 2]] = -1
    inner = scene.inner & scene.inner[:, ::-1]
    expected = fields_of(scene) * signs[:, None, None].astype(np.float32)
    assert_allclose(mirrored[:, inner], expected[:, inner], atol=0.02)


def test_azimuth_waves_are_sines_and_cosines_of_the_azimuth(scene):
    waves = azimuth_waves(scene.white.rig, 3)
    azimuth = 2 * np.pi * np.arange(7) / 7
    assert waves.shape == (7, 7)
    assert_allclose(waves[:, 0], 1)
    assert_allclose(waves[:, 4], np.sin(2 * azimuth), atol=1e-6)
    assert_allclose(waves[:, 5], np.cos(3 * azimuth), atol=1e-6)


def test_networks_need_colour_lights_all_around_and_fine_pixels(scene):
    white = scene.white
    assert can_learn(white, 0.0264)
    assert not can_learn(white, 0.08)
    assert not can_learn(BandImages(("green",), white.stack[1:2], white.rig), 0.0264)
    few = BandImages(
        white.channels, white.stack[:, :5], replace(white.rig, leds=white.rig.leds[:5])
    )
    assert not can_learn(few, 0.0264)
    crowded = tuple(
        replace(led, position_mm=(52.5 * np.cos(0.1 * k), 52.5 * np.sin(0.1 * k), 140.0))
        for k, led in enumerate(white.rig.leds)
    )
    assert not can_learn(
        BandImages(white.channels, white.stack, replace(white.rig, leds=crowded)), 0.0264
    )


def test_the_relief_is_the_network_output_without_its_offset(scene):
    grid, true = scene.grid, scene.relief_mm.astype(np.float32)
    seen = []

    def network(fields):
        seen.append(fields)
        drawn = np.zeros((9, *grid.shape), np.float32)
        drawn[0] = true / RELIEF_MM + 5.0  # the offset is not relief
        drawn[8] = 2 * np.log(0.5)
        return drawn

    light = light_on(scene)
    drawn_relief = relief_by_network(
        features(scene.white, grid, placed(scene), light), grid, placed(scene), network
    )
    assert_array_equal(seen[0], fields_of(scene))
    inner = scene.inner
    assert_allclose(drawn_relief.relief_mm[inner], true[inner], atol=0.003)
    assert not drawn_relief.relief_mm[~grid.mask].any()
    stated = drawn_relief.deviation_mm / (0.5 * RELIEF_MM)
    slant = slant_of(placed(scene), grid.pitch_mm)
    assert_allclose(stated[inner], np.interp(slant[inner], SLANT_DEG, SLANT_ERROR), rtol=0.01)
    assert stated[inner & (slant < 10)].max() < 0.95 and np.ptp(slant[inner]) > 10


def drawn_estimate(scene, rms_um, trust=None):
    relief = scene.relief_mm.astype(np.float32)
    trust = scene.inner.astype(np.float32) if trust is None else trust
    nothing = np.zeros_like(relief)
    facts = {"relief_rms_um": rms_um}
    return ReliefEstimate(relief, nothing, trust, nothing, nothing, None, facts)


def test_the_stated_deviation_has_the_gain_of_the_ridges_alone(scene):
    grid = scene.grid
    ridges = scene.relief_mm.astype(np.float32)
    ridges -= grid.smooth(ridges, grid.mask, RIDGE_BAND_MM)
    deviation = np.full(grid.shape, 0.004, np.float32)
    stated = stated_deviation(ridges + 0.3, deviation, grid, 0.5)
    again = ridges - grid.smooth(ridges, grid.mask, RIDGE_BAND_MM)
    expected = np.hypot(0.004, 0.5 * again)
    assert_allclose(stated[scene.inner], expected[scene.inner], atol=2e-5)
