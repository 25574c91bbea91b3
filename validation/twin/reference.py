"""A slow reference for the twin: random walks in the skin's volume under its true, ridged surface.

It shares no code with :mod:`splitknit_simulator.light.renderer`: a patch of skin becomes triangles, Mitsuba 3 finds
where rays meet them, and every image is an average of random walks with a standard error. Needs the group ``reference``
and Debian's ``libllvm19`` (other versions may abort). See ``docs/experiments/simulator-reference.md``.

A walk starts where the camera sees the skin and looks for the lights. Between boundaries it takes exponential steps of
the mean free path and turns isotropically; absorption weighs it by exp(-a length); roulette ends it. Every lane of the
computation walks for one pixel, one walk after the other, with random numbers of its own: the result depends on the
seed alone.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from reference_scene import INSET_MM, ReferenceScene, Seen, build, see

from splitknit.errors import importing, require
from splitknit.model import FloatArray, Led
from splitknit.settings import Checked, Limits, check_fields
from splitknit_simulator.light.skin import REFRACTIVE_INDEX, ChannelOptics, diffuse_transmittance
from splitknit_simulator.surface import SimulatedSurface

FAINT = 0.1
"""Below this weight a walk goes on with half the chance that its weight would give, and twice FAINT as weight."""

DEEP = 12.0
"""Mean free paths below the deepest valley beyond which a walk looks for no light: exp(-12) would be left of it."""

STEER = 0.16
"""Standard deviation of the direction (its x and y) in which a scattered walk looks for a light through the skin."""

STEERED = 0.85
"""Fraction of those looks that are steered towards a light; the others go anywhere upwards."""


# Random walks below the skin's triangles: the kernel. Mitsuba and Dr.Jit come in with the scene.


def _walk(
    crop: ReferenceScene, seen: Seen, medium: tuple[float, float], *, walks: int, seed: int, spread_rad: float | None
) -> tuple[list[Any], Any, Any]:
    """Walk `walks` times from each seen point; return the lights' sums, the light that left, and the steps, by lane.

    With a diffuse boundary (`spread_rad` None), the Fresnel terms give how much passes, and what passes or is reflected
    is spread as by a matt surface. A smooth boundary refracts and mirrors at the triangles; the lights then have a lobe
    of `spread_rad`, and a scattered walk looks for one of them through the boundary.

    Parameters
    ----------
    medium : reduced scattering and absorption per mm

    References
    ----------
    Wang, Jacques and Zheng 1995, MCML; Veach 1997, chapter 9, for the mixture of two ways to choose a direction.
    """
    mi, dr = crop.mi, crop.dr
    random = mi.PCG32(initstate=mi.UInt64(seed), initseq=mi.UInt64(seen.lane))
    kind = _Diffuse if spread_rad is None else _Smooth
    boundary = kind(crop, dr.opaque(mi.Float, medium[0]), dr.opaque(mi.Float, medium[1]), spread_rad or 0.0)
    up = seen.normal
    passed = dr.select(seen.valid, 1.0 - mi.fresnel(up.z, REFRACTIVE_INDEX)[0], 0.0)
    start = mi.Point3f(seen.point - up * INSET_MM)

    def step(*now: Any) -> Any:
        state = boundary.step(_State(*now))
        faint = state.weight < FAINT
        ends = state.ended | (faint & (state.random.next_float32() >= state.weight / (2.0 * FAINT)))
        # a walk that has ended begins anew at the place where this lane's ray met the skin
        return (
            mi.Point3f(dr.select(ends, start, state.point)),
            mi.Vector3f(dr.select(ends, boundary.begin(up, state.random), state.direction)),
            dr.select(ends, passed, dr.select(faint, 2.0 * FAINT, state.weight)),
            state.scattered & ~ends,
            dr.select(ends, state.left - 1, state.left),
            state.sums,
            state.gone,
            state.steps + 1,
            state.random,
            mi.Bool(False),
        )

    first = (
        start, boundary.begin(up, random), mi.Float(passed), mi.Bool(False),
        dr.select(seen.valid, mi.UInt32(walks), 0), [mi.Float(0.0) for _ in crop.lights], mi.Float(0.0),
        mi.UInt32(0), random, mi.Bool(False),
    )  # fmt: skip
    last = _State(*dr.while_loop(first, lambda *now: now[4] > 0, step, max_iterations=-1))
    return last.sums, last.gone, last.steps


@dataclass(slots=True, eq=False)
class _State:
    """One step of every lane."""

    point: Any
    direction: Any
    weight: Any
    scattered: Any
    """The last event was a scattering, not a boundary."""
    left: Any
    """Walks still to do."""
    sums: list[Any]
    gone: Any
    steps: Any
    random: Any
    ended: Any


@dataclass(frozen=True, slots=True, eq=False)
class _Diffuse:
    """A boundary that spreads what it lets pass and what it reflects."""

    crop: ReferenceScene
    scattering: Any
    absorption: Any
    spread_rad: float

    def begin(self, up: Any, random: Any) -> Any:
        """Direction in which a walk starts below the boundary."""
        return self._spread(up, self._pair(random))

    def step(self, state: _State) -> _State:
        """Go to the next scattering event or to the boundary, and turn."""
        mi, dr, scene = self.crop.mi, self.crop.dr, self.crop.scene
        length = -dr.log(1.0 - state.random.next_float32()) / self.scattering
        ray = mi.Ray3f(state.point, state.direction)
        ray.maxt = length
        near = dr.maximum(state.point.z, state.point.z + length * state.direction.z) > self.crop.lowest_mm
        found = scene.ray_intersect_preliminary(ray, coherent=False, active=near)
        met = found.is_valid() & near
        place = found.compute_surface_interaction(ray, mi.RayFlags.Minimal, met)
        normal = mi.Vector3f(place.n)
        cosine = dr.dot(state.direction, normal)
        state.ended = met & (cosine <= 0.0)  # through a crack between triangles
        met &= ~state.ended
        weight = state.weight * dr.exp(-self.absorption * dr.select(met, found.t, length))
        blocked = mi.fresnel(dr.maximum(cosine, 1e-4), 1.0 / REFRACTIVE_INDEX)[0]
        leaving = dr.select(met, weight * (1.0 - blocked), 0.0)
        state.gone = state.gone + leaving
        inside = mi.Point3f(place.p) - normal * INSET_MM
        pair = self._pair(state.random)
        self._leave(state, leaving, (place, met, cosine, inside))
        reflected = self._reflected(state.direction, normal, cosine, pair)
        state.direction = dr.select(met, reflected, mi.warp.square_to_uniform_sphere(pair))
        state.point = dr.select(met, inside, state.point + length * ray.d)
        state.weight = dr.select(met, weight * blocked, weight)
        state.scattered = ~met & ~state.ended
        self._look(state)
        return state

    def _leave(self, state: _State, leaving: Any, where: tuple[Any, Any, Any, Any]) -> None:
        """Light that the lights send in where the walk leaves."""
        place, met = where[:2]
        state.sums = [
            total + leaving * self.crop.gather(self.crop.entering, place.prim_index, light, met)
            for light, total in enumerate(state.sums)
        ]

    def _reflected(self, direction: Any, normal: Any, cosine: Any, pair: Any) -> Any:
        return self._spread(normal, pair)

    def _look(self, state: _State) -> None:
        """A matt boundary hides the lights from what is inside."""

    def _spread(self, normal: Any, pair: Any) -> Any:
        mi = self.crop.mi
        return mi.Frame3f(-normal).to_world(mi.warp.square_to_cosine_hemisphere(pair))

    def _pair(self, random: Any) -> Any:
        return self.crop.mi.Point2f(random.next_float32(), random.next_float32())


@dataclass(frozen=True, slots=True, eq=False)
class _Smooth(_Diffuse):
    """A boundary that refracts and mirrors at its triangles."""

    def begin(self, up: Any, random: Any) -> Any:
        return self._bend(self.crop.mi.Vector3f(0, 0, -1), up, 1.0 / REFRACTIVE_INDEX)

    def _leave(self, state: _State, leaving: Any, where: tuple[Any, Any, Any, Any]) -> None:
        place, met, _, inside = where
        outside = self._bend(state.direction, -self.crop.mi.Vector3f(place.n), REFRACTIVE_INDEX)
        unseen = met & ~state.scattered  # what scattered has already looked for the lights
        sums = []
        for light, total in enumerate(state.sums):
            strength = self.crop.gather(self.crop.strength, place.prim_index, light, unseen)
            lobe = self._lobe(outside, self.crop.towards(light, inside))
            sums.append(total + self.crop.dr.select(unseen, leaving * strength * lobe, 0.0))
        state.sums = sums

    def _reflected(self, direction: Any, normal: Any, cosine: Any, pair: Any) -> Any:
        return direction - 2.0 * cosine * normal

    def _look(self, state: _State) -> None:
        """Light of one of the lights, chosen at random, that reaches a scattering event directly."""
        crop, random, point, ratio = self.crop, state.random, state.point, REFRACTIVE_INDEX
        mi, dr, count = crop.mi, crop.dr, len(state.sums)
        active = state.scattered & (point.z > crop.lowest_mm - DEEP / self.scattering)
        choice = dr.minimum(mi.UInt32(random.next_float32() * count), count - 1)
        aim = mi.Vector3f(0.0)
        for light in range(count):
            aim = dr.select(choice == light, crop.towards(light, point), aim)
        near = mi.warp.square_to_std_normal(self._pair(random))
        wide = mi.warp.square_to_cosine_hemisphere(self._pair(random))
        steered = random.next_float32() < STEERED
        x = dr.select(steered, aim.x / ratio + STEER * near.x, wide.x)
        y = dr.select(steered, aim.y / ratio + STEER * near.y, wide.y)
        possible = active & (x * x + y * y < 0.999)
        z = dr.safe_sqrt(1.0 - x * x - y * y)
        # both ways choose x and y in the unit disc: their densities there add; z turns them into one of directions
        off = (dr.square(x - aim.x / ratio) + dr.square(y - aim.y / ratio)) / (2.0 * STEER**2)
        density = z * (STEERED * dr.exp(-off) / (2.0 * dr.pi * STEER**2) + (1.0 - STEERED) / dr.pi)
        direction = mi.Vector3f(x, y, z)
        ray = mi.Ray3f(point, direction)
        found = crop.scene.ray_intersect_preliminary(ray, coherent=False, active=possible)
        met = found.is_valid() & possible
        normal = mi.Vector3f(found.compute_surface_interaction(ray, mi.RayFlags.Minimal, met).n)
        cosine = dr.dot(direction, normal)
        met &= cosine > 0.0
        fraction = 1.0 - mi.fresnel(dr.maximum(cosine, 1e-4), 1.0 / ratio)[0]
        strength = crop.gather(crop.strength, found.prim_index, choice, met)
        light_in = fraction * strength * self._lobe(self._bend(direction, -normal, ratio), aim)
        kept = state.weight * dr.exp(-(self.scattering + self.absorption) * found.t) / (4.0 * dr.pi)
        light_in = dr.select(met, kept * light_in / density * count, 0.0)
        state.sums = [total + dr.select(choice == light, light_in, 0.0) for light, total in enumerate(state.sums)]

    def _lobe(self, outside: Any, towards: Any) -> Any:
        """The light's lobe in a direction: a Gaussian of the angle, whose integral is one."""
        dr, variance = self.crop.dr, self.spread_rad**2
        return dr.exp((dr.dot(outside, towards) - 1.0) / variance) / (2.0 * dr.pi * variance)

    def _bend(self, direction: Any, normal: Any, ratio: float) -> Any:
        """Refract a direction at a boundary whose normal is against it; `ratio` is n before over n behind."""
        dr = self.crop.dr
        cosine = -dr.dot(direction, normal)
        behind = dr.safe_sqrt(1.0 - ratio * ratio * (1.0 - cosine * cosine))
        return self.crop.mi.Vector3f(dr.normalize(ratio * direction + (ratio * cosine - behind) * normal))


LLVM = ("lib/*/libLLVM.so.19*", "lib/llvm-19/lib/libLLVM.so*", "lib64/libLLVM.so.19*")
"""Where LLVM 19 is, below /usr."""

BATCHES = 8
"""Independent parts of the walks, from which the standard errors come; they share the samples evenly."""


@dataclass(frozen=True, slots=True)
class ReferenceSettings(Checked):
    """Boundary and effort of the reference."""

    boundary: Literal["diffuse", "smooth"] = "diffuse"
    """``diffuse``: what passes the boundary or is reflected inside is spread as by a matt surface; ``smooth``: it is
    refracted or mirrored at the triangles. Skin lies between them."""
    samples: Annotated[int, Limits(1)] = 128
    """Walks for each pixel."""
    seed: int = 0
    """What the walks are drawn from."""
    binning: Annotated[int, Limits(1)] = 2
    """Pixels of the surface's map along each side of one pixel of the result."""
    margin_mm: Annotated[float, Limits(0.0)] = 4.0
    """Ridged skin around the crop; a map that ends earlier is continued by mirroring."""
    spread_rad: Annotated[float, Limits(0.01, 0.3)] = 0.08
    """Standard deviation of a light's direction under a smooth boundary, through which a point is never found."""
    led_radius_mm: float = 1.5
    """Radius of an LED's emitting face; it widens the specular reflection."""
    bounces: Annotated[int, Limits(1)] = 2
    """Reflections off the surface that count as specular: 1 is not an inter-reflection."""
    threads: Annotated[int, Limits(1)] = 1
    """The result does not depend on it."""

    def __post_init__(self) -> None:
        check_fields(self)
        require(
            self.samples % BATCHES == 0,
            f"reference.samples must be a multiple of the {BATCHES} independent parts, but it is {self.samples}.",
        )


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceImage:
    """Radiance of a crop in the rig's units, in independent parts."""

    batches: FloatArray
    """(B, L, h, w)."""
    left: float
    """Fraction of the light that passes the boundary which comes out again, wherever: the albedo of flat skin."""
    steps: float
    """Mean number of steps of a walk."""

    @property
    def radiance(self) -> FloatArray:
        """(L, h, w) mean of the parts."""
        return np.asarray(self.batches.mean(axis=0, dtype=np.float64), dtype=np.float32)

    @property
    def standard_error(self) -> FloatArray:
        """(L, h, w) of `radiance`."""
        parts = self.batches.shape[0]
        return np.asarray(self.batches.std(axis=0, ddof=1, dtype=np.float64) / np.sqrt(parts), dtype=np.float32)


def render_crop(
    surface: SimulatedSurface, window: tuple[slice, slice], leds: Sequence[Led], optics: ChannelOptics,
    settings: ReferenceSettings | None = None,
) -> ReferenceImage:  # fmt: skip
    """Light that came through the skin, in one channel, by random walks in its volume.

    Parameters
    ----------
    surface : the skin on the camera's pixels; all of its map is there for light to wander in
    window : rows and columns of the crop on the map, multiples of ``settings.binning`` long
    leds : L lights; one walk serves all of them
    optics : the medium (its relief gain is not used: the walks know the ridges themselves)
    settings : boundary and effort

    Returns
    -------
    ReferenceImage of (h, w) pixels, in the units of :func:`splitknit_simulator.light.renderer.render_band`

    Raises
    ------
    BadInput
        If Mitsuba or LLVM is missing, the window does not fit, or the camera does not see skin all over it.
    """
    settings = settings or ReferenceSettings()
    return render_volume(reference_scene(surface, window, leds, settings), optics, settings)


def reference_scene(
    surface: SimulatedSurface, window: tuple[slice, slice], leds: Sequence[Led], settings: ReferenceSettings
) -> ReferenceScene:
    """Build triangles and lights once, for several channels; arguments as for :func:`render_crop`."""
    require(surface.camera.model == "orthographic", "the reference's walks start under an orthographic camera only.")
    engine = _load(settings.threads)
    return build(engine, surface, window, leds, binning=settings.binning, margin_mm=settings.margin_mm)


def render_volume(crop: ReferenceScene, optics: ChannelOptics, settings: ReferenceSettings) -> ReferenceImage:
    """Random walks of one channel; see :func:`render_crop`."""
    parts, walks = BATCHES, settings.samples // BATCHES
    smooth = settings.boundary == "smooth"
    seeds = np.random.SeedSequence([settings.seed, 0x3EF]).generate_state(2, np.uint64)
    seen = see(crop, parts, int(seeds[0]))
    sums, left, steps = _walk(
        crop, seen, (optics.scattering_per_mm, optics.absorption_per_mm),
        walks=walks, seed=int(seeds[1]), spread_rad=settings.spread_rad if smooth else None,
    )  # fmt: skip
    crop.dr.eval(sums, left, steps)
    # what is spread evenly inside leaves towards the camera as from a matt surface; a smooth one keeps directions
    scale = 1.0 / walks if smooth else 1.0 / (walks * np.pi * diffuse_transmittance())
    entered = 1.0 - np.asarray(crop.mi.fresnel(seen.normal.z, REFRACTIVE_INDEX)[0], dtype=np.float64)
    return ReferenceImage(
        _images(crop, [np.asarray(one) * scale for one in sums], parts),
        float(np.asarray(left, dtype=np.float64).sum() / (walks * entered.sum())),
        float(np.asarray(steps, dtype=np.float64).mean() / walks),
    )


def render_glare(
    crop: ReferenceScene, roughness: float, settings: ReferenceSettings, samples: int | None = None
) -> ReferenceImage:
    """Light that the surface alone reflects (GGX of `roughness`), with shadows and inter-reflection.

    `samples` rays a pixel are sent, ``settings.samples`` unless it is given. `left` of the result is the fraction of
    this light that had more than one reflection.
    """
    require(0.01 <= roughness <= 1, f"roughness must lie in [0.01, 1], but it is {roughness}.")
    rays = (samples or settings.samples) // BATCHES
    require(rays >= 1, f"samples must be at least the number of batches, {BATCHES}, but it is {samples}.")
    seeds = np.random.SeedSequence([settings.seed, 0x91A]).generate_state(2, np.uint64)
    seen = see(crop, BATCHES * rays, int(seeds[0]))
    orders = _reflect(
        crop, seen, roughness, radius_mm=settings.led_radius_mm, bounces=settings.bounces, seed=int(seeds[1])
    )
    sums = np.array([[np.asarray(one) for one in order] for order in orders], dtype=np.float64)
    by_part = sums.reshape(*sums.shape[:2], -1, rays).mean(axis=-1)
    total = by_part.sum(axis=0)
    return ReferenceImage(_images(crop, list(total), BATCHES), float(by_part[1:].sum() / max(total.sum(), 1e-30)), 1.0)


def _images(crop: ReferenceScene, lights: list[Any], parts: int) -> FloatArray:
    """(B, L, h, w) from the lanes of every single light."""
    rows, columns = crop.grid[:2]
    result = np.zeros((parts, max(crop.images) + 1, rows, columns))
    for image, light in zip(crop.images, lights, strict=True):
        result[:, image] += np.moveaxis(np.asarray(light, dtype=np.float64).reshape(rows, columns, parts), 2, 0)
    return result.astype(np.float32)


def _load(threads: int) -> tuple[Any, Any]:
    """Mitsuba and Dr.Jit with LLVM 19."""
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        found = [path for pattern in LLVM for path in sorted(Path("/usr").glob(pattern))]
        require(
            len(found) > 0,
            "the reference needs LLVM 19; install Debian's libllvm19, or name the library in DRJIT_LIBLLVM_PATH.",
        )
        os.environ["DRJIT_LIBLLVM_PATH"] = str(found[0])
    with importing("the reference needs Mitsuba 3; install the dependency group 'reference'."):
        dr, mi = (importlib.import_module(name) for name in ("drjit", "mitsuba"))
    mi.set_variant("llvm_ad_mono")
    dr.set_thread_count(threads)
    return mi, dr


# Light that the skin's surface alone reflects, ray by ray: the specular reflection of the reference.


def _reflect(
    crop: ReferenceScene, seen: Seen, roughness: float, *, radius_mm: float, bounces: int, seed: int
) -> list[list[Any]]:
    """Radiance of the surface reflection by lane: (bounces, L).

    At each place the microfacet reflection of every light is added, a random point of its face at a time, where no skin
    is in the way; then the ray is mirrored at a random facet and goes on to the next place. Source: Walter, Marschner,
    Li and Torrance 2007; Mitsuba's ``roughdielectric`` evaluates and samples it.
    """
    mi, dr, scene = crop.mi, crop.dr, crop.scene
    bsdf = mi.load_dict(
        {"type": "roughdielectric", "distribution": "ggx", "alpha": roughness, "int_ior": REFRACTIVE_INDEX,
         "ext_ior": 1.0}
    )  # fmt: skip
    random = mi.PCG32(initstate=mi.UInt64(seed), initseq=mi.UInt64(seen.lane))
    only = mi.BSDFContext()
    only.type_mask = int(mi.BSDFFlags.GlossyReflection)
    place = dr.zeros(mi.SurfaceInteraction3f, dr.width(seen.lane))
    place.p, place.n = seen.point, seen.normal
    direction, active, weight, result = mi.Vector3f(0, 0, -1), mi.Bool(seen.valid), mi.Float(1.0), []
    for _ in range(bounces):
        place.sh_frame = mi.Frame3f(place.n)
        place.wi = place.to_local(-direction)
        above = place.p + place.n * INSET_MM
        sums = []
        for position, power in crop.lights:
            middle = mi.Point3f(*position.tolist())
            face = mi.Frame3f(-dr.normalize(mi.Vector3f(middle)))  # the LEDs look at the origin
            spot = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(random.next_float32(), random.next_float32()))
            way = middle + radius_mm * (face.s * spot.x + face.t * spot.y) - above
            squared = dr.squared_norm(way)
            towards = way / dr.sqrt(squared)
            ray = mi.Ray3f(above, towards)
            ray.maxt = dr.sqrt(squared) * 0.999
            lit = active & (dr.dot(towards, place.n) > 0.0)
            if not crop.unshadowed:
                lit &= ~scene.ray_test(ray, lit)
            value = bsdf.eval(only, place, place.to_local(towards), lit)[0]
            sums.append(dr.select(lit, weight * value * power / squared, 0.0))
        result.append(sums)
        pair = mi.Point2f(random.next_float32(), random.next_float32())
        sample, factor = bsdf.sample(only, place, random.next_float32(), pair, active)
        direction = place.to_world(sample.wo)
        active = active & (sample.pdf > 0.0) & (dr.dot(direction, place.n) > 0.0)
        weight = weight * dr.select(active, factor[0], 0.0)
        place = scene.ray_intersect(mi.Ray3f(above, direction), active)
        active &= place.is_valid() & (dr.dot(direction, place.n) < 0.0)
    return result
