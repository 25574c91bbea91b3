"""What is written is read again, and a PNG is decoded as others decode it; tests/fuzz reads what is
damaged."""

import json
from random import Random

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from png_files import PNG, chunk, png_of
from splitknit.errors import BadInput
from splitknit.io.images import decode_image as decode_png
from splitknit.io.provenance import canonical_json

FUZZ = settings(max_examples=150, derandomize=True, deadline=None)
SCALARS = (
    st.none() | st.booleans() | st.integers(-(10**30), 10**30) | st.floats() | st.text(max_size=8)
)
JSON = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4)
    ),
)
COLOURS = [
    (depth, colour)
    for colour in (0, 2, 3, 4, 6)
    for depth in ((1, 2, 4, 8, 16), (8, 16), (1, 2, 4, 8))[
        0 if colour == 0 else 2 if colour == 3 else 1
    ]
]


def refused(data):
    try:
        decode_png(data, "x.png")
    except BadInput:
        return True
    return False


@FUZZ
@given(
    st.integers(1, 12),
    st.integers(1, 12),
    st.sampled_from(COLOURS),
    st.booleans(),
    st.integers(0, 2**32),
)
def test_any_valid_png_is_decoded_as_opencv_does(rows, columns, kind, interlaced, seed):
    depth, colour = kind
    data = png_of(rows, columns, depth, colour, interlaced, Random(seed))
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    expected = expected[..., None] if expected.ndim == 2 else expected
    expected = expected[..., :1] if colour in (0, 4) else expected[..., 2::-1]
    np.testing.assert_array_equal(decode_png(data, "x"), expected)


def test_png_kinds_outside_the_standard_are_refused():
    for depth in (1, 2, 3, 4, 8, 16):
        for colour in range(8):
            known = (depth, colour) in COLOURS
            head = b"\0\0\0\3\0\0\0\2" + bytes([depth, colour, 0, 0, 0])
            unknown = PNG + chunk(b"IHDR", head) + chunk(b"IEND", b"")
            assert (
                refused(png_of(2, 3, depth, colour, False, Random(1)) if known else unknown)
                != known
            )


@FUZZ
@given(JSON)
def test_canonical_json_is_a_fixed_point(value):
    try:
        text = canonical_json(value)
    except BadInput:
        return
    assert canonical_json(json.loads(text)) == text
