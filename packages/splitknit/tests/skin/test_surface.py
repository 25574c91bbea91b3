"""A small dome of skin, from images to shape and relief."""

import numpy as np
import pytest

from refusals import bad_input
from skin_scene import fresnel, make_scene, relief_gain, shape_rms
from splitknit.methods.metric import metric_skin
from splitknit.skin.diffusion import SkinSettings
from splitknit.skin.grid import BandImages, coarsen
from splitknit.skin.images import MetricSettings
from splitknit.skin.light import fine_lighting

SETTINGS = MetricSettings(rounds=2)


@pytest.fixture(scope="module")
def scene():
    return make_scene()


@pytest.fixture(scope="module")
def surface(scene):
    return surface_of(scene)


def surface_of(scene, bands=None):
    bands = bands or (scene.white, scene.nir)
    return metric_skin(bands, scene.grid, SkinSettings(), SETTINGS)


def grey(scene):
    return BandImages(("green",), scene.white.stack[1:2], scene.white.rig)


def assert_finite(surface, shape):
    for field in (surface.shape_mm, surface.relief_mm, surface.deviation_mm, surface.albedo):
        assert field.shape == shape
        assert field.dtype == np.float32
        assert np.isfinite(field).all()
    assert (surface.deviation_mm >= 0).all()


def assert_relief(surface, scene):
    gain, correlation = relief_gain(surface.relief_mm, scene.relief_mm, scene.inner)
    assert 0.55 < gain < 1.1  # a Wiener filter shrinks; 0.61 where skin scatters by 30 % more
    assert correlation > 0.94


def test_the_relief_of_glossy_skin_is_recovered(scene, surface):
    assert_finite(surface, scene.grid.shape)
    assert_relief(surface, scene)


def test_the_shape_beneath_the_relief_is_recovered(scene, surface):
    whole, true = surface.shape_mm + surface.relief_mm, scene.shape_mm + scene.relief_mm
    assert shape_rms(surface.shape_mm, scene.shape_mm, scene.inner) < 0.04
    assert shape_rms(whole, true, scene.grid.mask & (scene.grid.depth_mm > 0.33)) < 0.08
    assert surface.shape_mm[scene.grid.mask].mean() == pytest.approx(SETTINGS.plane_mm, abs=0.1)


@pytest.mark.slow
def test_matt_skin_has_less_specular_reflection_than_glossy_skin(surface):
    scene = make_scene(glare=0.0)
    matt = surface_of(scene)
    assert_relief(matt, scene)
    assert matt.facts["glare"]["blue"] < 0.2 * surface.facts["glare"]["blue"]


def test_facts_state_scattering_and_colour(surface):
    skin = SkinSettings()
    assert surface.facts["scattering_per_mm"] == {
        n: skin.scattering(n) for n in ("blue", "green", "nir", "red")
    }
    assert surface.facts["colour"]["red"] == 1.0
    assert surface.facts["colour"]["green"] == pytest.approx(0.42 / 0.62, rel=0.05)
    assert surface.facts["colour"]["blue"] == pytest.approx(0.33 / 0.62, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("scattering", [0.7, 1.3])
def test_the_relief_is_recovered_under_wrong_scattering(scattering):
    scene = make_scene(scattering=scattering)
    assert_relief(surface_of(scene), scene)


@pytest.mark.slow
def test_the_deviation_of_grey_skin_holds_the_effect_of_wrong_scattering():
    true, stronger = make_scene(glare=0.0), make_scene(glare=0.0, scattering=1.3)
    surface, misled = (surface_of(each, (grey(each),)) for each in (true, stronger))
    gain, correlation = relief_gain(misled.relief_mm, surface.relief_mm, true.inner)
    assert correlation > 0.99
    assert gain - 1 > 0.1
    error = (misled.relief_mm - surface.relief_mm)[true.inner]
    assert (error**2).mean() < (surface.deviation_mm[true.inner] ** 2).mean()


@pytest.mark.parametrize("bands", ["grey", "grey and nir", "no nir"])
def test_fewer_bands_are_enough_for_the_relief(scene, bands):
    chosen = {
        "grey": (grey(scene),),
        "grey and nir": (grey(scene), scene.nir),
        "no nir": (scene.white,),
    }[bands]
    surface = surface_of(scene, chosen)
    assert_finite(surface, scene.grid.shape)
    if bands == "no nir":
        assert_relief(surface, scene)
    else:  # grey images keep their glare: only the sign and pattern of the relief can be right
        assert relief_gain(surface.relief_mm, scene.relief_mm, scene.inner)[1] > 0.8


def test_fine_lights_follow_the_surface_of_the_coarse_grid(scene):
    low = coarsen(scene.grid, 3)
    x, y = np.meshgrid(low.x_mm, low.y_mm)
    shape = (-0.06 * x**2 - 0.04 * y**2).astype(np.float32)
    height = shape - shape[low.mask].mean() + np.float32(1.0)
    light = fine_lighting(scene.white.rig, low, height, 3, scene.grid)
    assert light.entering.shape == light.trust.shape == scene.white.stack.shape[1:]
    assert not light.trust[:, ~scene.grid.mask].any()
    for row, column in ((90, 140), (60, 90), (150, 190)):
        px, py = scene.grid.x_mm[column], scene.grid.y_mm[row]
        normal = np.array([0.12 * px, 0.08 * py, 1.0])
        height = 1.0 - shape[low.mask].mean() - 0.06 * px**2 - 0.04 * py**2
        for k, led in enumerate(scene.white.rig.leds):
            towards = np.asarray(led.position_mm) - [px, py, height]
            cosine = towards @ normal / np.linalg.norm(towards) / np.linalg.norm(normal)
            enters = (1 - fresnel(cosine)) / (1 - fresnel(np.float64(1.0)))
            assert light.entering[k, row, column] == pytest.approx(enters, abs=2e-3)
            assert light.trust[k, row, column] > 0.99
    # and it varies: grazing light is mirrored more
    assert np.ptp(light.entering[:, scene.grid.mask]) > 0.01


def test_the_images_are_not_changed(scene):
    before = scene.white.stack.copy()
    metric_skin(
        (scene.white,), scene.grid, SkinSettings(), MetricSettings(rounds=1, coarse_steps=1)
    )
    np.testing.assert_array_equal(scene.white.stack, before)


@pytest.mark.parametrize("wrong", [{"rounds": 0}, {"relief": "magic"}, {"coarse_steps": 0}])
def test_metric_settings_out_of_range_are_refused(wrong):
    with bad_input(r"metric\."):
        MetricSettings(**wrong)
