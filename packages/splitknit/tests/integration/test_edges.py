"""Differences and their adjoint."""

from __future__ import annotations

import numpy as np

from splitknit.integration.poisson import _difference, _difference_adjoint, _edge_weights


def test_adjoint_passes_the_dot_test():
    rng = np.random.default_rng(0)
    height = rng.normal(size=(13, 17))
    right, down = rng.normal(size=(2, 13, 17))
    right[:, -1] = 0
    down[-1] = 0
    step_right, step_down = _difference(height)
    forward = np.sum(step_right * right) + np.sum(step_down * down)
    assert abs(forward - np.sum(height * _difference_adjoint(right, down))) < 1e-10


def test_edges_leave_the_mask_alone():
    mask = np.zeros((4, 5), dtype=bool)
    mask[1:3, 1:4] = True
    right, down = _edge_weights(mask, None)
    assert right.sum() == 4
    assert down.sum() == 3
    weights = np.full((4, 5), 0.5, dtype=np.float32)
    weights[1, 1] = 1
    right, _ = _edge_weights(mask, weights)
    assert right[1, 1] == 0.75
