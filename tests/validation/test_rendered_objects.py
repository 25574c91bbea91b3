"""Objects of validation/objects that were taken for faulty, or came out worse than they should."""

from __future__ import annotations

import numpy as np
import pytest

import splitknit
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


def test_a_view_for_colmap_has_its_axes(tmp_path):
    """y runs down and z away from the camera; channel lies after channel."""
    y, x = np.mgrid[9.5:-10:-1, -9.5:10] / 20
    normals = np.dstack([x, y, np.sqrt(1 - x * x - y * y)]).astype(np.float32)
    result = splitknit.surface_of_normals(normals, np.ones((20, 20), dtype=bool), 16.0)
    with scripts_of(VALIDATION / "objects") as script:
        script("in_colmap").write_view(result, tmp_path)
        distance = script("in_colmap").DISTANCE_MM
    maps = {}
    for part, channels in (("depth_maps", 1), ("normal_maps", 3)):
        data = (tmp_path / f"stereo/{part}/view.png.geometric.bin").read_bytes()
        header = f"20&20&{channels}&".encode()
        assert data.startswith(header)
        maps[part] = np.frombuffer(data[len(header) :], "<f4").reshape(channels, 20, 20)
    inside = result.mask
    assert inside.sum() > 300
    depth = maps["depth_maps"][0][inside]
    assert np.allclose(distance - depth, result.height_mm[inside], atol=1e-3)
    turned = np.moveaxis(maps["normal_maps"], 0, 2)[inside]
    assert np.allclose(turned, result.normals[inside] * (1, -1, -1))
