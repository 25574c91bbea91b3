"""Light on coated skin: through water, between grains of dust, off scales, along a gloss;
noise-free, linear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from splitknit import Camera, Led
from splitknit.model import BoolArray, FloatArray
from splitknit_simulator.light.lighting import Patch, angular_size, towards
from splitknit_simulator.light.parameters import (
    DUST_DENSITY_MG_PER_MM3,
    GRAIN_ALBEDO,
    GRAIN_MEDIAN_UM,
    GRAIN_SPREAD,
    REFRACTIVE_INDEX,
)
from splitknit_simulator.light.skin import diffuse_transmittance, fresnel
from splitknit_simulator.surface import WATER_INDEX, Coat, Film, Grains

_MAX_DUST_MG_PER_CM2 = 0.64
"""Largest mass of dust on skin. Source: outdoor dust that adheres to the skin of young adults in
Changchun, China (indoor dust: 0.35)."""
_LARGEST_GRAIN_UM = 250.0
"""Diameter above which grains do not stick to skin. Source: Cao et al. 2012."""


# Dust: how many grains of what size, and where they and their shadows lie in the picture.


def draw_grains(
    rng: np.random.Generator, mask: BoolArray, nz: FloatArray, camera: Camera, severity: float
) -> Grains:
    """Strew grains evenly over the skin that the camera sees, at severity 1 as much as skin holds.

    `nz` (H, W): z component of the shape's normals: a pixel on a slant shows more skin.
    """
    spread = float(np.log(GRAIN_SPREAD))
    volume = np.pi / 6.0 * (1e-3 * GRAIN_MEDIAN_UM) ** 3 * float(np.exp(4.5 * spread**2))
    per_mm2 = severity * _MAX_DUST_MG_PER_CM2 / 100.0 / (volume * DUST_DENSITY_MG_PER_MM3)
    rows, columns = mask.shape
    # drawn over the whole frame in mm and then thinned, so that every scale of the picture shows
    # the same dust
    width, height = columns / camera.px_per_mm, rows / camera.px_per_mm
    steep = 4.0
    count = int(rng.poisson(steep * per_mm2 * width * height))
    place = rng.random((2, count))
    column, row = place[0] * columns - 0.5, place[1] * rows - 0.5
    diameter = 1e-3 * GRAIN_MEDIAN_UM * np.exp(spread * rng.standard_normal(count))
    albedo = rng.uniform(*GRAIN_ALBEDO, count)
    chance = rng.random(count)
    i = np.clip(np.rint(row).astype(np.intp), 0, rows - 1)
    j = np.clip(np.rint(column).astype(np.intp), 0, columns - 1)
    skin = mask[i, j] & (chance < 1.0 / (steep * np.maximum(nz[i, j], 1.0 / steep)))
    keep = skin & (diameter < 1e-3 * _LARGEST_GRAIN_UM)
    return Grains(column[keep], row[keep], 0.5 * diameter[keep] * camera.px_per_mm, albedo[keep])


def stamp(
    shape: tuple[int, int],
    column: NDArray[np.float64],
    row: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    value: NDArray[np.float64] | float = 1.0,
) -> NDArray[np.float64]:
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
        self.across: Values | float = (
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
        self.normal = (patch.nx, patch.ny, patch.nz)
        zeros, ones = np.zeros_like(patch.nz), np.ones_like(patch.nz)
        self.view: Vectors = (zeros, zeros, ones) if patch.view is None else patch.view
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
            cosine = np.clip(_dot(_apart(self.film.normals), self.view), 0.05, 1.0)
            through = (1.0 - fresnel(cosine, WATER_INDEX)) / diffuse_transmittance(WATER_INDEX)
            bare = (1.0 - fresnel(np.clip(self.patch.nv, 0.05, 1.0))) / diffuse_transmittance()
            fraction = fraction * (1.0 + self.film.fraction * (through / bare - 1.0))
        return np.asarray(fraction, dtype=np.float32)

    def over(self, gain: FloatArray, channel: str) -> FloatArray:
        """(h, w) factor of a channel's diffuse light, from that of bare skin."""
        return gain * self.leaving * (1.0 + self.fraction * (self.tint.get(channel, 1.0) - 1.0))

    def light_on(
        self, led: Led, glare: float, led_radius_mm: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Light that enters the skin, that the surface reflects, and that scales and grains
        scatter; (h, w) each."""
        patch = self.patch
        sums = np.zeros((3, *patch.mask.shape), dtype=np.float32)
        for lamp in (led, *led.also):
            lx, ly, lz, strength = towards(lamp, patch.x, patch.y, patch.z)
            parts = self._lit(
                (lx, ly, lz), np.asarray(strength), angular_size(lamp, led_radius_mm), glare
            )
            for k, part in enumerate(parts):
                sums[k] += part
        return sums[0], sums[1], sums[2]

    def _lit(
        self, light: Vectors, strength: Values, size: float, glare: float
    ) -> tuple[Values, Values, Values]:
        patch = self.patch
        cosine = np.maximum(_dot(light, self.normal), 0.0)
        entering = strength * cosine * (1.0 - fresnel(cosine))
        gloss = glare * _reflected(
            self.normal,
            light,
            self.view,
            np.minimum(np.asarray(self.across) + size, 1.0),
            index=REFRACTIVE_INDEX,
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
            water = _reflected(
                normal, light, self.view, np.minimum(film.roughness + size, 1.0), index=WATER_INDEX
            )
            gloss = gloss + film.fraction * (water - gloss)
        if self.scales is not None:
            extra = extra + self.scales * strength * cosine / np.pi
            entering = entering * (1.0 - self.scales)
        gloss = gloss * strength
        if self.grains is not None:
            free = 1.0 - self._shadow(light)
            seen = 1.0 - self.hidden
            phase = np.arccos(np.clip(_dot(light, self.view), -1.0, 1.0)).astype(np.float32)
            dust = self.grain_albedo * _sphere_brightness(phase) * strength / np.pi
            # a ball rises above the skin's shadow
            dust = dust * np.clip(0.5 + 2.0 * _dot(light, self.body), 0.0, 1.0)
            entering, gloss, extra = entering * free, gloss * free * seen, extra * seen + dust
        parts = (np.where(patch.mask, part, 0.0) for part in (entering, gloss, extra))
        entering, gloss, extra = parts
        return entering, gloss, extra

    def _under_water(self, light: Vectors, strength: Values, normal: Vectors) -> Values:
        """Light that enters the skin below the water's surface.

        The flux through the surface goes on in the refracted direction; the skin's facet takes its
        cosine of it.
        """
        above = np.maximum(_dot(light, normal), 0.0)
        below = np.sqrt(np.maximum(1.0 - (1.0 - above * above) / WATER_INDEX**2, 0.0))
        stretch = below - above / WATER_INDEX
        x, y, z = (part / WATER_INDEX + stretch * n for part, n in zip(light, normal, strict=True))
        bent = (x, y, z)
        on_skin = np.maximum(_dot(bent, self.normal), 0.0)
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


# Light that a surface with two roughnesses reflects: GGX microfacets, anisotropic, pixel by pixel.

Values = NDArray[np.floating]
Vectors = tuple[Values, Values, Values]


def _dot(a: Vectors, b: Vectors) -> Values:
    """Inner products of vectors given as three arrays each."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _reflected(
    normal: Vectors,
    light: Vectors,
    view: Vectors,
    across: Values | float,
    *,
    index: float,
    along: Vectors | None = None,
    roughness_along: Values | float | None = None,
) -> Values:
    """(h, w) radiance towards `view` per unit of irradiance that a surface facing the light
    receives: D G F / (4 n.v).

    Vectors are three (h, w) arrays, unit, out of the surface; the GGX alpha is `across` across
    `along` and everywhere where there is no direction, and `roughness_along` along it. Walter et
    al. 2007, equations (20), (33), (34); Burley 2012 and Heitz 2014, equations (85) and (86), for
    two roughnesses.
    """
    nl, nv = _dot(normal, light), np.clip(_dot(normal, view), 1e-3, 1.0)
    lv = _dot(light, view)
    inverse = 1.0 / np.sqrt(np.maximum(2.0 + 2.0 * lv, 1e-6))
    half = (
        (light[0] + view[0]) * inverse,
        (light[1] + view[1]) * inverse,
        (light[2] + view[2]) * inverse,
    )
    nh = np.clip(_dot(normal, half), 0.0, 1.0)
    lit = nl > 0.0
    nl = np.maximum(nl, 1e-4)
    first = across if along is None or roughness_along is None else roughness_along

    def squashed(direction: Vectors, cosine: Values, power: int) -> Values:
        """Sum of the squared tangential parts of a direction, times (or over) the squared
        roughnesses."""
        sine = np.maximum(1.0 - cosine * cosine, 0.0)
        part = (
            np.zeros_like(sine) if along is None else np.minimum(_dot(along, direction) ** 2, sine)
        )
        first2, across2 = np.square(first), np.square(across)
        rest = sine - part
        return np.asarray(
            part * first2 + rest * across2 if power > 0 else part / first2 + rest / across2
        )

    below = squashed(half, nh, -1) + nh * nh
    distribution = 1.0 / (np.pi * first * across * below * below)

    def unshadowed(direction: Vectors, cosine: Values) -> Values:
        return 2.0 / (1.0 + np.sqrt(1.0 + squashed(direction, cosine, 1) / (cosine * cosine)))

    shadowing = unshadowed(light, nl) * unshadowed(view, nv)
    mirror = fresnel((lv + 1.0) * inverse, index)
    return np.where(lit, distribution * shadowing * mirror / (4.0 * nv), 0.0)
