"""Backs of fingers: creases that are their owner's."""

from __future__ import annotations

import numpy as np

from script_folder import VALIDATION, scripts_of

with scripts_of(VALIDATION / "match") as script:
    knuckle = script("knuckle")
draw_knuckle, knuckle_pose = knuckle.draw_knuckle, knuckle.knuckle_pose


def test_creases_stay_and_all_depths_change_together() -> None:
    one, again, other = draw_knuckle(3), draw_knuckle(3, 1), draw_knuckle(4)
    assert one.skin.ridge_depth_um == 0.0
    places = [[crease.v_mm for crease in each.skin.creases] for each in (one, again, other)]
    assert places[0] == places[1] != places[2]
    ratio = [
        a.depth_mm / b.depth_mm for a, b in zip(one.skin.creases, again.skin.creases, strict=True) if b.depth_mm > 0.05
    ]
    assert np.ptp(ratio) < 1e-9
    assert abs(np.log(ratio[0])) > 1e-3
    poses = [knuckle_pose(np.random.default_rng(seed)).insertion_mm for seed in (0, 0, 1)]
    assert poses[0] == poses[1] != poses[2]
