"""The transfer function of scattering: the measured figures, limits, order, and random walks with
another seed."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from refusals import bad_input
from splitknit.skin.diffusion import SkinSettings, diffusion

RIDGES = 2 * np.pi * 75.7 / 33  # rad/mm of one cycle in 33 px at 75.7 px/mm
MAKER = Path(__file__).resolve().parents[4] / "validation" / "diffusion" / "make_table.py"


def of_channel(channel):
    skin = SkinSettings()
    return diffusion(skin.scattering(channel), skin.absorption(channel))


def maker():
    spec = importlib.util.spec_from_file_location("make_table", MAKER)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("channel", "gain"), [("red", 0.08), ("green", 0.15), ("blue", 0.22)])
def test_the_gain_at_the_ridges_is_the_measured_one(channel, gain):
    assert of_channel(channel)(RIDGES) == pytest.approx(gain, abs=0.01)


def test_gain_is_one_at_zero_and_falls_with_the_frequency():
    omega = np.geomspace(0.01, 400, 300)
    for scattering, absorption in ((0.5, 0.0), (3.39, 0.03), (5.18, 0.4), (2.0, 4.0)):
        skin = diffusion(scattering, absorption)
        gain = skin(omega)
        assert skin(0.0) == 1.0
        assert (np.diff(gain) <= 0).all()
        assert gain[-1] > 0
        assert gain[-1] < 0.05 * gain[0]


def test_the_gain_depends_on_the_ratio_of_frequency_to_coefficients():
    omega = np.array([0.5, 3.0, 14.4])
    np.testing.assert_allclose(
        diffusion(8.0, 0.4)(2 * omega), diffusion(4.0, 0.2)(omega), rtol=1e-12
    )


def test_the_gain_takes_frequencies_of_any_shape():
    omega = np.linspace(0, 40, 12).reshape(3, 2, 2)
    skin = diffusion(4.0, 0.2)
    np.testing.assert_array_equal(
        skin(omega), [[[skin(w) for w in row] for row in plane] for plane in omega]
    )


def test_the_table_agrees_with_random_walks_of_another_seed():
    module = maker()
    count = 20_000
    walked = module.table(count, 400, seed=3)
    x = module.FREQUENCIES
    near = (x > 0.1) & (x < 0.99 * module.TAIL_FREQUENCY)
    # beyond, 400 scatterings cut the walks too short
    for row, albedo in enumerate(module.ALBEDOS[:-3]):
        # sigma_t' of 1, so that x is the frequency; both tables' errors, the weights of walks being
        # at most one
        skin = diffusion(albedo, 1 - albedo)
        worst = np.abs(skin(x[near]) * skin.albedo - walked[row, near]).max()
        assert worst < 4.0 * np.sqrt(skin.albedo / 2 / count), albedo
    assert walked[3, near].max() / walked[3, near].min() > 5  # there was something to agree on


def test_random_walks_agree_between_the_albedos_of_the_table():
    module = maker()
    radii, orders = module.walks(20_000, 400, seed=5)
    for albedo in (0.55, 0.88, 0.957, 0.97):
        skin = diffusion(albedo, 1 - albedo)
        x = np.array([0.2, 0.7, 2.0, 5.0])
        walked = [(albedo**orders * module.j0(w * radii)).sum() / 20_000 for w in x]
        np.testing.assert_allclose(
            skin(x) * skin.albedo, walked, atol=4 * np.sqrt(skin.albedo / 2 / 20_000)
        )


def test_the_scattering_factor_scales_all_channels_and_is_positive():
    plain, doubled = SkinSettings(), SkinSettings(scattering_factor=2.0)
    for channel in ("red", "green", "blue", "nir"):
        assert doubled.scattering(channel) == 2 * plain.scattering(channel)
        assert doubled.absorption(channel) == plain.absorption(channel)
    # Jacques: 4.6 (wavelength / 500 nm)^-1.42 per mm at the channel's wavelength
    assert plain.scattering("nir") == pytest.approx(4.6 * (850 / 500) ** -1.42, rel=0.01)
    with bad_input("skin"):
        SkinSettings(scattering_factor=-1.0)


def test_absorption_follows_the_colour_of_the_finger():
    skin = SkinSettings()
    red = of_channel("red").albedo
    for channel in ("green", "blue"):  # by a power of 0.6
        ratio = of_channel(channel).albedo / red
        assert skin.absorption(channel, ratio) == pytest.approx(skin.absorption(channel), rel=0.03)
        redder = skin.absorption(channel, 0.8 * ratio)
        assert diffusion(skin.scattering(channel), redder).albedo / red == pytest.approx(
            0.8**0.6 * ratio, rel=0.02
        )
    assert skin.absorption("red", 0.5) == skin.absorption("red")
