"""Random walks below the skin's triangles: the kernel of the reference.

Mitsuba and Dr.Jit come in with the scene; only :mod:`splitknit.simulator.reference` imports them. A walk starts
where the camera sees the skin and looks for the lights. Between boundaries it takes exponential steps of the mean free
path and turns isotropically; absorption weighs it by exp(-a length); roulette ends it. Every lane of the computation
walks for one pixel, one walk after the other, with random numbers of its own: the result depends on the seed alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from splitknit.simulator.diffusion import REFRACTIVE_INDEX
from splitknit.simulator.reference_scene import INSET_MM, ReferenceScene, Seen

FAINT = 0.1
"""Below this weight a walk goes on with half the chance that its weight would give, and twice FAINT as weight."""
DEEP = 12.0
"""Mean free paths below the deepest valley beyond which a walk looks for no light: exp(-12) would be left of it."""
STEER = 0.16
"""Standard deviation of the direction (its x and y) in which a scattered walk looks for a light through the skin."""
STEERED = 0.85
"""Share of those looks that are steered towards a light; the others go anywhere upwards."""


def walk(
    crop: ReferenceScene,
    seen: Seen,
    medium: tuple[float, float],
    *,
    walks: int,
    seed: int,
    spread_rad: float | None,
) -> tuple[list[Any], Any, Any]:
    """Walk `walks` times from each seen point; return the lights' sums, the light that left, and the steps, by lane.

    With a diffuse boundary (`spread_rad` None), the Fresnel terms say how much passes, and what passes or is reflected
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
        share = 1.0 - mi.fresnel(dr.maximum(cosine, 1e-4), 1.0 / ratio)[0]
        strength = crop.gather(crop.strength, found.prim_index, choice, met)
        light_in = share * strength * self._lobe(self._bend(direction, -normal, ratio), aim)
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
