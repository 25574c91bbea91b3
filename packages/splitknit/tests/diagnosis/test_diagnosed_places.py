"""Directions of lights that are near: a flat plate on flat ground comes out bowed, unless the
ground's light is read."""

from __future__ import annotations

import numpy as np
import pytest

import splitknit
from splitknit.observation.plain import capture_of_arrays

PX_PER_MM = 3.0
SIDE = 216


def plate(distance_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Photographs of a round plate on darker ground, both flat and matt, under 16 lights that far
    from the picture's middle; directions from there, and the plate's mask."""
    slant = np.deg2rad(np.where(np.arange(16) % 2, 30.0, 55.0))
    azimuth = 2 * np.pi * np.arange(16) / 16
    directions = np.column_stack(
        [np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.cos(slant)]
    )
    y, x = (np.mgrid[0:SIDE, 0:SIDE] - (SIDE - 1) / 2) / PX_PER_MM
    points = np.stack([x, -y, np.zeros_like(x)], axis=-1)
    mask = np.hypot(x, y) < 12.0
    away = distance_mm * directions[:, None, None] - points
    light = away[..., 2] / np.linalg.norm(away, axis=-1) ** 3 * distance_mm**2
    images = np.where(mask, 0.6, 0.2) * light
    images *= 1 + 0.01 * np.random.default_rng(0).standard_normal(images.shape)
    return np.rint(30_000 * images).clip(0, 65535).astype(np.uint16), directions, mask


def bow_mm(result: splitknit.Reconstruction) -> float:
    """Height of the middle above the rim of a 24 mm plate."""
    y, x = (np.mgrid[0:SIDE, 0:SIDE] - (SIDE - 1) / 2) / PX_PER_MM
    radius = np.hypot(x, y)
    height_mm = result.height_mm
    rim = result.mask & (radius > 10.5)
    return float(height_mm[radius < 2].mean() - height_mm[rim].mean())


def test_a_flat_plate_comes_out_flat_by_the_ground_beside_it() -> None:
    capture, _ = capture_of_arrays(*plate(70.0), PX_PER_MM, np.ones(16))
    stated = splitknit.reconstruct(capture, settings={"lights.places": "stated"})
    fitted = splitknit.reconstruct(capture)
    assert {"near-lights", "light-order"} & {each.code for each in fitted.findings} == {
        "near-lights"
    }
    assert np.shape(fitted.facts["light_places_mm"]) == (16, 3)
    assert "near-lights" not in {finding.code for finding in stated.findings}
    assert abs(bow_mm(stated)) > 0.5
    assert abs(bow_mm(fitted)) < 0.05


def test_exchanged_photographs_are_named_by_the_ground() -> None:
    images, directions, mask = plate(70.0)
    images[[3, 10]] = images[[10, 3]]
    capture, _ = capture_of_arrays(images, directions, mask, PX_PER_MM, np.ones(16))
    findings = splitknit.reconstruct(capture).findings
    assert ("light-order", ("image 3", "image 10")) in {
        (each.code, each.files) for each in findings
    }


@pytest.mark.parametrize("light", [2000.0, None])
def test_nothing_is_said_of_distant_lights_or_without_a_scale(light: float | None) -> None:
    images, directions, mask = plate(light or 70.0)
    scale = PX_PER_MM if light else None
    capture, _ = capture_of_arrays(images, directions, mask, scale, np.ones(16))
    assert "near-lights" not in {each.code for each in splitknit.reconstruct(capture).findings}
