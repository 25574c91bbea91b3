"""The fine grid: the relief from the shading of one channel, and where it is trusted."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skin_scene import ring
from splitknit.skin.diffusion import SkinSettings, diffusion
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.light import Lighting
from splitknit.skin.relief import CROSSOVER_MM, detail_of, high_pass, relief_by_shading

PITCH = 0.04
SHAPE = (150, 170)
SKIN = SkinSettings()
BLUE = diffusion(SKIN.scattering("blue"), SKIN.absorption("blue"))
K = 2 * np.pi / 0.48


def disc():
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    mask = np.hypot((rows - 74.5) / 70, (columns - 84.5) / 80) < 1
    x = (np.arange(SHAPE[1]) - 84.5) * PITCH
    y = (74.5 - np.arange(SHAPE[0])) * PITCH
    return Grid(mask, x, y, PITCH, (False,) * 4)


GRID = disc()
X, Y = np.meshgrid(GRID.x_mm, GRID.y_mm)
INNER = GRID.depth_mm > 1.2
DOME = (1.0 - 0.06 * X**2 - 0.03 * Y**2).astype(np.float32)
ONES = np.ones((7, *SHAPE), dtype=np.float32)


def ridge(amplitude):
    """Oblique waves (mm) and their slopes."""
    phase = K * (0.6 * X + 0.8 * Y)
    swing = -amplitude * K * np.sin(phase)
    return (amplitude * np.cos(phase)).astype(np.float32), 0.6 * swing, 0.8 * swing


def blurred(field):
    """Irradiance pattern behind the skin, in double precision with a margin of its own."""
    size = 512
    omega = (
        2
        * np.pi
        * np.hypot(np.fft.fftfreq(size, PITCH)[:, None], np.fft.rfftfreq(size, PITCH)[None, :])
    )
    spread = np.fft.irfft2(np.fft.rfft2(field, (size, size)) * BLUE(omega), (size, size))
    return spread[: SHAPE[0], : SHAPE[1]]


def gain_of(estimated, true):
    return float((estimated * true).sum() / (true * true).sum())


def lights(trust=ONES):
    """Photometric stereo takes the vectors from the rig; here they only have to be there."""
    return Lighting(np.zeros((7, 3, *SHAPE), np.float32), ONES, trust)


def photographed(slope_x, slope_y, height_mm=DOME, noise=0.0):
    """The blue channel of skin with these slopes under a ring of lights, behind scattering."""
    rig = ring("white")
    normal = np.stack([-slope_x, -slope_y, np.ones(SHAPE)])
    normal = np.stack(
        [blurred(axis * GRID.mask) for axis in normal / np.linalg.norm(normal, axis=0)]
    )
    stack = np.empty((1, 7, *SHAPE), dtype=np.float32)
    rng = np.random.default_rng(0)
    for k, led in enumerate(rig.leds):
        towards = np.asarray(led.position_mm)[:, None, None] - np.stack([X, Y, height_mm])
        distance = np.linalg.norm(towards, axis=0)
        light = (towards / distance * normal).sum(axis=0) / distance**2 * 149.52**2
        stack[0, k] = 0.3 * led.intensity * light + noise * rng.standard_normal(SHAPE)
    return BandImages(("blue",), stack, rig)


def relief_of(slopes, noise=0.0, trust=ONES):
    band = photographed(-0.12 * X + slopes[0], -0.06 * Y + slopes[1], noise=noise)
    return relief_by_shading(band, GRID, DOME, lights(trust), BLUE)


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_ridges_are_recovered_behind_scattering(noise):
    relief, *slopes = ridge(0.03)
    estimate = relief_of(slopes, noise)
    smooth = relief_of((0 * X, 0 * X), noise)
    found = (estimate.relief_mm - smooth.relief_mm)[INNER]
    assert 0.5 < gain_of(found, relief[INNER]) < 1.0  # a Wiener filter shrinks
    assert np.corrcoef(estimate.relief_mm[INNER], relief[INNER])[0, 1] > 0.97
    assert not estimate.relief_mm[~GRID.mask].any()
    assert estimate.facts == {"relief_by": "shading"}


def test_a_smooth_dome_has_no_relief():
    estimate = relief_of((0 * X, 0 * X))
    assert estimate.relief_mm[INNER].std() < 0.002
    assert estimate.deviation_mm[INNER].max() < 0.005


def test_the_stated_deviation_is_of_the_size_of_the_error():
    relief, *slopes = ridge(0.03)
    estimate = relief_of(slopes, 0.003)
    error = (estimate.relief_mm - relief)[INNER].std()
    stated = np.sqrt((estimate.deviation_mm[INNER] ** 2).mean())
    assert 0.3 < error / stated < 1.5


def test_the_first_channels_do_not_matter():
    _, *slopes = ridge(0.03)
    blue = photographed(-0.12 * X + slopes[0], -0.06 * Y + slopes[1])
    three = BandImages(
        ("red", "green", "blue"),
        np.concatenate([7 * ONES[None], 0 * ONES[None], blue.stack]),
        blue.rig,
    )
    alone, among = (relief_by_shading(b, GRID, DOME, lights(), BLUE) for b in (blue, three))
    assert alone.relief_mm.tobytes() == among.relief_mm.tobytes()


def test_lights_without_trust_do_not_count():
    relief, *slopes = ridge(0.03)
    band = photographed(-0.12 * X + slopes[0], -0.06 * Y + slopes[1])
    band.stack[0, 2] = 0.0  # in shadow
    trust = ONES.copy()
    trust[2] = 1e-3
    right, wrong = (
        relief_by_shading(band, GRID, DOME, lights(t), BLUE).relief_mm[INNER] for t in (trust, ONES)
    )
    errors = [np.std(each - relief[INNER]) for each in (right, wrong)]
    assert errors[0] < 0.5 * relief[INNER].std()
    assert errors[0] < errors[1]


def test_detail_is_the_shape_finer_than_the_crossover():
    trust = np.clip(GRID.depth_mm / 0.4, 0, 1).astype(np.float32)
    wave = (0.02 * np.cos(2 * np.pi * X)).astype(np.float32)
    smooth = detail_of(DOME, trust, GRID)
    assert np.abs(smooth[INNER]).max() < 0.002
    detail = detail_of(DOME + wave, trust, GRID)
    assert gain_of((detail - smooth)[INNER], wave[INNER]) == pytest.approx(0.97, abs=0.04)
    assert not detail[~GRID.mask].any()


def test_steep_slopes_are_not_trusted():
    steep = (-1.0 * np.abs(X) ** 2).astype(np.float32)  # 60 deg at 0.87 mm, 74 deg at 1.7 mm
    band = BandImages(("blue",), ONES[None], ring("white"))
    trust = relief_by_shading(band, GRID, steep, lights(), BLUE).trust
    row = SHAPE[0] // 2
    slant = np.rad2deg(np.arctan(2 * np.abs(GRID.x_mm)))
    assert (trust[row, slant < 59] > 0.99).all()
    assert (trust[row, slant > 75] == 0).all()
    assert not trust[GRID.depth_mm <= 0.1].any()


def test_the_fine_grid_passes_no_shape():
    fraction = high_pass(GRID)
    assert fraction[0, 0] == 0
    assert_allclose(fraction, 1 - np.exp(-0.5 * (GRID.omega[2] * CROSSOVER_MM) ** 2), atol=1e-6)
    tilted = relief_of((0.1 + 0 * X, 0 * X)).relief_mm
    assert abs(gain_of(tilted[INNER], 0.1 * X[INNER])) < 0.05
