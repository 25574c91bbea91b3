import numpy as np
import pytest
from numpy.testing import assert_allclose

from refusals import bad_input
from splitknit.io.rig import rig_from_json, rig_to_json
from splitknit.model import Camera, Led, Mirror, Rig


def rig_of(*leds):
    return Rig(Camera(10.0, (40, 60)), leds)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"px_per_mm": 0.0}, "px_per_mm"),
        ({"px_per_mm": float("nan")}, "px_per_mm"),
        ({"height_mm": -1.0}, "height_mm"),
        ({"image_size": (0, 5)}, "image_size"),
        ({"model": "fisheye"}, "fisheye"),
        ({"model": "perspective"}, "matrix"),
    ],
)
def test_an_impossible_camera_is_refused(changes, words):
    with bad_input(words):
        Camera(**{"px_per_mm": 10.0, "image_size": (4, 5), **changes})


def test_the_pitch_is_the_inverse_of_the_scale():
    assert Camera(px_per_mm=8.0, image_size=(4, 5)).pitch_mm == 0.125


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "not neither"),
        ({"position_mm": (0, 0, 1), "direction": (0, 0, 1)}, "not both"),
        ({"position_mm": (0, float("nan"), 1)}, "finite"),
        ({"direction": (0, 0, 0)}, "zero"),
        ({"direction": (0, 0, 1), "intensity": 0.0}, "intensity"),
        ({"direction": (0, 0, 1), "lobe_exponent": -1.0}, "lobe_exponent"),
    ],
)
def test_an_impossible_led_is_refused(changes, words):
    with bad_input(words):
        Led("white", **changes)


def test_strength_falls_with_the_square_of_the_distance():
    vectors = rig_of(
        Led("white", position_mm=(0, 0, 100)),
        Led("white", position_mm=(0, 0, 200)),
        Led("white", position_mm=(0, 300, 400), intensity=25.0),
    ).light_vectors()
    lengths = np.linalg.norm(vectors, axis=1)
    assert_allclose(lengths / lengths[0], [1.0, 0.25, 1.0])
    assert lengths.mean() == pytest.approx(1.0)
    assert_allclose(vectors[2] / lengths[2], [0.0, 0.6, 0.8])


THREE_LEDS = rig_of(
    *(
        Led("white", direction=d, intensity=i)
        for d, i in (((0, 0, 1), 1.0), ((0, 0.6, 0.8), 2.0), ((1, 0, 0), 1.0))
    )
)


def test_lights_of_one_exposure_add():
    rig = THREE_LEDS.select([(0, 1), (2,), (0,)])
    assert len(rig.leds) == 3
    expected = np.array([[0, 1.2, 2.6], [1, 0, 0], [0, 0, 1]], dtype=float)
    assert_allclose(rig.light_vectors(), expected / np.linalg.norm(expected, axis=1).mean())


def test_exposures_without_light_are_refused():
    with bad_input("LED 3 is not in the rig"):
        THREE_LEDS.select([(0, 3)])
    with bad_input("at least one LED"):
        THREE_LEDS.select([()])
    opposite = [Led("white", direction=(1, 0, 0)), Led("white", direction=(-1, 0, 0))]
    with bad_input("cancel"):
        rig_of(*opposite).select([(0, 1)]).light_vectors()


RIGHT = ((12.0, -10.0, -15.0), (12.0, 20.0, -15.0), (26.0, 20.0, -1.0), (26.0, -10.0, -1.0))


def test_the_normal_of_a_mirror_does_not_depend_on_the_order_of_its_corners():
    mirror = Mirror("right", RIGHT, 0.85)
    assert_allclose(mirror.normal, np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0), atol=1e-12)
    assert_allclose(mirror.point_mm, [19.0, 5.0, -8.0])
    assert_allclose(Mirror("right", RIGHT[::-1]).normal, mirror.normal, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "corners", "reflectance", "words"),
    [
        ("above", RIGHT, 0.9, "left, right or tip"),
        ("right", RIGHT[:2], 0.9, "three"),
        ("right", (*RIGHT[:3], (26.0, -10.0, float("nan"))), 0.9, "finite"),
        ("right", ((0, 0, 0), (1, 0, 1), (2, 0, 2)), 0.9, "one line"),
        ("right", (*RIGHT[:3], (26.0, -10.0, 3.0)), 0.9, "one plane"),
        ("right", RIGHT, 0.0, "reflectance"),
        ("right", ((9, 0, 0), (9, 9, 0), (9, 9, 9), (9, 0, 9)), 0.9, "upright"),
    ],
)
def test_an_impossible_mirror_is_refused(name, corners, reflectance, words):
    with bad_input(words):
        Mirror(name, corners, reflectance)


def test_a_rig_file_keeps_its_mirrors():
    led = Led("white", position_mm=(52.5, 0.0, 140.0))
    rig = Rig(Camera(45.0, (40, 60)), (led,), {}, (Mirror("right", RIGHT, 0.85),))
    document = rig_to_json(rig)
    assert rig_from_json(document).mirrors == rig.mirrors
    assert "mirrors" not in rig_to_json(Rig(rig.camera, (led,)))
    document["mirrors"][0]["corners_mm"][1] = [1, 2]
    with bad_input(r"mirrors\[0\]\.corners_mm"):
        rig_from_json(document)
    with bad_input("different names"):
        Rig(rig.camera, (led,), {}, rig.mirrors * 2)


def test_only_an_image_in_a_mirror_may_lie_below_the_finger_plane():
    with bad_input("above"):
        Led("white", position_mm=(150.0, 0.0, -60.0))
    assert Led("white", position_mm=(150.0, 0.0, -60.0), reflected=True).reflected
