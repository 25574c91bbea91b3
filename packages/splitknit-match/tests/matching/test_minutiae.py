"""Minutiae: found where they are, compared as nbis-py compares, packed and read again."""

from __future__ import annotations

import builtins
import itertools

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splitknit.errors import BadInput
from splitknit_match.prints.minutiae import NFIQ2_FAILED, extract, minutiae_match, nfiq2
from splitknit_match.prints.minutiae_record import (
    Minutiae,
    no_minutiae,
    pack_minutiae,
    unpack_minutiae,
)
from splitknit_simulator.finger.master_print import (
    MasterPrint,
    MasterPrintSettings,
    ink_print,
    master_print,
)

BORDER = 20
SMALL = MasterPrintSettings(half_width_mm=8.0, distal_mm=25.0, proximal_mm=1.0)
needs_nbis = pytest.mark.usefixtures("nbis")


@pytest.fixture(scope="module")
def nbis():
    return pytest.importorskip("nbis")


@pytest.fixture(scope="module")
def masters() -> list[MasterPrint]:
    return [
        master_print(pattern, seed, SMALL)
        for seed, pattern in enumerate(("whorl", "left_loop", "right_loop"), 41)
    ]


@pytest.fixture(scope="module")
def prints(masters: list[MasterPrint]) -> list[np.ndarray]:
    """Three fingers, and the first one once more, turned and shifted."""
    found = [np.pad(ink_print(master), BORDER, constant_values=255) for master in masters]
    turn = cv2.getRotationMatrix2D((170, 220), 12.0, 1.0)
    turn[:, 2] += 6.0, -9.0
    again = cv2.warpAffine(
        found[0], turn, found[0].shape[::-1], flags=cv2.INTER_CUBIC, borderValue=255
    )
    return [*found, again]


@pytest.fixture(scope="module")
def found(nbis, prints: list[np.ndarray]) -> list[Minutiae]:
    return [extract(one) for one in prints]


def some(count: int, seed: int = 0, size: tuple[int, int] = (380, 360)) -> Minutiae:
    rng = np.random.default_rng(seed)
    return Minutiae(
        rng.integers(0, size[1], count).astype(np.int32),
        rng.integers(0, size[0], count).astype(np.int32),
        rng.integers(0, 32, count) * np.pi / 16,
        rng.integers(1, 3, count).astype(np.uint8),
        rng.integers(0, 101, count).astype(np.uint8),
        size,
    )


def test_minutiae_lie_where_the_finger_has_them(
    masters: list[MasterPrint], found: list[Minutiae]
) -> None:
    """Places within a pixel on average, directions within a step of mindtct's (11.25 deg), against
    the truth."""
    step = 25.4 / 500
    near, wrong, left, up = 0, [], [], []
    for master, minutiae in zip(masters, found, strict=False):
        u, v, angle = master.minutiae.T
        x = (7.5 - u) / step - 0.5 + BORDER  # the print is mirrored
        y = (24.0 - v) / step - 0.5 + BORDER
        for k in range(minutiae.count):
            apart = np.hypot(x - minutiae.x_px[k], y - minutiae.y_px[k])
            nearest = int(np.argmin(apart))
            if apart[nearest] > 8:
                continue
            near += 1
            left.append(minutiae.x_px[k] - x[nearest])
            up.append(minutiae.y_px[k] - y[nearest])
            turned = minutiae.direction_rad[k] - (np.pi - angle[nearest])
            wrong.append(abs(np.rad2deg(np.angle(np.exp(1j * turned)))))
    assert near > 0.7 * sum(one.count for one in found[:3])
    assert np.median(wrong) < 8
    assert np.percentile(wrong, 80) < 15
    assert abs(np.mean(left)) < 1
    assert abs(np.mean(up)) < 1


def test_what_a_print_holds(found: list[Minutiae], prints: list[np.ndarray]) -> None:
    first = found[0]
    assert first.acquired
    assert first.size == prints[0].shape
    assert set(first.type.tolist()) == {1, 2}
    assert first.direction_rad.min() >= 0
    assert first.direction_rad.max() < 2 * np.pi
    assert first.x_mm[first.x_px.argmin()] < 0 < first.y_mm[first.y_px.argmin()]
    assert first.x_mm == pytest.approx((first.x_px - (prints[0].shape[1] - 1) / 2) * 0.0508)


@pytest.mark.slow
def test_scores_are_those_of_nbis_py(nbis, prints: list[np.ndarray]) -> None:
    """With all that mindtct finds, also at the outline."""
    found = [extract(one, edge_mm=0.0) for one in prints]
    extractor = nbis.new_nbis_extractor(
        nbis.NbisExtractorSettings(
            min_quality=0.0,
            get_center=False,
            check_fingerprint=False,
            compute_nfiq2=False,
            ppi=500.0,
        )
    )
    theirs = [extractor.extract_minutiae(cv2.imencode(".png", one)[1].tobytes()) for one in prints]
    for i, j in itertools.product(range(len(prints)), repeat=2):
        score = theirs[i].compare(theirs[j])
        assert minutiae_match(found[i], found[j]) == score
        assert minutiae_match(found[j], found[i]) == score
        assert minutiae_match(unpack_minutiae(pack_minutiae(found[i])), found[j]) == score


def test_one_finger_is_told_from_others(found: list[Minutiae]) -> None:
    assert minutiae_match(found[0], found[3]) > 60
    assert (
        max(minutiae_match(found[i], found[j]) for i, j in ((0, 1), (0, 2), (1, 2), (1, 3), (2, 3)))
        < 40
    )


def test_the_order_of_minutiae_does_not_matter(found: list[Minutiae]) -> None:
    order = np.random.default_rng(0).permutation(found[0].count)
    assert minutiae_match(found[0].taken(order), found[3]) == minutiae_match(found[0], found[3])


@needs_nbis
def test_of_too_many_the_best_are_compared() -> None:
    """200 good ones and 50 bad ones among them: the bad ones change nothing."""
    good, bad = some(200, 1), some(50, 2)
    good = Minutiae(
        good.x_px, good.y_px, good.direction_rad, good.type, np.full(200, 80, np.uint8), good.size
    )
    names = ("x_px", "y_px", "direction_rad", "type")
    both = [np.concatenate([getattr(bad, name), getattr(good, name)]) for name in names]
    quality = np.repeat(np.array([10, 80], np.uint8), [50, 200])
    together = Minutiae(both[0], both[1], both[2], both[3], quality, good.size)
    other = some(60, 3)
    assert minutiae_match(together, other) == minutiae_match(good, other)
    assert minutiae_match(together, good) == minutiae_match(good, good)


def test_other_resolutions_are_resampled(prints: list[np.ndarray], found: list[Minutiae]) -> None:
    large = cv2.resize(prints[0], None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    fine = extract(large, 1000.0)
    assert fine.size == prints[0].shape
    assert minutiae_match(fine, found[0]) > 150


@needs_nbis
@pytest.mark.parametrize("shape", [(1, 1), (8, 8), (63, 200), (90, 90), (300, 80)])
@pytest.mark.parametrize("content", ["white", "black", "noise"])
def test_what_is_no_print_is_a_failure_to_acquire(shape: tuple[int, int], content: str) -> None:
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


def test_failures_to_acquire_are_accepted(found: list[Minutiae]) -> None:
    nothing = unpack_minutiae(b"")
    assert not nothing.acquired
    assert pack_minutiae(nothing) == b""
    assert minutiae_match(nothing, found[0]) == 0
    assert minutiae_match(found[0].taken(np.arange(9)), found[0]) == 0


def test_equal_prints_are_of_equal_quality(prints: list[np.ndarray]) -> None:
    """The tests' own memory of earlier prints aside (conftest.py)."""
    first, second = (nfiq2.__wrapped__(prints[0].copy()) for _ in range(2))
    assert first == second


def test_nfiq2_tells_good_from_bad(nbis, prints: list[np.ndarray]) -> None:
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
def test_bad_prints_are_refused(image: np.ndarray, ppi: float, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        extract(image, ppi)


def test_where_nbis_py_is_missing_one_sentence_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    from splitknit_match.prints import minutiae

    real = builtins.__import__

    def refusing(name, *rest, **named):
        if name == "nbis":
            raise OSError("GLIBC_2.34 not found")
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", refusing)
    minutiae._extractor.cache_clear()
    with pytest.raises(BadInput, match=r"x86-64 Linux.*method ridge\.$"):
        extract(np.zeros((90, 90), np.uint8))
    minutiae._extractor.cache_clear()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), count=st.integers(0, 300))
def test_packed_minutiae_come_back(seed: int, count: int) -> None:
    before = some(count, seed)
    after = unpack_minutiae(pack_minutiae(before))
    for name in ("x_px", "y_px", "type", "quality"):
        assert np.array_equal(getattr(after, name), getattr(before, name))
    assert after.direction_rad == pytest.approx(before.direction_rad)
    assert after.size == (before.size if count else (0, 0))
    assert len(pack_minutiae(before)) == (16 + 7 * count if count else 0)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(place=st.integers(0, 1 << 20), change=st.integers(1, 255), cut=st.integers(0, 30))
def test_damage_is_noticed(place: int, change: int, cut: int) -> None:
    data = bytearray(pack_minutiae(some(20)))
    where = place % len(data)
    data[where] ^= change
    if 6 <= where < 10:
        return  # the print's size: any is possible
    with pytest.raises(BadInput, match="extract them from the print again"):
        unpack_minutiae(bytes(data[: len(data) - cut]))


def test_contradictory_minutiae_are_refused() -> None:
    one = some(3)
    with pytest.raises(BadInput, match="one length"):
        Minutiae(one.x_px[:2], one.y_px, one.direction_rad, one.type, one.quality, one.size)
    with pytest.raises(BadInput, match="inside their print"):
        Minutiae(one.x_px + 400, one.y_px, one.direction_rad, one.type, one.quality, one.size)
    with pytest.raises(BadInput, match="larger than"):
        no_minutiae((10_000, 10))
