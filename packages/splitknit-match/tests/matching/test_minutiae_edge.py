"""Where a print is cut off, every ridge ends: those ends are no minutiae."""

import numpy as np
import pytest

from splitknit.finger.ridges import relief_print
from splitknit_match.prints.minutiae import EDGE_MM, edge_distance_mm, extract

STEP_MM = 25.4 / 500


def test_the_distance_is_to_the_outline_of_the_print_or_the_image():
    """Valleys are not an outline, and a thin line beside the print is not part of it."""
    rows, _ = np.mgrid[:300, :240]
    ridges = np.where((rows // 5) % 2 == 0, 40, 255).astype(np.uint8)
    printed = np.full((300, 240), 255, np.uint8)
    printed[:, 60:180] = ridges[:, 60:180]
    printed[100:103, :40] = 0
    distance = edge_distance_mm(printed)
    assert distance[150, 120] == pytest.approx(60 * STEP_MM, abs=2.5 * STEP_MM)
    assert distance[150, 70] == pytest.approx(10.5 * STEP_MM, abs=2.5 * STEP_MM)
    # the finger goes on above
    assert distance[10, 120] == pytest.approx(11 * STEP_MM, abs=2.5 * STEP_MM)
    assert distance[101, 20] == 0
    assert not edge_distance_mm(np.full((100, 90), 255, np.uint8)).any()
    black = edge_distance_mm(np.zeros((100, 90), np.uint8))
    assert black.max() == pytest.approx(45 * STEP_MM, abs=STEP_MM)


def test_straight_ridges_have_no_minutiae_wherever_their_print_ends():
    """Parallel ridges inside a round outline: their ends at the outline are left out."""
    pytest.importorskip("nbis")
    rows, columns = np.mgrid[:400, :400]
    turned = np.cos(0.3) * rows + np.sin(0.3) * columns
    relief = (0.03 * np.sin(2 * np.pi * turned / 9.0)).astype(np.float32)
    away = np.hypot(rows - 200, columns - 200)
    fading = np.clip((190 - away) / 14, 0, 1).astype(np.float32)  # at grazing view a relief is lost
    printed = relief_print(relief * fading, away < 190, 20.0, np.eye(3), (400, 400))
    every, kept = extract(printed, edge_mm=0.0), extract(printed)
    assert every.count > 15
    assert kept.count == 0
    assert np.all(edge_distance_mm(printed)[every.y_px, every.x_px] < EDGE_MM)
