"""Figure 3.21: the relief of case SnK with n = 2 to 7 scales of shapelets, compared by the thesis's matcher.

Only the last step differs between the six, so that images are enhanced and separated once for each capture:
:func:`relief_images` lets all n share what comes before. It gives the same relief as
``splitknit reconstruct --preset snk --set shapelets.scales=n`` (tests/validation/test_thesis_experiments.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from compared import Way, captures_of, compare_pairs, drawn, each, kept_images, read_images
from trials import Pairs, Table

from splitknit.io.capture import read_capture
from splitknit.io.provenance import settings_hash
from splitknit.model import Capture
from splitknit.pipeline import reconstruct
from splitknit.presets import preset_settings
from splitknit.steps import Memory
from splitknit_match.evaluation.protocol import comparisons
from splitknit_match.matching.features import lbp_features
from splitknit_match.matching.thesis import FingerImages, finger_images

SCALES = (2, 3, 4, 5, 6, 7)
SESSIONS = ("1", "2")
"""The thesis: "170 fingers recorded over 2 sessions"."""


def relief_images(capture: Capture, scales: Sequence[int] = SCALES) -> FingerImages:
    """Reliefs of one capture, one channel ``snk2`` ... for each number of scales.

    Raises
    ------
    BadInput
        If it shows no finger.
    """
    memory = Memory(capture)  # the scales share all but the shapelets
    channels = {}
    for count in scales:
        # as snk up to the relief, without its near-infrared shape
        result = reconstruct(capture, "pr-split", {"shapelets.scales": count}, memory=memory)
        images = finger_images(
            result.normals, result.ridge_mm, result.mask, result.pitch_mm, result.input_from_upright,
            upright_size=result.upright_size,
        )  # fmt: skip
        channels[f"snk{count}"] = images.channels["relief"]
    return replace(images, channels=channels)


def scales_table(  # noqa: PLR0917
    population: Path, names: Sequence[str], scratch: Path, fraction: float, seed: int, jobs: int
) -> Table:
    """Trials ``n = 2`` to ``n = 7`` on sessions 1 and 2 of the captures `names`.

    Reliefs and scores are kept in `scratch`: what was stopped goes on.

    Parameters
    ----------
    population : folder of the captures
    names : of captures (``S01/session_1/right_index``)
    scratch : folder, of this population alone
    fraction : of the impostor pairs
    seed : which of them
    jobs : processes
    """
    captures = captures_of([name for name in names if name.split("/")[1].removeprefix("session_") in SESSIONS])
    scratch = scratch / settings_hash({"settings": preset_settings("pr-split"), "scales": SCALES})[:12]
    each(partial(_keep_reliefs, population, scratch), captures.names.tolist(), jobs)
    all_pairs = comparisons(captures.finger.tolist(), captures.session.tolist())
    kept = all_pairs.genuine | drawn(captures.finger[all_pairs.a], captures.finger[all_pairs.b], fraction, seed)
    pairs = Pairs(captures, all_pairs.a[kept], all_pairs.b[kept])
    ways = [Way(f"snk{count}", lbp_features, "relief", (f"snk{count}",)) for count in SCALES]
    trials = compare_pairs(pairs, partial(_reliefs, scratch), ways, scratch / "scores", jobs)
    return Table(pairs, tuple(trial.labelled(f"n = {trial.case[3:]}") for trial in trials), ())


def _keep_reliefs(population: Path, scratch: Path, name: str) -> None:
    kept_images(_file(scratch, name), lambda: relief_images(read_capture(population / name)))


def _reliefs(scratch: Path, name: str) -> FingerImages | None:
    return read_images(_file(scratch, name))


def _file(scratch: Path, name: str) -> Path:
    return scratch / "reliefs" / (name.replace("/", "_") + ".npz")
