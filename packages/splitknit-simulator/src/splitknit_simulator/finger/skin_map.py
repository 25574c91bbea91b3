"""The skin laid flat: ridges, pores and flexion creases as one displacement map over the chart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from splitknit.model import Array, FloatArray
from splitknit_simulator.finger.master_print import MasterPrint
from splitknit_simulator.finger.ridges import smooth_noise


@dataclass(frozen=True, slots=True)
class FlexionCrease:
    """A flexion crease: parallel grooves across the finger."""

    v_mm: float = 0.0
    """Where it crosses the middle line: arc length from the first crease, towards the tip."""
    depth_mm: float = 0.35
    """Depth of its main groove."""
    width_mm: float = 0.3
    """Standard deviation of the groove's profile."""
    tilt: float = 0.0
    """Rise over the breadth: dv / du."""
    bow_per_mm: float = 0.006
    """Curvature: v rises (falls) by bow u^2 towards the sides."""
    reach_mm: float = 10.0
    """Arc length from the middle line at which the groove has half its depth."""
    side_lines: int = 2
    """Fainter lines beside the main groove."""
    darkening: float = 0.25
    """Loss of diffuse reflectance at the bottom."""


@dataclass(frozen=True, slots=True)
class SkinRelief:
    """Depths on one finger's skin."""

    ridge_depth_um: float = 65.0
    """Mean height of ridges over valleys; people: 40-100."""
    depth_variation: float = 0.12
    """Relative standard deviation of the depth over distances of about 5 mm."""
    pore_depth_um: float = 25.0
    """Mean depth of the deepest pores."""
    pore_darkening: float = 0.06
    """Loss of diffuse reflectance at a pore."""
    undulation_mm: float = 0.0
    """Standard deviation of bumps and dents below the ridges, some 5 mm wide: no finger is as even
    as its model."""
    creases: tuple[FlexionCrease, ...] = (
        FlexionCrease(),
        FlexionCrease(v_mm=-23.0, depth_mm=0.5, side_lines=3),
    )
    """From the first crease towards the palm."""


@dataclass(frozen=True, slots=True, eq=False)
class SkinMap:
    """Displacement over the chart as a cubic spline, and pigment."""

    # (H, W) cubic B-spline coefficients of the displacement along the shape's normal, mm; 0 on
    # ridge tops
    coefficients: Array
    pigment: FloatArray  # (H, W) multiplier of the diffuse reflectance
    u0_mm: float
    v0_mm: float
    pitch_mm: float
    crease_lines: tuple[Array, ...]  # (N, 2) u, v along the main groove of every crease

    def displacement(self, u: Array, v: Array) -> Array:
        """Displacement (mm, negative inwards) at chart points; the map continues by reflection."""
        places = (self.v0_mm - v) / self.pitch_mm, (u - self.u0_mm) / self.pitch_mm
        return ndimage.map_coordinates(
            self.coefficients, places, order=3, prefilter=False, mode="mirror"
        )

    def displacement_gradient(self, u: Array, v: Array, here: Array) -> tuple[Array, Array]:
        """Slopes along u and v, given the displacement `here`; one-sided over 0.1 um."""
        step = 1e-4
        return (
            (self.displacement(u + step, v) - here) / step,
            (self.displacement(u, v + step) - here) / step,
        )

    def pigment_at(self, u: Array, v: Array) -> FloatArray:
        """Pigment at chart points."""
        places = (self.v0_mm - v) / self.pitch_mm, (u - self.u0_mm) / self.pitch_mm
        return np.asarray(
            ndimage.map_coordinates(self.pigment, places, order=1, mode="mirror"), dtype=np.float32
        )


def skin_map(master: MasterPrint, settings: SkinRelief) -> SkinMap:
    """Lay ridges, pores and creases over the chart.

    Ridges flatten inside the grooves. All draws (depths, lines beside creases) follow from the
    master print's seed.
    """
    draws = np.random.default_rng([master.seed, 0x5C1]).spawn(2)
    pitch = float(master.u_mm[1] - master.u_mm[0])
    depth = 1.0 + settings.depth_variation * smooth_noise(draws[0], master.ridge.shape, 4.0 / pitch)
    depth = np.clip(depth, 0.5, 1.5) * settings.ridge_depth_um * 1e-3
    groove, shade = np.zeros((2, *master.ridge.shape))
    lines = [
        _cut(draws[1], crease, (master.u_mm, master.v_mm), groove, shade)
        for crease in settings.creases
    ]
    flatten = np.exp(-((groove / 0.15) ** 2))
    displacement = -groove - depth * (1.0 - master.ridge) * (0.25 + 0.75 * flatten)
    displacement -= 1e-3 * settings.pore_depth_um * master.pores * flatten
    if settings.undulation_mm > 0:
        soft = smooth_noise(
            np.random.default_rng([master.seed, 0x5C2]),
            master.ridge.shape,
            1.6 / pitch,  # mm; bumps some 5 mm wide
        )
        displacement += settings.undulation_mm * (soft - soft.max())
    pigment = (1.0 - shade) * (1.0 - settings.pore_darkening * master.pores * flatten)
    return SkinMap(
        ndimage.spline_filter(displacement, order=3, mode="mirror"),
        pigment.astype(np.float32),
        float(master.u_mm[0]),
        float(master.v_mm[0]),
        pitch,
        tuple(lines),
    )


def _cut(
    rng: np.random.Generator,
    crease: FlexionCrease,
    axes: tuple[Array, Array],
    groove: Array,
    shade: Array,
) -> Array:
    """Add one crease to `groove` (depth, mm) and `shade` in place; return its main line (N, 2)."""
    u, v = axes
    waves = [
        (rng.uniform(0.05, 0.2), rng.uniform(5.0, 12.0), rng.uniform(0, 2 * np.pi))
        for _ in range(2)
    ]
    main = crease.v_mm + crease.tilt * u + crease.bow_per_mm * u * u
    main = main + sum(a * np.sin(2 * np.pi * u / length + phase) for a, length, phase in waves)
    lines = [(main, crease.depth_mm, crease.width_mm, 0.0, crease.reach_mm)]
    for k in range(crease.side_lines):
        side = 1.0 if k % 2 == 0 else -1.0
        apart = side * rng.uniform(0.9, 2.2) * (1.0 + 0.5 * (k // 2))
        lines.append(
            (
                main + apart + rng.uniform(-0.06, 0.06) * u,
                crease.depth_mm * rng.uniform(0.15, 0.55),
                crease.width_mm * rng.uniform(0.5, 0.8),
                rng.uniform(-4.0, 4.0),
                crease.reach_mm * rng.uniform(0.4, 0.8),
            )
        )
    reach = np.abs(v - crease.v_mm) < 8.0
    rows = (
        slice(int(np.argmax(reach)), int(v.size - np.argmax(reach[::-1])))
        if reach.any()
        else slice(0, 0)
    )
    for line, depth, width, middle, half in lines:
        slope = np.gradient(line, u)
        across = (v[rows, None] - line[None, :]) / np.sqrt(1.0 + slope * slope)[None, :]
        fade = 1.0 / (1.0 + np.exp((np.abs(u - middle) - half) / 0.9))
        cut = depth * np.exp(-0.5 * (across / width) ** 2) * fade[None, :]
        groove[rows] = np.sqrt(groove[rows] ** 2 + cut**2)
        dark = (
            crease.darkening
            * (depth / max(crease.depth_mm, 1e-9))
            * np.exp(-0.5 * (across / (1.3 * width)) ** 2)
        )
        shade[rows] = np.maximum(shade[rows], dark * fade[None, :])
    return np.stack([u, main], 1)
