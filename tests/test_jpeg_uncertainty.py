"""What JPEG may have taken stands in the relief's uncertainty, by scale."""

from dataclasses import replace

import numpy as np
import pytest

import splitknit
from splitknit_simulator import simulate_capture


@pytest.mark.slow
def test_coarse_jpeg_photographs_tell_little_of_the_relief():
    capture, _ = simulate_capture(3, settings={"scale": 0.08})  # 6 px/mm
    white = capture.bands["white"]
    named = replace(white, files=tuple(f"{k}.jpg" for k in range(len(white.pixels))))
    result = splitknit.reconstruct(replace(capture, bands={**capture.bands, "white": named}))
    inside = result.mask & np.isfinite(result.uncertainty_um)
    assert (result.uncertainty_um[inside] >= 899 * np.abs(result.ridge_mm[inside])).all()
    assert any(finding.code == "jpeg" for finding in result.findings)
