import base64
from dataclasses import replace

import cv2
import numpy as np
import pytest

from handmade import capture_of, finger
from splitknit.io.pictures import BLUE, ORANGE, upright_frame
from splitknit.report import figures
from splitknit.report.photos import capture_pictures

_, NORMALS, RELIEF, *_ = figures.FIELD_PICTURES


def _decoded(picture):
    data = base64.b64decode(picture.uri.partition(",")[2])
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


@pytest.mark.parametrize("yaw_deg", [-20.0, 0.0, 20.0])
def test_normals_turn_with_the_finger(yaw_deg):
    """Red is symmetrical about the finger's axis and green about nothing: at the tip it is above
    the middle value."""
    result, _ = finger(yaw_deg=yaw_deg)
    image = _decoded(
        NORMALS(result, figures.small_fields(result, upright_frame(result, 200)))
    ).astype(float)
    rows, columns = image.shape[:2]
    left, right = image[rows // 2, columns // 5], image[rows // 2, -columns // 5]
    assert left[0] + right[0] == pytest.approx(255, abs=12)
    assert right[0] > left[0] + 60
    assert abs(left[1] - right[1]) < 20
    tip = image[rows // 6, columns // 2]
    assert tip[1] > 165
    assert tip[0] == pytest.approx(127, abs=25)


def test_outline_and_crease_lie_on_the_input():
    result, _ = finger()
    crease = [[150.0, 330.0], [450.0, 400.0]]
    picture, _ = capture_pictures(
        replace(result, facts={"crease_line": crease}), capture_of(result)
    )
    image = _decoded(picture).astype(int)
    assert image.shape[:2] == result.mask.shape
    orange = np.abs(image - np.array(ORANGE)).max(axis=2) < 60
    edge = (
        cv2.morphologyEx(
            result.mask.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((7, 7), np.uint8)
        )
        > 0
    )
    assert orange.sum() > 800
    assert (orange & edge).sum() > 0.97 * orange.sum()
    blue = np.abs(image[365, 290:310] - np.array(BLUE)).max(axis=1) < 70
    assert blue.any()
    assert "was cut" in picture.caption
    assert "No crease" in capture_pictures(result, capture_of(result))[0].caption


def test_scale_bar_is_as_long_as_it_says():
    result, _ = finger()
    frame = upright_frame(result, 200)
    picture = RELIEF(result, figures.small_fields(result, frame))
    length_mm = float(picture.scale_label.split()[0])
    assert picture.scale_percent / 100 * picture.width * frame.pitch_mm == pytest.approx(
        length_mm, rel=1e-3
    )


def test_relief_limits_leave_out_steep_flanks():
    result, _ = finger()
    spoilt = np.where(result.normals[..., 2] < 0.5, np.float32(-0.5), result.ridge_mm)
    assert figures.relief_limits(replace(result, ridge_mm=spoilt)) == figures.relief_limits(result)
    low_mm, high_mm = figures.relief_limits(result)
    assert -0.045 <= low_mm <= -0.030
    assert 0.030 <= high_mm <= 0.045


def test_letters_of_an_object_are_its_details():
    """Grooves 0.8 mm wide on a thing of 16 mm keep their depth; the slope goes."""
    result, _ = finger()
    rows, columns = np.indices(result.mask.shape) * result.pitch_mm
    groove = np.abs(rows % 5.0 - 2.5) < 0.4
    height_mm = np.where(result.mask, 0.2 * columns - 0.3 * groove, np.nan).astype(np.float32)
    shown = figures.details_of_object(replace(result, height_mm=height_mm))
    inner = figures.erode(result.mask, 2.0 / result.pitch_mm)
    low, high = (shown.ridge_mm[inner & part].mean() for part in (groove, ~groove))
    assert high - low == pytest.approx(0.3, rel=0.3)
    assert np.allclose(shown.ridge_mm + shown.shape_mm, height_mm, equal_nan=True)


def test_the_rim_of_an_opaque_thing_is_no_relief():
    result, _ = finger()
    inner = figures.erode(result.mask, 4.0)
    opaque = replace(result, facts={"material": "opaque"})
    ring = replace(opaque, ridge_mm=np.where(inner, result.ridge_mm, np.float32(-0.5)))
    assert figures.relief_limits(ring) == figures.relief_limits(opaque)
    frame = upright_frame(result, 400)
    first, second = (RELIEF(each, figures.small_fields(each, frame)).uri for each in (ring, opaque))
    assert first == second
