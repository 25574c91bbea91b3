from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.networks.unet import load_network, run_network
from splitknit_simulator.cli.train import TrainShapeJob, _curve_svg
from splitknit_simulator.training import shape as app
from splitknit_simulator.training.fields import _network_metrics, train_fields
from splitknit_simulator.training.shape import (
    CHANNELS,
    SLOPES,
    TASK,
    WEIGHT,
    ShapeData,
    ShapeNetSettings,
)
from splitknit_simulator.training.trainer import HELD_OUT_FROM, TrainingRun


def test_the_verb_and_the_settings_agree_on_the_defaults() -> None:
    job = TrainShapeJob(out="run")
    data, settings = ShapeData(), ShapeNetSettings()
    for name in ("fingers", "held_out", "first"):
        assert getattr(job, name) == getattr(data, name)
    for name in ("iterations", "batch", "seed", "threads", "device", "precision"):
        assert getattr(job, name) == getattr(settings, name)
    assert job.patch_px == settings.patch_px


torch = pytest.importorskip("torch")

DATA = ShapeData(fingers=3, held_out=2, first=10)
SETTINGS = ShapeNetSettings(
    widths=(4, 6), patch_px=16, batch=2, iterations=5, report_every=2, beyond_px=4, precision="float32"
)


def made_up(number: int, data: ShapeData) -> tuple[np.ndarray, dict]:
    if number == 11:
        raise BadInput("there is no finger.")
    sample = np.random.default_rng(number).standard_normal((CHANNELS, 30, 26)).astype(np.float16)
    sample[SLOPES], sample[WEIGHT] = sample[:2], 1.0
    return sample, {"finger": number}


@pytest.fixture
def numbers(monkeypatch) -> list[int]:
    """Fingers that are photographed, in their order; here no finger needs a camera."""
    asked: list[int] = []

    def photograph(number: int, data: ShapeData) -> tuple[np.ndarray, dict]:
        asked.append(number)
        return made_up(number, data)

    monkeypatch.setattr(app, "shape_sample", photograph)
    return asked


def train(out: Path, data: ShapeData, settings: ShapeNetSettings, **how: Any) -> dict[str, Any]:
    return train_fields(TrainingRun(out, **how), TASK, data, settings)


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_training_writes_network_card_and_curve(tmp_path, numbers) -> None:
    heard: list[tuple[str, float]] = []
    facts = train(
        tmp_path / "run",
        DATA,
        SETTINGS,
        command="splitknit train shape --out run",
        progress=lambda stage, fraction: heard.append((stage, fraction)),
        chart=_curve_svg,
    )
    assert numbers == [10, 11, 12, HELD_OUT_FROM, HELD_OUT_FROM + 1]
    assert facts["refused"] == 1 and facts["onnx_difference"] < 0.02
    assert {name.split("/")[0] for name in files_of(tmp_path / "run")} == {*app.FILES, "run.json"}
    card = json.loads((tmp_path / "run" / "shape.json").read_text())
    assert (card["name"], card["channels_in"], card["channels_out"], card["stride"]) == ("shape", 32, 2, 2)
    assert card["command"] == "splitknit train shape --out run" and card["licence"] == "Apache-2.0"
    assert card["training"]["iterations_done"] == 5 and card["training"]["wide_share"] == 1.0
    assert (card["data"]["fingers_used"], card["data"]["fingers_refused"]) == (2, 1)
    assert card["data"]["rim_exponent"] == [0.0, 1.0] and card["data"]["gain"] == 0.93
    judged = card["metrics"]["fingers"]
    assert [entry["finger"] for entry in judged] == [HELD_OUT_FROM, HELD_OUT_FROM + 1]
    assert set(judged[0]) == {"finger", "before", "after", "wide_before", "wide_after"}
    assert 0.08 < judged[0]["before"] < 0.12  # the made-up slopes are one unit: 0.1
    rows = (tmp_path / "run" / "curve.csv").read_text().splitlines()
    assert rows[0].startswith("iteration,slope,wide,held_out_before,held_out_wide_before")
    assert [row.split(",")[0] for row in rows[1:]] == ["2", "4", "5"]
    chart = ElementTree.fromstring((tmp_path / "run" / "curve.svg").read_text())
    assert chart.tag == "{http://www.w3.org/2000/svg}svg"
    fractions = [fraction for _, fraction in heard]
    assert fractions == sorted(fractions) and fractions[0] == 0 and fractions[-1] == 1
    made = run_network(load_network(tmp_path / "run" / "shape.onnx"), np.zeros((1, 32, 33, 47), dtype=np.float32))
    assert made.shape == (1, 2, 33, 47)


def test_an_interrupted_training_is_taken_up_with_the_same_result(tmp_path, numbers) -> None:
    train(tmp_path / "whole", DATA, SETTINGS)

    class StopError(Exception):
        pass

    def stopping(limit: float):
        def progress(stage: str, fraction: float) -> None:
            if fraction > limit:
                raise StopError

        return progress

    for limit in (0.2, 0.75):  # between two fingers, and between two entries of the curve
        with pytest.raises(StopError):
            train(tmp_path / "parts", DATA, SETTINGS, resume=True, progress=stopping(limit))
    numbers.clear()
    train(tmp_path / "parts", DATA, SETTINGS, resume=True)
    assert numbers == []  # all fingers were there, the refused one too
    whole, parts = files_of(tmp_path / "whole"), files_of(tmp_path / "parts")
    assert whole.keys() == parts.keys()
    assert {n for n in whole if whole[n] != parts[n]} == {"checkpoint.pt", "curve.csv"}  # seconds differ


def test_a_folder_that_is_in_use_or_damaged_is_refused(tmp_path, numbers) -> None:
    folder = tmp_path / "run"
    train(folder, DATA, replace(SETTINGS, iterations=1))
    with pytest.raises(BadInput, match=r"other settings \(training.wide_share\)"):
        train(folder, DATA, replace(SETTINGS, iterations=1, wide_share=2.0), resume=True)
    with pytest.raises(BadInput, match=r"other settings \(data.gain\)"):
        train(folder, replace(DATA, gain=1.0), replace(SETTINGS, iterations=1), resume=True)
    np.save(folder / "data" / "finger_0000010.npy", np.zeros((3, 4, 5), dtype=np.float16))
    with pytest.raises(BadInput, match=r"finger_0000010.npy' is damaged .*\(3, 4, 5\).*resume"):
        train(folder, DATA, replace(SETTINGS, iterations=1), resume=True)
    with pytest.raises(BadInput, match=r"not one finger to train on.*11: there is no finger"):
        train(tmp_path / "other", replace(DATA, fingers=1, first=11), SETTINGS)


def test_the_verb_turns_options_into_settings_and_a_command(tmp_path, numbers, capsys) -> None:
    words = "--fingers 2 --held-out 1 --iterations 1 --batch 1 --patch 32 --seed 4 --first 10 --precision float32"
    folder = tmp_path / "run"
    assert main(["train", "shape", "--out", str(folder), *words.split(), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert numbers == [10, 11, HELD_OUT_FROM]
    assert facts["training"]["seed"] == 4 and facts["training"]["widths"] == [24, 32, 48, 64, 64]
    command = (
        "splitknit train shape --out DIR --fingers 2 --held-out 1 --first 10 --iterations 1 --batch 1 --patch 32 "
        "--seed 4 --threads 1 --device cpu --precision float32"
    )
    assert facts["command"] == command == json.loads((folder / "shape.json").read_text())["command"]
    assert main(["train", "shape", "--out", str(folder), *words.split(), "--resume"]) == 0
    said = capsys.readouterr().out
    assert "1 iteration" in said and "(fingers: 1; refused: 1)" in said
    assert "before mending" in said and f"{folder / 'shape.onnx'}: the network" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--fingers 0", "data.fingers must be from 1 to 100000"),
        ("--patch 100", "patch_px must be a multiple of 16"),
        ("--patch 16", "patch_px must be larger than beyond_px"),
        ("--iterations 0", "iterations"),
    ],
)
def test_bad_input_ends_the_verb_with_one_sentence_and_no_folder(tmp_path, capsys, words, said) -> None:
    assert main(["train", "shape", "--out", str(tmp_path / "run"), *words.split()]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert said in lines[-1] and not (tmp_path / "run").exists()


def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path, capsys) -> None:
    (tmp_path / "thesis.txt").write_text("not a training")
    assert main(["train", "shape", "--out", str(tmp_path), "--resume"]) == 2
    assert "name another folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_the_cards_figures_are_of_what_the_network_draws() -> None:
    def drawn(fields: np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.float32([[[1.0]], [[-2.0]]]), (2, *fields.shape[1:]))

    sample = made_up(3, DATA)[0].astype(np.float32)
    sample[SLOPES] = np.array([2.0, -1.0])[:, None, None]
    found = _network_metrics(TASK, drawn, 2, {3: sample, 4: sample})
    assert [entry["finger"] for entry in found["fingers"]] == [3, 4]
    assert found["mean"]["before"] == pytest.approx(0.1 * np.sqrt(2.5), abs=1e-4)
    assert found["mean"]["after"] == pytest.approx(0.1, abs=1e-4) == found["mean"]["wide_after"]
