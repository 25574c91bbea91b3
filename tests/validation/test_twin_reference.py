"""The reference for the twin: flat skin against the table of walks and a walk of its own, glare against the formula."""

import importlib
import importlib.util
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from script_folder import VALIDATION
from splitknit.errors import BadInput
from splitknit.model import Camera, Led
from splitknit_simulator.light.skin import ChannelOptics, diffuse_transmittance, diffusion_profile, fresnel
from splitknit_simulator.surface import SimulatedSurface

sys.path.append(str(VALIDATION / "twin"))
reference: Any = importlib.import_module("reference")
ReferenceSettings, reference_scene = reference.ReferenceSettings, reference.reference_scene
render_crop, render_glare, render_volume = reference.render_crop, reference.render_glare, reference.render_volume

HERE = importlib.util.find_spec("mitsuba") is not None and (
    "DRJIT_LIBLLVM_PATH" in os.environ or any(any(Path("/usr").glob(pattern)) for pattern in reference.LLVM)
)
needs_mitsuba = pytest.mark.skipif(not HERE, reason="needs mitsuba (group 'reference') and libllvm19")
TILT = np.arcsin(52.5 / np.hypot(52.5, 140.0))
LEDS = (
    Led("white", direction=(float(np.sin(TILT)), 0.0, float(np.cos(TILT)))),
    Led("white", direction=(0.0, 0.0, 1.0)),
)
BLUE = ChannelOptics(5.18, 0.40, 0.0)
WINDOW = (slice(4, 20), slice(4, 20))


def patch(height_mm: np.ndarray, pitch_mm: float = 0.05) -> SimulatedSurface:
    shape = height_mm.shape
    up = np.zeros((*shape, 3), dtype=np.float32)
    up[..., 2] = 1.0
    one = np.ones(shape, dtype=np.float32)
    height = height_mm.astype(np.float32)
    return SimulatedSurface(Camera(1.0 / pitch_mm, shape), height, 0 * one, up, up, 1e3 * height, one > 0, one)


FLAT = patch(np.zeros((24, 24)))
FEW = ReferenceSettings(samples=256, binning=4, margin_mm=0.2)


def mean_and_error(image: Any) -> tuple[np.ndarray, np.ndarray]:
    """Mean radiance of each light's image, and its standard error, from the batches."""
    means = image.batches.astype(np.float64).mean(axis=(2, 3))
    return means.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(len(means))


@needs_mitsuba
def test_flat_skin_with_a_diffuse_boundary_agrees_with_the_table_of_walks() -> None:
    settings = replace(FEW, samples=8192)
    image = render_crop(FLAT, WINDOW, LEDS, BLUE, settings)
    albedo = diffusion_profile(BLUE.scattering_per_mm, BLUE.absorption_per_mm).albedo
    walks = 16 * settings.samples
    assert abs(image.left - albedo) < 4 * 0.25 / np.sqrt(walks)
    cosine = np.array([np.cos(TILT), 1.0])
    expected = (
        cosine * (1 - fresnel(cosine)) * albedo * (1 - fresnel(np.array(1.0))) / (np.pi * diffuse_transmittance())
    )
    mean, error = mean_and_error(image)
    assert (error < 0.01 * expected).all()
    assert (np.abs(mean - expected) < 4 * error + 1e-3 * expected).all()


def slab(walks: int, tilt: float, spread: float, seed: int) -> tuple[float, float, float]:
    """Share that leaves flat skin with a smooth boundary, radiance under a light's lobe, and the error of the latter.

    Flat skin looks the same from all sides: the lobe is a mean over twelve lights around the camera.

    From the camera straight down; nothing but the medium's constants and the Fresnel formula is shared.
    """
    rng = np.random.default_rng(seed)
    z, d, length = np.zeros(walks), np.tile([[0.0], [0.0], [-1.0]], walks), np.zeros(walks)
    index, left, lobes = np.arange(walks), 0.0, np.zeros(walks)
    around = 2 * np.pi * np.arange(12) / 12
    lights = np.stack([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.full(12, np.cos(tilt))], axis=1)
    while index.size:
        step = rng.standard_exponential(index.size) / BLUE.scattering_per_mm
        out = z + step * d[2] > 0.0
        step = np.where(out, -z / np.where(out, d[2], 1.0), step)
        z, length = np.where(out, 0.0, z + step * d[2]), length + step
        passes = out & (rng.random(index.size) >= fresnel(np.abs(d[2]), 1 / 1.42))
        weight = np.exp(-BLUE.absorption_per_mm * length[passes])
        x, y = 1.42 * d[0, passes], 1.42 * d[1, passes]
        outside = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0.0))])
        left += weight.sum()
        near = np.exp((lights @ outside - 1) / spread**2) / (2 * np.pi * spread**2)
        lobes[index[passes]] = weight * near.mean(axis=0)
        up, turn = 2 * rng.random(index.size) - 1, 2 * np.pi * rng.random(index.size)
        side = np.sqrt(1 - up * up)
        scattered = np.stack([side * np.cos(turn), side * np.sin(turn), up])
        d = np.where(out, d * np.array([[1.0], [1.0], [-1.0]]), scattered)
        keep = ~passes & (BLUE.absorption_per_mm * length < 10)
        z, d, length, index = z[keep], d[:, keep], length[keep], index[keep]
    through = 1 - float(fresnel(np.array(1.0)))
    return left / walks, through * lobes.mean(), through * lobes.std() / np.sqrt(walks)


@needs_mitsuba
def test_flat_skin_with_a_smooth_boundary_agrees_with_a_walk_of_its_own() -> None:
    settings = replace(FEW, samples=2048, boundary="smooth", spread_rad=0.25)
    image = render_crop(FLAT, WINDOW, LEDS, BLUE, settings)
    left, light, light_error = slab(100_000, TILT, 0.25, 3)
    assert abs(image.left - left) < 4 * 0.3 * np.hypot(1 / np.sqrt(100_000), 1 / np.sqrt(16 * settings.samples))
    mean, error = mean_and_error(image)
    assert abs(mean[0] - light) < 4 * np.hypot(error[0], light_error)
    assert np.hypot(error[0], light_error) < 0.015 * light


@needs_mitsuba
def test_refracted_light_drifts_away_from_its_light_and_diffuse_light_does_not() -> None:
    # one narrow groove: its dark line is seen where the light that missed it would have come out
    x = (np.arange(120) - 59.5) * 0.02
    groove = patch(np.broadcast_to(-0.05 * np.exp(-0.5 * (x / 0.04) ** 2), (120, 120)), 0.02)
    window = (slice(40, 80), slice(30, 90))
    lean = (Led("white", direction=(0.5, 0.0, 0.866)), Led("white", direction=(-0.5, 0.0, 0.866)))
    found = {}
    for boundary in ("diffuse", "smooth"):
        settings = ReferenceSettings(samples=128, binning=2, margin_mm=1.0, boundary=boundary, spread_rad=0.15)
        light = render_crop(groove, window, lean, BLUE, settings).radiance.mean(axis=1)
        light = light / light.mean(axis=1, keepdims=True)
        at = x[30:90].reshape(30, 2).mean(axis=1)
        wing = np.where(np.abs(at) > 0.15, np.sign(at), 0.0) * (np.abs(at) < 0.4)
        found[boundary] = float((wing * (light[0] - light[1])).sum())
    # under refracted light from +x, the dark groove's neighbourhood at -x loses what would have drifted there
    assert found["smooth"] > found["diffuse"] + 0.1


@needs_mitsuba
def test_ridges_are_brighter_than_valleys_and_flanks_towards_the_light_brighter_than_others() -> None:
    x = (np.arange(160) - 79.5) * 0.0269
    wave = np.cos(2 * np.pi * x / 0.43)
    ridges = patch(np.broadcast_to(0.0375 * wave, (160, 160)), 0.0269)
    sides = (LEDS[0], Led("white", direction=(-float(np.sin(TILT)), 0.0, float(np.cos(TILT)))))
    image = render_crop(ridges, (slice(64, 96), slice(64, 96)), sides, BLUE, ReferenceSettings(samples=128, binning=1))
    light = image.batches.astype(np.float64).mean(axis=2)
    light = light / light.mean(axis=-1, keepdims=True)
    here, slope = wave[64:96], np.sin(2 * np.pi * x[64:96] / 0.43)
    height = 2 * (light.mean(axis=1) * here).mean(axis=-1)
    shade = ((light[:, 0] - light[:, 1]) * slope).mean(axis=-1)
    assert height.mean() > 5 * height.std(ddof=1) / np.sqrt(8)
    assert 0.05 < height.mean() < 0.12
    assert 0.02 < shade.mean() < 0.06


@needs_mitsuba
def test_same_seed_same_bytes_whatever_the_number_of_threads() -> None:
    settings = replace(FEW, samples=32)
    images = [
        render_crop(FLAT, WINDOW, LEDS, BLUE, replace(settings, threads=threads, boundary=boundary)).batches.tobytes()
        for boundary in ("diffuse", "smooth")
        for threads in (1, 2)
    ]
    assert images[0] == images[1]
    assert images[2] == images[3]
    other = render_crop(FLAT, WINDOW, LEDS, BLUE, replace(settings, seed=1)).batches.tobytes()
    assert other != images[0]


@needs_mitsuba
def test_glare_of_a_tilted_plane_follows_the_microfacet_formula() -> None:
    slope = 0.18
    height = np.broadcast_to(-slope * (np.arange(24) - 11.5) * 0.05, (24, 24))
    settings = replace(FEW, led_radius_mm=0.0)
    scene = reference_scene(patch(height), WINDOW, LEDS[:1], settings)
    image = render_glare(scene, 0.25, settings, samples=16)
    n = np.array([slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    light, view = np.array([np.sin(TILT), 0.0, np.cos(TILT)]), np.array([0.0, 0.0, 1.0])
    half = (light + view) / np.linalg.norm(light + view)
    spread = 0.25**2 / (np.pi * ((n @ half) ** 2 * (0.25**2 - 1) + 1) ** 2)

    def one_way(c: float) -> float:
        return 2 * c / (c + np.sqrt(0.25**2 + (1 - 0.25**2) * c * c))

    expected = spread * one_way(n @ light) * one_way(n @ view) * fresnel(np.array(half @ view)) / (4 * n @ view)
    np.testing.assert_allclose(image.radiance, float(expected), rtol=2e-3)
    assert image.left < 1e-3  # the ledge below the plane's high side


@needs_mitsuba
def test_a_step_casts_a_shadow() -> None:
    height = np.where(np.arange(60) < 20, 1.0, 0.0)
    step = patch(np.broadcast_to(height, (60, 60)))
    low = (Led("white", direction=(-1.0, 0.0, 1.0)), Led("white", direction=(1.0, 0.0, 1.0)))
    settings = ReferenceSettings(samples=64, binning=1, margin_mm=0.2)
    # 0.3 mm beside a step of 1 mm: dark under the light behind it, lit under the other; no light wanders that far
    scene = reference_scene(step, (slice(28, 32), slice(26, 30)), low, settings)
    glossy = render_glare(scene, 0.6, replace(settings, bounces=1)).radiance.mean(axis=(1, 2))
    thick = render_volume(scene, ChannelOptics(60.0, 10.0, 0.0), settings).radiance.mean(axis=(1, 2))
    assert glossy[0] == 0.0
    assert glossy[1] > 1e-4
    assert thick[0] < 0.05 * thick[1]


@needs_mitsuba
def test_crops_that_do_not_fit_are_refused() -> None:
    with pytest.raises(BadInput, match="positive multiple of 4"):
        render_crop(FLAT, (slice(0, 6), slice(0, 8)), LEDS, BLUE, FEW)
    holed = replace(FLAT, mask=FLAT.mask & (np.arange(24) != 10))
    with pytest.raises(BadInput, match="lie on the skin"):
        render_crop(holed, WINDOW, LEDS, BLUE, FEW)
    lobed = (replace(LEDS[0], lobe_exponent=2.0),)
    with pytest.raises(BadInput, match="without a lobe"):
        render_crop(FLAT, WINDOW, lobed, BLUE, FEW)


def test_missing_llvm_is_refused_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(reference, "LLVM", ("lib/no-such-library*",))
    with pytest.raises(BadInput, match="install Debian's libllvm19"):
        render_crop(FLAT, WINDOW, LEDS, BLUE)


def test_missing_mitsuba_is_refused_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "libLLVM.so.19.1")
    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(BadInput, match="the dependency group 'reference'"):
        render_crop(FLAT, WINDOW, LEDS, BLUE)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("boundary", "rough"), ("samples", 100), ("binning", 0), ("margin_mm", -1.0),
        ("spread_rad", 0.0), ("bounces", 0), ("threads", 0),
    ],
)  # fmt: skip
def test_settings_are_checked(field: str, value: object) -> None:
    with pytest.raises(BadInput, match=f"reference.{field}"):
        ReferenceSettings(**{field: value})


def test_standard_error_is_that_of_the_mean() -> None:
    rng = np.random.default_rng(2)
    image = reference.ReferenceImage(rng.normal(1.0, 0.2, (16, 1, 40, 40)).astype(np.float32), 0.0, 0.0)
    np.testing.assert_allclose(image.radiance, image.batches.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(np.sqrt((image.standard_error**2).mean()), 0.05, rtol=0.03)
