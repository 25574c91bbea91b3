"""How alike two fingers are: the thesis's matcher, and a better one on ridge templates."""

from splitknit.matching.elastic import PatchSettings
from splitknit.matching.features import (
    LbpSettings,
    cell_histograms,
    gabor_features,
    hog_features,
    lbp_codes,
    lbp_features,
    shape_context_features,
)
from splitknit.matching.phase import PhaseSettings
from splitknit.matching.ridge import Prepared, RidgeMatch, RidgeMatchSettings, prepared, ridge_match
from splitknit.matching.ridge_band import RidgeBand, RidgeBandSettings, print_band, ridge_band
from splitknit.matching.score import (
    FmrTable,
    Logistic,
    calibrate_probability,
    calibrate_scores,
    dissimilarity,
    dissimilarity_of_gated,
    similarity_of,
)
from splitknit.matching.template import (
    VERSION,
    Template,
    TemplateSettings,
    failed_template,
    make_template,
    pack,
    unpack,
)
from splitknit.matching.thesis import (
    FingerImages,
    MaskAlignment,
    ThesisMatch,
    ThesisSettings,
    align_masks,
    finger_features,
    finger_images,
    intersection_over_union,
    thesis_match,
)

__all__ = [
    "VERSION",
    "FingerImages",
    "FmrTable",
    "LbpSettings",
    "Logistic",
    "MaskAlignment",
    "PatchSettings",
    "PhaseSettings",
    "Prepared",
    "RidgeBand",
    "RidgeBandSettings",
    "RidgeMatch",
    "RidgeMatchSettings",
    "Template",
    "TemplateSettings",
    "ThesisMatch",
    "ThesisSettings",
    "align_masks",
    "calibrate_probability",
    "calibrate_scores",
    "cell_histograms",
    "dissimilarity",
    "dissimilarity_of_gated",
    "failed_template",
    "finger_features",
    "finger_images",
    "gabor_features",
    "hog_features",
    "intersection_over_union",
    "lbp_codes",
    "lbp_features",
    "make_template",
    "pack",
    "prepared",
    "print_band",
    "ridge_band",
    "ridge_match",
    "shape_context_features",
    "similarity_of",
    "thesis_match",
    "unpack",
]
