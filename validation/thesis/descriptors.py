"""Whether local binary patterns are the best descriptor, as section 5.2 says: HOG, Gabor energies, shape contexts.

The features are those of ``thesis.feature``; alignment, gate and score (5.2) are the same for all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from compared import Extract, Read, Way, compare_pairs, drawn
from trials import Captures, Pairs, StoreLike, Table, read_table

from splitknit_match.batch.reading import Place, images_of
from splitknit_match.matching.features import gabor_features, hog_features, shape_context_features
from splitknit_match.matching.thesis import ATTRIBUTES, FingerImages

OTHERS: Mapping[str, Extract] = {
    "hog": hog_features,
    "gabor": gabor_features,
    "shape context": shape_context_features,
}
MATCHED = ("normals", "relief")


def descriptors_table(  # noqa: PLR0917
    store: StoreLike,
    case: str,
    captures: Captures,
    read: Read,
    scratch: Path,
    fraction: float | None,
    seed: int,
    jobs: int,
) -> Table:
    """Trials of all features on the comparisons that the store has of a case by the thesis's matcher.

    Parameters
    ----------
    store : of the batch; its scores are those of local binary patterns
    case : how captures were reconstructed
    captures : all of the store
    read : images of a capture
    scratch : folder of finished comparisons, of this store and case alone
    fraction : of the store's impostor pairs; None: all, of which only those are compared that pass the gate
    seed : which of them
    jobs : processes
    """
    table = read_table(store, captures, (case,), ("thesis",))
    every, finger = table.pairs, captures.finger
    kept = np.ones(every.a.shape, dtype=np.bool_)
    if fraction is not None:
        kept = every.genuine | drawn(finger[every.a], finger[every.b], fraction, seed)
    pairs = Pairs(captures, every.a[kept], every.b[kept])
    patterns = [
        replace(trial.at(kept), case="lbp", label="lbp") for trial in table.trials if trial.attribute in MATCHED
    ]
    ways = [Way(name, extract, of, ATTRIBUTES[of]) for of in MATCHED for name, extract in OTHERS.items()]
    return Table(
        pairs, (*patterns, *compare_pairs(pairs, read, ways, scratch, jobs, gated=fraction is None)), table.missing
    )


def reader(places: Mapping[str, Place]) -> Read:
    """Images of the store's captures."""
    return partial(_images, tuple(sorted((name, place.file, place.row) for name, place in places.items())))


def _images(places: tuple[tuple[str, Path, int], ...], name: str) -> FingerImages | None:
    return _kept(_by_name(places)[name])


@lru_cache(maxsize=2)
def _by_name(places: tuple[tuple[str, Path, int], ...]) -> dict[str, Place]:
    return {name: Place(file, row) for name, file, row in places}


@lru_cache(maxsize=48)
def _kept(place: Place) -> FingerImages | None:
    """What is compared of a capture: 6 MB at 30 px/mm."""
    images = images_of(place)
    needed = [name for of in MATCHED for name in ATTRIBUTES[of]]
    return None if images is None else replace(images, channels={name: images.channels[name] for name in needed})
