import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit.finger.ridges import relief_print
from splitknit.imaging.geometry import rotation_about

PX_PER_MM = 1000 / 25.4  # twice the print's resolution


def _stripes(angle_deg, size=(300, 400), period_mm=0.45):
    """Ridges of 30 um whose crests run at an angle counter-clockwise from x, on the pixel grid."""
    rows, columns = size
    x = (np.arange(columns) - (columns - 1) / 2)[None, :] / PX_PER_MM
    y = ((rows - 1) / 2 - np.arange(rows))[:, None] / PX_PER_MM
    angle = np.deg2rad(angle_deg)
    return (0.03 * np.cos(2 * np.pi * (y * np.cos(angle) - x * np.sin(angle)) / period_mm)).astype(
        np.float32
    )


def _direction_deg(image):
    """Direction of stripes, counter-clockwise from x, in [0, 180)."""
    values = image[20:-20, 20:-20].astype(np.float32)
    across = cv2.Sobel(values, cv2.CV_32F, 1, 0)
    up = -cv2.Sobel(values, cv2.CV_32F, 0, 1)
    gradient = 0.5 * np.arctan2(2 * np.sum(across * up), np.sum(across * across - up * up))
    return float(np.rad2deg(gradient) + 90.0) % 180.0


def _print(relief, mask=None, input_from_upright=None, **options):
    """Print of a relief that lies upright and fills the image unless stated otherwise."""
    mask = np.ones(relief.shape, bool) if mask is None else mask
    upright = np.eye(3) if input_from_upright is None else input_from_upright
    return relief_print(relief, mask, PX_PER_MM, upright, relief.shape, **options)


def test_size_is_exactly_the_resolution():
    assert _print(_stripes(20)).shape == (150, 200)
    assert _print(_stripes(20), ppi=1000).shape == (300, 400)


def test_print_is_mirrored():
    assert _direction_deg(_print(_stripes(30))) == pytest.approx(150.0, abs=1.0)


def test_the_right_of_the_finger_is_at_the_left_of_the_print():
    mask = np.zeros((300, 400), bool)
    mask[100:280, 250:390] = True
    dark = _print(_stripes(30), mask) < 128
    assert not dark[:, 80:].any()
    assert dark[60:130, 10:70].mean() > 0.3


def test_ridges_are_dark_and_in_place():
    relief = np.zeros((300, 400), np.float32)
    relief[140:150, 100:300] = 0.03  # one ridge along x, above the middle
    profile = _print(relief)[:, 100].astype(int)
    assert abs(int(np.argmin(profile)) - 72) <= 1
    assert profile.min() < 60


def test_yaw_is_taken_out():
    """A finger at a yaw of 15 deg gives the print of an upright one, whatever lies between."""
    input_from_upright = rotation_about((199.5, 149.5), np.deg2rad(15.0))
    turned = _print(_stripes(40 + 15), input_from_upright=input_from_upright)
    middle = np.s_[50:100, 60:140]
    assert np.corrcoef(turned[middle].ravel(), _print(_stripes(40))[middle].ravel())[0, 1] > 0.99


def test_contrast_is_even_up_to_the_edge():
    """Ridges that fade to a fifth, on a bowl far higher than themselves, come out equally dark."""
    rows, columns = np.mgrid[0:600, 0:600]
    fade = 1.0 - 0.8 * columns / 599
    relief = (
        _stripes(0, (600, 600)) * fade.astype(np.float32)
        + np.float32(1e-6) * (columns - 300.0) ** 2
    )
    mask = np.hypot(rows - 299.5, columns - 299.5) < 280
    printed = _print(relief.astype(np.float32), mask)
    strong, weak, edge = (
        printed[130:170, part].astype(float).std()
        for part in (slice(200, 240), slice(60, 100), slice(18, 30))
    )
    assert weak > 0.85 * strong
    assert edge > 0.7 * strong
    assert (printed[:, :2] == 255).all()


def test_no_aliases_of_fine_structure():
    """Structure of 0.07 mm cannot be shown at 500 ppi and must vanish, not turn into false
    ridges."""
    ridges = _stripes(90, period_mm=0.45)
    printed = _print(ridges + 4 * _stripes(90, period_mm=0.07))
    assert np.corrcoef(printed.ravel(), _print(ridges).ravel())[0, 1] > 0.97


def test_nan_outside_the_mask_does_no_harm():
    relief = _stripes(30)
    mask = np.zeros(relief.shape, bool)
    mask[50:250, 50:350] = True
    holed = np.where(mask, relief, np.float32(np.nan))
    assert np.array_equal(_print(holed, mask), _print(relief, mask))


def test_flat_relief_gives_white_paper():
    assert (_print(np.zeros((60, 80), np.float32)) == 255).all()


def test_bad_input_is_refused():
    relief = np.zeros((60, 80), np.float32)
    with bad_input("mask is empty"):
        _print(relief, np.zeros((60, 80), bool))
    with bad_input("px_per_mm"):
        relief_print(relief, np.ones((60, 80), bool), 0.0, np.eye(3), (60, 80))
