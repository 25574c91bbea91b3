"""Light on coated skin: through water, between grains of dust, off scales, along a gloss;
noise-free, linear."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from splitknit import Camera, Led
from splitknit.model import Array, BoolArray, FloatArray
from splitknit_simulator.light.lighting import (
    Patch,
    Vectors,
    angular_size,
    dot,
    reflected,
    towards,
)
from splitknit_simulator.light.skin import REFRACTIVE_INDEX, diffuse_transmittance, fresnel
from splitknit_simulator.surface import WATER_INDEX, Coat, Film, Grains

_MAX_DUST_MG_PER_CM2 = 0.64
"""Largest mass of dust on skin. Source: outdoor dust that adheres to the skin of young adults in
Changchun, China (indoor dust: 0.35)."""
_LARGEST_GRAIN_UM = 250.0
"""Diameter above which grains do not stick to skin. Source: Cao et al. 2012."""


# Dust: how many grains of what size, and where they and their shadows lie in the picture.
_GRAIN_MEDIAN_UM = 20.0
"""Median diameter of dust grains, by number; by area their mean is 47 um. Dust under 100 um sticks
to skin (Cao et al. 2012)."""
DUST_DENSITY_MG_PER_MM3 = 2.0  # soil and house dust have 1.5 to 2.6


def draw_grains(
    rng: np.random.Generator, mask: BoolArray, nz: FloatArray, camera: Camera, severity: float
) -> Grains:
    """Strew grains evenly over the skin that the camera sees, at severity 1 as much as skin holds.

    `nz` (H, W): z component of the shape's normals: a pixel on a slant shows more skin.
    """
    spread = float(np.log(1.8))  # geometric standard deviation of diameters
    volume = np.pi / 6.0 * (1e-3 * _GRAIN_MEDIAN_UM) ** 3 * float(np.exp(4.5 * spread**2))
    per_mm2 = severity * _MAX_DUST_MG_PER_CM2 / 100.0 / (volume * DUST_DENSITY_MG_PER_MM3)
    rows, columns = mask.shape
    # drawn over the whole frame in mm and then thinned, so that every scale of the picture shows
    # the same dust
    width, height = columns / camera.px_per_mm, rows / camera.px_per_mm
    steep = 4.0
    count = int(rng.poisson(steep * per_mm2 * width * height))
    place = rng.random((2, count))
    column, row = place[0] * columns - 0.5, place[1] * rows - 0.5
    diameter = 1e-3 * _GRAIN_MEDIAN_UM * np.exp(spread * rng.standard_normal(count))
    albedo = rng.uniform(0.08, 0.6, count)  # from soot and soil to flour and skin scales
    chance = rng.random(count)
    i = np.clip(np.rint(row).astype(np.intp), 0, rows - 1)
    j = np.clip(np.rint(column).astype(np.intp), 0, columns - 1)
    skin = mask[i, j] & (chance < 1.0 / (steep * np.maximum(nz[i, j], 1.0 / steep)))
    keep = skin & (diameter < 1e-3 * _LARGEST_GRAIN_UM)
    return Grains(column[keep], row[keep], 0.5 * diameter[keep] * camera.px_per_mm, albedo[keep])


def stamp(
    shape: tuple[int, int],
    column: Array,
    row: Array,
    radius_px: Array,
    value: Array | float = 1.0,
) -> Array:
    """(h, w) sum of discs times their values, each with its own area; may exceed 1 where many
    overlap."""
    reach = np.ceil(radius_px + 0.5).astype(np.intp)
    values = np.broadcast_to(np.asarray(value, dtype=np.float64), radius_px.shape)
    pad = int(reach.max()) + 1 if reach.size else 1
    canvas = np.zeros((shape[0] + 2 * pad, shape[1] + 2 * pad))
    flat = canvas.ravel()
    for size in np.unique(reach):
        some = reach == size
        x, y, r, v = column[some], row[some], radius_px[some], values[some]
        ix, iy = np.rint(x).astype(np.intp), np.rint(y).astype(np.intp)
        near = (
            (ix >= -pad + size)
            & (ix < shape[1] + pad - size)
            & (iy >= -pad + size)
            & (iy < shape[0] + pad - size)
        )
        x, y, r, v, ix, iy = x[near], y[near], r[near], v[near], ix[near], iy[near]
        steps = [(dy, dx) for dy in range(-size, size + 1) for dx in range(-size, size + 1)]
        parts = [
            np.clip(0.5 + np.maximum(r, 0.5) - np.hypot(ix + dx - x, iy + dy - y), 0.0, 1.0)
            for dy, dx in steps
        ]
        scale = v * np.pi * r * r / np.maximum(np.sum(parts, axis=0), 1e-9)
        for (dy, dx), part in zip(steps, parts, strict=True):
            at = (iy + dy + pad) * canvas.shape[1] + ix + dx + pad
            flat += np.bincount(at, weights=part * scale, minlength=flat.size)
    return canvas[pad : pad + shape[0], pad : pad + shape[1]]


def _sphere_brightness(phase_rad: FloatArray) -> FloatArray:
    """Mean radiance of a matt sphere of albedo one, over that of a white card that faces the light.
    Source: Schoenberg 1929, in Handbuch der Astrophysik 2: the phase function of a Lambertian
    sphere.
    """
    cosine = np.cos(phase_rad)
    return np.asarray(
        2.0 / 3.0 * (np.sin(phase_rad) + (np.pi - phase_rad) * cosine) / np.pi, dtype=np.float32
    )


# Coated skin under a light.


class CoatedPatch:
    """Coated skin inside the finger's window.

    Light under water comes in the direction into which the water's surface bends it, and leaves
    through that surface; what it does in the skin is the same (the angles of total reflection do
    not depend on a flat film between skin and air). Grains take light from the skin where their
    shadows fall and hide what lies behind them. Scales add white light and let the rest through,
    both ways.
    """

    def __init__(self, coat: Coat, patch: Patch, body: FloatArray, roughness: float) -> None:
        """Cut the coat out; `body` (h, w, 3) are the normals of the finger without ridges."""
        window = patch.window
        self.patch = patch
        self.fraction, self.tint = coat.fraction[window], coat.tint
        self.across: FloatArray | float = (
            roughness if coat.roughness is None else coat.roughness[window]
        )
        self.lengthwise = None if coat.roughness_along is None else coat.roughness_along[window]
        self.along = None if coat.along is None else _apart(coat.along[window])
        film, grains = coat.film, coat.grains
        self.film = film and Film(
            film.fraction[window], film.normals[window], film.roughness[window]
        )
        self.scales = None if coat.scales is None else coat.scales[window]
        rows, columns = window
        self.grains = grains and replace(
            grains, column=grains.column - columns.start, row=grains.row - rows.start
        )
        self.body = _apart(body)
        shape = patch.mask.shape
        self.hidden = np.zeros(shape, dtype=np.float32)
        if self.grains is not None:
            g = self.grains
            cover = stamp(shape, g.column, g.row, g.radius_px)
            light = stamp(shape, g.column, g.row, g.radius_px, g.albedo)
            self.hidden = np.clip(cover, 0.0, 1.0).astype(np.float32)
            self.grain_albedo = (
                light * np.where(cover > 1.0, 1.0 / np.maximum(cover, 1.0), 1.0)
            ).astype(np.float32)
        self.leaving = self._leaving()

    def _leaving(self) -> FloatArray:
        """(h, w) fraction of the diffuse light that reaches the camera, over that of bare skin."""
        fraction = 1.0 - self.hidden
        if self.scales is not None:
            fraction = fraction * (1.0 - self.scales)
        if self.film is not None:
            cosine = np.clip(dot(_apart(self.film.normals), self.patch.view), 0.05, 1.0)
            through = (1.0 - fresnel(cosine, WATER_INDEX)) / diffuse_transmittance(WATER_INDEX)
            bare = (1.0 - fresnel(np.clip(self.patch.nv, 0.05, 1.0))) / diffuse_transmittance()
            fraction = fraction * (1.0 + self.film.fraction * (through / bare - 1.0))
        return np.asarray(fraction, dtype=np.float32)

    def over(self, gain: FloatArray, channel: str) -> FloatArray:
        """(h, w) factor of a channel's diffuse light, from that of bare skin."""
        return gain * self.leaving * (1.0 + self.fraction * (self.tint.get(channel, 1.0) - 1.0))

    def light_on(self, led: Led, glare: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Light that enters the skin, that the surface reflects, and that scales and grains
        scatter; (h, w) each."""
        patch = self.patch
        sums = np.zeros((3, *patch.mask.shape), dtype=np.float32)
        for lamp in (led, *led.also):
            parts = self._lit(*towards(lamp, patch.points), angular_size(lamp), glare)
            for k, part in enumerate(parts):
                sums[k] += part
        return sums[0], sums[1], sums[2]

    def _lit(
        self, light: Vectors, strength: FloatArray, size: float, glare: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        patch = self.patch
        cosine = np.maximum(dot(light, patch.normal), 0.0)
        entering = strength * cosine * (1.0 - fresnel(cosine))
        gloss = glare * reflected(
            patch.normal,
            light,
            patch.view,
            np.minimum(np.asarray(self.across) + size, 1.0),
            along=self.along,
            roughness_along=None
            if self.lengthwise is None
            else np.minimum(self.lengthwise + size, 1.0),
        )
        extra = np.zeros_like(entering)
        if self.film is not None:
            film, normal = self.film, _apart(self.film.normals)
            entering = entering + film.fraction * (
                self._under_water(light, strength, normal) - entering
            )
            water = reflected(
                normal,
                light,
                patch.view,
                np.minimum(film.roughness + size, 1.0),
                index=WATER_INDEX,
            )
            gloss = gloss + film.fraction * (water - gloss)
        if self.scales is not None:
            extra = extra + self.scales * strength * cosine / np.pi
            entering = entering * (1.0 - self.scales)
        gloss = gloss * strength
        if self.grains is not None:
            free = 1.0 - self._shadow(light)
            seen = 1.0 - self.hidden
            phase = np.arccos(np.clip(dot(light, patch.view), -1.0, 1.0)).astype(np.float32)
            dust = self.grain_albedo * _sphere_brightness(phase) * strength / np.pi
            # a ball rises above the skin's shadow
            dust = dust * np.clip(0.5 + 2.0 * dot(light, self.body), 0.0, 1.0)
            entering, gloss, extra = entering * free, gloss * free * seen, extra * seen + dust
        entering, gloss, extra = (
            np.where(patch.mask, part, 0.0) for part in (entering, gloss, extra)
        )
        return entering, gloss, extra

    def _under_water(self, light: Vectors, strength: FloatArray, normal: Vectors) -> Any:
        """Light that enters the skin below the water's surface.

        The flux through the surface goes on in the refracted direction; the skin's facet takes its
        cosine of it.
        """
        above = np.maximum(dot(light, normal), 0.0)
        below = np.sqrt(np.maximum(1.0 - (1.0 - above * above) / WATER_INDEX**2, 0.0))
        stretch = below - above / WATER_INDEX
        bent = tuple(
            part / WATER_INDEX + stretch * n for part, n in zip(light, normal, strict=True)
        )
        on_skin = np.maximum(dot(bent, self.patch.normal), 0.0)
        within = strength * above * (1.0 - fresnel(above, WATER_INDEX)) / below
        return within * on_skin * (1.0 - fresnel(on_skin, REFRACTIVE_INDEX / WATER_INDEX))

    def _shadow(self, light: Vectors) -> FloatArray:
        """(h, w) fraction of the skin's light that grains take: a ball on the ground shades a disc
        beside its foot."""
        assert self.grains is not None
        g, shape = self.grains, self.patch.mask.shape
        i = np.clip(np.rint(g.row).astype(np.intp), 0, shape[0] - 1)
        j = np.clip(np.rint(g.column).astype(np.intp), 0, shape[1] - 1)
        lx, ly, lz = (np.broadcast_to(part, shape)[i, j] for part in light)
        lean_x, lean_y = lx / np.maximum(lz, 0.3), ly / np.maximum(lz, 0.3)
        longer = np.sqrt(1.0 / np.maximum(lz, 0.3))  # the ellipse's area, as a disc
        shade = stamp(
            shape,
            g.column - g.radius_px * lean_x,
            g.row + g.radius_px * lean_y,
            g.radius_px * longer,
        )
        return np.clip(shade, 0.0, 1.0).astype(np.float32)


def _apart(vectors: FloatArray) -> Vectors:
    return vectors[..., 0], vectors[..., 1], vectors[..., 2]
