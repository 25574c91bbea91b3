"""Ridges, pores and bumps over a finger's body."""

import numpy as np
import pytest
from scipy import ndimage

from splitknit_simulator.finger.master_print import MasterPrintSettings, master_print
from splitknit_simulator.finger.skin_map import SkinRelief, skin_map


def test_bumps_are_soft_and_leave_the_ridges_as_they_are():
    master = master_print(
        "arch", 3, MasterPrintSettings(half_width_mm=8.0, distal_mm=20.0, proximal_mm=2.0)
    )
    v, u = np.meshgrid(np.arange(17.0, 1.0, -0.1), np.arange(-7.0, 7.0, 0.1), indexing="ij")
    even, bumpy = (
        skin_map(master, SkinRelief(undulation_mm=size, creases=())).displacement(u, v)
        for size in (0.0, 0.1)
    )
    bumps = bumpy - even
    assert bumps.max() < 0.01 and bumps.std() == pytest.approx(0.1, rel=0.35)
    assert (bumps - ndimage.gaussian_filter(bumps, 3.0)).std() < 0.008  # means over a ridge
