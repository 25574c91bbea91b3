"""Light from the LEDs through the skin and off it: noise-free linear radiance of every image.

Image-space model, see ``docs/twin.md``: irradiance of near LEDs times Fresnel transmittance, convolved with the Monte
Carlo diffusion profile of each channel, times a term for the relief, plus the GGX reflection of the surface.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.simulate.diffusion import WalkTable, diffuse_transmittance, diffusion_profile, fresnel
from splitknit.simulate.skin import ChannelOptics
from splitknit.simulate.surface import Surface
from splitknit.types import Camera, FloatArray, Led

UNIT = 1e4
"""Irradiance of an LED of intensity one at 100 mm."""
EDGE_EXPONENT = 0.75
"""Near the outline, part of the diffusion profile falls beside the picture of the finger; the light is divided by the
share inside to this power. Between 0 (no light there) and 1 (the same light there): 0.75 follows a random walk in an
elliptic cylinder best (``validation/twin_volume.py``)."""


@dataclass(frozen=True, slots=True)
class RenderSettings:
    """What of the light is modelled."""

    led_radius_mm: float = 1.5
    """Radius of an LED's emitting face; it widens the glare."""
    relief_low_mm: float = 0.03
    """Standard deviation of the smoothing of the relief in the relief term."""
    relief_high_mm: float = 0.32
    """Standard deviation of the high-pass of the relief in the relief term."""
    reach_mm: float = 6.0
    """Diffusion over longer distances may wrap around the image; larger costs time."""
    aperture_mm: float = 0.0
    """Diameter of the lens's entrance pupil; 0 switches defocus off. f/2 at 11 mm of focal length is 5.5 mm."""
    focus_depth_mm: float = 1.5
    """Depth of the plane in focus below the finger's highest point."""
    workers: int = 2
    """Threads; the result does not depend on it."""

    def __post_init__(self) -> None:
        require(0 <= self.led_radius_mm <= 20, f"render.led_radius_mm must be 0 to 20, but it is {self.led_radius_mm}.")
        require(
            0 <= self.relief_low_mm < self.relief_high_mm,
            "render.relief_low_mm must be at least 0 and below render.relief_high_mm.",
        )
        require(0 < self.reach_mm <= 30, f"render.reach_mm must lie in (0, 30], but it is {self.reach_mm}.")
        require(0 <= self.aperture_mm <= 50, f"render.aperture_mm must be 0 to 50, but it is {self.aperture_mm}.")
        require(self.workers >= 1, "render.workers must be at least 1.")


@dataclass(frozen=True, slots=True, eq=False)
class BandLight:
    """Radiance of the finger inside `window`, in units of the rig's intensities."""

    window: tuple[slice, slice]
    """Rows and columns of the frame."""
    diffuse: FloatArray
    """(L, C, h, w) light that came through the skin, C = 3 (white) or 1 (NIR)."""
    glare: FloatArray
    """(L, h, w) light that the surface alone reflects, the same in all channels."""


@dataclass(frozen=True, slots=True, eq=False)
class _Patch:
    """The surface inside the window, channels apart and contiguous, zero outside the mask."""

    window: tuple[slice, slice]
    mask: NDArray[np.bool_]
    x: FloatArray
    """(1, w) mm."""
    y: FloatArray
    """(h, 1) mm."""
    z: FloatArray
    nx: FloatArray
    ny: FloatArray
    nz: FloatArray


def finger_window(surface: Surface, margin: int = 8) -> tuple[slice, slice]:
    """Rows and columns of the finger's bounding box, widened by `margin` pixels inside the frame."""
    rows, columns = np.flatnonzero(surface.mask.any(axis=1)), np.flatnonzero(surface.mask.any(axis=0))
    require(rows.size > 0, "the simulated finger is outside the picture; move it into the frame.")
    height, width = surface.mask.shape
    return (
        slice(max(int(rows[0]) - margin, 0), min(int(rows[-1]) + 1 + margin, height)),
        slice(max(int(columns[0]) - margin, 0), min(int(columns[-1]) + 1 + margin, width)),
    )


def render_band(
    surface: Surface,
    leds: Sequence[Led],
    optics: Sequence[ChannelOptics],
    *,
    roughness: float,
    glare: float,
    walks: WalkTable,
    settings: RenderSettings | None = None,
) -> BandLight:
    """Render the finger under each of `leds`, one image a light.

    Parameters
    ----------
    surface : the finger on the camera's pixels
    leds : L lights
    optics : C media, one a channel
    roughness : GGX alpha
    glare : weight of the surface reflection, 1 = Fresnel
    walks : table of random walks
    settings : what of the light is modelled

    References
    ----------
    Jensen et al. 2001, equation (5), for the subsurface term; Walter et al. 2007, equations (20), (33), (34), for the
    surface reflection.
    """
    settings = settings or RenderSettings()
    patch = _patch(surface)
    blur = _Diffusion(patch, surface.camera.pitch_mm, optics, walks, settings.reach_mm)
    gains = list(_relief_gains(surface, patch, optics, settings))
    shape = patch.mask.shape
    diffuse = np.empty((len(leds), len(optics), *shape), dtype=np.float32)
    gloss = np.empty((len(leds), *shape), dtype=np.float32)

    def one(k: int) -> None:
        entering, gloss[k] = _light(patch, leds[k], roughness, settings.led_radius_mm)
        gloss[k] *= np.float32(glare)
        for c, light in enumerate(blur(entering)):
            np.multiply(light, gains[c], out=diffuse[k, c])

    with ThreadPoolExecutor(settings.workers) as pool:
        list(pool.map(one, range(len(leds))))
    return BandLight(window=patch.window, diffuse=diffuse, glare=gloss)


def render_ambient(
    surface: Surface,
    level: float,
    optics: Sequence[ChannelOptics],
    walks: WalkTable,
    settings: RenderSettings | None = None,
) -> FloatArray:
    """(C, h, w) radiance of the finger in the window under a uniform upper hemisphere that gives a white card `level`.

    A facet that is tilted by t sees the share (1 + cos t) / 2 of the hemisphere.
    """
    settings = settings or RenderSettings()
    patch = _patch(surface)
    blur = _Diffusion(patch, surface.camera.pitch_mm, optics, walks, settings.reach_mm)
    entering = np.where(patch.mask, np.float32(0.5 * np.pi * level * diffuse_transmittance()) * (1 + patch.nz), 0)
    gains = _relief_gains(surface, patch, optics, settings)
    return np.stack([light * gain for light, gain in zip(blur(entering.astype(np.float32)), gains, strict=True)])


def white_card(camera: Camera, led: Led, z_mm: float = 0.0, step: int = 16) -> FloatArray:
    """(H, W) radiance of a white Lambertian card at height `z_mm`, facing the camera, evaluated every `step` pixels."""
    height, width = camera.image_size
    rows = np.linspace(0, height - 1, max(height // step, 2))
    columns = np.linspace(0, width - 1, max(width // step, 2))
    x = ((columns - (width - 1) / 2) / camera.px_per_mm)[None, :]
    y = (((height - 1) / 2 - rows) / camera.px_per_mm)[:, None]
    total = np.zeros((rows.size, columns.size))
    for one in (led, *led.also):
        _, _, lz, strength = _towards(one, x, y, np.full_like(total, z_mm))
        total += strength * np.maximum(lz, 0.0)
    # bilinear between the centres of the coarse grid, which include the frame's corners
    at_rows = np.linspace(0, rows.size - 1, height)
    at_columns = np.linspace(0, columns.size - 1, width)
    low_row = np.minimum(at_rows.astype(np.intp), rows.size - 2)
    low_column = np.minimum(at_columns.astype(np.intp), columns.size - 2)
    share_row = (at_rows - low_row)[:, None]
    share_column = (at_columns - low_column)[None, :]
    tall = total[low_row] * (1.0 - share_row) + total[low_row + 1] * share_row
    tall /= np.pi
    card = tall[:, low_column] * (1.0 - share_column) + tall[:, low_column + 1] * share_column
    return np.asarray(card, dtype=np.float32)


def _patch(surface: Surface) -> _Patch:
    window = finger_window(surface)
    mask = np.ascontiguousarray(surface.mask[window])
    height, width = surface.mask.shape
    pitch = surface.camera.pitch_mm
    columns = np.arange(window[1].start, window[1].stop, dtype=np.float64)
    rows = np.arange(window[0].start, window[0].stop, dtype=np.float64)
    normals = surface.normals[window]
    return _Patch(
        window=window,
        mask=mask,
        x=((columns - (width - 1) / 2) * pitch).astype(np.float32)[None, :],
        y=(((height - 1) / 2 - rows) * pitch).astype(np.float32)[:, None],
        z=np.where(mask, surface.height_mm[window], 0).astype(np.float32),
        nx=np.ascontiguousarray(normals[..., 0]),
        ny=np.ascontiguousarray(normals[..., 1]),
        nz=np.ascontiguousarray(normals[..., 2]),
    )


def _towards(
    led: Led, x: NDArray[np.floating], y: NDArray[np.floating], z: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]]:
    """Unit vector from each point to the light, and the irradiance of a surface that faces it."""
    if led.position_mm is None:
        direction = np.asarray(led.direction, dtype=np.float64)
        dx, dy, dz = (float(v) for v in direction / np.linalg.norm(direction))
        return (np.full_like(z, dx), np.full_like(z, dy), np.full_like(z, dz), np.full_like(z, led.intensity))
    px, py, pz = led.position_mm
    lx, ly, lz = px - x, py - y, pz - z
    inverse = 1.0 / np.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx * inverse, ly * inverse, lz * inverse
    strength = (led.intensity * UNIT) * inverse * inverse
    if led.lobe_exponent > 0.0:
        distance = float(np.sqrt(px * px + py * py + pz * pz))
        axis = np.maximum((lx * px + ly * py + lz * pz) / distance, 0.0)
        strength = strength * axis**led.lobe_exponent
    return lx, ly, lz, strength


def _light(patch: _Patch, led: Led, roughness: float, led_radius_mm: float) -> tuple[FloatArray, FloatArray]:
    """Irradiance that enters the skin, and the radiance that its surface reflects to the camera."""
    entering = np.zeros(patch.mask.shape, dtype=np.float32)
    gloss = np.zeros(patch.mask.shape, dtype=np.float32)
    for one in (led, *led.also):
        lx, ly, lz, strength = _towards(one, patch.x, patch.y, patch.z)
        cosine = np.maximum(lx * patch.nx + ly * patch.ny + lz * patch.nz, 0.0)
        entering += strength * cosine * (1.0 - fresnel(cosine))
        alpha = roughness
        if one.position_mm is not None:
            alpha = min(roughness + led_radius_mm / (2.0 * float(np.linalg.norm(one.position_mm))), 1.0)
        gloss += strength * _ggx(patch, (lx, ly, lz), cosine, alpha)
    return entering, gloss


def _ggx(
    patch: _Patch,
    light: tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]],
    cosine: NDArray[np.floating],
    alpha: float,
) -> NDArray[np.floating]:
    """D G F / (4 n.v) for a viewer along z; zero in the attached shadow."""
    lx, ly, lz = light
    # half vector between the light and (0, 0, 1): |l + v| = sqrt(2 + 2 lz)
    inverse = 1.0 / np.sqrt(2.0 + 2.0 * lz)
    nh = np.clip((lx * patch.nx + ly * patch.ny + (lz + 1.0) * patch.nz) * inverse, 0.0, 1.0)
    vh = (lz + 1.0) * inverse
    nv = np.clip(patch.nz, 1e-3, 1.0)
    squared = alpha * alpha
    below = nh * nh * (squared - 1.0) + 1.0
    distribution = squared / (np.pi * below * below)

    def unshadowed(c: NDArray[np.floating]) -> NDArray[np.floating]:
        return 2.0 * c / (c + np.sqrt(squared + (1.0 - squared) * c * c))

    shadowing = unshadowed(np.maximum(cosine, 1e-4)) * unshadowed(nv)
    lit = (cosine > 0.0) & patch.mask
    return np.where(lit, distribution * shadowing * fresnel(vh) / (4.0 * nv), 0.0)


class _Diffusion:
    """Convolution of entering light with the diffusion profile of each channel, and Fresnel out to the viewer."""

    def __init__(
        self, patch: _Patch, pitch_mm: float, optics: Sequence[ChannelOptics], walks: WalkTable, reach_mm: float
    ) -> None:
        profiles = [diffusion_profile(walks, o.scattering_per_mm, o.absorption_per_mm) for o in optics]
        reach = int(np.ceil(min(reach_mm, max(p.radius_mm(0.99) for p in profiles)) / pitch_mm))
        mask = patch.mask
        # where the finger runs out of the picture, its skin goes on: repeat the border's light over the reach
        self.before = tuple(reach if side.any() else 0 for side in (mask[0], mask[:, 0]))
        self.after = tuple(reach if side.any() else 0 for side in (mask[-1], mask[:, -1]))
        self.shape = mask.shape
        self.fft_shape = (
            scipy.fft.next_fast_len(mask.shape[0] + self.before[0] + self.after[0] + reach, True),
            scipy.fft.next_fast_len(mask.shape[1] + self.before[1] + self.after[1] + reach, True),
        )
        self.transfers = [p.transfer_grid(self.fft_shape, pitch_mm) for p in profiles]
        out = (1.0 - fresnel(patch.nz)) / (np.pi * diffuse_transmittance())
        covered = list(self._spread(mask.astype(np.float32)))
        self.out = []
        for profile, cover in zip(profiles, covered, strict=True):
            seen = np.clip(cover / np.float32(profile.albedo), 0.05, 1.0)
            self.out.append(np.where(mask, out * seen ** np.float32(-EDGE_EXPONENT), 0.0).astype(np.float32))

    def __call__(self, entering: FloatArray) -> Iterator[FloatArray]:
        for light, out in zip(self._spread(entering), self.out, strict=True):
            yield np.maximum(light, 0.0) * out

    def _spread(self, entering: FloatArray) -> Iterator[FloatArray]:
        """The light that leaves, a channel at a time."""
        padding = ((self.before[0], self.after[0]), (self.before[1], self.after[1]))
        spectrum = scipy.fft.rfft2(np.pad(entering, padding, mode="edge"), self.fft_shape)
        rows = slice(self.before[0], self.before[0] + self.shape[0])
        columns = slice(self.before[1], self.before[1] + self.shape[1])
        for transfer in self.transfers:
            yield np.asarray(scipy.fft.irfft2(spectrum * transfer, self.fft_shape)[rows, columns], dtype=np.float32)


def _relief_gains(
    surface: Surface, patch: _Patch, optics: Sequence[ChannelOptics], settings: RenderSettings
) -> Iterator[FloatArray]:
    """(h, w) for each channel: pigment times 1 + k h, h the band-passed relief in um."""
    px_per_mm = surface.camera.px_per_mm
    inside = patch.mask.astype(np.float32)
    relief = np.where(patch.mask, surface.relief_um[patch.window], 0).astype(np.float32)

    def smooth(sigma_mm: float) -> FloatArray:
        if sigma_mm * px_per_mm < 0.2:
            return relief
        size, sigma = (0, 0), sigma_mm * px_per_mm
        weight = cv2.GaussianBlur(inside, size, sigma, borderType=cv2.BORDER_REPLICATE)
        blurred = cv2.GaussianBlur(relief, size, sigma, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(blurred / np.maximum(weight, 1e-3), dtype=np.float32)

    band = smooth(settings.relief_low_mm) - smooth(settings.relief_high_mm)
    pigment = np.where(patch.mask, surface.pigment[patch.window], 0).astype(np.float32)
    for one in optics:
        yield pigment * np.clip(1.0 + np.float32(one.relief_gain_per_um) * band, 0.2, 1.8)
