"""The two-layer model: against the integrals it comes from, and its derivatives against finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.photometric.hanrahan_krueger_fit import SkinLayers, _refracted, _scattered, _transmitted, reflected

LAYERS = SkinLayers(epidermis_thickness_mm=0.01)
FRACTION, DEPTH, BASE, EXPOSURE = LAYERS.epidermis_fraction, LAYERS.epidermis_depth, 0.4, 6.0


def by_the_book(normal, light, layers, base, exposure):
    """One image of strength one, by vectors, Fresnel's amplitudes and integrals over the depth."""
    index, view = layers.refractive_index, np.array([0.0, 0.0, 1.0])

    def inside(direction):
        cosine = direction @ normal
        tangential = (direction - cosine * normal) / index
        return tangential + np.sqrt(1 - tangential @ tangential) * normal

    def through(direction):
        outer, inner = direction @ normal, inside(direction) @ normal
        s = (outer - index * inner) / (outer + index * inner)
        p = (index * outer - inner) / (index * outer + inner)
        return 1 - (s**2 + p**2) / 2

    def phase(cosine, g):
        return (1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * cosine) ** 1.5)

    way_in, way_out = inside(light), inside(view)
    turned = -way_in @ way_out
    scattering = np.array([layers.epidermis_scattering_per_mm, layers.dermis_scattering_per_mm])
    extinction = scattering + np.array([layers.epidermis_absorption_per_mm, layers.dermis_absorption_per_mm])
    path = 1 / (way_in @ normal) + 1 / (way_out @ normal)
    thickness = layers.epidermis_thickness_mm
    upper, lower = np.linspace(0, thickness, 20001), np.linspace(0, 1.0, 200001)
    above = scattering[0] * np.exp(-extinction[0] * upper * path)
    below = scattering[1] * np.exp(-extinction[0] * thickness * path - extinction[1] * lower * path)
    # a beam of unit irradiance on the surface; radiance towards the viewer, times the cosine that both depths share
    once = phase(turned, layers.epidermis_asymmetry) * np.trapezoid(above, upper)
    once += phase(turned, layers.dermis_asymmetry) * np.trapezoid(below, lower)
    once /= (way_in @ normal) * (way_out @ normal)
    facing = 1 - ((1 - index) / (1 + index)) ** 2
    return (light @ normal) * through(light) * through(view) / facing**2 * (base + exposure * once)


@pytest.mark.parametrize("slant_deg", [0, 25, 60, 80])
@pytest.mark.parametrize("azimuth_deg", [0, 100])
def test_model_is_the_integral_over_depth(slant_deg, azimuth_deg):
    slant, azimuth = np.deg2rad([slant_deg, azimuth_deg])
    normal = np.array([np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.cos(slant)])
    light = np.array([0.35, 0.1, 0.0])
    light[2] = np.sqrt(1 - light @ light)
    wanted = by_the_book(normal, light, LAYERS, BASE, EXPOSURE)
    one = np.ones(1)
    got = reflected(
        np.array([[light @ normal]]), one * normal[2], light[2:, None], BASE * one, FRACTION * one, DEPTH * one,
        EXPOSURE, LAYERS,
    )  # fmt: skip
    assert got.value[0, 0] == pytest.approx(wanted, rel=2e-4)
    without = by_the_book(normal, light, LAYERS, BASE, 0.0)
    assert wanted > 1.02 * without  # the layers are seen at all


def test_light_behind_the_surface_gives_nothing():
    one = np.ones(2)
    got = reflected(np.array([[-0.2, 0.0]]), 0.5 * one, np.array([[0.9]]), one, 0.9 * one, one, 5.0, LAYERS)
    for name in ("value", "by_light", "by_view", "by_base", "by_fraction", "by_depth"):
        assert np.array_equal(getattr(got, name), np.zeros((1, 2)))


@pytest.mark.parametrize(("name", "place"), [("light", 0), ("view", 1), ("base", 3), ("fraction", 4), ("depth", 5)])
def test_derivatives_are_those_of_finite_differences(name, place):
    rng = np.random.default_rng(3)
    n = 400
    given = [
        rng.uniform(0.05, 1, (7, n)), rng.uniform(0.1, 1, n), rng.uniform(0.8, 1, (7, 1)), rng.uniform(0.1, 1, n),
        rng.uniform(0.05, 0.95, n), rng.uniform(0.1, 4, n),
    ]  # fmt: skip

    def value(change):
        moved = list(given)
        moved[place] = given[place] + change
        return reflected(*moved, 6.0, LAYERS).value

    step = 1e-6
    wanted = (value(step) - value(-step)) / (2 * step)
    got = getattr(reflected(*given, 6.0, LAYERS), f"by_{name}")
    assert np.abs(got - wanted).max() < 1e-7 * max(1, np.abs(wanted).max())


def test_parts_have_their_known_values():
    one = np.ones(1)
    assert _refracted(0 * one, 1.4)[0][0] == pytest.approx(np.sqrt(1 - 1 / 1.4**2))
    assert _transmitted(one, one, 1.4)[0][0] == pytest.approx(1 - (0.4 / 2.4) ** 2)
    assert _transmitted(1e-9 * one, _refracted(1e-9 * one, 1.4)[0], 1.4)[0][0] == pytest.approx(0, abs=1e-7)
    cosine = np.linspace(-1, 1, 200001)
    for g in (-0.4, 0.0, 0.81):
        whole = 2 * np.pi * np.trapezoid(_scattered(cosine, g)[0], cosine)
        assert whole == pytest.approx(1, rel=1e-6)
        assert 2 * np.pi * np.trapezoid(-cosine * _scattered(cosine, g)[0], cosine) == pytest.approx(g, abs=1e-6)


def test_single_precision_stays_single():
    one = np.ones(3, dtype=np.float32)
    got = reflected(one[None], one, one[:1, None], one, 0.9 * one, one, 5.0, LAYERS)
    assert got.value.dtype == got.by_view.dtype == got.by_depth.dtype == np.float32


@pytest.mark.parametrize(
    "change",
    [{"refractive_index": 1.0}, {"epidermis_asymmetry": 1.0}, {"dermis_scattering_per_mm": float("nan")},
     {"epidermis_thickness_mm": 0.0}],
)  # fmt: skip
def test_layers_that_are_none_are_refused(change):
    with pytest.raises(BadInput, match=next(iter(change))):
        replace(LAYERS, **change)


def test_a_layer_that_only_absorbs_is_refused():
    with pytest.raises(BadInput, match="epidermis must lie between"):
        replace(LAYERS, epidermis_scattering_per_mm=1e-3, epidermis_absorption_per_mm=1e3)
