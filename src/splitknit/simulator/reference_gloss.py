"""Light that the skin's surface alone reflects, ray by ray: the glare of the reference."""

from __future__ import annotations

from typing import Any

from splitknit.simulator.diffusion import REFRACTIVE_INDEX
from splitknit.simulator.reference_scene import INSET_MM, ReferenceScene, Seen


def reflect(
    crop: ReferenceScene, seen: Seen, roughness: float, *, radius_mm: float, bounces: int, seed: int
) -> list[list[Any]]:
    """Radiance of the surface reflection by lane: (bounces, L).

    At each place the microfacet reflection of every light is added, a random point of its face at a time, where no
    skin is in the way; then the ray is mirrored at a random facet and goes on to the next place.

    References
    ----------
    Walter, Marschner, Li and Torrance 2007; Mitsuba's ``roughdielectric`` evaluates and samples it.
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
