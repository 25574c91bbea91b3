"""Wet, dry, dusty, scarred and glossy fingers of the twin."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.model import Camera
from splitknit.nominal import default_rig
from splitknit_simulator.finger.conditions import KINDS, Condition, conditioned_surface
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.finger.master_print import MasterPrintSettings, master_print
from splitknit_simulator.light.coat import DUST_DENSITY_MG_PER_MM3, draw_grains
from splitknit_simulator.light.renderer import RenderSettings, render_band
from splitknit_simulator.light.skin import SkinOptics, fresnel
from splitknit_simulator.surface import WATER_INDEX, Coat, Film, Grains
from surfaces import ridged_egg

SMALL = MasterPrintSettings(half_width_mm=6, distal_mm=20, proximal_mm=2)
CAMERA = Camera(12.0, (260, 280))
POSE = FingerPose(insertion_mm=20.0)
SKIN = SkinOptics()


@pytest.fixture(scope="module")
def egg():
    return ridged_egg((180, 170), 12.0)


@pytest.fixture(scope="module")
def master():
    return master_print("whorl", 3, SMALL)


@pytest.fixture(scope="module")
def finger():
    return draw_finger(5, print_settings=SMALL)


def _render(surface, leds=None, **skin):
    leds = leds or [led for led in default_rig(0.25, seed=3).leds if led.band == "white"][:2]
    medium = replace(SKIN.medium("white"), **{"roughness": 0.25, "glare": 0.8, **skin})
    return render_band(surface, leds, medium, RenderSettings(workers=1))


def _coated(egg, **parts):
    zero = np.zeros(egg.mask.shape, dtype=np.float32)
    return replace(egg, coat=Coat("wet", 1.0, parts.pop("fraction", zero), **parts))


def test_an_empty_coat_changes_nothing(egg):
    bare, coated = _render(egg), _render(_coated(egg))
    assert_allclose(coated.diffuse, bare.diffuse, rtol=2e-5, atol=1e-7)
    assert_allclose(coated.glare, bare.glare, rtol=1e-3, atol=1e-6)


def test_unknown_conditions_are_refused():
    with bad_input(r"one of none, wet, dry"):
        Condition("muddy")
    with bad_input(r"severity must be from 0 to 1, but it is 1\.5"):
        Condition("wet", 1.5)


def test_a_condition_of_severity_zero_is_inactive():
    assert Condition("dry", 0.1).active
    assert not Condition("wet", 0.0).active and not Condition().active


def test_a_water_film_lowers_contrast_and_reflects_by_its_roughness(egg):
    flat = egg.shape_normals
    everywhere = egg.mask.astype(np.float32)
    film = Film(everywhere, flat, np.full(egg.mask.shape, 0.05, dtype=np.float32))
    wet, bare = _render(_coated(egg, fraction=everywhere, film=film)), _render(egg)
    middle = np.s_[:, 60:110, 60:110]

    def contrast(image):
        return float(np.std(image[middle] / np.mean(image[middle])))

    wet_blue, bare_blue = wet.diffuse[:, 2], bare.diffuse[:, 2]
    ratio = float(wet_blue[middle].mean() / bare_blue[middle].mean())
    assert 0.97 < ratio < 1.06  # a film over smooth skin is hardly darker
    assert contrast(wet_blue[0][None]) < contrast(bare_blue[0][None])
    top = float(wet.glare.max() / bare.glare.max())
    mirrors = fresnel(np.ones(1), WATER_INDEX)[0] / (0.8 * fresnel(np.ones(1), 1.42)[0])
    assert top == pytest.approx(mirrors * (0.25 / 0.05) ** 2, rel=0.4)


def test_dust_grains_have_the_stated_mass():
    mask = np.ones((600, 500), dtype=np.bool_)
    flat = np.ones(mask.shape, dtype=np.float32)
    camera = Camera(40.0, mask.shape)
    grains = draw_grains(np.random.default_rng(4), mask, flat, camera, 0.5)
    volume = np.pi / 6 * np.sum((2 * grains.radius_px / 40.0) ** 3)
    mg_per_cm2 = volume * DUST_DENSITY_MG_PER_MM3 / (mask.size / 40.0**2 / 100)
    assert mg_per_cm2 == pytest.approx(0.32, rel=0.12)  # what is larger than 0.25 mm does not stick
    twice = draw_grains(np.random.default_rng(4), mask, 0.5 * flat, camera, 0.5)
    assert len(twice.row) == pytest.approx(2 * len(grains.row), rel=0.05)


def test_grains_hide_the_skin_and_shade_it(egg):
    grain = Grains(np.array([85.0]), np.array([90.0]), np.array([4.0]), np.array([0.0]))
    fraction = np.zeros(egg.mask.shape, dtype=np.float32)
    dusty, bare = _render(_coated(egg, fraction=fraction, grains=grain)), _render(egg)
    window = dusty.window
    row, column = 90 - window[0].start, 85 - window[1].start
    assert (dusty.diffuse[:, :, row, column] < 1e-2 * bare.diffuse[:, :, row, column]).all()
    near = np.s_[:, :, row - 8 : row + 9, column - 8 : column + 9]
    lost = 1 - dusty.diffuse[near].sum(axis=(2, 3)) / bare.diffuse[near].sum(axis=(2, 3))
    assert (lost > 1.1 * np.pi * 16 / 17**2).all(), lost  # more than it hides: its shadow
    assert (lost[:, 0] < lost[:, 2]).all()  # red light comes from further away below the skin


def test_scales_scatter_white_light(egg):
    white = np.where(egg.mask, 0.2, 0.0).astype(np.float32)
    dry, bare = _render(_coated(egg, fraction=white, scales=white)), _render(egg)
    gain = dry.diffuse - 0.64 * bare.diffuse  # what comes through goes through the scale twice
    inside = np.s_[:, :, 60:110, 60:110]
    assert_allclose(gain[inside][:, 0], gain[inside][:, 2], rtol=0.02, atol=1e-4)
    assert (gain[inside] > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS[1:])
def test_every_condition_covers_skin_alone(finger, kind):
    seed = np.random.SeedSequence(9)
    surface = conditioned_surface(finger, POSE, CAMERA, SKIN, Condition(kind, 0.8), seed, workers=1)
    coat = surface.coat
    assert coat is not None and surface.chart is None
    assert coat.truth()["condition_kind"] == kind
    assert 0.005 < float(coat.fraction[surface.mask].mean()) <= 1.0
    assert float(np.abs(coat.fraction[~surface.mask]).max()) == 0.0
    clean = finger_surface(finger, POSE, CAMERA, workers=1)
    changed = float(np.abs(surface.normals - clean.normals)[clean.mask & surface.mask].mean())
    if kind in ("dry", "scarred"):
        assert changed > 1e-3
    else:  # water, dust and gloss leave the skin as it is, but for a shift of microns
        assert changed < 2e-3
    if coat.along is not None:
        inside = surface.mask & np.roll(surface.mask, 2, 0) & np.roll(surface.mask, -2, 0)
        tilt = np.abs(np.sum(coat.along * surface.normals, axis=-1))[inside]
        assert float(np.quantile(tilt, 0.98)) < 1e-3


def test_scars_keep_their_places_and_dust_does_not(finger):
    small = Camera(6.0, (130, 140))

    def fraction(kind, seed):
        surface = conditioned_surface(
            finger, POSE, small, SKIN, Condition(kind, 0.7), np.random.SeedSequence(seed), workers=1
        )
        return surface.coat.fraction

    assert_array_equal(fraction("scarred", 1), fraction("scarred", 2))
    assert np.any(fraction("dusty", 1) != fraction("dusty", 2))
