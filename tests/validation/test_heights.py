"""Brightness of heights under slanted light, measured on the simulator as on walks below the skin."""

from __future__ import annotations

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit_simulator.light.skin import Boundary, SkinOptics, SkinRanges
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture


@pytest.mark.slow
@pytest.mark.parametrize(("refraction", "walks"), [(0.0, (0.4, 1.0)), (0.67, (1.0, 1.8))])
def test_slanted_light_brightens_heights_as_much_as_in_walks_below_the_skin(refraction, walks):
    """What ln(1 / cos t) adds over what upright light shows, of red, green and blue: smallest and largest."""
    skin = SkinRanges(
        base=SkinOptics(boundary=Boundary(refraction=refraction)), glare=(0, 0), scattering_factor=(0.6, 0.6)
    )
    capture, truth = simulate_capture(9101, None, TwinSettings(scale=0.3, skin=skin))
    known = {name: np.asarray(truth[name]) for name in ("mask", "height_mm", "shape_mm")}
    with scripts_of(VALIDATION / "path_traced") as script:
        found = script("heights").brightness_of_heights(capture, known, 0.25)
    ratios = [oblique / upright for upright, oblique in found.values()]
    assert min(ratios) > 0.6 * walks[0] and max(ratios) < 1.2 * walks[1]
    assert ratios[0] > ratios[2]  # more in red than in blue
