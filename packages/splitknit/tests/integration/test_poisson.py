"""Masked Poisson: exact where the truth is in its reach, equal to a direct solver everywhere
else."""

import cv2
import numpy as np
import pytest

from direct_integration import solved
from refusals import bad_input
from splitknit.integration.poisson import poisson


def paraboloid(rows, columns):
    """Heights and y-up gradients of a tilted bowl: trapezoidal differences of its slopes are
    exact."""
    i, j = np.mgrid[0:rows, 0:columns].astype(float)
    x, y = (j - 0.4 * columns) / 10, (0.6 * rows - i) / 10
    height = 3 * x + 2 * y - 0.5 * x**2 + 0.25 * y**2 + 0.3 * x * y
    return height, (3 - x + 0.3 * y) / 10, (2 + 0.5 * y + 0.3 * x) / 10


def reference(slope_x, slope_y, mask, weights=None):
    """The same least squares by a sparse direct solver, the mean of each part zero."""
    weights = np.ones(mask.shape) if weights is None else weights
    height = np.full(mask.shape, np.nan)
    height[mask] = solved((slope_x, slope_y), weights, mask)[0]
    _, parts = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    for part in np.unique(parts[mask]):
        height[parts == part] -= height[parts == part].mean()
    return height


def masks():
    rows, columns = 70, 90
    i, j = np.mgrid[0:rows, 0:columns]
    radius, angle = np.hypot(i - 35, j - 45), np.arctan2(i - 35, j - 45)
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.normal(size=(rows, columns)), (0, 0), 3)
    return {
        "disk": radius < 30,
        "cut by the border": np.hypot(i - 69, j - 45) < 40,
        "holes": (radius < 33) & (np.hypot(i - 30, j - 50) > 6) & (np.hypot(i - 45, j - 30) > 4),
        "parts": noise > 0,
        "spiral": ((radius - angle * 12 / (2 * np.pi)) % 12 < 6) & (radius < 34),
        "comb": (j % 7 < 5) | (i < 4),
        "stripes": j % 2 == 0,
        "line": i == 20,
        "crack": (j != 45) | (i < 3),
    }


@pytest.mark.parametrize("name", list(masks()))
@pytest.mark.parametrize("weighted", [False, True])
def test_equals_a_direct_solver_on_any_mask(name, weighted):
    mask = masks()[name]
    rng = np.random.default_rng(1)
    slope_x, slope_y = rng.normal(size=(2, *mask.shape)).astype(np.float32)
    weights = None
    if weighted:
        weights = (0.05 + 0.95 * rng.random(mask.shape)).astype(np.float32)
    got = poisson(slope_x, slope_y, mask, weights)
    expected = reference(slope_x, slope_y, mask, weights)
    assert np.array_equal(np.isnan(got), ~mask)
    scale = np.sqrt(np.mean(expected[mask] ** 2))
    assert np.sqrt(np.mean((got - expected)[mask] ** 2)) < 2e-3 * scale


def test_rectangle_and_masked_solver_agree():
    rng = np.random.default_rng(2)
    slope_x, slope_y = rng.normal(size=(2, 45, 66))
    direct = poisson(slope_x, slope_y)
    iterated = poisson(slope_x, slope_y, weights=np.ones((45, 66)))
    assert np.abs(direct - iterated).max() < 1e-4


def test_parts_that_touch_at_a_corner_have_zero_mean_each():
    mask = np.kron(np.eye(2), np.ones((8, 8))) > 0
    height = poisson(np.where(np.arange(16) < 8, 1.0, 3.0) * mask, 0.0 * mask, mask)
    assert abs(height[:8, :8].mean()) < 1e-6
    assert abs(height[8:, 8:].mean()) < 1e-6
    assert height.dtype == np.float32


@pytest.mark.parametrize("weights", [None, np.full((5, 5), 0.5)])
def test_pixels_without_neighbours_have_height_zero(weights):
    mask = np.zeros((5, 5), dtype=bool)
    mask[1, 1] = mask[3, 3] = True
    height = poisson(np.ones((5, 5)), np.ones((5, 5)), mask, weights)
    assert (height[mask] == 0).all()
    assert np.isnan(height[~mask]).all()


def test_values_outside_the_mask_do_not_matter():
    mask = masks()["disk"]
    _, slope_x, slope_y = paraboloid(*mask.shape)
    clean = poisson(slope_x, slope_y, mask)
    slope_x[~mask], slope_y[~mask] = np.nan, 1e9
    assert np.array_equal(poisson(slope_x, slope_y, mask), clean, equal_nan=True)


def test_a_single_untrusted_pixel_takes_its_neighbours_slopes():
    i, j = np.mgrid[:9, :9]
    slopes, weights = np.stack([0.5 + 0.0 * i, 0.25 + 0.0 * i]), np.ones((9, 9))
    slopes[:, 4, 5], weights[4, 5] = 50.0, 0.0
    error = poisson(*slopes, weights=weights) - (0.5 * j - 0.25 * i)
    assert np.ptp(error) < 1e-5


def test_a_long_weighted_strip_has_its_whole_height():
    """The direct solver's ground would take part of it, were the solution not refined."""
    strip = np.ones((2, 1000))
    height = poisson(strip, 0 * strip, weights=0.01 * strip)
    assert height[0, -1] - height[0, 0] == pytest.approx(999, rel=1e-5)


def test_no_bowl_and_no_border_artefact_on_a_finger():
    i, j = np.mgrid[0:191, 0:117].astype(float)
    u, v = (j - 58) / 55, (190 - i) / 181
    mask = u**2 + v**2 < 0.9
    dome = np.sqrt(np.clip(1 - u**2 - v**2, 1e-3, None))
    got = poisson(-37.5 * u / 55 / dome, -37.5 * v / 181 / dome, mask)
    error = got - 37.5 * dome
    assert np.std(error[mask]) < 0.02


@pytest.mark.parametrize("name", ["comb", "stripes", "spiral"])
def test_strands_that_coarse_pixels_would_weld_converge_at_once(name, monkeypatch):
    monkeypatch.setattr("splitknit.integration.poisson._MAX_ITERATIONS", 8)
    mask = masks()[name]
    slope_x, slope_y = np.random.default_rng(7).normal(size=(2, *mask.shape)).astype(np.float32)
    got = poisson(slope_x, slope_y, mask)
    expected = reference(slope_x, slope_y, mask)
    assert np.std((got - expected)[mask]) < 1e-3 * np.std(expected[mask])


@pytest.mark.parametrize("name", ["disk", "holes"])
def test_weighted_iteration_converges_as_fast_as_on_large_surfaces(name, monkeypatch, caplog):
    """In four iterations, without the factorisation that small surfaces have."""
    for limit, value in (
        ("_MOST_FACTORISED", 1000),
        ("_MOST_DIRECT", 0),
        ("_ROUNDS", 1),
        ("_MAX_ITERATIONS", 4),
    ):
        monkeypatch.setattr(f"splitknit.integration.poisson.{limit}", value)
    mask, rng = masks()[name], np.random.default_rng(1)
    slope_x, slope_y = rng.normal(size=(2, *mask.shape)).astype(np.float32)
    weights = (0.05 + 0.95 * rng.random(mask.shape)).astype(np.float32)
    expected = reference(slope_x, slope_y, mask, weights)
    got = poisson(slope_x, slope_y, mask, weights)
    assert np.std((got - expected)[mask]) < 1e-5 * np.std(expected[mask])
    assert not caplog.records


@pytest.mark.parametrize(("direct", "warned"), [(100_000, False), (0, True)])
def test_iteration_that_does_not_converge_is_factorised_or_warns(
    direct, warned, monkeypatch, caplog
):
    """One iteration does not suffice; more unknowns than `_MOST_DIRECT` are not factorised."""
    limits = {"_MOST_FACTORISED": 100, "_MOST_DIRECT": direct, "_MAX_ITERATIONS": 1, "_ROUNDS": 2}
    for limit, value in limits.items():
        monkeypatch.setattr(f"splitknit.integration.poisson.{limit}", value)
    mask, rng = masks()["holes"], np.random.default_rng(1)
    slope_x, slope_y = rng.normal(size=(2, *mask.shape)).astype(np.float32)
    weights = (0.05 + 0.95 * rng.random(mask.shape)).astype(np.float32)
    expected = reference(slope_x, slope_y, mask, weights)
    error = (poisson(slope_x, slope_y, mask, weights) - expected)[mask]
    assert (np.std(error) < 1e-5 * np.std(expected[mask])) != warned
    assert ("has not converged" in caplog.text) == warned


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gradient_y": np.zeros((4, 5))}, "gradient_x and gradient_y must have one shape"),
        ({"gradient_x": np.zeros(4)}, r"\(H, W\)"),
        ({"gradient_x": np.full((4, 4), np.nan)}, "inside the mask"),
        ({"mask": np.zeros((4, 4), dtype=bool)}, "empty"),
        ({"weights": np.full((4, 4), 2.0)}, "between 0 and 1"),
        ({"weights": np.ones((3, 4))}, "weights must have the shape"),
    ],
)
def test_bad_input_is_refused(change, message):
    arguments = {"gradient_x": np.zeros((4, 4)), "gradient_y": np.zeros((4, 4)), **change}
    with bad_input(message):
        poisson(**arguments)
