"""The same scores through pyeer 0.5.6, an established package.

Its figures on these scores are written down here.

Two of its definitions differ from ours. GAR at FAR: it takes the threshold whose FMR is *nearest*
to the target, we the largest FAR not above it; the same where the target is reached exactly, as in
``real``. AUC: its curve ends at the highest score, so that the last piece, above which nobody is
accepted, is missing where that score is an impostor's.
"""

import numpy as np
import pytest
from scipy.special import ndtri

from splitknit_match.evaluation.rates import roc

GOLDEN = (np.sqrt(5) - 1) / 2
RECORDED = {
    "real": {
        "eer": 0.12663333333333332,
        "auc": 0.9466815333333332,
        "d_prime": 2.2822053910130826,
        "gar@0": 0.1306666666666667,
        "gar@0.001": 0.2773333333333333,
        "gar@0.01": 0.5286666666666666,
    },
    "whole": {
        "eer": 0.1392028184581376,
        "auc": 0.9290051513835708,
        "d_prime": 1.2621650441258188,
        "gar@0": 0.2964285714285714,
        "gar@0.01": 0.6,
    },
    "apart": {
        "eer": 0.0,
        "auc": 1.0,
        "d_prime": 40.001721721401466,
        "gar@0": 1.0,
        "gar@0.001": 1.0,
        "gar@0.01": 1.0,
    },
}
"""By pyeer."""


def shared(name):
    """Genuine and impostor scores without a random generator: the same in every version of
    everything."""

    def normal(count, start):
        return ndtri(np.mod(start + GOLDEN * np.arange(1, count + 1), 1.0))

    if name == "real":  # no ties
        return np.round(2.4 + 1.1 * normal(1500, 0.1), 9), np.round(normal(10_000, 0.7), 9)
    if name == "whole":  # like bozorth3: whole numbers, many ties
        genuine, impostor = 3.1 + 0.8 * normal(280, 0.3), 1.7 + 0.5 * normal(3619, 0.2)
        return np.floor(np.exp(genuine)), np.floor(np.exp(impostor))
    return 40 + normal(200, 0.5), normal(2000, 0.5)  # no overlap


def ours(genuine, impostor):
    """The same figures by this package."""
    curve = roc(genuine, impostor)
    figures = {"eer": curve.equal_error().value, "auc": curve.auc(), "d_prime": curve.d_prime()}
    for target in (0.0, 0.001, 0.01):
        figures[f"gar@{target:g}"] = curve.at_far(target or 1e-9).gar
    return figures


@pytest.mark.parametrize("name", list(RECORDED))
def test_our_figures_are_pyeers(name):
    figures = ours(*shared(name))
    for key, value in RECORDED[name].items():
        assert figures[key] == pytest.approx(value, rel=1e-9), key
