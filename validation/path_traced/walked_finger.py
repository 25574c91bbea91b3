"""A slow reference for whole fingers: random walks in the volume below the ridged skin, compiled,
in minutes.

It shares no transport code with :mod:`splitknit_simulator.light.renderer`; the coefficients of skin
are the same. Light of every LED enters through the ridged surface, which diffuses a fraction of it
and refracts the rest at micro-facets. Where it is scattered for the first time, walks begin that
serve all LEDs of a band; rays from the pixels gather what they leave in the volume. So the noise is
mostly the same in all images of a channel. Scattering is isotropic with the reduced coefficient;
absorption, in two layers and mottled, weighs the light.

The finger is closed by the mirror image of its smooth shape from below, with walls along the
outline, and is mirrored where the picture ends. Skin hides the LEDs from skin (cast shadows), as
soft as their faces make it. Needs the extra ``reference`` (numba).
"""

from __future__ import annotations

import importlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Band, Capture
from splitknit.errors import BadInput, require
from splitknit.model import Camera, FloatArray, Led, Progress, Rig, no_progress
from splitknit.settings import Checked, Limits
from splitknit_simulator.camera.sensor import SensorSettings, record
from splitknit_simulator.light.films import Films, FilmSettings, mounted_films, moved
from splitknit_simulator.light.lighting import towards
from splitknit_simulator.light.skin import (
    BAND_CHANNELS,
    CHANNELS,
    REFRACTIVE_INDEX,
    Channel,
    SkinOptics,
    diffuse_transmittance,
    fresnel,
)
from splitknit_simulator.surface import SimulatedSurface

Array = NDArray[np.float64]

UNIT = 1e4
"""Irradiance of an LED of intensity one at 100 mm is one, as everywhere in the simulator."""
LENS_PX = 0.6
"""Standard deviation of the lens's blur in pixels."""
BACKGROUND = (0.006, -10.0)
"""Albedo and height in mm of the black background."""
BRIGHTEST_LEVEL = 0.7
"""Fraction of full scale that the brightest light from within the skin reaches."""
LAYERS = 32
"""Layers that hold the light, five to a mean free path."""
SCATTERED_SMOOTHING = (0.05, 0.4)
"""Gaussian that smooths a layer of scattered fluence: its standard deviation over the layer's
depth, and in pixels at least."""
STARTS_SMOOTHING = (0.15, 0.6)
"""The same for unscattered light where walks begin; where it is seen, it is not smoothed."""
MAX_SIGMA_PX = 3.0
"""Largest standard deviation of these Gaussians."""
REGRESSION_MM = (0.3, 0.15)
"""Windows of :func:`without_walk_noise`: of what all lights have in common, and of what each has of
its own."""
LED_FACE_MM = 1.5
"""Side of an LED's face, for the edge of its cast shadows."""
RAYS = 2
"""Along each side of a cell: rays of unscattered light into it, diffused and of each light, in each
half."""


@dataclass(frozen=True, slots=True)
class FingerOptics(Checked):
    """Optics of one finger of the reference, and noise of its photographs."""

    _group = "optics"

    spread: Annotated[float, Limits(0.0, 1.0)] = 1.0
    """Fraction of the light that the boundary diffuses; the rest it refracts."""
    scattering_factor: Annotated[float, Limits(0.3, 1.5)] = 1.0
    """Of the reduced scattering of the simulator's skin."""
    epidermis_mm: Annotated[float, Limits(0.0, 0.5)] = 0.12
    """Thickness of the layer that has melanin and no blood."""
    melanin: Annotated[float, Limits(0.0, 0.05)] = 0.002
    """Volume fraction of melanosomes in the epidermis."""
    blood: Annotated[float, Limits(0.0, 0.1)] = 0.006
    """Volume fraction of blood below it."""
    mottle: Annotated[float, Limits(0.0, 0.5)] = 0.15
    """Standard deviation of the absorption below the epidermis from place to place, relative."""
    mottle_mm: Annotated[float, Limits(0.1, 10.0)] = 1.0
    """Size of the mottles: standard deviation of the Gaussian that smooths them."""
    roughness: Annotated[float, Limits(0.05, 1.0)] = 0.25
    """GGX alpha of the surface."""
    gloss: Annotated[float, Limits(0.0, 5.0)] = 1.0
    """Weight of the specular reflection; 1 = Fresnel."""
    shot_noise: Annotated[float, Limits(0.0, 0.1)] = 0.005
    """Standard deviation of the shot noise, relative to light of the exposure's level; 0 = no
    noise."""


def draw_optics(rng: np.random.Generator) -> FingerOptics:
    """Draw a finger's optics from their ranges: the boundary from matt to refracted, light and
    dark, dry and oily."""
    low = FingerOptics(0.0, 0.3, 0.05, 0.001, 0.003, 0.05, 0.5, 0.15, 0.0, 0.003)
    high = FingerOptics(1.0, 1.5, 0.25, 0.006, 0.012, 0.25, 3.0, 0.45, 1.3, 0.01)
    at = rng.random(len(fields(FingerOptics)))
    ends = zip(asdict(low).items(), asdict(high).values(), at, strict=True)
    return FingerOptics(**{name: round(float(a + (b - a) * f), 5) for (name, a), b, f in ends})


@dataclass(frozen=True, slots=True, eq=False)
class _ChannelLight:
    """Light that came through the skin, in one channel."""

    halves: FloatArray
    """(2, L, H, W) radiance from two independent halves of the walks, zero outside the finger."""
    once: FloatArray
    """(L, H, W) the part of it that was scattered once and refracted in and out."""

    @property
    def radiance(self) -> FloatArray:
        """(L, H, W) mean of the halves."""
        return np.asarray(self.halves.mean(axis=0), dtype=np.float32)

    def noise(self, mask: NDArray[np.bool_]) -> dict[str, float]:
        """Relative standard error of a pixel of `mask`: the part common to all lights, and the rest
        of each light."""
        first, second = (
            cv2.GaussianBlur(np.moveaxis(half, 0, 2), (0, 0), LENS_PX)[mask] for half in self.halves
        )
        error = (first - second) / np.maximum(first + second, 1e-9)
        common = error.mean(axis=1)
        rest = (error - common[:, None]) * np.sqrt(error.shape[1] / max(error.shape[1] - 1, 1))
        return {"common": _rms(common), "each_light": _rms(rest)}


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def render_finger(
    surface: SimulatedSurface,
    leds: Sequence[Led],
    channel: Channel,
    optics: FingerOptics,
    *,
    walks: float = 16.0,
    rays: int = 12,
    threads: int = 2,
    seed: int = 0,
    progress: Progress = no_progress,
    entering: int | None = None,
) -> _ChannelLight:
    """Light from within the skin under each LED, by random walks in one channel.

    Parameters
    ----------
    surface : the finger on the pixels of an orthographic camera
    leds : L near lights without a lobe
    channel : ``red``, ``green``, ``blue`` or ``nir``
    optics : boundary, layers and coefficients
    walks : for each pixel, an even number
    threads : the result does not depend on it
    seed : of walks and mottles
    progress : called after each part of the walks
    entering : rays of unscattered light along each side of a cell; None: `RAYS`

    Raises
    ------
    BadInput
        If numba is missing, the camera is not orthographic, an LED is distant or has a lobe, or
        `walks` is odd.

    Examples
    --------
    >>> optics = FingerOptics(spread=0.3)
    >>> light = render_finger(surface, rig.leds[:7], "green", optics)  # doctest: +SKIP
    """
    require(
        walks > 0 and rays > 0,
        f"walks and rays must be above zero, but they are {walks} and {rays}.",
    )
    pitch = surface.camera.pitch_mm
    skin = SkinOptics(scattering_factor=optics.scattering_factor, melanin=0.0, blood=optics.blood)
    dermis = skin.channel(channel)
    epidermis = SkinOptics(melanin=optics.melanin, blood=0.0).channel(channel)
    inside = 1.0 - diffuse_transmittance() / REFRACTIVE_INDEX**2
    medium = np.array(
        [
            dermis.scattering_per_mm * pitch,
            dermis.absorption_per_mm * pitch,
            epidermis.absorption_per_mm * pitch,
            optics.epidermis_mm / pitch,
            optics.spread,
            optics.roughness / np.sqrt(2.0),
            REFRACTIVE_INDEX,
            inside,
        ]
    )
    solid = solid_of(surface, leds)
    mottle = _mottles(solid.lean.shape, pitch, optics, seed)
    return walk_solid(
        solid,
        surface,
        mottle,
        medium,
        walks=walks,
        rays=rays,
        threads=threads,
        seed=[seed, CHANNELS.index(channel)],
        progress=progress,
        entering=entering,
    )


# The finger as a solid, in pixels.


@dataclass(frozen=True, slots=True, eq=False)
class _Solid:
    """Two height maps, and the lights."""

    sides: FloatArray
    lean: FloatArray
    lights: Array
    strength: Array
    entering: FloatArray
    corner: tuple[int, int]
    """Row and column of the picture where the maps begin."""


def solid_of(surface: SimulatedSurface, leds: Sequence[Led]) -> _Solid:
    camera, pitch = surface.camera, surface.camera.pitch_mm
    require(
        camera.model == "orthographic",
        "the reference's walks start under an orthographic camera only.",
    )
    require(
        all(
            led.position_mm is not None and led.lobe_exponent == 0.0 and not led.also
            for led in leds
        ),
        "the reference of whole fingers knows single near LEDs without a lobe only.",
    )
    require(bool(surface.mask.any()), "no part of the finger is in the picture.")
    # the finger's pixels and an empty margin, but where the picture ends
    filled = [np.flatnonzero(surface.mask.any(axis=1 - axis)) for axis in range(2)]
    place = tuple(slice(max(int(occupied[0]) - 2, 0), int(occupied[-1]) + 3) for occupied in filled)
    mask, shape, height = surface.mask[place], surface.shape_mm[place], surface.height_mm[place]
    # below: the smooth shape's mirror image, or 12 mm where the finger has no outline
    rim = float(shape.min()) - 6.0 if mask.all() else float(np.percentile(shape[mask], 1))
    low = np.minimum(2.0 * rim - shape, height - 0.05)
    both = np.stack([np.where(mask, height, rim), np.where(mask, low, rim)], axis=-1) / pitch
    sides = np.ascontiguousarray(both, dtype=np.float32)
    lean = np.where(mask, np.clip(surface.shape_normals[place][..., 2], 0.15, 1.0), 0.15).astype(
        np.float32
    )
    corner = place[0].start, place[1].start
    rows, columns = surface.mask.shape
    lights = np.array([led.position_mm for led in leds], dtype=np.float64).reshape(-1, 3)
    columns_px = lights[:, 0] / pitch + (columns - 1) / 2 - corner[1]
    rows_px = (rows - 1) / 2 - lights[:, 1] / pitch - corner[0]
    lights = np.stack([columns_px, rows_px, lights[:, 2] / pitch], axis=1)
    strength = np.array([led.intensity for led in leds]) * UNIT / pitch**2
    return _Solid(sides, lean, lights, strength, _entering(sides, lights, strength, pitch), corner)


def _entering(sides: FloatArray, lights: Array, strength: Array, pitch: float) -> FloatArray:
    """(2, H - 1, W - 1, L) light that passes the boundary, for each cell between four pixel
    centres, of each side."""
    rows, columns = sides.shape[0] - 1, sides.shape[1] - 1
    result = np.zeros((2, rows, columns, len(lights)), dtype=np.float32)
    y, x = np.mgrid[0:rows, 0:columns] + 0.5
    for side in range(2):
        z = sides[..., side].astype(np.float64)
        across = 0.5 * (z[:-1, 1:] - z[:-1, :-1] + z[1:, 1:] - z[1:, :-1])
        down = 0.5 * (z[1:, :-1] - z[:-1, :-1] + z[1:, 1:] - z[:-1, 1:])
        middle = 0.25 * (z[:-1, :-1] + z[:-1, 1:] + z[1:, :-1] + z[1:, 1:])
        sign = 1.0 - 2.0 * side
        for k, (light, power) in enumerate(zip(lights, strength, strict=True)):
            way = light[0] - x, light[1] - y, light[2] - middle
            squared = way[0] ** 2 + way[1] ** 2 + way[2] ** 2
            facing = sign * (way[2] - across * way[0] - down * way[1])
            cosine = np.maximum(facing / np.sqrt(squared * (1.0 + across**2 + down**2)), 0.0)
            result[side, ..., k] = power / squared * cosine * (1.0 - fresnel(cosine))
            if side == 0:
                result[side, ..., k] *= _lit(middle, light - (0.5, 0.5, 0.0), LED_FACE_MM / pitch)
    return result


def _lit(height: Array, light: Array, face: float) -> FloatArray:
    """(H, W) part of an LED's face (a square of side `face`, upright) that no skin hides. All in
    pixels: `height` with z up, `light` column, row and z. Lines of sight are followed in steps that
    grow with the distance.
    """
    rows, columns = height.shape
    y, x = np.mgrid[0:rows, 0:columns].astype(np.float32)
    sharp = height.astype(np.float32)
    top = float(height.max())
    over = np.array((light[0] - (columns - 1) / 2, light[1] - (rows - 1) / 2))
    across = np.array((-over[1], over[0])) / max(float(np.hypot(*over)), 1e-9)
    seen = np.zeros((rows, columns), dtype=np.float32)
    for side, up in itertools.product((-0.25, 0.25), repeat=2):
        place = light + face * np.array((*(side * across), up))
        way = [np.float32(place[0]) - x, np.float32(place[1]) - y]
        far = np.maximum(np.hypot(*way), np.float32(1e-3))
        right = way[0] / far
        down = way[1] / far
        rise = (np.float32(place[2]) - sharp) / far
        free = np.ones((rows, columns), dtype=np.bool_)
        step = 0.7
        while step < min(
            max(rows, columns), (top - float(height.min())) / max(float(rise.min()), 1e-3) + 1.0
        ):
            x_there = x + np.float32(step) * right
            y_there = y + np.float32(step) * down
            there = cv2.remap(
                sharp, x_there, y_there, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            free &= there <= sharp + np.float32(step) * rise + np.float32(1e-3)
            step *= 1.0 + 0.12 / (1.0 + 4.0 / step)
        seen += free
    return seen / 4


def _mottles(size: tuple[int, int], pitch_mm: float, optics: FingerOptics, seed: int) -> FloatArray:
    """(H, W) factor of the absorption below the epidermis, one on average."""
    noise = (
        np.random.default_rng(np.random.SeedSequence([seed, 0x307]))
        .standard_normal(size)
        .astype(np.float32)
    )
    field = cv2.GaussianBlur(
        noise, (0, 0), optics.mottle_mm / pitch_mm, borderType=cv2.BORDER_REFLECT
    )
    field -= field.mean()
    factor = np.maximum(1.0 + optics.mottle * field / max(float(field.std()), 1e-9), 0.2)
    return np.asarray(factor, dtype=np.float32)


def walk_solid(
    solid: _Solid,
    surface: SimulatedSurface,
    mottle: FloatArray,
    medium: Array,
    *,
    walks: float,
    rays: int,
    threads: int,
    seed: Sequence[int],
    progress: Progress = no_progress,
    entering: int | None = None,
) -> _ChannelLight:
    """Walk from all pixels that see the finger."""
    numba, kernels = _load()
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    count, (rows, columns) = len(solid.lights), solid.lean.shape
    seeds = [
        int(value) for value in np.random.SeedSequence([*seed, 0x3A1]).generate_state(3, np.uint32)
    ]
    layer_px = 0.2 / medium[0]
    optics = solid.sides, solid.lean, mottle
    first = np.zeros((2, rows, columns, LAYERS, count), dtype=np.float32)
    kernels.first_light(
        *optics, solid.entering, solid.lights, medium, layer_px, entering or RAYS, seeds[0], first
    )
    _share_border(first, 2.0)
    starts = first.copy()
    _smooth(starts, solid.sides, layer_px, STARTS_SMOOTHING)
    progress("first light", 0.2)
    pixels = np.argwhere(surface.mask)
    _share_border(starts, 0.5)
    density = (
        0.5
        * walks
        * len(pixels)
        / max(
            float((starts.mean(axis=(0, 4), dtype=np.float64).sum(axis=-1) / solid.lean).sum()),
            1e-30,
        )
    )
    fluence = np.zeros_like(first)
    kernels.scatter(*optics, starts, layer_px, medium, density, seeds[1], fluence)
    del starts
    _share_border(fluence, 2.0)
    _smooth(fluence, solid.sides, layer_px, SCATTERED_SMOOTHING)
    fluence += first
    progress("scattering", 0.7)
    sums = np.zeros((len(pixels), 2, count))
    once = np.zeros((len(pixels), count))
    kernels.gather(
        *optics,
        solid.entering,
        fluence,
        first,
        layer_px,
        solid.lights,
        solid.strength,
        medium,
        pixels - solid.corner,
        rays,
        seeds[2],
        sums,
        once,
    )
    progress("gathering", 1.0)
    halves = np.zeros((2, count, *surface.mask.shape), dtype=np.float32)
    halves[:, :, pixels[:, 0], pixels[:, 1]] = np.transpose(sums, (1, 2, 0)) / rays
    single = np.zeros(halves.shape[1:], dtype=np.float32)
    single[:, pixels[:, 0], pixels[:, 1]] = once.T / (2 * rays)
    return _ChannelLight(halves, single)


def _share_border(fluence: FloatArray, factor: float) -> None:
    """Multiply the cells at the border, half of which lies beyond it, mirrored: from energy to
    density or back."""
    fluence[:, [0, -1]] *= factor
    fluence[:, :, [0, -1]] *= factor


def _smooth(
    fluence: FloatArray, sides: FloatArray, layer_px: float, by: tuple[float, float]
) -> None:
    """Smooth every layer of the fluence, within which light varies little."""
    inside = (sides[..., 0] - sides[..., 1] > 1e-2).astype(np.float32)
    for layer in range(fluence.shape[3]):
        sigma = min(max(by[0] * (layer + 0.5) * layer_px, by[1]), MAX_SIGMA_PX)
        size = 2 * int(np.ceil(2.5 * sigma)) + 1

        def blur(values: FloatArray, size: int = size, sigma: float = sigma) -> Any:
            return cv2.GaussianBlur(values, (size, size), sigma, borderType=cv2.BORDER_REFLECT_101)

        weight = inside / np.maximum(blur(inside), 1e-3)
        for half in fluence[..., layer, :]:
            half[...] = blur(np.ascontiguousarray(half)) * weight[..., None]


def _load() -> tuple[Any, Any]:
    try:
        numba = importlib.import_module("numba")
    except ImportError as error:
        raise BadInput(
            "the reference of whole fingers needs numba; install the dependency group 'reference'."
        ) from error
    return numba, importlib.import_module("finger_walks")


# Light that the surface alone reflects.


def specular(
    surface: SimulatedSurface, led: Led, roughness: float, fine: SimulatedSurface | None = None
) -> FloatArray:
    """(H, W) radiance of the GGX reflection at the ridged skin, without inter-reflection.

    `fine`: the same finger with several pixels along each side of one of `surface`, whose mean is
    taken. On steep flanks the slope at a pixel's centre is not that of its heights: integrated, it
    gives 0.95 of a ridge at 30 to 45 deg and 0.72 at 45 to 60.

    References
    ----------
    Walter, Marschner, Li and Torrance 2007, equations (20), (33), (34).
    """
    (rows, columns), pitch, light = (
        surface.mask.shape,
        surface.camera.pitch_mm,
        np.asarray(led.position_mm),
    )
    total = pixel_means(reflected(fine or surface, led, roughness), surface)
    column, row = light[0] / pitch + (columns - 1) / 2, (rows - 1) / 2 - light[1] / pitch
    beside = float(surface.shape_mm[surface.mask].min()) - 6.0
    heights = np.where(surface.mask, surface.height_mm, beside) / pitch
    total *= _lit(heights, np.array((column, row, light[2] / pitch)), LED_FACE_MM / pitch)
    return np.asarray(total, dtype=np.float32)


def pixel_means(field: Array, surface: SimulatedSurface) -> Array:
    rows, columns = surface.mask.shape
    return np.asarray(field.reshape(rows, len(field) // rows, columns, -1).mean(axis=(1, 3)))


def reflected(surface: SimulatedSurface, led: Led, roughness: float) -> Array:
    """(H, W) radiance at the pixels' centres, no skin hiding the light."""
    normals, (x, y) = surface.normals.astype(np.float64), pixel_places(surface.camera)
    height = np.where(surface.mask, surface.height_mm, 0.0)
    way = np.asarray(led.position_mm) - np.stack([x, y, height], axis=-1)
    squared = np.sum(way * way, axis=-1)
    towards = way / np.sqrt(squared)[..., None]
    half = towards + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    n_l = np.sum(normals * towards, -1)
    n_v = normals[..., 2]
    n_h = np.sum(normals * half, -1)
    seen = surface.mask & (n_l > 1e-3) & (n_v > 1e-3)
    n_l, n_v, square = np.maximum(n_l, 1e-3), np.maximum(n_v, 1e-3), roughness**2
    facets = square / (np.pi * (n_h**2 * (square - 1.0) + 1.0) ** 2)
    shadow = np.ones_like(n_l)
    for cosine in (n_l, n_v):
        shadow = shadow * 2.0 * cosine / (cosine + np.sqrt(square + (1.0 - square) * cosine**2))
    light = (
        led.intensity
        * UNIT
        / squared
        * facets
        * shadow
        * fresnel(np.sum(half * towards, -1))
        / (4.0 * n_v)
    )
    return np.where(seen, light, 0.0)


def pixel_places(camera: Camera) -> tuple[Array, Array]:
    """x and y of the pixels' centres in mm."""
    height, width = camera.image_size
    x = (np.arange(width) - (width - 1) / 2) * camera.pitch_mm
    y = ((height - 1) / 2 - np.arange(height)) * camera.pitch_mm
    grid = np.meshgrid(x, y)
    return grid[0], grid[1]


# Photographs.


@dataclass(frozen=True, slots=True, eq=False)
class FingerLight:
    """Light that came through the skin under every LED of a rig, and the noise of its walks."""

    diffuse: Mapping[str, FloatArray]
    """For each band (L, H, W, 3)."""
    once: Mapping[str, FloatArray]
    """For each band (L, H, W, 3) the part that was scattered once and refracted in and out."""
    channels: Mapping[str, Any]
    """For each channel level, noise and coefficients."""


def walk_finger(
    surface: SimulatedSurface,
    rig: Rig,
    optics: FingerOptics,
    *,
    walks: float = 16.0,
    rays: int = 12,
    threads: int = 2,
    seed: int = 0,
    progress: Progress = no_progress,
    entering: int | None = None,
) -> FingerLight:
    """Walk in a finger under every LED of `rig`; arguments and errors as in
    :func:`photograph_finger` and :func:`render_finger`.
    """
    diffuse, once, channels = {}, {}, {}
    todo = [(name, channel) for name, names in BAND_CHANNELS.items() for channel in names]
    seen = cv2.erode(surface.mask.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    seen &= surface.shape_normals[..., 2] > 0.5
    for name, names in BAND_CHANNELS.items():
        leds = [led for led in rig.leds if led.band == name]
        if not leds:
            continue
        light, single = [], []
        for channel in names:
            done = todo.index((name, channel))

            def report(_: str, fraction: float, channel: str = channel, done: int = done) -> None:
                progress(channel, (done + fraction) / len(todo))

            rendered = render_finger(
                surface,
                leds,
                channel,
                optics,
                walks=walks,
                rays=rays,
                threads=threads,
                seed=seed,
                progress=report,
                entering=entering,
            )
            light.append(rendered.radiance)
            single.append(rendered.once)
            channels[channel] = {
                "level": float(np.median(rendered.radiance[:, seen])),
                "once_scattered": float(np.median(rendered.once[:, seen])),
                "noise": rendered.noise(seen),
                **_coefficients(channel, optics),
            }
        diffuse[name], once[name] = (
            np.stack([channel_images[min(c, len(channel_images) - 1)] for c in range(3)], axis=-1)
            for channel_images in (light, single)
        )
    return FingerLight(diffuse, once, channels)


def without_walk_noise(light: FingerLight, surface: SimulatedSurface) -> FingerLight:
    """The light with most of the walks' noise taken away by regression on the true surface.

    Around every pixel each image is explained, by weighted least squares within a Gaussian window,
    by place, relief and slopes, as they are and smoothed; the pixel then has what these explain.
    What all lights have in common is noisier and has a wider window than what each has of its own.

    References
    ----------
    Bitterli et al. 2016, Nonlinearly weighted first-order regression for denoising Monte Carlo
    renderings.
    """
    common, own = (_Regression(surface, width) for width in REGRESSION_MM)

    def smooth(images: FloatArray, regressions: tuple[_Regression, _Regression]) -> FloatArray:
        smoothed = np.empty_like(images)
        for c in range(images.shape[3]):
            mean = images[..., c].mean(axis=0, dtype=np.float64)
            level = regressions[0](mean)
            for k, image in enumerate(images[..., c]):
                smoothed[k, ..., c] = np.maximum(level + regressions[1](image - mean), 0.0)
        return smoothed

    diffuse = {name: smooth(images, (common, own)) for name, images in light.diffuse.items()}
    once = {name: smooth(images, (own, own)) for name, images in light.once.items()}
    return FingerLight(diffuse, once, light.channels)


class _Regression:
    """Local linear regression of images on the geometry of a surface."""

    def __init__(self, surface: SimulatedSurface, width_mm: float) -> None:
        """`width_mm`: standard deviation of the window."""
        self.mask, self.sigma = surface.mask, width_mm / surface.camera.pitch_mm
        pitch = surface.camera.pitch_mm
        weight = self.mask.astype(np.float64)

        def smooth(field: Array, by_mm: float) -> Array:
            blur = [
                cv2.GaussianBlur(array, (0, 0), by_mm / pitch) for array in (field * weight, weight)
            ]
            return np.asarray(blur[0] / np.maximum(blur[1], 1e-3), dtype=np.float64)

        relief = 10.0 * np.where(self.mask, surface.height_mm - surface.shape_mm, 0.0).astype(
            np.float64
        )
        slopes = [surface.normals[..., axis].astype(np.float64) for axis in range(2)]
        self.features = np.stack(
            [
                *pixel_places(surface.camera),
                relief,
                smooth(relief, 0.06),
                smooth(relief, 0.13),
                *slopes,
                *(smooth(slope, 0.06) for slope in slopes),
            ]
        )
        self.weight = self._window(np.ones(self.mask.shape))
        self.means = [self._mean(field) for field in self.features]
        count = len(self.features)
        spread = np.empty((self.weight.size, count, count))
        for i, first in enumerate(self.features):
            for j, second in enumerate(self.features[: i + 1]):
                spread[:, i, j] = self._mean(first * second) - self.means[i] * self.means[j]
                spread[:, j, i] = spread[:, i, j]
        spread[:, range(count), range(count)] += 1e-5
        here = self.features[:, self.mask].T - np.stack(self.means, axis=1)
        self.factors = np.linalg.solve(spread, here[..., None])[..., 0]

    def __call__(self, image: NDArray[Any]) -> Array:
        """(H, W) what the geometry explains of an image."""
        image = image.astype(np.float64)
        mean = self._mean(image)
        explained = mean.copy()
        for k, field in enumerate(self.features):
            explained += self.factors[:, k] * (self._mean(field * image) - self.means[k] * mean)
        result = np.zeros(self.mask.shape)
        result[self.mask] = explained
        return result

    def _window(self, field: Array) -> Array:
        inside = np.where(self.mask, field, 0.0)
        return np.asarray(
            cv2.GaussianBlur(inside, (0, 0), self.sigma, borderType=cv2.BORDER_REFLECT)[self.mask]
        )

    def _mean(self, field: Array) -> Array:
        return self._window(field) / self.weight


def photograph_finger(
    surface: SimulatedSurface,
    rig: Rig,
    optics: FingerOptics,
    *,
    walks: float = 16.0,
    rays: int = 12,
    threads: int = 2,
    seed: int = 0,
    progress: Progress = no_progress,
    light: FingerLight | None = None,
    films: FilmSettings | None = None,
    moved_mm: tuple[float, float] = (0.0, 0.0),
    fine: SimulatedSurface | None = None,
) -> tuple[Capture, dict[str, NDArray[Any]], dict[str, Any]]:
    """Photograph a finger under every LED of `rig` by random walks.

    Parameters
    ----------
    surface : the finger on the pixels of `rig.camera`
    rig : LEDs of the bands ``white`` and ``nir``
    optics : of skin, surface and noise
    walks : for each pixel and channel
    threads : the result does not depend on it
    seed : of walks, mottles and noise
    progress : called with the channel and the fraction of all walks
    light : of :func:`walk_finger` with the same arguments; None: walk
    films : before the white LEDs and the camera: the white band becomes a parallel and a crossed
    series of the same
        LEDs (``analyser``)
    moved_mm : by which the finger has moved (x, y up) after the parallel series; its light is taken
    as unchanged
    fine : see :func:`specular`; true heights are its pixels' means too

    Returns
    -------
    capture : 16-bit images of both bands
    truth : ``height_mm``, ``shape_mm``, ``ridge_mm``, ``mask``, ``px_mm``
    info : all optics, and for each channel level and noise of the walks

    Raises
    ------
    BadInput
        As :func:`render_finger`.
    """
    require(
        films is None or films.kind == "analyser",
        "the reference knows films before the same LEDs only.",
    )
    light = light or walk_finger(
        surface, rig, optics, walks=walks, rays=rays, threads=threads, seed=seed, progress=progress
    )
    bands = {}
    noise_seeds = np.random.SeedSequence([seed, 0x4C0]).spawn(len(rig.leds))
    for name, diffuse in light.diffuse.items():
        members = [k for k, led in enumerate(rig.leds) if led.band == name]
        if name == "white" and films is not None:
            mount_seed = np.random.SeedSequence([seed, 0x4C2])
            mounted = mounted_films(
                films, [rig.leds[k] for k in members], np.random.default_rng(mount_seed)
            )
            frames = _polarised((surface, fine), rig, optics, light, mounted)
            series = [name, "white_crossed"]
            seeds = [*noise_seeds, *np.random.SeedSequence([seed, 0x4C1]).spawn(len(members))]
            numbers = [members, [len(rig.leds) + k for k in range(len(members))]]
        else:
            frames = np.empty((1, *diffuse.shape), dtype=np.float32)
            for k, member in enumerate(members):
                led = rig.leds[member]
                frames[0, k] = (
                    diffuse[k]
                    + optics.gloss * specular(surface, led, optics.roughness, fine)[..., None]
                )
                frames[0, k] += _background_beside(surface, led)
            series, seeds, numbers = [name], noise_seeds, [members]
        level = diffuse if len(frames) == 1 else frames[0]
        exposure = BRIGHTEST_LEVEL / max(float(np.percentile(level[:, surface.mask], 99.9)), 1e-12)
        for key, shots, seeds_of in zip(series, frames, numbers, strict=True):
            shift = rig.camera.px_per_mm * np.array([moved_mm[0], -moved_mm[1]]) * (key != "white")
            images = []
            for k, frame in enumerate(shots):
                seen = cv2.GaussianBlur(moved(frame * np.float32(exposure), shift), (0, 0), LENS_PX)
                images.append(record(seen, name, seeds[seeds_of[k]], _sensor(optics)))
            none = np.zeros(len(members))
            bands[key] = Band(
                key,
                np.stack(images).astype(np.uint16),
                tuple((k,) for k in members),
                none + 1.0,
                none,
            )
    if "white_crossed" in bands:
        bands = {
            "white": replace(bands["white"], polarisation="parallel"),
            "white_crossed": replace(bands["white_crossed"], polarisation="crossed"),
        } | {name: band for name, band in bands.items() if name == "nir"}
    height = surface.height_mm
    if fine is not None:
        whole = pixel_means(fine.mask, surface) == 1.0
        height = np.where(
            whole, pixel_means(np.where(fine.mask, fine.height_mm, 0.0), surface), height
        )
    truth = {
        "height_mm": height.astype(np.float32),
        "shape_mm": surface.shape_mm,
        "ridge_mm": height.astype(np.float32) - surface.shape_mm,
        "mask": surface.mask,
        "px_mm": np.array(surface.camera.pitch_mm),
    }
    info = {
        "optics": asdict(optics),
        "channels": dict(light.channels),
        "walks": walks,
        "seed": seed,
        "finger_pixels": int(surface.mask.sum()),
    }
    if films is not None:
        info |= {"films": asdict(films), "moved_mm": list(moved_mm)}
    return Capture(rig=rig, bands=bands), truth, info


def _polarised(
    skin: tuple[SimulatedSurface, SimulatedSurface | None],
    rig: Rig,
    optics: FingerOptics,
    light: FingerLight,
    mounted: Films,
) -> FloatArray:
    """(2, L, H, W, 3) radiance behind the films, parallel and crossed, under every white LED."""
    surface, fine = skin
    leds = [led for led in rig.leds if led.band == "white"]
    diffuse = light.diffuse["white"]
    once = light.once["white"]
    passing = mounted.transmitted()
    x, y = pixel_places(surface.camera)
    z = np.where(surface.mask, surface.height_mm, 0.0)
    frames = np.empty((2, *diffuse.shape), dtype=np.float32)
    for k, led in enumerate(leds):
        gloss = optics.gloss * specular(surface, led, optics.roughness, fine)
        (lx, ly, lz), _ = towards(led, (x, y, z))
        background = _background_beside(surface, led)
        for series in range(2):
            mirrored = gloss * mounted.specular(series, k, (lx, ly, lz), (0.0, 0.0, 1.0))
            kept = mounted.once_scattered(series, k, (lx, ly, lz), (0.0, 0.0, 1.0))
            frame = (
                mounted.depolarised * (diffuse[k] + background)
                + kept[..., None] * once[k]
                + mirrored[..., None]
            )
            frame = frame * passing
            frames[series, k] = moved(frame.astype(np.float32), series * mounted.shift_px)
    return frames


def _background_beside(surface: SimulatedSurface, led: Led) -> FloatArray:
    """(H, W, 1) radiance of the black background, none where the finger is."""
    return np.where(surface.mask, 0.0, _background(surface.camera, led))[..., None].astype(
        np.float32
    )


def _coefficients(channel: Channel, optics: FingerOptics) -> dict[str, float]:
    dermis = SkinOptics(
        scattering_factor=optics.scattering_factor, melanin=0.0, blood=optics.blood
    ).channel(channel)
    epidermis = SkinOptics(melanin=optics.melanin, blood=0.0).channel(channel)
    return {
        "scattering_per_mm": dermis.scattering_per_mm,
        "absorption_per_mm": dermis.absorption_per_mm,
        "epidermis_absorption_per_mm": epidermis.absorption_per_mm,
    }


def _background(camera: Camera, led: Led) -> Array:
    """(H, W) radiance of the black background under `led`."""
    albedo, z = BACKGROUND
    x, y = pixel_places(camera)
    light = np.asarray(led.position_mm, dtype=np.float64)
    squared = (light[0] - x) ** 2 + (light[1] - y) ** 2 + (light[2] - z) ** 2
    return np.asarray(albedo / np.pi * led.intensity * UNIT * (light[2] - z) / squared**1.5)


def _sensor(optics: FingerOptics) -> SensorSettings:
    """A sensor whose shot noise at the exposure's level is that of `optics`, of 12 bits in files of
    16."""
    if optics.shot_noise == 0.0:
        return SensorSettings(noise=False, bits=16, raw_bits=16)
    full = 1.0 / (BRIGHTEST_LEVEL * optics.shot_noise**2)
    return SensorSettings(full_well_e=full, binned=False, raw_bits=12, bits=16)
