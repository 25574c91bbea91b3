"""The thesis's matcher for many pairs gives what the plain one gives."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from splitknit.matching.features import LbpSettings, lbp_features
from splitknit.matching.thesis import (
    ATTRIBUTES,
    FingerImages,
    ThesisSettings,
    _features_of,
    _quick_lbp_features,
    database_finger,
    finger_features,
    match_database,
    thesis_match,
)

NAMES = ["relief", *(f"{kind}normal_{axis}" for kind in ("", "shape_") for axis in "xyz")]


def finger(seed: int, rows: int, columns: int) -> FingerImages:
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[:rows, :columns]
    mask = ((row - rows) / rows) ** 2 + ((column - columns / 2) / (columns / 2)) ** 2 < 1
    mask = mask[np.flatnonzero(mask.any(1))][:, np.flatnonzero(mask.any(0))]
    noise = [cv2.GaussianBlur(rng.standard_normal(mask.shape).astype(np.float32), (0, 0), 2) for _ in NAMES]
    return FingerImages({k: np.where(mask, v, np.float32(0)) for k, v in zip(NAMES, noise, strict=True)}, mask, 30.3)


@pytest.mark.parametrize(
    "settings",
    [
        ThesisSettings(gate=0.0, attributes=tuple(ATTRIBUTES)),
        ThesisSettings(gate=0.0, lbp=LbpSettings(radius_px=4.3, uniform=False, normalisation="l1")),
        ThesisSettings(gate=0.0, lbp=LbpSettings(radius_px=2.5, normalisation="none", interpolation="nearest")),
        ThesisSettings(gate=0.0, feature="hog"),
        ThesisSettings(gate=0.99),
    ],
)
def test_scores_are_those_of_the_plain_matcher(settings: ThesisSettings) -> None:
    a, b = finger(1, 310, 217), finger(2, 333, 201)
    plain = thesis_match(a, b, settings, finger_features(a, settings))
    assert match_database(database_finger(a, settings), b, settings) == plain
    assert plain.compared == (settings.gate < 0.9)


def test_features_are_those_of_the_plain_extractor() -> None:
    image = finger(4, 300, 190).channels["relief"]
    for radius, uniform in ((1.0, True), (5.0, False)):
        lbp = LbpSettings(radius_px=radius, uniform=uniform)
        np.testing.assert_array_equal(_quick_lbp_features(image, 75.7, lbp), lbp_features(image, 75.7, lbp))


def test_a_missing_channel_is_named() -> None:
    from splitknit.errors import BadInput

    whole = finger(1, 200, 150)
    part = FingerImages({"relief": whole.channels["relief"]}, whole.mask, whole.px_per_mm)
    with pytest.raises(BadInput, match="normal_x"):
        _features_of(part, ThesisSettings())
    with pytest.raises(BadInput, match="px/mm"):
        match_database(
            database_finger(whole, ThesisSettings()), FingerImages(part.channels, part.mask, 60.0), ThesisSettings()
        )
