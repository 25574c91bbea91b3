from __future__ import annotations

import numpy as np
import pytest

from splitknit.check import BadInput
from splitknit.types import Camera, Led, Rig


def rig_of(*leds: Led) -> Rig:
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
def test_cameras_that_cannot_be(changes: dict[str, object], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        Camera(**{"px_per_mm": 10.0, "image_size": (4, 5), **changes})
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
        ({"position_mm": (5, 5, -1)}, "above"),
    ],
)
def test_lights_that_cannot_be(changes: dict[str, object], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        Led("white", **changes)


def test_strength_falls_with_the_square_of_the_distance() -> None:
    vectors = rig_of(
        Led("white", position_mm=(0, 0, 100)),
        Led("white", position_mm=(0, 0, 200)),
        Led("white", position_mm=(0, 300, 400), intensity=25.0),
    ).light_vectors()
    lengths = np.linalg.norm(vectors, axis=1)
    np.testing.assert_allclose(lengths / lengths[0], [1.0, 0.25, 1.0])
    assert lengths.mean() == pytest.approx(1.0)
    np.testing.assert_allclose(vectors[2] / lengths[2], [0.0, 0.6, 0.8])


def test_lights_of_one_exposure_add() -> None:
    leds = [
        Led("white", direction=d, intensity=i) for d, i in (((0, 0, 1), 1.0), ((0, 0.6, 0.8), 2.0), ((1, 0, 0), 1.0))
    ]
    rig = rig_of(*leds).select([(0, 1), (2,), (0,)])
    assert len(rig.leds) == 3
    expected = np.array([[0, 1.2, 2.6], [1, 0, 0], [0, 0, 1]], dtype=float)
    np.testing.assert_allclose(rig.light_vectors(), expected / np.linalg.norm(expected, axis=1).mean())
    with pytest.raises(BadInput, match="LED 3 is not in the rig"):
        rig_of(*leds).select([(0, 3)])
    with pytest.raises(BadInput, match="at least one LED"):
        rig_of(*leds).select([()])
    opposite = [Led("white", direction=(1, 0, 0)), Led("white", direction=(-1, 0, 0))]
    with pytest.raises(BadInput, match="cancel"):
        rig_of(*opposite).select([(0, 1)]).light_vectors()
