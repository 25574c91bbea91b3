"""Mirrors beyond the tip: they show the form of the largest sections."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from splitknit.mirrors.priors import SHEAR_SD, tukey
from splitknit.mirrors.settings import ANGLE_DEG, OFFSET_MM, OUTLINE_MM, ROW_MM, MirrorShapeSettings
from splitknit.mirrors.state import LIMITS, SeenIn, State, convex, misfit_of

Array = NDArray[np.float64]

TIP_TRUST = 0.1
"""Weight of a view from beyond the tip: it sees the largest sections only."""
COMMON_MM = 4.0
"""Points of an outline that are nearer to each other than this err together."""
SURE_FROM = 2
"""Corrections before points of an outline may be left out altogether."""
SETTLED = 2e-4
"""A correction (mm, rad) below this is the last one."""


def fitted_ends(
    state: State,
    mirrors: Mapping[str, SeenIn],
    ends: list[str],
    names: list[tuple[str, float]],
    settings: MirrorShapeSettings,
) -> State:
    """With those parameters fitted to the views from beyond the tip."""
    spread = {"squareness": settings.squareness_spread, "shear": 0.5 * SHEAR_SD, "shift_mm": OFFSET_MM}
    expected = {"squareness": state.body.squareness, "shear": state.body.shear}

    def misfit(state: State) -> Array:
        return np.concatenate([misfit_of_end(state, mirrors, name) for name in ends])

    for turn in range(8):
        residual = misfit(state)
        jacobian = np.column_stack([(misfit(state.moved(name, size)) - residual) / size for name, size in names])
        scale = max(OUTLINE_MM, 1.4826 * float(np.median(np.abs(residual))))
        weight = tukey(residual, 4.685 * scale) if turn > SURE_FROM else (np.abs(residual) < 5.0).astype(np.float64)
        weight = weight * (TIP_TRUST * 2.0 * ROW_MM / COMMON_MM / OUTLINE_MM**2)
        normal = jacobian.T @ (weight[:, None] * jacobian)
        right = -jacobian.T @ (weight * residual)
        for k, (name, _) in enumerate(names):
            kind, _, mirror = name.partition(" ")
            size = spread.get(kind, float(np.deg2rad(ANGLE_DEG)))
            value = getattr(state.poses[mirror], kind) if mirror else getattr(state.body, kind)
            normal[k, k] += 1.0 / size**2
            right[k] += (expected.get(kind, 0.0) - value) / size**2
        step = np.linalg.solve(normal, right)
        for (name, _), by in zip(names, step, strict=True):
            state = state.moved(name, float(np.clip(by, *LIMITS[name.partition(" ")[0]])))
        state = State(convex(state.body), state.poses)
        if turn > SURE_FROM and float(np.abs(step).max()) < SETTLED:
            break
    return state


def misfit_of_end(state: State, mirrors: Mapping[str, SeenIn], name: str) -> Array:
    """Misfit of a mirror beyond the tip."""
    planes = state.poses[name].of(mirrors[name]).reflect(mirrors[name].touching)
    return misfit_of(state, planes, from_tip=True)[0]
