"""What a better network for direct light takes: its error over width and patches, with the thesis's training.

    python validation/separation/curve.py --scratch FOLDER [--smoke]

Networks of the thesis's shape with 4 to 32 channels in the first block see 500 to 8,000 patches (half of palms, half of
fingers, labels through 25 checkerboards) as often as makes --passes patches in all. Judged are the equalised patches of
fingers and palms that none of them saw: dB above the one constant fraction that is best on the patches trained on. The
error is fitted by floor + a width^-p + b patches^-q, and continued to the thesis's 64 channels and 37,500 patches;
its interval is a bootstrap over the photographs judged. Each finished network is kept in FOLDER: the same command goes
on. Writes ``curve.json`` beside this file. Three quarters of an hour of one core.

    python validation/separation/curve.py --scratch FOLDER --thesis

trains at the thesis's size, 64 channels and 37,500 patches seen 50 times, labels through checkerboards: ``palms`` as
the thesis does, ``both`` as the shipped network, on palms and fingers. It needs a GPU: ten minutes of an H100 and 16
cores. Both are judged as above, and as in ``unet.py``, in time and memory too: ``thesis`` in ``curve.json``. What is in
FOLDER is not trained again; judging needs no GPU.
"""

from __future__ import annotations

import argparse
import functools
import json
import resource
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import unet as as_photographs
from scipy.optimize import least_squares

from splitknit.networks.unet import load_network, read_network, run_network
from splitknit.separation.direct import direct_light
from splitknit_simulator.training.networks import load_torch
from splitknit_simulator.training.separation import (
    Patches,
    Photograph,
    SeparationData,
    SeparationSettings,
    SeparationTrainer,
    enhanced_contrast,
    photographs,
    stored_photographs,
)
from splitknit_simulator.training.trainer import TrainingRun

HERE = Path(__file__).resolve().parent
SIZES = ((4, 500), (4, 2000), (4, 8000), (8, 500), (8, 2000), (8, 8000), (16, 500), (16, 2000), (16, 8000), (32, 8000))
THESIS = (64, 37_500)
REPLICATES = 500
Names = dict[str, str | Path]
"""Networks by what they are: shipped ones, or files."""
RECIPES = {
    "palms": SeparationSettings(device="cuda", threads=16),
    # as the shipped network
    "both": SeparationSettings(device="cuda", threads=16, dropout=0.0, start_fraction=0.25, decay=0.48, border_px=8),
}
AHEAD = 12  # epochs whose patches are made by other processes while one is trained on; 2.3 GB each
COUNT = {"palm": 6, "finger": 12, "snk": 8}  # photographs judged as in ``unet.py``; fingers by ``snk``


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, required=True)
    parser.add_argument("--passes", type=int, default=24_000, help="patches that each network sees (default: 24,000)")
    parser.add_argument("--share", default="1/1", help="K/N: train only every N-th network, from the K-th on")
    parser.add_argument("--thesis", action="store_true", help="the thesis's size instead, on a GPU")
    parser.add_argument("--smoke", action="store_true", help="two networks of two channels: does everything run?")
    options = parser.parse_args(arguments)
    target = (options.scratch if options.smoke else HERE) / "curve.json"
    data, sizes = SeparationData(palms=12, fingers=12, patches=334, held_out=8), list(SIZES)
    if options.smoke:
        data, sizes = replace(data, palms=1, fingers=1, patches=40, held_out=1, labels="truth"), [(1, 40), (2, 80)]
        options.passes = 160
    if options.thesis:
        trained_as_thesis(options.scratch, options.smoke)
        judged = prepared(options.scratch / "judged", replace(data, palms=1, fingers=1, patches=200, labels="truth"))[1]
        count = {"finger": 1} if options.smoke else COUNT
        store(target, {"thesis": report_thesis(options.scratch, judged, count)})
        return 0
    k, n = map(int, options.share.split("/"))
    seen, judged = prepared(options.scratch / "data", data)
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


def prepared(folder: Path, data: SeparationData, threads: int = 1) -> tuple[list[Photograph], list[Photograph]]:
    """Photographs to train on, and those held out."""
    run = TrainingRun(folder, resume=folder.exists())
    return stored_photographs(run, data, SeparationSettings(threads=threads))[:2]


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


def trained_as_thesis(folder: Path, smoke: bool) -> None:
    """Train the networks of the thesis's size that are not in `folder` yet."""
    data, recipes = SeparationData(palms=50, fingers=50), RECIPES
    if smoke:
        data = replace(data, palms=1, fingers=1, patches=70, held_out=1, labels="truth")
        recipes = {name: replace(one, width=2, epochs=2, device="cpu", threads=1) for name, one in RECIPES.items()}
    for name, settings in recipes.items():
        if (folder / f"{name}.onnx").is_file():
            continue
        held_out = prepared(folder / "data", data, settings.threads)[1]
        few = Patches([replace(one, corners=one.corners[:50]) for one in held_out])
        with PatchesAhead(name, folder, data, settings) as patches:
            trainer = GraphTrainer(settings, patches)
            while trainer.done < settings.epochs:
                began = time.perf_counter()
                entry = {"epoch": trainer.done + 1, **trainer.train(1), "seconds": time.perf_counter() - began}
                held = {light: trainer.loss_of(few, light == "enhanced") for light in ("linear", "enhanced")}
                trainer.curve.append({**entry, **held})
                print(name, trainer.curve[-1], flush=True)
        learnt = {"constant": best_constant(patches.photographs), "epochs": trainer.curve}
        (folder / f"{name}-curve.json").write_text(json.dumps(learnt), encoding="utf-8")
        weights, card = trainer.packed({})  # stored in half precision, as shipped
        (folder / f"{name}.json").write_bytes(card)
        (folder / f"{name}.onnx").write_bytes(weights)


@functools.cache
def chosen(name: str, folder: Path, data: SeparationData) -> Patches:
    """What a network of the thesis's size is trained on: 37,500 patches of palms, or of palms and fingers."""
    seen = prepared(folder, data)[0]
    if name == "palms":
        return Patches([one for one in seen if one.facts["kind"] == "palm"])
    return Patches([replace(one, corners=one.corners[::2]) for one in seen])


class PatchesAhead(Patches):
    """The same patches in the same order; those of the next epochs are made by other processes meanwhile."""

    def __init__(self, name: str, folder: Path, data: SeparationData, settings: SeparationSettings) -> None:
        self.settings, self.reader = settings, ThreadPoolExecutor(1)
        self.source = (name, folder / "data", data)
        super().__init__(chosen(*self.source).photographs)
        self.pool = get_context("spawn").Pool(min(AHEAD, settings.threads))
        self.made = TemporaryDirectory(dir=folder)
        self.waiting: dict[int, Any] = {}
        if settings.device == "cuda":
            self.torch = load_torch()
            self.side = self.torch.cuda.Stream()

    def __enter__(self) -> PatchesAhead:
        return self

    def __exit__(self, *_: object) -> None:
        self.pool.terminate()
        self.reader.shutdown(cancel_futures=True)
        self.made.cleanup()

    def shuffled(self, batch: int, seed: int, epoch: int) -> Iterator[tuple[Any, Any]]:
        """Yield the batches of an epoch; on a GPU as torch's tensors."""
        for number in range(epoch, min(epoch + AHEAD, self.settings.epochs)):
            if number not in self.waiting:
                file = Path(self.made.name) / f"{number}.npy"
                made = self.pool.apply_async(stored_epoch, (self.source, file, batch, seed, number))
                self.waiting[number] = self.reader.submit(self._loaded, made)
        pieces = self.waiting.pop(epoch).result()
        if self.settings.device == "cuda":
            pieces.record_stream(self.torch.cuda.current_stream())
        for first in range(0, len(pieces), batch):
            both = pieces[first : first + batch]
            yield both[:, :3], both[:, 3:]

    def _loaded(self, made: Any) -> Any:
        """An epoch's patches, read while the one before is trained on."""
        file = made.get()
        pieces = np.load(file)
        file.unlink()
        if self.settings.device == "cpu":
            return pieces.astype(np.float32)
        with self.torch.cuda.stream(self.side):
            there = self.torch.from_numpy(pieces).to(self.settings.device)
            self.side.synchronize()
        return there


def stored_epoch(source: tuple[str, Path, SeparationData], file: Path, batch: int, seed: int, epoch: int) -> Path:
    """Write the patches of an epoch in their order, (n, 6, side, side): image and direct light."""
    cv2.setNumThreads(1)
    patches, first = chosen(*source), 0
    pieces = np.lib.format.open_memmap(file, "w+", np.float16, (len(patches), 6, patches.side, patches.side))
    for pair in patches.shuffled(batch, seed, epoch):
        both = np.concatenate(pair, axis=1)
        pieces[first : first + len(both)] = both
        first += len(both)
    return file


class GraphTrainer(SeparationTrainer):
    """On a GPU every step is one CUDA graph: launching its kernels one by one takes longer than they run. The last,
    smaller batch of an epoch is left out there.
    """

    graph: Any = None

    def train(self, count: int, tick: Callable[[float], None] | None = None) -> dict[str, float]:
        """Train `count` epochs."""
        if self.settings.device == "cpu":
            return super().train(count, tick)
        self.network.train()
        total, steps = self.torch.zeros((), device=self.device), 0
        for _ in range(count):
            for step in self.steps():
                if len(step.batch[0]) < self.settings.batch:
                    continue
                if self.graph is None:
                    self._capture(step)
                self.rate.fill_(step.learning_rate)
                for place, part in zip(self.placed, step.batch, strict=True):
                    place.copy_(part)
                self.graph.replay()
                total, steps = total + self.loss, steps + 1
            self.done += 1
        return {"loss": float(total) / steps}

    def _capture(self, step: Any) -> None:
        torch, side = self.torch, self.torch.cuda.Stream()
        torch.backends.cudnn.benchmark = True
        self.rate = torch.tensor(step.learning_rate, device=self.device)
        self.optimiser = torch.optim.AdamW(self.network.parameters(), self.rate, weight_decay=0.0, capturable=True)
        self.placed = [part.float().contiguous(memory_format=torch.channels_last) for part in step.batch]
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(3):  # what is set up at first use must be there before
                self._step()
        torch.cuda.current_stream().wait_stream(side)
        self.graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self.graph):
            self.loss = self._step()

    def _step(self) -> Any:
        self.optimiser.zero_grad(set_to_none=True)
        loss = self.losses(self.placed)["loss"]
        loss.backward()
        self.optimiser.step()
        return loss.detach()

    def tensor(self, array: Any) -> Any:
        """Torch's tensors are as they should be."""
        return array if self.torch.is_tensor(array) else super().tensor(array)


def report_thesis(folder: Path, judged: Sequence[Photograph], count: dict[str, int]) -> dict[str, Any]:
    """Shipped network and those of the thesis's size: time and memory, learning curve, photographs, ``snk``."""
    names: Names = {"shipped": "direct"} | {name: folder / f"{name}.onnx" for name in RECIPES}
    with get_context("spawn").Pool(1, maxtasksperchild=1) as fresh:
        costs = {name: fresh.apply(cost, (names[name],)) for name in ("shipped", "both")} if "snk" in count else {}
    learnt = {name: json.loads((folder / f"{name}-curve.json").read_text(encoding="utf-8")) for name in RECIPES}

    def error(file: str | Path, index: int) -> float:
        image, direct = pairs(judged[index])
        made = (run_network(load_network(file), np.repeat(one[None, None], 3, axis=1))[0] for one in image)
        return float(np.mean([np.square(one - wanted) for one, wanted in zip(made, direct, strict=True)]))

    constant = [constant_error(one, learnt["both"]["constant"]) for one in judged]
    rows = {
        name: {
            "network": [kept(folder, file, f"patches_{k}", error, k) for k in range(len(judged))],
            "constant": constant,
        }
        for name, file in names.items()
    }
    return {
        "cost": costs,
        "training": {name: {**one, "epochs": one["epochs"][4::5]} for name, one in learnt.items()},
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
    """The figures of every network, and what it has more than the shipped one and than no network."""
    bases = [name for name in ("shipped", "none") if name in found]
    pairs = [(name, base) for base in bases for name in found if name not in (base, "none")]
    return found | {f"{name} - {base}": found[name] - found[base] for name, base in pairs}


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
    """Relief by ``snk`` with each network, and from all light, on the fingers of ``ablation.py``."""
    from ablation_rows import FIGURES, Bench, Options  # heavy

    bench = functools.cache(lambda seed: Bench(seed, Options()))

    def judged(row: str, file: str | Path, seed: int) -> list[float]:
        bench(seed).options = Options(direct=str(file))
        found = bench(seed).figures(row)
        return [found[figure] for figure in FIGURES]

    columns: dict[str, list[Any]] = {name: [] for name in (*names, "none")}
    for seed in range(1000, 1000 + count):
        for name, file in names.items():
            network = functools.partial(judged, "snk_clahe_network")
            columns[name].append(kept(folder, file, f"snk_{seed}", network, seed))
        columns["none"].append(kept(folder, "direct", f"none_{seed}", functools.partial(judged, "snk_clahe_all"), seed))
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
