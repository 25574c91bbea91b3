"""Lists of minutiae for chip cards."""

from __future__ import annotations

import numpy as np
import pytest

from fmr_samples import three_minutiae
from splitknit.errors import BadInput
from splitknit.io.iso19794 import decode_card, encode_card
from splitknit.io.minutiae_record import FingerView

PPCM = (200, 400)
"""0.05 mm along columns, 0.025 mm along rows."""


def view(**changes: object) -> FingerView:
    fields = {
        "x_px": np.array([20, 300]),
        "y_px": np.array([40, 400]),
        "direction_rad": np.deg2rad([90.0, 270.0]),
        "type": np.array([1, 2]),
        "quality": np.array([50, 60]),
        "size": (500, 350),
        "finger_quality": 70,
        "resolution_ppcm": PPCM,
        **changes,
    }
    return FingerView(**fields)  # type: ignore[arg-type]


def test_compact_minutiae_take_three_bytes() -> None:
    assert encode_card(view()).hex(" ") == "0a 0a 50 96 64 b0"  # 1.0, 1.0 mm, ending, 16 of 64 steps; 15, 10 mm ...


def test_normal_minutiae_take_five_bytes() -> None:
    assert encode_card(view(), compact=False).hex(" ") == "40 64 00 64 40 85 dc 03 e8 c0"


@pytest.mark.parametrize("compact", [True, False])
def test_lists_are_read_onto_an_image(compact: bool) -> None:
    data = encode_card(view(), compact)
    read = decode_card(data, (500, 350), PPCM, compact)
    for name in ("x_px", "y_px", "type"):
        np.testing.assert_array_equal(getattr(read, name), getattr(view(), name))
    np.testing.assert_allclose(read.direction_rad, view().direction_rad)
    assert (read.impression, read.finger, read.finger_quality) == ("unknown", "unknown", 0)
    assert encode_card(read, compact) == data


def test_what_is_no_list_is_refused() -> None:
    for data, compact, words in [
        (b"1234", True, "4 bytes, which is no list"),
        (bytes(3 * 256), True, "no list of at most 255"),
        (b"\1\1\xc0", True, "reserved type 3"),
        (b"\xc0\1\1\1\1", False, "reserved type 3"),
        (b"\0\1\x40\1\1", False, "reserved bits"),
        (b"\xff\1\1", True, "outside the image"),
    ]:
        with pytest.raises(BadInput, match=words):
            decode_card(data, (500, 350), PPCM, compact)
    with pytest.raises(BadInput, match="resolution must be positive"):
        decode_card(b"", (500, 350), (0, 0))


def test_what_does_not_reach_is_refused() -> None:
    with pytest.raises(BadInput, match=r"30.0 mm from the image's edge, but this format reaches 25.50"):
        encode_card(view(x_px=np.array([20, 600]), size=(500, 700)))
    many = three_minutiae(
        **{
            name: np.resize(getattr(three_minutiae(), name), 300)
            for name in ("x_px", "y_px", "direction_rad", "type", "quality")
        }
    )
    with pytest.raises(BadInput, match="at most 255 minutiae"):
        encode_card(many)
