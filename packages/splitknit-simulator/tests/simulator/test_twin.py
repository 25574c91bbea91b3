"""Whole captures of the twin."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit.model import Camera
from splitknit.nominal import default_rig
from splitknit.observation.observe import observe
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.finger.finger import PoseRanges
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.light.skin import SkinOptics
from splitknit_simulator.rigs import MirrorSettings
from splitknit_simulator.scene import BackgroundSettings, TwinSettings, background_albedo
from splitknit_simulator.twin import photograph, simulate_capture
from surfaces import ridged_egg

QUIET = SensorSettings(noise=False, bits=16, raw_bits=16)


@pytest.fixture(scope="module")
def egg():
    return ridged_egg((280, 260), 18.9)


def _digest(capture, truth):
    parts = [
        band.pixels.tobytes() + band.ambient.pixels.tobytes() for band in capture.bands.values()
    ]
    parts += [key.encode() + np.ascontiguousarray(truth[key]).tobytes() for key in sorted(truth)]
    return hashlib.sha256(b"".join(parts)).hexdigest()


@pytest.fixture(scope="module")
def photo(egg):
    """Photographs of the egg with these settings, and their truth."""
    rig = replace(default_rig(0.25, seed=3), camera=egg.camera)

    def photo(seed=1, skin=None, **settings):
        seeds = np.random.SeedSequence(seed)
        return photograph(egg, rig, skin or SkinOptics(), seeds, settings=TwinSettings(**settings))

    return photo


def _light(capture, channel="green"):
    light = observe(capture).white
    return light.grey if channel == "grey" else light.stack[light.channels.index(channel)]


def test_a_capture_has_the_arrays_and_types_of_the_format(photo):
    capture, truth = photo()
    assert capture.material == "skin"
    assert capture.subject["id"] == "anonymous"
    assert capture.bands["white"].leds == tuple((k,) for k in range(7))
    assert capture.bands["nir"].leds == tuple((k,) for k in range(7, 14))
    for name in ("white", "nir"):
        assert capture.bands[name].pixels.shape == (7, 280, 260, 3)
        assert capture.bands[name].pixels.dtype == np.uint8
        assert truth[f"glare_{name}"].shape == (7, 280, 260)
        assert truth[f"glare_{name}"].dtype == np.float16
    for name in (
        "height_mm",
        "shape_mm",
        "mask",
        "normals",
        "relief_um",
        "optics_scattering_per_mm",
        "skin_melanin",
    ):
        assert name in truth
    assert all(array.dtype != object for array in truth.values())
    assert truth["landmark_pose_yaw_deg"] == 0.0
    assert str(truth["landmark_pattern"]) == "rings"


def test_exposure_leaves_headroom_and_skin_has_its_colours(photo):
    capture, truth = photo(skin=SkinOptics(glare=0.0))
    light = [_light(capture, name)[:, truth["mask"]] for name in ("red", "green", "blue")]
    assert np.percentile(light[0], 99.9) == pytest.approx(0.7, abs=0.06)
    red, green, blue = (channel.mean() for channel in light)
    assert red > green > blue > 0.2 * red
    nir = capture.bands["nir"].pixels[:, truth["mask"]].astype(float)
    means = nir.mean(axis=(0, 1))
    assert means.max() < 1.02 * means.min()
    noise = nir - nir.mean(axis=-1, keepdims=True)
    assert noise.std() > 0.3  # the three channels see the same light with their own noise


@pytest.mark.slow
def test_ambient_light_is_in_every_image_and_in_its_frame(photo):
    lit, truth = photo(sensor=QUIET, background=BackgroundSettings(ambient=0.05))
    dark, _ = photo(sensor=QUIET, background=BackgroundSettings(ambient=0.0))
    removed, reference = _light(lit), _light(dark)
    inside = truth["mask"] & (reference.max(axis=0) < 0.9)
    assert lit.bands["white"].ambient.pixels[truth["mask"]].mean() > 300
    np.testing.assert_allclose(removed[:, inside], reference[:, inside], atol=2e-4)
    assert dark.bands["white"].ambient.pixels.max() == 0
    noisy, _ = photo(sensor=SensorSettings(bits=16), background=BackgroundSettings(ambient=0.05))
    beside = ~truth["mask"]
    frame, image = (
        pixels[..., 1][beside].astype(float)
        for pixels in (noisy.bands["white"].ambient.pixels, noisy.bands["white"].pixels[0])
    )
    assert abs(np.corrcoef(frame, image)[0, 1]) < 0.2  # each exposure has its own noise


def test_dust_brightens_and_the_shadow_of_the_hand_darkens_the_picture(photo):
    camera = Camera(20.0, (200, 300))
    plain = background_albedo(camera, BackgroundSettings(), np.random.default_rng(0))
    assert np.unique(plain).size == 1
    dusty = background_albedo(
        camera, BackgroundSettings(dust_per_cm2=20.0), np.random.default_rng(0)
    )
    assert dusty.max() > 5 * plain.max()
    open_hand, truth = photo(sensor=QUIET)
    shaded, _ = photo(sensor=QUIET, background=BackgroundSettings(hand_shadow=0.8))
    ratio = _light(shaded)[0] / np.maximum(_light(open_hand)[0], 1e-6)
    assert ratio[100, 130] == pytest.approx(1.0, abs=0.01)
    assert ratio[np.flatnonzero(truth["mask"][:, 130])[-1] - 2, 130] < 0.5
    background = open_hand.bands["white"].pixels[0][~truth["mask"]] / 65535.0
    assert 0 < background.mean() < 0.02


@pytest.mark.slow
def test_a_coloured_background_lights_the_flanks(photo):
    black, truth = photo(sensor=QUIET)
    green = BackgroundSettings(colour=(0.0, 0.4, 0.1, 0.7))
    before_green, its = photo(sensor=QUIET, background=green)
    beside = ~truth["mask"]
    paper = before_green.bands["white"].pixels[0][beside].mean(axis=0)
    assert paper[0] < 0.01 * paper[1]
    assert paper[2] == pytest.approx(0.25 * paper[1], rel=0.02)
    assert (
        before_green.bands["nir"].pixels[0][beside].mean()
        > 5 * black.bands["nir"].pixels[0][beside].mean()
    )
    before, after = (
        _light(capture)[0] / exposed["exposure_white"]
        for capture, exposed in ((black, truth), (before_green, its))
    )
    added, level = after - before, truth["normals"][..., 2]
    flank, top = truth["mask"] & (level > 0.3) & (level < 0.5), truth["mask"] & (level > 0.98)
    assert np.median(added[flank]) > 5 * abs(np.median(added[top]))


def test_mirrors_before_a_coloured_background_are_refused():
    green = BackgroundSettings(colour=(0.0, 0.4, 0.1, 0.7))
    with bad_input("on black, without films"):
        TwinSettings(background=green, mirrors=MirrorSettings(names=("left",)))


@pytest.mark.slow
def test_an_aperture_blurs_deep_skin_and_none_changes_nothing(photo):
    sharp, truth = photo(sensor=QUIET)
    off, _ = photo(sensor=QUIET, render=RenderSettings(aperture_mm=0.0, focus_depth_mm=0.3))
    np.testing.assert_array_equal(sharp.bands["white"].pixels, off.bands["white"].pixels)
    soft, _ = photo(sensor=QUIET, render=RenderSettings(aperture_mm=11.0, focus_depth_mm=0.3))
    change = np.abs(
        soft.bands["white"].pixels[0].astype(float) - sharp.bands["white"].pixels[0]
    ).mean(axis=-1)
    depth = np.nanmax(truth["shape_mm"]) - truth["shape_mm"]
    near, far = (
        change[truth["mask"] & (depth < 0.5)].mean(),
        change[truth["mask"] & (depth > 2) & (depth < 3.5)].mean(),
    )
    assert far > 2 * near


@pytest.mark.slow
def test_a_capture_depends_on_its_seed_and_not_on_workers(photo):
    expected = _digest(*photo())
    assert expected == _digest(*photo(render=RenderSettings(workers=5)))
    assert expected != _digest(*photo(seed=2))


@pytest.mark.slow
def test_impressions_of_a_finger_differ_in_pose_and_share_its_skin():
    settings = TwinSettings(scale=0.1, render=RenderSettings(workers=2))
    capture, truth = simulate_capture(11, "whorl", settings)
    again = simulate_capture(11, "whorl", replace(settings, render=RenderSettings(workers=1)))
    assert _digest(capture, truth) == _digest(*again)
    assert capture.shape == capture.bands["nir"].pixels.shape[1:3] == truth["mask"].shape
    assert 0.1 < truth["mask"].mean() < 0.6
    assert str(truth["landmark_pattern"]) == "whorl"
    assert truth["mask"][-1].any()
    assert not truth["mask"][0].any()
    second, moved = simulate_capture(11, "whorl", settings, impression=1)
    assert second.subject["session"] == 2
    assert moved["skin_melanin"] == truth["skin_melanin"]
    assert moved["landmark_yaw_rad"] != truth["landmark_yaw_rad"]
    assert (moved["mask"] != truth["mask"]).any()


def test_poses_are_drawn_inside_their_ranges_and_the_picture():
    camera = default_rig(0.5).camera
    poses = [PoseRanges().draw(np.random.default_rng(seed), camera) for seed in range(50)]
    assert max(abs(p.yaw_rad) for p in poses) <= np.deg2rad(10)
    assert np.std([p.roll_rad for p in poses]) > np.deg2rad(2)
    deep = PoseRanges(insertion_mm=(40.0, 40.0)).draw(np.random.default_rng(0), camera)
    assert deep.insertion_mm < 1100 / camera.px_per_mm


def test_a_reversed_pose_range_is_refused():
    with bad_input("yaw_deg"):
        PoseRanges(yaw_deg=(5.0, -5.0))


def test_a_rig_of_another_camera_than_the_surface_is_refused(egg):
    with bad_input("camera has"):
        photograph(
            egg, default_rig(0.5), SkinOptics(), np.random.SeedSequence(0), settings=TwinSettings()
        )
