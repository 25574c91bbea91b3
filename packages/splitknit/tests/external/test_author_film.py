"""The thesis's author's own finger, from the film on his public page: our steps beside his on the
same pixels."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from splitknit.finger.contrast import ClaheSettings, clahe
from splitknit.finger.mask import finger_mask, touched_borders
from splitknit.finger.orientation import find_upright
from splitknit.finger.phalange import find_crease, phalange_mask
from splitknit.finger.ridges import relief_print
from splitknit.imaging.pixels import GREY_WEIGHTS
from splitknit.separation.direct import direct_light

pytestmark = pytest.mark.external
FINGER_MM = 16.0  # assumed: the film states no scale
WHITE_FRAME_PX = 235.0  # width of the finger in the white frame


@pytest.fixture(scope="module")
def film(data_dir):
    """Grey picture, his contrast enhancement and his network's output of it, in the film's code
    from 0 to 1."""
    folder = data_dir / "author_film"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    names = ("grey_crop", "clahe", "direct")
    return {
        name: cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255
        for name in names
    }


@pytest.fixture(scope="module")
def inside(film):
    finger = ndimage.binary_opening(film["clahe"] > 0.08, iterations=3)
    return np.asarray(ndimage.binary_erosion(finger, iterations=25))


def ridges(image, inside):
    """Values in the band of the ridges, whose period is about 12 px here."""
    band = ndimage.gaussian_filter(image, 1.0) - ndimage.gaussian_filter(image, 8.0)
    return np.asarray(band[inside])


def agreement(ours, his, inside):
    """Correlation of the ridges, and their gain over his."""
    a, b = ridges(ours, inside), ridges(his, inside)
    return float(np.corrcoef(a, b)[0, 1]), float(a @ b / (b @ b))


def linear(code):
    light = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    return light.astype(np.float32)


def equalised(film, settings):
    finger = film["clahe"] > 0.08
    columns = np.flatnonzero(finger.any(axis=0))
    px_per_mm = float(np.ptp(columns)) / FINGER_MM
    return clahe(linear(film["grey_crop"]), px_per_mm, settings, mask=finger)


def contrast(image, inside):
    """Of the ridges, beside the mean brightness."""
    return float(np.std(ridges(image, inside)) / image[inside].mean())


def test_clahe_as_shipped_shows_the_author_s_ridges_at_half_their_contrast(film, inside):
    """Ours makes the brightest skin white before it equalises."""
    ours = equalised(film, ClaheSettings())
    correlation, gain = agreement(ours, film["clahe"], inside)
    assert correlation > 0.97 and 0.9 < gain < 1.3
    assert contrast(film["clahe"], inside) == pytest.approx(0.128, abs=0.002)
    assert contrast(ours, inside) == pytest.approx(0.060, abs=0.005)


@pytest.mark.parametrize(("clip_limit", "tiles"), [(3.0, 0), (4.0, 0), (4.0, 64)])
def test_clahe_with_the_camera_s_white_is_the_author_s(film, inside, clip_limit, tiles):
    """Cells of 64 px (0) or 64 tiles, as his text or his program has it."""
    settings = ClaheSettings(white="camera", clip_limit=clip_limit, tiles=tiles)
    ours = equalised(film, settings)
    correlation, gain = agreement(ours, film["clahe"], inside)
    assert correlation > 0.97 and 0.10 <= contrast(ours, inside) <= 0.15
    assert clip_limit < 4 or 0.95 < gain < 1.05


def test_the_direct_network_agrees_with_the_author_s_network(film, inside):
    """His network mostly makes ridges weaker: his own enhanced picture has 0.969, too."""
    ours = direct_light(film["clahe"][None], "direct")[0]
    correlation, gain = agreement(ours, film["direct"], inside)
    assert correlation > 0.95 and 0.8 < gain < 1.1
    unchanged, _ = agreement(film["clahe"], film["direct"], inside)
    assert unchanged == pytest.approx(0.969, abs=0.002)


@pytest.fixture(scope="module")
def photographs(data_dir):
    """Linear frames (H, W, 3) of the finger under one white and one near-infrared LED."""
    folder = data_dir / "author_film"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    frames = {}
    for name in ("white", "nir"):
        code = cv2.imread(str(folder / f"{name}_raw.png"))[..., ::-1].astype(np.float32) / 255
        frames[name] = linear(code)
    return frames


def test_the_white_frame_is_segmented_turned_cut_at_its_crease_and_printed(photographs):
    inputs = pytest.importorskip("splitknit_match.matching.inputs")

    white, px_per_mm = photographs["white"], WHITE_FRAME_PX / FINGER_MM
    mask, grey = finger_mask(white, px_per_mm), white @ GREY_WEIGHTS
    assert touched_borders(mask) == ("bottom",)
    upright = find_upright(mask)
    assert upright.width_px == pytest.approx(WHITE_FRAME_PX, abs=3)
    assert np.rad2deg(upright.yaw_rad) == pytest.approx(-7.1, abs=0.5)
    crease = find_crease(grey, mask, upright, px_per_mm)
    assert crease.detected and crease.distance_mm == pytest.approx(23.2, abs=0.5)
    phalange = phalange_mask(mask, crease, upright)
    image = relief_print(grey, phalange, px_per_mm, upright.input_from_upright, upright.size)
    assert 40 < len(inputs.print_template(image).minutiae.x_px) < 120


def test_red_is_clipped_all_over_the_finger(photographs):
    """So its ridges are the luma's, and neither their colour nor red over near infrared is skin's
    (validation/real_skin)."""
    inside = ndimage.binary_erosion(
        finger_mask(photographs["white"], WHITE_FRAME_PX / FINGER_MM), iterations=25
    )
    red, green = (
        ndimage.gaussian_filter(photographs["white"][..., k], 3.0)[inside] for k in (0, 1)
    )
    spread = [np.ptp(np.percentile(channel, (5, 95))) / channel.mean() for channel in (red, green)]
    assert spread[0] < 0.08
    assert spread[1] > 0.4
