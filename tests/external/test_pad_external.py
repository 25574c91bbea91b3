"""Real photographs of an opaque gel are not skin, and path-traced live fingers no attacks."""

import cv2
import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.capture import Band, Capture
from splitknit.io.capture import read_capture
from splitknit.model import Camera, Led, Rig
from splitknit.pipeline import reconstruct

with scripts_of(VALIDATION / "pad") as script:
    detector = script("detector")

judge, not_covered = detector.judge, detector.not_covered
pad_features, pad_images = detector.pad_features, detector.pad_images
pytestmark = pytest.mark.external


@pytest.mark.parametrize("part", ["BGA-001", "Flat-001"])
@pytest.mark.parametrize("material", ["skin", "opaque"])
def test_an_opaque_gel_is_no_skin(data_dir, part, material):
    folder = data_dir / "elastomer" / part
    if not folder.is_dir():
        pytest.skip("data set is absent")
    with scripts_of(VALIDATION / "accuracy") as script:
        lights = script("light_orders").lights_of_balls(data_dir)
    files = [folder / f"image{k:02d}.png" for k in range(7, 13)]
    images = [
        cv2.resize(cv2.imread(str(file), 0), None, fx=1 / 8, fy=1 / 8, interpolation=cv2.INTER_AREA)
        for file in files
    ]
    strength = np.linalg.norm(lights, axis=1)
    leds = tuple(
        Led("white", direction=tuple(light / s), intensity=float(s))
        for light, s in zip(lights, strength, strict=True)
    )
    stack = np.stack(images)[..., None]
    band = Band("white", stack, tuple((k,) for k in range(6)), np.ones(6), np.zeros(6))
    camera = Camera(1 / 0.0034035 / 8, stack.shape[1:3])
    capture = Capture(
        Rig(camera, leds),
        {"white": band},
        material=material,
        mask=np.ones(stack.shape[1:3], dtype=bool),
    )
    assert judge(pad_features(pad_images(capture), reconstruct(capture, "metric"))).answer != "live"
    assert not_covered(capture)  # and its verb says why: one band, and coarse


@pytest.mark.slow
@pytest.mark.parametrize("part", ["loop", "print", "polarised/d17_pol", "side_lights/d41_pol"])
def test_live_fingers_of_another_renderer_are_no_attacks(data_dir, part):
    folder = data_dir / "path_traced" / part
    if not folder.is_dir():
        pytest.skip("data set is absent")
    capture = read_capture(folder)
    judgement = judge(pad_features(pad_images(capture), reconstruct(capture, "metric")))
    assert not_covered(capture) == "" and judgement.answer != "attack"
