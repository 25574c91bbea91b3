"""Captures of other kinds than the rig's: each gives a plausible surface with every preset that it
concerns."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

import kinds
from refusals import bad_input
from small_capture import copy_of
from splitknit.io.capture import read_capture
from splitknit.io.images import read_image
from splitknit.io.npz import read_npz
from splitknit.nominal import default_rig
from splitknit.pipeline import reconstruct
from splitknit_simulator.accuracy import compare
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.light.skin import SkinOptics
from splitknit_simulator.scene import BackgroundSettings, TwinSettings
from splitknit_simulator.twin import photograph, simulate_capture

QUICK = {"metric.rounds": 1, "metric.coarse_steps": 2}
"""A short run of the metric recipe: enough to see that a kind of capture gets through."""


def quick(capture, preset):
    return reconstruct(capture, preset, QUICK if preset == "metric" else None)


@pytest.fixture(scope="module")
def capture(twin_capture):
    return twin_capture


@pytest.fixture(scope="module")
def truth(twin_folder):
    return read_npz(twin_folder / "truth.npz")


def plausible(result, truth, rms_mm=1.3, correlation=0.1):
    mask = result.mask
    for field in (result.height_mm, result.ridge_mm, result.shape_mm, result.albedo):
        np.testing.assert_array_equal(np.isfinite(field), mask)
    assert np.isfinite(result.normals).all()
    figures = compare(result, truth).figures
    assert figures["surface_rms_mm"] < rms_mm
    assert figures["mask_on_finger"] > 0.98
    assert figures["ridge_correlation"] > correlation


KINDS = {
    "grey skin": (lambda capture: kinds.grey(capture, "skin"), 1.3, ("pr", "kumar")),
    "grey opaque": (lambda capture: kinds.grey(capture, "opaque"), 1.55, ("ea", "zheng")),
    "three lights": (
        lambda capture: kinds.chosen_lights(capture, [0, 2, 4]),
        1.45,
        ("pr-split", "lin"),
    ),
    "no ambient": (
        lambda capture: kinds.each_band(capture, lambda band: replace(band, ambient=None)),
        1.05,
        ("ea-split", "zheng"),
    ),
    "several leds": (kinds.paired_lights, 1.05, ("kumar", "pr")),
    "distant leds": (kinds.distant, 1.6, ("zheng", "ea")),
    "perspective": (kinds.perspective, 1.05, ("lin", "pr-split")),
    "no nir": (
        lambda capture: replace(capture, bands={"white": capture.bands["white"]}),
        1.3,
        ("kumar", "ea-split"),
    ),
}
"""How a capture is made from the rig's, the factor by which the surface's rms may grow, and two
presets: `metric` and `snk` see every kind, each of the others two kinds that differ."""

METRIC = ("grey skin", "grey opaque", "perspective")
"""Kinds that the metric recipe treats in another way; the presets tell that other numbers of lights
and images do."""


@pytest.mark.parametrize(
    ("kind", "preset"),
    [(kind, KINDS[kind][2][0]) for kind in KINDS]
    + [pytest.param(k, "metric", marks=() if k in METRIC else pytest.mark.slow) for k in KINDS]
    + [pytest.param(k, p, marks=pytest.mark.slow) for k in KINDS for p in ("snk", KINDS[k][2][1])],
)
def test_every_kind_of_capture_gives_a_plausible_surface(kind, preset, capture, truth):
    make, worse, _ = KINDS[kind]
    (rms, _), (correlation, _), _ = kinds.FIGURES[preset]
    result = quick(make(capture), preset)
    plausible(result, truth, min(1.3, worse * rms), 0.85 * correlation)
    words = " ".join(result.warnings)
    no_nir = kind in ("grey skin", "no nir")  # of opaque things white light shows the shape as well
    assert ("no near-infrared band" in words) == (no_nir and preset in ("metric", "snk"))
    assert ("images are grey" in words) == (kind == "grey skin" and preset == "metric")
    assert (result.x_mm is not None) == (kind == "perspective" and preset == "metric")


@pytest.mark.slow
@pytest.mark.parametrize("size", [(323, 459), (329, 470)])
def test_odd_image_sizes_give_a_plausible_surface(size, capture, truth):
    rows, columns = slice(0, size[0]), slice(7, 7 + size[1])
    part = {name: truth[name][rows, columns] for name in ("height_mm", "shape_mm", "mask")}
    for preset in ("metric", "snk"):
        plausible(quick(kinds.cropped(capture, rows, columns), preset), part)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["metric", "ea"])
def test_a_finger_cut_by_one_side_gives_a_plausible_surface(preset, capture, truth):
    columns = np.flatnonzero(truth["mask"].any(axis=0))
    kept = slice(0, int(columns[0] + 0.75 * np.ptp(columns)))
    part = {name: truth[name][:, kept] for name in ("height_mm", "shape_mm", "mask")}
    plausible(quick(kinds.cropped(capture, slice(None), kept), preset), part, 1.8)


TWINS = {
    "tiny": TwinSettings(scale=0.1),
    "smallest": TwinSettings(scale=0.05),
    "srgb": TwinSettings(sensor=SensorSettings(encoding="srgb")),
    "sixteen bits": TwinSettings(sensor=SensorSettings(bits=16)),
    "short": TwinSettings(pose=FingerPose(insertion_mm=18.0)),
    "rolled": TwinSettings(pose=FingerPose(insertion_mm=27.0, roll_rad=0.35, pitch_rad=0.14)),
    "dark skin": TwinSettings(skin=SkinOptics(melanin=0.02, glare=1.3, roughness=0.2)),
    "fair skin": TwinSettings(skin=SkinOptics(melanin=0.0002, blood=0.003)),
    "hand shadow": TwinSettings(background=BackgroundSettings(hand_shadow=0.6, albedo=0.02)),
    "dust": TwinSettings(background=BackgroundSettings(dust_per_cm2=15.0)),
}


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=() if kind in ("tiny", "smallest") else pytest.mark.slow)
        for kind in TWINS
    ],
)
def test_every_kind_of_finger_and_camera_gives_a_plausible_surface(kind):
    settings = TWINS[kind]
    capture, truth = simulate_capture(
        3, "whorl", replace(settings, scale=min(settings.scale, 0.12))
    )
    result = quick(capture, "metric")
    # a ridge has less than two pixels: there is a shape, but no relief to compare
    if kind == "smallest":
        assert compare(result, truth).figures["surface_rms_mm"] < 1.3
    else:
        plausible(result, truth)


@pytest.mark.slow
def test_a_finger_with_two_creases_is_cut_at_the_first():
    """The finger lies far in a picture that is higher than the rig's."""
    settings = TwinSettings(scale=0.15)
    rig = default_rig(0.15)
    camera = replace(rig.camera, image_size=(720, 480))
    surface = finger_surface(draw_finger(5, "left_loop"), FingerPose(insertion_mm=57.0), camera)
    simulated, truth = photograph(
        surface,
        replace(rig, camera=camera),
        SkinOptics(),
        np.random.SeedSequence(1),
        settings=settings,
    )
    result = reconstruct(simulated, "ea")
    assert result.facts["crease_found"], result.warnings
    assert 20 < result.facts["crease_distance_mm"] < 30
    assert truth["mask"][-100:].any()
    plausible(result, truth)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["jpg", "tiff"])
def test_jpeg_and_tiff_give_the_surface_of_png(suffix, twin_folder, truth, upright, tmp_path):
    """JPEG of 8 and TIFF of 16 bits in place of the PNGs."""
    folder = copy_of(twin_folder, tmp_path / "capture")
    for file in sorted(folder.glob("*.png")):
        pixels = read_image(file)
        picture = (
            pixels[..., ::-1] if suffix == "jpg" else pixels[..., ::-1].astype(np.uint16) * 257
        )
        options = [cv2.IMWRITE_JPEG_QUALITY, 97] if suffix == "jpg" else []
        assert cv2.imwrite(str(file.with_suffix(f".{suffix}")), picture, options)
        file.unlink()
    text = (folder / "capture.json").read_text().replace(".png", f".{suffix}")
    (folder / "capture.json").write_text(text)
    assert json.loads(text)["bands"]["white"]["images"][0] == f"white_0.{suffix}"
    capture = read_capture(folder)
    result = reconstruct(capture, "ea")
    plausible(result, truth)
    both = result.mask & upright.mask
    assert both.sum() > 0.99 * upright.mask.sum()
    difference = (result.height_mm - upright.height_mm)[both]
    assert difference.std() < (0.05 if suffix == "jpg" else 1e-4)


@pytest.fixture(scope="module")
def upright(capture):
    return reconstruct(capture, "ea")


def test_a_mask_that_is_a_narrow_strip_is_refused(capture):
    mask = np.zeros(capture.shape, dtype=bool)
    mask[200:300, 240:256] = True
    with bad_input(r"given mask is too small: it is nowhere wider than 1\.4 mm"):
        reconstruct(replace(capture, mask=mask), "ea")


@pytest.mark.parametrize(
    ("material", "px_per_mm"),
    [("skin", 961.0), ("skin", 0.03785), ("skin", 37850.0), ("opaque", 961.0), ("opaque", 37850.0)],
)
def test_an_impossible_scale_is_refused(material, px_per_mm, capture):
    rig = replace(capture.rig, camera=replace(capture.rig.camera, px_per_mm=px_per_mm))
    with bad_input(f"{px_per_mm:g} px/mm"):
        quick(replace(capture, rig=rig, material=material), "ea")


@pytest.mark.slow
def test_an_unusual_finger_width_gets_a_note(capture):
    camera = capture.rig.camera
    rig = replace(capture.rig, camera=replace(camera, px_per_mm=2.5 * camera.px_per_mm))
    for stated, unusual in ((replace(capture, rig=rig), True), (capture, False)):
        warnings = quick(kinds.distant(stated), "ea").warnings
        assert any("mm is usual: check" in text for text in warnings) == unusual
