"""A finger under the rig's LEDs as the twin's camera sees it: any of them lit, in any order, as often as one likes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Camera, FloatArray, Led, Rig
from splitknit.simulator.background import background_albedo, hand_shadow
from splitknit.simulator.defocus import defocus
from splitknit.simulator.diffusion import WalkTable, load_walks
from splitknit.simulator.finger import Finger
from splitknit.simulator.lens import fall_off
from splitknit.simulator.lighting import white_card
from splitknit.simulator.renderer import render_band
from splitknit.simulator.skin import BAND_CHANNELS, SkinSettings
from splitknit.simulator.surface import Surface
from splitknit.simulator.truth import optics_truth, surface_truth
from splitknit.simulator.twin import TwinSettings, lay_down
from splitknit.simulator.twin_scene import finger_blur, room_level, room_light

HalfArray = NDArray[np.float16]


@dataclass(frozen=True, slots=True, eq=False)
class _Rendered:
    """Light of one band's LEDs inside the finger's window; half floats, whose steps are a tenth of the noise."""

    window: tuple[slice, slice]
    planes: HalfArray
    """(L, C, h, w) diffuse light and glare, C = 3 (white) or 1 (NIR)."""


class FingerScene:
    """One finger, laid down once, under any LEDs of a rig.

    The finger, its skin and its pose are those of :func:`splitknit.simulator.twin.simulate_capture` with the same
    arguments. Each band's light is rendered once, when one of its LEDs is lit first, and kept. The room's light is
    the same whichever LED is lit.
    """

    def __init__(
        self,
        seed: int,
        pattern: str | None = None,
        settings: TwinSettings | None = None,
        *,
        impression: int = 0,
        finger: Finger | None = None,
    ) -> None:
        """Lay a finger down.

        Parameters
        ----------
        seed : of the person: finger, print and skin follow from it
        pattern : class of the print; None draws it
        settings : of the twin; `sensor` is not used here
        impression : number of the capture of this finger: pose and dust change with it
        finger : laid down instead of the one that `seed` draws

        Raises
        ------
        BadInput
            If no part of the finger is in the picture.
        """
        settings = settings or TwinSettings()
        laid = lay_down(seed, pattern, settings, impression=impression, finger=finger)
        self.settings = settings
        self.rig: Rig = laid.rig
        self.skin: SkinSettings = laid.skin
        self.surface: Surface = laid.surface
        rng = np.random.default_rng(laid.photo_seed.spawn(1)[0])
        albedo = background_albedo(self.rig.camera, settings.background, rng)
        self._albedo = np.where(self.surface.mask, 0, albedo)
        self._shade = hand_shadow(self.rig.camera, settings.background)
        self._walks: WalkTable = load_walks()
        self._fall_off = fall_off(self.rig.camera) if self.rig.camera.shading else None
        self._blur = finger_blur(self.surface, settings.render)
        self._bands: dict[str, _Rendered] = {}
        self._room: FloatArray | None = None

    @property
    def camera(self) -> Camera:
        """The camera that looks at the finger."""
        return self.rig.camera

    @property
    def leds(self) -> tuple[Led, ...]:
        """LEDs of the rig."""
        return self.rig.leds

    def light(self, lit: Sequence[int]) -> FloatArray:
        """Noise-free light with some LEDs on.

        Parameters
        ----------
        lit : numbers of the LEDs; none = the room's light alone

        Returns
        -------
        (H, W, 3) float32
            White-balanced linear radiance in the rig's units: a white Lambertian card that faces an LED of intensity
            one at 100 mm gives 1 / pi.

        Raises
        ------
        BadInput
            If there is no such LED.
        """
        for index in lit:
            require(0 <= index < len(self.leds), f"there is no LED {index} in the rig of {len(self.leds)}.")
        frame = self._room_light().copy()
        for index in lit:
            band = self._rendered(self.leds[index].band)
            members = [k for k, led in enumerate(self.leds) if led.band == self.leds[index].band]
            card = white_card(self.camera, self.leds[index], -self.settings.background.depth_mm)
            frame += ((card * self._albedo) * self._shade)[..., None]
            planes = band.planes[members.index(index)]
            shade = self._shade[band.window[0]]
            for c in range(3):
                frame[band.window][..., c] += planes[min(c, len(planes) - 1)] * shade
        if self._blur is not None:
            frame = defocus(frame, self._blur)
        if self._fall_off is not None:
            frame *= self._fall_off[..., None]
        return frame

    def truth(self) -> dict[str, NDArray[Any]]:
        """Arrays by name: heights, normals, mask, landmarks and optics, see ``docs/twin.md``."""
        intensities = {"led_intensity": np.array([led.intensity for led in self.leds])}
        return surface_truth(self.surface) | optics_truth(self.skin) | intensities

    def _rendered(self, name: str) -> _Rendered:
        if name not in self._bands:
            require(name in BAND_CHANNELS, f"the twin's LEDs are white or nir, not '{name}'.")
            optics = [self.skin.channel(channel) for channel in BAND_CHANNELS[name]]
            leds = [led for led in self.leds if led.band == name]
            light = render_band(
                self.surface,
                leds,
                optics,
                roughness=self.skin.roughness,
                glare=self.skin.glare,
                walks=self._walks,
                settings=self.settings.render,
            )
            planes = np.empty(light.diffuse.shape, dtype=np.float16)
            for k, glare in enumerate(light.glare):
                planes[k] = light.diffuse[k] + glare
            self._bands[name] = _Rendered(light.window, planes)
        return self._bands[name]

    def _room_light(self) -> FloatArray:
        """(H, W, 3) radiance with all LEDs off."""
        if self._room is None:
            self._room = room_light(
                self.surface,
                self._albedo,
                room_level(self.camera, self.leds, self.settings.background.ambient),
                [self.skin.channel(channel) for channel in BAND_CHANNELS["white"]],
                self.skin.roughness,
                walks=self._walks,
                render=self.settings.render,
            )
        return self._room
