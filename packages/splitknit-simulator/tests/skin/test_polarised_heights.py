"""Heights from the specular image: prediction, linear equations and what a whole finger gives."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import cv2
import numpy as np
import pytest

import splitknit
import splitknit_simulator
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.methods.metric import NO_SPECULAR, without_white
from splitknit.model import Camera, Capture, FloatArray, Led, Rig
from splitknit.skin import polarised
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.light import MicrofacetGlare
from splitknit.skin.polarised import SpecularImages, polarised_heights, specular_images

PITCH_MM = 0.026
NOISE = 0.003


def _rig(size: tuple[int, int]) -> Rig:
    angle = 2 * np.pi * np.arange(7) / 7
    leds = tuple(Led(band="white", position_mm=(52.5 * np.cos(a), 52.5 * np.sin(a), 140.0)) for a in angle)
    return Rig(Camera(1 / PITCH_MM, size, 140.0), leds)


def _grid(size: tuple[int, int]) -> Grid:
    rows, columns = size
    mask = np.zeros(size, dtype=np.bool_)
    mask[4:-4, 4:-4] = True
    x, y = (np.arange(columns) - (columns - 1) / 2) * PITCH_MM, ((rows - 1) / 2 - np.arange(rows)) * PITCH_MM
    return Grid(mask, x, y, PITCH_MM, (False,) * 4)


def _ridged(grid: Grid) -> tuple[FloatArray, FloatArray]:
    """A dome, and ridges across it."""
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    dome = 0.6 - (x * x + y * y) / 20
    return dome.astype(np.float32), (0.03 * np.cos(2 * np.pi * (x + 0.4 * y) / 0.5)).astype(np.float32)


def _photographed(height_mm: FloatArray, grid: Grid, rig: Rig, roughness: float, rho: float) -> FloatArray:
    """What the older model of glare makes of it, by other code than the method's: no blur, Lambert beside it."""
    normals = normals_from_gradients(*height_gradients(height_mm, grid.pitch_mm))
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    towards = np.stack([np.array(led.position_mm)[:, None, None] - np.stack([x, y, height_mm]) for led in rig.leds])
    far = np.sqrt((towards**2).sum(axis=1, keepdims=True))
    lights = (towards / far * (140.0 / far) ** 2).astype(np.float32)
    matt = np.maximum(np.einsum("lchw,hwc->lhw", lights, normals), 0)
    return np.asarray(5.0 * MicrofacetGlare(normals, lights)(roughness) + rho * matt, dtype=np.float32)


@pytest.mark.parametrize("grazing", [0.0, 0.01])
def test_derivatives_are_those_of_the_prediction(grazing: float) -> None:
    grid = _grid((24, 30))
    dome, _ = _ridged(grid)
    light = polarised._Lights.of(_rig((24, 30)), grid, dome).on(slice(0, 24))
    slopes = [np.random.default_rng(k).normal(0, 0.3, dome.shape).astype(np.float32) for k in range(2)]
    _, _, *derivatives = polarised._facets(light, (slopes[0], slopes[1]), 0.3, grazing, derivatives=True)
    for axis in range(2):
        sides = []
        for change in (-1e-2, 1e-2):
            moved = [s + np.float32(change * (axis == k)) for k, s in enumerate(slopes)]
            sides.append(polarised._facets(light, (moved[0], moved[1]), 0.3, grazing))
        for image in range(2):  # specular, matt
            by = (sides[1][image] - sides[0][image]) / 2e-2
            np.testing.assert_allclose(derivatives[2 * image + axis], by, atol=4e-3)
    smoother, rougher = (
        polarised._facets(light, (slopes[0], slopes[1]), 0.3 * float(np.exp(change)))[0] for change in (-1e-2, 1e-2)
    )
    np.testing.assert_allclose(derivatives[4], (rougher - smoother) / 2e-2, atol=2e-3)


def test_the_lobe_is_that_of_the_glare_model() -> None:
    grid, rig = _grid((40, 44)), _rig((40, 44))
    dome, ridges = _ridged(grid)
    height = dome + ridges
    x, y = height_gradients(height, grid.pitch_mm)
    lights = polarised._Lights.of(rig, grid, height)
    parts = (slice(0, 17), slice(17, 40))
    made = np.concatenate([polarised._facets(lights.on(p), (x[p], y[p]), 0.3)[0] for p in parts], axis=1)
    ratio = made / _photographed(height, grid, rig, 0.3, 0.0)
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=3e-3)


def test_slopes_and_their_transpose() -> None:
    rng = np.random.default_rng(0)
    nodes, x, y = (rng.normal(size=s).astype(np.float32) for s in ((9, 12), (8, 11), (8, 11)))
    along, up = polarised._slopes(nodes, 0.5)
    back = polarised._transposed(x, y, 0.5)
    assert float((along * x + up * y).sum()) == pytest.approx(float((nodes * back).sum()), rel=1e-4)
    plane = np.arange(12, dtype=np.float32)[None] * 0.5 - np.arange(9, dtype=np.float32)[:, None]
    along, up = polarised._slopes(plane, 0.5)
    np.testing.assert_allclose(along, 1.0, atol=1e-5)
    np.testing.assert_allclose(up, 2.0, atol=1e-5)


@pytest.mark.parametrize(("roughness", "gain"), [(0.15, 0.7), (0.35, 1.2)])
def test_ridges_come_out_at_their_height_whatever_the_start(roughness: float, gain: float) -> None:
    grid, rig = _grid((180, 200)), _rig((180, 200))
    dome, ridges = _ridged(grid)
    rng = np.random.default_rng(1)
    stack = _photographed(dome + ridges, grid, rig, roughness, 0.05)
    stack += rng.normal(0, NOISE, stack.shape).astype(np.float32)
    start = dome + np.float32(gain) * ridges
    images = SpecularImages(stack, NOISE, rig)
    height_mm, error_mm, facts = polarised_heights(images, grid, start, np.full(grid.shape, 0.006, dtype=np.float32))
    inner = grid.depth_mm > 0.3
    rest = height_mm - dome
    relief = (rest - grid.smooth(rest, grid.mask, 0.32))[inner]
    true = (ridges - grid.smooth(ridges, grid.mask, 0.32))[inner]
    assert float(relief @ true / (true @ true)) == pytest.approx(1.0, abs=0.04)
    assert float(np.sqrt(np.mean((relief - true) ** 2))) < 0.002
    assert facts["roughness"] == pytest.approx(roughness, rel=0.1)
    assert facts["residual_over_noise"] < 1.3
    assert (error_mm > 0).all()


def test_skin_that_turns_out_too_rough_is_not_fitted_to_the_end() -> None:
    """All that is lost is time: such heights are not used."""
    grid, rig = _grid((90, 100)), _rig((90, 100))
    dome, ridges = _ridged(grid)
    images = SpecularImages(_photographed(dome + ridges, grid, rig, 0.6, 0.05), NOISE, rig)
    unknown, counts = np.full(grid.shape, 0.006, dtype=np.float32), []
    for roughest in (0.35, 0.9):
        with mock.patch.object(polarised, "_predicted", wraps=polarised._predicted) as predicted:
            facts = polarised_heights(images, grid, dome + ridges, unknown, roughest)[2]
        assert facts["roughness"] > 0.35
        counts.append(predicted.call_count)
    assert counts[0] < counts[1] == polarised.TURNS


def _with_side(rig: Rig) -> Rig:
    angle = np.deg2rad(np.linspace(-25, 205, 5))
    leds = tuple(Led(band="white", position_mm=(90 * np.cos(a), 90 * np.sin(a), 30.0), intensity=0.46) for a in angle)
    return replace(rig, leds=(*rig.leds, *leds))


def test_lights_to_the_side_are_fitted_and_left_out_where_they_do_not_fit() -> None:
    grid, rig = _grid((180, 200)), _with_side(_rig((180, 200)))
    dome, ridges = _ridged(grid)
    stack = _photographed(dome + ridges, grid, rig, 0.3, 0.05)
    stack[7:] *= np.float32(0.46)
    stack[8] *= np.float32(0.6)  # a film before it passes less
    stack[10] = 0.1 - stack[10]  # turned films
    stack = np.stack([cv2.GaussianBlur(one, (0, 0), 0.7) for one in stack])
    stack += np.random.default_rng(1).normal(0, NOISE, stack.shape).astype(np.float32)
    images = SpecularImages(stack, NOISE, rig)
    unknown = np.full(grid.shape, 0.006, dtype=np.float32)
    start = dome + np.float32(0.85) * ridges
    height_mm, error_mm, facts = polarised_heights(images, grid, start, unknown)
    assert facts["side_lights"] == 4
    inner = grid.depth_mm > 0.3
    same_mm, more_mm, _ = polarised_heights(images, grid, start, unknown, roughest=0.9)  # as if colours separated them
    np.testing.assert_array_equal(same_mm, height_mm)
    assert (more_mm > error_mm)[inner].mean() > 0.99
    rest = height_mm - dome
    relief = (rest - grid.smooth(rest, grid.mask, 0.32))[inner]
    true = (ridges - grid.smooth(ridges, grid.mask, 0.32))[inner]
    assert float(relief @ true / (true @ true)) == pytest.approx(1.0, abs=0.1)
    assert float(np.corrcoef(relief, true)[0, 1]) > 0.99


@pytest.mark.slow
def test_lights_to_the_side_show_how_high_the_finger_lies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(polarised, "GRAZING", 0.0)  # the scene's scattered light enters as Lambert's law has it
    size = (300, 360)
    grid, rig = _grid(size), _with_side(_rig(size))
    dome, ridges = _ridged(grid)
    dome -= np.float32(0.5) * (np.float32(0.6) - dome)
    stack = _photographed(dome + ridges, grid, rig, 0.3, 0.05)
    stack[7:] *= np.float32(0.46)
    stack += np.random.default_rng(1).normal(0, NOISE, stack.shape).astype(np.float32)
    unknown = np.full(grid.shape, 0.006, dtype=np.float32)
    lifts = []
    for lower in np.float32([0.0, 2.5]):
        start = dome + np.float32(0.85) * ridges - lower
        lifts.append(polarised_heights(SpecularImages(stack, NOISE, rig), grid, start, unknown)[2]["lift_mm"])
    assert abs(lifts[0]) < 0.8
    assert 2.2 < lifts[1] - lifts[0] < 2.8


def test_a_wall_casts_a_shadow_as_long_as_the_light_is_low() -> None:
    grid, rig = _grid((60, 160)), _with_side(_rig((60, 160)))
    wall = np.where(np.abs(np.arange(160) - 100) < 6, 0.2, 0.0).astype(np.float32) + np.zeros((60, 1), np.float32)
    lights = polarised._Lights.of(rig, grid, wall)
    low = replace(rig, leds=(Led(band="white", position_mm=(90.0, 0.0, 30.0)),))
    reached = polarised._Lights.of(low, grid, wall).reached(0, wall, grid)[30]
    dark = np.flatnonzero(reached < 0.5)
    assert 95 - dark.min() == pytest.approx(0.2 / (30 / 90) / PITCH_MM, abs=3)
    assert dark.max() < 100
    assert float(lights.reached(0, wall, grid)[30, :70].min()) == 1.0  # of the ring


def test_the_difference_and_its_noise() -> None:
    rig, rng = _rig((60, 70)), np.random.default_rng(2)
    crossed = 0.3 + rng.normal(0, 0.002, (3, 7, 60, 70)).astype(np.float32)
    parallel = crossed + 0.1 + rng.normal(0, 0.003, crossed.shape).astype(np.float32)
    names = ("red", "green", "blue")
    grid, flat = _grid((60, 70)), np.zeros((60, 70), dtype=np.float32)
    bands = BandImages(names, (parallel + crossed) / 2, rig), BandImages(names, crossed, rig)
    images = specular_images(*bands, rig, grid, flat)
    assert float(images.stack.mean()) == pytest.approx(0.1, abs=1e-3)
    assert images.noise == pytest.approx(0.003 / np.sqrt(3), rel=0.1)


def test_white_light_is_what_colours_leave() -> None:
    rig, rng, grid = _rig((60, 70)), np.random.default_rng(3), _grid((60, 70))
    skin, white = rng.uniform(0.2, 0.6, (1, 7, 60, 70)), rng.uniform(0.0, 0.2, (7, 60, 70))
    colour = np.array([1.0, 0.6, 0.4])[:, None, None, None]
    both = BandImages(("red", "green", "blue"), (colour * skin + white).astype(np.float32), rig)
    left = without_white(both, np.full((60, 70), 0.2, dtype=np.float32))
    found = specular_images(both, left, rig, grid, np.zeros((60, 70), dtype=np.float32)).stack
    np.testing.assert_allclose(found, 0.8 * white + 0.2 * skin[0], atol=1e-6)  # 0.4 - 0.2 of the skin's light


@pytest.fixture(scope="module")
def simulated() -> tuple[Capture, dict[str, FloatArray]]:
    return splitknit_simulator.simulate_capture(3, settings={"scale": 0.25, "films.kind": "analyser"})


@pytest.mark.slow
def test_a_polarised_capture_has_measured_heights(simulated: tuple[Capture, dict[str, FloatArray]]) -> None:
    capture, truth = simulated
    result = splitknit.reconstruct(capture, settings={"metric.rounds": 1})
    assert result.facts["heights"] == "measured"
    assert result.facts["optics"]["relief_by"] == "polarised"
    figures = splitknit.compare(result, truth).figures
    assert figures["ridge_correlation"] > 0.95
    assert figures["ridge_gain"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_films_that_are_not_crossed_say_so(simulated: tuple[Capture, dict[str, FloatArray]]) -> None:
    capture, _ = simulated
    white = replace(capture.bands["white"], name="white_crossed", polarisation="crossed")
    result = splitknit.reconstruct(replace(capture, bands={**capture.bands, "white_crossed": white}))
    assert result.facts["heights"] == "modelled"
    assert NO_SPECULAR in result.warnings


@pytest.mark.slow
def test_crossed_leds_beside_the_parallel_ones_do_as_well() -> None:
    capture, truth = splitknit_simulator.simulate_capture(3, settings={"scale": 0.25, "films.kind": "leds"})
    assert capture.bands["white"].leds != capture.bands["white_crossed"].leds
    result = splitknit.reconstruct(capture)
    assert result.facts["heights"] == "measured"
    figures = splitknit.compare(result, truth).figures
    assert figures["ridge_correlation"] > 0.95
    assert figures["ridge_gain"] == pytest.approx(1.0, abs=0.1)
