"""Minutiae by the phase: found where a pattern has them, directed and named rightly, none where it
has none."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit_match.prints.enhance import gabor_enhance
from splitknit_match.prints.phase_minutiae import by_phase
from splitknit_simulator.finger.master_print import MasterPrintSettings, ink_print, master_print

PERIOD_PX = 9.0


def with_dislocations(
    places: list[tuple[float, float]], signs: list[int], shift: float, turn: float = 0.0
) -> np.ndarray:
    """Parallel ridges, and at each place (column, row) one more on one side; the phase is that of
    the formula."""
    rows, columns = np.mgrid[:260, :260].astype(np.float64)
    x, y = columns - 130, 130 - rows
    phase = 2 * np.pi * (-np.sin(turn) * x + np.cos(turn) * y) / PERIOD_PX + shift
    for (column, row), sign in zip(places, signs, strict=True):
        phase = phase + sign * np.arctan2(row - rows, columns - column)
    return np.round(127.5 - 120 * np.cos(phase)).astype(np.uint8)  # dark where the cosine is one


@pytest.mark.parametrize("turn", [0.0, 0.6, -1.1])
@pytest.mark.parametrize("sign", [1, -1])
def test_one_more_ridge_begins_at_a_known_place(turn: float, sign: int) -> None:
    image = with_dislocations([(122.0, 133.0)], [sign], 0.4, turn)
    found = by_phase(image, gabor_enhance(image))
    assert len(found.type) == 1
    assert np.hypot(found.x_px[0] - 122.0, found.y_px[0] - 133.0) < 3.0
    expected = turn if sign > 0 else turn + np.pi
    assert abs(np.angle(np.exp(1j * (found.direction_rad[0] - expected)))) < np.deg2rad(12)


def test_endings_and_forks_are_distinguished() -> None:
    """The pattern with ridges and valleys exchanged has the other kind at the same place, and the
    same direction."""
    for shift in (0.0, np.pi):
        image = with_dislocations([(130.0, 128.0)], [1], shift)
        found = by_phase(image, gabor_enhance(image))
        # straight ahead of the point, on the side of the additional ridge, lies the phase of the
        # formula
        ridge_ahead = np.cos(shift) > 0
        assert found.type.tolist() == [1 if ridge_ahead else 2]


def test_a_finger_has_its_own() -> None:
    """Of a master print's minutiae nine in ten are found within half a period, and nine in ten
    found ones are true."""
    master = master_print(
        "left_loop", 52, MasterPrintSettings(half_width_mm=8.0, distal_mm=25.0, proximal_mm=1.0)
    )
    border = 20
    image = np.pad(ink_print(master), border, constant_values=255)
    found = by_phase(image, gabor_enhance(image))
    step = 25.4 / 500
    u, v, _ = master.minutiae.T
    true = np.stack([(7.5 - u) / step - 0.5 + border, (24.0 - v) / step - 0.5 + border], axis=1)
    place = np.stack([found.x_px, found.y_px], axis=1)
    apart = np.hypot(*(place[:, None] - true[None]).transpose(2, 0, 1))
    half = 0.5 * 0.45 / step
    assert (apart.min(axis=1) < half).mean() > 0.85
    low, high = place.min(axis=0), place.max(axis=0)
    inner = ((true > low) & (true < high)).all(axis=1)
    assert (apart.min(axis=0)[inner] < half).mean() > 0.8


def test_quality_and_outline_leave_out(monkeypatch: pytest.MonkeyPatch) -> None:
    image = with_dislocations([(60.0, 133.0), (200.0, 120.0)], [1, -1], 0.4)
    enhanced = gabor_enhance(image)
    every = by_phase(image, enhanced)
    assert len(every.type) == 2
    for name, value in (("PHASE_EDGE_MM", 4.0), ("WAVE_LIKENESS", 1.0)):
        with monkeypatch.context() as patch:
            patch.setattr(f"splitknit_match.prints.phase_minutiae.{name}", value)
            assert len(by_phase(image, enhanced).type) == 0


def test_minutiae_lie_on_even_and_odd_pixels() -> None:
    """And their quality says more than that they were taken: near the outline, and beside an
    opposite one, it falls."""
    master = master_print(
        "left_loop", 52, MasterPrintSettings(half_width_mm=8.0, distal_mm=25.0, proximal_mm=1.0)
    )
    image = np.pad(ink_print(master), 20, constant_values=255)
    found = by_phase(image, gabor_enhance(image))
    odd = np.concatenate([found.x_px, found.y_px]) % 2
    assert 0.3 < odd.mean() < 0.7
    assert np.ptp(found.quality) > 20
    apart = np.hypot(found.x_px[:, None] - found.x_px, found.y_px[:, None] - found.y_px)
    opposite = np.cos(found.direction_rad[:, None] - found.direction_rad) < -0.5
    near = (opposite & (apart < 1.0 / 25.4 * 500)).any(axis=1)
    assert near.any()
    assert found.quality[near].mean() < found.quality[~near].mean() - 5


def test_a_minutia_between_pixels_is_found_there() -> None:
    """The mean place of many, moved by fractions of a pixel, follows them."""
    miss = []
    for part in (0.0, 0.25, 0.5, 0.75):
        for turn in (0.3, 1.2):
            place = 122.0 + part, 133.0 + part
            image = with_dislocations([place], [1], 0.4, turn)
            found = by_phase(image, gabor_enhance(image))
            miss.append([found.x_px[0] - place[0], found.y_px[0] - place[1]])
    assert np.abs(np.mean(miss, axis=0)).max() < 0.75
