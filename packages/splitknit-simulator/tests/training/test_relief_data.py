from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import ndimage

from splitknit.errors import BadInput
from splitknit.io.images import write_image
from splitknit.model import Camera, Led, Rig, default_rig
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.learned import COUNT, RELIEF_MM, features
from splitknit.skin.learned import GLARE as GLARE_UNIT
from splitknit_simulator import twin
from splitknit_simulator.finger.master_print import ink_print, master_print
from splitknit_simulator.training.fields import FIELDS
from splitknit_simulator.training.relief import (
    CHANNELS,
    GLARE,
    RELIEF,
    SYMMETRY,
    WEIGHT,
    ReliefData,
    _assembled,
    _draw_scene,
    _light_on,
    _sample_of,
)
from splitknit_simulator.training.scenes import TruthOnGrid, photograph_scene

PITCH_MM = 0.04
SIDE = 96
SMALL = ReliefData(scale=0.12, other_scale_share=0.0, other_rig_share=0.0)


@dataclass(frozen=True, eq=False)
class Scene:
    """A tilted, curved piece of something, its lights, and any images at all."""

    grid: Grid
    white: BandImages
    surface_mm: np.ndarray
    glare: np.ndarray
    relief_mm: np.ndarray

    def sample(self) -> np.ndarray:
        light = _light_on(self.white.rig, self.grid, self.surface_mm, PITCH_MM)
        truth = {
            "mask": self.grid.mask,
            "height_mm": self.surface_mm + self.relief_mm,
            "shape_mm": self.surface_mm,
            "glare_white": self.glare,
        }
        whole = TruthOnGrid(truth, (slice(None), slice(None)), self.grid, 1)
        return _assembled(self.white, self.grid, self.surface_mm, light, whole).astype(np.float32)

    def moved(
        self, image: Callable[[np.ndarray], np.ndarray], x: np.ndarray, y: np.ndarray, place: Callable[..., tuple]
    ) -> Scene:
        rig = self.white.rig
        leds = tuple(replace(led, position_mm=(*place(*led.position_mm[:2]), led.position_mm[2])) for led in rig.leds)
        stack = np.ascontiguousarray(image(self.white.stack))
        return Scene(
            Grid(np.ascontiguousarray(image(self.grid.mask)), x, y, PITCH_MM, (False,) * 4),
            BandImages(self.white.channels, stack, replace(rig, leds=leds)),
            np.ascontiguousarray(image(self.surface_mm)),
            np.ascontiguousarray(image(self.glare)),
            np.ascontiguousarray(image(self.relief_mm)),
        )


@pytest.fixture(scope="module")
def scene() -> Scene:
    rng = np.random.default_rng(0)
    x, y = (np.arange(SIDE) - 40.0) * PITCH_MM, (55.0 - np.arange(SIDE)) * PITCH_MM
    gx, gy = np.meshgrid(x, y)
    surface = (1.0 + 0.3 * gx - 0.2 * gy - 0.15 * gx**2 - 0.05 * gx * gy).astype(np.float32)
    mask = (gx + 0.2) ** 2 + 1.3 * (gy - 0.1) ** 2 < 1.6**2
    azimuths = 2 * np.pi * np.arange(7) / 7 + 0.2
    leds = tuple(
        Led("white", position_mm=(52 * np.cos(a), 52 * np.sin(a), 140.0 + k), intensity=1 + 0.03 * k)
        for k, a in enumerate(azimuths)
    )
    grain = ndimage.gaussian_filter(rng.standard_normal((3, 7, SIDE, SIDE)), (0, 0, 2, 2)) * 0.3
    stack = (0.4 + 0.1 * np.arange(3)[:, None, None, None] + grain).astype(np.float32) * mask
    return Scene(
        Grid(mask, x, y, PITCH_MM, (False,) * 4),
        BandImages(("red", "green", "blue"), stack, Rig(Camera(1 / PITCH_MM, (SIDE, SIDE)), leds)),
        surface,
        rng.random((7, SIDE, SIDE)).astype(np.float32) * mask,
        ndimage.gaussian_filter(rng.standard_normal((SIDE, SIDE)), 2).astype(np.float32) * 0.1,
    )


def test_the_mirrored_finger_is_the_mirrored_sample(scene) -> None:
    x, y = scene.grid.x_mm, scene.grid.y_mm
    other = scene.moved(lambda a: a[..., ::-1], -x[::-1], y, lambda px, py: (-px, py))
    _same(other.sample(), SYMMETRY.flipped(scene.sample()))


def test_the_transposed_finger_is_the_transposed_sample(scene) -> None:
    x, y = scene.grid.x_mm, scene.grid.y_mm
    other = scene.moved(lambda a: a.swapaxes(-1, -2), -y, -x, lambda px, py: (-py, -px))
    _same(other.sample(), SYMMETRY.transposed(scene.sample()))


def _same(one: np.ndarray, other: np.ndarray) -> None:
    for number in range(CHANNELS):  # stored in half precision
        limit = 2e-3 * max(float(np.abs(other[number]).max()), 0.05)
        np.testing.assert_allclose(one[number], other[number], atol=limit, err_msg=f"field {number}")


def test_a_sample_holds_what_the_network_sees_and_shall_draw(scene) -> None:
    grid, white = scene.grid, scene.white
    light = _light_on(white.rig, grid, scene.surface_mm, PITCH_MM)
    seen = features(white, grid, scene.surface_mm, light)
    size = np.linalg.norm(light.vectors, axis=1)
    azimuth = np.array([np.arctan2(*led.position_mm[1::-1]) for led in white.rig.leds])[:, None, None]
    shown = 0.1 + 0.03 * np.cos(azimuth) - 0.02 * np.sin(3 * azimuth)
    bright = replace(scene, glare=(shown * seen.level[1] * size).astype(np.float32))
    sample = bright.sample()
    assert sample.shape == (CHANNELS, SIDE, SIDE) and FIELDS == COUNT
    np.testing.assert_allclose(sample[:FIELDS], seen.fields, atol=2e-3)
    inner = sample[WEIGHT] > 0.5
    assert inner.sum() > 2000
    wanted = np.array([0.1, 0.03, 0, 0, 0, 0, -0.02]) / float(GLARE_UNIT)
    np.testing.assert_allclose(sample[GLARE][:, inner].mean(axis=1), wanted, atol=5e-3)
    assert sample[GLARE][:, inner].std(axis=1).max() < 5e-3
    mask = grid.mask.astype(np.float64)
    blur, fraction = (ndimage.gaussian_filter(part, 7.5, mode="mirror") for part in (scene.relief_mm * mask, mask))
    relief = (scene.relief_mm - blur / fraction) / float(RELIEF_MM)
    np.testing.assert_allclose(sample[RELIEF][inner], relief[inner], atol=0.03)
    assert (sample[:, ~grid.mask] == 0).all()


def test_truth_of_several_pixels_is_their_mean_and_counts_where_all_are_skin(scene) -> None:
    truth = {
        "mask": np.ones((6, 8), dtype=bool),
        "height_mm": np.arange(48.0).reshape(6, 8),
        "shape_mm": np.full((6, 8), 1.0),
        "glare_white": np.ones((2, 6, 8), dtype=np.float16),
    }
    truth["mask"][1, 2] = False
    for name in ("height_mm", "shape_mm"):
        truth[name][1, 2] = np.nan
    coarse = Grid(np.ones((2, 3), dtype=bool), np.arange(3.0), np.arange(2.0), 2 * PITCH_MM, (False,) * 4)
    found = TruthOnGrid(truth, (slice(0, 5), slice(1, 8)), coarse, 2)
    np.testing.assert_array_equal(found.mask, [[False, True, True], [True, True, True]])
    np.testing.assert_allclose(found.relief_mm()[:, 1:], [[6.5, 8.5], [22.5, 24.5]])
    np.testing.assert_allclose(found.shape_mm(), 1.0)
    assert found.glare().shape == (2, 2, 3)


@pytest.fixture(scope="module")
def photographed():
    scene = replace(_draw_scene(5000, SMALL), textured_by=None)
    return scene, *photograph_scene(scene)


@pytest.mark.slow
def test_a_scene_is_photographed_as_the_twin_photographs(photographed, monkeypatch) -> None:
    scene, capture, truth = photographed
    monkeypatch.setattr(twin, "default_rig", lambda *args: scene.rig)
    wanted, true = twin.simulate_capture(5000, settings=scene.settings, finger=scene.finger)
    for name, band in wanted.bands.items():
        np.testing.assert_array_equal(capture.bands[name].pixels, band.pixels)
    np.testing.assert_array_equal(truth["height_mm"], true["height_mm"])
    assert float(truth["skin_scattering_factor"]) == float(true["skin_scattering_factor"])


@pytest.mark.slow
def test_a_finger_goes_through_the_front_end_of_a_reconstruction(photographed) -> None:
    _, capture, truth = photographed
    true, found = (_sample_of(capture, truth, mix).astype(np.float32) for mix in (0.0, 1.0))
    assert true.shape == found.shape and np.isfinite(true).all() and np.isfinite(found).all()
    inner = (true[WEIGHT] > 0.9) & (found[WEIGHT] > 0.9)
    assert inner.sum() > 2500
    # the slopes of the smooth shape: the true one and the first round's are similar, not the same
    for number in (21, 22):
        assert 0.8 < np.corrcoef(true[number][inner], found[number][inner])[0, 1] < 0.99999
    # the relief does not depend on it, and fields show it: ridges are darker where they face away from all lights
    np.testing.assert_array_equal(true[RELIEF][inner], found[RELIEF][inner])
    assert 0.2 < true[RELIEF][inner].std() < 5
    assert abs(np.corrcoef(true[RELIEF][inner], true[2][inner])[0, 1]) > 0.1


def test_scenes_follow_from_their_number_and_stay_in_their_ranges() -> None:
    data = ReliefData(other_scale_share=0.5)
    scenes = [_draw_scene(number, data) for number in range(5000, 5012)]
    skin = defaultdict(float)
    assert scenes[3].facts(skin) == _draw_scene(5003, data).facts(skin) != scenes[4].facts(skin)
    scales = [scene.settings.scale for scene in scenes]
    assert 0 < scales.count(0.5) < 12 and all(0.38 <= scale <= 0.62 for scale in scales)
    assert {scene.rig.camera.height_mm == 140.0 for scene in scenes} == {True, False}
    usual, twists = [led.position_mm[:2] for led in default_rig().leds], []
    for scene in scenes:
        height = scene.rig.camera.height_mm
        assert height == 140.0 or 120 <= height <= 165
        depth = scene.finger.skin.ridge_depth_um
        assert depth == 0 or 25 <= depth <= 110
        for led in scene.rig.leds:
            assert 36 < np.hypot(*led.position_mm[:2]) < 68 and abs(led.position_mm[2] - height) < 6
            twists.append(np.angle(complex(*led.position_mm[:2]) / complex(*usual[len(twists) % 14])))
        aperture = scene.settings.render.aperture_mm
        assert aperture == 0 or 1 <= aperture <= 4
    assert 0.2 < np.abs(twists).max() < 0.6


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fingers": 0}, "fingers"),
        ({"held_out": 0}, "held_out"),
        ({"first": -1}, "first"),
        ({"crops": 0}, "crops"),
        ({"whole_fingers": -1}, "whole_fingers"),
        ({"scale": 0.0}, "scale"),
        ({"other_scale": (0.6, 0.4)}, "other_scale"),
        ({"aperture_share": 1.5}, "aperture_share"),
        ({"glare": (0.0, 9.0)}, "glare"),
        ({"led_height_mm": (5.0, 100.0)}, "led_height_mm"),
    ],
)
def test_ranges_that_make_no_sense_are_refused(change, words) -> None:
    with pytest.raises(BadInput, match=words):
        ReliefData(**change)


@pytest.mark.slow
def test_a_part_of_the_fingers_has_the_ridges_of_real_prints(tmp_path) -> None:
    with pytest.raises(BadInput, match="prints_folder"):
        _draw_scene(5000, ReliefData(prints_folder=str(tmp_path), prints_share=1.0))
    write_image(tmp_path / "one.png", ink_print(master_print("whorl", 5)))
    data = ReliefData(prints_folder=str(tmp_path), prints_share=0.5)
    fingers = [_draw_scene(number, data).finger for number in range(5000, 5012)]
    assert {finger.pattern == "print" for finger in fingers} == {True, False}
    assert all((finger.printed is not None) == (finger.pattern == "print") for finger in fingers)
    plain = _draw_scene(5000, ReliefData()).finger
    assert replace(fingers[0], pattern=plain.pattern, printed=None) == plain
