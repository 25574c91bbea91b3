"""Direct and global light of the twin under projected checkerboards, without noise.

What Nayar's separation calls direct is the brightest minus the darkest image over all phases of the pattern. It holds
the surface reflection and all light that leaves the skin closer to its entry than about a check, so it is defined only
together with its check size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import FloatArray, Led
from splitknit.simulator.diffusion import WalkTable, load_walks
from splitknit.simulator.lighting import cut_out, light_on
from splitknit.simulator.projector import Checkerboard, check_camera, projected, square_wave
from splitknit.simulator.renderer import Diffusion, RenderSettings, relief_gains
from splitknit.simulator.skin import BAND_CHANNELS, ChannelOptics, SkinSettings
from splitknit.simulator.surface import Surface

Phases = Literal["all", "centred"]


@dataclass(frozen=True, slots=True, eq=False)
class Separated:
    """Light of one surface under one light, inside `window`, in units of the rig's intensities."""

    window: tuple[slice, slice]
    """Rows and columns of the frame."""
    direct: FloatArray
    """(C, h, w) brightest minus darkest over all phases of a checkerboard of `check_mm`, glare included."""
    global_: FloatArray
    """(C, h, w) white minus direct."""
    glare: FloatArray
    """(h, w) light that the surface alone reflects, the same in all channels."""
    white: FloatArray
    """(C, h, w) under full light."""
    check_mm: float
    """Side of the checks that `direct` is defined with."""


def separate_truth(
    surface: Surface,
    led: Led,
    skin: SkinSettings,
    *,
    check_mm: float,
    walks: WalkTable | None = None,
    settings: RenderSettings | None = None,
    phases: Phases = "all",
    optics: Sequence[ChannelOptics] | None = None,
) -> Separated:
    """Direct and global light of `surface` under a projector at `led`, at a stated check size.

    Parameters
    ----------
    surface : on the camera's pixels
    led : where the projector stands
    skin : optics, roughness and glare
    check_mm : side of the checks on the finger plane, at least two pixels
    walks : table of random walks; None loads the shipped one
    settings : what of the light is modelled (defocus is not)
    phases : ``all`` takes maximum minus minimum over all phases in steps of at most a pixel, each rendered: c^2 images
        for checks of c pixels, because shifts by a check only exchange lit and dark. ``centred`` takes, for each pixel,
        the difference between the checks centred on it and their complement: one convolution with the diffusion
        profile times a checkerboard, c^2 times faster; it neglects that checks lie askew on slanted skin, and that a
        light gradient can make another phase the brightest one.
    optics : media instead of those of `skin` in the light's band; C of them

    References
    ----------
    Nayar, Krishnan, Grossberg and Raskar 2006, Fast separation of direct and global components of a scene using high
    frequency illumination, equations (3) and (4).
    """
    _check_size(check_mm, surface)
    require(phases in ("all", "centred"), f"phases must be 'all' or 'centred', but it is '{phases}'.")
    scene = _Scene(surface, led, skin, walks=walks, settings=settings, optics=optics)
    white = scene.image(None)
    direct = scene.largest_difference(check_mm) if phases == "all" else scene.centred_difference(check_mm)
    np.minimum(direct, white, out=direct)
    return Separated(scene.patch.window, direct, white - direct, scene.glare, white, float(check_mm))


def checkerboard_images(
    surface: Surface,
    led: Led,
    skin: SkinSettings,
    pattern: Checkerboard,
    *,
    walks: WalkTable | None = None,
    settings: RenderSettings | None = None,
    optics: Sequence[ChannelOptics] | None = None,
) -> Iterator[FloatArray]:
    """Yield the (C, h, w) noise-free radiance under each shift of `pattern`, one at a time.

    Parameters are those of :func:`separate_truth`; the window is that of the truth.
    """
    _check_size(pattern.check_mm, surface)
    scene = _Scene(surface, led, skin, walks=walks, settings=settings, optics=optics)
    for shift in pattern.shifts_mm():
        yield scene.image((pattern, shift))


def checkerboard_stack(
    surface: Surface,
    led: Led,
    skin: SkinSettings,
    pattern: Checkerboard,
    *,
    walks: WalkTable | None = None,
    settings: RenderSettings | None = None,
    optics: Sequence[ChannelOptics] | None = None,
) -> FloatArray:
    """(N, C, h, w) noise-free radiance under all shifts of `pattern`: :func:`checkerboard_images` in one array."""
    images = checkerboard_images(surface, led, skin, pattern, walks=walks, settings=settings, optics=optics)
    first = next(images)
    stack = np.empty((pattern.steps**2, *first.shape), dtype=np.float32)
    stack[0] = first
    for place, image in zip(stack[1:], images, strict=True):
        place[...] = image
    return stack


def _check_size(check_mm: float, surface: Surface) -> None:
    check_camera(surface)
    least = 2.0 * surface.camera.pitch_mm
    require(
        bool(np.isfinite(check_mm)) and check_mm >= least,
        f"check_mm is {check_mm}, but checks need at least two pixels ({least:.3f} mm); take larger checks.",
    )


class _Scene:
    """One surface in one light: everything that does not depend on the pattern."""

    def __init__(
        self,
        surface: Surface,
        led: Led,
        skin: SkinSettings,
        *,
        walks: WalkTable | None,
        settings: RenderSettings | None,
        optics: Sequence[ChannelOptics] | None,
    ) -> None:
        settings = settings or RenderSettings()
        media = optics or [skin.channel(name) for name in BAND_CHANNELS[led.band]]
        self.pitch_mm = surface.camera.pitch_mm
        self.patch = cut_out(surface)
        self.diffusion = Diffusion(
            self.patch,
            self.pitch_mm,
            media,
            walks or load_walks(),
            reach_mm=settings.reach_mm,
            roughness=skin.roughness,
            rim=settings.rim_exponent,
        )
        gains = relief_gains(surface, self.patch, media, settings)
        self.out = [out * gain for out, gain in zip(self.diffusion.out, gains, strict=True)]
        entering, gloss = light_on(self.patch, led, skin.roughness, settings.led_radius_mm)
        self.glare = np.asarray(gloss * np.float32(skin.glare), dtype=np.float32)
        self.entering = self.diffusion.pad(entering)
        self.x, self.y = (self._beyond(c, k) for k, c in enumerate(projected(self.patch, led)))
        rows, columns = (slice(b, b + n) for b, n in zip(self.diffusion.before, entering.shape, strict=True))
        self.inner = (rows, columns)

    def _beyond(self, coordinate: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
        """Where the pattern falls on the skin that goes on beyond the picture: the parallax of the border goes on."""
        here = self.patch.x if axis == 0 else self.patch.y
        before, after = self.diffusion.before, self.diffusion.after
        padding = ((before[0], after[0]), (before[1], after[1]))
        parallax = np.pad(coordinate - here, padding, mode="edge")
        line = (self.patch.x[0] if axis == 0 else self.patch.y[:, 0]).astype(np.float64)
        side = 1 - axis
        grid = np.arange(-before[side], line.size + after[side]) * (self.pitch_mm if axis == 0 else -self.pitch_mm)
        grid = line[0] + grid
        return np.asarray(parallax + (grid[None, :] if axis == 0 else grid[:, None]))

    def image(self, pattern: tuple[Checkerboard, NDArray[np.float64]] | None) -> FloatArray:
        """(C, h, w) radiance under one pattern, or under full light."""
        if pattern is None:
            entering, glare = self.entering, self.glare
        else:
            state = pattern[0].state(self.x, self.y, pattern[1], self.pitch_mm)
            entering, glare = self.entering * state, self.glare * state[self.inner]
        lit = zip(self.diffusion.spread(entering), self.out, strict=True)
        return np.stack([np.maximum(light, 0.0) * out + glare for light, out in lit])

    def largest_difference(self, check_mm: float) -> FloatArray:
        """(C, h, w) maximum minus minimum over all phases.

        With the checkerboard as 1/2 + chi/2 an image is half the white one plus half the response to chi, and chi and
        -chi both occur: maximum minus minimum is the largest absolute response to chi.
        """
        steps = max(int(np.ceil(check_mm / self.pitch_mm - 1e-6)), 1)
        shifts = check_mm / steps * np.arange(steps)
        rows = [square_wave(self.y - shift, check_mm, self.pitch_mm).astype(np.float32) for shift in shifts]
        largest = np.zeros((len(self.out), *self.glare.shape), dtype=np.float32)
        for shift in shifts:
            across = square_wave(self.x - shift, check_mm, self.pitch_mm).astype(np.float32)
            for along in rows:
                chi = across * along
                gloss = self.glare * chi[self.inner]
                for c, light in enumerate(self.diffusion.spread(self.entering * chi)):
                    np.maximum(largest[c], np.abs(light * self.out[c] + gloss), out=largest[c])
        return largest

    def centred_difference(self, check_mm: float) -> FloatArray:
        """(C, h, w) response to the checkerboard that is centred on each pixel, all of the glare included."""
        transfers = [self._checked(transfer, check_mm) for transfer in self.diffusion.transfers]
        lit = zip(self.diffusion.spread(self.entering, transfers), self.out, strict=True)
        return np.stack([np.maximum(light, 0.0) * out + self.glare for light, out in lit])

    def _checked(self, transfer: FloatArray, check_mm: float) -> NDArray[Any]:
        """Transfer of the diffusion profile times a checkerboard centred on it."""
        kernel = scipy.fft.irfft2(transfer, self.diffusion.fft_shape)
        waves = []
        for count in self.diffusion.fft_shape:
            offset = scipy.fft.fftfreq(count, 1.0 / count) * self.pitch_mm
            waves.append(square_wave(offset + 0.5 * check_mm, check_mm, self.pitch_mm).astype(np.float32))
        kernel *= waves[0][:, None] * waves[1][None, :]
        return np.asarray(scipy.fft.rfft2(kernel))
