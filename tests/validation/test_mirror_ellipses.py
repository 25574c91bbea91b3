"""The thesis's shape from one mirror, beside the fit to all outlines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mirrored import scene
from script_folder import VALIDATION, Script

FOLDER = VALIDATION / "mirror"


def test_the_method_of_the_thesis_gives_a_coarser_shape(script: Script) -> None:
    finger = scene(9002)
    left = replace(finger.views, mirrors={"left": finger.views.mirrors["left"]})
    shape = script("ellipses").ellipses(left, finger.rig)
    assert finger.rms_mm(shape) < 0.35
    assert np.isfinite(shape.points(slice(None), slice(None))[2]).sum() > 0.85 * finger.mask.sum()
