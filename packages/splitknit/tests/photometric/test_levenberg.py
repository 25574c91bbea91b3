"""Many small least-squares problems at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.photometric.hanrahan_krueger_fit import (
    LevenbergSettings,
    _levenberg_marquardt,
    _NormalEquations,
    _solved,
)


@dataclass
class Valleys:
    """Rosenbrock's valley, each with a bottom of its own."""

    steepness: np.ndarray

    def equations(self, parameters):
        x, y = parameters
        residual = np.stack([self.steepness * (y - x * x), 1 - x])
        by_x = np.stack([-2 * self.steepness * x, -np.ones_like(x)])
        by_y = np.stack([self.steepness, np.zeros_like(x)])
        moments = np.stack([(a * b).sum(axis=0) for a, b in ((by_x, by_x), (by_x, by_y), (by_y, by_y))])
        gradient = np.stack([(by_x * residual).sum(axis=0), (by_y * residual).sum(axis=0)])
        return _NormalEquations((residual**2).sum(axis=0), gradient, moments)

    def moved(self, parameters, step):
        return parameters + step

    def take(self, kept):
        return Valleys(self.steepness[kept])


def test_every_problem_ends_in_its_own_valley():
    rng = np.random.default_rng(0)
    problem = Valleys(rng.uniform(1, 10, 200))
    start = rng.uniform(-2, 2, (2, 200))
    found = _levenberg_marquardt(problem, start, LevenbergSettings(iterations=200, step=1e-9, gain=1e-12))
    assert found.converged.all()
    assert np.abs(found.parameters - 1).max() < 1e-6
    assert len(np.unique(found.iterations)) > 5  # each left when it was done
    assert np.all(found.cost <= problem.equations(start).cost)


def test_a_problem_depends_on_nothing_but_itself():
    rng = np.random.default_rng(1)
    steepness, start = rng.uniform(1, 10, 50), rng.uniform(-2, 2, (2, 50))
    settings = LevenbergSettings(iterations=12)
    together = _levenberg_marquardt(Valleys(steepness), start, settings)
    for i in (0, 17, 49):
        alone = _levenberg_marquardt(Valleys(steepness[i : i + 1]), start[:, i : i + 1], settings)
        assert np.array_equal(alone.parameters[:, 0], together.parameters[:, i])
        assert alone.iterations[0] == together.iterations[i]


def test_too_few_steps_are_told():
    found = _levenberg_marquardt(Valleys(np.full(3, 10.0)), np.full((2, 3), -1.5), LevenbergSettings(iterations=2))
    assert not found.converged.any()
    assert (found.iterations == 2).all()
    assert np.all(found.cost < Valleys(np.full(3, 10.0)).equations(np.full((2, 3), -1.5)).cost)


@pytest.mark.parametrize("size", [1, 3, 5])
def test_solved_agrees_with_numpy(size):
    rng = np.random.default_rng(size)
    roots = rng.normal(size=(20, 8, size))
    matrix = np.einsum("nki,nkj->nij", roots, roots)
    vector, damping = rng.normal(size=(20, size)), rng.uniform(0, 2, 20)
    damped = matrix + damping[:, None, None] * matrix * np.eye(size)
    upper = np.stack([matrix[:, i, j] for i in range(size) for j in range(i, size)])
    wanted = np.linalg.solve(damped, vector[..., None])[..., 0]
    assert np.allclose(_solved(upper, vector.T, damping).T, wanted, rtol=1e-9)


@pytest.mark.parametrize("change", [{"iterations": 0}, {"step": 0.0}, {"gain": float("nan")}, {"gain": 1.0}])
def test_settings_that_make_no_sense_are_refused(change):
    with pytest.raises(BadInput, match=next(iter(change))):
        LevenbergSettings(**change)
