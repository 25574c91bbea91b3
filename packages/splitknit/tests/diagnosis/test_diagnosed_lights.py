"""Places of the lights, on a matt ellipsoid that darkens towards its flanks as skin does."""

from dataclasses import replace

import numpy as np
import pytest

from splitknit.diagnosis.lights import doubt_of_places, fitted_places
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import View
from splitknit.model import Camera, Led, Rig
from splitknit.skin.light import fresnel_transmission

PITCH_MM = 0.8
AXIS = np.arange(-12.0, 12.01, PITCH_MM)


def _rig(
    height_mm: float = 140.0, radius_mm: float = 52.5, x_mm: float = 0.0, y_mm: float = 0.0
) -> Rig:
    angles = 2 * np.pi * np.arange(7) / 7
    places = [
        (radius_mm * np.cos(a) + x_mm, radius_mm * np.sin(a) + y_mm, height_mm) for a in angles
    ]
    return Rig(
        Camera(10.0, (300, 300)), tuple(Led("white", (float(x), float(y), z)) for x, y, z in places)
    )


def _doubt(stated: Rig) -> str:
    x, y = np.meshgrid(AXIS, AXIS[::-1])
    z = 8.0 * np.sqrt(np.maximum(1 - (x / 8.5) ** 2 - (y / 14.0) ** 2, 1e-3))
    normals = np.stack([x / 8.5**2, y / 14.0**2, z / 8.0**2])
    normals /= np.linalg.norm(normals, axis=0)
    mask = normals[2] > 0.4
    vectors = light_vectors_at(_rig(), *(a.astype(np.float32) for a in (x, y, z - 6.0)))
    cosine = np.einsum("kahw,ahw->khw", vectors, normals) / np.linalg.norm(vectors, axis=1)
    cosine = np.maximum(cosine, 0.05)
    entering = fresnel_transmission(cosine) * cosine**0.15
    albedo = np.exp(-0.3 * (1 - normals[2]))
    stack = (albedo * entering * np.einsum("kahw,ahw->khw", vectors, normals) * mask).astype(
        np.float32
    )
    depth_mm = np.where(mask, 2.0, 0.0).astype(np.float32)
    places = fitted_places(stack, stated, mask, depth_mm, View(AXIS, AXIS[::-1]), PITCH_MM)
    assert places is not None
    return str(doubt_of_places(places, stated) or "")


def test_stated_places_are_not_doubted():
    assert not _doubt(_rig())


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        (_rig(height_mm=180.0), "seem to be 0."),
        (_rig(height_mm=100.0), "seem to be 1."),
        (_rig(radius_mm=40.0), "their ring 1."),
        (_rig(radius_mm=65.0), "their ring 0."),
        (_rig(x_mm=8.0), "the middle of the LEDs' ring"),
        (_rig(x_mm=-6.0, y_mm=-6.0), "the middle of the LEDs' ring"),
    ],
)
def test_wrongly_stated_places_are_named(stated, words):
    assert words in _doubt(stated)


def test_few_or_distant_lights_have_no_fitted_places():
    few = replace(_rig(), leds=_rig().leds[:5])
    distant = replace(
        few, leds=tuple(Led("white", direction=(np.cos(a), np.sin(a), 2.0)) for a in range(7))
    )
    mask = np.ones((31, 31), bool)
    for rig in (few, distant):
        stack, depth_mm = np.ones((len(rig.leds), 31, 31), np.float32), mask.astype(np.float32)
        assert fitted_places(stack, rig, mask, depth_mm, View(AXIS, AXIS), PITCH_MM) is None
