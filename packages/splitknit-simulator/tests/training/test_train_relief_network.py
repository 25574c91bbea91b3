from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.networks.unet import network_of, read_network, run_network
from splitknit_simulator.training.fields import FieldsTrainer, field_scale
from splitknit_simulator.training.networks import fields_network
from splitknit_simulator.training.relief import (
    CHANNELS,
    GLARE,
    NETWORK,
    PARTS,
    RELIEF,
    TASK,
    WEIGHT,
    ReliefSettings,
    _judge_middle,
    _relief_losses,
)
from splitknit_simulator.training.trainer import packed

torch = pytest.importorskip("torch")

SETTINGS = ReliefSettings(
    widths=(8, 8),
    patch_px=16,
    batch=4,
    iterations=150,
    warm_up=5,
    learning_rate=1e-2,
    slope_share=0.2,
    glare_share=3.0,
    precision="float32",
)


def sample_of(seed: int) -> np.ndarray:
    """A finger whose relief, glare and error are plain functions of what the network sees."""
    rng = np.random.default_rng(seed)
    sample = rng.standard_normal((CHANNELS, 40, 36)).astype(np.float32)
    sample[RELIEF] = sample[0] - 0.5 * sample[1]
    sample[GLARE] = 0.0
    sample[GLARE.start] = 3 * sample[2]  # the only wave that does not turn with the image
    sample[WEIGHT] = 1.0
    sample[20:32] *= 7.0
    return sample.astype(np.float16)


SAMPLES = [sample_of(0), sample_of(1)]


def weights_of(trainer: FieldsTrainer) -> list[np.ndarray]:
    return [part.numpy().copy() for part in trainer.network.state_dict().values()]


def test_each_part_of_the_loss_says_what_it_is_named_after() -> None:
    rng = np.random.default_rng(0)
    batch = rng.standard_normal((2, CHANNELS, 5, 6)).astype(np.float32)
    made = rng.standard_normal((2, 9, 5, 6)).astype(np.float32)
    weight = batch[:, WEIGHT] = rng.random((2, 5, 6))
    parts = _relief_losses(torch.from_numpy(made), torch.from_numpy(batch))
    error, count = made[:, 0] - batch[:, RELIEF], weight.sum() + 1
    across = (np.diff(error, axis=2) * weight[:, :, 1:]) ** 2
    down = (np.diff(error, axis=1) * weight[:, 1:]) ** 2
    wanted = {
        "relief": (error**2 * weight).sum() / count,
        "slope": (across.sum() + down.sum()) / count,
        "likelihood": ((error**2 / np.exp(made[:, 8]) + made[:, 8]) * weight).sum() / count,
        "glare": (((made[:, 1:8] - batch[:, GLARE]) ** 2).mean(axis=1) * weight).sum() / count,
    }
    assert tuple(parts) == PARTS == tuple(wanted)
    for name, value in wanted.items():
        assert float(parts[name]) == pytest.approx(float(value), rel=1e-5), name
    settings = ReliefSettings(slope_share=2.0, likelihood_share=3.0, glare_share=5.0)
    total = wanted["relief"] + 2 * wanted["slope"] + 3 * wanted["likelihood"] + 5 * wanted["glare"]
    trainer = FieldsTrainer(TASK, replace(settings, widths=(4, 6), patch_px=16), SAMPLES)
    assert float(trainer.total(parts)) == pytest.approx(float(total), rel=1e-5)


def test_the_loss_looks_at_skin_alone_and_the_likelihood_changes_no_height() -> None:
    rng = np.random.default_rng(1)
    batch = rng.standard_normal((1, CHANNELS, 4, 4)).astype(np.float32)
    batch[:, WEIGHT] = 0.0
    batch[:, WEIGHT, :2] = 1.0
    made = torch.from_numpy(rng.standard_normal((1, 9, 4, 4)).astype(np.float32)).requires_grad_()
    parts = _relief_losses(made, torch.from_numpy(batch))
    FieldsTrainer(TASK, SETTINGS, SAMPLES).total(parts).backward()
    assert (made.grad[:, :, 2:] == 0).all() and (made.grad[:, :, :2] != 0).all()
    made.grad = None
    _relief_losses(made, torch.from_numpy(batch))["likelihood"].backward()
    assert (made.grad[:, :8] == 0).all() and (made.grad[:, 8, :2] != 0).all()


def test_training_lowers_every_part_of_the_loss_and_betters_the_figures() -> None:
    trainer = FieldsTrainer(TASK, SETTINGS, SAMPLES)
    heard: list[float] = []
    before = _judge_middle(trainer.run, SAMPLES[0], SETTINGS.stride)
    first = trainer.train(5)
    trainer.train(135)
    last = trainer.train(10, heard.append)
    for name in PARTS:
        assert last[name] < 0.6 * first[name], name
    after = _judge_middle(trainer.run, SAMPLES[0], SETTINGS.stride)
    assert after["correlation"] > 0.8 > before["correlation"]
    assert abs(after["gain"] - 1) < 0.3 < abs(before["gain"] - 1)
    assert after["rms"] < 0.6 * before["rms"]
    assert after["glare_r2"] > 0.6 > before["glare_r2"]
    assert heard == pytest.approx(np.arange(141, 151) / 150)


def test_every_iteration_has_its_learning_rate() -> None:
    trainer = FieldsTrainer(TASK, SETTINGS, SAMPLES)
    for number in range(3):
        trainer.train(1)
        assert trainer.optimiser.param_groups[0]["lr"] == SETTINGS.rate(number)


def test_fields_are_brought_to_one_scale_inside_the_network() -> None:
    trainer = FieldsTrainer(TASK, SETTINGS, SAMPLES)
    scale = field_scale(TASK, SAMPLES, SETTINGS)
    np.testing.assert_array_equal(trainer.network.scale.numpy(), scale)
    fields = np.asarray(SAMPLES[0][:32], dtype=np.float32)
    made = trainer.run(fields)
    trainer.network.scale.fill_(1.0)
    np.testing.assert_allclose(trainer.run(fields * scale[:, None, None]), made, atol=1e-5)
    assert not np.allclose(trainer.run(fields), made, atol=1e-3)


@pytest.mark.parametrize("precision", ["float32", "mixed"])
def test_an_interrupted_training_gives_the_same_weights(precision) -> None:
    settings = ReliefSettings(widths=(4, 6), patch_px=16, batch=2, iterations=6, precision=precision)
    whole = FieldsTrainer(TASK, settings, SAMPLES)
    whole.train(6)
    first = FieldsTrainer(TASK, settings, SAMPLES)
    first.train(3)
    first.curve.append({"iteration": 3.0})
    second = FieldsTrainer(TASK, settings, SAMPLES)
    second.restore(first.state())
    assert second.done == 3 and second.curve == [{"iteration": 3.0}]
    second.train(3)
    for one, other in zip(weights_of(whole), weights_of(second), strict=True):
        np.testing.assert_array_equal(one, other)
    assert not all(np.array_equal(*pair) for pair in zip(weights_of(whole), weights_of(first), strict=True))


def test_states_of_other_trainings_and_damaged_ones_are_refused() -> None:
    trainer = FieldsTrainer(TASK, SETTINGS, SAMPLES)
    state = trainer.state()
    other = FieldsTrainer(TASK, ReliefSettings(widths=(8, 8), patch_px=16, batch=3, iterations=150), SAMPLES)
    with pytest.raises(BadInput, match=r"batch.*resume with the same"):
        other.restore(state)
    with pytest.raises(BadInput, match="damaged"):
        trainer.restore(state[:1000])


def test_whole_fingers_take_part() -> None:
    settings = ReliefSettings(widths=(4, 6), patch_px=16, batch=2, iterations=6, whole_share=1.0)
    never = SAMPLES[0].copy()
    never[RELIEF] = np.nan
    parts = FieldsTrainer(TASK, settings, [never], SAMPLES[1:]).train(2)
    assert np.isfinite(list(parts.values())).all()  # not one patch was from the others


def test_a_loss_that_is_no_number_ends_the_training() -> None:
    settings = ReliefSettings(widths=(4, 6), patch_px=16, batch=2, iterations=6, precision="float32")
    broken = SAMPLES[0].copy()
    broken[0] = np.nan
    with pytest.raises(BadInput, match="diverged"):
        FieldsTrainer(TASK, settings, [broken]).train(1)


def test_the_exported_network_computes_what_the_trained_one_does(tmp_path) -> None:
    trainer = FieldsTrainer(TASK, SETTINGS, SAMPLES)
    trainer.train(20)
    weights, card = trainer.packed({"command": "splitknit train relief"})
    (tmp_path / f"{NETWORK.name}.onnx").write_bytes(weights)
    (tmp_path / f"{NETWORK.name}.json").write_bytes(card)
    network = network_of(*read_network(tmp_path / f"{NETWORK.name}.onnx"))
    assert (network.card.channels_in, network.card.channels_out, network.card.stride) == (32, 9, 2)
    assert network.card.facts["licence"] == "Apache-2.0"
    assert network.card.facts["command"] == "splitknit train relief"
    fields = np.asarray(SAMPLES[1][:32], dtype=np.float32)
    wanted = trainer.run(fields)
    np.testing.assert_allclose(run_network(network, fields[None])[0], wanted, atol=3e-3 * np.abs(wanted).max())
    # in tiles, and of a size that is not a multiple of the stride
    whole = run_network(network, fields[None, :, :38, :35])
    np.testing.assert_allclose(run_network(network, fields[None, :, :38, :35], tile=12), whole, atol=1e-5)


def test_the_reach_on_the_card_is_how_far_the_network_looks() -> None:
    network = fields_network((1, 1, 1, 1, 1), 1, 1).eval()
    reach = json.loads(packed(replace(NETWORK, channels=(1, 1)), network, "", 4, {})[1])["reach"]
    with torch.no_grad():
        for part in network.parameters():  # nothing cancels and no ReLU is shut
            part.fill_(0.3)
    image = torch.rand(1, 1, 16, 352, generator=torch.Generator().manual_seed(0))
    begins, ends = 160, 192

    def changed(column: int) -> bool:
        other = image.clone()
        other[..., column] += 1e4
        with torch.no_grad():
            return not torch.equal(network(other)[..., begins:ends], network(image)[..., begins:ends])

    assert changed(begins - reach) and not changed(begins - reach - 1)
    assert changed(ends - 1 + reach) and not changed(ends + reach)


def test_the_network_has_the_layers_of_its_widths() -> None:
    state = fields_network((16, 32, 48, 64, 64), 32, 9).state_dict()
    shapes = {name: tuple(part.shape) for name, part in state.items()}
    assert shapes["down.0.0.weight"] == (16, 32, 3, 3) and shapes["down.4.2.weight"] == (64, 64, 3, 3)
    assert shapes["up.0.0.weight"] == (64, 128, 3, 3) and shapes["up.3.0.weight"] == (16, 48, 3, 3)
    assert shapes["out.weight"] == (9, 16, 1, 1) and shapes["scale"] == (32,)
    assert len(shapes) == 9 * 4 + 3
