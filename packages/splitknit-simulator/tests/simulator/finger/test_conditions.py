"""Wet, dry, dusty, scarred and glossy fingers of the twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.model import Camera, default_rig
from splitknit_simulator.finger.conditions import (
    KINDS,
    Condition,
    _dried,
    _ridge_angle,
    _scale_reflectance,
    _scarred,
    _water_level,
    _water_surface,
    conditioned_surface,
)
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.finger.master_print import MasterPrintSettings, master_print
from splitknit_simulator.light.coat import (
    DENSITY_MG_PER_MM3,
    _reflected,
    _sphere_brightness,
    draw_grains,
    stamp,
)
from splitknit_simulator.light.renderer import RenderSettings, render_band
from splitknit_simulator.light.skin import Medium, SkinOptics, fresnel
from splitknit_simulator.surface import WATER, Coat, Film, Grains
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


def test_a_coat_of_nothing_changes_nothing(egg):
    bare, coated = _render(egg), _render(_coated(egg))
    np.testing.assert_allclose(coated.diffuse, bare.diffuse, rtol=2e-5, atol=1e-7)
    np.testing.assert_allclose(coated.glare, bare.glare, rtol=1e-3, atol=1e-6)


def test_a_renderer_takes_the_coat_by_itself(egg):
    wet = _coated(egg, roughness=np.full(egg.mask.shape, 0.6, dtype=np.float32))
    leds = [default_rig(0.25).leds[0]]
    optics = [SKIN.channel("blue")] * 3
    found = render_band(wet, leds, Medium(optics, 0.25, 1.0))
    assert found.glare.max() < 0.5 * _render(egg, leds, glare=1.0).glare.max()


def test_conditions_are_checked():
    with pytest.raises(BadInput, match=r"one of none, wet, dry"):
        Condition("muddy")
    with pytest.raises(BadInput, match=r"severity must be from 0 to 1, but it is 1\.5"):
        Condition("wet", 1.5)
    assert not Condition("wet", 0.0).active and not Condition().active and Condition("dry", 0.1).active


def test_two_roughnesses_keep_their_energy_and_reciprocity():
    rng = np.random.default_rng(0)
    normal = tuple(np.full(1, v) for v in (0.0, 0.0, 1.0))
    along = tuple(np.full(1, v) for v in (1.0, 0.0, 0.0))

    def unit(x, y, z):
        return tuple(np.atleast_1d(v) / np.sqrt(x * x + y * y + z * z) for v in (x, y, z))

    light, view = unit(0.3, 0.2, 1.0), unit(-0.1, 0.5, 0.9)
    shape = {"index": 1e6, "along": along, "roughness_along": 0.1}
    there = _reflected(normal, light, view, 0.3, **shape) / light[2]
    back = _reflected(normal, view, light, 0.3, **shape) / view[2]
    np.testing.assert_allclose(there, back, rtol=1e-6)
    # a mirror (index without end) with two roughnesses reflects nearly all of a beam that falls on it
    z = rng.random(400_000)
    turn = 2 * np.pi * rng.random(z.size)
    out = (np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z)
    radiance = _reflected(normal, tuple(np.full(1, v) for v in (0.0, 0.0, 1.0)), out, 0.3, **shape)
    assert 0.93 < 2 * np.pi * float(np.mean(radiance * z)) < 1.01


def test_two_roughnesses_follow_the_papers():
    ax, ay = 0.1, 0.4
    light, view = np.array([0.5, 0.1, 0.86]), np.array([0.2, -0.6, 0.77])
    light, view = light / np.linalg.norm(light), view / np.linalg.norm(view)
    x, y, z = (light + view) / np.linalg.norm(light + view)
    spread = 1 / (np.pi * ax * ay * ((x / ax) ** 2 + (y / ay) ** 2 + z**2) ** 2)
    seen = [2 / (1 + np.sqrt(1 + ((ax * d[0]) ** 2 + (ay * d[1]) ** 2) / d[2] ** 2)) for d in (light, view)]
    mirrors = fresnel(np.array([np.dot(light, (x, y, z))]), 1.42)[0]
    wanted = spread * seen[0] * seen[1] * mirrors / (4 * view[2])
    parts = [tuple(np.full(1, v) for v in vector) for vector in ((0, 0, 1.0), light, view, (1.0, 0, 0))]
    found = _reflected(parts[0], parts[1], parts[2], ay, index=1.42, along=parts[3], roughness_along=ax)
    assert found[0] == pytest.approx(wanted, rel=1e-6)


def test_equal_roughnesses_have_no_direction():
    normal = tuple(np.full(1, v) for v in (0.1, 0.0, np.sqrt(0.99)))
    along = tuple(np.full(1, v) for v in (0.0, 1.0, 0.0))
    light, view = (np.full(1, 0.3), np.full(1, 0.1), np.full(1, 0.9487)), tuple(np.full(1, v) for v in (0.0, 0.0, 1.0))
    plain = _reflected(normal, light, view, 0.2, index=1.42)
    np.testing.assert_allclose(
        plain, _reflected(normal, light, view, 0.2, index=1.42, along=along, roughness_along=0.2)
    )
    wide = _reflected(normal, light, view, 0.2, index=1.42, along=along, roughness_along=0.02)
    assert abs(float(wide[0] / plain[0]) - 1) > 0.2


def test_water_lies_on_the_skin_and_bridges_valleys_in_arcs():
    u = 0.02 * np.arange(600)
    valleys = np.repeat(-0.03 * (1 - np.cos(2 * np.pi * u / 0.44))[None, :], 8, axis=0)
    levels = [_water_surface(valleys, 0.02, severity) for severity in (0.4, 0.5)]
    for level in levels:
        assert (level >= valleys - 1e-12).all()
    thickness = [float((level - valleys).mean()) for level in levels]
    assert 0 < thickness[0] < thickness[1] < 0.03
    middle = levels[0][4, 22 * 8 : 22 * 12]
    bend = np.diff(middle, 2) / 0.02**2
    inside = (middle - valleys[4, 22 * 8 : 22 * 12])[1:-1] > 2e-3
    np.testing.assert_allclose(np.median(bend[inside]), 1 / (0.05 * 40**0.4), rtol=0.05)
    closed = _water_level(valleys, 0.02, 1.0, np.random.default_rng(0))
    assert float(np.ptp(closed[:, 100:-100])) < 1e-3  # a film over the ridges levels out
    assert float((closed - valleys).min()) > 5e-3


def test_half_of_the_skin_is_wet_at_a_quarter():
    valleys = np.repeat(-0.03 * (1 - np.cos(2 * np.pi * np.arange(700) / 11))[None, :], 700, axis=0)
    level = _water_level(valleys, 0.04, 0.25, np.random.default_rng(1))
    full = _water_surface(valleys, 0.04, 0.25)
    deep = full - valleys > 1e-3
    assert 0.35 < float(((level - valleys)[deep] > 0.5 * (full - valleys)[deep]).mean()) < 0.65


def test_light_bends_towards_the_normal_under_water(egg):
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
    mirrors = fresnel(np.ones(1), WATER)[0] / (0.8 * fresnel(np.ones(1), 1.42)[0])
    assert top == pytest.approx(mirrors * (0.25 / 0.05) ** 2, rel=0.4)


def test_grains_have_the_mass_that_was_asked_for():
    mask = np.ones((600, 500), dtype=np.bool_)
    flat = np.ones(mask.shape, dtype=np.float32)
    camera = Camera(40.0, mask.shape)
    grains = draw_grains(np.random.default_rng(4), mask, flat, camera, 0.5)
    volume = np.pi / 6 * np.sum((2 * grains.radius_px / 40.0) ** 3)
    mg_per_cm2 = volume * DENSITY_MG_PER_MM3 / (mask.size / 40.0**2 / 100)
    assert mg_per_cm2 == pytest.approx(0.32, rel=0.12)  # what is larger than 0.25 mm does not stick
    twice = draw_grains(np.random.default_rng(4), mask, 0.5 * flat, camera, 0.5)
    assert len(twice.row) == pytest.approx(2 * len(grains.row), rel=0.05)


def test_discs_keep_their_areas():
    radius = np.array([0.2, 0.9, 4.0])
    drawn = stamp(
        (60, 80), np.array([20.3, 40.0, 60.6]), np.array([30.0, 20.4, 40.2]), radius, np.array([1.0, 2.0, 0.5])
    )
    total = np.pi * radius**2 * [1.0, 2.0, 0.5]
    assert drawn.sum() == pytest.approx(total.sum())
    assert drawn[40, 60] == pytest.approx(0.5, rel=0.03)
    assert stamp((9, 9), np.empty(0), np.empty(0), np.empty(0)).sum() == 0
    np.testing.assert_allclose(_sphere_brightness(np.array([0.0, np.pi])), [2 / 3, 0.0], atol=1e-6)


def test_grains_hide_the_skin_and_shade_it(egg):
    one = Grains(np.array([85.0]), np.array([90.0]), np.array([4.0]), np.array([0.0]))
    fraction = np.zeros(egg.mask.shape, dtype=np.float32)
    dusty, bare = _render(_coated(egg, fraction=fraction, grains=one)), _render(egg)
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
    np.testing.assert_allclose(gain[inside][:, 0], gain[inside][:, 2], rtol=0.02, atol=1e-4)
    assert (gain[inside] > 0).all()
    assert _scale_reflectance(np.array([0.0, 1.0, 4.0])) == pytest.approx([0.0, 0.0889, 0.2807], rel=2e-3)


def test_dry_skin_is_lower_rougher_and_has_scales(master):
    relief = -0.065 * (1 - master.ridge.astype(np.float64))
    weak, strong = (_dried(relief, master, s, np.random.default_rng(2)) for s in (0.2, 1.0))
    assert strong.fraction.mean() > 2 * weak.fraction.mean() > 0
    assert 0.04 < strong.fraction.mean() < 0.5
    assert strong.reflectance is not None
    assert 0.08 < strong.reflectance.max() < 0.29
    fissured = relief - strong.displacement > 0.02
    assert 0.005 < fissured.mean() < 0.2


def test_scars_have_no_ridges_and_grow_with_the_severity(master):
    relief = -0.065 * (1 - master.ridge.astype(np.float64))
    fractions = []
    for severity in (0.1, 0.5, 1.0):
        scar = _scarred(relief, master, severity, np.random.default_rng(2))
        fractions.append(float(scar.fraction.mean()))
        inside = scar.fraction > 0.99
        if severity == 1.0:
            assert np.std(np.diff(scar.displacement, axis=1)[inside[:, 1:]]) < 0.15 * np.std(np.diff(relief, axis=1))
        np.testing.assert_array_equal(scar.displacement[(scar.fraction == 0)].size > 0, True)
    assert 0 < fractions[0] < fractions[1] < fractions[2] < 0.3


def test_the_ridges_direction_is_found(master):
    angle = _ridge_angle(master.ridge, 8.0)
    step = 3
    rows, columns = np.mgrid[60:400:37, 60:240:31]
    along = angle[rows, columns]
    here = master.ridge[rows, columns]
    there = master.ridge[
        np.rint(rows - step * np.sin(along)).astype(int), np.rint(columns + step * np.cos(along)).astype(int)
    ]
    across = master.ridge[
        np.rint(rows - step * np.cos(along)).astype(int), np.rint(columns - step * np.sin(along)).astype(int)
    ]
    assert np.mean(np.abs(there - here)) < 0.5 * np.mean(np.abs(across - here))


@pytest.mark.parametrize("kind", KINDS[1:])
def test_a_finger_in_every_condition(finger, kind):
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


def test_scars_stay_where_they_are_and_dust_does_not(finger):
    small = Camera(6.0, (130, 140))

    def fraction(kind, seed):
        surface = conditioned_surface(
            finger, POSE, small, SKIN, Condition(kind, 0.7), np.random.SeedSequence(seed), workers=1
        )
        return surface.coat.fraction

    np.testing.assert_array_equal(fraction("scarred", 1), fraction("scarred", 2))
    assert np.any(fraction("dusty", 1) != fraction("dusty", 2))
