"""Minutiae by the phase: found where a pattern has them, directed and named rightly, none where it has none."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.prints.enhance import gabor_enhance
from splitknit.prints.phase_minutiae import phase_minutiae
from splitknit.simulator.finger.master_print import MasterPrintSettings, ink_print, master_print

PERIOD_PX = 9.0


def with_dislocations(
    places: list[tuple[float, float]], signs: list[int], shift: float, turn: float = 0.0
) -> np.ndarray:
    """Parallel ridges, and at each place (column, row) one more on one side; the phase is that of the formula."""
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
    found = phase_minutiae(image, gabor_enhance(image))
    assert len(found.kind) == 1
    assert np.hypot(*(found.place_px[0] - [122.0, 133.0])) < 3.0
    expected = turn if sign > 0 else turn + np.pi
    assert abs(np.angle(np.exp(1j * (found.direction_rad[0] - expected)))) < np.deg2rad(12)


def test_endings_and_forks_are_distinguished() -> None:
    """The pattern with ridges and valleys exchanged has the other kind at the same place, and the same direction."""
    for shift in (0.0, np.pi):
        image = with_dislocations([(130.0, 128.0)], [1], shift)
        found = phase_minutiae(image, gabor_enhance(image))
        # straight ahead of the point, on the side of the additional ridge, lies the phase of the formula
        ridge_ahead = np.cos(shift) > 0
        assert found.kind.tolist() == [1 if ridge_ahead else 2]


def test_none_where_there_is_none() -> None:
    image = with_dislocations([], [], 0.0, 0.3)
    assert len(phase_minutiae(image, gabor_enhance(image)).kind) == 0


def test_a_finger_has_its_own() -> None:
    """Of a master print's minutiae nine in ten are found within half a period, and nine in ten found ones are true."""
    master = master_print("left_loop", 52, MasterPrintSettings(half_width_mm=8.0, distal_mm=25.0, proximal_mm=1.0))
    border = 20
    image = np.pad(ink_print(master), border, constant_values=255)
    found = phase_minutiae(image, gabor_enhance(image))
    step = 25.4 / 500
    u, v, _ = master.minutiae.T
    true = np.stack([(7.5 - u) / step - 0.5 + border, (24.0 - v) / step - 0.5 + border], axis=1)
    apart = np.hypot(*(found.place_px[:, None] - true[None]).transpose(2, 0, 1))
    half = 0.5 * 0.45 / step
    assert (apart.min(axis=1) < half).mean() > 0.85
    low, high = found.place_px.min(axis=0), found.place_px.max(axis=0)
    inner = ((true > low) & (true < high)).all(axis=1)
    assert (apart.min(axis=0)[inner] < half).mean() > 0.8


def test_quality_and_outline_leave_out(monkeypatch: pytest.MonkeyPatch) -> None:
    image = with_dislocations([(60.0, 133.0), (200.0, 120.0)], [1, -1], 0.4)
    enhanced = gabor_enhance(image)
    every = phase_minutiae(image, enhanced)
    assert len(every.kind) == 2
    with pytest.raises(BadInput, match="one print"):
        phase_minutiae(image[1:], enhanced)
    for name, value in (("_EDGE_MM", 4.0), ("_MIN_QUALITY", 100)):
        with monkeypatch.context() as patch:
            patch.setattr(f"splitknit.prints.phase_minutiae.{name}", value)
            assert len(phase_minutiae(image, enhanced).kind) == 0
