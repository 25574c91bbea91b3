from __future__ import annotations

import importlib
import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

from splitknit.cli.main import build_parser, main
from splitknit.cli.verb import job_of
from splitknit.errors import BadInput
from splitknit.networks.unet import load_network
from splitknit_simulator.cli.train import TrainSeparationJob
from splitknit_simulator.training import separation
from splitknit_simulator.training.trainer import TrainingRun

Captured = pytest.CaptureFixture[str]
TINY = [
    *("--palms", "1", "--patches", "4", "--held-out", "1", "--labels", "truth"),
    *("--width", "2", "--epochs", "2", "--start-fraction", "0.25"),
]
needs_torch = pytest.mark.skipif(
    importlib.util.find_spec("torch") is None, reason="torch (extra 'train') is not installed"
)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Photographs of noise in the place of skin."""
    import numpy as np

    from splitknit_simulator.training.separation import Photograph

    def shoot(kind: str, index: int, seed: int, settings: Any, enhance: Any) -> list[Photograph]:
        rng = np.random.default_rng([kind == "finger", index, seed])
        image = 0.2 + rng.random((90, 80, 3), dtype=np.float32)
        pixels = np.concatenate([image, 0.4 * image, image[..., :1], 0.4 * image[..., :1]], axis=2)
        corners = rng.integers(0, 8, (settings.patches, 2)).astype(np.int32)
        facts = {"kind": kind, "skin": settings.skin.draw(rng)}  # which must be storable
        return [Photograph(pixels.astype(np.float16), corners, facts) for _ in range(settings.views)]

    monkeypatch.setattr(separation, "photographs", shoot)


def test_without_torch_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    present = importlib.import_module

    def absent(name: str) -> Any:
        if name == "torch":
            raise ImportError(f"No module named {name!r}")
        return present(name)

    monkeypatch.setattr(importlib, "import_module", absent)
    assert main(["train", "separation", "--out", str(tmp_path / "out"), *TINY]) == 2
    said = capsys.readouterr()
    assert said.err.count("\n") == 1 and "make install EXTRAS=train" in said.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--width", "0"], "training.width must be from 1 to 1024, but it is 0"),
        (["--palms", "0"], "at least one palm or finger"),
        (["--check-mm", "9"], "data.check_mm must be from 0.1 to 5, but it is 9.0"),
        (["--patches", "many"], "invalid int value"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    tmp_path: Path, arguments: list[str], words: str, capsys: Captured
) -> None:
    assert main(["train", "separation", "--out", str(tmp_path / "out"), *TINY, *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_thesis_is_the_default_and_the_card_s_command_says_all() -> None:
    options = build_parser().parse_args(["train", "separation", "--out", "x"])
    wanted = {"palms": 50, "fingers": 0, "patches": 750, "epochs": 50, "width": 64, "labels": "stack", "dropout": 0.5}
    assert {name: getattr(options, name) for name in wanted} == wanted
    job = job_of(TrainSeparationJob, build_parser().parse_args(["train", "separation", "--out", "x", *TINY]))
    words = job.command().split()
    again = build_parser().parse_args(words[1:])
    assert (again.width, again.epochs, again.start_fraction, again.labels) == (2, 2, 0.25, "truth")


@needs_torch
def test_a_training_from_start_to_card(tmp_path: Path, small: None, capsys: Captured) -> None:
    out = tmp_path / "out"
    assert main(["train", "separation", "--out", str(out), "--json", *TINY]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    facts = json.loads(said.out)
    assert facts["training"]["epochs_done"] == 2 and facts["training"]["width"] == 2
    assert facts["onnx_difference"] < 0.01
    network = load_network(out / "direct.onnx")
    assert "--width 2" in network.card.facts["command"] and network.card.facts["licence"] == "Apache-2.0"
    assert len((out / "curve.csv").read_text().splitlines()) == 3
    assert (out / "curve.svg").read_text().startswith("<svg xmlns=")
    first = (out / "direct.onnx").read_bytes()

    assert main(["train", "separation", "--out", str(out), *TINY]) == 2
    assert "add --resume" in capsys.readouterr().err
    assert main(["train", "separation", "--out", str(out), "--resume", *TINY, "--width", "3"]) == 2
    assert "other settings (training.width)" in capsys.readouterr().err
    assert main(["train", "separation", "--out", str(out), "--resume", *TINY]) == 0
    assert (out / "direct.onnx").read_bytes() == first

    assert main(["train", "separation", "--out", str(out), "--resume", *TINY, "--epochs", "3"]) == 0
    assert json.loads((out / "direct.json").read_text())["training"]["epochs_done"] == 3


@needs_torch
def test_an_interrupted_data_set_is_completed(
    tmp_path: Path, small: None, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    out, real, taken = tmp_path / "out", separation.photographs, []

    def stops(kind: str, index: int, *rest: Any) -> Any:
        taken.append((kind, index))
        if len(taken) == 2:
            raise KeyboardInterrupt
        return real(kind, index, *rest)

    monkeypatch.setattr(separation, "photographs", stops)
    assert main(["train", "separation", "--out", str(out), *TINY]) == 130
    assert main(["train", "separation", "--out", str(out), "--resume", *TINY]) == 0
    assert taken[0] == ("palm", 0) and taken.count(("palm", 0)) == 1  # what is there is not taken again
    assert not list(out.rglob("*.tmp"))
    capsys.readouterr()
    damaged = next((out / "data").glob("palm_0000000*.npy"))
    damaged.write_bytes(damaged.read_bytes()[:500])
    assert main(["train", "separation", "--out", str(out), "--resume", *TINY]) == 2
    assert "is damaged" in capsys.readouterr().err


@needs_torch
def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(BadInput, match="holds no training of splitknit"):
        run = TrainingRun(tmp_path)
        separation.train_separation(run, separation.SeparationData(), separation.SeparationSettings())
    assert [path.name for path in tmp_path.iterdir()] == ["letter.txt"]
