"""Light from the LEDs through the skin and off it: noise-free linear radiance of every image.

See ``docs/explain/simulator.md``: irradiance of near LEDs times Fresnel transmittance, convolved
along the skin with the Monte Carlo diffusion profile of each channel, times a term for the relief,
plus the GGX reflection of the surface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Annotated, Any

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy import ndimage

from splitknit import Led
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.settings import Checked, Limits
from splitknit_simulator.light.coat import CoatedPatch
from splitknit_simulator.light.lighting import (
    Patch,
    Vectors,
    arriving,
    cut_out,
    dot,
    light_on,
    towards,
)
from splitknit_simulator.light.skin import (
    CHANNELS,
    Channel,
    Medium,
    diffuse_transmittance,
    diffusion_profile,
    fresnel,
)
from splitknit_simulator.surface import SimulatedSurface, Window

BLOOD: dict[Channel, float] = {"red": 0.15, "green": 1.0, "blue": 0.8, "nir": 0.05}
"""How strongly mottled blood darkens each channel, relative to green."""


@dataclass(frozen=True, slots=True)
class RenderSettings(Checked):
    """What of the light is modelled."""

    reach_mm: Annotated[float, Limits(0, 30, above=True)] = 6.0
    """Diffusion over longer distances may wrap around the image; larger costs time."""
    aperture_mm: Annotated[float, Limits(0, 50)] = 0.0
    """Diameter of the lens's entrance pupil; 0 switches defocus off. f/2 at 11 mm of focal length
    is 5.5 mm."""
    focus_depth_mm: float = 1.5
    """Depth of the plane in focus below the finger's highest point."""
    rim_exponent: Annotated[float, Limits(0, 1)] = 0.75
    """Near the outline, part of the diffusion profile falls beside the picture of the finger; the
    light is divided by the fraction inside to this power. Between 0 (no light there) and 1 (the
    same light there): 0.75 follows a random walk in an elliptic cylinder best
    (``validation/twin``)."""
    workers: Annotated[int, Limits(1)] = 2
    """Threads; the result does not depend on it."""


@dataclass(frozen=True, slots=True, eq=False)
class BandLight:
    """Radiance of the finger inside `window`, in units of the rig's intensities."""

    window: Window  # rows and columns of the frame
    diffuse: FloatArray  # (L, C, h, w) light that came through the skin, C = 3 (white) or 1 (NIR)
    glare: FloatArray  # (L, h, w) light that the surface alone reflects, the same in all channels


def render_band(
    surface: SimulatedSurface,
    leds: Sequence[Led],
    skin: Medium,
    settings: RenderSettings | None = None,
) -> BandLight:
    """Render the finger under each of `leds`, one image a light.

    Jensen et al. 2001, equation (5) (subsurface term); Walter et al. 2007, equations (20), (33),
    (34) (reflection).
    """
    settings = settings or RenderSettings()
    if any(led.also for led in leds):
        groups = [(replace(led, also=()), *led.also) for led in leds]
        each = render_band(surface, [led for group in groups for led in group], skin, settings)
        starts = np.cumsum([0, *(len(group) for group in groups[:-1])])
        return replace(
            each,
            diffuse=np.add.reduceat(each.diffuse, starts),
            glare=np.add.reduceat(each.glare, starts),
        )
    patch = cut_out(surface, shadows=True)
    relief = Relief(surface, patch, skin)
    blur = SubsurfaceScattering(patch, skin, settings, blurred=skin.boundary.blurred)
    if surface.texture is not None:
        blood, grain = surface.texture.blood[patch.window], surface.texture.grain
        relief.colour(lambda pigment, name: pigment * np.exp(-BLOOD[name] * blood))
        if grain is not None:
            relief.colour(
                lambda pigment, name: pigment * grain[(CHANNELS.index(name), *patch.window)]
            )
    if surface.coat is not None:
        coat = CoatedPatch(surface.coat, patch, surface.shape_normals[patch.window], skin.roughness)
        relief.colour(coat.over)

        def shine(k: int) -> Shine:
            return coat.light_on(leds[k], skin.glare)

    else:
        patches: Any = np.float32(skin.glare)
        if surface.texture is not None:
            patches = patches * surface.texture.gloss[patch.window]

        def shine(k: int) -> Shine:
            entering, gloss = light_on(patch, leds[k], skin.roughness)
            return entering, gloss * patches, None

        if skin.boundary.refraction > 0 or skin.boundary.entry_power != 1:
            blur.enter_by(skin, surface.shape_normals[patch.window], leds)

    return render_lights(patch, shine, len(leds), blur, lambda k: relief.gains(leds[k]))


Shine = tuple[FloatArray, FloatArray, FloatArray | None]
"""(h, w) light that enters the skin, that the surface reflects, and that what lies on it scatters
(None: nothing)."""


def render_lights(
    patch: Patch,
    shine: Callable[[int], Shine],
    count: int,
    blur: SubsurfaceScattering,
    gains: Callable[[int], Iterable[FloatArray]],
) -> BandLight:
    """Render `count` images of a patch of skin, whatever lights each of them; `gains`: factors of
    its channels."""
    diffuse = np.empty((count, len(blur.out), *patch.mask.shape), dtype=np.float32)
    gloss = np.empty((count, *patch.mask.shape), dtype=np.float32)

    def render(k: int) -> None:
        entering, gloss[k], extra = shine(k)
        for c, (light, gain) in enumerate(zip(blur(entering, k), gains(k), strict=True)):
            np.multiply(light, gain, out=diffuse[k, c])
            if extra is not None:
                diffuse[k, c] += extra

    with ThreadPoolExecutor(blur.settings.workers) as pool:
        list(pool.map(render, range(count)))
    return BandLight(window=patch.window, diffuse=diffuse, glare=gloss)


def render_ambient(
    surface: SimulatedSurface,
    level: float,
    skin: Medium,
    settings: RenderSettings | None = None,
    up: Array | None = None,
) -> FloatArray:
    """(C, h, w) radiance of the finger in the window under a uniform hemisphere that gives a white
    card `level`.

    A facet tilted by t against the hemisphere's middle, `up` (3,) or the z axis, sees the fraction
    (1 + cos t) / 2.
    """
    settings = settings or RenderSettings()
    patch = cut_out(surface)
    facing = patch.normal[2] if up is None else dot(patch.normal, up.astype(np.float32))
    entering = np.where(
        patch.mask, np.float32(0.5 * np.pi * level * diffuse_transmittance()) * (1 + facing), 0
    )
    blur, gains = SubsurfaceScattering(patch, skin, settings), Relief(surface, patch, skin).gains()
    return np.stack(
        [light * gain for light, gain in zip(blur(entering.astype(np.float32)), gains, strict=True)]
    )


class SubsurfaceScattering:
    """Convolution of entering light with the diffusion profile of each channel, and Fresnel out to
    the viewer.

    At grazing view the facets of a rough surface that the viewer sees are turned towards him: the
    cosine of emergence does not fall below about half the roughness.
    """

    def __init__(
        self, patch: Patch, skin: Medium, settings: RenderSettings, *, blurred: bool = False
    ) -> None:
        """Prepare the transfer of every medium, and what of the light leaves towards the viewer.

        `blurred`: light spreads across the picture, see
        :class:`splitknit_simulator.light.skin.Boundary`.
        """
        self.settings, self.patch, pitch_mm = settings, patch, patch.pitch_mm
        self._entering: Callable[[int], Iterator[FloatArray]] | None = None
        profiles = [
            diffusion_profile(o.scattering_per_mm, o.absorption_per_mm) for o in skin.optics
        ]
        reach = int(
            np.ceil(min(settings.reach_mm, max(p.radius_mm(0.99) for p in profiles)) / pitch_mm)
        )
        mask = patch.mask
        # where the finger runs out of the picture, its skin goes on: repeat the border's light over
        # the reach
        self.before = tuple(reach if side.any() else 0 for side in (mask[0], mask[:, 0]))
        self.after = tuple(reach if side.any() else 0 for side in (mask[-1], mask[:, -1]))
        self.inner = tuple(
            slice(before, before + n) for before, n in zip(self.before, mask.shape, strict=True)
        )
        self._area = None if blurred else patch.area
        along_x, along_y = (self._continued(slope) for slope in patch.slopes)
        self._sheet = (
            None if blurred else _Sheet(along_x, along_y, self._continued(mask), self.inner)
        )
        spread_over = self._continued(mask).shape if self._sheet is None else self._sheet.shape
        self.fft_shape = tuple(
            scipy.fft.next_fast_len(length + reach, True) for length in spread_over
        )
        self.transfers = [
            p.transfer_grid((self.fft_shape[0], self.fft_shape[1]), pitch_mm) for p in profiles
        ]
        emergence = np.sqrt(patch.nv**2 + (0.5 * skin.roughness) ** 2 * (1.0 - patch.nv**2))
        out = (1.0 - fresnel(emergence)) / (np.pi * diffuse_transmittance())
        inside = mask.astype(np.float32)
        # as much area as lets light in lets it out again: evenly lit skin is evenly bright,
        # whatever its ridges
        covered = zip(
            self.spread(self._continued(inside)), self.spread(self.pad(inside)), strict=True
        )
        self.out = []
        for profile, (cover, area) in zip(profiles, covered, strict=True):
            seen = np.clip(cover / np.float32(profile.albedo), 0.05, 1.0)
            lost = seen ** np.float32(settings.rim_exponent) * np.clip(
                area / np.maximum(cover, 1e-6), 0.5, 8.0
            )
            self.out.append(np.where(mask, out / lost, 0.0).astype(np.float32))

    def enter_by(self, skin: Medium, shape_normals: FloatArray, leds: Sequence[Led]) -> None:
        """Let light enter as the skin's boundary lets it, not as given: each of `leds`, by its
        image's number."""
        boundary = skin.boundary
        signals = [boundary.slope_signal(name) for name in skin.channels]
        below: Vectors = tuple(np.moveaxis(shape_normals, -1, 0))

        def entering(k: int) -> Iterator[FloatArray]:
            power = boundary.entry_power
            facets = _light_below(self.patch, self.patch.normal, leds[k], power)
            ridged = self.spread(self.pad(facets))
            if boundary.refraction == 0:
                yield from ridged
                return
            smooth = self.spread(self._continued(_light_below(self.patch, below, leds[k], power)))
            for light, even, signal in zip(ridged, smooth, signals, strict=True):
                yield even + np.float32(signal) * (light - even)

        self._entering = entering

    def __call__(self, entering: FloatArray, k: int = 0) -> Iterator[FloatArray]:
        """Yield the (h, w) radiance of each channel under the (h, w) light that enters, of image
        `k`."""
        lights = self.spread(self.pad(entering)) if self._entering is None else self._entering(k)
        for light, out in zip(lights, self.out, strict=True):
            yield np.maximum(light, 0.0) * out

    def pad(self, entering: FloatArray) -> FloatArray:
        """(h', w') light that enters by the area of the skin's facets, repeated where the skin goes
        on."""
        return self._continued(entering if self._area is None else entering * self._area)

    def _continued(self, field: NDArray[Any]) -> NDArray[Any]:
        """(h', w') a field, its border repeated over the reach where the skin goes on beyond the
        picture."""
        return np.pad(field, tuple(zip(self.before, self.after, strict=True)), mode="edge")

    def spread(
        self, padded: FloatArray, transfers: Sequence[NDArray[Any]] | None = None
    ) -> Iterator[FloatArray]:
        """(h, w) light that leaves, a channel at a time, from the (h', w') light that enters.

        `transfers` on the grid of the FFT replace those of the channels.
        """
        spectrum = scipy.fft.rfft2(
            padded if self._sheet is None else self._sheet.laid_out(padded), self.fft_shape
        )
        for transfer in self.transfers if transfers is None else transfers:
            light = np.asarray(
                scipy.fft.irfft2(spectrum * transfer, self.fft_shape), dtype=np.float32
            )
            yield (
                np.ascontiguousarray(light[self.inner])
                if self._sheet is None
                else self._sheet.laid_back(light)
            )


class _Sheet:
    """Skin laid out on a plane: distances there are those along the skin.

    Rows of the picture are laid out to their length from its middle column, and what they then show
    is laid out along the columns from its middle row. This is exact for a surface that curves in
    one of the two directions, such as a cylinder; where it curves in both, at the tip, distances
    across are a little too long or short.
    """

    def __init__(
        self,
        slope_x: FloatArray,
        slope_y: FloatArray,
        mask: BoolArray,
        inner: tuple[slice, ...],
    ) -> None:
        """Lay out skin (h', w') by its slopes; what is laid back is the part `inner` of it."""
        rows, columns = mask.shape
        along_x, along_y = (np.sqrt(1.0 + np.where(mask, s, 0.0) ** 2) for s in (slope_x, slope_y))
        across = np.cumsum(along_x, axis=1) - 0.5 * along_x
        across -= across[:, columns // 2, None]
        places = np.arange(np.floor(across[mask].min()), np.ceil(across[mask].max()) + 1)
        column = np.stack([np.interp(places, line, np.arange(columns)) for line in across]).astype(
            np.float32
        )
        row = np.broadcast_to(np.arange(rows, dtype=np.float32)[:, None], column.shape)
        lengths = _sampled(along_y.astype(np.float32), row, column, cv2.INTER_LINEAR).astype(
            np.float64
        )
        down = np.cumsum(lengths, axis=0) - 0.5 * lengths
        down -= down[rows // 2]
        here = _sampled(mask.astype(np.float32), row, column, cv2.INTER_NEAREST) > 0
        steps = np.arange(np.floor(down[here].min()), np.ceil(down[here].max()) + 1)
        self._row = np.stack(
            [np.interp(steps, line, np.arange(rows)) for line in down.T], axis=1
        ).astype(np.float32)
        # rows and columns of the plane, in pixels as large as those of the picture
        self.shape = self._row.shape
        u = np.broadcast_to(np.arange(places.size, dtype=np.float32), self.shape)
        self._column = _sampled(column, self._row, u, cv2.INTER_LINEAR)
        self._there = _sampled(mask.astype(np.float32), self._row, self._column, cv2.INTER_NEAREST)
        self._u = (across[inner] - places[0]).astype(np.float32)
        at = np.broadcast_to(np.arange(rows, dtype=np.float32)[inner[0], None], self._u.shape)
        self._v = _sampled((down - steps[0]).astype(np.float32), at, self._u, cv2.INTER_LINEAR)
        nearest = ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
        self._nearest = np.ravel_multi_index(tuple(nearest), mask.shape)

    def laid_out(self, field: FloatArray) -> FloatArray:
        """A field of the picture (h', w') on the plane, zero where no skin is seen."""
        whole = np.take(field, self._nearest)
        return _sampled(whole, self._row, self._column, cv2.INTER_LANCZOS4) * self._there

    def laid_back(self, field: FloatArray) -> FloatArray:
        """(h, w) a field of the plane in the picture."""
        return _sampled(field, self._v, self._u, cv2.INTER_LANCZOS4)


def _sampled(field: FloatArray, row: FloatArray, column: FloatArray, how: int) -> FloatArray:
    """`field` at places in between its pixels; beyond its border the border goes on."""
    values = cv2.remap(
        field, column, np.ascontiguousarray(row), how, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(values, dtype=np.float32)


class Relief:
    """Brightness of the relief: pigment times 1 + k h, h the band-passed relief in um."""

    def __init__(self, surface: SimulatedSurface, patch: Patch, skin: Medium) -> None:
        """Filter the relief of a patch of skin."""
        self._patch, self._skin = patch, skin
        self._normals = surface.shape_normals[patch.window]
        inside = patch.mask.astype(np.float32)
        relief = np.where(patch.mask, surface.relief_um[patch.window], 0).astype(np.float32)

        def smooth(sigma_mm: float) -> FloatArray:
            sigma = sigma_mm * patch.px_per_mm
            if sigma < 0.2:
                return relief
            weight = cv2.GaussianBlur(inside, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
            blurred = cv2.GaussianBlur(relief, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
            return np.asarray(blurred / np.maximum(weight, 1e-3), dtype=np.float32)

        self._band = smooth(0.03) - smooth(0.32)  # mm
        pigment = np.where(patch.mask, surface.pigment[patch.window], 0).astype(np.float32)
        self._pigments = [pigment] * len(skin.optics)

    def colour(self, change: Callable[[FloatArray, Channel], FloatArray]) -> None:
        """Change the pigment (h, w) of each channel."""
        named = zip(self._pigments, self._skin.channels, strict=True)
        self._pigments = [change(pigment, name) for pigment, name in named]

    def gains(self, led: Led | None = None) -> Iterator[FloatArray]:
        """(h, w) for each channel, under one LED or (None) under light from everywhere."""
        slanted = None if led is None else _obliquity(self._patch, self._normals, led)
        for medium, pigment in zip(self._skin.optics, self._pigments, strict=True):
            gain: Any = np.float32(medium.relief_gain_per_um)
            if slanted is not None and medium.oblique_gain_per_um > 0.0:
                gain = gain + np.float32(medium.oblique_gain_per_um) * slanted
            yield pigment * np.clip(1.0 + gain * self._band, 0.2, 1.8)


def _light_below(patch: Patch, normal: Vectors, led: Led, entry_power: float) -> FloatArray:
    """(h, w) light that enters skin with this `normal`, with Fresnel's transmittance to a power."""
    total = np.zeros(patch.mask.shape, dtype=np.float32)
    for lamp in (led, *led.also):
        light, strength = arriving(patch, lamp)
        cosine = np.maximum(dot(light, normal), 0.0)
        total += strength * cosine * np.maximum(1.0 - fresnel(cosine), 0.02) ** entry_power
    return np.where(patch.mask, total, 0.0).astype(np.float32)


def _obliquity(patch: Patch, normals: FloatArray, led: Led) -> FloatArray:
    """(h, w) ln(1 / cos t), t the angle between skin's normals (h, w, 3) and an LED; at most ln
    10."""
    light, _ = towards(led, patch.points)
    cosine = dot(light, np.moveaxis(normals, -1, 0))
    return np.where(patch.mask, -np.log(np.clip(cosine, 0.1, 1.0)), 0.0).astype(np.float32)
