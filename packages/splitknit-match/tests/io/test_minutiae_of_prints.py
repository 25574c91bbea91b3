"""From a print to a record: minutiae as mindtct finds them, in the frame that the standards ask
for."""

import numpy as np
import pytest

from splitknit_match.prints.minutiae import extract
from splitknit_match.records.fmr_bytes import ANSI_2004
from splitknit_match.records.minutiae_files import encode_minutiae_record
from splitknit_match.records.minutiae_record import FingerView

pytest.importorskip("nbis")


def view_of(minutiae):
    return FingerView(
        minutiae.x_px,
        minutiae.y_px,
        minutiae.direction_rad,
        minutiae.type,
        minutiae.quality,
        minutiae.size,
        finger_quality=60,
    )


def test_an_ending_points_along_its_ridge():
    """Upright ridges, one more below row 150 than above it: down is 270 deg, 192 of 256 and 135 of
    180 steps."""
    rows, columns = np.mgrid[:300, :280].astype(float)
    phase = 2 * np.pi * columns / 9 + np.arctan2(columns - 140, rows - 150)
    print_image = np.round(127 + 100 * np.cos(phase)).astype(np.uint8)
    minutiae = extract(print_image)
    inner = (np.abs(minutiae.x_px - 140) < 100) & (np.abs(minutiae.y_px - 150) < 100)
    view = view_of(minutiae.taken(inner))
    data = encode_minutiae_record(view)
    assert data[27] == 1
    x, y = int.from_bytes(data[28:30], "big") & 0x3FFF, int.from_bytes(data[30:32], "big")
    assert abs(x - 140) <= 4
    assert abs(y - 150) <= 4
    assert data[32] == 192
    assert encode_minutiae_record(view, ANSI_2004)[34] == 135
