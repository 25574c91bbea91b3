"""Objects of validation/objects that were taken for faulty, or came out worse than they should."""

from __future__ import annotations

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.diagnosis.photographs import faulty_photographs
from splitknit.photometric.robust import robust


@pytest.fixture(scope="module")
def rendered():
    with scripts_of(VALIDATION / "objects") as script:
        yield script("render").rendered


@pytest.mark.parametrize(
    ("seed", "what"),
    [(228, "the step where another light ends"), (349, "gloss on the ribs of a vase")],
)
def test_a_sound_photograph_is_not_taken_for_blurred(rendered, seed, what):
    scene = rendered(seed)
    assert (
        faulty_photographs(scene.images.astype(np.float32) / 65535, scene.lights, scene.mask, 0.985)
        == ()
    ), what


def test_given_brightness_is_as_good_as_equal_lights(rendered):
    """Bright lights counted more: 0.7 deg above equal ones on this glossy bumpy plate."""
    degrees = []
    for strengths in (0.0, 0.3):
        scene = rendered(206, strengths=strengths)
        normals, _ = robust(
            scene.images.astype(np.float32), scene.lights * scene.intensities[:, None], scene.mask
        )
        cosine = np.clip((normals * scene.normals).sum(axis=2)[scene.mask], -1, 1)
        degrees.append(float(np.degrees(np.arccos(cosine)).mean()))
    assert degrees[1] < degrees[0] + 0.1


def test_shadows_are_cast_away_from_the_light(rendered):
    scene = rendered(606)
    for image, light in zip(scene.images, scene.lights, strict=True):
        facing = scene.mask & (scene.normals @ light > 0.8)
        assert np.mean(image[facing] < 0.1 * np.median(image[facing])) < 0.01
