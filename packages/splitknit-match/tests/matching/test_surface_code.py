"""Finger surface codes: zones and bits, and the distance over shifts and turns."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_match.matching.surface_code import (
    _MIN_OVERLAP,
    CODINGS,
    GRAY,
    PreparedSurface,
    SurfaceCode,
    SurfaceCodeSettings,
    SurfaceMatchSettings,
    _packed_planes,
    make_surface_code,
    pack_surface_code,
    surface_code_match,
    unpack_surface_code,
)

PITCH = 0.1
ALL = SurfaceCodeSettings(least_area_mm2=0.0)


def skin(
    seed: int, shape: tuple[int, int] = (180, 120), turn_deg: float = 0.0, shift: tuple[int, int] = (0, 0)
) -> SurfaceCode:
    """Code of an invented finger: a warped wave in an ellipse, turned about its middle and shifted (rows, columns)."""
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.normal(size=(300, 300)).astype(np.float32), (0, 0), 14.0)
    row, column = np.mgrid[:300, :300].astype(np.float32)
    wave = np.sin(2 * np.pi * (0.22 * (column * 0.6 + row * 0.8) + 40 * noise)).astype(np.float32)
    index = 0.5 + 0.3 * wave
    turn = cv2.getRotationMatrix2D((149.5, 149.5), turn_deg, 1.0)  # counter-clockwise as seen
    turn[:, 2] += shift[1] + (shape[1] - 300) / 2, shift[0] + (shape[0] - 300) / 2
    moved = cv2.warpAffine(index, turn, shape[::-1], flags=cv2.INTER_LINEAR)
    row, column = np.mgrid[: shape[0], : shape[1]]
    mask = ((row - shape[0] / 2) / (0.46 * shape[0])) ** 2 + ((column - shape[1] / 2) / (0.46 * shape[1])) ** 2 < 1
    return make_surface_code(moved, mask, ALL)


def test_zones() -> None:
    """Nine surface types around 0, 1/8, ..., 1, and a Gray code that goes from one to the next by one bit."""
    index = np.linspace(0, 1, 1601, dtype=np.float32)[None]
    code = make_surface_code(index, np.ones_like(index, bool), ALL).code[0]
    borders = np.flatnonzero(np.diff(code.astype(int)))
    np.testing.assert_allclose(index[0, borders], (np.arange(8) + 0.5) / 8, atol=0.001)
    assert [int(code[round(200 * k)]) for k in range(9)] == GRAY.tolist()
    assert np.bitwise_count(GRAY[1:] ^ GRAY[:-1]).tolist() == [1] * 8
    plain = make_surface_code(index, np.ones_like(index, bool), SurfaceCodeSettings(coding="binary", least_area_mm2=0))
    assert sorted(set(plain.code[0].tolist())) == list(range(9)) == CODINGS["binary"].tolist()


def test_what_is_not_known_has_no_code() -> None:
    index = np.full((40, 40), 0.75, dtype=np.float32)
    index[:5] = np.nan
    mask = np.ones((40, 40), bool)
    mask[:, :3] = False
    made = make_surface_code(index, mask, ALL)
    assert made.area_mm2 == pytest.approx(35 * 37 * 0.01)
    assert not made.code[~made.mask].any()
    assert make_surface_code(index, mask).empty  # below 30 mm2
    assert not made.empty


def test_a_finger_is_itself_and_no_other() -> None:
    same = surface_code_match(skin(1), skin(1))
    other = surface_code_match(skin(1), skin(2))
    assert (same.similarity, same.distance, same.rotation_deg) == (1.0, 0.0, 0.0)
    assert same.overlap_mm2 == pytest.approx(skin(1).area_mm2)
    assert same.compared
    assert other.compared
    assert other.similarity < 0.75


@pytest.mark.parametrize(("turn_deg", "shift"), [(0.0, (14, -9)), (6.0, (0, 0)), (-7.5, (-12, 8))])
def test_shifts_and_turns_are_found(turn_deg: float, shift: tuple[int, int]) -> None:
    found = surface_code_match(skin(3), skin(3, turn_deg=turn_deg, shift=shift))
    assert found.rotation_deg == pytest.approx(turn_deg, abs=0.8)
    assert found.similarity > 0.85
    assert surface_code_match(skin(4), skin(3, turn_deg=turn_deg)).similarity < 0.75


def test_order_does_not_matter() -> None:
    one, two = skin(5), skin(5, turn_deg=4.0, shift=(5, 3))
    there, back = surface_code_match(one, two), surface_code_match(two, one)
    assert (there.similarity, there.overlap_mm2) == (back.similarity, back.overlap_mm2)
    assert there.rotation_deg == -back.rotation_deg != 0
    assert surface_code_match(one, two) == there == surface_code_match(PreparedSurface(one), PreparedSurface(two))


@pytest.mark.parametrize("shift", [(0, 0), (6, -5), (-9, 3)])
def test_distance_as_a_slow_loop_counts_it(shift: tuple[int, int]) -> None:
    """Without turns to speak of: the least fraction of unequal bits over all shifts with enough overlap."""
    rng = np.random.default_rng(0)
    one, moved = skin(6, (61, 71)), skin(6, (61, 71), shift=shift)
    two = SurfaceCode(
        np.where(moved.mask, moved.code ^ (rng.random(moved.code.shape) < 0.1), 0).astype(np.uint8), moved.mask, PITCH
    )
    settings = SurfaceMatchSettings(turn_deg=0.0, turn_step_deg=0.5, shift_mm=1.4, side_shift_mm=1.4, coarse_mm=0.1)
    found = surface_code_match(one, two, settings)
    least = _MIN_OVERLAP * min(one.area_mm2, two.area_mm2)
    slow = 1.0
    for rows in range(-15, 16):
        for columns in range(-15, 16):
            a, b = _overlapping(one, rows, columns), _overlapping(two, -rows, -columns)
            common = a.mask & b.mask
            if common.sum() * PITCH**2 >= least:
                slow = min(slow, int(np.bitwise_count(a.code ^ b.code)[common].sum()) / (4 * int(common.sum())))
    assert found.distance == pytest.approx(slow, abs=1e-12)


def _overlapping(side: SurfaceCode, rows: int, columns: int) -> SurfaceCode:
    """What of a side lies on the other one if this one is moved by so much."""
    cut = tuple(slice(max(-d, 0), size - max(d, 0)) for d, size in zip((rows, columns), side.code.shape, strict=True))
    return SurfaceCode(side.code[cut], side.mask[cut], side.pitch_mm)


def test_other_sizes_and_what_lies_outside() -> None:
    """A part of a finger is found in the whole; nothing outside a mask plays a part."""
    whole = skin(7)
    part = SurfaceCode(whole.code[30:150], whole.mask[30:150], PITCH)
    found = surface_code_match(part, whole)
    assert found.similarity > 0.99
    assert found.overlap_mm2 == pytest.approx(part.area_mm2, rel=0.02)
    wide = [np.pad(field, ((10, 10), (20, 20))) for field in (whole.code, whole.mask)]
    assert surface_code_match(SurfaceCode(*wide, PITCH), whole).distance == 0.0


def test_failures_to_acquire_and_too_little_overlap() -> None:
    empty = unpack_surface_code(b"")
    assert empty.empty
    for sides in ((empty, skin(1)), (skin(1), empty), (empty, empty)):
        found = surface_code_match(*sides)
        assert (found.compared, found.similarity) == (False, 0.0)
    low = np.zeros((180, 120), bool)
    low[:20] = True
    apart = [SurfaceCode(np.where(mask, skin(1).code, 0).astype(np.uint8), mask, PITCH) for mask in (low, low[::-1])]
    assert not surface_code_match(*apart).compared


def test_bits_are_packed_by_words() -> None:
    one = skin(8, (20, 70))
    planes, mask = _packed_planes(one.code, one.mask)
    assert planes.shape == (4, 20, 2)
    assert int(np.bitwise_count(mask).sum()) == int(one.mask.sum())
    for plane in range(4):
        assert int(np.bitwise_count(planes[plane]).sum()) == int(((one.code >> plane) & 1).sum())


def test_packed_codes_are_read_again() -> None:
    one = skin(9, (41, 33))
    data = pack_surface_code(one)
    back = unpack_surface_code(data)
    assert (back.pitch_mm, back.code.tolist(), back.mask.tolist()) == (0.1, one.code.tolist(), one.mask.tolist())
    assert len(data) == 16 + 5 * ((41 * 33 + 7) // 8)
    damaged = bytearray(data)
    damaged[60] ^= 1
    for wrong in (b"SKMI" + data[4:], data[:-1], bytes(damaged), data[:4] + b"\x09" + data[5:], b"x"):
        with pytest.raises(BadInput, match=r"make them from the surface again\.$"):
            unpack_surface_code(wrong)


def test_what_cannot_be_compared_is_refused() -> None:
    one = skin(1)
    with pytest.raises(BadInput, match=r"pitches of 0\.1 and 0\.2 mm"):
        surface_code_match(one, SurfaceCode(one.code, one.mask, 0.2))
    with pytest.raises(BadInput, match="different settings"):
        surface_code_match(PreparedSurface(one, SurfaceMatchSettings(turn_deg=3.0)), PreparedSurface(one))
    with pytest.raises(BadInput, match="coding"):
        SurfaceCodeSettings(coding="morse")
    with pytest.raises(BadInput, match="uint8"):
        SurfaceCode(one.code.astype(np.int64), one.mask, PITCH)
