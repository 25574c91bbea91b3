"""Direct and global light of the simulated skin under projected checkerboards, without noise.

What Nayar's separation calls direct is the brightest minus the darkest image over all phases of the
pattern. It holds the surface reflection and all light that leaves the skin closer to its entry than
about a check, so it is defined only together with its check size.

The projector stands where a light stands. Its checks have their stated size on the finger plane; on
a surface above or below that plane they are displaced along the projector's rays, so that they lie
on the surface.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from splitknit import Led
from splitknit.errors import require
from splitknit.model import Array, FloatArray
from splitknit.settings import Checked, Limits
from splitknit_simulator.light.lighting import Patch, cut_out, light_on
from splitknit_simulator.light.renderer import Relief, RenderSettings, SubsurfaceScattering
from splitknit_simulator.light.skin import Medium, SkinOptics
from splitknit_simulator.surface import SimulatedSurface

# Patterns that a projector throws on the skin, and where they fall.


@dataclass(frozen=True, slots=True)
class Checkerboard(Checked):
    """A checkerboard in all its shifts: `steps` x `steps` patterns, by a `steps`-th of the period
    each way."""

    check_mm: Annotated[float, Limits(0.0, 50.0, above=True)]
    """Side of one check on the finger plane."""
    steps: Annotated[int, Limits(2, 32)] = 5
    """Shifts along each axis; 5 gives the thesis's 25 patterns. With an even number every
    checkerboard occurs twice, since a shift by one check along both axes changes nothing."""

    @property
    def period_mm(self) -> float:
        """Two checks."""
        return float(2.0 * self.check_mm)

    def shifts_mm(self) -> Array:
        """(N, 2) displacement of every pattern along its two axes; the first axis changes
        fastest."""
        step = self.period_mm / self.steps * np.arange(self.steps)
        second, first = np.meshgrid(step, step, indexing="ij")
        return np.stack([first.ravel(), second.ravel()], axis=1)

    def state(
        self, x: Array, y: Array, shift_mm: tuple[float, float] | Array, pitch_mm: float
    ) -> FloatArray:
        """Light of the projector, in [0, 1], at points of the finger plane; edges are averaged over
        a pixel of `pitch_mm`.

        `x`, `y`: mm, any shape; `shift_mm`: of the pattern.
        """
        across = _wave(x - shift_mm[0], self.check_mm, pitch_mm)
        along = _wave(y - shift_mm[1], self.check_mm, pitch_mm)
        return np.asarray(0.5 + 0.5 * across * along, dtype=np.float32)


def _wave(u: Array, check_mm: float, width: float) -> Array:
    """+1 over every second check from u = 0 on, else -1, linear over `width` at the edges."""
    middle = np.abs((u + 0.5 * check_mm) % (2.0 * check_mm) - check_mm)
    return np.clip((0.5 * check_mm - middle) * (2.0 / width), -1.0, 1.0)


def _check_camera(surface: SimulatedSurface) -> None:
    require(
        surface.camera.model == "orthographic",
        "projected patterns are modelled under an orthographic camera only, but this one is"
        " perspective; take an orthographic one.",
    )


def _projected(patch: Patch, led: Led) -> tuple[Array, Array]:
    """(h, w) x and y in mm where the projector's ray to each surface point meets the finger plane.
    Raises BadInput if several lights share the exposure (a projector is one light), or the surface
    reaches up to the projector.
    """
    require(
        not led.also,
        "a pattern comes from one projector, but several lights share this exposure; take one.",
    )
    z = patch.z.astype(np.float64)
    x, y = patch.x.astype(np.float64), patch.y.astype(np.float64)
    if led.position_mm is None:
        direction = np.asarray(led.direction, dtype=np.float64)
        require(
            float(direction[2]) > 0, "a projector must shine from above: its direction needs z > 0."
        )
        rise = z / direction[2]
        return x - rise * direction[0], y - rise * direction[1]
    px, py, pz = led.position_mm
    require(
        float(z.max()) < pz, "the surface reaches up to the projector; move the projector away."
    )
    scale = pz / (pz - z)
    return px + (x - px) * scale, py + (y - py) * scale


def pattern_states(surface: SimulatedSurface, led: Led, pattern: Checkerboard) -> FloatArray:
    """(N, H, W) the projector's light on every pixel of an orthographic camera in each shift, in
    [0, 1]; zero beside the surface. A pixel's state is that of the surface point it sees.
    """
    _check_camera(surface)
    patch = cut_out(surface)
    x, y = _projected(patch, led)
    shifts = pattern.shifts_mm()
    states = np.zeros((len(shifts), *surface.mask.shape), dtype=np.float32)
    for state, shift in zip(states, shifts, strict=True):
        state[patch.window] = pattern.state(x, y, shift, surface.camera.pitch_mm) * patch.mask
    return states


Phases = Literal["all", "centred"]


# Direct and global light under them.


@dataclass(frozen=True, slots=True, eq=False)
class Separated:
    """Light of one surface under one light, inside `window`, in units of the rig's intensities."""

    window: tuple[slice, slice]  # rows and columns of the frame
    # (C, h, w) brightest minus darkest over all phases of a checkerboard of `check_mm`, specular
    # light included
    direct: FloatArray
    global_: FloatArray  # (C, h, w) white minus direct
    glare: FloatArray  # (h, w) light that the surface alone reflects, the same in all channels
    white: FloatArray  # (C, h, w) under full light
    check_mm: float  # side of the checks that `direct` is defined with


def separate_truth(
    surface: SimulatedSurface,
    led: Led,
    skin: SkinOptics | Medium,
    *,
    check_mm: float,
    settings: RenderSettings | None = None,
    phases: Phases = "all",
) -> Separated:
    """Direct and global light of `surface` under a projector at `led`, at a stated check size.

    Parameters
    ----------
    skin : the finger's, or a medium of the light's band
    check_mm : side of the checks on the finger plane, at least two pixels
    settings : what of the light is modelled (defocus is not)
    phases : ``all`` or ``centred``
        ``all`` takes maximum minus minimum over all phases in steps of at most a pixel, each
        rendered: c^2 images for checks of c pixels, because shifts by a check only exchange lit and
        dark. ``centred`` takes, for each pixel, the difference between the checks centred on it and
        their complement: one convolution with the diffusion profile times a checkerboard, c^2 times
        faster; it neglects that checks lie askew on slanted skin, and that a light gradient can
        make another phase the brightest one.

    Nayar, Krishnan, Grossberg and Raskar 2006, Fast separation of direct and global components of a
    scene using high frequency illumination, equations (3) and (4).
    """
    _check_size(check_mm, surface)
    scene = _Scene(surface, led, skin, settings)
    white = scene.image(None)
    direct = (
        scene.largest_difference(check_mm)
        if phases == "all"
        else scene.centred_difference(check_mm)
    )
    np.minimum(direct, white, out=direct)
    return Separated(
        scene.patch.window, direct, white - direct, scene.glare, white, float(check_mm)
    )


def checkerboard_images(
    surface: SimulatedSurface,
    led: Led,
    skin: SkinOptics | Medium,
    pattern: Checkerboard,
    settings: RenderSettings | None = None,
) -> Iterator[FloatArray]:
    """Yield the (C, h, w) noise-free radiance under each shift of `pattern`, one at a time.

    Parameters are those of :func:`separate_truth`; the window is that of the truth.
    """
    _check_size(pattern.check_mm, surface)
    scene = _Scene(surface, led, skin, settings)
    for shift in pattern.shifts_mm():
        yield scene.image((pattern, shift))


def checkerboard_stack(
    surface: SimulatedSurface,
    led: Led,
    skin: SkinOptics | Medium,
    pattern: Checkerboard,
    settings: RenderSettings | None = None,
) -> FloatArray:
    """(N, C, h, w) noise-free radiance under all shifts of `pattern`: :func:`checkerboard_images`
    in one array."""
    return np.stack(list(checkerboard_images(surface, led, skin, pattern, settings)))


def _check_size(check_mm: float, surface: SimulatedSurface) -> None:
    _check_camera(surface)
    least = 2.0 * surface.camera.pitch_mm
    require(
        bool(np.isfinite(check_mm)) and check_mm >= least,
        f"check_mm is {check_mm}, but checks need at least two pixels ({least:.3f} mm); take larger"
        " checks.",
    )


class _Scene:
    """One surface in one light: everything that does not depend on the pattern."""

    def __init__(
        self,
        surface: SimulatedSurface,
        led: Led,
        skin: SkinOptics | Medium,
        settings: RenderSettings | None,
    ) -> None:
        medium = skin if isinstance(skin, Medium) else skin.medium(led.band)
        self.pitch_mm = surface.camera.pitch_mm
        self.patch = cut_out(surface)
        # a pattern's edges are sharper than what can be laid out along the skin and back: it
        # spreads in the picture
        self.diffusion = SubsurfaceScattering(
            self.patch, medium, settings or RenderSettings(), blurred=True
        )
        gains = Relief(surface, self.patch, medium).gains(led)
        self.out = [out * gain for out, gain in zip(self.diffusion.out, gains, strict=True)]
        entering, gloss = light_on(self.patch, led, medium.roughness)
        self.glare: FloatArray = np.asarray(gloss * np.float32(medium.glare), dtype=np.float32)
        self.entering = self.diffusion.pad(entering)
        x, y = _projected(self.patch, led)
        # the pattern falls on the skin that goes on beyond the picture: the parallax of the border
        # goes on
        padding = tuple(zip(self.diffusion.before, self.diffusion.after, strict=True))
        down, across = (
            np.arange(-before, size + after) * self.pitch_mm
            for (before, after), size in zip(padding, x.shape, strict=True)
        )
        left, top = float(self.patch.x[0, 0]), float(self.patch.y[0, 0])
        self.x = np.pad(x - self.patch.x, padding, mode="edge") + (left + across)
        self.y = np.pad(y - self.patch.y, padding, mode="edge") + (top - down)[:, None]
        self.inner = self.diffusion.inner

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

        With the checkerboard as 1/2 + chi/2 an image is half the white one plus half the response
        to chi, and chi and -chi both occur: maximum minus minimum is the largest absolute response
        to chi.
        """
        steps = max(int(np.ceil(check_mm / self.pitch_mm - 1e-6)), 1)
        shifts = check_mm / steps * np.arange(steps)
        rows = [
            _wave(self.y - shift, check_mm, self.pitch_mm).astype(np.float32) for shift in shifts
        ]
        largest = np.zeros((len(self.out), *self.glare.shape), dtype=np.float32)
        for shift in shifts:
            across = _wave(self.x - shift, check_mm, self.pitch_mm).astype(np.float32)
            for along in rows:
                chi = across * along
                gloss = self.glare * chi[self.inner]
                for c, light in enumerate(self.diffusion.spread(self.entering * chi)):
                    np.maximum(largest[c], np.abs(light * self.out[c] + gloss), out=largest[c])
        return largest

    def centred_difference(self, check_mm: float) -> FloatArray:
        """(C, h, w) response to the checkerboard that is centred on each pixel, all specular
        reflection included."""
        transfers = [self._checked(transfer, check_mm) for transfer in self.diffusion.transfers]
        lit = zip(self.diffusion.spread(self.entering, transfers), self.out, strict=True)
        return np.stack([np.maximum(light, 0.0) * out + self.glare for light, out in lit])

    def _checked(self, transfer: FloatArray, check_mm: float) -> NDArray[Any]:
        """Transfer of the diffusion profile times a checkerboard centred on it."""
        kernel = scipy.fft.irfft2(transfer, self.diffusion.fft_shape)
        offsets = (
            scipy.fft.fftfreq(count, 1.0 / count) * self.pitch_mm
            for count in self.diffusion.fft_shape
        )
        down, across = (
            _wave(offset + 0.5 * check_mm, check_mm, self.pitch_mm).astype(np.float32)
            for offset in offsets
        )
        kernel *= down[:, None] * across[None, :]
        return scipy.fft.rfft2(kernel)
