"""Patterns that a projector throws on the skin: shifted checkerboards, and where they fall.

The projector stands where a light stands. Its checks have their stated size on the finger plane; on a surface above or
below that plane they are displaced along the projector's rays, so that they lie on the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import FloatArray, Led
from splitknit.simulator.lighting import Patch, cut_out
from splitknit.simulator.surface import Surface

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Checkerboard:
    """A checkerboard in all its shifts: `steps` x `steps` patterns, by a `steps`-th of the period each way."""

    check_mm: float
    """Side of one check on the finger plane."""
    steps: int = 5
    """Shifts along each axis; 5 gives the thesis's 25 patterns. With an even number every checkerboard occurs twice,
    since a shift by one check along both axes changes nothing."""
    alpha: float = 0.5
    """Share of the plane that is lit: 0.5 is the checkerboard; below it lit squares on dark, above it dark squares on
    light, one a period of two checks."""
    dark: float = 0.0
    """Light of the projector's dark checks, relative to its lit ones (b)."""
    edge_mm: float = 0.0
    """Width over which an edge goes from dark to lit, on top of one pixel: the projector's blur."""
    angle_rad: float = 0.0
    """Of the pattern's axes against the camera's, counter-clockwise."""
    phase_mm: tuple[float, float] = (0.0, 0.0)
    """Where the pattern starts: displacement of the first of its shifts along its own axes."""

    def __post_init__(self) -> None:
        require(
            bool(np.isfinite(self.check_mm)) and 0 < self.check_mm <= 50,
            f"checkerboard.check_mm must lie in (0, 50], but it is {self.check_mm}.",
        )
        require(2 <= self.steps <= 32, f"checkerboard.steps must be 2 to 32, but it is {self.steps}.")
        require(0.05 <= self.alpha <= 0.95, f"checkerboard.alpha must be 0.05 to 0.95, but it is {self.alpha}.")
        require(0 <= self.dark <= 0.9, f"checkerboard.dark must be 0 to 0.9, but it is {self.dark}.")
        require(
            0 <= self.edge_mm <= self.check_mm,
            f"checkerboard.edge_mm must be at most one check, but it is {self.edge_mm}.",
        )
        require(
            bool(np.isfinite(self.angle_rad)) and bool(np.isfinite(self.phase_mm).all()),
            "checkerboard.angle_rad and phase_mm must be finite numbers.",
        )

    @property
    def period_mm(self) -> float:
        """Two checks."""
        return float(2.0 * self.check_mm)

    def shifts_mm(self) -> Array:
        """(N, 2) displacement of every pattern along its two axes; the first axis changes fastest."""
        step = self.period_mm / self.steps * np.arange(self.steps)
        second, first = np.meshgrid(step, step, indexing="ij")
        return np.asarray(np.stack([first.ravel(), second.ravel()], axis=1) + np.asarray(self.phase_mm))

    def state(self, x: Array, y: Array, shift_mm: tuple[float, float] | Array, pitch_mm: float) -> FloatArray:
        """Light of the projector, in [dark, 1], at points of the finger plane.

        Parameters
        ----------
        x, y : coordinates in mm, any shape
        shift_mm : displacement of the pattern along its own axes
        pitch_mm : size of a pixel, over which an edge is averaged
        """
        u, v = turn(x, y, self.angle_rad)
        u, v = u - shift_mm[0], v - shift_mm[1]
        width = float(np.hypot(pitch_mm, self.edge_mm))
        if self.alpha == 0.5:
            signs = _wave(u, self.period_mm, self.check_mm, width) * _wave(v, self.period_mm, self.check_mm, width)
            lit = 0.5 + 0.5 * signs
        else:
            side = self.period_mm * float(np.sqrt(min(self.alpha, 1.0 - self.alpha)))
            waves = (_wave(u, self.period_mm, side, width), _wave(v, self.period_mm, side, width))
            square = (0.5 + 0.5 * waves[0]) * (0.5 + 0.5 * waves[1])
            lit = square if self.alpha < 0.5 else 1.0 - square
        return np.asarray(self.dark + (1.0 - self.dark) * lit, dtype=np.float32)


def turn(x: Array, y: Array, angle_rad: float) -> tuple[Array, Array]:
    """Coordinates along axes that are turned counter-clockwise by `angle_rad`."""
    if angle_rad == 0.0:
        return x, y
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return cosine * x + sine * y, cosine * y - sine * x


def square_wave(u: Array, check_mm: float, width_mm: float) -> Array:
    """+1 on one check, -1 on the next, an edge at u = 0, linear over `width_mm` at the edges."""
    return _wave(u, 2.0 * check_mm, check_mm, width_mm)


def _wave(u: Array, period: float, lit: float, width: float) -> Array:
    """+1 over `lit` of each `period` from u = 0 on, else -1, linear over `width` at the edges."""
    middle = np.abs((u - 0.5 * lit + 0.5 * period) % period - 0.5 * period)
    return np.asarray(np.clip((0.5 * lit - middle) * (2.0 / width), -1.0, 1.0))


def check_camera(surface: Surface) -> None:
    """Refuse a camera under which patterns are not modelled."""
    require(
        surface.camera.model == "orthographic",
        "projected patterns are modelled under an orthographic camera only, but this one is perspective; take an "
        "orthographic one.",
    )


def projected(patch: Patch, led: Led) -> tuple[Array, Array]:
    """(h, w) x and y in mm where the projector's ray to each surface point meets the finger plane.

    Raises
    ------
    BadInput
        If several lights share the exposure (a projector is one light), or the surface reaches up to the projector.
    """
    require(not led.also, "a pattern comes from one projector, but several lights share this exposure; take one.")
    z = patch.z.astype(np.float64)
    x, y = patch.x.astype(np.float64), patch.y.astype(np.float64)
    if led.position_mm is None:
        direction = np.asarray(led.direction, dtype=np.float64)
        require(float(direction[2]) > 0, "a projector must shine from above: its direction needs z > 0.")
        rise = z / direction[2]
        return x - rise * direction[0], y - rise * direction[1]
    px, py, pz = led.position_mm
    require(float(z.max()) < pz, "the surface reaches up to the projector; move the projector away.")
    scale = pz / (pz - z)
    return px + (x - px) * scale, py + (y - py) * scale


def pattern_states(surface: Surface, led: Led, pattern: Checkerboard) -> FloatArray:
    """(N, H, W) the projector's light on every camera pixel in each shift, in [dark, 1]; zero beside the surface.

    The camera is orthographic: a pixel's state is that of the surface point it sees.

    Raises
    ------
    BadInput
        If the camera is not orthographic.
    """
    check_camera(surface)
    patch = cut_out(surface)
    x, y = projected(patch, led)
    shifts = pattern.shifts_mm()
    states = np.zeros((len(shifts), *surface.mask.shape), dtype=np.float32)
    for state, shift in zip(states, shifts, strict=True):
        state[patch.window] = pattern.state(x, y, shift, surface.camera.pitch_mm) * patch.mask
    return states
