"""A finger between mirrors: one picture shows it from the front and from the sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import BoolArray, Camera, FloatArray, Led, Mirror, PixelArray, Rig
from splitknit.simulator.light.lighting import Patch, cut_out, finger_window, irradiance, light_on, white_card
from splitknit.simulator.light.renderer import (
    LED_RADIUS_MM,
    BandLight,
    Relief,
    SubsurfaceScattering,
    render_ambient,
    render_lights,
)
from splitknit.simulator.light.skin import SkinOptics
from splitknit.simulator.mirror_view import Coverage, Light, ReflectedView, lights_of, outline_coverage
from splitknit.simulator.rigs import HolderProfile, MirrorSettings
from splitknit.simulator.scene import (
    BACKGROUND_MM,
    BackgroundSettings,
    Scene,
    Taken,
    TwinSettings,
    ambient_level,
    background_albedo,
    brightest,
    finger_depth,
)
from splitknit.simulator.surface import SimulatedSurface

Array = NDArray[np.float64]


# Light on a finger between mirrors: the LEDs, and their images through the mirrors' faces.


def _light_through(
    patch: Patch, lights: Sequence[Light], roughness: float, led_radius_mm: float
) -> tuple[FloatArray, FloatArray]:
    """(h, w) irradiance that enters the skin and radiance that its surface reflects, of all `lights` together."""
    entering = np.zeros(patch.mask.shape, dtype=np.float32)
    gloss = np.zeros(patch.mask.shape, dtype=np.float32)
    for light in lights:
        with np.errstate(divide="ignore", invalid="ignore"):  # light from straight behind, where nothing is lit
            enters, shines = light_on(patch, light.led, roughness, led_radius_mm)
        if light.gate is not None:
            fraction = light.gate.fraction(patch.x, patch.y, patch.z, light.led, led_radius_mm)
            enters, shines = enters * fraction, shines * fraction
        entering += enters
        gloss += shines
    return entering, gloss


class MirrorScene:
    """One finger, its reflections and the holders in front of the camera."""

    def __init__(
        self,
        subject: tuple[SimulatedSurface, Rig, SkinOptics],
        seen: Sequence[ReflectedView],
        settings: TwinSettings,
        seed: np.random.SeedSequence,
    ) -> None:
        """Lay the background and the holders; `seed` draws the dust on them."""
        surface, rig, skin = subject
        self.views, self.rig, self.skin, self.settings = tuple(seen), rig, skin, settings
        self.front = Scene(subject, settings, np.random.default_rng(seed))
        if settings.render.aperture_mm > 0.0:  # what a mirror shows lies as deep as its image behind the mirror
            depth, top = finger_depth(surface)
            for view in self.views:
                cover = view.coverage
                inside = finger_depth(view.surface)[0][cover.window]
                depth[cover.window] += cover.fraction * (inside - depth[cover.window])
            self.front.blur = self.front.blur_by(depth, top)
        self.mirrors = [view.mirror for view in seen]
        self.free = ~surface.mask
        rngs = [np.random.default_rng(child) for child in seed.spawn(len(self.views))]
        self.frames: list[_Frame] = [
            _mirror_frame(view, self.mirrors, rig.camera, settings.mirrors, rng)
            for view, rng in zip(self.views, rngs, strict=True)
        ]
        self.masks = [_visible(view, frame, self.free) for view, frame in zip(self.views, self.frames, strict=True)]
        for view, mask in zip(self.views, self.masks, strict=True):
            require(
                bool(mask.any()),
                f"the lip of the {view.mirror.name} mirror's holder hides the finger; lift it or lower the mirror.",
            )

    def photograph(self, name: str, seed: np.random.SeedSequence) -> Taken:
        """Images of one band, the glare (L, H, W) in the images' units, and the exposure, as :class:`Scene` does."""
        members = [k for k, led in enumerate(self.rig.leds) if led.band == name]
        leds = [self.rig.leds[k] for k in members]
        lit = [lights_of(led, self.mirrors) for led in leds]
        front = self._render(self.front.surface, lit, name)
        sides = [
            self._render(view.surface, [[light.reflected(view.reflection) for light in group] for group in lit], name)
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

    def _render(self, surface: SimulatedSurface, lights: Sequence[Sequence[Light]], name: str) -> BandLight:
        """Light of a finger, or its reflection, in as many images as there are groups of `lights`."""
        skin, patch = self.skin.medium(name), cut_out(surface)

        def shine(k: int) -> tuple[FloatArray, FloatArray, None]:
            entering, gloss = _light_through(patch, lights[k], skin.roughness, LED_RADIUS_MM)
            return entering, gloss * np.float32(skin.glare), None

        blur, relief = SubsurfaceScattering(patch, skin, self.settings.render), Relief(surface, patch, skin)
        return render_lights(patch, shine, len(lights), blur, lambda k: relief.gains(lights[k][0].led))

    def _frame(self, front: BandLight, sides: Sequence[BandLight], k: int, led: Led) -> FloatArray:
        """(H, W, 3) radiance of the whole picture under light k."""
        camera = self.rig.camera
        card = white_card(camera, led, -BACKGROUND_MM)
        frame = self.front.frame(front, k, self.front.background(card, led.band))
        for view, plates, light in zip(self.views, self.frames, sides, strict=True):
            inside = _background_of(plates, camera, led)
            _put(inside, view.surface, light.window, light.diffuse[k], light.glare[k])
            self._over(frame, (view, plates), inside, lambda plate: plate.radiance(led), card)
        return frame

    def _over(
        self,
        frame: FloatArray,
        seen: tuple[ReflectedView, _Frame],
        inside: FloatArray,
        radiance: Callable[[_Plate], float],
        card: FloatArray | None = None,
    ) -> None:
        """Lay a mirror that shows `inside` (H, W, 3), and its holder, over `frame`; `card` (H, W) lights its dust."""
        view, plates = seen
        for plate in plates.reflected_lip:
            _blend(inside, plate.coverage, np.float32(radiance(plate)))
        inside *= np.float32(view.mirror.reflectance)
        if card is not None:
            if plates.dust.any():
                inside += (plates.dust * card)[..., None]
            inside *= self.front.shade[..., None]
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
        level = ambient_level(self.rig.camera, leds, self.settings.background.ambient)
        if level <= 0.0:
            return frame
        for view, plates in zip(self.views, self.frames, strict=True):
            up = view.reflection.vectors(np.array([0.0, 0.0, 1.0]))
            light = render_ambient(view.surface, level, self.skin.medium(name), self.settings.render, up)
            albedo = np.float32(0.5 * level * _PLASTIC_ALBEDO)
            inside = np.full_like(frame, albedo)
            window = finger_window(view.surface)
            _put(inside, view.surface, window, light, None)
            self._over(frame, (view, plates), inside, lambda plate: level * plate.albedo)
        return frame


def _put(
    frame: FloatArray,
    surface: SimulatedSurface,
    window: tuple[slice, slice],
    diffuse: FloatArray,
    glare: FloatArray | None,
) -> None:
    """Write the light of a finger (C, h, w) over `frame` (H, W, 3) where the finger is seen, in place."""
    mask, some = surface.mask[window], frame[window]
    for c in range(3):
        light = diffuse[min(c, diffuse.shape[0] - 1)]
        if glare is not None:
            light = light + glare
        some[..., c] = np.where(mask, light, some[..., c])


# What stands around the finger where there are mirrors: holders, glass, the tube behind it, dust.


_PLASTIC_ALBEDO = 0.04
"""Of holders and tube: black print."""
_GLASS_ALBEDO = 0.12
"""Of the mirrors' ground upper edge."""
_TUBE_MM = 52.0
"""Inner radius of the tube around the finger."""

_STRAY_SHARE = 0.1
"""Light that comes to the tube by way of other things, against that of a white card under the LED."""

_LID_SHARE = 0.2
"""Light from what hangs above the finger, which a second mirror shows, against that from the tube."""


@dataclass(frozen=True, slots=True, eq=False)
class _Plate:
    """A flat piece of plastic or glass in the picture."""

    coverage: Coverage
    middle: Array
    """(3,) mm, where it truly is."""
    normal: Array
    albedo: float

    def radiance(self, led: Led) -> float:
        """What it sends under one LED: matt."""
        return self.albedo / np.pi * _received(led, self.middle, self.normal)


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    """Everything of one mirror but the finger."""

    name: str
    holder: tuple[_Plate, ...]
    """Behind and beside the face, in front of the background."""
    lip: tuple[_Plate, ...]
    """In front of the face."""
    reflected_lip: tuple[_Plate, ...]
    """What the mirror shows of the lip; its `coverage` is in the mirror, the rest as it truly is."""
    opposite: tuple[Coverage, ...]
    """Where it shows the other mirrors."""
    wall: _Plate
    """The tube on the far side of the finger."""
    dust: FloatArray
    """(H, W) albedo of the specks on the face."""


def _mirror_frame(
    view: ReflectedView, mirrors: Sequence[Mirror], camera: Camera, views: MirrorSettings, rng: np.random.Generator
) -> _Frame:
    """Lay out what surrounds the finger in and around one mirror; the holders stand where the drawing has them."""
    name, profile = view.mirror.name, HolderProfile(views.parts)
    inwards = {"left": np.array([1.0, 0, 0]), "right": np.array([-1.0, 0, 0]), "tip": np.array([0, -1.0, 0])}[name]

    def plate(low: Array, high: Array, albedo: float) -> _Plate:
        corners = profile.quad(name, camera, low, high)
        return _Plate(outline_coverage(camera, corners), corners.mean(axis=0), _face_normal(corners, inwards), albedo)

    low, high = profile.glass
    glass = plate(low, high, _GLASS_ALBEDO)
    back = plate(*profile.back, _PLASTIC_ALBEDO)
    inside, outside, start = profile.lip
    lip = (plate(outside, start, _PLASTIC_ALBEDO), plate(inside, outside, _PLASTIC_ALBEDO))
    shown = tuple(
        replace(one, coverage=outline_coverage(camera, view.reflection.points(profile.quad(name, camera, *ends))))
        for one, ends in ((plate(*profile.shade, 0.0), profile.shade), (lip[1], (inside, outside)))
    )
    opposite = tuple(
        outline_coverage(camera, view.reflection.points(np.asarray(other.corners_mm)))
        for other in mirrors
        if other.name != name
    )
    middle = np.append(_TUBE_MM * inwards[:2], -5.0)
    wall = _Plate(view.coverage, middle, -inwards, _PLASTIC_ALBEDO)
    specks = BackgroundSettings(albedo=0.0, dust_per_cm2=views.dust_per_cm2)
    return _Frame(name, (glass, back), lip, shown, opposite, wall, background_albedo(camera, specks, rng))


def _face_normal(corners: Array, inwards: Array) -> Array:
    """(3,) unit normal of a rectangle, upwards."""
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    normal /= np.linalg.norm(normal)
    lean = normal[2] if abs(normal[2]) > 1e-6 else float(normal @ inwards)
    return np.asarray(normal if lean > 0 else -normal)


def _blend(frame: FloatArray, cover: Coverage, over: FloatArray | np.float32, free: BoolArray | None = None) -> None:
    """Replace what `cover` covers of `frame` (H, W, 3) by `over` (H, W, 3), in place; only where `free` (H, W)."""
    fraction = cover.fraction if free is None else cover.fraction * free[cover.window]
    some = frame[cover.window]
    some += fraction[..., None] * ((over[cover.window] if isinstance(over, np.ndarray) else over) - some)


def _visible(view: ReflectedView, frame: _Frame, free: BoolArray) -> BoolArray:
    """(H, W) pixels that show the finger in a mirror: not the lip, not the lip in the mirror, not the finger itself."""
    mask = view.mask & free
    for plate in (*frame.reflected_lip, *frame.lip):
        mask[plate.coverage.window] &= plate.coverage.fraction < 0.5
    return mask


def _received(led: Led, point: Array, normal: Array) -> float:
    """Light of an LED, and of those lit with it, on a facet at `point` (3,) that faces `normal` (3,)."""
    return sum(float(irradiance(one, point, normal)) for one in (led, *led.also))


def _background_of(frame: _Frame, camera: Camera, led: Led) -> FloatArray:
    """(H, W, 3) radiance of what a mirror shows behind the finger."""
    above = np.array([0.0, 0.0, 1.0])
    stray = _STRAY_SHARE * frame.wall.albedo / np.pi * _received(led, np.zeros(3), above)
    wall = frame.wall.radiance(led) + stray
    content = np.full((*camera.image_size, 3), wall, dtype=np.float32)
    for cover in frame.opposite:
        _blend(content, cover, np.float32(_LID_SHARE * wall))
    return content
