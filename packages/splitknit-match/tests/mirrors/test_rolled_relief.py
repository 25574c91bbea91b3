"""Ridges of a view of skin: a camera too coarse for the network is read on a grid twice as fine."""

import numpy as np
import pytest

from splitknit.finger.locate import FingerSettings
from splitknit.skin.images import MetricSettings
from splitknit_match.rolled.finger import Work
from splitknit_match.rolled.register import ridges_of
from splitknit_match.rolled.views import find_mirror_views
from splitknit_simulator.rigs import MirrorSettings
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture


@pytest.mark.slow
def test_a_camera_of_15_px_per_mm_shows_the_ridges_in_front_and_in_the_mirror():
    mirrors = MirrorSettings(names=("left",), nir=False)
    capture, truth = simulate_capture(11, None, TwinSettings(scale=0.35, mirrors=mirrors))
    px_per_mm = capture.rig.camera.px_per_mm
    assert px_per_mm < 17  # the network has learned 25 and more
    views = find_mirror_views(capture, FingerSettings())
    work = Work(capture, views, MetricSettings())
    for name, prefix, least in (("front", "", 0.75), ("left", "view_left_", 0.6)):
        view = work.reliefs[name]
        assert view.how == "network"
        true_mm = truth[f"{prefix}relief_um"][view.window] * np.float32(1e-3)
        inside = truth[f"{prefix}mask"][view.window]
        known = np.isfinite(view.relief_mm) & inside & (view.trust > 0.95)
        measured, true = (
            ridges_of(np.nan_to_num(relief), known, 1 / px_per_mm)[known]
            for relief in (view.relief_mm, true_mm)
        )
        assert np.corrcoef(measured, true)[0, 1] > least
        assert measured.std() > 0.5 * true.std()
