from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.model import BoolArray, FloatArray
from splitknit.networks.unet import card_bytes, network_of, read_network, run_network
from splitknit.separation.direct import direct_light
from splitknit_simulator.light.skin import SkinRanges
from splitknit_simulator.training.networks import load_torch, unet, unet_reach
from splitknit_simulator.training.separation import (
    Patches,
    Photograph,
    SeparationData,
    SeparationSettings,
    SeparationTrainer,
    _learning_factor,
    _levelled,
    photographs,
    stored_photographs,
)
from splitknit_simulator.training.trainer import TrainingRun

SMALL = SeparationData(palms=1, patches=6, image_size=(150, 146), pitch_um=(39.0, 40.0), labels="truth", held_out=1)


def brighten(grey: FloatArray, px_per_mm: float, mask: BoolArray) -> FloatArray:
    """Stands in for CLAHE."""
    return np.sqrt(grey) * mask


@pytest.fixture(scope="module")
def by_truth() -> Photograph:
    return photographs("palm", 0, 7, SMALL, brighten)[0]


@pytest.fixture
def torch() -> Any:
    return pytest.importorskip("torch", reason="torch (extra 'train') is not installed")


def flat(fraction: float = 0.5, count: int = 8) -> Photograph:
    """A photograph of noise whose direct part is `fraction` of it everywhere."""
    rng = np.random.default_rng(1)
    image = rng.random((120, 110, 3), dtype=np.float32)
    grey = rng.random((120, 110, 1), dtype=np.float32)
    pixels = np.concatenate([image, fraction * image, grey, fraction * grey], axis=2).astype(np.float16)
    corners = np.stack([rng.integers(0, 48, count), rng.integers(0, 38, count)], axis=1).astype(np.int32)
    return Photograph(pixels, corners, {})


PATCHES = Patches([flat()])


def test_a_photograph_holds_image_and_direct_light_on_one_scale(by_truth: Photograph) -> None:
    pixels = by_truth.pixels.astype(np.float32)
    assert pixels.shape == (150, 146, 8)
    image, direct, enhanced, enhanced_direct = pixels[..., :3], pixels[..., 3:6], pixels[..., 6], pixels[..., 7]
    assert 0.98 < np.percentile(image, 99.9) < 1.05
    fraction = direct.mean() / image.mean()
    assert 0.1 < fraction < 0.6
    assert (direct > 0).all() and (direct < image + 0.1).all()  # noise is in the image alone
    # the enhanced image's direct part is its fraction of the light
    weights = np.array([0.299, 0.587, 0.114])
    np.testing.assert_allclose(enhanced_direct / enhanced, direct @ weights / (image @ weights), rtol=0.2)
    assert by_truth.corners.shape == (6, 2)
    assert (by_truth.corners + 72 <= (150, 146)).all()


def test_a_levelled_photograph_has_one_brightness_everywhere(by_truth: Photograph) -> None:
    ready = _levelled(by_truth).pixels.astype(np.float32)
    for part in (ready[..., :3], ready[..., 6:7]):
        blocks = part[:144, :144].reshape(3, 48, 3, 48, -1).mean(axis=(1, 3, 4))
        np.testing.assert_allclose(blocks, 1.0, atol=0.05)
    np.testing.assert_allclose(
        ready[..., 3:6] / ready[..., :3], by_truth.pixels[..., 3:6] / by_truth.pixels[..., :3], rtol=0.01
    )


def test_what_clips_is_taken_from_the_direct_light() -> None:
    shiny = replace(SMALL, skin=SkinRanges(glare=(5.0, 5.0), roughness=(0.05, 0.05)), led_radius_mm=(5.0, 6.0))
    for index in range(6):
        pixels = photographs("palm", index, 7, shiny, brighten)[0].pixels.astype(np.float32)
        image, direct = pixels[..., 1], pixels[..., 4]
        clipped = (pixels[..., :3] >= pixels[..., :3].max() - 1e-3).all(axis=2)
        if clipped.sum() > 5:
            break
    assert clipped.sum() > 5, "no photograph clips: the test says nothing"
    assert (direct[clipped] < image[clipped]).all()
    # global light is smooth: beside the highlight as much of it as within
    assert np.median((image - direct)[clipped]) == pytest.approx(np.median((image - direct)[~clipped]), rel=0.4)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_photograph_and_another_index_another(by_truth: Photograph) -> None:
    again = photographs("palm", 0, 7, SMALL, brighten)[0]
    assert again.pixels.tobytes() == by_truth.pixels.tobytes()
    assert again.facts == by_truth.facts and (again.corners == by_truth.corners).all()
    other = photographs("palm", 1, 7, SMALL, brighten)[0]
    assert other.facts["skin"] != by_truth.facts["skin"]


@pytest.mark.slow
def test_labels_through_the_patterns_agree_with_the_truth(by_truth: Photograph) -> None:
    settings = SeparationData(
        palms=1, patches=6, image_size=(150, 146), pitch_um=(39.0, 40.0), labels="stack", held_out=1
    )
    by_patterns = photographs("palm", 0, 7, settings, brighten)[0]
    assert (by_patterns.pixels[..., :3] == by_truth.pixels[..., :3]).all()
    difference = (by_patterns.pixels - by_truth.pixels)[..., 3:6].astype(np.float32)
    assert 0 < np.sqrt((difference**2).mean()) < 0.006  # 44 dB


def test_input_and_target_are_turned_and_shifted_together() -> None:
    patches = Patches([flat(0.5), flat(0.5)], 72)
    batches = list(patches.shuffled(5, 3, 0))
    assert [len(inputs) for inputs, _ in batches] == [5, 5, 5, 1]
    for inputs, targets in batches:
        assert inputs.shape[1:] == targets.shape[1:] == (3, 72, 72)
        np.testing.assert_allclose(targets, 0.5 * inputs, atol=2e-3)
    grey = [bool((image[0] == image[1]).all()) for inputs, _ in batches for image in inputs]
    assert 0 < sum(grey) < len(grey)


def test_an_epoch_is_drawn_from_its_number_alone() -> None:
    patches = Patches([flat()], 72)
    first, again, next_one = (next(patches.shuffled(4, 0, epoch))[0] for epoch in (0, 0, 1))
    assert (first == again).all() and not (first == next_one).all()


def test_fixed_patches_are_as_stored() -> None:
    photograph = flat(0.3)
    (inputs, targets), *_ = Patches([photograph], 72).fixed(enhanced=False, batch=4)
    row, column = photograph.corners[2]
    np.testing.assert_array_equal(inputs[2, 1], photograph.pixels[row : row + 72, column : column + 72, 1])
    np.testing.assert_array_equal(targets[2, 1], photograph.pixels[row : row + 72, column : column + 72, 4])
    (inputs, _), *_ = Patches([photograph], 72).fixed(enhanced=True, batch=4)
    for channel in range(3):
        np.testing.assert_array_equal(inputs[2, channel], photograph.pixels[row : row + 72, column : column + 72, 6])


def test_the_learning_rate_falls_at_the_end_only() -> None:
    assert [_learning_factor(fraction, 0.0) for fraction in (0.0, 0.5, 1.0)] == [1.0, 1.0, 1.0]
    assert _learning_factor(0.59, 0.4) == 1.0
    assert _learning_factor(0.8, 0.4) == pytest.approx(0.5)
    assert _learning_factor(1.0, 0.4) == pytest.approx(0.0)


@pytest.mark.parametrize(
    "change", [{"width": 0}, {"dropout": 1.0}, {"device": "tpu"}, {"learning_rate": float("nan")}, {"precision": "low"}]
)
def test_settings_that_make_no_sense_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match=next(iter(change))):
        SeparationSettings(**change)


@pytest.mark.parametrize("change", [{"labels": "none"}, {"palms": 0}, {"image_size": (100, 500)}, {"patches": 0}])
def test_data_that_make_no_sense_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        SeparationData(**change)


def test_without_torch_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> Any:
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(BadInput, match="make install EXTRAS=train"):
        load_torch()
    monkeypatch.undo()
    assert importlib.import_module("math")


def test_the_network_is_the_thesis_s(torch: Any) -> None:
    network = unet()
    kinds = [type(module).__name__ for module in network.modules()]
    assert kinds.count("Conv2d") == 15 and kinds.count("ConvTranspose2d") == 3
    assert kinds.count("ReLU") == 17 and kinds.count("Dropout") == 2
    # with three poolings, three concatenations, the input and the regression: 45 layers
    assert 15 + 3 + 17 + 2 + 3 + 3 + 1 + 1 == 45
    assert network.last.out_channels == 3
    w = 64
    convolutions = 9 * (3 * w + w * w + 6 * w * w + 24 * w * w + 96 * w * w + 48 * w * w + 12 * w * w + 3 * w * w)
    rises = 4 * (2 + 8 + 32) * w * w
    biases = 2 * (w + 2 * w + 4 * w + 8 * w) + 3 * (4 * w + 2 * w + w)
    assert sum(p.numel() for p in network.parameters()) == convolutions + rises + biases + 3 * w + 3


def test_an_untrained_network_may_begin_with_a_fraction_of_its_image(torch: Any) -> None:
    trainer = SeparationTrainer(SeparationSettings(width=8, dropout=0.0, start_fraction=0.25), PATCHES)
    image = np.random.default_rng(0).random((1, 3, 64, 64), dtype=np.float32)
    made = trainer.run(image)
    assert np.corrcoef(made.ravel(), image.ravel())[0, 1] > 0.7
    assert not np.allclose(made, 0.25 * image, atol=1e-3)  # the rest is random, so that it can learn


def test_the_reach_is_that_of_the_network(torch: Any) -> None:
    for depth in (1, 2):
        trainer = SeparationTrainer(SeparationSettings(width=4, depth=depth, dropout=0.0), PATCHES)
        image = torch.rand(1, 3, 96, 96, requires_grad=True)
        trainer.network(image)[0, :, 48].sum().backward()  # row 48 begins a tile
        rows = torch.nonzero(image.grad.abs().sum(dim=(0, 1, 3))).ravel()
        assert 48 - int(rows.min()) == unet_reach(depth)


def test_training_learns_and_can_be_interrupted(torch: Any) -> None:
    patches = Patches([flat(0.5, count=24)], 72)
    settings = SeparationSettings(width=4, dropout=0.25, epochs=4, batch=8, decay=0.5, start_fraction=0.2, border_px=4)
    straight = SeparationTrainer(settings, patches)
    losses = [straight.train(1)["loss"] for _ in range(4)]
    assert losses[-1] < 0.7 * losses[0]
    assert straight.loss_of(patches, enhanced=True) < 0.03
    first = SeparationTrainer(settings, patches)
    for _ in range(2):
        first.train(1)
    state = first.state()
    second = SeparationTrainer(settings, patches)
    second.restore(state)
    assert second.done == 2
    for _ in range(2):
        second.train(1)
    assert second.packed({}) == straight.packed({})


def test_a_checkpoint_that_does_not_fit_is_refused(torch: Any) -> None:
    state = SeparationTrainer(SeparationSettings(width=2), PATCHES).state()
    with pytest.raises(BadInput, match=r"other settings \(width\)"):
        SeparationTrainer(SeparationSettings(width=3), PATCHES).restore(state)
    SeparationTrainer(SeparationSettings(width=2, epochs=3, threads=2), PATCHES).restore(state)
    with pytest.raises(BadInput, match="checkpoint is damaged"):
        SeparationTrainer(SeparationSettings(width=2), PATCHES).restore(state[:100])


@pytest.mark.slow
def test_a_training_that_diverges_says_so(torch: Any) -> None:
    trainer = SeparationTrainer(SeparationSettings(width=2, dropout=0.0, learning_rate=1e30), PATCHES)
    with pytest.raises(BadInput, match="diverged"):
        for _ in range(3):
            trainer.train(1)


def test_the_export_computes_what_torch_does(torch: Any, tmp_path: Path) -> None:
    trainer = SeparationTrainer(SeparationSettings(width=4, dropout=0.5, start_fraction=0.3), PATCHES)
    weights, _ = trainer.packed({})
    facts = {"channels_in": 3, "channels_out": 3, "stride": 8, "reach": unet_reach(3)}
    (tmp_path / "new.onnx").write_bytes(weights)
    (tmp_path / "new.json").write_bytes(card_bytes("new", weights, facts))
    network = network_of(*read_network(tmp_path / "new.onnx"))
    images = np.random.default_rng(2).random((2, 3, 56, 72), dtype=np.float32)
    wanted = trainer.run(images)
    np.testing.assert_allclose(run_network(network, images), wanted, atol=5e-3 * np.abs(wanted).max())
    assert direct_light(images, network).shape == images.shape
    parameters = sum(p.numel() for p in trainer.network.parameters())
    assert len(weights) < 2.0 * parameters + 20_000  # stored in half precision


def test_photographs_by_two_processes_are_those_by_one(tmp_path: Path) -> None:
    data = SeparationData(palms=2, fingers=0, patches=3, held_out=1, image_size=(160, 160), labels="truth")
    for threads in (1, 2):
        run = TrainingRun(tmp_path / str(threads))
        stored_photographs(run, data, SeparationSettings(threads=threads))
    one, two = (sorted((tmp_path / name / "data").iterdir()) for name in "12")
    assert [file.name for file in one] == [file.name for file in two]
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(one, two, strict=True))
