"""The training scripts, a few steps each."""

import importlib
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.errors import BadInput
from splitknit.networks.unet import load_network, run_network

TRAINING = VALIDATION.parent / "training"
SHIPPED = VALIDATION.parent / "packages/splitknit/src/splitknit/networks/shipped"


@pytest.fixture(scope="module")
def script():
    with scripts_of(TRAINING) as named:
        yield named


@pytest.fixture
def loop(script):
    pytest.importorskip("torch")
    pytest.importorskip("onnx")
    return script("loop")


def test_a_seed_gives_one_palm(script):
    palms = script("palms")
    camera = importlib.import_module("splitknit.model").Camera(25.0, (160, 200))
    first, again, different = (
        palms.palm_surface(palms.draw_palm(seed), camera) for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first.height_mm, again.height_mm)
    assert not np.array_equal(first.relief_um, different.relief_um)
    assert first.mask.all() and 20 < np.ptp(first.relief_um) < 500


@pytest.mark.slow
def test_samples_hold_fields_truth_and_weight(script):
    """A finger for `shape`, pieces of one for `relief`: the fields of both, and skin that
    counts."""
    shape, relief = script("shape"), script("relief")
    sample = shape.shape_sample(5001)
    assert sample.shape[0] == 35 and 0.2 < sample[shape.WEIGHT_CHANNEL].mean(dtype=np.float32) < 1
    relief.CROPS = 1
    piece = relief.training_crops(7000)[0]
    assert piece.shape == (41, 300, 300) and np.abs(piece[relief.RELIEF_CHANNEL]).max() > 0.3


def test_direct_is_trained_on_palms_and_fingers(script, loop, tmp_path, monkeypatch):
    separation = script("separation")
    monkeypatch.setattr(separation, "IMAGE_SIZE", (96, 88))
    monkeypatch.setattr(separation, "PITCH_UM", (40.0, 40.0))
    recipe = replace(separation.SHIPPED, palms=1, fingers=0, views=1, patches=40, width=4, epochs=2)
    monkeypatch.setattr(separation, "HELD_OUT_FROM", 1)  # the palm is its own judge
    subjects = loop.make_data

    def palms_alone(out, wanted, shoot, workers):
        return subjects(
            out, [subject for subject in wanted if subject[0] == "palm"], shoot, workers
        )

    monkeypatch.setattr(loop, "make_data", palms_alone)
    separation.train(tmp_path, recipe, "command", held_out=1, threads=1)
    separated = run_network(
        load_network(tmp_path / "direct.onnx"), np.zeros((1, 3, 40, 48), np.float32)
    )
    assert separated.shape == (1, 3, 40, 48)
    card = json.loads((tmp_path / "direct.json").read_text())
    assert (card["stride"], card["reach"], card["command"]) == (8, 46, "command")
    rows = (tmp_path / "curve.csv").read_text().splitlines()
    assert rows[0] == "epoch,loss,psnr_linear_db,psnr_enhanced_db" and len(rows) == 3


@pytest.mark.parametrize(("name", "channels"), [("relief", 41), ("shape", 35)])
def test_networks_of_fields_learn_and_ship(script, loop, tmp_path, name, channels):
    task = SimpleNamespace(
        **{**vars(script(name).TASK), "batch": 1, "patch_px": 48, "beyond_px": 0}
    )
    rng = np.random.default_rng(0)
    sample = rng.standard_normal((channels, 64, 80)).astype(np.float16)
    sample[32:-1], sample[-1] = sample[: channels - 33], 1.0
    samples = {"finger": [sample]}
    loop.train_fields(task, tmp_path, "command", samples, samples, iterations=3)
    weights = (tmp_path / f"{name}.onnx").read_bytes()
    loop.train_fields(task, tmp_path, "command", samples, samples, iterations=3)
    assert (tmp_path / f"{name}.onnx").read_bytes() == weights
    network = load_network(tmp_path / f"{name}.onnx")
    shipped = load_network(name)
    assert (network.card.channels_out, network.card.stride) == (
        shipped.card.channels_out,
        shipped.card.stride,
    )
    assert len(weights) == pytest.approx((SHIPPED / f"{name}.onnx").stat().st_size, rel=0.02)
    start = tmp_path / f"{name}.onnx"
    before = loop.weights_of(start)
    loop.train_fields(task, tmp_path, "command", samples, samples, iterations=1, start=start)
    after = loop.weights_of(start)
    assert after.keys() == before.keys()
    for key, weight in after.items():  # the first step of a warm-up is small
        np.testing.assert_allclose(weight, before[key], atol=1e-3)


def test_glare_that_is_not_known_does_not_count(script):
    torch = pytest.importorskip("torch")
    relief = script("relief")
    rng = np.random.default_rng(0)
    batch = torch.from_numpy(rng.standard_normal((1, 41, 8, 8)).astype(np.float32))
    batch[:, 40] = 1.0
    output = batch[:, 32:41].clone()
    known = relief.relief_loss(output, batch)
    batch[:, relief.GLARE_CHANNELS] = torch.nan
    assert relief.relief_loss(output, batch) == known


def test_what_is_refused_is_left_out_and_what_is_there_is_kept(loop, tmp_path):
    asked = []

    def shoot(kind, number):
        asked.append(number)
        if number == 1:
            raise BadInput("there is no finger.")
        return [np.full(3, number)]

    for _ in range(2):
        data = loop.make_data(tmp_path, [("finger", 1), ("finger", 2)], shoot, 1)
        assert {subject: arrays[0].tolist() for subject, arrays in data.items()} == {
            ("finger", 2): [2, 2, 2]
        }
    assert asked == [1, 2]
