"""Minutiae in space compared by reference pairs and by tetrahedra: what must hold of both."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, permutations

import numpy as np
import pytest

from space_samples import again, finger, turned
from splitknit.errors import BadInput
from splitknit_match.matching.minutiae3d import (
    _ANGLE_DEG,
    _HEIGHT_MM,
    _LENGTH_MM,
    _PHI_DEG,
    _THETA_DEG,
    AgreementSettings,
    Minutiae3DSettings,
    PreparedMinutiae3D,
    PreparedTetrahedra,
    TetrahedraSettings,
    _agreeing,
    _Framed,
    _rigid_motion,
    minutiae3d_match,
    one_to_one,
    tetrahedra_match,
)
from splitknit_match.matching.minutiae_record import (
    SpaceMinutiae,
    no_space_minutiae,
    pack_space_minutiae,
    unpack_space_minutiae,
)

MATCHERS = [minutiae3d_match, tetrahedra_match]
both = pytest.mark.parametrize("match", MATCHERS)
Match = Callable


@both
def test_a_finger_is_itself(match: Match) -> None:
    found = match(finger(1), finger(1))
    assert found.compared
    assert found.agreeing == 60
    assert found.similarity == 1.0


@both
def test_one_finger_is_told_from_others(match: Match) -> None:
    same = [match(finger(k), turned(again(finger(k), k), k)).similarity for k in range(6)]
    other = [match(finger(k), turned(again(finger(k + 1), k), k)).similarity for k in range(6)]
    assert min(same) > 0.4
    assert max(other) < 0.15


@both
def test_how_a_finger_lies_does_not_matter(match: Match) -> None:
    one, two = finger(3), again(finger(3), 8)
    still = match(one, two)
    assert [match(turned(one, k), turned(two, k + 50)).agreeing for k in range(5)] == [still.agreeing] * 5


@both
def test_a_mirrored_finger_is_another(match: Match) -> None:
    one = finger(4)
    away = np.array([-1.0, 1.0, 1.0])
    theta = (np.pi - one.theta_rad) % (2 * np.pi)
    mirrored = SpaceMinutiae(one.position_mm * away, theta, one.phi_rad, one.type, one.quality)
    assert match(one, mirrored).similarity < 0.15


@both
def test_order_of_the_sides_and_of_the_minutiae(match: Match) -> None:
    one, two = finger(5), again(finger(5), 3)
    assert match(one, two) == match(two, one) == match(one, two)
    order = np.random.default_rng(0).permutation(two.count)
    shuffled = SpaceMinutiae(
        two.position_mm[order], two.theta_rad[order], two.phi_rad[order], two.type[order], two.quality[order]
    )
    assert match(one, shuffled).agreeing == match(one, two).agreeing


@both
def test_too_few_minutiae_are_not_compared(match: Match) -> None:
    for few in (no_space_minutiae(), finger(1, 9)):
        for sides in ((few, finger(1)), (finger(1), few), (few, few)):
            found = match(*sides)
            assert (found.compared, found.similarity, found.agreeing) == (False, 0.0, 0)
    assert match(finger(1, 10), finger(1, 10)).compared


@both
def test_minutiae_on_one_spot_or_one_line_are_no_trouble(match: Match) -> None:
    one = finger(1)
    spot = SpaceMinutiae(np.zeros((60, 3)), one.theta_rad, one.phi_rad, one.type, one.quality)
    line = SpaceMinutiae(one.position_mm * [0.0, 1.0, 0.0], one.theta_rad, one.phi_rad, one.type, one.quality)
    for odd in (spot, line):
        assert 0 <= match(odd, one).similarity <= 1
        assert 0 <= match(odd, odd).similarity <= 1


def test_sides_must_be_prepared_with_the_same_settings() -> None:
    one = PreparedMinutiae3D(finger(1), Minutiae3DSettings(neighbours=4))
    with pytest.raises(BadInput, match="different settings"):
        minutiae3d_match(one, PreparedMinutiae3D(finger(1)))
    with pytest.raises(BadInput, match="other settings"):
        minutiae3d_match(one, finger(1), Minutiae3DSettings())
    with pytest.raises(BadInput, match="other settings"):
        tetrahedra_match(PreparedTetrahedra(finger(1)), finger(1), TetrahedraSettings(neighbours=4))


def test_pairs_as_slow_loops_find_them() -> None:
    a, b = PreparedMinutiae3D(finger(6, 14)), PreparedMinutiae3D(again(finger(6, 14), 1))
    fast = {(*left, *right) for left, right in zip(*(one.tolist() for one in a.correspondences(b)), strict=True)}
    settings, slow = Minutiae3DSettings(), set()
    for pair in _near(a, settings.neighbours):
        for other in _near(b, settings.neighbours):
            one, two = _look(a, *pair), _look(b, *other)
            apart = [abs(np.angle(np.exp(1j * (one[k] - two[k])))) for k in (1, 2)]
            if abs(one[0] - two[0]) <= _LENGTH_MM and max(apart) <= np.deg2rad(_ANGLE_DEG):
                slow.add((*pair, *other))
    assert len(slow) > 20
    assert fast == slow


def _near(side: _Framed, count: int) -> list[tuple[int, int]]:
    places = side.places[0]
    found = []
    for i in range(len(places)):
        others = sorted((float(np.linalg.norm(places[j] - places[i])), j) for j in range(len(places)) if j != i)
        found += [(i, j) for _, j in others[:count]]
    return found


def _look(side: _Framed, i: int, j: int) -> tuple[float, float, float]:
    places, directions = side.places
    line = places[j] - places[i]
    ahead = np.arctan2(line[1], line[0])
    turns = [np.arctan2(directions[k, 1], directions[k, 0]) - ahead for k in (i, j)]
    return float(np.linalg.norm(line)), float(turns[0]), float(turns[1])


def test_tetrahedra_as_slow_loops_find_them() -> None:
    settings = TetrahedraSettings(neighbours=4, edge_mm=0.6, angle_deg=30.0)
    a = PreparedTetrahedra(finger(7, 12), settings)
    b = PreparedTetrahedra(again(finger(7, 12), 1, kept=1.0), settings)
    fast = {(*left, *right) for left, right in zip(*(one.tolist() for one in a.correspondences(b)), strict=True)}
    slow = set()
    for left in _tetrahedra(a, 4):
        for right in _tetrahedra(b, 4):
            ways = []
            for rest in permutations(right[1:]):
                worst = _worst_angle(a, left, b, (right[0], *rest), settings.edge_mm)
                if worst is not None and worst <= np.deg2rad(settings.angle_deg):
                    ways.append((worst, rest))
            if ways:
                slow.add((*left, right[0], *min(ways)[1]))
    assert len(slow) > 10
    assert fast == slow


def _tetrahedra(side: _Framed, neighbours: int) -> list[tuple[int, ...]]:
    near: dict[int, list[int]] = {}
    for i, j in _near(side, neighbours):
        near.setdefault(i, []).append(j)
    found = [(i, *three) for i, others in near.items() for three in combinations(others, 3)]
    places = side.places[0]
    edges = {four: min(np.linalg.norm(places[i] - places[j]) for i, j in combinations(four, 2)) for four in found}
    return [four for four, edge in edges.items() if edge >= 0.6]


def _worst_angle(a: _Framed, left: tuple[int, ...], b: _Framed, right: tuple[int, ...], edge_mm: float) -> float | None:
    worst = 0.0
    for i, j in permutations(range(4), 2):
        lines = [side.places[0][c[j]] - side.places[0][c[i]] for side, c in ((a, left), (b, right))]
        lengths = [float(np.linalg.norm(line)) for line in lines]
        if abs(lengths[0] - lengths[1]) > edge_mm:
            return None
        ahead = [side.places[1][c[i]] for side, c in ((a, left), (b, right))]
        angles = [np.arccos(np.clip(t @ line / d, -1, 1)) for t, line, d in zip(ahead, lines, lengths, strict=True)]
        worst = max(worst, abs(float(angles[0] - angles[1])))
    return worst


def test_agreement_as_a_slow_loop_finds_it() -> None:
    a, b = PreparedTetrahedra(finger(8)), PreparedTetrahedra(again(finger(8), 2))
    settings = AgreementSettings()
    rotation, shift = np.eye(3), np.array([0.2, -0.1, 0.1])
    found = _agreeing(a, b, rotation, shift, settings)
    pairs = []
    for i, (place, ahead) in enumerate(zip(*a.places, strict=True)):
        for j, (other, there) in enumerate(zip(*b.places, strict=True)):
            apart = place + shift - other
            turn = abs(np.angle(np.exp(1j * (np.arctan2(ahead[1], ahead[0]) - np.arctan2(there[1], there[0])))))
            rise = abs(np.arcsin(ahead[2]) - np.arcsin(there[2]))
            limits = (
                settings.plane_mm,
                _HEIGHT_MM,
                np.deg2rad(_THETA_DEG),
                np.deg2rad(_PHI_DEG),
            )
            ratios = np.array([np.hypot(apart[0], apart[1]), abs(apart[2]), turn, rise]) / limits
            if ratios.max() <= 1:
                pairs.append((float((ratios**2).sum()), i, j))
    kept: list[tuple[int, int]] = []
    for _, i, j in sorted(pairs):
        if all(i != one and j != other for one, other in kept):
            kept.append((i, j))
    assert len(kept) > 3
    assert set(zip(found[0].tolist(), found[1].tolist(), strict=True)) == set(kept)


def test_motions_are_found_back() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(12, 3))
    angle, axis = 0.7, np.array([1.0, 2.0, -1.0]) / np.sqrt(6)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    found, shift = _rigid_motion(points, points @ rotation.T + [3.0, -2.0, 1.0])
    np.testing.assert_allclose(found, rotation, atol=1e-12)
    np.testing.assert_allclose(shift, [3.0, -2.0, 1.0], atol=1e-12)
    mirrored, _ = _rigid_motion(points, points * [-1.0, 1.0, 1.0])
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


def test_pairing_and_score() -> None:
    i, j = np.array([0, 0, 1, 2]), np.array([0, 1, 0, 2])
    assert one_to_one(i, j, np.array([2.0, 1.0, 0.5, 9.0])).tolist() == [2, 1, 3]


def test_packed_minutiae_are_read_again() -> None:
    one = finger(9)
    data = pack_space_minutiae(one)
    back = unpack_space_minutiae(data)
    assert len(data) == 12 + 22 * 60
    np.testing.assert_allclose(back.position_mm, one.position_mm, atol=1e-5)
    np.testing.assert_allclose(back.direction, one.direction, atol=1e-6)
    assert back.type.tolist() == one.type.tolist()
    assert pack_space_minutiae(back) == data
    assert pack_space_minutiae(no_space_minutiae()) == b""
    damaged = bytearray(data)
    damaged[40] ^= 1
    for wrong in (b"SKMI" + data[4:], data[:-1], bytes(damaged), data[:4] + b"\x09" + data[5:], b"x"):
        with pytest.raises(BadInput, match=r"make them from the surface again\.$"):
            unpack_space_minutiae(wrong)


def test_bad_minutiae_and_settings_are_refused() -> None:
    one = finger(1)
    with pytest.raises(BadInput, match="finite"):
        SpaceMinutiae(one.position_mm * np.nan, one.theta_rad, one.phi_rad, one.type, one.quality)
    with pytest.raises(BadInput, match="all of one length"):
        SpaceMinutiae(one.position_mm[:5], one.theta_rad, one.phi_rad, one.type, one.quality)
    with pytest.raises(BadInput, match="neighbours"):
        Minutiae3DSettings(neighbours=0)
    with pytest.raises(BadInput, match="neighbours"):
        TetrahedraSettings(neighbours=2)
    with pytest.raises(BadInput, match="plane_mm"):
        AgreementSettings(plane_mm=0.0)
