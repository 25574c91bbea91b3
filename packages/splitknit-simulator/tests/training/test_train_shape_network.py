from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.networks.unet import network_of, read_network, run_network
from splitknit_simulator.training.fields import FieldsTrainer, field_scale
from splitknit_simulator.training.networks import fields_network
from splitknit_simulator.training.shape import (
    CHANNELS,
    NETWORK,
    PARTS,
    SLOPES,
    TASK,
    WEIGHT,
    ShapeNetSettings,
    _judge_whole,
    _shape_losses,
)

torch = pytest.importorskip("torch")

SETTINGS = ShapeNetSettings(
    widths=(8, 8), patch_px=16, batch=4, iterations=150, warm_up=5, learning_rate=1e-2, beyond_px=4, precision="float32"
)


def sample_of(seed: int) -> np.ndarray:
    """A finger whose missing slopes are plain functions of what the network sees."""
    rng = np.random.default_rng(seed)
    sample = rng.standard_normal((CHANNELS, 40, 36)).astype(np.float32)
    sample[SLOPES] = sample[0:2] - 0.5 * sample[20:22]
    sample[WEIGHT] = 1.0
    return sample.astype(np.float16)


SAMPLES = [sample_of(0), sample_of(1)]


def weights_of(trainer: FieldsTrainer) -> list[np.ndarray]:
    return [part.numpy().copy() for part in trainer.network.state_dict().values()]


def test_each_part_of_the_loss_says_what_it_is_named_after() -> None:
    rng = np.random.default_rng(0)
    batch = rng.standard_normal((2, CHANNELS, 8, 12)).astype(np.float32)
    made = rng.standard_normal((2, 2, 8, 12)).astype(np.float32)
    weight = batch[:, WEIGHT] = rng.random((2, 8, 12))
    parts = _shape_losses(torch.from_numpy(made), torch.from_numpy(batch), 4)
    error, count = made - batch[:, SLOPES], weight.sum() + 1
    blocks = (error * weight[:, None]).reshape(2, 2, 2, 4, 3, 4).mean(axis=(3, 5))
    fractions = weight.reshape(2, 1, 2, 4, 3, 4).mean(axis=(3, 5))
    wanted = {
        "slope": (error**2 * weight[:, None]).sum() / count,
        "wide": (blocks**2 / (fractions + 0.05)).sum() * 16 / count,
    }
    assert tuple(parts) == PARTS == tuple(wanted)
    for name, value in wanted.items():
        assert float(parts[name]) == pytest.approx(float(value), rel=1e-5), name


def test_an_error_that_changes_from_pixel_to_pixel_is_not_wide() -> None:
    batch = torch.zeros(1, CHANNELS, 16, 16)
    batch[:, WEIGHT] = 1.0
    ripple = torch.ones(1, 2, 16, 16)
    ripple[..., ::2] *= -1
    fine, wide = (_shape_losses(made, batch, 8) for made in (ripple, torch.ones(1, 2, 16, 16)))
    assert float(fine["slope"]) == float(wide["slope"])
    assert float(fine["wide"]) == 0 and float(wide["wide"]) == pytest.approx(2 / 1.05, rel=0.01)


def test_training_lowers_the_loss_and_betters_the_figures() -> None:
    trainer = FieldsTrainer(TASK, SETTINGS, SAMPLES)
    heard: list[float] = []
    before = _judge_whole(trainer.run, SAMPLES[0], SETTINGS.stride)
    first = trainer.train(5)
    trainer.train(135)
    last = trainer.train(10, heard.append)
    for name in PARTS:
        assert last[name] < 0.5 * first[name], name
    after = _judge_whole(trainer.run, SAMPLES[0], SETTINGS.stride)
    assert after["after"] < 0.7 * before["after"] and after["after"] < 0.7 * after["before"]
    assert after["before"] == before["before"]
    assert heard == pytest.approx(np.arange(141, 151) / 150)


def test_weights_decay_and_fields_are_brought_to_one_scale() -> None:
    plain, decaying = (
        FieldsTrainer(
            TASK, ShapeNetSettings(widths=(4, 6), patch_px=16, beyond_px=4, weight_decay=decay, warm_up=1), SAMPLES
        )
        for decay in (0.0, 100.0)
    )
    np.testing.assert_array_equal(plain.network.scale.numpy(), field_scale(TASK, SAMPLES, plain.settings))
    first = plain.network.down[0][0].weight.detach().clone()
    plain.train(1)
    decaying.train(1)
    moved = plain.network.down[0][0].weight - decaying.network.down[0][0].weight
    np.testing.assert_allclose(moved.detach(), 1.5e-3 * 100 * first, atol=1e-5)


@pytest.mark.parametrize("precision", ["float32", "mixed"])
def test_an_interrupted_training_gives_the_same_weights(precision) -> None:
    settings = ShapeNetSettings(widths=(4, 6), patch_px=16, batch=2, iterations=6, beyond_px=4, precision=precision)
    whole = FieldsTrainer(TASK, settings, SAMPLES)
    whole.train(6)
    first = FieldsTrainer(TASK, settings, SAMPLES)
    first.train(3)
    second = FieldsTrainer(TASK, settings, SAMPLES)
    second.restore(first.state())
    assert second.done == 3
    second.train(3)
    for one, other in zip(weights_of(whole), weights_of(second), strict=True):
        np.testing.assert_array_equal(one, other)
    assert not all(np.array_equal(*pair) for pair in zip(weights_of(whole), weights_of(first), strict=True))
    other = FieldsTrainer(
        TASK, ShapeNetSettings(widths=(4, 6), patch_px=16, batch=2, iterations=6, beyond_px=5, wide_share=2.0), SAMPLES
    )
    with pytest.raises(BadInput, match=r"beyond_px, wide_share.*resume with the same"):
        other.restore(first.state())


def test_the_exported_network_computes_what_the_trained_one_does(tmp_path) -> None:
    trainer = FieldsTrainer(TASK, SETTINGS, SAMPLES)
    trainer.train(20)
    weights, card = trainer.packed({"command": "splitknit train shape"})
    (tmp_path / f"{NETWORK.name}.onnx").write_bytes(weights)
    (tmp_path / f"{NETWORK.name}.json").write_bytes(card)
    network = network_of(*read_network(tmp_path / f"{NETWORK.name}.onnx"))
    assert (network.card.channels_in, network.card.channels_out, network.card.stride) == (32, 2, 2)
    assert network.card.facts["command"] == "splitknit train shape"
    assert "slopes that a finger's shape lacks" in network.card.facts["what"]
    fields = np.asarray(SAMPLES[1][:32], dtype=np.float32)
    wanted = trainer.run(fields)
    np.testing.assert_allclose(run_network(network, fields[None])[0], wanted, atol=3e-3 * np.abs(wanted).max())


def test_the_network_has_the_layers_of_the_one_that_ships() -> None:
    shapes = {
        name: tuple(part.shape) for name, part in fields_network(ShapeNetSettings().widths, 32, 2).state_dict().items()
    }
    assert shapes["down.0.0.weight"] == (24, 32, 3, 3) and shapes["down.3.2.weight"] == (64, 64, 3, 3)
    assert shapes["up.0.0.weight"] == (64, 128, 3, 3) and shapes["out.weight"] == (2, 24, 1, 1)
