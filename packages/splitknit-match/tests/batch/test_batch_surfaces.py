"""Surfaces in files: nothing is lost, and damage is noticed."""

from dataclasses import fields, replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.io.npz import read_npz, write_npz
from splitknit.reconstruction import Surface
from splitknit_match.batch.store import read_surface, write_surface


def surface():
    rng = np.random.default_rng(5)
    row, column = np.mgrid[:60, :50]
    mask = np.hypot(row - 31, column - 24) < 20
    mask[40:44, 20:30] = False
    shape = np.where(mask, 3 - 0.002 * (row - 30) ** 2 - 0.004 * (column - 24) ** 2, np.nan).astype(
        np.float32
    )
    ridge = np.where(mask, 0.02 * rng.standard_normal(mask.shape), np.nan).astype(np.float32)
    height = shape + ridge
    normals = np.nan_to_num(
        normals_from_gradients(*height_gradients(height, 0.033)) * mask[..., None]
    )
    matrix = np.array([[0.9, 0.1, 3.5], [-0.1, 0.9, 1.25], [0, 0, 1]])
    return Surface(ridge, shape, normals, mask, 0.033, matrix, (70, 48)), height


def assert_equal(actual, expected):
    for field in fields(Surface):
        np.testing.assert_array_equal(
            getattr(actual, field.name), getattr(expected, field.name), err_msg=field.name
        )


def test_surfaces_come_back_to_the_last_bit(tmp_path):
    kept, height = surface()
    file = tmp_path / "surface.npz"
    write_surface(file, kept, height)
    assert_equal(read_surface(file), kept)
    assert file.stat().st_size < 12 * kept.mask.sum() + 2500


@pytest.mark.parametrize("whole", [False, True])
def test_relief_and_normals_of_their_own_come_back_too(whole, tmp_path):
    # normals of a perspective camera, and a relief that is not the surface minus the shape
    kept, height = surface()
    turned = np.where(kept.mask[..., None], kept.normals[..., ::-1], 0).astype(np.float32)
    ridge = (kept.ridge_mm * np.float32(1.7)).astype(np.float32)
    of_its_own = replace(kept, normals=turned, ridge_mm=ridge, whole=whole)
    write_surface(tmp_path / "surface.npz", of_its_own, height)
    assert_equal(read_surface(tmp_path / "surface.npz"), of_its_own)


@pytest.mark.parametrize("change", [lambda p: p[:50], lambda p: p[:-1], lambda p: b"XXXX" + p[4:]])
def test_damage_is_noticed(change, tmp_path):
    file = tmp_path / "surface.npz"
    write_surface(file, *surface())
    file.write_bytes(change(file.read_bytes()))
    with bad_input("damaged"):
        read_surface(file)


@pytest.mark.parametrize(
    "change", [{"height_mm": np.zeros(3)}, {"mask": np.ones(7, bool)}, {"upright_size": np.ones(3)}]
)
def test_arrays_that_do_not_fit_are_refused(change, tmp_path):
    file = tmp_path / "surface.npz"
    write_surface(file, *surface())
    write_npz(file, read_npz(file) | change)
    with bad_input("damaged"):
        read_surface(file)
