"""The networks that ship, on a scene that shares nothing with their training data."""

import numpy as np
import pytest

from skin_scene import make_scene, relief_gain, shape_rms
from splitknit.methods.metric import metric_skin
from splitknit.networks.unet import load_network, run_network
from splitknit.skin.diffusion import SkinSettings
from splitknit.skin.images import MetricSettings, shipped_networks
from splitknit.skin.learned import Networks

SETTINGS = MetricSettings()


def runner(name):
    network = load_network(name)
    return lambda fields: run_network(network, fields[None])[0]


def surface_of(scene, networks, settings=SETTINGS):
    bands = scene.white, scene.nir
    return metric_skin(bands, scene.grid, SkinSettings(), settings, networks=networks)


@pytest.fixture(scope="module")
def networks():
    return Networks(runner(SETTINGS.network), runner(SETTINGS.shape_network))


@pytest.mark.slow
@pytest.mark.parametrize(("glare", "scattering"), [(0.5, 1.0), (1.0, 0.7)])
def test_networks_recover_relief_and_shape_of_a_dome(networks, glare, scattering):
    scene = make_scene(glare=glare, scattering=scattering)
    surface = surface_of(scene, networks)
    gain, correlation = relief_gain(surface.relief_mm, scene.relief_mm, scene.inner)
    assert surface.facts["relief_by"] == "network"
    assert correlation > 0.95
    assert 0.8 < gain < 1.25
    whole, true = surface.shape_mm + surface.relief_mm, scene.shape_mm + scene.relief_mm
    assert shape_rms(whole, true, scene.grid.mask & (scene.grid.depth_mm > 0.33)) < 0.15
    # the uncertainty is of the size of the error
    error = (surface.relief_mm - scene.relief_mm)[scene.inner]
    error -= error.mean()
    ratio = np.sqrt((error**2).mean() / (surface.deviation_mm[scene.inner] ** 2).mean())
    assert 0.3 < ratio < 3


@pytest.mark.slow
def test_networks_draw_no_ridges_on_smooth_skin(networks):
    scene = make_scene(depth=0.0)
    surface = surface_of(scene, networks)
    assert surface.relief_mm[scene.inner].std() < 0.007  # a third of what is there with ridges


@pytest.mark.slow
def test_settings_turn_the_networks_off():
    settings = MetricSettings(relief="shading", rounds=1, coarse_steps=2)
    networks = shipped_networks(settings)
    assert networks is None
    assert surface_of(make_scene(), networks, settings).facts["relief_by"] == "shading"
