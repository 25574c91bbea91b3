"""What a better network for direct light takes: its error over width and patches, with the thesis's training.

    python validation/separation/curve.py --scratch FOLDER [--smoke]

Networks of the thesis's shape with 4 to 32 channels in the first block see 500 to 8,000 patches (half of palms, half of
fingers, labels through 25 checkerboards) as often as makes --passes patches in all. Judged are the equalised patches of
fingers and palms that none of them saw: dB above the one constant fraction that is best on the patches trained on. The
error is fitted by floor + a width^-p + b patches^-q, and continued to the thesis's 64 channels and 37,500 patches;
its interval is a bootstrap over the photographs judged. Each finished network is kept in FOLDER: the same command goes
on. Writes ``curve.json`` beside this file. Three quarters of an hour of one core.

    python validation/separation/curve.py --scratch FOLDER --widen EPOCHS [--share K/2]

makes the shipped network twice as wide, keeping its function, and trains it on; as a control the shipped one is trained
on with the same patches, of palms and fingers that no other training saw (seed 1; an epoch is a fifth of them). Both
are judged as above, and as in ``unet.py``, in time and memory too: ``widened`` in ``curve.json``; FOLDER/12.onnx,
24.onnx.
"""

from __future__ import annotations

import argparse
import functools
import json
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import unet as as_photographs
from scipy.optimize import least_squares

from splitknit.networks.unet import load_network, read_network, run_network
from splitknit.separation.direct import direct_light
from splitknit_simulator.training.networks import load_torch, unet
from splitknit_simulator.training.separation import (
    Patches,
    Photograph,
    SeparationData,
    SeparationSettings,
    SeparationTrainer,
    enhanced_contrast,
    photographs,
    stored_photographs,
    train_separation,
)
from splitknit_simulator.training.trainer import TrainingRun

HERE = Path(__file__).resolve().parent
SIZES = ((4, 500), (4, 2000), (4, 8000), (8, 500), (8, 2000), (8, 8000), (16, 500), (16, 2000), (16, 8000), (32, 8000))
THESIS = (64, 37_500)
REPLICATES = 500
Names = dict[str, str | Path]
"""Networks by what they are: shipped ones, or files."""
WIDTHS = (12, 24)  # of the shipped network, and twice that
PARTS = 5  # of the patches that a network is trained on further; an epoch sees one
LIGHT = ("linear", "enhanced")
COUNT = {"palm": 6, "finger": 12, "snk": 6}  # photographs judged as in ``unet.py``; fingers by ``snk``


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, required=True)
    parser.add_argument("--passes", type=int, default=24_000, help="patches that each network sees (default: 24,000)")
    parser.add_argument("--share", default="1/1", help="K/N: train only every N-th network, from the K-th on")
    parser.add_argument("--widen", type=int, metavar="EPOCHS", help="the shipped network at twice its width instead")
    parser.add_argument("--smoke", action="store_true", help="two networks of two channels: does everything run?")
    options = parser.parse_args(arguments)
    target = (options.scratch if options.smoke else HERE) / "curve.json"
    data, sizes = SeparationData(palms=12, fingers=12, patches=334, held_out=8), list(SIZES)
    if options.smoke:
        data, sizes = replace(data, palms=1, fingers=1, patches=40, held_out=1, labels="truth"), [(1, 40), (2, 80)]
        options.passes = 160
    k, n = map(int, options.share.split("/"))
    if options.widen:
        more = SeparationData(palms=12, fingers=20, views=2, patches=100, labels="truth")
        made = prepared(options.scratch / "more", data if options.smoke else more, 1)
        for width in WIDTHS[k - 1 :: n]:
            trained_on(width, *made, options.widen, options.scratch)
        if all((options.scratch / f"{width}.onnx").is_file() for width in WIDTHS):
            few = replace(data, palms=1, fingers=1, labels="truth")
            judged = prepared(options.scratch / "judged", few, 0)[1]
            count = {"finger": 1} if options.smoke else COUNT
            store(target, {"widened": report_widened(options.scratch, made[0], judged, count)})
        return 0
    seen, judged = prepared(options.scratch / "data", data, 0)
    for size in sizes[k - 1 :: n]:
        file = options.scratch / f"{size[0]}-{size[1]}.json"
        if not file.is_file():
            rows = trained(size, seen, judged, options.passes)
            file.write_text(json.dumps(rows), encoding="utf-8")
        print(size, [round(gain(row, judged, "finger"), 2) for row in json.loads(file.read_text())], flush=True)
    files = [options.scratch / f"{width}-{count}.json" for width, count in sizes]
    if all(file.is_file() for file in files):
        networks = [json.loads(file.read_text(encoding="utf-8")) for file in files]
        store(target, report(sizes, networks, judged, options.passes))
    return 0


def store(file: Path, result: dict[str, Any]) -> None:
    """Write a part of the result beside those that are there."""
    before = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    file.write_text(json.dumps({**before, **result}, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=1))


def prepared(folder: Path, data: SeparationData, seed: int) -> tuple[list[Photograph], list[Photograph]]:
    """Photographs to train on, and those held out."""
    first = SeparationSettings(width=1, epochs=1, seed=seed)
    train_separation(TrainingRun(folder, resume=folder.exists()), data, first)
    return stored_photographs(folder, data, False), stored_photographs(folder, data, True)


def trained(
    size: tuple[int, int], seen: Sequence[Photograph], judged: Sequence[Photograph], passes: int
) -> list[dict[str, Any]]:
    """Three times while a network is trained: the patches seen, and mean squared errors by photograph."""
    width, count = size
    own = [replace(photograph, corners=photograph.corners[: round(count / len(seen))]) for photograph in seen]
    trainer = SeparationTrainer(SeparationSettings(width=width), Patches(own))
    constant = best_constant(own)
    epochs = max(3, round(passes / count))
    rows = []
    for part in range(3):
        trainer.train(epochs * (part + 1) // 3 - epochs * part // 3)
        rows.append(
            {
                "passes": trainer.done * count,
                "network": [trainer.loss_of(Patches([one]), enhanced=True) for one in judged],
                "constant": [constant_error(one, constant) for one in judged],
            }
        )
    return rows


def load_stored(network: Any, name: str | Path) -> Any:
    """Give a network in torch the weights of a shipped one, or of an ``.onnx`` file."""
    import onnx  # as torch, of the extra ``train``

    stored = onnx.load_model_from_string(read_network(name)[1]).graph.initializer
    arrays = {one.name: onnx.numpy_helper.to_array(one).astype(np.float32) for one in stored}
    network.load_state_dict({name: load_torch().from_numpy(array) for name, array in arrays.items()})
    return network


def widen(narrow: Any, wide: Any) -> None:
    """Give `wide` the function of `narrow`, a U-Net of a fraction of its width: Net2WiderNet (Chen et al. 2016).

    A channel becomes neighbouring copies, so that channels of joined maps stay where their source puts them. A weight
    is split among the copies that it reads in parts drawn for each: this alone makes copies differ and learn different
    things. The U-Net normalises nothing, so no statistics change.
    """
    torch = load_torch()
    draw = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for name, layer in wide.named_modules():
            if not isinstance(layer, (torch.nn.Conv2d, torch.nn.ConvTranspose2d)):
                continue
            source = narrow.get_submodule(name)
            weight, bias = source.weight, source.bias
            copies = [new // old for new, old in zip(layer.weight.shape, weight.shape, strict=True)]
            reads = int(isinstance(layer, torch.nn.Conv2d))  # the axis of the channels that it reads
            for axis in (0, 1):
                weight = weight.repeat_interleave(copies[axis], axis)
            parts = torch.rand(weight.shape, generator=draw).unflatten(reads, (-1, copies[reads]))
            parts = (parts / parts.sum(reads + 1, keepdim=True)).flatten(reads, reads + 1)
            layer.weight.copy_(weight * parts)
            layer.bias.copy_(bias.repeat_interleave(copies[1 - reads]))


def trained_on(
    width: int, seen: Sequence[Photograph], held_out: Sequence[Photograph], epochs: int, folder: Path
) -> None:
    """Train the shipped network further at a width. Each epoch's state is kept; a stopped training goes on from it."""
    settings = SeparationSettings(
        width=width, dropout=0.0, learning_rate=3e-4, epochs=epochs, decay=1.0, border_px=8, seed=1, precision="mixed"
    )
    trainer = SeparationTrainer(settings, Patches(seen))
    few = Patches([replace(one, corners=one.corners[:20]) for one in held_out])
    widen(load_stored(unet(WIDTHS[0], dropout=0.0), "direct"), trainer.network)

    def entry() -> dict[str, float]:
        return {"epoch": trainer.done, **{name: trainer.loss_of(few, name == "enhanced") for name in LIGHT}}

    state = folder / f"{width}.pt"
    if state.is_file():
        trainer.restore(state.read_bytes())
    else:
        trainer.curve.append(entry())
        export(trainer, folder / f"{width}-start.onnx")
    while trainer.done < epochs:
        trainer.patches = Patches([replace(one, corners=one.corners[trainer.done % PARTS :: PARTS]) for one in seen])
        began = time.process_time()
        loss = trainer.train(1)["loss"]
        trainer.curve.append({"loss": loss, "processor_s": time.process_time() - began, **entry()})
        state.with_suffix(".new").write_bytes(trainer.state())
        state.with_suffix(".new").replace(state)
        print(width, trainer.curve[-1], flush=True)
    (folder / f"{width}-curve.json").write_text(json.dumps(trainer.curve), encoding="utf-8")
    export(trainer, folder / f"{width}.onnx")


def export(trainer: SeparationTrainer, file: Path) -> None:
    """Write a network and its card; the weights are stored in half precision, as shipped."""
    weights, card = trainer.packed({})
    file.with_suffix(".json").write_bytes(card)
    file.write_bytes(weights)


def report_widened(
    folder: Path, seen: Sequence[Photograph], judged: Sequence[Photograph], count: dict[str, int]
) -> dict[str, Any]:
    """Shipped network, widened one, and both trained on: time and memory, learning curve, photographs, ``snk``."""
    names: Names = {"shipped": "direct", "widened": folder / "24-start.onnx"}
    names |= {"control": folder / "12.onnx", "trained": folder / "24.onnx"}
    with get_context("spawn").Pool(1, maxtasksperchild=1) as fresh:
        costs = {name: fresh.apply(cost, (names[name],)) for name in ("shipped", "trained")} if "snk" in count else {}
    curves = {}
    for width in WIDTHS:
        epochs = json.loads((folder / f"{width}-curve.json").read_text(encoding="utf-8"))
        seconds = sum(one.get("processor_s", 0.0) for one in epochs)
        curves[width] = {"processor_s": round(seconds, 1), "epochs": epochs[:: max(1, len(epochs) // 15)]}
    constant, rows = best_constant(seen), {}
    for name in ("shipped", "control", "trained"):
        trainer = SeparationTrainer(SeparationSettings(width=WIDTHS[name == "trained"], dropout=0.0), Patches(seen))
        load_stored(trainer.network, names[name])
        rows[name] = {
            "network": [trainer.loss_of(Patches([one]), enhanced=True) for one in judged],
            "constant": [constant_error(one, constant) for one in judged],
        }
    return {
        "cost": costs,
        "training": curves,
        "gain_db": {kind: compared_gains(rows, judged, kind) for kind in ("finger", "palm")},
        "photographs": {
            kind: compared_photographs(names, kind, number, folder) for kind, number in count.items() if kind != "snk"
        },
        "snk": compared_reliefs(names, count["snk"], folder) if "snk" in count else {},
    }


def compared_gains(rows: dict[str, Any], judged: Sequence[Photograph], kind: str) -> dict[str, list[float]]:
    """dB of each network above the constant, and of each above the shipped one, with intervals over photographs."""
    size = sum(one.facts["kind"] == kind for one in judged)
    draws = [None, *np.random.default_rng(0).integers(0, size, (REPLICATES, size))]
    found = {name: np.array([gain(row, judged, kind, draw) for draw in draws]) for name, row in rows.items()}
    found = with_differences(found)
    return {name: [round(float(v), 3) for v in (all_[0], *interval(all_[1:]))] for name, all_ in found.items()}


def with_differences(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The figures of every network, and what it has more than the shipped one and than the control."""
    pairs_of = [(name, "shipped") for name in list(found)[1:]] + [("trained", "control")]
    return found | {f"{one} - {other}": found[one] - found[other] for one, other in pairs_of}


def compared_photographs(names: Names, kind: str, count: int, folder: Path) -> dict[str, dict[str, list[float]]]:
    """PSNR and SSIM of linear colours and enhanced grey as by ``unet.py``; truth: the twin's own direct light."""

    def judged(file: str | Path, index: int) -> list[float]:
        network = load_network(file)
        image, truth = as_photographs.channels(kept_photograph(folder, kind, index))
        made = np.concatenate([direct_light(image[None, :3], network)[0], direct_light(image[3:], network)])
        four = as_photographs.figures((kind, index), str(file), made, truth, truth[0] > 0)
        values = np.array([[row["psnr_db"], row["ssim"]] for row in four])
        return [*values[:3].mean(axis=0).tolist(), *values[3].tolist()]

    first = as_photographs.FIRST
    columns = {
        name: [kept(folder, file, f"{kind}_{k}", judged, k) for k in range(first, first + count)]
        for name, file in names.items()
    }
    return summed_up(columns, ("psnr_linear_db", "ssim_linear", "psnr_enhanced_db", "ssim_enhanced"))


def compared_reliefs(names: Names, count: int, folder: Path) -> dict[str, dict[str, list[float]]]:
    """Relief by ``snk`` with each network, on the fingers of ``ablation.py``."""
    from ablation_rows import FIGURES, Bench, Options  # heavy

    bench = functools.cache(lambda seed: Bench(seed, Options()))

    def judged(file: str | Path, seed: int) -> list[float]:
        bench(seed).options = Options(direct=str(file))
        found = bench(seed).figures("snk_clahe_network")
        return [found[figure] for figure in FIGURES]

    columns: dict[str, list[Any]] = {name: [] for name in names}
    for seed in range(1000, 1000 + count):
        for name, file in names.items():
            columns[name].append(kept(folder, file, f"snk_{seed}", judged, seed))
        bench.cache_clear()
    return summed_up(columns, FIGURES)


def kept(folder: Path, network: str | Path, name: str, judge: Callable[[str | Path, int], Any], number: int) -> Any:
    """What was found by a network, measured once."""
    file = folder / f"{read_network(network)[0].sha256[:12]}_{name}.json"
    if not file.is_file():
        file.write_text(json.dumps(judge(network, number)), encoding="utf-8")
        print(network, name, file.read_text(encoding="utf-8"), flush=True)
    return json.loads(file.read_text(encoding="utf-8"))


def kept_photograph(folder: Path, kind: str, index: int) -> Photograph:
    """One of the photographs of ``unet.py``."""
    file = folder / f"{kind}_{index}.npy"
    if not file.is_file():
        data = SeparationData(labels="truth", patches=1)
        np.save(file, photographs(kind, index, 0, data, enhanced_contrast)[0].pixels)
    return Photograph(np.load(file), np.zeros((0, 2), dtype=np.int32), {})


def summed_up(columns: dict[str, list[Any]], figures: Sequence[str]) -> dict[str, dict[str, list[float]]]:
    """Mean of each figure, and its interval by a bootstrap over photographs or fingers."""
    found = with_differences({name: np.array(column) for name, column in columns.items()})
    count = len(found["shipped"])
    drawn = np.random.default_rng(1).integers(0, count, (2000, count))
    result = {}
    for name, values in found.items():
        ends = np.percentile(values[drawn].mean(axis=1), [2.5, 97.5], axis=0)
        table = np.round([values.mean(axis=0), *ends], 4).T.tolist()
        result[name] = dict(zip(figures, table, strict=True))
    return result


def cost(file: str | Path) -> dict[str, float]:
    """Processor time of a photograph at half scale, least of three, and the peak memory of this process alone."""
    image = np.random.default_rng(0).random((1, 3, 1100, 1600), dtype=np.float32)
    network, times = load_network(file), []
    for _ in range(3):
        began = time.process_time()
        run_network(network, image)
        times.append(time.process_time() - began)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    return {"processor_s": round(min(times), 2), "peak_mb": peak_mb}


def pairs(photograph: Photograph) -> tuple[np.ndarray, np.ndarray]:
    """Equalised patches and their direct light, one channel."""
    batches = list(Patches([photograph]).fixed(enhanced=True, batch=64))
    inputs, targets = (np.concatenate([batch[side][:, 0] for batch in batches]) for side in (0, 1))
    return inputs, targets


def best_constant(photographs: Sequence[Photograph]) -> float:
    """The fraction of an equalised image that is nearest to its direct light."""
    up = down = 0.0
    for photograph in photographs:
        image, direct = pairs(photograph)
        up, down = up + float((image * direct).sum()), down + float((image * image).sum())
    return up / down


def constant_error(photograph: Photograph, fraction: float) -> float:
    image, direct = pairs(photograph)
    return float(np.mean((fraction * image - direct) ** 2))


def gain(row: dict[str, Any], judged: Sequence[Photograph], kind: str, chosen: np.ndarray | None = None) -> float:
    """dB of a network above the constant: of the mean squared errors over photographs of a kind."""
    mine = np.flatnonzero([one.facts["kind"] == kind for one in judged])
    mine = mine if chosen is None else mine[chosen]
    return float(10 * np.log10(np.mean(np.array(row["constant"])[mine]) / np.mean(np.array(row["network"])[mine])))


def report(
    sizes: Sequence[tuple[int, int]],
    networks: Sequence[list[dict[str, Any]]],
    judged: Sequence[Photograph],
    passes: int,
) -> dict[str, Any]:
    """Gains at the end of every training, and what the fit says of the thesis's size."""
    result: dict[str, Any] = {"passes": passes, "of_thesis": 50 * THESIS[1], "kinds": {}}
    rng = np.random.default_rng(0)
    for kind in ("finger", "palm"):
        mine = np.flatnonzero([one.facts["kind"] == kind for one in judged])
        draws = [None, *(rng.integers(0, len(mine), len(mine)) for _ in range(REPLICATES))]
        ends = np.array([[gain(rows[-1], judged, kind, draw) for rows in networks] for draw in draws])
        fits = [continued(sizes, end) for end in ends] if len(sizes) > 5 else [(0.0, 0.0)] * len(ends)
        at_thesis, floor = np.array(fits).T
        result["kinds"][kind] = {
            "gain_db": {
                f"{width} x {count}": [round(float(v), 2) for v in (ends[0, k], *interval(ends[1:, k]))]
                for k, (width, count) in enumerate(sizes)
            },
            "while_training_db": {
                f"{width} x {count}": [round(gain(row, judged, kind), 2) for row in rows]
                for (width, count), rows in zip(sizes, networks, strict=True)
            },
            "thesis_size_db": [round(float(v), 2) for v in (at_thesis[0], *interval(at_thesis[1:]))],
            "without_limit_db": [round(float(v), 2) for v in (floor[0], *interval(floor[1:]))],
        }
    return result


def interval(values: np.ndarray) -> tuple[float, float]:
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)


def continued(sizes: Sequence[tuple[int, int]], gains: np.ndarray) -> tuple[float, float]:
    """Gain of the thesis's size, and of no limit: errors relative to the constant's, fitted over width and patches."""
    width, count = np.array(sizes, dtype=float).T
    error = 10 ** (-gains / 10)

    def model(p: np.ndarray, width: Any, count: Any) -> Any:
        return p[0] + p[1] * (width / 4) ** -p[2] + p[3] * (count / 500) ** -p[4]

    lowest = (0, 0, 0.1, 0, 0.1)
    fit = least_squares(lambda p: model(p, width, count) - error, (0.5, 0.3, 0.5, 0.3, 0.5), bounds=(lowest, 2))
    at_thesis, floor = (float(-10 * np.log10(max(value, 1e-3))) for value in (model(fit.x, *THESIS), fit.x[0]))
    return at_thesis, floor


if __name__ == "__main__":
    raise SystemExit(main())
