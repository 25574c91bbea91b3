"""Photometric stereo of two-layer skin: what it recovers, and that it finds the minimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skin_ball import EQUAL, THIN, ball, ring
from splitknit.errors import BadInput
from splitknit.imaging import chunks
from splitknit.model import Camera, Led, Rig
from splitknit.photometric.hanrahan_krueger import hanrahan_krueger, hanrahan_krueger_near
from splitknit.photometric.hanrahan_krueger_fit import HanrahanKruegerSettings, LevenbergSettings, reflected
from splitknit.photometric.lambertian import lambertian


def error_deg(got, normals, mask):
    return np.degrees(np.arccos(np.clip((got * normals).sum(axis=-1), -1, 1)))[mask]


def test_normals_of_its_own_skin_are_recovered():
    lights = ring() * np.linspace(0.9, 1.1, 7)[:, None]
    stack, normals, mask = ball(lights)
    plain = error_deg(lambertian(stack, lights, mask)[0], normals, mask)
    got, albedo, fit = hanrahan_krueger(stack, lights, mask, replace(EQUAL, layers=THIN))
    error = error_deg(got, normals, mask)
    assert plain.mean() > 1.0
    assert error.mean() < 0.05 * plain.mean()
    assert np.abs(albedo[mask] / 0.5 - 1).mean() < 0.02
    assert fit.converged[mask].mean() > 0.99
    assert np.nanmedian(fit.misfit) < 1e-3
    assert np.isnan(albedo[~mask]).all()
    assert not got[~mask].any()


def test_under_noise_the_error_is_that_of_the_noise():
    lights = ring(elevation_deg=50.0)
    stack, normals, mask = ball(lights, noise=0.004, edge=0.5)
    got, _, fit = hanrahan_krueger(stack, lights, mask, replace(EQUAL, layers=THIN))
    # of a matt surface: each component of the normal across the view has this standard deviation
    expected = np.rad2deg(0.004 / 0.5 / np.sqrt(7 / 2) / np.cos(np.deg2rad(50)))
    assert error_deg(got, normals, mask).mean() < 2.0 * expected
    assert 0.5 < np.nanmedian(fit.misfit) / (0.004 / 0.5) < 1.2


def test_layers_are_recovered_where_many_lights_and_no_noise_say_so():
    lights = np.vstack([ring(12, 25.0), ring(12, 50.0), ring(9, 75.0)])
    stack, normals, mask = ball(lights, reflectance=0.05, fraction=0.6, depth=0.8, edge=0.5)
    loose = replace(
        EQUAL, layers=THIN, base_reflectance=0.05, noise=1e-4, spread_share=5.0, spread_depth=5.0,
        fit=LevenbergSettings(iterations=200, step=1e-5, gain=1e-9),
    )  # fmt: skip
    # the exposure follows from the median albedo, which the layers brighten
    typical = np.nanmedian(lambertian(stack, lights, mask)[1])
    got, _, fit = hanrahan_krueger(stack, lights, mask, replace(loose, base_reflectance=0.05 * typical / 0.5))
    assert error_deg(got, normals, mask).mean() < 0.1
    assert np.abs(fit.fraction[mask] - 0.6).mean() < 0.05
    assert np.abs(fit.depth[mask] - 0.8).mean() < 0.1


def test_shadows_and_highlights_lose_weight():
    lights = ring(9, 50.0)
    stack, normals, mask = ball(lights, edge=0.7)
    stack[4, 20:40, 20:40] *= 1.6
    robust = replace(EQUAL, layers=THIN, weights="robust")
    kept = error_deg(hanrahan_krueger(stack, lights, mask, robust)[0], normals, mask)
    plain = error_deg(hanrahan_krueger(stack, lights, mask, replace(EQUAL, layers=THIN))[0], normals, mask)
    glossy = np.zeros_like(mask)
    glossy[20:40, 20:40] = True
    assert plain[glossy[mask]].mean() > 5
    assert kept[glossy[mask]].mean() < 0.5
    assert kept.mean() < 0.5


def test_scale_of_images_and_lights_does_not_matter():
    lights = ring()
    stack, _, mask = ball(lights, noise=0.003)
    normals, albedo, fit = hanrahan_krueger(stack, lights, mask)
    by_image = hanrahan_krueger(stack * np.float32(1e-3), lights, mask)
    by_light = hanrahan_krueger(stack, lights * 40.0, mask)
    for other, factor in ((by_image, 1e-3), (by_light, 1 / 40.0)):
        assert error_deg(other[0], normals, mask).mean() < 0.05
        assert np.allclose(other[1][mask], factor * albedo[mask], rtol=5e-3)
        assert np.allclose(other[2].fraction[mask], fit.fraction[mask], atol=5e-3)


def test_order_of_the_lights_does_not_matter():
    lights = ring()
    stack, _, mask = ball(lights, noise=0.003)
    order = np.array([3, 1, 6, 0, 2, 5, 4])
    first, other = hanrahan_krueger(stack, lights, mask), hanrahan_krueger(stack[order], lights[order], mask)
    assert error_deg(other[0], first[0], mask).mean() < 0.03


def test_bytes_do_not_depend_on_threads_or_chunks(monkeypatch):
    lights = ring()
    stack, _, mask = ball(lights, noise=0.003)

    def content():
        normals, albedo, fit = hanrahan_krueger(stack, lights, mask)
        return [a.tobytes() for a in (normals, albedo, fit.fraction, fit.depth, fit.misfit, fit.iterations)]

    first = content()
    monkeypatch.setattr(chunks.os, "cpu_count", lambda: 1)
    assert content() == first
    monkeypatch.setattr(chunks, "_pixels_per_chunk", lambda lights: 300)
    assert content() == first


def test_near_lights_are_as_distant_ones_where_they_are_far():
    lights = ring()
    size = 40
    stack, normals, mask = ball(lights, edge=0.6, size=size)
    far = Rig(
        Camera(2.0, (size, size)), tuple(Led("white", position_mm=tuple(1e5 * light)) for light in lights)
    )  # fmt: skip
    settings = replace(EQUAL, layers=THIN)
    near, albedo, fit = hanrahan_krueger_near(stack, far, 0.0, mask, settings)
    distant, distant_albedo, _ = hanrahan_krueger(stack, lights, mask, settings)
    assert error_deg(near, normals, mask).mean() < 0.1
    assert error_deg(near, distant, mask).mean() < 0.05
    assert np.allclose(albedo[mask], distant_albedo[mask], rtol=1e-2)
    assert fit.converged[mask].all()


def test_near_lights_need_their_distance():
    size = 40
    leds = tuple(Led("white", position_mm=tuple(80.0 * light)) for light in ring())
    rig = Rig(Camera(2.0, (size, size)), leds)
    lights = ring()
    i, j = np.mgrid[0:size, 0:size]
    points = np.dstack([(j - (size - 1) / 2) / 2, ((size - 1) / 2 - i) / 2, np.zeros((size, size))])
    towards = 80.0 * lights[:, None, None] - points
    distance = np.linalg.norm(towards, axis=-1)
    to_light = (towards[..., 2] / distance).reshape(7, -1)
    one = np.ones(size * size)
    value = reflected(
        to_light, one, to_light, 0.5 * one, THIN.epidermis_fraction * one, THIN.epidermis_depth * one,
        np.pi * 0.5 / (0.45 * THIN.refractive_index**2), THIN,
    ).value.reshape(7, size, size)  # fmt: skip
    stack = (value * (80.0 / distance) ** 2).astype(np.float32)
    flat = np.zeros((size, size, 3))
    flat[..., 2] = 1
    everywhere = np.ones((size, size), dtype=bool)
    settings = replace(EQUAL, layers=THIN)
    near = hanrahan_krueger_near(stack, rig, 0.0, None, settings)[0]
    distant = hanrahan_krueger(stack, lights, None, settings)[0]
    assert error_deg(near, flat, everywhere).mean() < 0.05
    assert error_deg(distant, flat, everywhere).mean() > 1


def test_black_pixels_face_the_camera():
    lights = ring()
    stack, _, mask = ball(lights)
    stack[:, 30:34, 30:34] = 0
    normals, albedo, _ = hanrahan_krueger(stack, lights, mask)
    assert np.isfinite(normals).all()
    assert np.abs(np.linalg.norm(normals[mask], axis=-1) - 1).max() < 1e-5
    assert albedo[30:34, 30:34].max() < 1e-3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"stack": np.zeros((7, 8, 8))}, "black"),
        ({"stack": np.ones((2, 8, 8))}, "at least 3 images"),
        ({"lights": ring()[:5]}, "differ in number"),
        ({"lights": np.tile([0.0, 0.0, 1.0], (7, 1))}, "same direction"),
        ({"mask": np.zeros((8, 8), dtype=bool)}, "empty"),
        ({"stack": np.full((7, 8, 8), np.nan)}, "NaN"),
    ],
)
def test_bad_input_is_refused(change, words):
    given = {"stack": np.ones((7, 8, 8)), "lights": ring(), "mask": None} | change
    with pytest.raises(BadInput, match=words):
        hanrahan_krueger(given["stack"], given["lights"], given["mask"])


@pytest.mark.parametrize(
    "change",
    [{"base_reflectance": 0.0}, {"noise": float("nan")}, {"spread_share": 0.0}, {"spread_depth": -1.0},
     {"weights": "some"}],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(change):
    with pytest.raises(BadInput, match=f"hanrahan_krueger.{next(iter(change))}"):
        HanrahanKruegerSettings(**change)
