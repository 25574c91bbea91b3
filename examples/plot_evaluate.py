"""How good is a matcher? All pairs of a small population, error rates with intervals, and a ROC
curve.

    python examples/plot_evaluate.py --out pictures

Ten fingers, each laid down twice, known exactly (no camera between): what remains is pose alone.
Twenty captures are far too few for a false match rate of a hundredth, and the intervals show it;
``splitknit simulate population`` and ``splitknit batch`` do the same with hundreds.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from splitknit.finger.orientation import find_upright
from splitknit.nominal import default_rig
from splitknit_match.evaluation.curves import chart, draw_roc
from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.protocol import comparisons, scores_of_comparisons
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.ridge_band import ridge_band
from splitknit_match.matching.template import Template, make_template
from splitknit_simulator.finger.finger import PoseRanges, draw_finger, finger_surface

PHALANGE_MM, NOISE_UM = 20.0, 12.0


def template(finger: int, impression: int, scale: float) -> Template:
    """What a perfect camera would give, with noise on the relief."""
    camera = default_rig(scale).camera
    rng = np.random.default_rng([finger, impression])
    seen = finger_surface(draw_finger(finger), PoseRanges().draw(rng, camera), camera)
    mask = seen.mask.copy()
    mask[int(np.argmax(mask.any(axis=1))) + round(PHALANGE_MM * camera.px_per_mm) :] = False
    upright = find_upright(mask)
    noise = (NOISE_UM / 1000.0 * rng.standard_normal(mask.shape)).astype(np.float32)
    relief = seen.height_mm - seen.shape_mm + noise
    return make_template(
        ridge_band(
            relief, mask, camera.pitch_mm, seen.shape_mm, upright.input_from_upright, upright.size
        )
    )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fingers", type=int, default=10)
    parser.add_argument("--scale", type=float, default=0.15)
    parser.add_argument("--out", type=Path, help="folder for pictures; none are written without it")
    options = parser.parse_args(arguments)
    count = options.fingers
    finger = np.tile(np.arange(count), 2)
    session = np.repeat(np.arange(2), count)
    sides = [
        Prepared(template(100 + f, s, options.scale)) for f, s in zip(finger, session, strict=True)
    ]
    pairs = comparisons(finger, session)
    similarity = np.array(
        [ridge_match(sides[a], sides[b]).similarity for a, b in zip(pairs.a, pairs.b, strict=True)]
    )
    scores = scores_of_comparisons(pairs, similarity, finger, session)
    print(f"{int(pairs.genuine.sum())} genuine pairs, {int((~pairs.genuine).sum())} of impostors")
    print(
        f"similarity: genuine {similarity[pairs.genuine].min():.2f} to"
        f" {similarity[pairs.genuine].max():.2f}, impostors {similarity[~pairs.genuine].min():.2f}"
        f" to {similarity[~pairs.genuine].max():.2f}"
    )
    intervals = bootstrap(scores, "finger", BootstrapSettings(seed=1))
    for name, words in (("eer", "equal error rate"), ("gar@0.01", "GAR at FAR 1 %")):
        figure = intervals.figures[name]
        print(
            f"{words}: {100 * figure.value:.1f} % [{100 * figure.low:.1f}, {100 * figure.high:.1f}]"
        )
    band = intervals.curve_far, intervals.curve_low, intervals.curve_high
    if options.out is not None:
        (options.out / "roc.svg").write_bytes(
            chart(lambda ax: draw_roc(ax, [("ridges", scores, band)]))
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
