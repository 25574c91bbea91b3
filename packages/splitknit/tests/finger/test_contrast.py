"""CLAHE: against OpenCV, and what it must not do."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from refusals import bad_input
from splitknit.finger.contrast import ClaheSettings, clahe


def picture(shape=(256, 320), seed=0):
    rng = np.random.default_rng(seed)
    smooth = ndimage.gaussian_filter(rng.standard_normal(shape), 6.0)
    return (0.5 + 0.12 * smooth / smooth.std()).clip(0, 1).astype(np.float32)


@pytest.mark.parametrize(
    ("settings", "tiles"),
    [
        *((ClaheSettings("linear", clip_limit=limit), (5, 4)) for limit in (2.0, 4.0, 40.0)),
        # tiles of 32 x 40 pixels; at low limits OpenCV rounds the few pixels of a bin
        (ClaheSettings("linear", tiles=8, clip_limit=40.0), (8, 8)),
    ],
)
def test_clahe_agrees_with_opencv(settings, tiles):
    quantised = np.round(picture() * 255).astype(np.uint8)
    quantised[:2, :64] = 255
    expected = cv2.createCLAHE(settings.clip_limit, tiles).apply(quantised) / 255.0
    error = np.abs(clahe(quantised.astype(np.float32) / 255, 75.7, settings) - expected)
    assert error.mean() < 0.01
    assert np.percentile(error, 99) < 0.03


def test_coded_grey_is_equalised_as_its_code():
    image = picture()
    code = np.where(
        image <= 0.0031308, 12.92 * image, 1.055 * np.maximum(image, 1e-9) ** (1 / 2.4) - 0.055
    )
    code[:2, :64] = image[:2, :64] = 1.0
    equalised = clahe(image, 75.7)
    plain = ClaheSettings(grey="linear")
    assert_allclose(equalised, clahe(code.astype(np.float32), 75.7, plain), atol=1e-3)
    assert np.abs(equalised - clahe(image, 75.7, plain)).max() > 0.02


def test_equalised_light_keeps_its_range_and_fine_levels():
    image = picture() * np.float32(0.01)
    result = clahe(image, 75.7)
    assert result.dtype == np.float32
    assert result.min() >= 0.0
    assert result.max() <= 1.0
    assert len(np.unique(result)) > 20_000  # no 8-bit steps
    # exposure does not matter
    assert_allclose(clahe(image * np.float32(7.0), 75.7), result, atol=1e-4)


def test_the_camera_s_full_scale_is_white_where_the_skin_is_not():
    image = picture()
    image[:2, :64] = 1.0
    camera = ClaheSettings(white="camera")
    assert_allclose(clahe(image, 75.7, camera), clahe(image, 75.7), atol=1e-4)
    dark = image * np.float32(0.1)
    assert clahe(dark, 75.7, camera).mean() < 0.8 * clahe(dark, 75.7).mean()


def test_the_clip_limit_bounds_the_gain():
    y, x = np.mgrid[0:320, 0:320]
    # hardly any contrast
    image = (0.6 + 0.02 * np.sin(x / 7.0) * np.sin(y / 9.0)).astype(np.float32)
    image[0, :120] = 1.0
    amplitude = np.ptp(image[64:256, 64:256])
    gains = []
    for limit in (1.0, 2.0, 4.0):
        result = clahe(image, 75.7, ClaheSettings("linear", clip_limit=limit))
        gains.append(float(np.ptp(result[64:256, 64:256])) / float(amplitude))
        assert gains[-1] < limit + 1.3
    assert gains[0] < gains[1] < gains[2]
    assert gains[2] > 3.0


def test_tiles_scale_with_the_resolution():
    image = picture((512, 512))
    half = cv2.resize(image, (256, 256), interpolation=cv2.INTER_AREA)
    fine = cv2.resize(clahe(image, 75.7), (256, 256), interpolation=cv2.INTER_AREA)
    assert np.corrcoef(fine.ravel(), clahe(half, 37.85).ravel())[0, 1] > 0.99
    assert np.corrcoef(fine.ravel(), clahe(half, 150.0).ravel())[0, 1] < 0.99


def test_the_background_does_not_change_the_finger():
    image = picture((300, 300))
    y, x = np.mgrid[0:300, 0:300]
    mask = (x - 140) ** 2 / 110**2 + (y - 160) ** 2 / 130**2 < 1
    dark, bright = np.where(mask, image, 0.0), np.where(mask, image, 5.0)
    first = clahe(dark.astype(np.float32), 75.7, mask=mask)
    assert_array_equal(first, clahe(bright.astype(np.float32), 75.7, mask=mask))
    assert (first[~mask] == 0).all()
    box = np.zeros_like(mask)
    box[35:290, 21:250] = True
    boxed = clahe(image, 75.7, mask=box)[35:290, 21:250]
    assert_allclose(boxed, clahe(image[35:290, 21:250], 75.7), atol=1e-6)


def test_a_smooth_image_has_no_seams_between_tiles():
    y, x = np.mgrid[0:400, 0:300] / 400
    result = clahe((0.2 + 0.6 * y + 0.1 * x).astype(np.float32), 75.7)
    assert np.abs(np.diff(result, axis=0)).max() < 0.03
    assert np.abs(np.diff(result, axis=1)).max() < 0.03


def test_a_small_limit_and_an_empty_mask_are_refused():
    with bad_input("clip_limit"):
        ClaheSettings(clip_limit=0.5)
    with bad_input("empty"):
        clahe(picture(), 75.7, mask=np.zeros((256, 320), dtype=bool))
