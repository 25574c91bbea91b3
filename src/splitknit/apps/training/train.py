"""What ``splitknit train separation`` does: data set, training, learning curve, network and card, in one folder.

The folder grows as the work goes on, every file whole or not there, so that an interrupted training is taken up where
it stopped: photographs palm by palm, the network epoch by epoch.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import __version__
from splitknit.apps.training.training_folder import (
    Progress,
    curve_chart,
    curve_table,
    files_of,
    open_folder,
    plain,
    read_file,
    write_file,
)
from splitknit.errors import refusing, require
from splitknit.finger import clahe
from splitknit.io.fields import parse_json
from splitknit.io.npz import map_npy
from splitknit.model import BoolArray, FloatArray
from splitknit.networks.unet import network_of, run_network
from splitknit.networks.weights import card_bytes, read_network
from splitknit.report.charts import Line
from splitknit.training.train import (
    MAY_CHANGE,
    DataSettings,
    Patches,
    Photograph,
    Trainer,
    TrainSettings,
    levelled,
    load_torch,
    photographs,
    unet_reach,
)

NETWORK = "direct"
HELD_OUT_FROM = 1_000_000
"""Palms and fingers from this number on are never trained on; the learning curve takes the first of them."""
DATA_PART = 0.2
"""Of the progress bar."""
FILES = files_of(NETWORK, "photographs")


def train_separation(
    out: Path,
    data: DataSettings,
    settings: TrainSettings,
    *,
    resume: bool = False,
    command: str = "",
    progress: Progress = lambda stage, share: None,
) -> dict[str, Any]:
    """Build the data set and train; return what came out.

    Parameters
    ----------
    out : folder to write into; it must be new, unless `resume`
    data, settings : what to train on, and how
    resume : go on with the training in `out`
    command : the command line that does this again, for the card
    progress : hears what is being done and the share of the whole that is done

    Raises
    ------
    BadInput
        If torch is missing, `out` is in use, or what is there does not fit the settings.
    """
    started = time.perf_counter()
    load_torch()
    open_folder(out, data, settings, resume, free=MAY_CHANGE)
    trainer = Trainer(settings)
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        trainer.restore(read_file(checkpoint))
    subjects = list(_subjects(data))
    for number, (kind, index) in enumerate(subjects):
        progress("photographing", DATA_PART * number / len(subjects))
        _store(out, kind, index, data, settings.seed)
    train = Patches([p for s in subjects if s[1] < HELD_OUT_FROM for p in _load(out, *s, data)], data.patch_px)
    held_out = Patches([p for s in subjects if s[1] >= HELD_OUT_FROM for p in _load(out, *s, data)], data.patch_px)
    while trainer.epoch < settings.epochs:
        epoch_started = time.perf_counter()
        words = f"epoch {trainer.epoch + 1} of {settings.epochs}"
        loss = trainer.train_epoch(train, lambda share: progress(words, DATA_PART + (1 - DATA_PART) * share))  # noqa: B023
        linear, enhanced = (trainer.loss_of(held_out, kind) for kind in (False, True))
        trainer.curve.append(
            {
                "epoch": trainer.epoch,
                "loss": loss,
                "held_out_linear": linear,
                "held_out_enhanced": enhanced,
                "seconds": time.perf_counter() - epoch_started,
            }
        )
        write_file(checkpoint, trainer.state())
        _write_curve(out, trainer.curve)
    progress("exporting", 1.0)
    facts = _export(out, trainer, data, command, len(train))
    return {**facts, "out": str(out), "total_s": time.perf_counter() - started}


def enhance(grey: FloatArray, px_per_mm: float, mask: BoolArray) -> FloatArray:
    """Enhance the contrast as the presets ``pr`` and ``snk`` do before the network."""
    return clahe(grey, px_per_mm, mask=mask)


def _subjects(data: DataSettings) -> Iterator[tuple[str, int]]:
    """Kind and number of every palm and finger, those held out last."""
    for kind, count in (("palm", data.palms), ("finger", data.fingers)):
        yield from ((kind, index) for index in range(count))
    for kind in ("palm", "finger"):
        yield from ((kind, HELD_OUT_FROM + index) for index in range(data.held_out))


def _store(out: Path, kind: str, index: int, data: DataSettings, seed: int) -> None:
    """Photograph one palm or finger, unless it is there already."""
    names = [out / "data" / f"{kind}_{index:07d}_{view:02d}" for view in range(data.views)]
    if all(name.with_suffix(".json").exists() for name in names):
        return
    for name, photograph in zip(names, photographs(kind, index, seed, data, enhance), strict=True):
        buffer = io.BytesIO()
        np.save(buffer, levelled(photograph).pixels, allow_pickle=False)
        write_file(name.with_suffix(".npy"), buffer.getvalue())
        document = {**photograph.facts, "corners": photograph.corners.tolist()}
        write_file(name.with_suffix(".json"), (json.dumps(document) + "\n").encode())  # last: it says that all is there


def _load(out: Path, kind: str, index: int, data: DataSettings) -> Iterator[Photograph]:
    for view in range(data.views):
        name = out / "data" / f"{kind}_{index:07d}_{view:02d}"
        damaged = f"'{name}.npy' is damaged; delete it and its .json, and resume."
        with refusing(damaged):
            facts = parse_json(read_file(name.with_suffix(".json")), f"{name}.json")
            corners = np.asarray(facts.pop("corners"), dtype=np.int32).reshape(-1, 2)
            # read as it is needed: a data set may be larger than the memory
            pixels = map_npy(name.with_suffix(".npy"), damaged)
            low, high = corners.min(), corners.max(axis=0) + data.patch_px
            require(
                bool(low >= 0 and (high <= pixels.shape[:2]).all()),
                f"patches lie outside the photograph '{name}.npy'; delete it and its .json, and resume.",
            )
        yield Photograph(pixels, corners, facts)


def _export(out: Path, trainer: Trainer, data: DataSettings, command: str, patches: int) -> dict[str, Any]:
    """Write network and card, read them back, and see that onnxruntime computes what torch does."""
    settings = trainer.settings
    weights = trainer.export()
    last = trainer.curve[-1]
    facts: dict[str, Any] = {
        "channels_in": 3,
        "channels_out": 3,
        "stride": settings.stride,
        "reach": unet_reach(settings.depth),
        "what": "direct light of skin: a photograph, or its CLAHE-enhanced grey image three times, to its direct part",
        "architecture": f"U-Net of the thesis (figure 3.19), depth {settings.depth}, width {settings.width}",
        "licence": "Apache-2.0",
        "software": f"splitknit {__version__}",
        "command": command,
        "training": {**plain(asdict(settings)), "epochs_done": trainer.epoch, "patches": patches},
        "data": plain(asdict(data)),
        "metrics": {
            "held_out": f"{data.held_out} palms and {data.held_out} fingers not trained on, patches, local level 1",
            "psnr_linear_db": _psnr(last["held_out_linear"]),
            "psnr_enhanced_db": _psnr(last["held_out_enhanced"]),
        },
    }
    write_file(out / f"{NETWORK}.onnx", weights)
    write_file(out / f"{NETWORK}.json", card_bytes(NETWORK, weights, facts))
    network = network_of(*read_network(out / f"{NETWORK}.onnx"))
    side = 10 * settings.stride
    probe = np.random.default_rng(0).random((1, 3, side, side + settings.stride), dtype=np.float32)
    made, wanted = run_network(network, probe), trainer.run(probe)
    # weights are stored in half precision: a few parts in a thousand of the output's range
    difference = float(np.abs(made - wanted).max() / max(float(np.abs(wanted).max()), 1e-6))
    require(
        difference < 0.02,
        f"the exported network differs from the trained one by {100 * difference:.2g} %; report this.",
    )
    return {**facts, "bytes": len(weights), "onnx_difference": difference}


def _write_curve(out: Path, curve: list[dict[str, float]]) -> None:
    write_file(out / "curve.csv", curve_table(curve))
    if len(curve) < 2:
        return
    epochs = np.array([entry["epoch"] for entry in curve], dtype=np.float64)
    lines = [
        Line(words, epochs, np.array([_psnr(entry[name]) for entry in curve]))
        for name, words in (
            ("loss", "training"),
            ("held_out_linear", "held out"),
            ("held_out_enhanced", "held out, enhanced"),
        )
    ]
    write_file(out / "curve.svg", curve_chart(lines, "epoch", "PSNR, dB"))


def _psnr(loss: float) -> float:
    """Of a mean squared error, in dB, for a peak of one: the local level."""
    return float(-10.0 * np.log10(max(loss, 1e-12)))
