"""The networks that ship, on a scene that shares nothing with their training data."""

from __future__ import annotations

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


@pytest.fixture(scope="module")
def networks():
    return Networks(runner(SETTINGS.network), runner(SETTINGS.shape_network))


@pytest.mark.slow
@pytest.mark.parametrize(("glare", "scattering"), [(0.5, 1.0), (1.0, 0.7)])
def test_relief_and_shape_of_a_dome(networks, glare, scattering):
    scene = make_scene(glare=glare, scattering=scattering)
    found = metric_skin(
        (scene.white, scene.nir), scene.grid, SkinSettings(), SETTINGS, networks=networks
    )
    gain, correlation = relief_gain(found.relief_mm, scene.relief_mm, scene.inner)
    assert found.facts["relief_by"] == "network"
    assert correlation > 0.95
    assert 0.8 < gain < 1.25
    whole, true = found.shape_mm + found.relief_mm, scene.shape_mm + scene.relief_mm
    assert shape_rms(whole, true, scene.grid.mask & (scene.grid.depth_mm > 0.33)) < 0.15
    # the uncertainty is of the size of the error
    error = (found.relief_mm - scene.relief_mm)[scene.inner]
    error -= error.mean()
    ratio = np.sqrt((error**2).mean() / (found.deviation_mm[scene.inner] ** 2).mean())
    assert 0.3 < ratio < 3


@pytest.mark.slow
def test_without_ridges_none_are_drawn(networks):
    scene = make_scene(depth=0.0)
    found = metric_skin(
        (scene.white, scene.nir), scene.grid, SkinSettings(), SETTINGS, networks=networks
    )
    assert found.relief_mm[scene.inner].std() < 0.007  # a third of what is there with ridges


@pytest.mark.slow
def test_settings_turn_the_networks_off():
    scene = make_scene()
    settings = MetricSettings(relief="colour", rounds=1, coarse_steps=2)
    networks = shipped_networks(settings)
    found = metric_skin((scene.white, scene.nir), scene.grid, SkinSettings(), settings, networks)
    assert networks is None and found.facts["relief_by"] == "colour"
