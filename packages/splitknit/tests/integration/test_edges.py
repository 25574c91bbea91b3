"""Differences and their adjoint."""

from __future__ import annotations

import numpy as np

from splitknit.integration.poisson import _difference, _difference_adjoint, _edge_weights, _predicted_differences


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


def test_cubic_rule_integrates_a_cubic_slope_exactly_where_four_pixels_are_in_line():
    x = np.arange(9.0) / 4
    slope = np.tile(1 + x - 2 * x**2 + x**3, (2, 1)).astype(np.float32)
    antiderivative = 4 * (x + x**2 / 2 - 2 * x**3 / 3 + x**4 / 4)
    mask = np.ones((2, 9), dtype=bool)
    mask[1, 4] = False
    right, _ = _predicted_differences(slope, 0 * slope, mask, None, "cubic")
    mean, _ = _predicted_differences(slope, 0 * slope, mask, None, "trapezoidal")
    exact = np.diff(antiderivative)
    assert np.allclose(right[0, 1:7], exact[1:7], atol=1e-5)
    assert np.abs(mean[0, :8] - exact).max() > 1e-3
    assert np.array_equal(right[0, [0, 7]], mean[0, [0, 7]])
    assert right[1, 2] == mean[1, 2]
    assert right[1, 1] == right[0, 1]
