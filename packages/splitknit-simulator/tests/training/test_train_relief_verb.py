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
from splitknit_simulator.cli.train import TrainReliefJob, _curve_svg
from splitknit_simulator.training import relief as app
from splitknit_simulator.training.fields import _network_metrics, train_fields
from splitknit_simulator.training.relief import (
    CHANNELS,
    GLARE,
    RELIEF,
    TASK,
    WEIGHT,
    ReliefData,
    ReliefSettings,
)
from splitknit_simulator.training.trainer import HELD_OUT_FROM, TrainingRun

torch = pytest.importorskip("torch")

DATA = ReliefData(fingers=2, whole_fingers=2, held_out=2, first=30, first_whole=10)
SETTINGS = ReliefSettings(widths=(4, 6), patch_px=16, batch=2, iterations=5, report_every=2, precision="float32")


def made_up(number: int, data: ReliefData) -> tuple[np.ndarray, dict]:
    if number == 11:
        raise BadInput("there is no finger.")
    sample = np.random.default_rng(number).standard_normal((CHANNELS, 30, 26)).astype(np.float16)
    sample[RELIEF], sample[WEIGHT] = sample[0], 1.0
    return sample, {"finger": number}


def made_up_pieces(number: int, data: ReliefData) -> np.ndarray:
    if number == 31:
        raise BadInput("not one piece holds skin.")
    return np.stack([made_up(100 * number + piece, data)[0][:, :20, :20] for piece in range(3)])


@pytest.fixture
def numbers(monkeypatch) -> list[int]:
    """Fingers that are photographed, in their order; here no finger needs a camera."""
    asked: list[int] = []

    def photograph(number: int, data: ReliefData) -> tuple[np.ndarray, dict]:
        asked.append(number)
        return made_up(number, data)

    def in_pieces(number: int, data: ReliefData) -> np.ndarray:
        asked.append(number)
        return made_up_pieces(number, data)

    monkeypatch.setattr(app, "training_sample", photograph)
    monkeypatch.setattr(app, "training_crops", in_pieces)
    return asked


def train(out: Path, data: ReliefData, settings: ReliefSettings, **how: Any) -> dict[str, Any]:
    return train_fields(TrainingRun(out, **how), TASK, data, settings)


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_training_writes_network_card_and_curve(tmp_path, numbers) -> None:
    heard: list[tuple[str, float]] = []
    facts = train(
        tmp_path / "run",
        DATA,
        SETTINGS,
        command="splitknit train relief --out run",
        progress=lambda stage, fraction: heard.append((stage, fraction)),
        chart=_curve_svg,
    )
    assert numbers == [30, 31, 10, 11, HELD_OUT_FROM, HELD_OUT_FROM + 1]
    assert facts["refused"] == 2 and facts["onnx_difference"] < 0.02
    assert {name.split("/")[0] for name in files_of(tmp_path / "run")} == {*app.FILES, "run.json"}
    card = json.loads((tmp_path / "run" / "relief.json").read_text())
    assert (card["name"], card["channels_in"], card["channels_out"], card["stride"]) == ("relief", 32, 9, 2)
    assert card["command"] == "splitknit train relief --out run" and card["licence"] == "Apache-2.0"
    assert card["training"]["iterations_done"] == 5 and card["training"]["seed"] == 0
    data = card["data"]
    assert (data["pieces_used"], data["whole_fingers_used"], data["fingers_refused"]) == (3, 1, 2)
    assert card["data"]["scattering_factor"] == [0.2, 2.2]
    judged = card["metrics"]["fingers"]
    assert [entry["finger"] for entry in judged] == [HELD_OUT_FROM, HELD_OUT_FROM + 1]
    assert set(judged[0]) == {"finger", "correlation", "gain", "rms_um", "error_ratio", "glare_r2"}
    assert card["metrics"]["mean"]["gain"] == pytest.approx(np.mean([entry["gain"] for entry in judged]), abs=1e-4)
    assert 10 < judged[0]["rms_um"] < 40  # the made-up relief is one unit high: 20 um
    rows = (tmp_path / "run" / "curve.csv").read_text().splitlines()
    assert rows[0].startswith("iteration,relief,slope,likelihood,glare,held_out_correlation")
    assert [row.split(",")[0] for row in rows[1:]] == ["2", "4", "5"]
    chart = ElementTree.fromstring((tmp_path / "run" / "curve.svg").read_text())
    assert chart.tag == "{http://www.w3.org/2000/svg}svg"
    fractions = [fraction for _, fraction in heard]
    assert fractions == sorted(fractions) and fractions[0] == 0 and fractions[-1] == 1
    made = run_network(load_network(tmp_path / "run" / "relief.onnx"), np.zeros((1, 32, 33, 47), dtype=np.float32))
    assert made.shape == (1, 9, 33, 47)


def test_an_interrupted_training_is_taken_up_with_the_same_result(tmp_path, numbers, monkeypatch) -> None:
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
    assert [n for n in whole if whole[n] != parts[n]] in (
        ["checkpoint.pt", "curve.csv"],
        ["curve.csv", "checkpoint.pt"],
    )
    again = train(tmp_path / "parts", DATA, SETTINGS, resume=True)
    assert files_of(tmp_path / "parts") == parts and again["refused"] == 2


def test_a_folder_that_is_in_use_or_damaged_is_refused(tmp_path, numbers) -> None:
    folder = tmp_path / "run"
    train(folder, DATA, SETTINGS)
    with pytest.raises(BadInput, match="`resume`"):
        train(folder, DATA, SETTINGS)
    with pytest.raises(BadInput, match=r"other settings \(training.batch\)"):
        train(folder, DATA, replace(SETTINGS, batch=3), resume=True)
    with pytest.raises(BadInput, match=r"other settings \(data.fingers\)"):
        train(folder, replace(DATA, fingers=4), SETTINGS, resume=True)
    sample = folder / "data" / "finger_0000010.npy"
    whole = sample.read_bytes()
    sample.write_bytes(whole[:500])
    with pytest.raises(BadInput, match=r"finger_0000010.npy' is damaged .*resume"):
        train(folder, DATA, SETTINGS, resume=True)
    np.save(sample, np.zeros((3, 4, 5), dtype=np.float16))
    with pytest.raises(BadInput, match=r"\(3, 4, 5\)"):
        train(folder, DATA, SETTINGS, resume=True)
    sample.write_bytes(whole)
    pieces = folder / "data" / "pieces_0000030.npy"
    there = pieces.read_bytes()
    np.save(pieces, np.zeros((41, 20, 20), dtype=np.float16))
    with pytest.raises(BadInput, match=r"pieces_0000030.npy' is damaged"):
        train(folder, DATA, SETTINGS, resume=True)
    pieces.write_bytes(there)
    (folder / "data" / "finger_0000010.json").write_text("{")
    with pytest.raises(BadInput, match=r"finger_0000010.json' is damaged"):
        train(folder, DATA, SETTINGS, resume=True)
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.txt").write_text("not a training")
    with pytest.raises(BadInput, match="name another folder"):
        train(other, DATA, SETTINGS, resume=True)


def test_fingers_that_all_are_refused_are_told_with_the_reason(tmp_path, numbers) -> None:
    with pytest.raises(BadInput, match=r"not one finger to train on.*31: not one piece holds skin"):
        train(tmp_path / "run", replace(DATA, fingers=1, first=31), SETTINGS)


def test_the_verb_turns_options_into_settings_and_a_command(tmp_path, numbers, capsys) -> None:
    words = "--fingers 1 --whole-fingers 2 --held-out 1 --iterations 1 --batch 1 --patch 32 --seed 4 --first 30"
    words += " --first-whole 10 --precision float32"
    folder = tmp_path / "run"
    assert main(["train", "relief", "--out", str(folder), *words.split(), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert numbers == [30, 10, 11, HELD_OUT_FROM]
    assert facts["training"]["seed"] == 4 and facts["training"]["widths"] == [16, 32, 48, 64, 64]
    command = (
        "splitknit train relief --out DIR --fingers 1 --crops 5 --whole-fingers 2 --held-out 1 --first 30 "
        "--first-whole 10 --iterations 1 --batch 1 --patch 32 --seed 4 --threads 1 --device cpu --precision float32"
    )
    assert facts["command"] == command == json.loads((folder / "relief.json").read_text())["command"]
    assert main(["train", "relief", "--out", str(folder), *words.split(), "--resume"]) == 0
    said = capsys.readouterr().out
    assert "1 iteration" in said and "(pieces: 3; whole fingers: 1; refused: 1)" in said
    assert "ridge correlation" in said and f"{folder / 'relief.onnx'}: the network" in said
    assert main(["train", "relief", "--out", str(folder), *words.split()]) == 2
    assert "--resume" in capsys.readouterr().err


def test_the_verb_and_the_settings_agree_on_the_defaults() -> None:
    job = TrainReliefJob(out="run")
    data, settings = ReliefData(), ReliefSettings()
    for name in ("fingers", "crops", "whole_fingers", "held_out", "first", "first_whole"):
        assert getattr(job, name) == getattr(data, name)
    for name in ("iterations", "batch", "seed", "threads", "device", "precision"):
        assert getattr(job, name) == getattr(settings, name)
    assert job.patch_px == settings.patch_px


def test_the_cards_figures_are_of_what_the_network_draws() -> None:
    def drawn(fields: np.ndarray) -> np.ndarray:
        values = np.array([0.5, 1, 2, 3, 4, 5, 6, 7, 0], dtype=np.float32)
        return np.broadcast_to(values[:, None, None], (9, *fields.shape[1:]))

    sample = made_up(3, DATA)[0].astype(np.float32)
    sample[GLARE] = np.arange(1.0, 8.0)[:, None, None]
    sample[RELIEF] = 1.5
    found = _network_metrics(TASK, drawn, 2, {3: sample, 4: sample})
    assert [entry["finger"] for entry in found["fingers"]] == [3, 4]
    assert found["mean"]["rms_um"] == 20.0  # one unit too low
    assert found["mean"]["gain"] == pytest.approx(1 / 3, abs=1e-4)
    assert found["mean"]["glare_r2"] == 1.0 and found["mean"]["error_ratio"] == 1.0
    assert found["mean"]["correlation"] is None  # of a constant
    assert found["held_out"].startswith("2 simulated fingers")
