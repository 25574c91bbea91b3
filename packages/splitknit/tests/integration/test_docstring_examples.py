"""The examples in the docstrings of normals and integrators run and say the truth."""

import doctest
import importlib

import pytest


@pytest.mark.parametrize(
    "module",
    [
        "integration.poisson",
        "integration.frankot_chellappa",
        "integration.shapelets",
        "photometric.lambertian",
    ],
)
def test_examples_run(module):
    result = doctest.testmod(importlib.import_module(f"splitknit.{module}"))
    assert result.attempted > 0
    assert result.failed == 0
