import numpy as np
import pytest

from refusals import bad_input
from splitknit.finger.ridge_period import ridge_period, scale_of_ridges


def normals_of(slope_x, slope_y):
    normals = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1).astype(np.float32)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


@pytest.mark.parametrize("period", [6.0, 13.0, 27.0])
@pytest.mark.parametrize("tilt", [0.0, 0.6])
def test_the_period_is_measured_along_the_skin(period, tilt):
    rows, columns = np.mgrid[:600, :600]
    across = columns * np.cos(0.4) + rows * np.sin(0.4)
    wave = 0.15 * np.cos(2 * np.pi * across / period)
    normals = normals_of(tilt + wave * np.cos(0.4), -wave * np.sin(0.4))
    expected = period * np.sqrt(1 + (tilt * np.cos(0.4)) ** 2)
    assert ridge_period(normals, np.ones((600, 600), bool)).period_px == pytest.approx(
        expected, rel=0.03
    )


def test_a_surface_without_ridges_gives_no_scale():
    noise = np.random.default_rng(1).normal(0, 0.2, (2, 300, 300))
    with bad_input("no ridges were found"):
        scale_of_ridges(normals_of(*noise), np.ones((300, 300), bool), None, 0.45)


def test_few_blocks_give_the_same_period():
    columns = np.tile(np.arange(500.0), (500, 1))
    normals = normals_of(0.15 * np.cos(2 * np.pi * columns / 9.0), 0 * columns)
    few, all_of_them = (ridge_period(normals, np.ones((500, 500), bool), step) for step in (32, 16))
    assert few.period_px == pytest.approx(all_of_them.period_px, rel=1e-3)
    assert 3 * few.blocks < all_of_them.blocks
