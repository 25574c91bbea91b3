"""Surfaces as bytes: nothing is lost, and damage is noticed."""

from __future__ import annotations

import struct
import tracemalloc
from dataclasses import fields, replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.model import Surface
from splitknit_match.batch.surfaces import pack_surface, unpack_surface


def surface() -> tuple[Surface, np.ndarray]:
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


def assert_equal(actual: Surface, expected: Surface) -> None:
    for field in fields(Surface):
        np.testing.assert_array_equal(
            getattr(actual, field.name), getattr(expected, field.name), err_msg=field.name
        )


def test_surfaces_come_back_to_the_last_bit() -> None:
    kept, height = surface()
    payload = pack_surface(kept, height)
    assert_equal(unpack_surface(payload), kept)
    assert len(payload) < 12.5 * kept.mask.sum() + 600


def test_relief_and_normals_of_their_own_come_back_too() -> None:
    # normals of a perspective camera, and a relief that is not the surface minus the shape
    kept, height = surface()
    turned = np.where(kept.mask[..., None], kept.normals[..., ::-1], 0).astype(np.float32)
    of_its_own = replace(
        kept, normals=turned, ridge_mm=(kept.ridge_mm * np.float32(1.7)).astype(np.float32)
    )
    for whole in (False, True):
        packed = replace(of_its_own, whole=whole)
        assert_equal(unpack_surface(pack_surface(packed, height)), packed)
        assert unpack_surface(pack_surface(replace(kept, whole=whole), height)).whole == whole


@pytest.mark.parametrize(
    "change", [lambda p: p[:50], lambda p: p[:-1], lambda p: p + b"\0", lambda p: b"XXXX" + p[4:]]
)
def test_damage_is_noticed(change) -> None:
    with pytest.raises(BadInput, match="damaged"):
        unpack_surface(change(pack_surface(*surface())))


@pytest.mark.parametrize(
    ("place", "layout", "values"),
    [
        (4, "<II", (32_000, 32_000)),  # rows and columns: 2^30 pixels
        (4, "<II", (6400, 6400)),
        (20, "<II", (60_000, 60_000)),  # of the box
        (28, "<I", (7,)),  # whether normals are stored
        (32, "<d", (float("nan"),)),  # pitch
        (32, "<d", (0.0,)),
        (40, "<d", (float("inf"),)),  # matrix
        (112, "<II", (60_000, 60_000)),  # of the upright frame
    ],
)
def test_a_head_that_claims_too_much_is_refused_before_memory_is_taken(
    place, layout, values
) -> None:
    payload = bytearray(pack_surface(*surface()))
    struct.pack_into(layout, payload, place, *values)
    tracemalloc.start()
    with pytest.raises(BadInput, match="damaged"):
        unpack_surface(bytes(payload))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000


def test_heights_that_are_no_numbers_are_refused() -> None:
    kept, height = surface()
    payload = bytearray(pack_surface(kept, height))
    count = int(kept.mask.sum())
    payload[-12 * count + 3 * count] = 0x7F  # the highest byte of the first height
    payload[-12 * count + 2 * count] = 0x80
    with pytest.raises(BadInput, match="damaged"):
        unpack_surface(bytes(payload))
