"""Light that reaches only part of the finger, and light by way of a mirror."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.imaging.light_field import light_vectors_at
from splitknit.model import Camera, Led, Rig, Shade

CAMERA = Camera(10.0, (20, 30))
X, Y = (
    np.ascontiguousarray(a) for a in np.meshgrid(np.linspace(-9, 9, 300), np.linspace(5, -5, 200))
)
Z = np.zeros_like(X)
PLACES = tuple(a.astype(np.float32) for a in (X, Y, Z))


def rig_of(*leds: Led) -> Rig:
    return Rig(CAMERA, leds)


def test_a_shade_dims_a_light_where_it_says() -> None:
    ramp = np.linspace(0, 1, 19, dtype=np.float32)[None].repeat(3, axis=0)
    led = Led("white", position_mm=(30.0, 0.0, 100.0))
    whole = light_vectors_at(rig_of(led), *PLACES)
    shaded = light_vectors_at(
        rig_of(replace(led, shade=Shade((-9.0, 9.0), (5.0, -5.0), ramp))), *PLACES
    )
    fraction = shaded[0, 2] / whole[0, 2]
    # 60 000 places: more than one line of OpenCV's
    assert np.abs(fraction - (X + 9) / 18).max() < 2e-3


def test_images_in_mirrors_add_light_and_do_not_change_what_an_exposure_is_called() -> None:
    led = Led("white", position_mm=(30.0, 0.0, 100.0))
    image = Led("white", position_mm=(120.0, 0.0, -5.0), intensity=0.5, reflected=True)
    alone, both = rig_of(led), rig_of(replace(led, also=(image,)))
    assert np.array_equal(alone.light_vectors(), both.light_vectors())
    added = light_vectors_at(both, *PLACES) - light_vectors_at(alone, *PLACES)
    far = np.array([120.0, 0.0, -5.0])
    at_origin = far / np.linalg.norm(far) ** 3 * 0.5
    own = np.array([30.0, 0.0, 100.0])
    expected = at_origin / np.linalg.norm(own / np.linalg.norm(own) ** 3)
    middle = added[0][:, 99:101, 149:151].mean(axis=(1, 2))
    assert np.allclose(middle, expected, rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize("fraction", [np.ones(4, np.float32), np.ones((1, 4), np.float32)])
def test_a_shade_needs_a_size(fraction: np.ndarray) -> None:
    with pytest.raises(BadInput, match="2 x 2"):
        Shade((0.0, 1.0), (0.0, 1.0), fraction)
