"""Whether local binary patterns are the best descriptor, as section 5.2 says: HOG, Gabor energies,
shape contexts.

Alignment, gate and score (5.2) are the same for all.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

from compared import Extract, Way

sys.path.append(str(Path(__file__).resolve().parents[1] / "published"))
from image_features import gabor_features, hog_features, shape_context_features

from splitknit_match.matching.features import lbp_features
from splitknit_match.matching.thesis import ATTRIBUTES

DESCRIPTORS: Mapping[str, Extract] = {
    "lbp": lbp_features,
    "hog": hog_features,
    "gabor": gabor_features,
    "shape context": shape_context_features,
}
MATCHED = ("normals", "relief")
WAYS = [
    Way(name, extract, of, ATTRIBUTES[of])
    for of in MATCHED
    for name, extract in DESCRIPTORS.items()
]
