from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.imaging.view import view_of
from splitknit.integration.knit import KnitSettings, add, crossover, place, unevenness
from splitknit.integration.poisson import poisson
from splitknit.model import Camera


def waves(shape, period):
    """Mirror-symmetric along columns: whole half-waves between the borders."""
    rows, columns = np.mgrid[0 : shape[0], 0 : shape[1]]
    return np.cos(2 * np.pi * (columns + 0.5) / period) + 0 * rows


def keep_fine(omega):
    return (omega > 2 * np.pi / 20).astype(float)


def test_addition_is_the_sum_inside_the_mask():
    rng = np.random.default_rng(0)
    ridge, shape = rng.normal(size=(2, 6, 7))
    mask = np.zeros((6, 7), dtype=bool)
    mask[1:4, 2:6] = True
    knitted = add(ridge, shape, mask)
    assert knitted.dtype == np.float32
    assert_allclose(knitted[mask], (ridge + shape)[mask], rtol=1e-6)
    assert np.isnan(knitted[~mask]).all()
    assert_allclose(add(ridge, shape), ridge + shape, rtol=1e-5, atol=1e-6)


def test_crossover_takes_fine_from_one_and_coarse_from_the_other():
    size = (32, 80)
    fine_1, coarse_1 = waves(size, 8.0), 3.0 * waves(size, 80.0)
    fine_2, coarse_2 = 0.2 * waves(size, 8.0), 2.0 * waves(size, 80.0) + 5.0
    knitted = crossover(fine_1 + coarse_1 - 7.0, fine_2 + coarse_2, keep_fine)
    assert_allclose(knitted, fine_1 + coarse_2, atol=1e-5)


@pytest.mark.parametrize("gain", [0.0, 0.3, 1.0])
def test_what_both_surfaces_agree_on_is_kept_whatever_the_response(gain):
    """Each frequency counts once, with a mask too, where addition would count it twice."""
    rng = np.random.default_rng(1)
    surface = rng.normal(size=(24, 31)).cumsum(axis=0)
    mask = np.hypot(*(np.mgrid[0:24, 0:31] - np.array([[[12]], [[15]]]))) < 10
    knitted = crossover(surface + 4.0, surface, lambda omega: np.full(omega.shape, gain), mask)
    assert_allclose(knitted[mask], surface[mask], atol=1e-5)
    assert np.isnan(knitted[~mask]).all()


def test_response_is_asked_for_radians_per_pixel():
    asked = []

    def response(omega):
        asked.append(omega)
        return np.zeros(omega.shape)

    crossover(np.ones((8, 10)), np.zeros((8, 10)), response)
    assert asked[0].min() == 0.0
    assert asked[0].max() == pytest.approx(np.pi * np.hypot(7 / 8, 9 / 10))


def test_values_outside_the_mask_do_not_matter():
    rng = np.random.default_rng(2)
    visible, shape = rng.normal(size=(2, 16, 16))
    mask = np.zeros((16, 16), dtype=bool)
    mask[3:12, 4:14] = True
    dirty = np.where(mask, visible, np.nan)
    assert_array_equal(
        crossover(visible, shape, keep_fine, mask), crossover(dirty, shape, keep_fine, mask)
    )


LENS = Camera(
    10.0, (72, 96), 20.0, "perspective", np.array([[200.0, 0, 47.5], [0, 200.0, 35.5], [0, 0, 1]])
)
"""A wide view, so that what the rays change shows."""
WINDOW = slice(10, 61), slice(20, 91)


def tilted_plane():
    """Points (h, w, 3) that `LENS` sees in `WINDOW`, their normal, a mask, and the heights (h, w)
    that integrating the slopes along its rays gives on a regular grid."""
    view = view_of(LENS, *WINDOW, along_rays=True)
    x, y = view.on_plane()
    rise = 0.2 * x - 0.3 * y
    z = (1 + rise) / (1 + rise / LENS.height_mm)
    nearer = 1 - z / LENS.height_mm
    normal = np.array([-0.2, 0.3, 1.0], np.float32) / np.sqrt(1.13)
    own = view.turned(np.broadcast_to(normal[:, None, None], (1, 3, *z.shape)))[0]
    mask = np.ones(z.shape, dtype=bool)
    mask[:5, 40:] = False
    plain = LENS.pitch_mm * np.nan_to_num(poisson(-own[0] / own[2], -own[1] / own[2], mask))
    return np.dstack([x * nearer, y * nearer, z]), normal, mask, plain.astype(np.float32)


def test_unevenness_is_what_a_regular_grid_misses_along_the_rays():
    points, _, mask, plain = tilted_plane()
    missing = view_of(LENS, *WINDOW, along_rays=True).along(points[..., 2]) - plain
    left = (missing - unevenness(plain, mask, LENS, WINDOW))[mask]
    assert np.ptp(missing[mask]) > 0.03
    assert np.ptp(left) < 5e-3
    assert left.std() < 3e-4


def test_a_plane_along_the_rays_is_placed_at_its_points():
    points, normal, mask, plain = tilted_plane()
    top = float(np.quantile(points[mask, 2], 0.998))
    z, below, normals, x, y = place(plain, plain, mask, LENS, WINDOW, top)
    assert np.abs(np.dstack([x, y, z]) - points)[mask].max() < 4e-3
    assert np.array_equal(z, below)
    assert (normals @ normal)[mask].min() > np.cos(np.deg2rad(0.6))
    assert (normals @ normal)[9:-4, 4:-4].min() > np.cos(np.deg2rad(0.06))  # off the outline
    assert np.array_equal(normals.any(axis=-1), mask)


def test_relief_is_added_along_the_rays():
    _, _, mask, plain = tilted_plane()
    z, below, *_ = place(plain + np.float32(0.1), plain, mask, LENS, WINDOW, 3.0)
    assert np.abs((20 - z) / (20 - below) - np.exp(-0.1 / 20))[mask].max() < 1e-6


def test_parallel_rays_leave_heights_in_place():
    rows, columns = np.mgrid[:12.0, :15.0]
    mask = np.hypot(rows - 6, columns - 7) < 5
    height = np.where(mask, 0.03 * columns - 0.02 * rows, 9.0)
    window = slice(0, 12), slice(0, 15)
    z, below, normals, x, y = place(height, 0 * height, mask, Camera(10.0, (12, 15)), window, 5.0)
    assert np.array_equal(z, height)
    assert not below.any()
    assert np.allclose(normals, mask[..., None] * np.array([-0.3, -0.2, 1]) / np.sqrt(1.13))
    assert x is None
    assert y is None


@pytest.mark.parametrize(
    ("lens", "size", "kept", "some"),
    [
        (LENS, (8, 7), 7, False),
        (LENS, (8, 8), 8, True),
        (LENS, (40, 40), 1, False),  # no coarse pixel within the mask
        (replace(LENS, px_per_mm=2.0), (4, 4), 4, True),  # a pixel of the image is one
    ],
)
def test_unevenness_needs_four_coarse_pixels(lens, size, kept, some):
    ramp = np.tile(np.arange(size[1], dtype=np.float32), (size[0], 1))
    uneven = unevenness(ramp, ramp < kept, lens, (slice(0, size[0]), slice(0, size[1])))
    assert uneven.shape == size
    assert uneven.any() == some


def test_what_is_refused():
    good = np.zeros((4, 5))
    for join in (add, partial(crossover, response=keep_fine)):
        with bad_input("the relief and the shape must have one shape"):
            join(good, np.zeros((5, 4)))
        with bad_input("the shape contains NaN"):
            join(good, np.full((4, 5), np.nan))
    with bad_input("mask is empty"):
        crossover(good, good, keep_fine, np.zeros((4, 5), dtype=bool))
    with bad_input(r"knit\.method"):
        KnitSettings(method="glue")
