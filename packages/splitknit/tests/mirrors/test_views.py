"""Which part of a picture is the finger and which its mirror images; and pictures that are
refused."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit.errors import BadInput
from splitknit.imaging.areas import mirror_outline, without_mirrors
from splitknit.mirrors.views import view_binning, views_in
from splitknit.model import Camera, Mirror, Rig

CAMERA = Camera(5.0, (300, 460))
LEFT = Mirror(
    "left", ((-15.0, -25.0, -20.0), (-15.0, 12.0, -20.0), (-37.0, 12.0, 2.0), (-37.0, -25.0, 2.0))
)
RIGHT = Mirror(
    "right", ((15.0, -25.0, -20.0), (15.0, 12.0, -20.0), (37.0, 12.0, 2.0), (37.0, -25.0, 2.0))
)
MIRRORS = {"left": LEFT, "right": RIGHT}
RIG = Rig(CAMERA, (), mirrors=(LEFT, RIGHT))


@pytest.fixture(autouse=True)
def bright_pieces(monkeypatch):
    """The largest bright piece stands for the finger."""

    def region(image, px_per_mm):
        _, labels, stats, _ = cv2.connectedComponentsWithStats(
            (image.sum(axis=2) > 0.9).astype(np.uint8)
        )
        if len(stats) < 2 or stats[1:, cv2.CC_STAT_AREA].max() < 16 * px_per_mm**2:
            raise BadInput("no finger was found.")
        return np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))

    monkeypatch.setattr("splitknit.mirrors.views.finger_mask", region)


def picture(*fingers):
    """Fingers as bright strips: (first column, width); mirrors with grey frames and a second
    reflection."""
    image = np.full((300, 460, 3), 0.02, dtype=np.float32)
    for mirror in MIRRORS.values():
        corners = mirror_outline(mirror, CAMERA).round().astype(np.int32)
        cv2.fillPoly(image, [corners], (0.04, 0.04, 0.04))
        cv2.polylines(image, [corners], True, (0.2, 0.2, 0.2), 2)
    image[110:114, 20:40] = (0.6, 0.4, 0.3)  # a second reflection: small
    for first, width in fingers:
        bottom = 300 if 140 <= first < 300 else 262  # a mirror ends before the picture does
        image[100:bottom, first : first + width] = (0.6, 0.4, 0.3)
    return image


FRONT, BESIDE = (190, 80), ((70, 60), (330, 60))


def check_columns(views, scale):
    """Front, left and right view show the fingers FRONT and BESIDE in a picture of this scale."""
    masks = views.front, *(views.mirrors[name] for name in ("left", "right"))
    assert set(views.mirrors) == {"left", "right"}
    for mask, (first, width) in zip(masks, (FRONT, *BESIDE), strict=True):
        columns = np.flatnonzero(mask.any(axis=0))
        assert (columns[0], columns[-1]) == (scale * first, scale * (first + width) - 1)


def test_front_and_mirrors_are_distinguished():
    check_columns(views_in(picture(FRONT, *BESIDE), RIG, 1), 1)


def test_a_mirror_without_a_finger_is_left_out():
    assert set(views_in(picture(FRONT, BESIDE[1]), RIG, 1).mirrors) == {"right"}


@pytest.mark.parametrize("scale", [1, 4])
@pytest.mark.parametrize(
    ("fingers", "words"),
    [
        ((FRONT,), "no mirror shows the finger"),
        (BESIDE, "no finger was found beside the mirrors"),
        (((170, 50), (240, 48), *BESIDE), "two fingers"),
        (((140, 80), (79, 61), BESIDE[1]), "touches the edge of the left mirror"),
    ],
)
def test_pictures_without_one_finger_and_its_mirror_images_are_refused(fingers, words, scale):
    image, camera = large(*fingers) if scale == 4 else (picture(*fingers), CAMERA)
    with bad_input(words):
        views_in(image, replace(RIG, camera=camera), 1)


def test_a_rig_without_mirrors_is_refused():
    with bad_input("the rig has no mirrors"):
        views_in(picture(FRONT), replace(RIG, mirrors=()), 1)


def test_mirror_images_are_painted_over_and_the_finger_is_kept():
    """Where the shape comes from light."""
    image = without_mirrors(picture(FRONT, *BESIDE), CAMERA, MIRRORS, 1)
    assert image[200, 100].max() < 0.25 and image[200, 360].max() < 0.25
    assert image[200, 230, 0] == pytest.approx(0.6)
    assert view_binning(44.0) == 2 and view_binning(8.0) == 1


def large(*fingers):
    """The picture at four times the scale, one row and two columns larger."""
    image = np.kron(picture(*fingers), np.ones((4, 4, 1), dtype=np.float32))
    return np.pad(image, ((0, 1), (0, 2), (0, 0)), mode="edge"), Camera(20.0, (1201, 1842))


def test_views_are_found_at_any_scale():
    image, camera = large(FRONT, *BESIDE)
    views = views_in(image, replace(RIG, camera=camera), 1)
    assert views.binning == 1
    check_columns(views, 4)
    for mask in (views.front, *views.mirrors.values()):
        assert mask.shape == image.shape[:2]
        assert np.flatnonzero(mask.any(axis=1))[0] == 400
    assert np.flatnonzero(views.front.any(axis=1))[-1] == 1200
