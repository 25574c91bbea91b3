"""Light on skin that is coated: through water, between grains, off scales, along a gloss; noise-free, linear."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import FloatArray, Led
from splitknit.simulator.coat import WATER, Coat, Film, Grains
from splitknit.simulator.diffusion import REFRACTIVE_INDEX, WalkTable, diffuse_transmittance, fresnel
from splitknit.simulator.grains import sphere_brightness, stamp
from splitknit.simulator.lighting import Patch, cut_out, towards
from splitknit.simulator.renderer import BandLight, Diffusion, RenderSettings, relief_gains
from splitknit.simulator.skin import BAND_CHANNELS, ChannelOptics
from splitknit.simulator.surface import Surface


def render_coated(
    surface: Surface,
    leds: Sequence[Led],
    optics: Sequence[ChannelOptics],
    *,
    roughness: float,
    glare: float,
    walks: WalkTable,
    settings: RenderSettings | None = None,
) -> BandLight:
    """Render a finger with a coat as :func:`splitknit.simulator.renderer.render_band` renders a bare one.

    Light under water comes in the direction into which the water's surface bends it, and leaves through that surface;
    what it does in the skin is the same (the angles of total reflection do not depend on a flat film between skin and
    air). Grains take light from the skin where their shadows fall and hide what lies behind them. Scales add white
    light and let the rest through, both ways.
    """
    settings = settings or RenderSettings()
    require(surface.coat is not None, "this surface has no coat; use render_band.")
    assert surface.coat is not None
    patch = cut_out(surface)
    coat = _CutCoat(surface.coat, patch, surface.shape_normals[patch.window], roughness)
    blur = Diffusion(
        patch, patch.pitch_mm, optics, walks,
        reach_mm=settings.reach_mm, roughness=roughness, rim=settings.rim_exponent,
    )  # fmt: skip
    channels = next(names for names in BAND_CHANNELS.values() if len(names) == len(optics))
    gains = [
        gain * coat.leaving * (1.0 + coat.share * (surface.coat.tint.get(name, 1.0) - 1.0))
        for gain, name in zip(relief_gains(surface, patch, optics, settings), channels, strict=True)
    ]
    shape = patch.mask.shape
    diffuse = np.empty((len(leds), len(optics), *shape), dtype=np.float32)
    gloss = np.zeros((len(leds), *shape), dtype=np.float32)

    def one(k: int) -> None:
        entering, extra = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
        for led in (leds[k], *leds[k].also):
            lx, ly, lz, strength = towards(led, patch.x, patch.y, patch.z)
            size = 0.0 if led.position_mm is None else settings.led_radius_mm / (2.0 * _norm(led.position_mm))
            parts = coat.lit((lx, ly, lz), np.asarray(strength), size, glare)
            entering += parts[0]
            gloss[k] += parts[1]
            extra += parts[2]
        for c, light in enumerate(blur(entering)):
            diffuse[k, c] = light * gains[c] + extra

    with ThreadPoolExecutor(settings.workers) as pool:
        list(pool.map(one, range(len(leds))))
    return BandLight(window=patch.window, diffuse=diffuse, glare=gloss)


class _CutCoat:
    """A coat inside the finger's window."""

    def __init__(self, coat: Coat, patch: Patch, body: FloatArray, roughness: float) -> None:
        window = patch.window
        self.patch = patch
        self.share = coat.share[window]
        self.across: Values | float = roughness if coat.roughness is None else coat.roughness[window]
        self.lengthwise = None if coat.roughness_along is None else coat.roughness_along[window]
        self.along = None if coat.along is None else _apart(coat.along[window])
        self.film = None if coat.film is None else _cut_film(coat.film, patch)
        self.scales = None if coat.scales is None else coat.scales[window]
        self.grains = None if coat.grains is None else _cut_grains(coat.grains, patch)
        self.body = _apart(body)
        self.normal = (patch.nx, patch.ny, patch.nz)
        zero, one = np.zeros_like(patch.nz), np.ones_like(patch.nz)
        self.view: Vectors = (zero, zero, one) if patch.view is None else patch.view
        shape = patch.mask.shape
        self.hidden = np.zeros(shape, dtype=np.float32)
        if self.grains is not None:
            g = self.grains
            cover = stamp(shape, g.column, g.row, g.radius_px)
            light = stamp(shape, g.column, g.row, g.radius_px, g.albedo)
            self.hidden = np.clip(cover, 0.0, 1.0).astype(np.float32)
            self.grain_albedo = (light * np.where(cover > 1.0, 1.0 / np.maximum(cover, 1.0), 1.0)).astype(np.float32)
        self.leaving = self._leaving()

    def _leaving(self) -> FloatArray:
        """(h, w) share of the diffuse light that reaches the camera, over that of bare skin."""
        share = 1.0 - self.hidden
        if self.scales is not None:
            share = share * (1.0 - self.scales)
        if self.film is not None:
            through = (1.0 - fresnel(np.clip(dot(_apart(self.film.normals), self.view), 0.05, 1.0), WATER)) / (
                diffuse_transmittance(WATER)
            )
            bare = (1.0 - fresnel(np.clip(self.patch.nv, 0.05, 1.0))) / diffuse_transmittance()
            share = share * (1.0 + self.film.share * (through / bare - 1.0))
        return np.asarray(share, dtype=np.float32)

    def lit(self, light: Vectors, strength: Values, size: float, glare: float) -> tuple[Values, Values, Values]:
        """Light that enters the skin, that the surface mirrors, and that scales and grains scatter; (h, w) each."""
        patch = self.patch
        cosine = np.maximum(dot(light, self.normal), 0.0)
        entering = strength * cosine * (1.0 - fresnel(cosine))
        gloss = glare * reflected(
            self.normal, light, self.view, np.minimum(np.asarray(self.across) + size, 1.0), index=REFRACTIVE_INDEX,
            along=self.along,
            roughness_along=None if self.lengthwise is None else np.minimum(self.lengthwise + size, 1.0),
        )  # fmt: skip
        extra = np.zeros_like(entering)
        if self.film is not None:
            film, normal = self.film, _apart(self.film.normals)
            entering = entering + film.share * (self._under_water(light, strength, normal) - entering)
            water = reflected(normal, light, self.view, np.minimum(film.roughness + size, 1.0), index=WATER)
            gloss = gloss + film.share * (water - gloss)
        if self.scales is not None:
            extra = extra + self.scales * strength * cosine / np.pi
            entering = entering * (1.0 - self.scales)
        gloss = gloss * strength
        if self.grains is not None:
            free = 1.0 - self._shadow(light)
            seen = 1.0 - self.hidden
            phase = np.arccos(np.clip(dot(light, self.view), -1.0, 1.0)).astype(np.float32)
            dust = self.grain_albedo * sphere_brightness(phase) * strength / np.pi
            dust = dust * np.clip(0.5 + 2.0 * dot(light, self.body), 0.0, 1.0)  # a ball rises above the skin's shadow
            entering, gloss, extra = entering * free, gloss * free * seen, extra * seen + dust
        inside = patch.mask
        return tuple(np.where(inside, part, 0.0) for part in (entering, gloss, extra))  # type: ignore[return-value]

    def _under_water(self, light: Vectors, strength: Values, normal: Vectors) -> Values:
        """Light that enters the skin below the water's surface.

        The flux through the surface goes on in the refracted direction; the skin's facet takes its cosine of it.
        """
        above = np.maximum(dot(light, normal), 0.0)
        below = np.sqrt(np.maximum(1.0 - (1.0 - above * above) / WATER**2, 0.0))
        stretch = below - above / WATER
        bent = (
            light[0] / WATER + stretch * normal[0],
            light[1] / WATER + stretch * normal[1],
            light[2] / WATER + stretch * normal[2],
        )
        on_skin = np.maximum(dot(bent, self.normal), 0.0)
        within = strength * above * (1.0 - fresnel(above, WATER)) / below
        return np.asarray(within * on_skin * (1.0 - fresnel(on_skin, REFRACTIVE_INDEX / WATER)))

    def _shadow(self, light: Vectors) -> FloatArray:
        """(h, w) share of the skin's light that the grains take: a ball on the ground shades a disc beside its foot."""
        assert self.grains is not None
        g, shape = self.grains, self.patch.mask.shape
        i = np.clip(np.rint(g.row).astype(np.intp), 0, shape[0] - 1)
        j = np.clip(np.rint(g.column).astype(np.intp), 0, shape[1] - 1)
        lx, ly, lz = (np.broadcast_to(part, shape)[i, j] for part in light)
        lean_x, lean_y = lx / np.maximum(lz, 0.3), ly / np.maximum(lz, 0.3)
        longer = np.sqrt(1.0 / np.maximum(lz, 0.3))  # the ellipse's area, as a disc
        shade = stamp(shape, g.column - g.radius_px * lean_x, g.row + g.radius_px * lean_y, g.radius_px * longer)
        return np.clip(shade, 0.0, 1.0).astype(np.float32)


def _cut_film(film: Film, patch: Patch) -> Film:
    window = patch.window
    return Film(film.share[window], film.normals[window], film.roughness[window])


def _cut_grains(grains: Grains, patch: Patch) -> Grains:
    rows, columns = patch.window
    return Grains(grains.column - columns.start, grains.row - rows.start, grains.radius_px, grains.albedo)


def _apart(vectors: FloatArray) -> Vectors:
    return vectors[..., 0], vectors[..., 1], vectors[..., 2]


def _norm(position: Sequence[float]) -> float:
    return float(np.linalg.norm(np.asarray(position, dtype=np.float64)))


# Light that a surface with two roughnesses reflects: GGX microfacets, anisotropic, pixel by pixel.

Values = NDArray[np.floating]
Vectors = tuple[Values, Values, Values]


def dot(a: Vectors, b: Vectors) -> Values:
    """Inner products of vectors given as three arrays each."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def reflected(
    normal: Vectors,
    light: Vectors,
    view: Vectors,
    across: Values | float,
    *,
    index: float,
    along: Vectors | None = None,
    roughness_along: Values | float | None = None,
) -> Values:
    """(h, w) radiance towards `view` per unit of irradiance that a surface facing the light receives: D G F / (4 n.v).

    Parameters
    ----------
    normal, light, view : three (h, w) arrays each
        Unit vectors; out of the surface, towards the light, towards the camera.
    across : (h, w) or float
        GGX alpha across `along`, and everywhere where there is no direction.
    index : float
        Refractive index of what reflects.
    along : three (h, w) arrays, optional
        Unit vectors in the surface, along which the roughness is `roughness_along`.
    roughness_along : (h, w) or float, optional

    References
    ----------
    Walter et al. 2007, equations (20), (33), (34); Burley 2012 and Heitz 2014, equations (85) and (86), for two
    roughnesses.
    """
    nl, nv = dot(normal, light), np.clip(dot(normal, view), 1e-3, 1.0)
    lv = dot(light, view)
    inverse = 1.0 / np.sqrt(np.maximum(2.0 + 2.0 * lv, 1e-6))
    half = (
        (light[0] + view[0]) * inverse,
        (light[1] + view[1]) * inverse,
        (light[2] + view[2]) * inverse,
    )
    nh = np.clip(dot(normal, half), 0.0, 1.0)
    lit = nl > 0.0
    nl = np.maximum(nl, 1e-4)
    first = across if roughness_along is None else roughness_along
    if along is None:
        first, towards = across, None
    else:
        towards = along

    def squashed(direction: Vectors, cosine: Values, power: int) -> Values:
        """Sum of the squared tangential parts of a direction, times (or over) the squared roughnesses."""
        sine = np.maximum(1.0 - cosine * cosine, 0.0)
        part = np.zeros_like(sine) if towards is None else np.minimum(dot(towards, direction) ** 2, sine)
        one, other = np.square(first), np.square(across)
        if power < 0:
            return np.asarray(part / one + (sine - part) / other)
        return np.asarray(part * one + (sine - part) * other)

    below = squashed(half, nh, -1) + nh * nh
    distribution = 1.0 / (np.pi * first * across * below * below)

    def unshadowed(direction: Vectors, cosine: Values) -> Values:
        return np.asarray(2.0 / (1.0 + np.sqrt(1.0 + squashed(direction, cosine, 1) / (cosine * cosine))))

    shadowing = unshadowed(light, nl) * unshadowed(view, nv)
    mirror = fresnel((lv + 1.0) * inverse, index)
    return np.asarray(np.where(lit, distribution * shadowing * mirror / (4.0 * nv), 0.0))
