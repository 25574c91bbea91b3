"""Figure 3.21: the relief of case SnK with n = 2 to 7 scales of shapelets, compared by the thesis's matcher.

Only the last step differs between the six, so that images are enhanced and separated once for each capture:
:func:`snk_images` lets all n share what comes before. It gives the same relief as
``splitknit reconstruct --preset snk --set shapelets.scales=n`` (tests/validation/test_thesis_experiments.py).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from compared import Read, Way, captures_of, compare_pairs, drawn, each, kept_images, read_images
from trials import Pairs, Table

from splitknit import __version__
from splitknit.io.capture import read_capture
from splitknit.io.provenance import settings_hash
from splitknit.model import Capture, surface_of
from splitknit.pipeline import reconstruct
from splitknit.presets import preset_settings
from splitknit.steps import Memory
from splitknit_match.evaluation.protocol import comparisons
from splitknit_match.matching.features import lbp_features
from splitknit_match.matching.surface import surface_images
from splitknit_match.matching.thesis import ATTRIBUTES, FingerImages

SCALES = (2, 3, 4, 5, 6, 7)
SESSIONS = ("1", "2")
"""The thesis: "170 fingers recorded over 2 sessions"."""


def snk_images(capture: Capture, scales: Sequence[int] = SCALES) -> FingerImages:
    """Normals and relief of one capture by case SnK, and a relief ``snk2`` ... for each number of scales.

    Raises
    ------
    BadInput
        If it shows no finger.
    """
    memory = Memory(capture)  # all share what comes before the shapelets
    found = surface_images(surface_of(reconstruct(capture, "snk", memory=memory)))
    channels = {name: found.channels[name] for name in (*ATTRIBUTES["normals"], "relief")}
    for count in scales:
        # as snk up to the relief, without its near-infrared shape
        result = reconstruct(capture, "pr-split", {"shapelets.scales": count}, memory=memory)
        channels[f"snk{count}"] = surface_images(surface_of(result)).channels["relief"]
    return replace(found, channels=channels)


def keep_all(population: Path, names: Iterable[str], scratch: Path, jobs: int) -> tuple[Read, Path]:
    """Keep the images of captures in `scratch`, a folder of this population alone; return what reads them, and where.

    Captures of :data:`SESSIONS` have the reliefs of all numbers of scales.
    """
    settings = [preset_settings("snk"), preset_settings("pr-split"), SCALES, __version__]
    place = scratch / settings_hash(settings)[:12]
    each(partial(_keep, population, place), list(names), jobs)
    return partial(_read, place), place


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
    captures = captures_of([name for name in names if _session(name) in SESSIONS])
    read, place = keep_all(population, captures.names.tolist(), scratch, jobs)
    all_pairs = comparisons(captures.finger.tolist(), captures.session.tolist())
    kept = all_pairs.genuine | drawn(captures.finger[all_pairs.a], captures.finger[all_pairs.b], fraction, seed)
    pairs = Pairs(captures, all_pairs.a[kept], all_pairs.b[kept])
    ways = [Way(f"snk{count}", lbp_features, "relief", (f"snk{count}",)) for count in SCALES]
    trials = compare_pairs(pairs, read, ways, place / "scales", jobs)
    return Table(pairs, tuple(trial.labelled(f"n = {trial.case[3:]}") for trial in trials), ())


def _keep(population: Path, place: Path, name: str) -> None:
    scales = SCALES if _session(name) in SESSIONS else ()
    kept_images(_file(place, name), lambda: snk_images(read_capture(population / name), scales))


def _read(place: Path, name: str) -> FingerImages | None:
    return read_images(_file(place, name))


def _session(name: str) -> str:
    return name.split("/")[1].removeprefix("session_")


def _file(place: Path, name: str) -> Path:
    return place / (name.replace("/", "_") + ".npz")
