"""The reference of whole fingers: flat skin against the table of walks, conservation of energy, the
same bytes."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from script_folder import VALIDATION
from splitknit.errors import BadInput
from splitknit.model import Camera, Led, Rig
from splitknit_simulator.light.films import FilmSettings
from splitknit_simulator.light.skin import (
    REFRACTIVE_INDEX,
    diffuse_transmittance,
    diffusion_profile,
    fresnel,
)
from splitknit_simulator.surface import SimulatedSurface

sys.path.append(str(VALIDATION / "path_traced"))
finger: Any = importlib.import_module("walked_finger")
FingerOptics, photograph_finger, specular = (
    finger.FingerOptics,
    finger.photograph_finger,
    finger.specular,
)

needs_numba = pytest.mark.skipif(
    importlib.util.find_spec("numba") is None, reason="needs numba (group 'reference')"
)
LEDS = (Led("white", position_mm=(52.5, 0.0, 140.0)), Led("white", position_mm=(0.0, 0.0, 140.0)))
STRENGTH = 1e4 / np.array([52.5**2 + 140.0**2, 140.0**2])
COSINE = np.array([140.0 / np.hypot(52.5, 140.0), 1.0])
ENTERING = STRENGTH * COSINE * (1 - fresnel(COSINE))
TO_CAMERA = (1 - float(fresnel(np.array(1.0)))) / np.pi


def patch(height_mm: np.ndarray, pitch_mm: float = 0.05) -> SimulatedSurface:
    """A piece of skin that fills the picture, over a flat shape."""
    rows, columns = np.gradient(height_mm, pitch_mm)
    normals = np.stack([-columns, rows, np.ones_like(rows)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    up, ones = (
        np.zeros((*height_mm.shape, 3), dtype=np.float32),
        np.ones(height_mm.shape, dtype=np.float32),
    )
    up[..., 2] = 1.0
    height = height_mm.astype(np.float32)
    camera = Camera(1.0 / pitch_mm, height_mm.shape)
    return SimulatedSurface(
        camera, height, 0 * ones, normals.astype(np.float32), up, 1e3 * height, ones > 0, ones
    )


FLAT = patch(np.zeros((24, 24)))
EVEN = FingerOptics(mottle=0.0, epidermis_mm=0.0)


def medium(
    scattering_per_mm: float, absorption_per_mm: float, spread: float = 1.0, pitch_mm: float = 0.05
):
    """What the kernels know of the skin."""
    inside = 1.0 - diffuse_transmittance() / REFRACTIVE_INDEX**2
    scattering, absorption = scattering_per_mm * pitch_mm, absorption_per_mm * pitch_mm
    return np.array(
        [scattering, absorption, absorption, 0.0, spread, 0.15, REFRACTIVE_INDEX, inside]
    )


def walked(
    surface: SimulatedSurface, optics: np.ndarray, walks: float = 100.0, threads: int = 1
) -> np.ndarray:
    """Mean radiance under both lights."""
    solid = finger.solid_of(surface, LEDS)
    even = np.ones(solid.lean.shape, dtype=np.float32)
    light = finger.walk_solid(
        solid, surface, even, optics, walks=walks, rays=64, threads=threads, seed=[1]
    )
    return light.radiance.mean(axis=(1, 2), dtype=np.float64)


@pytest.fixture(autouse=True)
def _many_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(finger, "RAYS", 4)


@needs_numba
@pytest.mark.parametrize(("scattering", "absorption"), [(5.18, 0.40), (2.0, 0.1)])
def test_flat_skin_with_a_diffuse_boundary_agrees_with_the_table_of_walks(scattering, absorption):
    albedo = diffusion_profile(scattering, absorption).albedo
    expected = albedo * ENTERING * TO_CAMERA / diffuse_transmittance()
    np.testing.assert_allclose(walked(FLAT, medium(scattering, absorption)), expected, rtol=0.02)


@needs_numba
def test_light_scattered_once_is_that_of_a_half_space_that_scatters_once():
    scattering, absorption = 4.0, 1.0
    solid, even = finger.solid_of(FLAT, LEDS), np.ones((24, 24), dtype=np.float32)
    optics = medium(scattering, absorption, spread=0.0)
    optics[5] = 0.0  # no micro-facets
    walked = finger.walk_solid(
        solid, FLAT, even, optics, walks=1.0, rays=200, threads=1, seed=[1], entering=6
    )
    # Chandrasekhar 1960, Radiative Transfer, section 47
    inside = np.sqrt(1 - (1 - COSINE**2) / REFRACTIVE_INDEX**2)
    once = (
        0.8
        / (4 * np.pi)
        * ENTERING
        * (1 - float(fresnel(np.array(1.0))))
        / REFRACTIVE_INDEX**2
        / (inside + 1)
    )
    np.testing.assert_allclose(walked.once.mean(axis=(1, 2), dtype=np.float64), once, rtol=0.03)
    assert (walked.once <= walked.radiance).all()


@needs_numba
def test_films_part_a_finger_into_a_parallel_and_a_crossed_series():
    ridges = patch(np.broadcast_to(0.03 * np.cos(np.arange(40) * 0.7), (40, 40)))
    leds = tuple(replace(led, band=band) for band in ("white", "nir") for led in LEDS)
    optics = FingerOptics(spread=0.0, shot_noise=0.0, roughness=0.3)
    rig = Rig(ridges.camera, leds)
    light = finger.walk_finger(ridges, rig, optics, walks=2.0, rays=2, threads=1)
    series = {}
    for kept in (0.0, 0.4):
        films = FilmSettings("analyser", extinction=1e6, kept=kept, transmission=(1.0, 1.0, 0.9))
        capture, _, info = photograph_finger(ridges, rig, optics, light=light, films=films)
        assert [band.polarisation for band in capture.bands.values()] == ["parallel", "crossed", ""]
        parallel, crossed = (
            capture.bands[name].pixels.astype(float) for name in ("white", "white_crossed")
        )
        assert info["films"]["kept"] == kept
        series[kept] = parallel - crossed, parallel + crossed
    # without it the difference is white but for the tint; with it, the skin's colour is in it as
    # well
    shine = series[0.0][0].mean(axis=(0, 1, 2))
    assert shine / shine[0] == pytest.approx([1.0, 1.0, 0.81], rel=0.01)
    assert (
        series[0.4][0].sum() / series[0.4][1].sum()
        > 1.05 * series[0.0][0].sum() / series[0.0][1].sum()
    )


def test_regression_takes_noise_away_and_keeps_what_the_relief_explains():
    rng = np.random.default_rng(1)
    ridges = patch(np.broadcast_to(0.03 * np.cos(np.arange(80) * 0.7), (60, 80)))
    shading = 1.0 + 0.3 * ridges.normals[..., 0] + 2.0 * ridges.height_mm
    clean = np.repeat((0.1 * shading[None, ..., None]).astype(np.float32), 7, axis=0)
    clean *= np.linspace(0.8, 1.2, 7, dtype=np.float32)[:, None, None, None]
    # common to all lights
    noisy = clean * (1.0 + 0.04 * rng.standard_normal((1, 60, 80, 1))).astype(np.float32)
    light = finger.FingerLight({"white": noisy}, {"white": noisy}, {})
    smoothed = finger.without_walk_noise(light, ridges).diffuse["white"]
    kept = finger.without_walk_noise(replace(light, diffuse={"white": clean}), ridges).diffuse[
        "white"
    ]
    assert np.std(smoothed / clean) < 0.25 * np.std(noisy / clean)
    np.testing.assert_allclose(kept, clean, rtol=2e-3)


@needs_numba
def test_without_absorption_all_light_comes_out_again_as_from_a_matt_surface():
    # a slab of 12 mm: what leaves below is some 0.6 %, three mean free paths over 12 mm
    expected = ENTERING * TO_CAMERA / diffuse_transmittance()
    np.testing.assert_allclose(walked(FLAT, medium(40.0, 0.0), 10.0), expected, rtol=0.02)


@needs_numba
def test_a_steep_side_is_lit_as_walks_in_an_elliptic_cylinder_say():
    # radiance at x = 0, 5.55 and -7.4 mm (slant 0, 33 and 58 deg) under a light of +x:
    # random walks, 200,000 each (validation/twin)
    pitch_mm = 0.1
    x = (np.arange(221) - 110.0) * pitch_mm
    inside = np.broadcast_to(np.abs(x) < 8.0, (40, 221))
    z = np.broadcast_to(5.5 * np.sqrt(np.clip(1.0 - (x / 8.0) ** 2, 1e-9, 1.0)), (40, 221))
    height = np.where(inside, z, np.nan).astype(np.float32)
    slope = np.where(inside, x * 5.5**2 / 8.0**2 / z, 0.0)
    normals = (
        np.stack([slope, 0 * slope, np.ones_like(slope)], axis=-1) / np.hypot(1.0, slope)[..., None]
    )
    shape_normals = np.where(inside[..., None], normals, 0.0).astype(np.float32)
    camera = Camera(1.0 / pitch_mm, (40, 221))
    cylinder = replace(
        patch(np.zeros((40, 221)), pitch_mm),
        camera=camera,
        height_mm=height,
        shape_mm=height,
        normals=shape_normals,
        shape_normals=shape_normals,
        mask=inside,
    )
    solid = finger.solid_of(cylinder, LEDS)
    even = np.ones(solid.lean.shape, dtype=np.float32)
    light = (
        finger.walk_solid(
            solid,
            cylinder,
            even,
            medium(4.1237, 0.2, pitch_mm=pitch_mm),
            walks=20.0,
            rays=10,
            threads=1,
            seed=[5],
        )
        .radiance[0]
        .mean(axis=0)
    )
    sampled = np.interp([0.0, 5.55, -7.4], x, light)
    np.testing.assert_allclose(sampled[:2], [0.05918, 0.06218], rtol=0.03)
    # a twelfth of the light, on pixels of 0.1 mm
    np.testing.assert_allclose(sampled[2], 0.00491, rtol=0.08)


@needs_numba
def test_same_seed_same_bytes_whatever_the_number_of_threads():
    ridges = patch(np.broadcast_to(0.04 * np.cos(np.arange(40) * 0.7), (40, 40)))
    optics = FingerOptics(spread=0.4)
    lights = [
        finger.render_finger(
            ridges, LEDS, "green", optics, walks=4.0, rays=2, threads=threads, seed=seed
        ).halves.tobytes()
        for threads, seed in ((1, 3), (2, 3), (1, 4))
    ]
    assert lights[0] == lights[1]
    assert lights[0] != lights[2]


@needs_numba
def test_a_photograph_has_both_bands_and_its_truth():
    y, x = np.mgrid[-30:30, -30:30] * 0.2
    inside = x**2 + y**2 < 5.0**2
    dome = patch(np.where(inside, np.sqrt(np.maximum(30.0 - x**2 - y**2, 0.1)) - 5.0, 0.0), 0.2)
    nan = np.where(inside, dome.height_mm, np.nan).astype(np.float32)
    dome = replace(dome, mask=inside, height_mm=nan, shape_mm=nan)
    leds = tuple(
        Led(band, position_mm=(float(52.5 * np.cos(a)), float(52.5 * np.sin(a)), 140.0))
        for band in ("white", "nir")
        for a in (0.0, 2.1, 4.2)
    )
    capture, truth, info = photograph_finger(
        dome,
        Rig(dome.camera, leds),
        FingerOptics(spread=0.5, gloss=0.5),
        walks=1.0,
        rays=1,
        threads=1,
    )
    assert {name: band.pixels.shape for name, band in capture.bands.items()} == {
        "white": (3, 60, 60, 3),
        "nir": (3, 60, 60, 3),
    }
    assert capture.bands["white"].pixels.dtype == np.uint16
    assert (
        capture.bands["white"].pixels[0][inside].mean()
        > 10 * capture.bands["white"].pixels[0][~inside].mean()
    )
    np.testing.assert_array_equal(truth["ridge_mm"][inside], 0.0)
    assert set(info["channels"]) == {"red", "green", "blue", "nir"}


def test_specular_reflection_of_a_level_surface_follows_the_microfacet_formula():
    half = (
        np.array([0.0, 0.0, 1.0])
        + np.array(LEDS[0].position_mm) / np.linalg.norm(LEDS[0].position_mm)
    ) / 2
    n_h = half[2] / np.linalg.norm(half)
    spread = 0.25**2 / (np.pi * (n_h**2 * (0.25**2 - 1) + 1) ** 2)
    one_way = 2 * COSINE[0] / (COSINE[0] + np.sqrt(0.25**2 + (1 - 0.25**2) * COSINE[0] ** 2))
    expected = STRENGTH[0] * spread * one_way * float(fresnel(np.array(n_h))) / 4
    np.testing.assert_allclose(specular(FLAT, LEDS[0], 0.25)[11:13, 11:13], expected, rtol=5e-3)


def test_missing_numba_is_refused_with_a_remedy(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    with pytest.raises(BadInput, match="the dependency group 'reference'"):
        finger.render_finger(FLAT, LEDS, "red", EVEN)


def test_drawn_fingers_have_all_boundaries_and_are_repeated() -> None:
    make: Any = importlib.import_module("make")
    cases = make.drawn_cases(5, 7)
    assert [case.optics.spread for case in cases] == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert cases == make.drawn_cases(5, 7) and cases != make.drawn_cases(5, 8)
    assert all(case.films is None and 25 <= case.ridge_um <= 90 for case in cases)
