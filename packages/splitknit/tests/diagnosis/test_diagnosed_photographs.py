"""Photographs against each other: gains of the lights, and which photograph does not fit."""

import cv2
import numpy as np
import pytest

import splitknit
from rough_dome import scene, spoilt
from splitknit.diagnosis.photographs import faulty_photographs
from splitknit.errors import BadInput
from splitknit.photometric.forward import unequal


def test_sound_photographs_have_no_fault():
    stack, lights, mask = scene()
    assert faulty_photographs(stack, lights, mask, 0.98) == ()


@pytest.mark.parametrize(
    "kind", ["moved", "double", "blurred", "overexposed", "underexposed", "unlike"]
)
def test_a_faulty_photograph_and_its_fault_are_named(kind):
    stack, lights, mask = scene(1)
    stack[5] = spoilt(stack[5], kind)
    faults = faulty_photographs(stack, lights, mask, 0.7)
    assert [(fault.photograph, fault.kind) for fault in faults] == [(5, kind)]
    if kind in {"moved", "double", "blurred"}:
        assert faults[0].size == pytest.approx({"blurred": 2.5}.get(kind, 3.6), abs=0.6)
    # the floats of the former are exact, the latter is not used
    if kind not in {"underexposed", "overexposed"}:
        assert faults[0].effect_deg > 0.05


@pytest.mark.parametrize("k", [3, 7])
def test_a_small_shift_is_no_double_image(k):
    stack, lights, mask = scene(1)
    matrix = np.array([[1, 0, 1.3], [0, 1, 0.6]])
    stack[k] = cv2.warpAffine(
        stack[k], matrix, (110, 110), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    faults = faulty_photographs(stack, lights, mask, 0.98)
    assert [(fault.photograph, fault.kind) for fault in faults] == [(k, "moved")]


@pytest.mark.parametrize("kind", ["moved", "blurred"])
def test_a_fault_has_its_name_where_a_light_ends_beside_every_pixel(kind: str) -> None:
    """Under many raking lights a rough thing has no place that all of them reach."""
    random = np.random.default_rng(0)
    height = cv2.GaussianBlur(random.standard_normal((160, 160)), (0, 0), 3)
    down, right = np.gradient(2 * height / height.std())
    normals = np.dstack([-right, down, np.ones_like(height)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    azimuth = 2 * np.pi * np.arange(24) / 24
    elevation = np.deg2rad(np.where(np.arange(24) % 2, 20, 45))
    across = np.cos(elevation)
    lights = np.column_stack(
        [across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)]
    )
    stack = np.clip(np.moveaxis(normals @ lights.T, -1, 0), 0, None).astype(np.float32)
    stack += 0.002 * random.random(stack.shape, dtype=np.float32)
    inside = np.zeros(height.shape, dtype=bool)
    inside[5:-5, 5:-5] = True
    assert faulty_photographs(stack, lights, inside) == ()
    stack[7] = spoilt(stack[7], kind)
    faults = faulty_photographs(stack, lights, inside)
    assert [(fault.photograph, fault.kind) for fault in faults] == [(7, kind)]


def test_what_was_left_out_is_accused_once_and_no_other():
    stack, lights, mask = scene(1)
    stack[2] = np.roll(stack[2], (6, 9), (0, 1))
    result = splitknit.reconstruct_images(np.clip(stack, 0, 1), lights, mask, 10.0)
    assert [finding.files for finding in result.findings] == [("image 2",)]
    assert len(result.facts["light_residual_per_image"]) == 7


def test_two_faulty_photographs_are_named():
    stack, lights, mask = scene(2)
    stack[1], stack[6] = spoilt(stack[1], "moved"), spoilt(stack[6], "blurred")
    assert {fault.photograph for fault in faulty_photographs(stack, lights, mask)} == {1, 6}


def test_four_photographs_are_too_few_to_compare():
    stack, lights, mask = scene()
    stack[1] = spoilt(stack[1], "moved")
    assert faulty_photographs(stack[:4], lights[:4], mask) == ()


def test_gains_of_the_lights_are_estimated():
    stack, lights, mask = scene()
    gains = np.array([1, 3, 0.4, 1.5, 0.7, 1, 2, 0.5])
    light = (stack * gains[:, None, None])[:, mask].astype(np.float32)
    estimated = np.exp(unequal(light, lights.astype(np.float32)).gains)
    assert estimated == pytest.approx(gains / np.exp(np.log(gains).mean()), rel=0.02)


def test_arrays_that_disagree_are_refused():
    stack, lights, mask = scene()
    with pytest.raises(BadInput, match="differ in number"):
        faulty_photographs(stack, lights[:7], mask)
