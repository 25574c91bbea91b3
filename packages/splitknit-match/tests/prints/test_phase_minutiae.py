"""Minutiae by the phase: extracted where a pattern has them, with direction and type."""

import numpy as np
import pytest

from splitknit_match.prints.enhance import gabor_enhance
from splitknit_match.prints.phase_minutiae import by_phase
from splitknit_simulator.finger.master_print import MasterPrintSettings, ink_print, master_print

PERIOD_PX = 9.0
STEP_MM = 25.4 / 500
BORDER = 20


def extracted(image):
    return by_phase(image, gabor_enhance(image))


@pytest.fixture(scope="module")
def master():
    settings = MasterPrintSettings(half_width_mm=8.0, distal_mm=25.0, proximal_mm=1.0)
    return master_print("left_loop", 52, settings)


@pytest.fixture(scope="module")
def minutiae(master):
    return extracted(np.pad(ink_print(master), BORDER, constant_values=255))


def with_dislocations(places, signs, shift, turn=0.0):
    """Parallel ridges, and at each place (column, row) a further one on one side."""
    rows, columns = np.mgrid[:260, :260].astype(np.float64)
    x, y = columns - 130, 130 - rows
    phase = 2 * np.pi * (-np.sin(turn) * x + np.cos(turn) * y) / PERIOD_PX + shift
    for (column, row), sign in zip(places, signs, strict=True):
        phase = phase + sign * np.arctan2(row - rows, columns - column)
    return np.round(127.5 - 120 * np.cos(phase)).astype(np.uint8)  # dark where the cosine is one


@pytest.mark.parametrize("turn", [0.0, 0.6, -1.1])
@pytest.mark.parametrize("sign", [1, -1])
def test_one_more_ridge_begins_at_a_known_place(turn, sign):
    minutiae = extracted(with_dislocations([(122.0, 133.0)], [sign], 0.4, turn))
    assert len(minutiae.type) == 1
    assert np.hypot(minutiae.x_px[0] - 122.0, minutiae.y_px[0] - 133.0) < 3.0
    expected = turn if sign > 0 else turn + np.pi
    assert abs(np.angle(np.exp(1j * (minutiae.direction_rad[0] - expected)))) < np.deg2rad(12)


@pytest.mark.parametrize(("shift", "type_"), [(0.0, 1), (np.pi, 2)])
def test_a_ridge_ending_becomes_a_fork_where_ridges_and_valleys_are_exchanged(shift, type_):
    minutiae = extracted(with_dislocations([(130.0, 128.0)], [1], shift))
    assert minutiae.type.tolist() == [type_]


def test_most_minutiae_of_a_finger_are_extracted_and_most_extracted_ones_are_true(master, minutiae):
    """Within half a period."""
    x_mm, y_mm = 7.5 - master.minutiae[:, 0], 24.0 - master.minutiae[:, 1]
    true = np.stack([x_mm, y_mm], axis=1) / STEP_MM - 0.5 + BORDER
    place = np.stack([minutiae.x_px, minutiae.y_px], axis=1)
    apart = np.hypot(*(place[:, None] - true[None]).transpose(2, 0, 1))
    half = 0.5 * 0.45 / STEP_MM
    assert (apart.min(axis=1) < half).mean() > 0.85
    low, high = place.min(axis=0), place.max(axis=0)
    inner = ((true > low) & (true < high)).all(axis=1)
    assert (apart.min(axis=0)[inner] < half).mean() > 0.8


def test_poor_waves_and_the_outline_give_no_minutiae(monkeypatch):
    image = with_dislocations([(60.0, 133.0), (200.0, 120.0)], [1, -1], 0.4)
    enhanced = gabor_enhance(image)
    every = by_phase(image, enhanced)
    assert len(every.type) == 2
    for name, value in (("PHASE_EDGE_MM", 4.0), ("WAVE_LIKENESS", 1.0)):
        with monkeypatch.context() as patch:
            patch.setattr(f"splitknit_match.prints.phase_minutiae.{name}", value)
            assert len(by_phase(image, enhanced).type) == 0


def test_quality_falls_beside_an_opposite_minutia(minutiae):
    x, y, direction_rad = minutiae.x_px, minutiae.y_px, minutiae.direction_rad
    apart_mm = np.hypot(x[:, None] - x, y[:, None] - y) * STEP_MM
    opposite = np.cos(direction_rad[:, None] - direction_rad) < -0.5
    near = (opposite & (apart_mm < 1.0)).any(axis=1)
    assert near.any()
    assert np.ptp(minutiae.quality) > 20
    assert minutiae.quality[near].mean() < minutiae.quality[~near].mean() - 5


def test_a_minutia_between_pixels_is_placed_there():
    """The mean place of many, moved by fractions of a pixel, follows them."""
    errors_px = []
    for part in (0.0, 0.25, 0.5, 0.75):
        for turn in (0.3, 1.2):
            place = 122.0 + part, 133.0 + part
            minutiae = extracted(with_dislocations([place], [1], 0.4, turn))
            errors_px.append([minutiae.x_px[0] - place[0], minutiae.y_px[0] - place[1]])
    assert np.abs(np.mean(errors_px, axis=0)).max() < 0.75
