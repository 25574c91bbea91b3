"""Scores and calibrations."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from splitknit_match.matching.score import calibrate_scores, dissimilarity


@given(ratio=st.floats(0.9, 1.0), near=st.floats(0.0, 100.0), further=st.floats(0.001, 100.0))
def test_higher_means_less_similar(ratio, near, further):
    assert 0.0 <= dissimilarity(ratio, [near]) <= dissimilarity(ratio, [near + further]) <= 1.0


def test_extrapolated_rates_are_upper_limits():
    """Scores with the assumed tail: the true rate beyond the threshold seldom exceeds the stated
    one."""
    rng, stated = np.random.default_rng(0), 1e-5
    tables = [calibrate_scores(rng.exponential(0.3, 5000)) for _ in range(200)]
    similarity, expected = np.transpose([table.beyond(stated) for table in tables])
    true = np.exp(-similarity / 0.3)
    assert np.mean(true > stated) < 0.05
    assert (expected < stated).all()
    nearer = tables[0].beyond(1e-4)
    assert nearer[0] < similarity[0]
    assert nearer[1] > expected[0]
