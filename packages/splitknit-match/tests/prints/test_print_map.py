"""Where a print's pixels come from, and that prints have the right size, side and spacing."""

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit.finger.ridges import ink, relief_print
from splitknit_match.prints.print_map import plane_map, resample, unrolled_map
from splitknit_match.prints.ridge_field import ridge_field
from splitknit_match.prints.unroll import unroll
from splitknit_simulator.finger.master_print import ink_print


@pytest.fixture(scope="module")
def laid(twin):
    return unrolled_map(unroll(twin.grid()), "free")


@pytest.fixture(scope="module")
def printed(twin, laid):
    return ink(*resample(twin.ridge_mm, twin.seen.mask, twin.seen.camera.pitch_mm, laid))


def test_a_print_of_the_plane_is_the_relief_print(twin):
    pitch = twin.seen.camera.pitch_mm
    flat = plane_map(pitch, *twin.frame)
    mapped = ink(*resample(twin.ridge_mm, twin.seen.mask, pitch, flat))
    relief = relief_print(twin.ridge_mm, twin.seen.mask, 1 / pitch, *twin.frame)
    assert mapped.shape == relief.shape
    inside = cv2.erode((relief < 255).astype(np.uint8), np.ones((25, 25))) > 0
    assert np.corrcoef(mapped[inside], relief[inside])[0, 1] > 0.99


@pytest.mark.parametrize("kind", ["plane", "free"])
@pytest.mark.parametrize("ppi", [500.0, 1000.0])
def test_points_come_back_from_the_print(twin, ppi, kind):
    rng = np.random.default_rng(4)
    rows, columns = np.nonzero(cv2.erode(twin.seen.mask.astype(np.uint8), np.ones((31, 31))))
    drawn = rng.integers(0, rows.size, 200)
    points = np.stack([columns[drawn], rows[drawn]], axis=1) + rng.uniform(-0.5, 0.5, (200, 2))
    if kind == "plane":
        print_map = plane_map(twin.seen.camera.pitch_mm, *twin.frame, ppi)
    else:
        print_map = unrolled_map(unroll(twin.grid()), kind, ppi)
    there = print_map.print_from_input(points)
    back = print_map.input_from_print(there)
    inside = np.isfinite(back).all(axis=1)
    assert inside.mean() > 0.9
    assert np.abs(back - points)[inside].max() < 0.02
    # the rows and columns stored for every pixel are the same map
    pixel = np.rint(there[inside]).astype(int)
    place = pixel[:, 1], pixel[:, 0]
    stored = np.stack([print_map.columns[place], print_map.rows[place]], axis=1)
    assert np.nanpercentile(np.abs(print_map.print_from_input(stored) - pixel), 99) < 0.1


def test_points_beside_the_finger_are_nan(laid):
    assert np.isnan(laid.input_from_print(np.array([[-5.0, 4.0], [0.0, 0.0]]))).all()
    assert np.isnan(laid.print_from_input(np.array([[-4000.0, 12.0], [np.nan, 3.0]]))).all()


def _best(part, whole):
    score = cv2.matchTemplate(np.float32(whole), np.float32(part), cv2.TM_CCOEFF_NORMED)
    _, best, _, place = cv2.minMaxLoc(score)
    return best, place


def test_side_size_and_polarity_are_those_of_ink(twin, laid, printed):
    """8 mm of the print match the finger's own ink print best as they are: not mirrored, turned,
    inverted or scaled."""
    ink_master = ink_print(twin.master)
    core = laid.print_from_input(np.atleast_2d(twin.seen.landmarks["cores_px"])[:1])[0]
    column, row = np.rint(core).astype(int)
    part = printed[row - 79 : row + 79, column - 79 : column + 79]
    right, place = _best(part, ink_master)
    assert right > 0.7
    for wrong in (part[:, ::-1], part[::-1], 255 - part):
        assert _best(wrong, ink_master)[0] < 0.5
    for factor in (0.96, 1.04):
        scaled = cv2.resize(part, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        assert _best(scaled, ink_master)[0] < right - 0.1
    there = ink_master[place[1] : place[1] + 158, place[0] : place[0] + 158]
    printed_field, true = (ridge_field(np.ascontiguousarray(image)) for image in (part, there))
    both = printed_field.mask & true.mask
    ratio = np.median(true.frequency_px[both] / printed_field.frequency_px[both])
    assert ratio == pytest.approx(1.0, abs=0.02)


def test_impossible_sizes_are_refused():
    with bad_input("ppi"):
        plane_map(0.1, np.eye(3), (10, 10), ppi=0)
    with bad_input("19685 x 19685 pixels, more than any finger"):  # else 20 GB
        plane_map(0.1, np.eye(3), (10_000, 10_000))


def test_flat_skin_is_refused(laid):
    flat = np.zeros(laid.columns.shape, np.float32)
    with bad_input("no ridges"):
        ink(flat, np.ones_like(flat))
    with bad_input("nothing of the finger"):
        ink(flat, flat)
