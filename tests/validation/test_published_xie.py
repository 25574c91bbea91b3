"""Xie's system on a simulated finger, beside `ea`; and its model against differences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.io.capture import write_capture
from splitknit.io.results import read_result
from splitknit.pipeline import reconstruct
from splitknit_simulator.twin import simulate_capture


@pytest.mark.slow
def test_a_folder_in_a_result_out(tmp_path: Path) -> None:
    capture, _ = simulate_capture(1, settings={"scale": 0.08, "render.workers": 1})
    write_capture(capture, tmp_path / "capture")
    with scripts_of(VALIDATION / "published") as script:
        assert script("xie").main([str(tmp_path / "capture"), "--out", str(tmp_path / "out")]) == 0
    refracted, plain = read_result(tmp_path / "out"), reconstruct(capture, "ea")
    assert np.array_equal(refracted.mask, plain.mask)
    tilt, flat = (
        np.degrees(np.arccos(result.normals[..., 2][plain.mask])).mean()
        for result in (refracted, plain)
    )
    assert 0.5 < flat - tilt < 4  # Fresnel's law makes slopes smaller


def test_derivatives_are_those_of_the_model() -> None:
    rng = np.random.default_rng(1)
    mu, view, between = (
        rng.uniform(0.3, 0.9, (4, 6)),
        rng.uniform(0.5, 1.0, 6),
        rng.uniform(0.6, 0.9, (4, 1)),
    )
    layers = tuple(rng.uniform(low, high, 6) for low, high in ((0.3, 0.6), (0.7, 0.95), (2.0, 6.0)))
    with scripts_of(VALIDATION / "published") as script:
        model = script("xie").reflected
        at = model(mu, view, between, layers, 2.0)
        step = 1e-6
        moved = [
            (model(mu + step, view, between, layers, 2.0) - at)[0] / step,
            (model(mu, view + step, between, layers, 2.0) - at)[0] / step,
            *(
                (
                    model(mu, view, between, (*layers[:k], layers[k] + step, *layers[k + 1 :]), 2.0)
                    - at
                )[0]
                / step
                for k in range(3)
            ),
        ]
    np.testing.assert_allclose(np.stack(moved), at[1:], rtol=1e-3, atol=1e-5)
