"""The thesis's matcher: alignment, gate, score."""

from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit_match.matching.thesis import ThesisSettings, thesis_match

NO_GATE = ThesisSettings(gate=0.0)


@pytest.mark.parametrize("index", [0, 3, 6])
def test_a_finger_is_most_similar_to_itself_moved(impressions, index):
    """By two pixels: this matcher needs poses that differ little."""
    impression = impressions[index]
    fields = ("normals", "ridge_mm", "mask")
    rolled = {name: np.roll(getattr(impression, name), 2, axis=1) for name in fields}
    moved = replace(impression, **rolled).images()
    similarities = {
        k: thesis_match(impressions[k].images(), moved, NO_GATE).similarity for k in (0, 3, 6)
    }
    genuine = similarities.pop(index)
    assert genuine > max(similarities.values())


def test_a_finger_equals_itself(impressions):
    finger = impressions[0].images()
    match = thesis_match(finger, finger)
    assert match.similarity == 1.0
    assert set(match.distances.values()) == {0.0}


def test_two_scales_are_refused(impressions):
    finger = impressions[0].images()
    with bad_input("px/mm"):
        thesis_match(finger, replace(finger, px_per_mm=75.7))
