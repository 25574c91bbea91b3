"""The fine grid: what a measurement has beyond a surface, unmixed, integrated and denoised."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from skin_scene import ring
from splitknit.skin.diffusion import SkinSettings, diffusion
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.light import Lighting
from splitknit.skin.relief import (
    CROSSOVER_MM,
    Measured,
    Unmixing,
    denoise,
    detail_of,
    high_pass,
    measure,
    unmixing,
    update,
)

PITCH = 0.04
SHAPE = (150, 170)
COLOURS = ("red", "green", "blue")
BRIGHTNESS = np.array([0.6, 0.4, 0.3], dtype=np.float32)
SKIN = SkinSettings()
OPTICS = {n: diffusion(SKIN.scattering(n), SKIN.absorption(n)) for n in (*COLOURS, "nir")}
K = 2 * np.pi / 0.48


def disc():
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    mask = np.hypot((rows - 74.5) / 70, (columns - 84.5) / 80) < 1
    x = (np.arange(SHAPE[1]) - 84.5) * PITCH
    y = (74.5 - np.arange(SHAPE[0])) * PITCH
    return Grid(mask, x, y, PITCH, (False,) * 4)


GRID = disc()
ZERO = np.zeros(SHAPE)
FLAT = np.zeros(SHAPE, np.float32)
X, Y = np.meshgrid(GRID.x_mm, GRID.y_mm)
INNER = GRID.depth_mm > 1.2
DOME = (1.0 - 0.06 * X**2 - 0.03 * Y**2).astype(np.float32)


def ridge(amplitude):
    """Oblique waves (mm) and their slopes."""
    phase = K * (0.6 * X + 0.8 * Y)
    swing = -amplitude * K * np.sin(phase)
    return (amplitude * np.cos(phase)).astype(np.float32), 0.6 * swing, 0.8 * swing


def blurred(field, name):
    """Irradiance pattern behind the skin, in double precision with a margin of its own."""
    size = 512
    omega = (
        2
        * np.pi
        * np.hypot(np.fft.fftfreq(size, PITCH)[:, None], np.fft.rfftfreq(size, PITCH)[None, :])
    )
    spread = np.fft.irfft2(np.fft.rfft2(field, (size, size)) * OPTICS[name](omega), (size, size))
    return spread[: SHAPE[0], : SHAPE[1]]


def gain_of(estimated, true):
    return float((estimated * true).sum() / (true * true).sum())


def measured_of(slope_x, slope_y, albedo=1.0, glare=0.0, names=COLOURS):
    """Pseudo-normals of a surface with these slopes behind the skin, times an albedo, plus white
    glare along z."""
    normal = np.stack([-slope_x, -slope_y, np.ones(SHAPE)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal *= GRID.mask[..., None]
    g = np.empty((len(names), *SHAPE, 3), dtype=np.float32)
    for c, name in enumerate(names):
        level = BRIGHTNESS[COLOURS.index(name)]
        g[c] = (
            level
            * np.stack([blurred(normal[..., i], name) for i in range(3)], axis=-1)
            * np.asarray(albedo)[..., None]
        )
        g[c, ..., 2] += glare
    omega = np.linspace(0, float(GRID.omega[2].max()), 1024)
    transfer = np.stack([GRID.radial(omega, OPTICS[n](omega)) for n in names])
    trust = np.clip(GRID.depth_mm / 0.4, 0, 1)
    region = np.clip((GRID.depth_mm - 0.5) / 0.5, 0, 1)
    levels = np.array([BRIGHTNESS[COLOURS.index(n)] for n in names])
    return Measured(names, g, transfer, levels, trust.astype(np.float32), region.astype(np.float32))


def dome_slopes():
    return -0.12 * X, -0.06 * Y


def lights(entering, trust):
    """Photometric stereo takes the vectors from the rig; here they only have to be there."""
    return Lighting(np.zeros((entering.shape[0], 3, *SHAPE), np.float32), entering, trust)


def test_measure_gives_albedo_times_normal():
    rig = ring("white")
    gx, gy = dome_slopes()
    normal = np.stack([-gx, -gy, np.ones(SHAPE)]) / np.sqrt(1 + gx * gx + gy * gy)
    stack = np.empty((3, 7, *SHAPE), dtype=np.float32)
    rng = np.random.default_rng(0)
    entering = (0.7 + 0.3 * rng.random((7, *SHAPE))).astype(np.float32)
    for k, led in enumerate(rig.leds):
        towards = np.asarray(led.position_mm)[:, None, None] - np.stack([X, Y, DOME])
        distance = np.linalg.norm(towards, axis=0)
        cosine = (towards / distance * normal).sum(axis=0)
        stack[:, k] = (
            BRIGHTNESS[:, None, None]
            * led.intensity
            * cosine
            / distance**2
            * 149.52**2
            * entering[k]
        )
    light = lights(entering, np.ones_like(entering))
    brightness = dict(zip(COLOURS, BRIGHTNESS.tolist(), strict=True))
    measured = measure(BandImages(COLOURS, stack, rig), GRID, DOME, light, OPTICS, brightness)
    assert measured.channels == COLOURS
    mean = np.mean([led.intensity for led in rig.leds])
    for c in range(3):
        truth = np.moveaxis(normal, 0, -1) * BRIGHTNESS[c] * mean
        assert_allclose(
            measured.pseudo_normals[c][GRID.mask], truth[GRID.mask], rtol=0.01, atol=1e-3
        )
    assert_array_equal(measured.brightness, BRIGHTNESS)
    wx = GRID.omega[0][0]
    assert_allclose(measured.transfer[1, 0], OPTICS["green"](wx), atol=2e-3)
    assert not measured.trust[~GRID.mask].any()
    assert measured.trust[INNER].min() > 0.99
    assert not measured.trust[GRID.depth_mm <= 0.1].any()
    rim = np.abs(GRID.depth_mm - 0.25) < 0.01
    assert np.abs(measured.trust[rim] - 0.5).max() < 0.06
    assert not measured.region[GRID.depth_mm < 0.5].any()
    assert measured.region[75, 85] == pytest.approx(1.0, abs=1e-3)


def test_lights_without_trust_do_not_count():
    rig = ring("white")
    stack = np.empty((1, 7, *SHAPE), dtype=np.float32)
    for k, led in enumerate(rig.leds):
        towards = np.asarray(led.position_mm)[:, None, None] - np.stack([X, Y, np.ones(SHAPE)])
        stack[0, k] = led.intensity * towards[2] / np.linalg.norm(towards, axis=0) ** 3 * 149.52**2
    stack[0, 2] = 0.0  # in shadow
    trust = np.ones((7, *SHAPE), dtype=np.float32)
    trust[2] = 1e-3
    level = np.ones(SHAPE, dtype=np.float32)
    band = BandImages(("green",), stack, rig)
    for weights, straight in ((trust, True), (np.ones_like(trust), False)):
        light = lights(np.ones_like(trust), weights)
        g = measure(band, GRID, level, light, OPTICS, {"green": 1.0}).pseudo_normals[0]
        tilt = np.hypot(g[INNER][:, 0], g[INNER][:, 1]) / g[INNER][:, 2]
        assert (tilt.max() < 0.01) == straight


def test_detail_is_the_shape_finer_than_the_crossover():
    measured = measured_of(*dome_slopes())
    wave = (0.02 * np.cos(2 * np.pi * X)).astype(np.float32)
    smooth = detail_of(DOME, measured.trust, GRID)
    assert np.abs(smooth[INNER]).max() < 0.002
    detail = detail_of(DOME + wave, measured.trust, GRID)
    assert gain_of((detail - smooth)[INNER], wave[INNER]) == pytest.approx(0.97, abs=0.04)
    assert not detail[~GRID.mask].any()


def test_low_frequencies_pass_even_without_relief():
    measured, slopes, glare = synthetic((ZERO, ZERO), (ZERO, ZERO), 0.0)
    mix = unmixing(measured, GRID, slopes, glare)
    kept = sum(w * t for w, t in zip(mix.weights, measured.transfer, strict=True))
    slow = (GRID.omega[2] > 5) & (GRID.omega[2] < 12)
    assert kept[slow].min() > 0.9
    assert kept.max() < 1.02


def test_steep_slopes_are_not_trusted():
    rig = ring("white")
    steep = (-1.0 * np.abs(X) ** 2).astype(np.float32)  # 60 deg at 0.87 mm, 74 deg at 1.7 mm
    ones = np.ones((7, *SHAPE), dtype=np.float32)
    band = BandImages(("green",), ones[None], rig)
    measured = measure(band, GRID, steep, lights(ones, ones), OPTICS, {"green": 1.0})
    row = SHAPE[0] // 2
    slant = np.rad2deg(np.arctan(2 * np.abs(GRID.x_mm)))
    assert (measured.trust[row, slant < 59] > 0.99).all()
    assert (measured.trust[row, slant > 75] == 0).all()
    assert (measured.region[row, slant > 51] == 0).all()


def synthetic(relief_slopes, glare_slopes, noise, seed=0):
    """Slopes p_c = M_c d + g_c s + noise of every colour, and what was measured with them."""
    measured = measured_of(ZERO, ZERO)
    glare = (BRIGHTNESS[0] / BRIGHTNESS).astype(np.float32)
    rng = np.random.default_rng(seed)
    slopes = []
    for c, name in enumerate(COLOURS):
        pair = []
        for d, s in zip(relief_slopes, glare_slopes, strict=True):
            value = blurred(d * GRID.mask, name) + glare[c] * s + noise * rng.standard_normal(SHAPE)
            pair.append((value * measured.trust).astype(np.float32))
        slopes.append(tuple(pair))
    return measured, slopes, glare


def ridges_in_noise(noise):
    """Ridges of 0.03 mm, their slopes as measured, the weights, and the relief after one update."""
    relief, sx, sy = ridge(0.03)
    measured, slopes, glare = synthetic((sx, sy), (ZERO, ZERO), noise)
    mix = unmixing(measured, GRID, slopes, glare)
    return relief, measured, slopes, mix, update(measured, GRID, slopes, mix, FLAT)


def test_noise_hardly_shrinks_strong_ridges():
    relief, *_, updated = ridges_in_noise(0.03)
    assert gain_of(updated[INNER], relief[INNER]) == pytest.approx(1.0, abs=0.05)


def test_unmixing_and_integration_recover_the_relief():
    relief, _, _, mix, updated = ridges_in_noise(0.003)
    assert len(mix.weights) == 3
    assert gain_of(updated[INNER], relief[INNER]) == pytest.approx(1.0, abs=0.05)
    assert np.corrcoef(updated[INNER], relief[INNER])[0, 1] > 0.97
    assert not updated[~GRID.mask].any()


def test_specular_reflection_does_not_become_relief():
    relief, sx, sy = ridge(0.03)
    phase = 17.0 * (0.9 * X - 0.4 * Y)
    false = 0.3 * np.cos(phase)
    measured, slopes, glare = synthetic((sx, sy), (0.9 * false, -0.4 * false), 0.003)
    updated = update(measured, GRID, slopes, unmixing(measured, GRID, slopes, glare), FLAT)
    assert gain_of(updated[INNER], relief[INNER]) == pytest.approx(1.0, abs=0.08)
    alone = list(slopes[2:])
    blue = Measured(
        ("blue",),
        measured.pseudo_normals[2:],
        measured.transfer[2:],
        measured.brightness[2:],
        measured.trust,
        measured.region,
    )
    mix = unmixing(blue, GRID, alone, np.ones(1, np.float32))
    fooled = update(blue, GRID, alone, mix, FLAT)
    left, kept = ((f - relief)[INNER].std() for f in (updated, fooled))
    assert left < 0.3 * kept


def test_repeated_updates_converge():
    relief, measured, slopes, mix, first = ridges_in_noise(0.01)
    wx, wy, _ = GRID.omega
    current, steps = FLAT, []
    for _ in range(6):
        spectrum = GRID.forward(current)
        residual = [
            tuple(
                (s - GRID.inverse(1j * w * t * spectrum) * measured.trust).astype(np.float32)
                for s, w in zip(pair, (wx, wy), strict=True)
            )
            for pair, t in zip(slopes, measured.transfer, strict=True)
        ]
        after = update(measured, GRID, residual, mix, current)
        steps.append(float(np.abs(after - current)[INNER].std()))
        current = after
    assert steps[-1] < 0.02 * steps[0]
    assert current[INNER].std() == pytest.approx(first[INNER].std(), rel=0.05)
    assert gain_of(current[INNER], relief[INNER]) == pytest.approx(1.0, abs=0.1)


def test_the_fine_grid_passes_no_shape():
    fraction = high_pass(GRID)
    assert fraction[0, 0] == 0
    assert_allclose(fraction, 1 - np.exp(-0.5 * (GRID.omega[2] * CROSSOVER_MM) ** 2), atol=1e-6)
    measured, slopes, glare = synthetic((ZERO + 0.3, ZERO), (ZERO, ZERO), 0.003)
    updated = update(measured, GRID, slopes, unmixing(measured, GRID, slopes, glare), FLAT)
    assert abs(gain_of(updated[INNER], 0.3 * X[INNER])) < 0.05


def test_denoise_lowers_the_error_and_states_it():
    relief, _, _, mix, raw = ridges_in_noise(0.01)
    clean, deviation = denoise(raw, GRID, mix, 0)
    before, after = (float(np.sqrt(((f - relief)[INNER] ** 2).mean())) for f in (raw, clean))
    assert after < 0.9 * before
    assert gain_of(clean[INNER], relief[INNER]) > 0.9
    assert 0.3 * after < deviation[INNER].mean() < 2 * after
    again = denoise(raw, GRID, mix, 0)
    assert again[0].tobytes() == clean.tobytes()
    assert again[1].tobytes() == deviation.tobytes()
    assert denoise(raw, GRID, mix, 1)[0].tobytes() != clean.tobytes()


def test_denoise_of_a_grid_smaller_than_the_window_states_the_noise_alone():
    small = Grid(GRID.mask[60:90, 60:90], GRID.x_mm[60:90], GRID.y_mm[60:90], PITCH, (True,) * 4)
    ones = np.ones_like(small.omega[2])
    relief = np.random.default_rng(0).standard_normal((30, 30)).astype(np.float32)
    same, deviation = denoise(relief, small, Unmixing([ones], np.array([0.01])), 0)
    assert_array_equal(same, relief)
    assert deviation.shape == (30, 30)
    assert deviation.min() == deviation.max() > 0
