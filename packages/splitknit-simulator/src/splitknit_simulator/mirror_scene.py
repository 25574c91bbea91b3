"""A finger between mirrors: one picture shows it from the front and from the sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from splitknit import Camera, Led, Mirror, Rig
from splitknit.errors import require
from splitknit.model import Array, BoolArray, FloatArray, PixelArray
from splitknit_simulator.light.lighting import (
    Patch,
    cut_out,
    finger_window,
    irradiance,
    light_on,
    white_card,
)
from splitknit_simulator.light.renderer import (
    BandLight,
    Relief,
    SubsurfaceScattering,
    render_ambient,
    render_lights,
)
from splitknit_simulator.light.skin import SkinOptics
from splitknit_simulator.mirror_view import (
    Coverage,
    Light,
    ReflectedView,
    lights_of,
    outline_coverage,
)
from splitknit_simulator.rigs import holder_profile, holder_quad
from splitknit_simulator.scene import (
    BACKGROUND_MM,
    Scene,
    Taken,
    TwinSettings,
    ambient_level,
    brightest,
    finger_depth,
)
from splitknit_simulator.surface import SimulatedSurface, Window


def _light_through(
    patch: Patch, lights: Sequence[Light], roughness: float
) -> tuple[FloatArray, FloatArray]:
    """(h, w) irradiance that enters the skin and radiance that its surface reflects, of all
    `lights` together."""
    entering, gloss = np.zeros((2, *patch.mask.shape), dtype=np.float32)
    for light in lights:
        # light from straight behind, where nothing is lit
        with np.errstate(divide="ignore", invalid="ignore"):
            parts = light_on(patch, light.led, roughness)
        fraction = 1 if light.gate is None else light.gate.fraction(patch.points, light.led)
        entering += parts[0] * fraction
        gloss += parts[1] * fraction
    return entering, gloss


_PLASTIC_ALBEDO = 0.04
"""Black print: the mirrors' holders and the tube around the finger."""


class MirrorScene:
    """One finger, its reflections and the holders in front of the camera."""

    def __init__(
        self,
        subject: tuple[SimulatedSurface, Rig, SkinOptics],
        seen: Sequence[ReflectedView],
        settings: TwinSettings,
        seed: np.random.SeedSequence,
    ) -> None:
        """Lay the background, whose dust `seed` draws, and the holders."""
        surface, rig, skin = subject
        self.views, self.rig, self.skin, self.settings = tuple(seen), rig, skin, settings
        self.front = Scene(subject, settings, np.random.default_rng(seed))
        # what a mirror shows lies as deep as its image behind the mirror
        if settings.render.aperture_mm > 0.0:
            depth, top = finger_depth(surface)
            for view in self.views:
                cover = view.coverage
                inside = finger_depth(view.surface)[0][cover.window]
                depth[cover.window] += cover.fraction * (inside - depth[cover.window])
            self.front.blur = self.front.blur_by(depth, top)
        self.mirrors = [view.mirror for view in seen]
        self.free = ~surface.mask
        self.frames: list[_Frame] = []
        self.masks: list[BoolArray] = []
        for view in self.views:
            self.frames.append(_mirror_frame(view, self.mirrors, rig.camera))
            # not the lip, not the lip in the mirror, not the finger itself
            mask = view.mask & self.free
            for plate in (*self.frames[-1].reflected_lip, *self.frames[-1].lip):
                mask[plate.coverage.window] &= plate.coverage.fraction < 0.5
            self.masks.append(mask)
            require(
                self.masks[-1].any(),
                f"the lip of the {view.mirror.name} mirror's holder hides the finger; lift it or"
                " lower the mirror.",
            )

    def photograph(self, name: str, seed: np.random.SeedSequence) -> Taken:
        """Images of one band, the glare (L, H, W) in the images' units, and the exposure, as
        :class:`Scene` does."""
        members = [k for k, led in enumerate(self.rig.leds) if led.band == name]
        leds = [self.rig.leds[k] for k in members]
        lit = [lights_of(led, self.mirrors) for led in leds]
        front = self._render(self.front.surface, lit, name)
        sides = [
            self._render(
                view.surface,
                [[light.reflected(view.reflection) for light in group] for group in lit],
                name,
            )
            for view in self.views
        ]
        exposure = np.float32(self.settings.sensor.exposure / self._brightest(front, sides))
        ambient = self._ambient(name, leds)
        glare = np.zeros((len(leds), *self.rig.camera.image_size), dtype=np.float16)

        def shoot(k: int, seed: np.random.SeedSequence) -> PixelArray:
            frame = self._frame(front, sides, k, leds[k])
            glare[k] = self._glare(front, sides, k) * exposure
            return self.front.record((ambient + frame) * exposure, name, leds, seed)

        band = self.front.take(name, [(k,) for k in members], shoot, ambient * exposure, seed)
        return band, glare, np.array(float(exposure))

    def _render(
        self, surface: SimulatedSurface, lights: Sequence[Sequence[Light]], name: str
    ) -> BandLight:
        """Light of a finger, or its reflection, in as many images as there are groups of
        `lights`."""
        skin, patch = self.skin.medium(name), cut_out(surface)

        def shine(k: int) -> tuple[FloatArray, FloatArray, None]:
            entering, gloss = _light_through(patch, lights[k], skin.roughness)
            return entering, gloss * np.float32(skin.glare), None

        blur, relief = (
            SubsurfaceScattering(patch, skin, self.settings.render),
            Relief(surface, patch, skin),
        )
        return render_lights(
            patch, shine, len(lights), blur, lambda k: relief.gains(lights[k][0].led)
        )

    def _frame(self, front: BandLight, sides: Sequence[BandLight], k: int, led: Led) -> FloatArray:
        """(H, W, 3) radiance of the whole picture under light k."""
        camera = self.rig.camera
        card = white_card(camera, led, -BACKGROUND_MM)
        frame = self.front.frame(front, k, self.front.background(card, led.band))
        for view, plates, light in zip(self.views, self.frames, sides, strict=True):
            # (H, W, 3) radiance of what a mirror shows behind the finger
            above = np.array([0.0, 0.0, 1.0])
            # a tenth of the LED's light reaches the tube by way of other things
            wall = plates.wall.radiance(led) + 0.1 * plates.wall.albedo / np.pi * _received(
                led, np.zeros(3), above
            )
            content = np.full((*camera.image_size, 3), wall, dtype=np.float32)
            for cover in plates.opposite:
                # what hangs above the finger sends a fifth of the tube's light
                _blend(content, cover, np.float32(0.2 * wall))
            inside = content
            _put(inside, view.surface, light.window, light.diffuse[k] + light.glare[k])
            self._over(
                frame, (view, plates), inside, lambda plate: plate.radiance(led), self.front.shade
            )
        return frame

    def _over(
        self,
        frame: FloatArray,
        seen: tuple[ReflectedView, _Frame],
        inside: FloatArray,
        radiance: Callable[[_Plate], float],
        shade: FloatArray | None = None,
    ) -> None:
        """Lay a mirror that shows `inside` (H, W, 3), and its holder, over `frame`; `shade` (H, 1):
        the hand's."""
        view, plates = seen
        for plate in plates.reflected_lip:
            _blend(inside, plate.coverage, np.float32(radiance(plate)))
        inside *= np.float32(view.mirror.reflectance)
        if shade is not None:
            inside *= shade[..., None]
        for plate in plates.holder:
            _blend(frame, plate.coverage, np.float32(radiance(plate)), self.free)
        _blend(frame, view.coverage, inside, self.free)
        for plate in plates.lip:
            _blend(frame, plate.coverage, np.float32(radiance(plate)), self.free)

    def _glare(self, front: BandLight, sides: Sequence[BandLight], k: int) -> FloatArray:
        """(H, W) radiance that the finger's surface reflects under light k, also in the mirrors."""
        glare = np.zeros(self.rig.camera.image_size, dtype=np.float32)
        glare[front.window] = front.glare[k]
        for view, light in zip(self.views, sides, strict=True):
            whole = np.zeros((*glare.shape, 1), dtype=np.float32)
            whole[light.window] = light.glare[k][..., None] * np.float32(view.mirror.reflectance)
            _blend(glare[..., None], view.coverage, whole, self.free)
        return glare * self.front.shade

    def _brightest(self, front: BandLight, sides: Sequence[BandLight]) -> float:
        """Brightest light behind the lens, of the front view and the mirrored ones."""
        fallen = self.front.fall_off
        values = [brightest(front.diffuse, None if fallen is None else fallen[front.window])]
        for view, mask, light in zip(self.views, self.masks, sides, strict=True):
            if mask[light.window][::4, ::4].any():
                reflected = light.diffuse * mask[light.window] * np.float32(view.mirror.reflectance)
                values.append(
                    brightest(reflected, None if fallen is None else fallen[light.window])
                )
        return max(values)

    def _ambient(self, name: str, leds: list[Led]) -> FloatArray:
        """(H, W, 3) radiance of the picture with all LEDs off."""
        frame = self.front.ambient(name, leds)
        level = ambient_level(self.rig.camera, leds, self.settings.background.ambient)
        if level <= 0.0:
            return frame
        for view, plates in zip(self.views, self.frames, strict=True):
            up = view.reflection.vectors(np.array([0.0, 0.0, 1.0]))
            light = render_ambient(
                view.surface, level, self.skin.medium(name), self.settings.render, up
            )
            inside = np.full_like(frame, np.float32(0.5 * level * _PLASTIC_ALBEDO))
            _put(inside, view.surface, finger_window(view.surface), light)
            self._over(frame, (view, plates), inside, lambda plate: level * plate.albedo)
        return frame


def _put(frame: FloatArray, surface: SimulatedSurface, window: Window, light: FloatArray) -> None:
    """Write the light of a finger (C, h, w) over `frame` (H, W, 3) where the finger is seen, in
    place."""
    colours = np.broadcast_to(np.moveaxis(light, 0, -1), frame[window].shape)
    np.copyto(frame[window], colours, where=surface.mask[window][..., None])


# What stands around the finger where there are mirrors: holders, glass, the tube behind it.


@dataclass(frozen=True, slots=True, eq=False)
class _Plate:
    """A flat piece of plastic or glass in the picture."""

    coverage: Coverage
    middle: Array  # (3,) mm, where it truly is
    normal: Array
    albedo: float

    def radiance(self, led: Led) -> float:
        """What it sends under one LED: matt."""
        return self.albedo / np.pi * _received(led, self.middle, self.normal)


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    """Everything of one mirror but the finger."""

    holder: tuple[_Plate, ...]  # behind and beside the face, in front of the background
    lip: tuple[_Plate, ...]  # in front of the face
    # what the mirror shows of the lip; its `coverage` is in the mirror, the rest as it truly is
    reflected_lip: tuple[_Plate, ...]
    opposite: tuple[Coverage, ...]  # where it shows the other mirrors
    wall: _Plate  # the tube on the far side of the finger


def _mirror_frame(view: ReflectedView, mirrors: Sequence[Mirror], camera: Camera) -> _Frame:
    """Lay out what surrounds the finger in and around one mirror; the holders stand where the
    drawing has them."""
    name, profile = view.mirror.name, holder_profile()
    inwards = {
        "left": np.array([1.0, 0, 0]),
        "right": np.array([-1.0, 0, 0]),
        "tip": np.array([0, -1.0, 0]),
    }[name]

    def quad(line: str) -> Array:
        return holder_quad(name, camera, *profile[line])

    def plate(line: str, albedo: float = _PLASTIC_ALBEDO) -> _Plate:
        corners = quad(line)
        return _Plate(
            outline_coverage(camera, corners),
            corners.mean(axis=0),
            _face_normal(corners, inwards),
            albedo,
        )

    lip = (plate("lip_front"), plate("lip"))
    reflected = tuple(
        replace(part, coverage=outline_coverage(camera, view.reflection.points(quad(line))))
        for part, line in ((plate("shade", 0.0), "shade"), (lip[1], "lip"))
    )
    opposite = tuple(
        outline_coverage(camera, view.reflection.points(np.asarray(mirror.corners_mm)))
        for mirror in mirrors
        if mirror.name != name
    )
    middle = np.append(52.0 * inwards[:2], -5.0)  # mm; the tube's inner radius
    wall = _Plate(view.coverage, middle, -inwards, _PLASTIC_ALBEDO)
    holder = plate("glass", 0.12), plate("back")  # the edge is ground
    return _Frame(holder, lip, reflected, opposite, wall)


def _face_normal(corners: Array, inwards: Array) -> Array:
    """(3,) unit normal of a rectangle, upwards."""
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    normal /= np.linalg.norm(normal)
    lean = normal[2] if abs(normal[2]) > 1e-6 else float(normal @ inwards)
    return np.asarray(normal if lean > 0 else -normal)


def _blend(
    frame: FloatArray, cover: Coverage, over: FloatArray | np.float32, free: BoolArray | None = None
) -> None:
    """Replace what `cover` covers of `frame` (H, W, 3) by `over` (H, W, 3), in place; only where
    `free` (H, W)."""
    fraction = cover.fraction if free is None else cover.fraction * free[cover.window]
    some = frame[cover.window]
    some += fraction[..., None] * (
        (over[cover.window] if isinstance(over, np.ndarray) else over) - some
    )


def _received(led: Led, point: Array, normal: Array) -> float:
    """Light of an LED, and of those lit with it, on a facet at `point` (3,) that faces `normal`
    (3,)."""
    return sum(float(irradiance(lamp, point, normal)) for lamp in (led, *led.also))
