"""A small dome of skin, from images to shape and relief."""

from __future__ import annotations

import numpy as np
import pytest
from skin_scene import make_scene, relief_gain, shape_rms

from splitknit.check import BadInput
from splitknit.metric import MetricSettings, reconstruct_skin
from splitknit.metric.coarse import BandImages
from splitknit.separate import SkinSettings

SETTINGS = MetricSettings(rounds=2)


@pytest.fixture(scope="module")
def scene():
    return make_scene()


@pytest.fixture(scope="module")
def found(scene):
    return reconstruct_skin((scene.white, scene.nir), scene.grid, SkinSettings(), SETTINGS)


def grey(scene):
    return BandImages(("green",), scene.white.stack[1:2], scene.white.rig)


def assert_finite(surface, shape):
    for field in (surface.shape_mm, surface.relief_mm, surface.deviation_mm, surface.albedo):
        assert field.shape == shape
        assert field.dtype == np.float32
        assert np.isfinite(field).all()
    assert (surface.deviation_mm >= 0).all()


def test_relief_comes_out_of_skin_with_glare(scene, found):
    assert_finite(found, scene.grid.shape)
    gain, correlation = relief_gain(found.relief_mm, scene.relief_mm, scene.inner)
    assert 0.85 < gain < 1.15
    assert correlation > 0.97


def test_shape_comes_out_beside_the_relief(scene, found):
    whole, true = found.shape_mm + found.relief_mm, scene.shape_mm + scene.relief_mm
    assert shape_rms(found.shape_mm, scene.shape_mm, scene.inner) < 0.04
    assert shape_rms(whole, true, scene.grid.mask & (scene.grid.depth_mm > 0.33)) < 0.08
    assert found.shape_mm[scene.grid.mask].mean() == pytest.approx(SETTINGS.plane_mm, abs=0.1)


def test_matt_skin_has_less_glare_than_glossy_skin(found):
    scene = make_scene(glare=0.0)
    matt = reconstruct_skin((scene.white, scene.nir), scene.grid, SkinSettings(), SETTINGS)
    gain, correlation = relief_gain(matt.relief_mm, scene.relief_mm, scene.inner)
    assert 0.85 < gain < 1.15
    assert correlation > 0.97
    assert matt.facts["glare"]["blue"]["strength"] < 0.2 * found.facts["glare"]["blue"]["strength"]


def test_facts_tell_what_was_assumed_and_found(found):
    skin = SkinSettings()
    assert found.facts["scattering_per_mm"] == {n: skin.scattering(n) for n in ("blue", "green", "nir", "red")}
    assert found.facts["colour"]["red"] == 1.0
    assert found.facts["colour"]["green"] == pytest.approx(0.42 / 0.62, rel=0.05)
    assert found.facts["colour"]["blue"] == pytest.approx(0.33 / 0.62, rel=0.05)
    # three colours that are blind to glare are nearly blind to the scattering too
    assert 0 < found.facts["gain_sensitivity"] < 0.1


@pytest.mark.parametrize("scattering", [0.7, 1.3])
def test_colours_find_the_relief_of_skin_that_scatters_otherwise(scattering):
    scene = make_scene(scattering=scattering)
    surface = reconstruct_skin((scene.white, scene.nir), scene.grid, SkinSettings(), SETTINGS)
    gain, correlation = relief_gain(surface.relief_mm, scene.relief_mm, scene.inner)
    assert 0.85 < gain < 1.15
    assert correlation > 0.97


def test_deviation_of_grey_skin_tells_what_wrong_scattering_does():
    """Matt skin in grey: its relief is off by as much as is told, and the deviation holds it."""
    true, stronger = make_scene(glare=0.0), make_scene(glare=0.0, scattering=1.3)
    surface = reconstruct_skin((grey(true),), true.grid, SkinSettings(), SETTINGS)
    misled = reconstruct_skin((grey(stronger),), true.grid, SkinSettings(), SETTINGS)
    gain, correlation = relief_gain(misled.relief_mm, surface.relief_mm, true.inner)
    assert correlation > 0.99
    assert gain - 1 > 0.1
    assert surface.facts["gain_sensitivity"] == pytest.approx(gain - 1, abs=0.05)
    sure = reconstruct_skin((grey(true),), true.grid, SkinSettings(scattering_uncertainty=0.0), SETTINGS)
    np.testing.assert_array_equal(sure.relief_mm, surface.relief_mm)
    assert sure.facts["gain_sensitivity"] == 0
    noise = float(sure.deviation_mm[true.inner].mean())
    assert 0.0002 < noise < 0.005
    expected = np.hypot(sure.deviation_mm, surface.facts["gain_sensitivity"] * surface.relief_mm)
    np.testing.assert_allclose(surface.deviation_mm[true.inner].mean(), expected[true.inner].mean(), rtol=0.05)
    crest = true.inner & (np.abs(surface.relief_mm) > 0.02)
    assert (surface.deviation_mm[crest] > 2 * sure.deviation_mm[crest]).mean() > 0.9


@pytest.mark.parametrize("bands", ["grey", "grey and nir", "no nir"])
def test_fewer_bands_do(scene, bands):
    chosen = {"grey": (grey(scene),), "grey and nir": (grey(scene), scene.nir), "no nir": (scene.white,)}[bands]
    surface = reconstruct_skin(chosen, scene.grid, SkinSettings(), SETTINGS)
    assert_finite(surface, scene.grid.shape)
    gain, correlation = relief_gain(surface.relief_mm, scene.relief_mm, scene.inner)
    assert correlation > (0.97 if bands == "no nir" else 0.8)
    assert bands != "no nir" or 0.85 < gain < 1.15
    # grey images keep their glare: only its sign and pattern can be right


def test_same_bytes_every_time_and_progress_is_told(scene, found):
    told = []
    again = reconstruct_skin((scene.white, scene.nir), scene.grid, SkinSettings(), SETTINGS, told.append)
    for name in ("shape_mm", "relief_mm", "deviation_mm", "albedo"):
        assert getattr(again, name).tobytes() == getattr(found, name).tobytes()
    assert again.facts == found.facts
    assert told == [pytest.approx(1 / 3), pytest.approx(2 / 3)]


def test_images_are_left_as_they_were(scene):
    before = scene.white.stack.copy()
    reconstruct_skin((scene.white,), scene.grid, SkinSettings(), MetricSettings(rounds=1, coarse_steps=(1,)))
    np.testing.assert_array_equal(scene.white.stack, before)


@pytest.mark.parametrize(
    "wrong",
    [{"working_pitch_mm": 0.2}, {"working_pitch_mm": 0.0}, {"rounds": 0}, {"relief_steps": 0}, {"coarse_steps": ()}],
)
def test_settings_are_checked(wrong):
    with pytest.raises(BadInput, match=r"metric\."):
        MetricSettings(**wrong)
