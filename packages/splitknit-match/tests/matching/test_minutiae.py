"""Minutiae: extracted where they are, compared, packed and read again."""

import builtins
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from refusals import bad_input
from splitknit_match.matching.minutiae_match import minutiae_match
from splitknit_match.prints.minutiae import NFIQ2_FAILED, extract, nfiq2
from splitknit_match.records.minutiae_record import (
    Minutiae,
    no_minutiae,
    pack_minutiae,
    unpack_minutiae,
)
from splitknit_simulator.finger.master_print import MasterPrintSettings, ink_print, master_print

BORDER = 20
SMALL = MasterPrintSettings(half_width_mm=8.0, distal_mm=25.0, proximal_mm=1.0)
needs_nbis = pytest.mark.usefixtures("nbis")


@pytest.fixture(scope="module")
def nbis():
    return pytest.importorskip("nbis")


@pytest.fixture(scope="module")
def masters():
    return [
        master_print(pattern, seed, SMALL)
        for seed, pattern in enumerate(("whorl", "left_loop", "right_loop"), 41)
    ]


@pytest.fixture(scope="module")
def prints(masters):
    """Three fingers, and the first one once more, turned and shifted."""
    fingers = [np.pad(ink_print(master), BORDER, constant_values=255) for master in masters]
    turn = cv2.getRotationMatrix2D((170, 220), 12.0, 1.0)
    turn[:, 2] += 6.0, -9.0
    size = fingers[0].shape[::-1]
    again = cv2.warpAffine(fingers[0], turn, size, flags=cv2.INTER_CUBIC, borderValue=255)
    return [*fingers, again]


@pytest.fixture(scope="module")
def minutiae(nbis, prints):
    """Of each print."""
    return [extract(image) for image in prints]


def random_minutiae(count, seed=0, size=(380, 360)):
    rng = np.random.default_rng(seed)
    return Minutiae(
        rng.integers(0, size[1], count).astype(np.int32),
        rng.integers(0, size[0], count).astype(np.int32),
        rng.integers(0, 32, count) * np.pi / 16,
        rng.integers(1, 3, count).astype(np.uint8),
        rng.integers(0, 101, count).astype(np.uint8),
        size,
    )


def test_minutiae_lie_where_the_finger_has_them(masters, minutiae):
    """Places within a pixel on average, directions within a step of mindtct's (11.25 deg), against
    the truth."""
    step = 25.4 / 500
    errors_px, errors_deg = [], []
    for master, extracted in zip(masters, minutiae, strict=False):
        u, v, angle = master.minutiae.T
        x = (7.5 - u) / step - 0.5 + BORDER  # the print is mirrored
        y = (24.0 - v) / step - 0.5 + BORDER
        for k in range(extracted.count):
            right, down = extracted.x_px[k] - x, extracted.y_px[k] - y
            nearest = int(np.argmin(np.hypot(right, down)))
            if np.hypot(right, down)[nearest] > 8:
                continue
            errors_px.append((right[nearest], down[nearest]))
            turned = extracted.direction_rad[k] - (np.pi - angle[nearest])
            errors_deg.append(abs(np.rad2deg(np.angle(np.exp(1j * turned)))))
    assert len(errors_px) > 0.7 * sum(extracted.count for extracted in minutiae[:3])
    assert np.median(errors_deg) < 8
    assert np.percentile(errors_deg, 80) < 15
    assert (np.abs(np.mean(errors_px, axis=0)) < 1).all()


def test_minutiae_are_in_pixels_and_in_mm_from_the_middle(minutiae, prints):
    first = minutiae[0]
    assert first.acquired
    assert first.size == prints[0].shape
    assert set(first.type.tolist()) == {1, 2}
    assert first.direction_rad.min() >= 0
    assert first.direction_rad.max() < 2 * np.pi
    assert first.x_mm[first.x_px.argmin()] < 0 < first.y_mm[first.y_px.argmin()]
    assert first.x_mm == pytest.approx((first.x_px - (prints[0].shape[1] - 1) / 2) * 0.0508)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10_000),
    angle=st.floats(-np.pi, np.pi),
    shift=st.tuples(st.integers(-120, 120), st.integers(-120, 120)),
    missing=st.floats(0, 0.3),
)
def test_turned_shifted_and_missing_minutiae_are_recognised(seed, angle, shift, missing):
    """On both sides some are missing, and others are put in their place."""
    first = random_minutiae(45, seed)
    place = (first.x_px - 180 + 1j * (first.y_px - 190)) * np.exp(-1j * angle)
    rng = np.random.default_rng(seed)
    moved = replace(
        first,
        x_px=np.rint(place.real + 500 + shift[0]).astype(np.int32),
        y_px=np.rint(place.imag + 500 + shift[1]).astype(np.int32),
        direction_rad=(first.direction_rad + angle) % (2 * np.pi),
        size=(1000, 1000),
    )
    moved = moved.taken(rng.random(45) >= missing)
    fewer = first.taken(rng.random(45) >= missing)
    own = minutiae_match(fewer, moved)
    assert own == minutiae_match(moved, fewer)
    assert own > 2 > 1.8 > minutiae_match(fewer, random_minutiae(45, seed + 1))  # noqa: PLR0133


def test_two_prints_of_a_finger_score_higher_than_those_of_two_fingers(minutiae):
    impostors = ((0, 1), (0, 2), (1, 2), (1, 3), (2, 3))
    assert minutiae_match(minutiae[0], minutiae[3]) > 3
    assert max(minutiae_match(minutiae[i], minutiae[j]) for i, j in impostors) < 1.8


def test_the_order_of_minutiae_does_not_matter(minutiae):
    first, again = minutiae[0], minutiae[3]
    order = np.random.default_rng(0).permutation(first.count)
    assert minutiae_match(first.taken(order), again) == minutiae_match(first, again)


def test_of_too_many_minutiae_the_best_are_compared():
    """100 good ones and 50 bad ones among them: the bad ones change what a print shows at most."""
    good, bad = random_minutiae(100, 1), random_minutiae(50, 2)
    good = replace(good, quality=np.full(100, 80, np.uint8))
    names = ("x_px", "y_px", "direction_rad", "type")
    both = [np.concatenate([getattr(bad, name), getattr(good, name)]) for name in names]
    together = Minutiae(*both, np.repeat(np.array([10, 80], np.uint8), [50, 100]), good.size)
    for second in (random_minutiae(60, 3), good):
        assert minutiae_match(together, second) == pytest.approx(
            minutiae_match(good, second), rel=0.1
        )


def test_prints_of_1000_ppi_are_resampled(prints, minutiae):
    large = cv2.resize(prints[0], None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    fine = extract(large, 1000.0)
    assert fine.size == prints[0].shape
    assert minutiae_match(fine, minutiae[0]) > 4


@needs_nbis
@pytest.mark.parametrize("shape", [(1, 1), (8, 8), (63, 200), (90, 90), (300, 80)])
@pytest.mark.parametrize("content", ["white", "black", "noise"])
def test_images_without_a_print_are_failures_to_acquire(shape, content):
    image = {
        "white": np.full(shape, 255, np.uint8),
        "black": np.zeros(shape, np.uint8),
        "noise": np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8),
    }[content]
    minutiae = extract(image)
    assert minutiae.size == shape
    assert minutiae_match(minutiae, minutiae) == 0 or minutiae.acquired
    if content != "noise":
        assert not minutiae.acquired
        assert nfiq2(image) == NFIQ2_FAILED


def test_failures_to_acquire_score_0(minutiae):
    nothing = unpack_minutiae(b"")
    assert not nothing.acquired
    assert pack_minutiae(nothing) == b""
    assert minutiae_match(nothing, minutiae[0]) == 0
    assert minutiae_match(minutiae[0].taken(np.arange(9)), minutiae[0]) == 0


def test_equal_prints_are_of_equal_quality(prints):
    """Without the tests' own memory of earlier prints (match_fixtures.py)."""
    first, second = (nfiq2.__wrapped__(prints[0].copy()) for _ in range(2))
    assert first == second


def test_nfiq2_is_lower_for_a_spoilt_print(nbis, prints):
    noise = np.random.default_rng(1).normal(0, 90, prints[0].shape)
    spoilt = np.clip(cv2.GaussianBlur(prints[0], (0, 0), 2.5) + noise, 0, 255).astype(np.uint8)
    assert 0 <= nfiq2(spoilt) < nfiq2(prints[0]) <= 100


@pytest.mark.parametrize(
    ("image", "ppi", "words"),
    [
        (np.zeros((90, 90), np.float32), 500.0, "uint8"),
        (np.zeros((90, 90, 3), np.uint8), 500.0, "uint8"),
        (np.zeros((0, 90), np.uint8), 500.0, "uint8"),
        (np.zeros((90, 90), np.uint8), 20.0, "ppi must"),
        (np.zeros((90, 90), np.uint8), float("nan"), "ppi must"),
        (np.zeros((2000, 90), np.uint8), 100.0, "larger than a finger"),
    ],
)
def test_bad_prints_are_refused(image, ppi, words):
    with bad_input(words):
        extract(image, ppi)


def test_where_nbis_py_is_missing_one_sentence_says_so(monkeypatch):
    from splitknit_match.prints.minutiae import extractor

    real = builtins.__import__

    def refusing(name, *rest, **named):
        if name == "nbis":
            raise OSError("GLIBC_2.34 not found")
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", refusing)
    extractor.cache_clear()
    with bad_input(r"x86-64 Linux.*method ridge \(GLIBC_2.34 not found\)\.$"):
        extract(np.zeros((90, 90), np.uint8))
    extractor.cache_clear()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), count=st.integers(0, 300))
def test_packed_minutiae_come_back(seed, count):
    before = random_minutiae(count, seed)
    after = unpack_minutiae(pack_minutiae(before))
    for name in ("x_px", "y_px", "type", "quality"):
        assert np.array_equal(getattr(after, name), getattr(before, name))
    assert after.direction_rad == pytest.approx(before.direction_rad)
    assert after.size == (before.size if count else (0, 0))
    assert len(pack_minutiae(before)) == (17 + 7 * count if count else 0)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(place=st.integers(0, 1 << 20), change=st.integers(1, 255), cut=st.integers(0, 30))
def test_changed_or_cut_bytes_are_refused(place, change, cut):
    data = bytearray(pack_minutiae(random_minutiae(20)))
    where = place % len(data)
    data[where] ^= change
    if 6 <= where < 10:
        return  # the print's size: any is possible
    with bad_input("extract them from the print again"):
        unpack_minutiae(bytes(data[: len(data) - cut]))


def test_contradictory_minutiae_are_refused():
    three = random_minutiae(3)
    with bad_input("one length"):
        replace(three, x_px=three.x_px[:2])
    with bad_input("inside their print"):
        replace(three, x_px=three.x_px + 400)
    with bad_input("larger than"):
        no_minutiae((10_000, 10))
