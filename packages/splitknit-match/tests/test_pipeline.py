"""The whole pipeline on a small simulated finger: fields, frames, meshes, facts and settings."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from kinds import FIGURES, turned
from refusals import bad_input
from splitknit.capture import Band, Capture
from splitknit.imaging.geometry import height_gradients, normals_from_gradients, warp
from splitknit.imaging.view import view_of
from splitknit.io.npz import read_npz
from splitknit.io.provenance import provenance
from splitknit.io.results import read_result, write_mesh
from splitknit.model import Camera, Led, Rig
from splitknit.pipeline import located, reconstruct
from splitknit.presets import PRESETS, chosen_settings, preset_settings
from splitknit.reconstruction import surface_of
from splitknit.settings import flatten
from splitknit_match.matching.inputs import read_surface
from splitknit_match.matching.surface import surface_images
from splitknit_simulator.accuracy import compare
from splitknit_simulator.finger.finger import FingerPose
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture
from written_files import read_ply

_POSE = FingerPose(insertion_mm=28.0, yaw_rad=0.1)


@pytest.fixture(scope="module")
def capture(twin_capture):
    return twin_capture


@pytest.fixture(scope="module")
def truth(twin_folder):
    return read_npz(twin_folder / "truth.npz")


@pytest.fixture(scope="module")
def results(capture):
    return {preset: reconstruct(capture, preset) for preset in PRESETS}


@pytest.mark.parametrize("preset", PRESETS)
def test_results_lie_on_the_input_grid(results, capture, preset):
    result = results[preset]
    assert result.preset == preset
    assert result.pitch_mm == pytest.approx(1 / (0.15 * 75.7), rel=1e-3)
    fields = [result.height_mm, result.ridge_mm, result.shape_mm, result.albedo]
    fields += [result.uncertainty_um] if preset == "metric" else []
    for field in fields:
        assert field.shape == capture.shape
        assert field.dtype == np.float32
        assert_array_equal(np.isfinite(field), result.mask)
    assert (result.uncertainty_um is None) == (preset != "metric")
    inside = result.mask
    height_mm = result.ridge_mm + result.shape_mm
    assert_allclose(height_mm[inside], result.height_mm[inside], atol=1e-4)
    expected = normals_from_gradients(*height_gradients(result.height_mm, result.pitch_mm))
    assert_allclose(result.normals[inside], expected[inside], atol=1e-5)
    assert not result.normals[~inside].any()


@pytest.mark.parametrize("preset", PRESETS)
def test_the_surface_is_that_of_the_finger(results, truth, preset):
    """At a sixth of the full scale a ridge has five pixels; validation holds the accuracy at full
    scale."""
    as_accurate(preset, results[preset], truth)


@pytest.mark.slow
def test_the_networks_show_the_ridges_of_a_coarse_camera(capture, results):
    """At 12.9 pixels a millimetre both networks run, on a grid twice as fine."""
    fine, truth = simulate_capture(3, "whorl", TwinSettings(scale=0.17, pose=_POSE))
    result = reconstruct(fine)
    assert result.facts["optics"]["relief_by"] == "network"
    assert not any("network" in warning for warning in result.warnings)
    as_accurate("metric with networks", result, truth)


def as_accurate(name, result, truth):
    """As good as stored, within three standard deviations and 1 % for other versions of
    packages."""
    figures = compare(result, truth).figures
    assert figures["mask_on_finger"] > 0.99
    (rms, rms_spread), (correlation, correlation_spread), (gain, gain_spread) = FIGURES[name]
    assert figures["surface_rms_mm"] < 1.01 * rms + 3 * rms_spread
    assert figures["ridge_correlation"] > 0.99 * correlation - 3 * correlation_spread
    assert figures["ridge_gain"] == pytest.approx(gain, abs=0.01 * gain + 3 * gain_spread)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_result_states_how_it_was_computed(results, preset):
    result = results[preset]
    direct = "direct light by the network" in result.facts["separation"]
    assert direct == (preset in ("pr", "pr-split", "snk"))
    # a sixth of the full scale is too coarse for the network
    coarse = any("the network of the relief needs" in words for words in result.warnings)
    assert coarse == (preset == "metric")
    assert result.facts["shape_source"] == ("nir" if preset in ("metric", "snk") else "white")
    assert result.facts["mask"] == "found"
    assert result.settings == asdict(preset_settings(preset))


@pytest.mark.parametrize("preset", PRESETS)
def test_a_result_states_its_inputs_times_and_light(results, capture, preset):
    result = results[preset]
    assert result.hashes == capture.hashes
    assert len(result.hashes) == 14 + 2 + 2  # images, ambient, two documents
    assert {"surface", "result"} <= set(result.timings_s)
    assert all(seconds >= 0 for seconds in result.timings_s.values())
    assert set(result.quality) == {"white", "nir"}
    assert len(result.quality["nir"]["led_relative"]) == 7


@pytest.mark.slow
def test_progress_never_falls(capture):
    fractions = []
    reconstruct(capture, "snk", progress=lambda _, fraction: fractions.append(fraction))
    assert fractions == sorted(fractions)
    assert 0 <= fractions[0] < fractions[-1] <= 1


@pytest.mark.slow
def test_the_phalange_ends_at_the_crease(results, capture, truth):
    result = results["ea"]
    assert result.facts["crease_found"]
    assert 20 < result.facts["crease_distance_mm"] < 30
    whole = reconstruct(capture, "ea", {"cut_at_crease": False})
    assert {"finger", "light", "surface", "result"} <= set(whole.timings_s)
    assert (whole.mask & ~result.mask).sum() > 30 * capture.shape[1] // 10
    assert not (result.mask & ~whole.mask).any()
    (left, upper), (right, lower) = result.facts["crease_line"]
    columns = np.arange(int(left) + 5, int(right) - 5)
    ends = np.array([np.flatnonzero(result.mask[:, column]).max() for column in columns])
    slope = -np.tan(np.deg2rad(result.facts["yaw_deg"]))
    assert np.polyfit(columns, ends, 1)[0] == pytest.approx(slope, abs=0.01)
    # straight across, at the crease's middle
    assert ends.mean() == pytest.approx((upper + lower) / 2, abs=1.5)
    below = np.mgrid[0 : capture.shape[0], 0 : capture.shape[1]][0] > ends.min()
    lost = truth["mask"].astype(bool) & ~below & ~result.mask
    assert lost.sum() < 0.02 * result.mask.sum()


def test_the_upright_frame_has_the_tip_up(results):
    result = results["ea"]
    assert abs(np.linalg.det(result.input_from_upright) - 1) < 1e-9  # turned and moved, not scaled
    mask = result.mask.astype(np.float32)
    upright = warp(mask, result.input_from_upright, result.upright_size) > 0.5
    assert upright.sum() == pytest.approx(result.mask.sum(), rel=0.01)  # nothing is cut off
    widths = upright.sum(axis=1)
    rows = np.flatnonzero(widths)
    assert rows[0] < 0.1 * upright.shape[0]
    assert widths[rows[0] + 3] < 0.5 * widths.max()  # round above
    assert widths[rows[-1] - 3] > 0.8 * widths.max()  # cut straight below
    middle = [np.flatnonzero(upright[row]).mean() for row in (rows[0] + 20, rows[-1] - 20)]
    assert abs(middle[0] - middle[1]) < 4


def test_mesh_and_heights_are_one_surface(results, tmp_path):
    """Each vertex, taken back to the input by `input_from_upright`'s turn, is its pixel."""
    result = results["snk"]
    write_mesh(tmp_path / "m.ply", result, provenance({}, {}))
    vertices = read_ply(tmp_path / "m.ply").vertices_mm
    assert len(vertices) == result.mask.sum()
    rows, columns = np.nonzero(result.mask)
    assert_array_equal(vertices[:, 2], result.height_mm[rows, columns])
    turn = result.input_from_upright[:2, :2]
    upright = np.stack([vertices[:, 0], -vertices[:, 1]]) / result.pitch_mm  # column, row
    back = turn @ upright
    assert_allclose(back[0] - back[0].mean(), columns - columns.mean(), atol=0.01)
    assert_allclose(back[1] - back[1].mean(), rows - rows.mean(), atol=0.01)


@pytest.mark.parametrize(
    ("quarter_turns", "tip_deg"),
    [(1, 90.0), pytest.param(2, 180.0, marks=pytest.mark.slow), (3, -90.0)],
)
def test_a_turned_capture_gives_the_turned_surface(capture, results, quarter_turns, tip_deg):
    """Images, lights and tip turned together: the same finger, up to rounding."""
    result = reconstruct(turned(capture, quarter_turns, tip_deg), "snk")
    expected = results["snk"]
    mask = np.rot90(expected.mask, quarter_turns)
    assert (result.mask & mask).sum() > 0.995 * (result.mask | mask).sum()
    difference = result.height_mm - np.rot90(expected.height_mm, quarter_turns)
    assert difference[result.mask & mask].std() < 0.03
    turn = result.facts["yaw_deg"] - expected.facts["yaw_deg"]
    assert abs((turn - tip_deg + 180) % 360 - 180) < 0.5
    assert result.upright_size == pytest.approx(expected.upright_size, abs=4)


@pytest.mark.slow
def test_a_yawed_finger_is_the_same_phalange():
    """The same finger laid down straight and turned by 17 deg: upright, its relief and outline
    agree."""
    uprights = []
    for yaw in (0.0, 0.3):
        pose = FingerPose(insertion_mm=28.0, yaw_rad=yaw)
        simulated, _ = simulate_capture(3, "whorl", TwinSettings(scale=0.15, pose=pose))
        result = reconstruct(simulated, "snk")
        assert result.facts["yaw_deg"] == pytest.approx(np.rad2deg(yaw), abs=1.0)
        fields = [np.nan_to_num(result.shape_mm), result.mask.astype(np.float32)]
        size = (330, 200)
        uprights.append([warp(field, result.input_from_upright, size) for field in fields])
        uprights[-1].append(result.facts["crease_distance_mm"])
    (shape_0, mask_0, crease_0), (shape_1, mask_1, crease_1) = uprights
    assert crease_0 == pytest.approx(crease_1, abs=0.2)
    both, either = (mask_0 > 0.5) & (mask_1 > 0.5), (mask_0 > 0.5) | (mask_1 > 0.5)
    assert both.sum() > 0.95 * either.sum()
    inside = both & (warp(mask_0, np.eye(3), mask_0.shape) > 0.99)
    difference = (shape_0 - shape_1)[inside]
    assert (difference - difference.mean()).std() < 0.25


@pytest.mark.slow
def test_a_given_mask_is_used_as_it_is(capture, truth):
    """Across the crease, with a hole, and touching three borders: not a pixel is changed."""
    mask = truth["mask"].astype(bool)
    mask[100:104, 236:240] = False
    mask[-6:] = True
    result = reconstruct(replace(capture, mask=mask), "ea")
    assert_array_equal(result.mask, mask)
    assert_array_equal(np.isfinite(result.height_mm), mask)
    assert result.facts["mask"] == "given"
    assert not result.facts["crease_found"]


def differing(first, second):
    before, after = flatten(asdict(first)), flatten(asdict(second))
    assert before.keys() == after.keys()
    return {name: after[name] for name in before if before[name] != after[name]}


@pytest.mark.parametrize(
    "change",
    [
        {"knit.method": "crossover"},
        {"height.method": "poisson"},
        {"enhance.clahe": False},
        {"shapelets.scales": 4},
        {"shape.source": "white"},
        {"direct.method": "none"},
        {"normals.method": "robust"},
    ],
)
def test_one_setting_changes_one_thing(capture, results, change):
    base = results["snk"]
    result = reconstruct(capture, "snk", change)
    before, after = flatten(base.settings), flatten(result.settings)
    assert {name: after[name] for name in after if after[name] != before[name]} == change
    assert_array_equal(result.mask, base.mask)
    assert not np.array_equal(result.height_mm, base.height_mm, equal_nan=True)


def test_a_result_is_named_after_its_settings():
    for name in PRESETS:
        settings = preset_settings(name)
        assert chosen_settings("metric", settings) == (name, PRESETS[name])
        assert chosen_settings("metric", replace(settings, top_mm=0.0))[1] == PRESETS[name]
    assert chosen_settings("metric", replace(PRESETS["snk"], top_mm=1.0))[0] == "snk, changed"
    assert chosen_settings("zheng", replace(PRESETS["zheng"], top_mm=1.0))[0] == "zheng, changed"
    assert chosen_settings("snk", {"top_mm": 1.0})[0] == "snk, changed"
    assert chosen_settings("snk", {"top_mm": 0.0})[0] == "snk"
    assert chosen_settings("snk", None) == ("snk", PRESETS["snk"])


def test_the_thesis_cases_differ_as_the_thesis_says():
    assert differing(PRESETS["ea"], PRESETS["pr"]) == {
        "enhance.clahe": True,
        "direct.method": "network",
    }
    assert differing(PRESETS["pr"], PRESETS["snk"]) == {"knit.method": "addition"}
    assert differing(PRESETS["pr"], PRESETS["pr-split"]) == {"knit.method": "none"}
    assert differing(PRESETS["ea"], PRESETS["ea-split"]) == {"knit.method": "none"}
    assert PRESETS["ea"].height.method == "frankot_chellappa"
    assert PRESETS["snk"].shapelets.scales == 3


@pytest.mark.parametrize("preset", ["ea", "pr"])
def test_a_surface_that_is_not_split_is_matched_by_its_height(results, preset, tmp_path):
    unsplit, split = results[preset], results[f"{preset}-split"]
    assert unsplit.whole
    assert not split.whole
    assert_array_equal(unsplit.height_mm, split.height_mm)
    inside = unsplit.mask
    # the shape is the smooth part of the heights
    assert np.abs(unsplit.shape_mm - unsplit.height_mm)[inside].max() < 1
    assert 0.005 < np.std(unsplit.ridge_mm[inside]) < 0.1
    unsplit.save(tmp_path / "result")
    kept = read_result(tmp_path / "result")
    assert kept.whole
    heights = replace(surface_of(split), ridge_mm=unsplit.ridge_mm + unsplit.shape_mm)
    of_heights = surface_images(heights).channels["relief"]
    from_file = read_surface(tmp_path / "result" / "height.npz")
    for surface in (surface_of(unsplit), surface_of(kept), from_file):
        relief = surface_images(surface).channels["relief"]
        assert_array_equal(relief, of_heights)
    relief = surface_images(surface_of(split)).channels["relief"]
    assert np.corrcoef(relief.ravel(), of_heights.ravel())[0, 1] < 0.5
    if preset == "pr":  # the relief of SnK too
        assert_array_equal(split.ridge_mm, results["snk"].ridge_mm)


@pytest.mark.slow
def test_presets_that_share_a_located_finger_are_what_they_are_alone(capture):
    finger = located(capture, "snk")
    for preset in ("snk", "ea", "pr"):
        shared, alone = (reconstruct(source, preset) for source in (finger, capture))
        for name in ("height_mm", "ridge_mm", "shape_mm", "normals", "albedo", "mask"):
            fields = getattr(shared, name), getattr(alone, name)
            assert_array_equal(*fields, err_msg=f"{preset} {name}")
        assert shared.warnings == alone.warnings
        assert shared.quality == alone.quality
    with bad_input("located by other settings"):
        reconstruct(finger, "ea", {"cut_at_crease": False})


def test_unknown_presets_settings_and_bands_are_refused(capture):
    with bad_input(r"no preset 'best'; known are metric, snk, pr, ea"):
        reconstruct(capture, "best")
    with bad_input("no band 'white'"):
        reconstruct(replace(capture, bands={"nir": capture.bands["nir"]}))
    with bad_input(r"there is no setting 'knit\.glue'"):
        reconstruct(capture, "snk", {"knit.glue": 1})


def lambertian_dome():
    """A matt dome 11 mm right of the picture's middle under four near lights, and its height."""
    camera = Camera(12.0, (240, 440))
    view = view_of(camera)
    x, y = np.meshgrid(view.x_mm - 11.0, view.y_mm)
    inside = x**2 + y**2 < 8.0**2
    height = np.where(inside, np.sqrt(np.maximum(12.0**2 - x**2 - y**2, 0.0)) - 11.0, 0.0)
    points = np.stack([x + 11.0, y, height], axis=-1)
    normals = np.stack([x, y, height + 11.0], axis=-1) / 12.0
    places = (50, 0, 90), (0, 50, 90), (-50, 0, 90), (0, -50, 90)
    leds = tuple(Led("white", position_mm=place) for place in places)
    images = []
    for led in leds:
        towards = np.array(led.position_mm) - points
        distance = np.linalg.norm(towards, axis=-1)
        images.append((normals * towards).sum(axis=-1) / distance**3 * inside)
    pixels = np.round(np.stack(images) / np.max(images) * 60000).astype(np.uint16)[..., None]
    band = Band("white", pixels, tuple((k,) for k in range(4)), np.ones(4), np.zeros(4))
    capture = Capture(Rig(camera, leds), {"white": band}, material="opaque", mask=inside)
    return capture, height


def test_a_matt_dome_beside_the_middle_is_measured_under_near_lights():
    """To a micrometre without noise; the lights must be placed against the picture, not the
    window."""
    capture, height = lambertian_dome()
    result = reconstruct(capture, "metric", {"metric.plane_mm": float(height[capture.mask].mean())})
    error = (result.height_mm - height)[capture.mask]
    assert error.std() < 0.001
    far = (reconstruct(capture, "ea").height_mm - height)[capture.mask]
    assert far.std() > 0.1  # `ea` takes the lights for distant
