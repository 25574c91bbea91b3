"""Patches without ridges, and images of other ridges: a matt plane with ridges that curve, under a
ring of lights."""

import numpy as np
import pytest

from splitknit.diagnosis.relief import bare_patch, unlike_image

PX_PER_MM = 8.0
Y, X = np.mgrid[:176, :144] / PX_PER_MM
ANGLES = 2 * np.pi * np.arange(7) / 7
LIGHTS = np.stack([0.4 * np.cos(ANGLES), -0.4 * np.sin(ANGLES), np.ones(7)], axis=1)
MASK = ((X - 9.0) / 8.5) ** 2 + ((Y - 11.0) / 10.5) ** 2 < 1
PLASTER = (np.abs(X - 9.0) < 2.5) & (np.abs(Y - 10.0) < 3.0)


def _stack(bare: np.ndarray, albedo: float = 1.0, weave_um: float = 0.0) -> np.ndarray:
    """Light (7, h, w) of ridges 0.5 mm apart but where `bare`: there 0.3 mm higher, of another
    albedo, woven."""
    ridges = 0.02 * np.cos(2 * np.pi * np.hypot(X - 9.0, Y - 24.0) / 0.5)
    weave = 0.3 + 1e-3 * weave_um * np.cos(2 * np.pi * X / 0.45) * np.cos(2 * np.pi * Y / 0.45)
    down, across = np.gradient(np.where(bare, weave, ridges) * PX_PER_MM)
    light = [x * -across + y * down + z for x, y, z in LIGHTS]
    noise = np.random.default_rng(1).normal(0.0, 0.005, (7, *X.shape))
    return (np.where(bare, albedo, 1.0) * np.clip(light, 0.05, None) + noise).astype(np.float32)


def test_ridged_skin_is_not_doubted():
    assert bare_patch(_stack(np.zeros_like(MASK)), MASK, PX_PER_MM) == (0.0, 0.0)


def test_a_crease_and_a_scar_are_not_doubted():
    crease = np.abs(Y - 14.0 - 0.3 * np.sin(X)) < 0.4
    scar = (np.abs(X - 8.0) < 0.5) & (np.abs(Y - 7.0) < 3.0)
    assert bare_patch(_stack(crease | scar, 0.8), MASK, PX_PER_MM) == (0.0, 0.0)


@pytest.mark.parametrize(("albedo", "weave_um"), [(1.0, 0.0), (0.5, 0.0), (1.5, 3.0)])
def test_a_plaster_is_named_with_its_size(albedo, weave_um):
    area_mm2, _ = bare_patch(_stack(PLASTER, albedo, weave_um), MASK, PX_PER_MM)
    assert 0.5 * 30 < area_mm2 < 1.1 * 30


def test_a_strip_around_half_of_the_finger_is_named():
    assert bare_patch(_stack(np.abs(Y - 11.0) < 5.0), MASK, PX_PER_MM)[0] > 90


def test_coarse_small_or_dark_images_are_not_judged():
    stack = _stack(PLASTER)
    assert bare_patch(stack, MASK, 5.0) == (0.0, 0.0)
    assert bare_patch(stack, X < 1.0, PX_PER_MM) == (0.0, 0.0)
    dark = np.where(PLASTER, 0.1, 1.0).astype(np.float32)
    assert bare_patch(stack * dark, MASK, PX_PER_MM)[0] == 0


def test_images_of_one_relief_are_not_doubted():
    assert unlike_image(_stack(np.zeros_like(MASK)), LIGHTS, MASK, PX_PER_MM) is None
    assert unlike_image(_stack(MASK & (Y < 8.0)), LIGHTS, MASK, PX_PER_MM) is None


@pytest.mark.parametrize("fault", ["moved", "double", "another finger"])
def test_an_image_of_other_ridges_is_named(fault):
    stack = _stack(np.zeros_like(MASK))
    moved = np.roll(stack[2], 2, axis=0)
    stack[2] = {
        "moved": moved,
        "double": (stack[2] + moved) / 2,
        "another finger": np.roll(stack[2, ::-1], 3, axis=1),
    }[fault]
    assert unlike_image(stack, LIGHTS, MASK, PX_PER_MM) == 2
    assert unlike_image(stack[:5], LIGHTS[:5], MASK, PX_PER_MM) is None  # too few
    assert unlike_image(stack, LIGHTS, MASK, 5.0) is None  # too coarse
