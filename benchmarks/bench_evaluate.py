"""ROC, figures and bootstrap of 20,000 genuine and 1,000,000 impostor scores, and the thesis's
173,400 comparisons.

Peers: numpy's way of the textbook (sort all scores with their labels, cumulate), scikit-learn and
bob.measure.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

from peers import library
from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.protocol import comparisons, scores_of_comparisons
from splitknit_match.evaluation.rates import roc
from splitknit_match.evaluation.scores import Scores
from timing import machine, print_table, race


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument(
        "--replicates", type=int, default=100, help="timed; the table gives seconds for 1,000"
    )
    options = parser.parse_args()
    generator = np.random.default_rng(0)
    genuine = generator.normal(2.5, 1, 20_000)
    impostor = generator.normal(0, 1, 1_000_000)
    print(f"20,000 genuine and 1,000,000 impostor scores, {machine()}")
    contenders = {
        "roc": lambda: roc(genuine, impostor).far.size,
        "roc, EER, GAR at three FARs, AUC": lambda: figures(genuine, impostor),
        "argsort of all scores, cumulated": lambda: textbook(genuine, impostor).size,
    }
    label = np.repeat([1, 0], [genuine.size, impostor.size])
    score = np.concatenate([genuine, impostor])
    if metrics := library("sklearn.metrics"):
        contenders["scikit-learn: roc_curve"] = lambda: metrics.roc_curve(label, score)[0].size
    print_table(
        "ROC, scores in double precision",
        race(contenders, options.rounds),
        lambda size: f"{size:,}",
        "points",
    )
    rates = {"EER and the threshold of FAR 0.1 %": lambda: eer_and_threshold(genuine, impostor)}
    if measure := library("bob.measure"):
        rates["bob.measure: eer, far_threshold"] = lambda: (
            measure.eer(impostor, genuine),
            float(np.mean(genuine >= measure.far_threshold(impostor, genuine, 0.001))),
        )
    facts = race(rates, max(options.rounds // 3, 1))
    print_table(
        "Figures",
        facts,
        lambda rates_pair: f"{rates_pair[0]:.5f} / {rates_pair[1]:.5f}",
        "EER / GAR at FAR 0.1 %",
    )
    label = np.repeat([True, False], [genuine.size, impostor.size])
    resampling(Scores(label, np.concatenate([genuine, impostor])), ("plain",), options.replicates)
    resampling(thesis(generator), ("plain", "finger", "subject"), options.replicates)
    print(f"\n{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB at the peak")


def figures(genuine: np.ndarray, impostor: np.ndarray) -> int:
    curve = roc(genuine, impostor)
    curve.equal_error(), curve.auc(), curve.gars((0.01, 0.001, 0.0001))
    return curve.far.size


def eer_and_threshold(genuine: np.ndarray, impostor: np.ndarray) -> tuple[float, float]:
    curve = roc(genuine, impostor)
    return curve.equal_error().value, curve.at_far(0.001).gar


def textbook(genuine: np.ndarray, impostor: np.ndarray) -> np.ndarray:
    scores = np.concatenate([genuine, impostor])
    order = np.argsort(-scores)
    label = np.repeat([True, False], [genuine.size, impostor.size])[order]
    gar = np.cumsum(label) / genuine.size
    far = np.cumsum(~label) / impostor.size
    last = np.append(np.diff(scores[order]) != 0, True)
    return np.stack([far[last], gar[last]], axis=1)[:, 0]


def thesis(generator: np.random.Generator) -> Scores:
    """17 subjects, 10 fingers, 4 sessions, all six pairs."""
    finger = np.tile(np.arange(170), 4)
    session = np.repeat(np.arange(4), 170)
    pairs = comparisons(finger, session)
    score = 3 * pairs.genuine + generator.normal(size=pairs.a.size)
    return scores_of_comparisons(pairs, score, finger, session, finger // 10)


def resampling(scores: Scores, methods: tuple[str, ...], replicates: int) -> None:
    counts = (
        f"{int(scores.label.sum()):,} genuine and {int((~scores.label).sum()):,} impostor"
        " comparisons"
    )
    print(
        f"\n### Bootstrap of {counts}: seconds for 1,000 replicates\n\n| drawn | seconds | of the"
        " processor |"
    )
    print("| --- | --- | --- |")
    bootstrap(scores, "plain", BootstrapSettings(replicates=20))
    for method in methods:
        started = time.perf_counter()
        busy = time.process_time()
        bootstrap(scores, method, BootstrapSettings(replicates=replicates))
        factor = 1000 / replicates
        wall = factor * (time.perf_counter() - started)
        used = factor * (time.process_time() - busy)
        print(f"| {method} | {wall:.1f} | {used:.1f} |")


if __name__ == "__main__":
    main()
