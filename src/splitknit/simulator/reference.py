"""A slow reference for the twin: random walks in the skin's volume under its true, ridged surface.

It shares no code with :mod:`splitknit.simulator.renderer`: a patch of skin becomes triangles, Mitsuba 3 finds where
rays meet them, and every image is an average of random walks with a standard error. Needs the extra ``reference`` and
Debian's ``libllvm19`` (other versions may abort). See ``docs/twin-reference.md``.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.errors import BadInput, require
from splitknit.model import FloatArray, Led
from splitknit.simulator.diffusion import REFRACTIVE_INDEX, diffuse_transmittance
from splitknit.simulator.reference_scene import INSET_MM, ReferenceScene, Seen, build, see
from splitknit.simulator.reference_walk import walk
from splitknit.simulator.skin import ChannelOptics
from splitknit.simulator.surface import Surface

LLVM = ("lib/*/libLLVM.so.19*", "lib/llvm-19/lib/libLLVM.so*", "lib64/libLLVM.so.19*")
"""Where LLVM 19 is, below /usr."""


@dataclass(frozen=True, slots=True)
class ReferenceSettings:
    """Boundary and effort of the reference."""

    boundary: str = "diffuse"
    """``diffuse``: what passes the boundary or is reflected inside is spread as by a matt surface; ``smooth``: it is
    refracted or mirrored at the triangles. Skin lies between them."""
    samples: int = 128
    """Walks for each pixel."""
    batches: int = 8
    """Independent parts of the walks, from which the standard errors come; they share `samples` evenly."""
    seed: int = 0
    """What the walks are drawn from."""
    binning: int = 2
    """Pixels of the surface's map along each side of one pixel of the result."""
    margin_mm: float = 4.0
    """Ridged skin around the crop; a map that ends earlier is continued by mirroring."""
    spread_rad: float = 0.08
    """Standard deviation of a light's direction under a smooth boundary, through which a point is never found."""
    led_radius_mm: float = 1.5
    """Radius of an LED's emitting face; it widens the glare."""
    bounces: int = 2
    """Reflections off the surface that glare counts: 1 is no inter-reflection."""
    threads: int = 1
    """The result does not depend on it."""

    def __post_init__(self) -> None:
        require(
            self.boundary in ("diffuse", "smooth"),
            f"reference.boundary must be 'diffuse' or 'smooth', but it is '{self.boundary}'.",
        )
        require(self.batches >= 2, f"reference.batches must be at least 2, but it is {self.batches}.")
        require(
            self.samples >= self.batches and self.samples % self.batches == 0,
            f"reference.samples must be a multiple of batches ({self.batches}), but it is {self.samples}.",
        )
        require(self.binning >= 1, f"reference.binning must be at least 1, but it is {self.binning}.")
        require(self.margin_mm >= 0, f"reference.margin_mm must not be negative, but it is {self.margin_mm}.")
        require(0.01 <= self.spread_rad <= 0.3, f"reference.spread_rad must be 0.01 to 0.3, not {self.spread_rad}.")
        require(self.bounces >= 1, f"reference.bounces must be at least 1, but it is {self.bounces}.")
        require(self.threads >= 1, f"reference.threads must be at least 1, but it is {self.threads}.")


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceImage:
    """Radiance of a crop in the rig's units, in independent parts."""

    batches: FloatArray
    """(B, L, h, w)."""
    left: float
    """Share of the light that passes the boundary which comes out again, wherever: the albedo of flat skin."""
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
    surface: Surface, window: tuple[slice, slice], leds: Sequence[Led], optics: ChannelOptics,
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
    ReferenceImage of (h, w) pixels, in the units of :func:`splitknit.simulator.renderer.render_band`

    Raises
    ------
    BadInput
        If Mitsuba or LLVM is missing, the window does not fit, or the camera does not see skin all over it.
    """
    settings = settings or ReferenceSettings()
    return render_volume(reference_scene(surface, window, leds, settings), optics, settings)


def reference_scene(
    surface: Surface, window: tuple[slice, slice], leds: Sequence[Led], settings: ReferenceSettings
) -> ReferenceScene:
    """Build triangles and lights once, for several channels; arguments as for :func:`render_crop`."""
    require(surface.camera.model == "orthographic", "the reference's walks start under an orthographic camera only.")
    engine = _load(settings.threads)
    return build(engine, surface, window, leds, binning=settings.binning, margin_mm=settings.margin_mm)


def render_volume(crop: ReferenceScene, optics: ChannelOptics, settings: ReferenceSettings) -> ReferenceImage:
    """Random walks of one channel; see :func:`render_crop`."""
    parts, walks = settings.batches, settings.samples // settings.batches
    smooth = settings.boundary == "smooth"
    seeds = np.random.SeedSequence([settings.seed, 0x3EF]).generate_state(2, np.uint64)
    seen = see(crop, parts, int(seeds[0]))
    sums, left, steps = walk(
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

    `samples` rays a pixel are sent, ``settings.samples`` unless it is given. `left` of the result is the share of this
    light that had more than one reflection.
    """
    require(0.01 <= roughness <= 1, f"roughness must lie in [0.01, 1], but it is {roughness}.")
    rays = (samples or settings.samples) // settings.batches
    require(rays >= 1, f"samples must be at least the number of batches, {settings.batches}, but it is {samples}.")
    seeds = np.random.SeedSequence([settings.seed, 0x91A]).generate_state(2, np.uint64)
    seen = see(crop, settings.batches * rays, int(seeds[0]))
    orders = reflect(
        crop, seen, roughness, radius_mm=settings.led_radius_mm, bounces=settings.bounces, seed=int(seeds[1])
    )
    sums = np.array([[np.asarray(one) for one in order] for order in orders], dtype=np.float64)
    by_part = sums.reshape(*sums.shape[:2], -1, rays).mean(axis=-1)
    total = by_part.sum(axis=0)
    return ReferenceImage(
        _images(crop, list(total), settings.batches), float(by_part[1:].sum() / max(total.sum(), 1e-30)), 1.0
    )


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
    try:
        dr, mi = (importlib.import_module(name) for name in ("drjit", "mitsuba"))
    except ImportError as error:
        raise BadInput("the reference needs Mitsuba 3; install splitknit with its extra 'reference'.") from error
    mi.set_variant("llvm_ad_mono")
    dr.set_thread_count(threads)
    return mi, dr


# Light that the skin's surface alone reflects, ray by ray: the glare of the reference.


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
