"""Both readings of the thesis's "normals": of the integrated surface, and as photometric stereo
measured them.

The text does not say which. Those of the surface are in the store; here the measured ones are
compared by the same local binary patterns, alignment and score, on the same comparisons.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from compared import Way, compare_pairs, each, kept_images, read_images
from numpy.typing import NDArray
from trials import Captures, Pairs, StoreLike, Table, Trial, read_table

from splitknit import __version__
from splitknit.io.capture import read_capture
from splitknit.io.provenance import settings_hash
from splitknit.pipeline import reconstruct
from splitknit.presets import preset_settings
from splitknit.reconstruction import surface_of
from splitknit_match.matching.features import lbp_features
from splitknit_match.matching.surface import surface_images
from splitknit_match.matching.thesis import NORMALS, FingerImages

MEASURED_AS: Mapping[str, str] = {"snk": "pr", "pr": "pr", "ea": "ea"}
"""Case, and the case that measures the same normals: `snk` and `pr` differ after photometric stereo
only."""
FIELDS = {
    case: tuple(f"{case}_{name}" for name in NORMALS)
    for case in dict.fromkeys(MEASURED_AS.values())
}


def normals_table(store: StoreLike, captures: Captures, options: argparse.Namespace) -> Table:
    """Trials of each case and reading on the comparisons that the store has of all cases.

    `options`: of ``run.py``; ``fraction`` of the impostor pairs is compared, and finished captures
    and comparisons are kept in ``scratch``.
    """
    table = read_table(store, captures, tuple(MEASURED_AS), ("thesis",))
    every, finger = table.pairs, captures.finger
    kept = every.genuine | drawn(finger[every.a], finger[every.b], options.fraction, options.seed)
    pairs = Pairs(captures, every.a[kept], every.b[kept])
    origin = [preset_settings(case) for case in FIELDS] + [__version__, str(options.population)]
    place = options.scratch / "normals" / settings_hash(origin)[:12]
    each(partial(_keep, options.population, place), captures.names.tolist(), options.jobs)
    ways = [Way(case, lbp_features, "measured normals", names) for case, names in FIELDS.items()]
    measured = {
        trial.case: trial
        for trial in compare_pairs(
            pairs, partial(_read, place), ways, place / "scores", options.jobs
        )
    }
    trials: list[Trial] = []
    for case, like in MEASURED_AS.items():
        of_surface = table.trial(case, "thesis", "normals")
        if of_surface is not None:
            trials += [
                of_surface.at(kept).labelled(f"{case}, of the surface"),
                replace(measured[like], case=case).labelled(f"{case}, measured"),
            ]
    return Table(pairs, tuple(trials), table.missing)


def drawn(
    finger_a: NDArray[np.str_], finger_b: NDArray[np.str_], fraction: float, seed: int
) -> NDArray[np.bool_]:
    """(N,) a fraction of the pairs of fingers, the same whatever else is compared."""

    def chosen(a: str, b: str) -> bool:
        digest = hashlib.sha256(f"{seed}:{a}:{b}".encode()).digest()
        return int.from_bytes(digest[:8], "big") < fraction * 2.0**64

    return np.array(
        [chosen(a, b) for a, b in zip(finger_a.tolist(), finger_b.tolist(), strict=True)],
        dtype=np.bool_,
    )


def _keep(population: Path, place: Path, name: str) -> None:
    def images() -> FingerImages:
        capture = read_capture(population / name)
        channels = {}
        for case, fields in FIELDS.items():
            result = reconstruct(capture, case)
            assert result.normals_measured is not None  # the thesis's cases measure normals
            images = surface_images(replace(surface_of(result), normals=result.normals_measured))
            channels |= {
                field: images.channels[name] for field, name in zip(fields, NORMALS, strict=True)
            }
        return replace(images, channels=channels)  # both cases find the same mask

    kept_images(_file(place, name), images)


@lru_cache(maxsize=48)
def _read(place: Path, name: str) -> FingerImages | None:
    return read_images(_file(place, name))


def _file(place: Path, name: str) -> Path:
    return place / "images" / (name.replace("/", "_") + ".npz")
