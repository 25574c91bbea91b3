"""Instruments of presentation attacks: their geometry and optics are those of their species."""

from __future__ import annotations

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.errors import BadInput
from splitknit_simulator.twin import twin_settings

with scripts_of(VALIDATION / "pad") as script:
    attacks = script("attacks")
SPECIES, simulate_attack = attacks.SPECIES, attacks.simulate_attack

SETTINGS = twin_settings(0.08, {"render.workers": 1})


@pytest.fixture(scope="module")
def presented():
    return {
        name: simulate_attack(1, name, SETTINGS)
        for name in ("live", "photo-matt", "screen", "silicone", "bloodless")
    }


@pytest.mark.slow
def test_a_photograph_is_flat_and_shows_the_finger(presented):
    capture, truth = presented["photo-matt"]
    live = presented["live"][1]
    inside = truth["mask"]
    assert np.array_equal(inside, live["mask"])
    assert np.all(truth["relief_um"] == 0)
    plane = np.c_[np.argwhere(inside), np.ones(inside.sum())]
    above = (
        truth["height_mm"][inside]
        - plane @ np.linalg.lstsq(plane, truth["height_mm"][inside], rcond=None)[0]
    )
    assert np.std(above) < 0.2 * np.std(live["height_mm"][inside])
    picture = capture.bands["white"].pixels[0][..., 1][inside].astype(float)
    assert picture.std() / picture.mean() > 0.1  # it shows shading that its surface does not have


@pytest.mark.slow
def test_a_cast_has_lower_relief_and_a_normal_for_each_slope(presented):
    _, truth = presented["silicone"]
    live = presented["live"][1]
    inside = truth["mask"] & (live["normals"][..., 2] > 0.8)
    assert 0.3 < np.std(truth["relief_um"][inside]) / np.std(live["relief_um"][inside]) < 1.0
    assert np.allclose(np.linalg.norm(truth["normals"][truth["mask"]], axis=1), 1, atol=1e-5)


@pytest.mark.slow
def test_a_screen_shines_with_the_lights_off_but_not_in_near_infrared(presented):
    capture, truth = presented["screen"]
    inside = truth["mask"]
    white, nir = (
        capture.bands[name].ambient.pixels[inside].astype(float).mean() for name in ("white", "nir")
    )
    assert white > 20.0 and nir < 0.2 * white


@pytest.mark.slow
def test_skin_without_blood_keeps_its_ridges_and_loses_its_red(presented):
    (pale, truth), (capture, live) = presented["bloodless"], presented["live"]
    inside = truth["mask"]
    assert np.allclose(truth["relief_um"], live["relief_um"], atol=1e-3)

    def red_over_green(presented_capture):
        return np.median(presented_capture.bands["white"].pixels[..., 0][:, inside]) / np.median(
            presented_capture.bands["white"].pixels[..., 1][:, inside]
        )

    assert red_over_green(pale) < 0.9 * red_over_green(capture)


def test_what_is_no_species_or_cannot_be_shown_is_refused():
    assert len(SPECIES) == 12
    with pytest.raises(BadInput, match="photo-matt"):
        simulate_attack(1, "jelly", SETTINGS)
    with pytest.raises(BadInput, match="still"):
        simulate_attack(1, "latex", twin_settings(0.08, {"motion.amplitude_mm": 0.1}))
