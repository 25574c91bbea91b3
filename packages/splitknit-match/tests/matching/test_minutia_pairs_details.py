"""Pairs of minutiae against plain loops: cylinders, similarities, fits and alignments."""

import math
from dataclasses import replace

import numpy as np
import pytest

from splitknit_match.matching import minutia_pairs
from splitknit_match.matching.minutia_pairs import (
    Cylinders,
    Pairing,
    agreeing,
    drifted,
    minutia_cylinders,
    on_ridges,
    pair_minutiae,
)
from splitknit_match.matching.ridge_band import RidgeBand
from splitknit_match.records.minutiae_record import PPI, Minutiae

PITCH_MM = 0.1


def minutiae_at(places, size):
    """Minutiae at columns and rows, with directions in degrees."""
    x, y, direction = np.array(places).T
    count = len(places)
    return Minutiae(
        x.astype(np.int32),
        y.astype(np.int32),
        np.deg2rad(direction),
        np.ones(count, np.uint8),
        np.linspace(90, 10, count).astype(np.uint8),
        size,
    )


def constellation(seed, count=14):
    rng = np.random.default_rng(seed)
    return [
        (float(x), float(y), float(d))
        for x, y, d in rng.uniform((40, 40, 0), (260, 260, 360), (count, 3)).round()
    ]


@pytest.fixture(scope="module")
def cylinders():
    valid = np.ones((152, 152), bool)
    valid[:, :40] = False
    return minutia_cylinders(minutiae_at(constellation(1), (300, 300)), valid, PITCH_MM)


def test_places_are_as_a_camera_sees_them(cylinders):
    step = 25.4 / PPI
    for k, (x, y, direction) in enumerate(constellation(1)):
        assert cylinders.place[k].real == pytest.approx(-(x - 149.5) * step, abs=1e-6)
        assert cylinders.place[k].imag == pytest.approx(-(y - 149.5) * step, abs=1e-6)
        assert np.exp(1j * cylinders.turn[k]) == pytest.approx(
            np.exp(1j * (np.pi - np.deg2rad(direction)))
        )


def test_cylinders_are_sums_over_the_other_minutiae(cylinders):
    line = 2 * 3.556 / 8 * (np.arange(8) - 3.5)
    levels = (2 * np.pi / 6 * np.arange(6) + np.pi) % (2 * np.pi) - np.pi
    # 0.5 mm, and half a pixel, beyond the outermost pixels
    print_right_mm, left_mm = 8.1, -4.1
    for own in (0, 5, 9):
        number = 0
        for right in line:
            for up in line:
                if math.hypot(right, up) > 3.556:
                    continue
                turn = cylinders.turn[own]
                cell = cylinders.place[own] + (right + 1j * up) * np.exp(1j * turn)
                known = left_mm <= cell.real <= print_right_mm and abs(cell.imag) <= 8.1
                clear = min(
                    abs(cell.real - left_mm),
                    abs(cell.real - print_right_mm),
                    abs(abs(cell.imag) - 8.1),
                )
                for level in levels:
                    if clear > 1e-3:
                        total = 0.0
                        for k, place in enumerate(cylinders.place):
                            if k == own:
                                continue
                            off = abs(place - cell)
                            angle = (level - (cylinders.turn[k] - turn) + np.pi) % (2 * np.pi)
                            total += math.exp(-(off**2) / (2 * 0.474**2)) * math.exp(
                                -0.5 * ((angle - np.pi) / (2 * np.pi / 9)) ** 2
                            )
                        expected = known / (1 + math.exp(-17 * (total - 0.234)))
                        assert cylinders.value[own, number] == pytest.approx(expected, abs=1e-3)
                        assert cylinders.known[own, number] == known
                    number += 1
        assert number == minutia_pairs.CYLINDER == cylinders.value.shape[1]


def test_minutiae_agree_one_with_one():
    places = np.array([0, 1, 1.1, 5 + 2j])
    turns = np.array([0.1, 3.1, -3.1, 1.0])
    laid = np.array([0.2, 1.05 + 0.1j]), np.array([0.3, -3.1])
    count = agreeing(laid, (places, turns))
    expected = math.exp(-((0.2 / 0.4) ** 2) - (0.2 / 0.35) ** 2)
    expected += math.exp(-(0.05**2 + 0.1**2) / 0.16)
    assert count == pytest.approx(expected)
    assert agreeing((places[:0], turns[:0]), laid) == 0
    assert agreeing(laid, (places[:0], turns[:0])) == 0
    # two that are laid on one count once
    twice = np.array([0.2, 0.3]), np.array([0.1, 0.1])
    assert agreeing(twice, (places[:1], turns[:1])) == pytest.approx(math.exp(-0.25))


def laid(seed, angle_rad, shift, count=14):
    """Cylinders of a constellation, turned and moved in the camera's view."""
    valid = np.ones((152, 152), bool)
    cylinders = minutia_cylinders(minutiae_at(constellation(seed), (300, 300)), valid, PITCH_MM)
    return Cylinders(
        cylinders.place[:count] * np.exp(1j * angle_rad) + shift,
        cylinders.turn[:count] + angle_rad,
        cylinders.value[:count],
        cylinders.known[:count],
    )


def test_two_alignments_are_proposed_the_better_one_first():
    """Half of the minutiae moved one way, fewer another way."""
    a = laid(1, 0, 0)
    first, second = laid(1, 0.4, 1 + 1j), laid(1, 2.0, -3)
    part = np.arange(14) < 9
    b = Cylinders(
        np.where(part, first.place, second.place),
        np.where(part, first.turn, second.turn),
        a.value,
        a.known,
    )
    pairings = pair_minutiae(a, b)
    assert len(pairings) == 2
    assert pairings[0].angle_rad == pytest.approx(0.4, abs=0.02)
    assert pairings[1].angle_rad == pytest.approx(2.0, abs=0.02)
    assert pairings[0].support > pairings[1].support > 3


def test_minutiae_drift_as_a_pulled_skin_slips():
    """Those of a skin that is shifted by 1.2 mm at one end find theirs; still ones stay."""
    place = laid(1, 0, 0).place
    turn = np.linspace(0, 6, 14)
    slip = 1.2 / (1 + np.exp(-place.imag / 1.5)) * np.exp(0.4j)
    (shift,) = drifted((place, turn), (place + slip, turn), [place + slip])
    residual = np.abs(shift @ [1, 1j] - slip)
    assert np.median(residual) < 0.2 < np.median(np.abs(slip))
    assert np.abs(drifted((place, turn), (place, turn), [place])[0]).max() < 0.02


@pytest.mark.parametrize(("count", "alignments"), [(1, 0), (2, 0), (3, 1)])
def test_an_alignment_takes_three_pairs(count, alignments):
    a, b = laid(1, 0, 0, count), laid(1, 0.2, 1, count)
    assert len(pair_minutiae(a, b)) == alignments


def test_dissimilar_cylinders_propose_nothing():
    a, b = laid(1, 0, 0), laid(1, 0, 0)
    unknown = Cylinders(b.place, b.turn, 0 * b.value, 0 * b.known)
    assert pair_minutiae(a, unknown) == []


def test_the_affine_map_of_a_pairing_is_that_of_its_places():
    a, b = (
        RidgeBand(np.zeros(s, np.float32), np.ones(s, bool), 0.1) for s in ((101, 81), (61, 41))
    )
    pairing = Pairing(0.4, 1.0 + 2.0j, 5.0)
    affine = pairing.affine(a, b)
    for place in (0.5 + 1j, -1.5 - 2j):
        moved = pairing.moved(np.array([place]))[0]
        column, row = affine @ [20 + 10 * moved.real, 30 - 10 * moved.imag, 1]
        assert (column, row) == pytest.approx((40 + 10 * place.real, 50 - 10 * place.imag))


def test_places_beyond_the_picture_are_not_on_ridges():
    valid = np.zeros((4, 5), bool)
    valid[3, 0] = valid[0, 4] = valid[1, 2] = True
    place = [(0.4, 3.4), (4.4, -0.4), (2, 1), (2.6, 1), (-0.6, 3), (0, 3.6), (5, 0), (4, -40)]
    assert on_ridges(valid, np.array(place)).tolist() == [True] * 3 + [False] * 5


def test_of_many_minutiae_the_best_hundred_are_compared():
    rng = np.random.default_rng(1)
    places = [(float(x), float(y), 0.0) for x, y in rng.integers(20, 280, (130, 2))]
    minutiae = minutiae_at(places, (300, 300))
    quality = np.full(130, 50, np.uint8)
    quality[120:] = 60
    quality[5] = 40
    minutiae = replace(minutiae, quality=quality)
    cylinders = minutia_cylinders(minutiae, np.ones((152, 152), bool), PITCH_MM)
    kept = [k for k in range(91) if k != 5] + list(range(120, 130))
    x = np.array(places)[kept, 0]
    np.testing.assert_allclose(cylinders.place.real, -(x - 149.5) * 0.0508)
