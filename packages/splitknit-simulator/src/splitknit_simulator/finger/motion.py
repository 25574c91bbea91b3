"""A finger that does not lie still while it is photographed: drift, tremor, small turns, and skin
that slips.

A hand that holds still for seconds drifts slowly, as a random walk, and trembles at 8 to 12 Hz by a
small part of that. The finger turns a little with it (yaw and roll), and where it rests on
something its skin slips over the bone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from splitknit import Camera
from splitknit.model import Array
from splitknit.settings import Checked, Limits
from splitknit_simulator.camera.lens import pixels_of_points, sight_lines
from splitknit_simulator.finger.deformation import Deformation, deformed, draw_deformation
from splitknit_simulator.finger.finger import (
    FingerPose,
    SimulatedFinger,
    finger_surface,
    placement_of,
)
from splitknit_simulator.finger.master_print import MasterPrint
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.surface import SimulatedSurface, Truth

_SHOT_S = 0.5
"""Time from shot to shot. Source: thesis, 14 photographs in 7 s."""
_TREMOR_HZ = (8.0, 12.0)
"""Frequencies of physiological tremor. Source: Elble and Koller 1990."""


@dataclass(frozen=True, slots=True)
class HandMotion(Checked):
    """How far and how a finger moves during a capture. Numbers are our choice where no source is
    named."""

    _group = "motion"

    amplitude_mm: Annotated[float, Limits(0.0, 3.0)] = 0.0
    """Largest distance between the finger's positions in any two shots; 0 = it lies still."""


@dataclass(frozen=True, slots=True, eq=False)
class _MotionPath:
    """Where the finger is in each of N shots, against the reference shot, whose values are zero."""

    time_s: Array  # (N,)
    shift_mm: Array  # (N, 2): x right, y up
    speed_mm_per_s: Array  # (N, 2) of the tremor, at the middle of the exposure
    yaw_rad: Array  # (N,)
    roll_rad: Array  # (N,)
    slip: Array  # (N, 2): fractions of two drawn fields of slip
    reference: int


_TREMOR_FRACTION = 0.05  # standard deviation, relative to the drift's amplitude


def draw_path(
    rng: np.random.Generator, shots: int, settings: HandMotion, reference: int
) -> _MotionPath:
    """Draw a path of N shots that is zero in the shot `reference`."""
    time: Array = np.asarray(np.arange(shots) * _SHOT_S, dtype=np.float64)
    drift = _walk(rng, shots, 2)
    frequency = rng.uniform(*_TREMOR_HZ, (3, 2))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 2))
    angle = 2.0 * np.pi * frequency * time[:, None, None] + phase
    tremor = np.sin(angle).sum(axis=1) * (_TREMOR_FRACTION * np.sqrt(2.0 / 3.0))
    speed = (2.0 * np.pi * frequency * np.cos(angle)).sum(axis=1) * (
        _TREMOR_FRACTION * np.sqrt(2.0 / 3.0)
    )
    path = drift / _spread(drift) + tremor
    scale = settings.amplitude_mm / _spread(path)
    yaw, roll = (
        walk[:, 0] / _spread(walk) for walk in (_walk(rng, shots, 1), _walk(rng, shots, 1))
    )
    slip = _walk(rng, shots, 2)

    def against(values: Array) -> Array:
        return np.asarray(values - values[reference])

    turned = np.deg2rad(settings.amplitude_mm)
    # between two shots a finger turns by at most 1.5 deg, its skin slips by 0.1 mm, a mm of motion
    return _MotionPath(
        time_s=time,
        shift_mm=against(path * scale),
        speed_mm_per_s=speed * scale,
        yaw_rad=against(yaw * turned * 1.5),
        roll_rad=against(roll * turned * 1.5),
        slip=against(slip / _spread(slip) * settings.amplitude_mm * 0.1),
        reference=reference,
    )


def _walk(rng: np.random.Generator, steps: int, width: int) -> Array:
    """(N, W) random walk."""
    return np.cumsum(rng.standard_normal((steps, width)), axis=0)


def _spread(path: Array) -> float:
    """Largest distance between two of its points."""
    return float(np.linalg.norm(path[:, None] - path[None], axis=-1).max())


# The surfaces of a moving finger, one for each shot, and where its skin goes in the pictures.


@dataclass(frozen=True, slots=True, eq=False)
class _MovingFinger:
    """A finger, its pose in the reference shot, and its path."""

    finger: SimulatedFinger
    pose: FingerPose
    camera: Camera
    master: MasterPrint
    path: _MotionPath
    slips: tuple[Deformation, Deformation]
    """Fields of slip whose weights are in `path.slip`; their largest shift is 1 mm."""

    def pose_of(self, shot: int) -> FingerPose:
        """How the finger lies in a shot."""
        x, y = self.path.shift_mm[shot]
        return replace(
            self.pose,
            x_mm=self.pose.x_mm + float(x),
            insertion_mm=self.pose.insertion_mm + float(y),
            yaw_rad=self.pose.yaw_rad + float(self.path.yaw_rad[shot]),
            roll_rad=self.pose.roll_rad + float(self.path.roll_rad[shot]),
        )

    def slip_of(self, shot: int) -> Deformation:
        """How the skin has slipped in a shot."""
        first, second = self.slips
        shift = self.path.slip[shot, 0] * first.shift_mm + self.path.slip[shot, 1] * second.shift_mm
        return Deformation(first.u_mm, first.v_mm, shift)

    def surfaces(self, workers: int = 2) -> Iterator[SimulatedSurface]:
        """Yield the surface of every shot, in the order in which they are taken; the threads do not
        change them."""
        for shot in range(len(self.path.time_s)):
            master = self.master
            if self.path.slip[shot].any():
                master = deformed(master, self.slip_of(shot))
            worn = replace(self.finger, printed=master)
            yield finger_surface(worn, self.pose_of(shot), self.camera, workers=workers)

    def truth(self, reference: SimulatedSurface) -> Truth:
        """Arrays by name: the path, and where the skin of the reference shot lies in every other
        picture.

        ``motion_flow_px`` (N, 2, h, w): columns and rows by which the skin that the reference shows
        at the pixels ``motion_rows`` (h,) x ``motion_columns`` (w,) lies elsewhere in shot k; NaN
        beside the finger.
        """
        path = self.path
        step = max(1, round(0.5 * self.camera.px_per_mm))  # every 0.5 mm
        rows, columns = (np.arange(step // 2, n, step) for n in reference.mask.shape)
        grid = np.ix_(rows, columns)
        inside = reference.mask[grid]
        flow = np.full((len(path.time_s), 2, *inside.shape), np.nan, dtype=np.float32)
        here = np.stack(
            [at[inside] for at in np.meshgrid(columns.astype(np.float64), rows.astype(np.float64))]
        )
        smooth = reference.shape_mm[grid][inside]
        points = sight_lines(self.camera, here[0], here[1]).at(smooth)
        body = FingerBody(self.finger.shape)
        on_finger = np.stack(placement_of(body, self.pose, self.camera).to_finger(*points))
        for shot in range(len(path.time_s)):
            slipped = on_finger + _slip(body, on_finger, self.slip_of(shot))
            placed = placement_of(body, self.pose_of(shot), self.camera)
            there = np.einsum("ij,jn->in", placed.rotation, slipped) + placed.shift[:, None]
            flow[shot][:, inside] = np.stack(pixels_of_points(self.camera, *there)) - here
        return {
            "motion_time_s": path.time_s,
            "motion_shift_mm": path.shift_mm,
            "motion_yaw_deg": np.rad2deg(path.yaw_rad),
            "motion_roll_deg": np.rad2deg(path.roll_rad),
            "motion_reference": np.array(path.reference),
            "motion_rows": rows,
            "motion_columns": columns,
            "motion_flow_px": flow,
        }


_SLIP_SIGMA_MM = 5.0  # smooths the slip over the skin


def moving_finger(
    finger: SimulatedFinger,
    pose: FingerPose,
    camera: Camera,
    path: _MotionPath,
    seed: np.random.SeedSequence,
) -> _MovingFinger:
    """Draw the motion of a finger that lies in `pose` in its reference shot; `seed`: of the
    slip."""
    master = finger.master()
    rng = np.random.default_rng(seed)
    unit_mm = 0.1 * _SLIP_SIGMA_MM
    fields = [draw_deformation(rng, master, unit_mm, _SLIP_SIGMA_MM) for _ in "12"]
    first, second = (
        Deformation(drawn.u_mm, drawn.v_mm, drawn.shift_mm * (1 / unit_mm)) for drawn in fields
    )
    return _MovingFinger(finger, pose, camera, master, path, (first, second))


def _slip(body: FingerBody, points: Array, slip: Deformation) -> Array:
    """(3, N) by which skin at `points` (3, N) of the finger's frame has slipped along the body."""
    step = 1e-3

    def chart(p: Array) -> Array:
        return np.stack(body.distance_and_chart(*p))

    here = chart(points)
    steps = step * np.eye(3)[..., None]
    turn = np.stack([chart(points + away) - chart(points - away) for away in steps])
    moved = slip.moved(here[1:].T).T - here[1:]
    wanted = np.concatenate([np.zeros((1, points.shape[1])), moved])
    matrices = np.moveaxis(turn / (2 * step), (0, 1), (2, 1))  # (N, chart, space)
    return np.asarray(np.linalg.solve(matrices, wanted.T[..., None])[..., 0].T)
