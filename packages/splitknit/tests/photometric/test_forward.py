"""Things that shine: a lobe of gloss is estimated with the normals."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.model import Camera, Led, Rig
from splitknit.photometric.forward import fitted_gloss, glossy_fit, hypotheses, matt_misfit
from splitknit.photometric.near_light import near_light
from splitknit.photometric.robust import robust_fit

SIDE = 40


def lights(count: int = 16) -> np.ndarray:
    """Distant lights on two rings."""
    azimuth = 2 * np.pi * np.arange(count) / count
    slant = np.deg2rad(np.where(np.arange(count) % 2, 22.0, 44.0))
    return np.column_stack(
        [np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.cos(slant)]
    )


def relief() -> np.ndarray:
    """(3, n) unit normals of a plate with dents, up to 25 deg steep."""
    y, x = np.mgrid[0:SIDE, 0:SIDE] / SIDE
    slopes = 0.45 * np.sin(9 * x + 2 * y), 0.35 * np.cos(7 * y - 3 * x)
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(x)]).reshape(3, -1)
    return normals / np.linalg.norm(normals, axis=0)


def photographed(
    normals: np.ndarray, towards: np.ndarray, gloss: float, power: float
) -> np.ndarray:
    """(L, n) light of a matt and a Blinn-Phong part, with noise of half a percent."""
    half = towards + np.array([0, 0, 1.0])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    matt = np.maximum(towards @ normals, 0.0)
    images = (1 - gloss) * matt + gloss * np.maximum(half @ normals, 0.0) ** power * (matt > 0)
    noise = 1 + 0.005 * np.random.default_rng(1).standard_normal(images.shape)
    return (images * noise).astype(np.float32)


def error_deg(g: np.ndarray, normals: np.ndarray) -> float:
    cosine = (g * normals).sum(axis=0) / np.linalg.norm(g, axis=0)
    return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))))


@pytest.mark.parametrize(
    ("gloss", "power", "matt_deg", "limit_deg"), [(0.9, 30.0, 8.0, 2.0), (0.3, 60.0, 1.2, 0.7)]
)
def test_normals_of_metal_and_lacquer(gloss, power, matt_deg, limit_deg) -> None:
    normals, towards = relief(), lights()
    images = photographed(normals, towards, gloss, power)
    lobe = fitted_gloss(images, towards.astype(np.float32))
    assert lobe is not None
    assert lobe.misfit < 0.5 * matt_misfit(images, towards.astype(np.float32))
    assert (np.diff(lobe.lobe) <= 0).all()
    assert error_deg(robust_fit(images, towards.astype(np.float32)), normals) > matt_deg
    assert error_deg(glossy_fit(images, towards.astype(np.float32), lobe), normals) < limit_deg


def test_a_matt_thing_and_few_lights_have_no_lobe() -> None:
    normals = relief()
    for count, gloss in ((16, 0.0), (6, 0.9)):
        towards = lights(count)
        images = photographed(normals, towards, gloss, 30.0)
        assert fitted_gloss(images, towards.astype(np.float32)) is None


def test_near_lights_shine_on_gloss_from_their_places() -> None:
    """A flat plate under lights 60 mm away: its normals face the camera everywhere."""
    camera = Camera(4.0, (SIDE, SIDE))
    places = 60.0 * lights()
    y, x = (np.mgrid[0:SIDE, 0:SIDE] - (SIDE - 1) / 2) / 4.0
    points = np.stack([x, -y, np.zeros_like(x)]).reshape(3, -1)
    away = places[:, :, None] - points
    distance = np.linalg.norm(away, axis=1)
    half = away / distance[:, None] + np.array([0, 0, 1.0])[:, None]
    cosine = half[:, 2] / np.linalg.norm(half, axis=1)
    images = (cosine**40.0 / distance**2 * 2000.0).astype(np.float32)
    rig = Rig(camera, tuple(Led("white", tuple(place)) for place in places.tolist()))
    vectors = (away / distance[:, None] ** 3).astype(np.float32)
    lobe = fitted_gloss(images, vectors)
    assert lobe is not None
    normals, _ = near_light(images.reshape(-1, SIDE, SIDE), rig, 0.0, gloss=lobe)
    slant = np.degrees(np.arccos(np.clip(normals[..., 2], -1, 1)))
    assert np.percentile(slant, 95) < 1.0


@pytest.mark.parametrize("gloss", [0.0, 0.3, 0.9])
def test_lamps_that_differ_are_told_from_gloss(gloss: float) -> None:
    normals, towards = relief(), lights()
    images = photographed(normals, towards, gloss, 30.0)
    lamps = 1 + 0.12 * np.sin(2.1 * np.arange(16) + 0.3)
    name = "both" if gloss else "unequal"
    equal = "glossy" if gloss else "matt"
    sound = hypotheses(images, towards.astype(np.float32))
    assert sound[equal].misfit < 2 * sound[name].misfit
    unequal = hypotheses((images.T * lamps).T.astype(np.float32), towards.astype(np.float32))
    assert unequal[equal].misfit > 3.3 * unequal[name].misfit
    error = unequal[name].gains - np.log(lamps) + np.log(lamps).mean()
    assert error.std() < 0.05
