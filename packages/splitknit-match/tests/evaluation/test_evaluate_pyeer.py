"""The same scores through pyeer 0.5.6, an established package.

pyeer pulls matplotlib in, so it is not even a dependency of the tests: its figures on these scores are written down
here, and computed anew where it can be imported (``pip install --no-deps pyeer==0.5.6``).

Two of its definitions differ from ours. GAR at FAR: it takes the threshold whose FMR is *nearest* to the target, we the
largest FAR not above it; the same where the target is reached exactly, as in ``real``. AUC: its curve ends at the
highest score, so that the last piece, above which nobody is accepted, is missing where that score is an impostor's.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.special import ndtri

from splitknit_match.evaluation.rates import auc, d_prime, equal_error, gar_at_far

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
    "apart": {"eer": 0.0, "auc": 1.0, "d_prime": 40.001721721401466, "gar@0": 1.0, "gar@0.001": 1.0, "gar@0.01": 1.0},
}
"""By pyeer."""


def shared(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Genuine and impostor scores without a random generator: the same in every version of everything."""

    def normal(count: int, start: float) -> np.ndarray:
        return ndtri(np.mod(start + GOLDEN * np.arange(1, count + 1), 1.0))

    if name == "real":  # no ties
        return np.round(2.4 + 1.1 * normal(1500, 0.1), 9), np.round(normal(10_000, 0.7), 9)
    if name == "whole":  # like bozorth3: whole numbers, many ties
        return np.floor(np.exp(3.1 + 0.8 * normal(280, 0.3))), np.floor(np.exp(1.7 + 0.5 * normal(3619, 0.2)))
    return 40 + normal(200, 0.5), normal(2000, 0.5)  # no overlap


def pyeer_figures(genuine: np.ndarray, impostor: np.ndarray) -> dict[str, float]:
    """What pyeer makes of them."""
    stats = pytest.importorskip("pyeer.eer_stats")
    _, fmr, fnmr = stats.calculate_roc(genuine, impostor)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        eer = stats.get_eer_values(fmr, fnmr)[3]
        area = stats.calculate_roc_auc(fmr, fnmr)
    figures = {"eer": eer, "auc": area + fmr[-1] * (1 - fnmr[-1]) / 2}
    figures["d_prime"] = stats.get_decidability_value(
        np.mean(genuine), np.std(genuine), np.mean(impostor), np.std(impostor)
    )
    for target in (0.0, 0.001, 0.01):
        figures[f"gar@{target:g}"] = 1 - stats.get_fmr_op(fmr, fnmr, target)[1]
    return {key: float(value) for key, value in figures.items()}


def ours(genuine: np.ndarray, impostor: np.ndarray) -> dict[str, float]:
    """The same figures by this package."""
    figures = {"eer": equal_error(genuine, impostor).value, "auc": auc(genuine, impostor)}
    figures["d_prime"] = d_prime(genuine, impostor) or 0.0
    for target in (0.0, 0.001, 0.01):
        figures[f"gar@{target:g}"] = gar_at_far(genuine, impostor, target or 1e-9).gar
    return figures


@pytest.mark.parametrize("name", list(RECORDED))
def test_our_figures_are_pyeers(name: str) -> None:
    found = ours(*shared(name))
    for key, value in RECORDED[name].items():
        assert found[key] == pytest.approx(value, rel=1e-9), key


@pytest.mark.parametrize("name", ["real", "whole", "apart"])
def test_pyeer_itself_where_it_is_installed(name: str) -> None:
    theirs, found = pyeer_figures(*shared(name)), ours(*shared(name))
    for key, value in theirs.items():
        if name == "whole" and key == "gar@0.001":
            continue  # ties: the nearest FMR lies above the target
        assert found[key] == pytest.approx(value, rel=1e-9), key
