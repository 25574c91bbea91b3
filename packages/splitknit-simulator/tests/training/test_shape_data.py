from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import ndimage

from splitknit.errors import BadInput
from splitknit.imaging.geometry import height_gradients
from splitknit.model import Camera, Led, Rig
from splitknit.skin import learned
from splitknit.skin.diffusion import SkinSettings, diffusion
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.learned import SHAPE_SLOPE, _shape_features
from splitknit_simulator.training.fields import FIELDS
from splitknit_simulator.training.scenes import photograph_scene
from splitknit_simulator.training.shape import (
    CHANNELS,
    OF_NIR,
    SLOPES,
    SYMMETRY,
    WEIGHT,
    ShapeData,
    _assembled_shape,
    _draw_shape_scene,
    _shape_sample_of,
    shape_sample,
)

PITCH_MM = 0.106
SIDE = 64
SMALL = ShapeData(scale=(0.2, 0.2), other_rig_share=0.0)
SKIN = SkinSettings()
OPTICS = {name: diffusion(SKIN.scattering(name), SKIN.absorption(name)) for name in ("red", "green", "blue", "nir")}


@dataclass(frozen=True, eq=False)
class Scene:
    """A tilted, curved piece of something, its lights, and any images at all."""

    grid: Grid
    bands: tuple[BandImages, ...]
    found_mm: np.ndarray
    true_mm: np.ndarray
    across: tuple[np.ndarray, np.ndarray]

    def sample(self) -> np.ndarray:
        x, y = self.across
        ridges = 0.3 * np.stack([x * x - y * y, 2 * x * y, np.ones_like(x)]) * self.grid.mask
        fields = _shape_features(self.bands, self.grid, self.found_mm * self.grid.mask, OPTICS, ridges)
        return _assembled_shape(fields, self.true_mm, self.grid.mask, self.grid, 1).astype(np.float32)

    def moved(
        self, image: Callable[[np.ndarray], np.ndarray], x: np.ndarray, y: np.ndarray, place: Callable[..., tuple]
    ) -> Scene:
        def turned(field: np.ndarray) -> np.ndarray:
            return np.ascontiguousarray(image(field))

        bands = []
        for band in self.bands:
            leds = tuple(
                replace(led, position_mm=(*place(*led.position_mm[:2]), led.position_mm[2])) for led in band.rig.leds
            )
            bands.append(BandImages(band.channels, turned(band.stack), replace(band.rig, leds=leds)))
        grid = Grid(turned(self.grid.mask), x, y, PITCH_MM, (False,) * 4)
        across = place(*map(turned, self.across))
        return Scene(grid, tuple(bands), turned(self.found_mm), turned(self.true_mm), across)


@pytest.fixture(scope="module")
def scene() -> Scene:
    rng = np.random.default_rng(0)
    x, y = (np.arange(SIDE) - 30.0) * PITCH_MM, (33.0 - np.arange(SIDE)) * PITCH_MM
    gx, gy = np.meshgrid(x, y)
    found = (1.0 + 0.1 * gx - 0.05 * gy - 0.04 * gx**2 - 0.02 * gx * gy).astype(np.float32)
    true = (found + 0.03 * gx**2 - 0.01 * gy**3).astype(np.float32)
    mask = (gx + 0.2) ** 2 + 1.3 * (gy - 0.1) ** 2 < 2.6**2
    bands = []
    for names, turn in ((("red", "green", "blue"), 0.2), (("nir",), 0.5)):
        azimuths = 2 * np.pi * np.arange(7) / 7 + turn
        leds = tuple(
            Led("white", position_mm=(52 * np.cos(a), 52 * np.sin(a), 140.0 + k), intensity=1 + 0.03 * k)
            for k, a in enumerate(azimuths)
        )
        grain = ndimage.gaussian_filter(rng.standard_normal((len(names), 7, SIDE, SIDE)), (0, 0, 2, 2)) * 0.2
        stack = (0.5 + 0.1 * np.arange(len(names))[:, None, None, None] + grain).astype(np.float32) * mask
        bands.append(BandImages(names, stack, Rig(Camera(1 / PITCH_MM, (SIDE, SIDE)), leds)))
    angle = (0.3 * gx + 0.2 * gy).astype(np.float32)
    return Scene(Grid(mask, x, y, PITCH_MM, (False,) * 4), tuple(bands), found, true, (np.cos(angle), np.sin(angle)))


def test_the_mirrored_finger_is_the_mirrored_sample(scene) -> None:
    x, y = scene.grid.x_mm, scene.grid.y_mm
    other = scene.moved(lambda a: a[..., ::-1], -x[::-1], y, lambda px, py: (-px, py))
    _same(other.sample(), SYMMETRY.flipped(scene.sample()))


def test_the_transposed_finger_is_the_transposed_sample(scene) -> None:
    x, y = scene.grid.x_mm, scene.grid.y_mm
    other = scene.moved(lambda a: a.swapaxes(-1, -2), -y, -x, lambda px, py: (-py, -px))
    _same(other.sample(), SYMMETRY.transposed(scene.sample()))


def _same(one: np.ndarray, other: np.ndarray) -> None:
    assert one.shape == other.shape == (CHANNELS, SIDE, SIDE)
    for number in range(CHANNELS):  # stored in half precision
        limit = 2e-3 * max(float(np.abs(other[number]).max()), 0.05)
        np.testing.assert_allclose(one[number], other[number], atol=limit, err_msg=f"field {number}")


def test_the_fields_of_near_infrared_are_those_that_vanish_without_it(scene) -> None:
    with_nir, without = (replace(scene, bands=scene.bands[:count]).sample() for count in (2, 1))
    vanished = [n for n in range(FIELDS) if with_nir[n].any() and not without[n].any()]
    assert tuple(vanished) == OF_NIR
    others = [n for n in range(CHANNELS) if n not in (*OF_NIR, 23)]  # 23 is the trust in the last band's lights
    np.testing.assert_array_equal(without[others], with_nir[others])


def test_a_sample_holds_the_slopes_that_are_missing(scene) -> None:
    sample = scene.sample()
    mask = scene.grid.mask
    inner = sample[WEIGHT] > 0
    assert mask.sum() * 0.85 < inner.sum() < mask.sum() and not (inner & ~mask).any()
    true, found = (np.stack(height_gradients(part, PITCH_MM)) for part in (scene.true_mm, scene.found_mm))
    np.testing.assert_allclose(sample[SLOPES][:, inner] * SHAPE_SLOPE, (true - found)[:, inner], atol=3e-3)
    np.testing.assert_allclose(sample[WEIGHT][inner], (1 / (1 + (true**2).sum(axis=0)))[inner], atol=1e-3)
    assert (sample[:, ~mask] == 0).all() and np.abs(sample[SLOPES]).max() > 0.5


def test_slopes_are_of_the_mean_over_blocks_that_are_known(scene) -> None:
    fields = scene.sample()[:FIELDS]
    fine = np.kron(scene.true_mm, np.ones((2, 2), dtype=np.float32))
    known = np.kron(scene.grid.mask, np.ones((2, 2))) > 0
    known[60, 60] = False
    sample = _assembled_shape(fields, fine, known, scene.grid, 2).astype(np.float32)
    plain = scene.sample()
    lost = {(30, 30), (29, 30), (31, 30), (30, 29), (30, 31)}
    assert set(map(tuple, np.argwhere((plain[WEIGHT] > 0) & (sample[WEIGHT] == 0)))) == lost
    there = sample[WEIGHT] > 0
    np.testing.assert_allclose(sample[:, there], plain[:, there], atol=0.02)


@pytest.mark.slow
def test_a_finger_goes_through_a_reconstruction(monkeypatch) -> None:
    monkeypatch.setattr(learned, "PITCH_MM", (0.017, 0.1))  # a small image will do here
    sample, facts = shape_sample(5000, SMALL)
    assert sample.dtype == np.float16 and np.isfinite(sample).all()
    values = sample.astype(np.float32)
    assert values.shape[0] == CHANNELS and 0.3 < values[WEIGHT].mean() < 0.9
    assert 0.5 < facts["relief_gain"] < 1.3 and facts["rim_exponent"] != 0.75
    there = values[WEIGHT] > 0.5
    missing = values[SLOPES][:, there] * SHAPE_SLOPE
    assert 0.01 < missing.std() < 0.3 < values[20:22][:, there].std() * 4  # small against the finger's own slopes
    assert (values[30][there] == 1).all()  # near-infrared is there
    # with what is missing the shape's slopes are the true ones, close to those found
    found = 2 * values[20:22][:, there]
    for axis in range(2):
        assert 0.85 < np.corrcoef(found[axis], found[axis] + missing[axis])[0, 1] < 0.99999


@pytest.fixture(scope="module")
def coarse():
    """A capture of too few pixels, with its truth and gain."""
    scene, gain = _draw_shape_scene(5000, replace(SMALL, scale=(0.12, 0.12)))
    return *photograph_scene(scene), gain


def test_a_capture_that_no_network_reads_is_refused(coarse) -> None:
    capture, truth, gain = coarse
    with pytest.raises(BadInput, match="lights or pixels"):
        _shape_sample_of(capture, truth, gain)


def test_scenes_follow_from_their_number_and_stay_in_their_ranges() -> None:
    data = ShapeData()
    drawn = [_draw_shape_scene(number, data) for number in range(5000, 5016)]
    again, gain = _draw_shape_scene(5003, data)
    skin = defaultdict(float)
    assert (again.facts(skin), gain) == (drawn[3][0].facts(skin), drawn[3][1])
    assert (again.facts(skin), gain) != (drawn[4][0].facts(skin), drawn[4][1])
    scenes, gains = zip(*drawn, strict=True)
    scales, rims = ([read(scene) for scene in scenes] for read in (lambda s: s.settings.scale, _rim))
    assert 0.34 <= min(scales) < 0.36 and 0.41 < max(scales) <= 0.43
    assert 0 <= min(rims) < 0.25 and 0.75 < max(rims) <= 1
    assert 0.85 < np.mean(gains) < 1.0 and 0.05 < np.std(gains) < 0.2
    assert {scene.rig.camera.height_mm == 140.0 for scene in scenes} == {True, False}
    skins = {scene.settings.skin.scattering_factor for scene in scenes}
    assert skins == {(0.2, 2.2)}


def _rim(scene) -> float:
    return scene.settings.render.rim_exponent


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fingers": 0}, "fingers"),
        ({"held_out": 0}, "held_out"),
        ({"first": -1}, "first"),
        ({"scale": (0.0, 0.5)}, "scale"),
        ({"rim_exponent": (0.5, 1.2)}, "rim_exponent"),
        ({"gain": 0.0}, "gain"),
        ({"gain_spread": 0.5}, "gain_spread"),
        ({"blood": (0.2, 0.1)}, "blood"),
    ],
)
def test_ranges_that_make_no_sense_are_refused(change, words) -> None:
    with pytest.raises(BadInput, match=words):
        ShapeData(**change)
