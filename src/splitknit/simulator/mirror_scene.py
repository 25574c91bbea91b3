"""A finger between mirrors: one picture shows it from the front and from the sides."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Band, FloatArray, Led, PixelArray, Rig
from splitknit.simulator.defocus import blur_sigma_px
from splitknit.simulator.diffusion import WalkTable
from splitknit.simulator.lens import px_per_mm_at
from splitknit.simulator.lighting import finger_window, white_card
from splitknit.simulator.mirror_frame import Frame, background_of, blend, mirror_frame, visible
from splitknit.simulator.mirror_light import render_between_mirrors, render_room
from splitknit.simulator.mirror_view import View
from splitknit.simulator.mirrors import lights_of
from splitknit.simulator.renderer import BandLight
from splitknit.simulator.skin import BAND_CHANNELS, SkinSettings
from splitknit.simulator.surface import Surface
from splitknit.simulator.twin_scene import Scene, brightest, finger_depth, room_level

if TYPE_CHECKING:
    from splitknit.simulator.twin import TwinSettings


class MirrorScene:
    """One finger, its reflections and the holders in front of the camera."""

    def __init__(
        self,
        subject: tuple[Surface, Rig, SkinSettings],
        seen: Sequence[View],
        settings: TwinSettings,
        seed: np.random.SeedSequence,
        walks: WalkTable,
    ) -> None:
        """Lay the background and the holders; `seed` draws the dust on them."""
        surface, rig, skin = subject
        self.views, self.rig, self.skin, self.settings, self.walks = tuple(seen), rig, skin, settings, walks
        self.front = Scene(subject, settings, np.random.default_rng(seed), walks)
        self.front.blur = _blur(surface, self.views, settings)
        self.mirrors = [view.mirror for view in seen]
        self.free = ~surface.mask
        rngs = [np.random.default_rng(child) for child in seed.spawn(len(self.views))]
        self.frames: list[Frame] = [
            mirror_frame(view, self.mirrors, rig.camera, settings.mirrors, rng)
            for view, rng in zip(self.views, rngs, strict=True)
        ]
        self.masks = [visible(view, frame, self.free) for view, frame in zip(self.views, self.frames, strict=True)]
        for view, mask in zip(self.views, self.masks, strict=True):
            require(
                bool(mask.any()),
                f"the lip of the {view.mirror.name} mirror's holder hides the finger; lift it or lower the mirror.",
            )

    def photograph(self, name: str, seed: np.random.SeedSequence) -> tuple[Band, NDArray[np.float16], NDArray[Any]]:
        """Images of one band, the glare (L, H, W) in the images' units, and the exposure, as :class:`Scene` does."""
        members = [k for k, led in enumerate(self.rig.leds) if led.band == name]
        leds = [self.rig.leds[k] for k in members]
        optics = [self.skin.channel(channel) for channel in BAND_CHANNELS[name]]
        render, walks = self.settings.render, self.walks
        lit = [lights_of(led, self.mirrors) for led in leds]
        front = render_between_mirrors(self.front.surface, lit, optics, self.skin, walks=walks, settings=render)
        sides = []
        for view in self.views:
            behind = [[light.reflected(view.reflection) for light in group] for group in lit]
            sides.append(render_between_mirrors(view.surface, behind, optics, self.skin, walks=walks, settings=render))
        exposure = np.float32(self.settings.sensor.exposure / self._brightest(front, sides))
        ambient = self._ambient(name, leds)
        seeds = seed.spawn(len(leds) + 1)
        size = self.rig.camera.image_size
        glare = np.zeros((len(leds), *size), dtype=np.float16)

        def shoot(k: int) -> PixelArray:
            frame = self._frame(front, sides, k, leds[k])
            glare[k] = self._glare(front, sides, k) * exposure
            return self.front.record((ambient + frame) * exposure, name, seeds[k])

        with ThreadPoolExecutor(render.workers) as pool:
            images = list(pool.map(shoot, range(len(leds))))
        dark = self.front.record(ambient * exposure, name, seeds[-1])
        band = Band(
            name=name,
            pixels=np.stack(images),  # type: ignore[arg-type]
            leds=tuple((k,) for k in members),
            exposure=np.ones(len(leds)),
            black_level=np.zeros(len(leds)),
            ambient=dark,
            shading=self.rig.camera.shading,
        )
        return band, glare, np.array(float(exposure))

    def _frame(self, front: BandLight, sides: Sequence[BandLight], k: int, led: Led) -> FloatArray:
        """(H, W, 3) radiance of the whole picture under light k."""
        camera = self.rig.camera
        card = white_card(camera, led, -self.settings.background.depth_mm)
        frame = self.front.frame(front, k, card)
        for view, plates, light in zip(self.views, self.frames, sides, strict=True):
            inside = background_of(plates, camera, led)
            _put(inside, view.surface, light.window, light.diffuse[k], light.glare[k])
            for plate in plates.reflected_lip:
                blend(inside, plate.coverage, np.float32(plate.radiance(led)))
            inside *= np.float32(view.mirror.reflectance)
            if plates.dust.any():
                inside += (plates.dust * card)[..., None]
            inside *= self.front.shade[..., None]
            for plate in plates.holder:
                blend(frame, plate.coverage, np.float32(plate.radiance(led)), self.free)
            blend(frame, view.coverage, inside, self.free)
            for plate in plates.lip:
                blend(frame, plate.coverage, np.float32(plate.radiance(led)), self.free)
        return frame

    def _glare(self, front: BandLight, sides: Sequence[BandLight], k: int) -> FloatArray:
        """(H, W) radiance that the finger's surface reflects under light k, also in the mirrors."""
        glare = np.zeros(self.rig.camera.image_size, dtype=np.float32)
        glare[front.window] = front.glare[k]
        for view, light in zip(self.views, sides, strict=True):
            whole = np.zeros((*glare.shape, 1), dtype=np.float32)
            whole[light.window] = light.glare[k][..., None] * np.float32(view.mirror.reflectance)
            blend(glare[..., None], view.coverage, whole, self.free)
        return glare * self.front.shade

    def _brightest(self, front: BandLight, sides: Sequence[BandLight]) -> float:
        """Of the front and of what the mirrors show, behind the lens."""
        fallen = self.front.fall_off
        values = [brightest(front.diffuse, None if fallen is None else fallen[front.window])]
        for view, mask, light in zip(self.views, self.masks, sides, strict=True):
            if mask[light.window][::4, ::4].any():
                shown = light.diffuse * mask[light.window] * np.float32(view.mirror.reflectance)
                values.append(brightest(shown, None if fallen is None else fallen[light.window]))
        return max(values)

    def _ambient(self, name: str, leds: list[Led]) -> FloatArray:
        """(H, W, 3) radiance of the picture with all LEDs off."""
        frame = self.front.ambient(name, leds)
        level = room_level(self.rig.camera, leds, self.settings.background.ambient)
        if level <= 0.0:
            return frame
        optics = [self.skin.channel(channel) for channel in BAND_CHANNELS[name]]
        for view, plates in zip(self.views, self.frames, strict=True):
            up = view.reflection.vectors(np.array([0.0, 0.0, 1.0]))
            light = render_room(
                view.surface, level, optics, self.skin, walks=self.walks, settings=self.settings.render, up=up
            )
            albedo = np.float32(0.5 * level * self.settings.mirrors.plastic_albedo)
            inside = np.full_like(frame, albedo)
            window = finger_window(view.surface)
            _put(inside, view.surface, window, light, None)
            for plate in plates.reflected_lip:
                blend(inside, plate.coverage, np.float32(level * plate.albedo))
            inside *= np.float32(view.mirror.reflectance)
            for plate in plates.holder:
                blend(frame, plate.coverage, np.float32(level * plate.albedo), self.free)
            blend(frame, view.coverage, inside, self.free)
            for plate in plates.lip:
                blend(frame, plate.coverage, np.float32(level * plate.albedo), self.free)
        return frame


def _blur(surface: Surface, seen: Sequence[View], settings: TwinSettings) -> FloatArray | None:
    """(H, W) defocus in pixels by depth, or None; what a mirror shows lies as deep as its image behind the mirror."""
    render, camera = settings.render, surface.camera
    if render.aperture_mm == 0.0:
        return None
    depth, top = finger_depth(surface)
    focus = top - render.focus_depth_mm
    for view in seen:
        cover = view.coverage
        inside = finger_depth(view.surface)[0][cover.window]
        depth[cover.window] += cover.share * (inside - depth[cover.window])
    return blur_sigma_px(depth, focus, camera.height_mm, render.aperture_mm, px_per_mm_at(camera, focus))


def _put(
    frame: FloatArray, surface: Surface, window: tuple[slice, slice], diffuse: FloatArray, glare: FloatArray | None
) -> None:
    """Write the light of a finger (C, h, w) over `frame` (H, W, 3) where the finger is seen, in place."""
    mask, some = surface.mask[window], frame[window]
    for c in range(3):
        light = diffuse[min(c, diffuse.shape[0] - 1)]
        if glare is not None:
            light = light + glare
        some[..., c] = np.where(mask, light, some[..., c])
