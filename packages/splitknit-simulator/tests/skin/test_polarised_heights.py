"""Heights from the specular image: prediction, linear equations and what a whole finger gives."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import splitknit
import splitknit_simulator
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.methods.metric import NO_SPECULAR, without_white
from splitknit.model import Camera, Led, Rig
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.light import microfacet_glare
from splitknit.skin.polarised import SpecularImages, polarised_heights, specular_images

PITCH_MM = 0.026
NOISE = 0.003


def _rig(size):
    angle = 2 * np.pi * np.arange(7) / 7
    leds = tuple(
        Led(band="white", position_mm=(52.5 * np.cos(a), 52.5 * np.sin(a), 140.0)) for a in angle
    )
    return Rig(Camera(1 / PITCH_MM, size, 140.0), leds)


def _grid(size):
    rows, columns = size
    mask = np.zeros(size, dtype=np.bool_)
    mask[4:-4, 4:-4] = True
    x, y = (
        (np.arange(columns) - (columns - 1) / 2) * PITCH_MM,
        ((rows - 1) / 2 - np.arange(rows)) * PITCH_MM,
    )
    return Grid(mask, x, y, PITCH_MM, (False,) * 4)


def _ridged(grid):
    """A dome, and ridges across it."""
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    dome = 0.6 - (x * x + y * y) / 20
    return dome.astype(np.float32), (0.03 * np.cos(2 * np.pi * (x + 0.4 * y) / 0.5)).astype(
        np.float32
    )


def _relief(height_mm, grid):
    """Heights above their smooth mean, inside the outline."""
    return (height_mm - grid.smooth(height_mm, grid.mask, 0.32))[grid.depth_mm > 0.3]


def _photographed(height_mm, grid, rig, roughness, rho):
    """What the older model of glare makes of it, by other code than the method's: no blur, Lambert
    beside it."""
    normals = normals_from_gradients(*height_gradients(height_mm, grid.pitch_mm))
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    towards = np.stack(
        [np.array(led.position_mm)[:, None, None] - np.stack([x, y, height_mm]) for led in rig.leds]
    )
    far = np.sqrt((towards**2).sum(axis=1, keepdims=True))
    lights = (towards / far * (140.0 / far) ** 2).astype(np.float32)
    matt = np.maximum(np.einsum("lchw,hwc->lhw", lights, normals), 0)
    return np.asarray(
        5.0 * microfacet_glare(normals, lights, roughness) + rho * matt, dtype=np.float32
    )


@pytest.mark.slow
@pytest.mark.parametrize(("roughness", "gain"), [(0.15, 0.7), (0.35, 1.2)])
def test_ridges_have_their_true_height_for_any_start(roughness, gain):
    grid, rig = _grid((180, 200)), _rig((180, 200))
    dome, ridges = _ridged(grid)
    rng = np.random.default_rng(1)
    stack = _photographed(dome + ridges, grid, rig, roughness, 0.05)
    stack += rng.normal(0, NOISE, stack.shape).astype(np.float32)
    start = dome + np.float32(gain) * ridges
    images = SpecularImages(stack, NOISE, rig)
    height_mm, error_mm, facts = polarised_heights(
        images, grid, start, np.full(grid.shape, 0.006, dtype=np.float32)
    )
    relief, true = (_relief(field, grid) for field in (height_mm - dome, ridges))
    assert float(relief @ true / (true @ true)) == pytest.approx(1.0, abs=0.04)
    assert float(np.sqrt(np.mean((relief - true) ** 2))) < 0.002
    assert facts["roughness"] == pytest.approx(roughness, rel=0.1)
    assert facts["residual_over_noise"] < 1.3
    assert (error_mm > 0).all()


def _with_side(rig):
    angle = np.deg2rad(np.linspace(-25, 205, 5))
    leds = tuple(
        Led(band="white", position_mm=(90 * np.cos(a), 90 * np.sin(a), 30.0), intensity=0.46)
        for a in angle
    )
    return replace(rig, leds=(*rig.leds, *leds))


@pytest.mark.slow
def test_side_lights_are_fitted_and_inconsistent_ones_left_out():
    grid, rig = _grid((180, 200)), _with_side(_rig((180, 200)))
    dome, ridges = _ridged(grid)
    stack = _photographed(dome + ridges, grid, rig, 0.3, 0.05)
    stack[7:] *= np.float32(0.46)
    stack[8] *= np.float32(0.6)  # a film before it passes less
    stack[10] = 0.1 - stack[10]  # turned films
    stack = np.stack([cv2.GaussianBlur(photograph, (0, 0), 0.7) for photograph in stack])
    stack += np.random.default_rng(1).normal(0, NOISE, stack.shape).astype(np.float32)
    images = SpecularImages(stack, NOISE, rig)
    unknown = np.full(grid.shape, 0.006, dtype=np.float32)
    start = dome + np.float32(0.85) * ridges
    height_mm, error_mm, facts = polarised_heights(images, grid, start, unknown)
    assert facts["side_lights"] == 4
    # as if colours separated them
    _, more_mm, _ = polarised_heights(images, grid, start, unknown, films=False)
    assert (more_mm > error_mm)[grid.depth_mm > 0.3].mean() > 0.99
    relief, true = (_relief(field, grid) for field in (height_mm - dome, ridges))
    assert float(relief @ true / (true @ true)) == pytest.approx(1.0, abs=0.1)
    assert float(np.corrcoef(relief, true)[0, 1]) > 0.99


def test_the_specular_image_is_parallel_less_crossed_with_its_noise():
    rig, rng = _rig((60, 70)), np.random.default_rng(2)
    crossed = 0.3 + rng.normal(0, 0.002, (3, 7, 60, 70)).astype(np.float32)
    parallel = crossed + 0.1 + rng.normal(0, 0.003, crossed.shape).astype(np.float32)
    names = ("red", "green", "blue")
    grid, flat = _grid((60, 70)), np.zeros((60, 70), dtype=np.float32)
    bands = BandImages(names, (parallel + crossed) / 2, rig), BandImages(names, crossed, rig)
    images = specular_images(*bands, rig, grid, flat)
    assert float(images.stack.mean()) == pytest.approx(0.1, abs=1e-3)
    assert images.noise == pytest.approx(0.003 / np.sqrt(3), rel=0.1)


def test_coloured_skin_is_removed_from_white_specular_light():
    rig, rng, grid = _rig((60, 70)), np.random.default_rng(3), _grid((60, 70))
    skin, white = rng.uniform(0.2, 0.6, (1, 7, 60, 70)), rng.uniform(0.0, 0.2, (7, 60, 70))
    colour = np.array([1.0, 0.6, 0.4])[:, None, None, None]
    both = BandImages(("red", "green", "blue"), (colour * skin + white).astype(np.float32), rig)
    left = without_white(both, np.full((60, 70), 0.2, dtype=np.float32))
    specular = specular_images(both, left, rig, grid, np.zeros((60, 70), dtype=np.float32)).stack
    # 0.4 - 0.2 of the skin's light
    np.testing.assert_allclose(specular, 0.8 * white + 0.2 * skin[0], atol=1e-6)


@pytest.fixture(scope="module")
def simulated():
    return splitknit_simulator.simulate_capture(
        3, settings={"scale": 0.25, "films.kind": "analyser"}
    )


@pytest.mark.slow
def test_a_polarised_capture_has_measured_heights(simulated):
    capture, truth = simulated
    result = splitknit.reconstruct(capture, settings={"metric.rounds": 1})
    assert result.facts["heights"] == "measured"
    assert result.facts["optics"]["relief_by"] == "polarised"
    figures = splitknit_simulator.compare(result, truth).figures
    assert figures["ridge_correlation"] > 0.95
    assert figures["ridge_gain"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_films_that_are_not_crossed_get_a_warning(simulated):
    capture, _ = simulated
    white = replace(capture.bands["white"], name="white_crossed", polarisation="crossed")
    result = splitknit.reconstruct(
        replace(capture, bands={**capture.bands, "white_crossed": white})
    )
    assert result.facts["heights"] == "modelled"
    assert NO_SPECULAR in result.warnings
