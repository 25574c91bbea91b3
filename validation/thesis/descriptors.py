"""Whether local binary patterns are the best descriptor, as section 5.2 says: HOG, Gabor energies, shape contexts.

The features are those of ``thesis.feature``; alignment, gate and score (5.2) are the same for all.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from compared import Extract, Read, Way, captures_of, compare_pairs, drawn
from numpy.typing import NDArray
from trials import Pairs, Table

from splitknit_match.evaluation.protocol import comparisons
from splitknit_match.matching.features import gabor_features, hog_features, lbp_features, shape_context_features
from splitknit_match.matching.thesis import ATTRIBUTES

DESCRIPTORS: Mapping[str, Extract] = {
    "lbp": lbp_features,
    "hog": hog_features,
    "gabor": gabor_features,
    "shape context": shape_context_features,
}
MATCHED = ("normals", "relief")


def descriptors_table(  # noqa: PLR0917
    names: list[str], read: Read, scratch: Path, fraction: float, seed: int, jobs: int
) -> tuple[Table, NDArray[np.bool_]]:
    """Trials of all features on all comparisons of captures, and (N,) which of them are compared without the gate, too.

    Parameters
    ----------
    names : of captures (``S01/session_1/right_index``)
    read : images of a capture
    scratch : folder of finished comparisons, of these images alone
    fraction : of the impostor pairs, that are compared even if they do not pass the gate
    seed : which of them
    jobs : processes
    """
    captures = captures_of(names)
    every = comparisons(captures.finger.tolist(), captures.session.tolist())
    pairs = Pairs(captures, every.a, every.b)
    ungated = pairs.genuine | drawn(captures.finger[every.a], captures.finger[every.b], fraction, seed)
    ways = [Way(name, extract, of, ATTRIBUTES[of]) for of in MATCHED for name, extract in DESCRIPTORS.items()]
    return Table(pairs, compare_pairs(pairs, read, ways, scratch, jobs, ungated), ()), ungated
