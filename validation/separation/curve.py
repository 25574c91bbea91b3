"""What a better network for direct light takes: its error over width and patches, with the thesis's training.

    python validation/separation/curve.py --scratch FOLDER [--smoke]

Networks of the thesis's shape with 4 to 32 channels in the first block see 500 to 8,000 patches (half of palms, half of
fingers, labels through 25 checkerboards) as often as makes --passes patches in all. Judged are the equalised patches of
fingers and palms that none of them saw: dB above the one constant fraction that is best on the patches trained on. The
error is fitted by floor + a width^-p + b patches^-q, and continued to the thesis's 64 channels and 37,500 patches;
its interval is a bootstrap over the photographs judged. Each finished network is kept in FOLDER: the same command goes
on. Writes ``curve.json`` beside this file. Three quarters of an hour of one core.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from splitknit_simulator.training.separation import (
    Patches,
    Photograph,
    SeparationData,
    SeparationSettings,
    SeparationTrainer,
    stored_photographs,
    train_separation,
)
from splitknit_simulator.training.trainer import TrainingRun

HERE = Path(__file__).resolve().parent
SIZES = ((4, 500), (4, 2000), (4, 8000), (8, 500), (8, 2000), (8, 8000), (16, 500), (16, 2000), (16, 8000), (32, 8000))
THESIS = (64, 37_500)
REPLICATES = 500


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, required=True)
    parser.add_argument("--passes", type=int, default=24_000, help="patches that each network sees (default: 24,000)")
    parser.add_argument("--share", default="1/1", help="K/N: train only every N-th network, from the K-th on")
    parser.add_argument("--smoke", action="store_true", help="two networks of two channels: does everything run?")
    options = parser.parse_args(arguments)
    data, sizes = SeparationData(palms=12, fingers=12, patches=334, held_out=8), list(SIZES)
    if options.smoke:
        data, sizes = replace(data, palms=1, fingers=1, patches=40, held_out=1, labels="truth"), [(1, 40), (2, 80)]
        options.passes = 160
    folder = options.scratch / "data"
    first = SeparationSettings(width=1, epochs=1)
    train_separation(TrainingRun(folder, resume=folder.exists()), data, first)
    seen, judged = (stored_photographs(folder, data, held_out) for held_out in (False, True))
    k, n = map(int, options.share.split("/"))
    for size in sizes[k - 1 :: n]:
        file = options.scratch / f"{size[0]}-{size[1]}.json"
        if not file.is_file():
            rows = trained(size, seen, judged, options.passes)
            file.write_text(json.dumps(rows), encoding="utf-8")
        print(size, [round(gain(row, judged, "finger"), 2) for row in json.loads(file.read_text())], flush=True)
    files = [options.scratch / f"{width}-{count}.json" for width, count in sizes]
    if all(file.is_file() for file in files):
        networks = [json.loads(file.read_text(encoding="utf-8")) for file in files]
        result = report(sizes, networks, judged, options.passes)
        (options.scratch if options.smoke else HERE).joinpath("curve.json").write_text(
            json.dumps(result, indent=1) + "\n", encoding="utf-8"
        )
        print(json.dumps(result, indent=1))
    return 0


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
