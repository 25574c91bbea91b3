"""Constraints of rigs, at geometries that can be worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_rig.rig.candidates import (
    FULL_WELL_E,
    LAMPS,
    TARGET_LEVEL,
    BuildSettings,
    PhotonSettings,
    PrintPoints,
    RigCandidate,
    _glare_lobe_rad,
    _glaring,
    candidate_rig,
    electrons_per_s,
    examine,
    grid,
    intensity_w_sr,
    plan_exposure,
)

FLAT = PrintPoints(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
DOME = PrintPoints(
    np.array([[5.0 * x, 5.0 * y, 0.0] for x, y in ((0, 0), (1, 0), (-1, 0), (0, 1))]),
    np.array([[np.sin(0.4) * x, np.sin(0.4) * y, np.cos(0.4)] for x, y in ((0, 0), (1, 0), (-1, 0), (0, 1))]),
)
ORTHOGRAPHIC = BuildSettings(view="orthographic")
THESIS = RigCandidate(140.0, 52.5, 1.0)


def _found(candidate, build=ORTHOGRAPHIC, photons=None, finger=DOME):
    findings = examine(candidate, build, photons or PhotonSettings(), finger=finger)
    return {one.name: one for one in findings}


def test_the_thesis_rig_passes_everything():
    found = _found(THESIS, BuildSettings())
    assert all(one.ok for one in found.values())
    assert set(found) == {
        *("leds_in_view", "direct_light", "room", "printer", "beam", "glare", "exposure_white", "depth_of_field")
    }
    assert all(one.words.endswith(".") for one in found.values())


def test_leds_inside_the_field_stand_in_the_picture():
    # the field is 29.06 x 42.27 mm; seven LEDs, one of them on the x axis
    found = _found(replace(THESIS, radius_mm=23.0))["leds_in_view"]
    assert not found.ok and "in the picture" in found.words
    wide = _found(replace(THESIS, radius_mm=40.0))["leds_in_view"]
    assert wide.ok
    # a perspective camera's pyramid is narrow near the lens: the LEDs' lowest points lie 2.5 mm below it
    near = _found(replace(THESIS, radius_mm=23.0), BuildSettings())["leds_in_view"]
    assert near.ok
    assert near.value == pytest.approx(23.0 - 2.5 - 0.5 * 42.27 * 2.5 / 140.0, abs=0.1)
    # 100 mm below the lens it has 102.5 / 140 of its full breadth
    low = _found(replace(THESIS, radius_mm=17.0), BuildSettings(led_drop_mm=100.0))["leds_in_view"]
    assert not low.ok


def test_leds_below_the_lens_shine_into_it():
    assert _found(THESIS)["direct_light"].value == 0.0
    assert _found(THESIS, replace(ORTHOGRAPHIC, led_drop_mm=-5.0))["direct_light"].ok
    bare = BuildSettings(led_drop_mm=20.0, half_angle_deg=60.0)
    level = RigCandidate(140.0, 52.5, 1.0, tilt_deg=80.0)
    found = _found(level, bare)["direct_light"]
    away = np.hypot(52.5, 20.0)
    # beam 80 deg from the vertical, lens at atan(20 / 52.5) above the horizontal
    leaves = np.cos(np.deg2rad(10.0) + np.arctan2(20.0, 52.5))
    assert found.value == pytest.approx(20.0 / away * leaves**bare.lobe_exponent, rel=1e-6)
    assert not found.ok and "shine into it" in found.words


def test_room_and_printer():
    assert not _found(replace(THESIS, radius_mm=19.0), BuildSettings())["room"].ok
    assert _found(replace(THESIS, radius_mm=19.9), BuildSettings())["room"].ok
    assert _found(replace(THESIS, radius_mm=102.0))["printer"].ok
    assert not _found(replace(THESIS, radius_mm=102.1))["printer"].ok
    assert not _found(replace(THESIS, height_mm=251.0))["printer"].ok


def test_beam_must_meet_the_finger():
    centre = _found(THESIS)["beam"]
    assert centre.ok and centre.value == pytest.approx(1.0)
    off = _found(replace(THESIS, tilt_deg=-9.443))["beam"]  # 30 deg from the middle: half the light
    assert off.value == pytest.approx(0.5, abs=1e-3)
    lost = _found(replace(THESIS, tilt_deg=80.0))["beam"]
    assert not lost.ok and "tilt them by 21 deg" in lost.words


def test_glare_is_where_the_normal_halves_the_angle():
    # straight above a flat point, light from the angle t mirrors at t / 2
    lobe = _glare_lobe_rad(0.25)
    assert np.rad2deg(lobe) == pytest.approx(9.57, abs=0.01)
    radius = 140.0 * np.tan(2.0 * lobe)
    for factor, hit in ((0.98, True), (1.02, False)):
        candidate = replace(THESIS, radius_mm=radius * factor)
        leds = list(candidate_rig(candidate, ORTHOGRAPHIC, {"white": 1.0}).leds)
        assert bool(_glaring(leds, candidate, ORTHOGRAPHIC, 0.25, FLAT).all()) is hit
        assert bool(_glaring(leds, candidate, ORTHOGRAPHIC, 0.25, FLAT).any()) is hit
    found = _found(replace(THESIS, radius_mm=0.9 * radius), finger=FLAT)["glare"]
    assert not found.ok and found.value == 1.0 and "100 % of it" in found.words
    assert _found(replace(THESIS, radius_mm=1.1 * radius), finger=FLAT)["glare"].ok


def test_glare_lobe_is_half_the_distribution():
    alpha, angle = 0.3, _glare_lobe_rad(0.3)

    def ggx(theta):
        return alpha**2 / (np.pi * (np.cos(theta) ** 2 * (alpha**2 - 1) + 1) ** 2)

    assert ggx(angle) == pytest.approx(0.5 * ggx(0.0))


def test_exposure_follows_from_photons():
    photons = PhotonSettings()
    found = _found(THESIS)["exposure_white"]
    # by hand: flux, intensity, irradiance under one LED at the finger, radiance, sensor, electrons
    m = np.log(0.5) / np.log(np.cos(np.deg2rad(30.0)))
    intensity = 1.0 * 0.31 * (m + 1) / (2 * np.pi)
    assert intensity_w_sr(1.0, LAMPS["white"], m) == pytest.approx(intensity)
    squared = 0.14**2 + 0.0525**2
    radiance = 0.6 / np.pi * intensity / squared * 0.14 / np.sqrt(squared)
    working = 4.0 * (1.0 + 1.12e-3 * 75.7)
    watts = np.pi * radiance * 0.9 / (4.0 * working**2) * (1.12e-6) ** 2
    rate = watts / (6.62607e-34 * 2.99792e8 / 560e-9) * 0.22
    assert electrons_per_s(radiance, LAMPS["white"], photons) == pytest.approx(rate, rel=1e-4)
    assert found.value == pytest.approx(0.7)
    assert 0.7 * 4700 / rate == pytest.approx(0.05, rel=0.2), "about a twentieth of a second at 1 W"
    assert "ms at gain 1 " in found.words
    dark = _found(replace(THESIS, power_w=0.001))["exposure_white"]
    assert not dark.ok and "too dark" in dark.words
    bright = _found(replace(THESIS, power_w=100.0), photons=replace(photons, shortest_s=0.01))["exposure_white"]
    assert not bright.ok and "too bright" in bright.words and bright.value > 1.0


def test_shutter_before_gain_before_darkness():
    photons = PhotonSettings()
    full = TARGET_LEVEL * FULL_WELL_E
    assert plan_exposure(full / 0.1, photons).time_s == pytest.approx(0.1)
    assert plan_exposure(full / 0.1, photons).gain == 1.0
    amplified = plan_exposure(full / 0.8, photons)
    assert (amplified.time_s, amplified.gain) == pytest.approx((0.2, 4.0)) and amplified.level == pytest.approx(0.7)
    dark = plan_exposure(full / 16.0, photons)
    assert (dark.time_s, dark.gain, dark.level) == pytest.approx((0.2, 8.0, 0.07))
    assert plan_exposure(1e9, photons).level > 1.0
    with pytest.raises(BadInput, match="no light"):
        plan_exposure(0.0, photons)


def test_depth_of_field_drops_the_height_and_follows_the_stop():
    photons = PhotonSettings()
    assert photons.focal_mm(140.0) == pytest.approx(10.94, abs=0.01)  # the reading notes' 11 mm
    # reading notes: about 1.4 mm at f/2 for a circle of two pixels
    assert replace(photons, f_number=2.0).depth_of_field_mm(2.0 / 75.7) == pytest.approx(1.35, abs=0.02)
    shallow = _found(THESIS, photons=replace(photons, f_number=1.0), finger=PrintPoints(np.eye(3) * 9, np.eye(3)))
    assert not shallow["depth_of_field"].ok and not shallow["depth_of_field"].hard


def test_grid_names_and_bad_candidates():
    rigs = grid((100.0, 140.0), (50.0,), (1.0, 1.0), (None, 20.0), (8.0,))
    assert len(rigs) == 4 and len({one.name for one in rigs}) == 4
    assert rigs[0].name == "h100_r50_p1_tcentre_s8"
    with pytest.raises(BadInput, match="radii_mm is empty"):
        grid((100.0,), (), (1.0,))
    for wrong in ({"height_mm": -1.0}, {"power_w": 0.0}, {"radius_mm": float("nan")}, {"tilt_deg": 95.0}):
        with pytest.raises(BadInput, match=next(iter(wrong))):
            replace(THESIS, **wrong)


def test_beams_are_tilted_towards_the_axis():
    rig = candidate_rig(replace(THESIS, tilt_deg=20.0), BuildSettings(), {"white": 0.3, "nir": 0.2})
    assert [led.band for led in rig.leds] == ["white"] * 7 + ["nir"] * 7
    for led in rig.leds:
        x, y, z = led.position_mm
        assert np.hypot(x, y) == pytest.approx(52.5) and z == 140.0
        assert np.rad2deg(np.arccos(-led.axis[2])) == pytest.approx(20.0)
        assert led.axis[0] * x + led.axis[1] * y < 0.0
    aimed = candidate_rig(THESIS, BuildSettings(), {"white": 0.3})
    np.testing.assert_allclose(aimed.leds[0].axis, -np.array([52.5, 0, 140.0]) / np.hypot(52.5, 140.0), atol=1e-12)
    assert BuildSettings(half_angle_deg=60.0).lobe_exponent == pytest.approx(1.0)
    assert BuildSettings(half_angle_deg=90.0).lobe_exponent == 0.0
