"""Films before LEDs and camera: Fresnel's published values, Malus's law, energy, and captures of
the twin."""

from __future__ import annotations

import numpy as np
import pytest

import splitknit_simulator
from splitknit.errors import BadInput
from splitknit.nominal import default_rig
from splitknit_simulator.light.films import FilmSettings, fresnel_amplitudes, mounted_films
from splitknit_simulator.light.skin import fresnel
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import lay_down

UP = (0.0, 0.0, 1.0)
EXACT = {
    "scale": 0.08,
    "sensor.noise": False,
    "sensor.bits": 16,
    "sensor.raw_bits": 16,
    "background.ambient": 0.0,
}


def ray(slant_deg: float, azimuth_deg: float = 0.0) -> tuple[float, float, float]:
    slant, azimuth = np.deg2rad([slant_deg, azimuth_deg])
    return tuple(
        np.array([np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.cos(slant)])
    )


def mounted(**settings: float):
    films = FilmSettings("analyser", **({"extinction": 1e9} | settings))
    return mounted_films(films, default_rig().leds[:7], np.random.default_rng(1))


@pytest.mark.parametrize(
    ("angle_deg", "across", "along"),
    # glass of 1.52 in air (Born and Wolf, Principles of Optics, section 1.5.3): 4.3 % along the
    # normal; nothing along the plane of incidence at 56 deg 40', where it is ((n n - 1) / (n n +
    # 1))^2 across; at 45 deg the one is the square of the other; all at grazing incidence
    [(0.0, 0.0426, 0.0426), (56.667, 0.1568, 0.0), (45.0, 0.0967, 0.0967**2), (89.9999, 1.0, 1.0)],
)
def test_fresnel_reflectances_agree_with_published_values(angle_deg, across, along):
    s, p = fresnel_amplitudes(np.cos(np.deg2rad(angle_deg)), 1.52)
    assert (float(s**2), float(p**2)) == (
        pytest.approx(across, abs=2e-4),
        pytest.approx(along, abs=2e-4),
    )
    assert s < 0
    assert 0.5 * (s**2 + p**2) == pytest.approx(float(fresnel(np.cos(np.deg2rad(angle_deg)), 1.52)))


def test_crossed_films_block_a_mirror_and_misalignment_leaks_by_malus_s_law():
    straight = mounted()
    assert straight.specular(0, 0, UP, UP) == pytest.approx(0.5)
    assert float(straight.specular(1, 0, UP, UP)) < 1e-8
    for off in (1.0, 3.0):
        films = mounted(misalignment_deg=off)
        angle = films.analyser_rad[1] - films.polariser_rad[1, 2]
        assert float(films.specular(1, 2, UP, UP)) == pytest.approx(
            0.5 * np.cos(angle) ** 2, rel=1e-5
        )
        assert np.rad2deg(np.abs(films.polariser_rad)).max() <= off
        assert films.analyser_rad[0] == pytest.approx(np.deg2rad(off))
    assert float(mounted(extinction=100.0).specular(1, 0, UP, UP)) == pytest.approx(0.01, rel=1e-6)


def pixels(settings, seed=1):
    capture, truth = splitknit_simulator.simulate_capture(seed, "whorl", EXACT | settings)
    return (
        {name: band.pixels.astype(np.float64) for name, band in capture.bands.items()},
        capture,
        truth,
    )


@pytest.fixture(scope="module")
def unpolarised():
    return pixels({})


@pytest.mark.parametrize("kind", ["analyser", "leds"])
def test_the_mean_of_both_series_equals_the_unpolarised_capture(unpolarised, kind):
    polarised, capture, truth = pixels(
        {"films.kind": kind, "films.kept": 0.3, "films.transmission": (0.8, 0.8, 0.6)}
    )
    plain, inside = unpolarised[0]["white"], truth["mask"]
    mean = (polarised["white"] + polarised["white_crossed"]) / 2 / [1.0, 1.0, (0.6 / 0.8) ** 2]
    # s and p reflectance are not the same: a few per cent of the specular reflection; neighbours
    # stand elsewhere
    ratio = (mean / np.maximum(plain, 1.0))[:, inside & (plain.min(axis=(0, 3)) > 1000)]
    np.testing.assert_allclose(np.median(ratio, axis=(0, 1)), 1.0, atol=2e-3)
    assert np.percentile(np.abs(ratio - 1), 95) < (0.02 if kind == "analyser" else 0.06)
    np.testing.assert_array_equal(polarised["nir"], unpolarised[0]["nir"])
    assert truth["exposure_white"] == truth["exposure_white_crossed"]
    assert [capture.bands[name].polarisation for name in ("white", "white_crossed", "nir")] == [
        "parallel", "crossed", "",
    ]  # fmt: skip


def test_the_difference_of_the_series_is_the_specular_reflection(unpolarised):
    polarised, _, truth = pixels(
        {"films.kind": "analyser", "films.kept": 0.0, "films.extinction": 1e6}
    )
    inside, full = truth["mask"], 65535.0
    difference = (polarised["white"] - polarised["white_crossed"])[..., 1] / full
    expected = truth["glare_white"].astype(np.float64) - truth["glare_white_crossed"]
    assert np.abs(difference - expected)[:, inside].max() < 2e-3
    ratio = truth["glare_white"][:, inside].sum() / unpolarised[2]["glare_white"][:, inside].sum()
    assert ratio == pytest.approx(2.0, rel=0.02)
    assert truth["glare_white_crossed"].max() < 0.01 * truth["glare_white"].max()


def test_the_crossed_series_has_neighbouring_leds_of_its_own():
    _, capture, _ = pixels({"films.kind": "leds"})
    white, crossed = (capture.bands[name].leds for name in ("white", "white_crossed"))
    assert (white, crossed) == (tuple((k,) for k in range(7)), tuple((k,) for k in range(14, 21)))
    places = np.array([capture.rig.leds[k].position_mm for k in (0, 14)])
    assert np.linalg.norm(places[1] - places[0]) == pytest.approx(6.0, rel=0.01)


@pytest.mark.slow
def test_a_shift_by_the_film_moves_the_crossed_series_only():
    plain, _, _ = pixels({"films.kind": "analyser"})
    shifted, _, _ = pixels({"films.kind": "analyser", "films.shift_px": 2.0})
    np.testing.assert_array_equal(plain["white"], shifted["white"])
    assert np.abs(plain["white_crossed"] - shifted["white_crossed"]).max() > 500


@pytest.mark.slow
def test_motion_includes_the_time_between_the_series():
    _, capture, truth = pixels({"films.kind": "analyser", "motion.amplitude_mm": 0.2})
    assert list(capture.bands) == ["white", "white_crossed", "nir"]
    assert truth["motion_shift_mm"].shape == (21, 2)
    assert truth["exposure_white"] == truth["exposure_white_crossed"]


def test_films_with_mirrors_or_coloured_leds_are_refused():
    with pytest.raises(BadInput, match=r"without films; leave out mirrors"):
        pixels({"films.kind": "leds", "mirrors.names": ("left",)})
    with pytest.raises(BadInput, match=r"films\.kept must be from 0 to 1"):
        FilmSettings(kept=1.5)
    from splitknit_simulator.rigs import coloured_rig

    coloured = TwinSettings(rig=coloured_rig(0.08, 0), films=FilmSettings("analyser"))
    with pytest.raises(BadInput, match="leave out coloured LEDs"):
        splitknit_simulator.simulate_capture(1, settings=coloured)


def test_without_films_the_rig_gets_no_further_leds():
    assert len(lay_down(1, "whorl", TwinSettings(scale=0.08))[1].rig.leds) == 14
