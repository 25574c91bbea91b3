"""What is fitted: a body and mirrors' poses, and how far they are from planes that touch the finger."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitknit.mirrors.body import MOST_SQUARE, Body
from splitknit.mirrors.planes import MirrorPlane, Touching

Array = NDArray[np.float64]

STATIONS = 80
"""Places along the body at which a plane seen from the tip is tried."""
LIMITS = {
    "tip_mm": (-1.0, 1.0),
    "squareness": (-0.15, 0.15),
    "shear": (-0.2, 0.2),
    "shear_slope": (-0.2, 0.2),
    "turn_rad": (-0.04, 0.04),
    "lean_rad": (-0.04, 0.04),
    "shift_mm": (-2.0, 2.0),
}
"""Of one correction."""


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Measured slopes of the skin at places of the front view."""

    places_mm: Array
    """(n, 2) on the finger plane."""
    x: Array
    """(n,) dz/dx."""
    y: Array
    """(n,) dz/dy."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenIn:
    """One mirror: what is seen in it, and where it nominally is."""

    touching: Touching
    """As the camera sees it, not yet reflected."""
    plane: MirrorPlane
    about_mm: Array
    """(3,) point of the mirror about which it turns."""
    from_tip: bool = False
    """Whether it looks along the finger."""
    turn_rad: float = 0.0
    """What the tips of the views say about its turn."""
    turn_sd_rad: float | None = None
    """Standard deviation of that; None: they say nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """How a mirror differs from its nominal pose."""

    turn_rad: float = 0.0
    lean_rad: float = 0.0
    shift_mm: float = 0.0

    def of(self, seen: SeenIn) -> MirrorPlane:
        """The mirror where it is."""
        return seen.plane.moved(self.turn_rad, self.lean_rad, self.shift_mm, seen.about_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The result."""

    body: Body
    poses: Mapping[str, Pose]
    misfit_mm: Mapping[str, Array]
    """Distance (n,) of the body from each touching plane of ``front`` and every mirror, positive where it is too
    large."""
    weights: Mapping[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Body and poses between corrections."""

    body: Body
    poses: dict[str, Pose]

    def moved(self, name: str, by: float) -> State:
        """With one of the parameters that all sections share moved."""
        kind, _, mirror = name.partition(" ")
        if mirror:
            pose = self.poses[mirror]
            return State(self.body, {**self.poses, mirror: replace(pose, **{kind: getattr(pose, kind) + by})})
        return State(replace(self.body, **{kind: getattr(self.body, kind) + by}), self.poses)

    def stepped(self, step: Array, names: list[tuple[str, float]], count: int) -> State:
        """After a correction: of the splines' 4 x `count` coefficients first, then of the parameters `names`.

        One that goes beyond a limit is shortened as a whole: lean and shift of a mirror belong together.
        """
        sizes = [
            abs(float(by)) / LIMITS[name.partition(" ")[0]][1]
            for (name, _), by in zip(names, step[4 * count :], strict=True)
        ]
        step = step / max(1.0, *sizes)
        state = State(self.body.grown(step[: 4 * count]), self.poses)
        for (name, _), by in zip(names, step[4 * count :], strict=True):
            state = state.moved(name, float(by))
        return State(convex(state.body), state.poses)


def convex(body: Body) -> Body:
    """The body with a squareness at which its sections are convex."""
    return replace(body, squareness=float(np.clip(body.squareness, -0.2, MOST_SQUARE)))


def all_planes(state: State, front: Touching, mirrors: Mapping[str, SeenIn], names: list[str]) -> list[Touching]:
    """Planes of the front view and of the mirrors `names`, as they touch the finger itself."""
    return [front, *(state.poses[name].of(mirrors[name]).reflect(mirrors[name].touching) for name in names)]


def stations(body: Body, planes: Touching, *, from_tip: bool) -> tuple[Array, Array, Array]:
    """Where along the body each plane touches it: u (n,), and the planes' normals and points in the finger's frame."""
    normal = body.to_frame(planes.normal, place=False)
    point = body.to_frame(planes.point, place=True)
    if from_tip:
        u = body.tip_mm - body.length_mm * np.linspace(0.0, 1.0, STATIONS) ** 2
        sections = body.sections(u)
        reach = sections.support(normal[:, :1], normal[:, 2:])[0] + normal[:, 1:2] * u  # (n, STATIONS)
        return np.asarray(u[np.argmax(reach, axis=1)]), normal, point
    direction = body.to_frame(planes.direction, place=False)
    within = np.maximum(direction[:, 0] ** 2 + direction[:, 2] ** 2, 1e-6)
    u = point[:, 1] + 0.0
    for _ in range(3):
        t, z = body.sections(u).contact(normal[:, 0], normal[:, 2])
        far = ((t - point[:, 0]) * direction[:, 0] + (z - point[:, 2]) * direction[:, 2]) / within
        u = point[:, 1] + far * direction[:, 1]
    return u, normal, point


def misfit_of(state: State, planes: Touching, *, from_tip: bool) -> tuple[Array, Array, Array, Array, Array]:
    """How far (n,) the body reaches beyond each plane; where it touches, the normals, derivatives by a and b."""
    body = state.body
    u, normal, point = stations(body, planes, from_tip=from_tip)
    support, by_a, by_b = body.sections(u).support(normal[:, 0], normal[:, 2])
    offset = (normal * point).sum(axis=1)
    residual = support + normal[:, 1] * u - offset
    if from_tip:  # what touches at the end of the model is not of the part that is modelled
        residual = np.where(u <= body.tip_mm - 0.98 * body.length_mm, 10.0, residual)
    return residual, u, normal, by_a, by_b


def all_misfits(state: State, front: Touching, mirrors: Mapping[str, SeenIn], names: list[str]) -> Array:
    """Of the front view and the mirrors `names`, one after the other."""
    tips = [False, *(mirrors[name].from_tip for name in names)]
    parts = all_planes(state, front, mirrors, names)
    return np.concatenate([misfit_of(state, part, from_tip=tip)[0] for part, tip in zip(parts, tips, strict=True)])


def touched(body: Body, planes: Touching) -> Array:
    """(n, 3) points of the body, rig's frame, at which planes of a view beside it touch."""
    u, normal, _ = stations(body, planes, from_tip=False)
    t, z = body.sections(u).contact(normal[:, 0], normal[:, 2])
    level = body.origin_mm + np.outer(t, body.across) + np.outer(u, body.axis)
    return np.column_stack([level, z])
