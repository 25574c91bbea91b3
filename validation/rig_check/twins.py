"""Twins of a built rig in front of card, ball, phantom and finger, and what can be wrong with them.

A defect changes the light of each LED, the camera's picture or the rig file; where it is in the
light itself (a moved LED, the focus) the scene is rendered again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Ambient, Band, Capture, Led, Rig
from splitknit.model import FloatArray, PixelArray
from splitknit_rig.acceptance.photographs import SERIES_FRACTIONS
from splitknit_rig.calibration.card_model import CardPlane
from splitknit_rig.calibration.phantom import phantom
from splitknit_rig.calibration.radiometry import fit_radiometry
from splitknit_rig.calibration.radiometry_folder import patches
from splitknit_simulator import simulate_capture
from splitknit_simulator.calibration_set.bench import BenchSettings
from splitknit_simulator.calibration_set.flat import CardScene
from splitknit_simulator.calibration_set.solids import ReliefScene, SphereScene
from splitknit_simulator.camera.sensor import SensorSettings, binning_scale, record
from splitknit_simulator.rigs import built_rig
from splitknit_simulator.twin import FingerScene, twin_settings

SCALE = 0.2
"""Of the pictures: 440 x 640 pixels, 15 px/mm."""
PUPIL_MM = 5.5
"""Of the lens: f/2 at 11 mm, the least depth of field that is offered."""
LED_SD_MM = 0.3
"""Error of the LEDs' places in the rig file, each axis: 0.2 deg, that of four nail positions."""
SCALE_SD = 0.001
"""Error of the camera's focal length in the rig file."""
TILT_SD_DEG = 0.1
"""Error of the base's tilt in the rig file."""
FINGER_SHIFT_MM = 0.1
"""A finger that lies still moves by this between two captures (each axis), ..."""
SHOT_SHIFT_MM = 0.01
"""... and by this from shot to shot."""

Array = NDArray[np.float64]
Store = Callable[[PixelArray], PixelArray]


@dataclass(frozen=True)
class Lit:
    """A scene: (L, H, W, 3) light with one LED on, and (H, W, 3) with none."""

    leds: FloatArray
    dark: FloatArray

    def warped(self, matrices: Sequence[Any]) -> Lit:
        size = self.dark.shape[1::-1]

        def warp(image: FloatArray, matrix: Any) -> FloatArray:
            return np.asarray(cv2.warpAffine(image, matrix, size, borderMode=cv2.BORDER_REPLICATE))

        moved = np.stack([warp(i, m) for i, m in zip(self.leds, matrices, strict=True)])
        return Lit(moved, warp(self.dark, matrices[0]))


@dataclass(frozen=True)
class Twin:
    """A rig as it was built, its file, and what it lights."""

    seed: int
    rig: Rig  # true
    tilt_deg: tuple[float, float]
    file: Rig
    card: Lit
    ball: Lit
    phantom: Lit
    finger: Lit
    store: Store = lambda pixels: pixels  # what the camera does with its picture
    exposure: float = 1.0  # of what is right
    moving_mm: float = 0.0  # from shot to shot
    flicker: float = 0.0  # of the light, from photograph to photograph
    films: Capture | None = None  # of the same finger behind films

    def lights(self, change: Callable[[Lit], Lit]) -> Twin:
        """With the light of all scenes changed."""
        parts = ("card", "ball", "phantom", "finger")
        return replace(self, **{part: change(getattr(self, part)) for part in parts})

    def bench(self) -> tuple[Capture, Capture, Capture, tuple[Array, Array]]:
        """Card, ball and phantom under every LED, and an exposure series of the card: values,
        exposures."""
        seeds = np.random.SeedSequence([self.seed, 0xAC])
        card = self._capture(self.card, seeds, "opaque")
        ball = self._capture(self.ball, seeds, "opaque")
        light = self.card.leds[0]
        top = 0.85 * self.exposure / float(np.percentile(light, 99.9))
        frames = [
            self._photo(light * np.float32(top * s), "white", seeds) for s in SERIES_FRACTIONS
        ]
        values = np.stack([patches(frame)[0] for frame in frames])
        phantom = self._capture(self.phantom, seeds, "opaque")
        return card, ball, phantom, (values, np.array(SERIES_FRACTIONS))

    def fingers(self) -> tuple[Capture, Capture]:
        """The finger twice."""
        seeds = np.random.SeedSequence([self.seed, 0xAD])
        rng = np.random.default_rng(seeds.spawn(1)[0])
        captures = []
        for _ in range(2):
            between = FINGER_SHIFT_MM * rng.standard_normal(2)
            steps = (SHOT_SHIFT_MM + self.moving_mm) * rng.standard_normal((len(self.rig.leds), 2))
            moves = (between + steps) * self.rig.camera.px_per_mm
            matrices = [np.array([[1.0, 0.0, x], [0.0, 1.0, y]]) for x, y in moves]
            captures.append(self._capture(self.finger.warped(matrices), seeds, "skin"))
        return captures[0] if self.films is None else self.films, captures[1]

    def _capture(self, scene: Lit, seeds: np.random.SeedSequence, material: str) -> Capture:
        bands = {}
        for name in ("white", "nir"):
            members = [k for k, led in enumerate(self.rig.leds) if led.band == name]
            brightest = max(float(np.percentile(scene.leds[k][::4, ::4], 99.9)) for k in members)
            exposure = np.float32(0.7 * self.exposure / brightest)
            images = [self._photo(scene.leds[k] * exposure, name, seeds) for k in members]
            bands[name] = Band(
                name,
                np.stack(images),  # type: ignore[arg-type]
                tuple((k,) for k in members),
                np.ones(len(members)),
                np.zeros(len(members)),
                ambient=Ambient(self._photo(scene.dark * exposure, name, seeds)),
            )
        return Capture(rig=self.file, bands=bands, material=material)

    def _photo(self, light: FloatArray, band: str, seeds: np.random.SeedSequence) -> PixelArray:
        scale = binning_scale(self.rig.camera)
        if self.flicker:
            rng = np.random.default_rng(seeds.spawn(1)[0])
            light = light * np.float32(1.0 + self.flicker * rng.standard_normal())
        return self.store(record(light, band, seeds.spawn(1)[0], SensorSettings(), scale))


def twin(seed: int) -> Twin:
    """A sound rig: built, calibrated, its file as wrong as calibration leaves it."""
    rig = built_rig(seed, scale=SCALE)
    tilt = tuple(rig.provenance["base_tilt_deg"])
    flat = card_of(rig, tilt)
    empty = Twin(seed, rig, tilt, rig, flat, flat, flat, flat)
    return replace(empty, file=_calibrated(empty), finger=finger_of(seed, rig), **solids(rig, tilt))


def _lit(scene: Any, leds: Sequence[int]) -> Lit:
    return Lit(np.stack([scene.light([k]) for k in leds]), scene.light([]))


def card_of(rig: Rig, tilt: Any) -> Lit:
    scene = CardScene(camera=rig.camera, leds=rig.leds, tilt_deg=tilt, bench=_bench())
    return _lit(scene, range(len(rig.leds)))


def ball_of(rig: Rig, tilt: Any) -> Lit:
    scene = SphereScene(
        camera=rig.camera, leds=rig.leds, tilt_deg=tilt, bench=_bench(), chrome=False
    )
    return _lit(scene, range(len(rig.leds)))


def phantom_of(rig: Rig, tilt: Any, focus_mm: float = 0.0) -> Lit:
    """The printed phantom, laid by hand, in focus at a height over its top."""
    drawn = phantom()[0]
    scene = ReliefScene(
        camera=rig.camera,
        leds=rig.leds,
        tilt_deg=tilt,
        bench=replace(_bench(), focus_mm=focus_mm),
        height_mm=drawn.height_mm,
        pitch_mm=drawn.pitch_mm,
        position_mm=(1.0, -1.5),
    )
    return _lit(scene, range(len(rig.leds)))


def solids(rig: Rig, tilt: Any) -> dict[str, Lit]:
    """Ball and phantom under a rig."""
    return {"ball": ball_of(rig, tilt), "phantom": phantom_of(rig, tilt)}


def finger_of(seed: int, rig: Rig, focus_mm: float = 1.5) -> Lit:
    """The finger, in focus `focus_mm` below its top."""
    lens = {"render.aperture_mm": PUPIL_MM, "render.focus_depth_mm": focus_mm}
    scene = FingerScene(seed, None, replace(twin_settings(None, lens), rig=rig))
    return _lit(scene, range(len(rig.leds)))


def behind_films(twin: Twin) -> Capture:
    """The finger behind films, by a sound rig."""
    changes = {"rig": twin.file, "films.kind": "analyser"}
    return simulate_capture(twin.seed, None, changes)[0]


def _bench() -> BenchSettings:
    return BenchSettings(aperture_mm=PUPIL_MM)


def _calibrated(twin: Twin) -> Rig:
    """The rig's file: places as the nail leaves them, brightness and beams by a card."""
    rng = np.random.default_rng(np.random.SeedSequence([twin.seed, 0xCA1]))
    camera = twin.rig.camera
    assert camera.matrix is not None
    factor = 1.0 + SCALE_SD * rng.standard_normal()
    matrix = camera.matrix * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
    file_camera = replace(camera, matrix=matrix, px_per_mm=camera.px_per_mm * factor)

    def measured(led: Led) -> Led:
        place = np.asarray(led.position_mm) + LED_SD_MM * rng.standard_normal(3)
        return Led(led.band, tuple(map(float, place)))  # type: ignore[arg-type]

    tilt = np.asarray(twin.tilt_deg) + TILT_SD_DEG * rng.standard_normal(2)
    plane = {"tilt_xy_deg": tilt.tolist(), "tilt_deg_deviation": 0.0}
    before = Rig(
        file_camera,
        tuple(map(measured, twin.rig.leds)),
        {"camera": {"residuals": {"plane": plane}}},
    )
    seeds = np.random.SeedSequence([twin.seed, 0xCA2])
    card = replace(twin, file=before)._capture(twin.card, seeds, "opaque")
    return fit_radiometry(card, before, CardPlane(0.0, (float(tilt[0]), float(tilt[1])))).rig


# What can be wrong.


def _each(change: Callable[[FloatArray, FloatArray], FloatArray]) -> Callable[[Twin], Twin]:
    """A defect of the LEDs: `change` of all images, and the dark one, without a word."""
    return lambda twin: twin.lights(lambda lit: Lit(change(lit.leds.copy(), lit.dark), lit.dark))


def _dead(leds: FloatArray, dark: FloatArray) -> FloatArray:
    leds[3] = dark
    return leds


def dimmed(lit: Lit, led: int, left: float) -> Lit:
    """A scene of which one LED has a part of its light left."""
    leds = lit.leds.copy()
    leds[led] = lit.dark + np.float32(left) * (leds[led] - lit.dark)
    return Lit(leds, lit.dark)


def _exchanged(lit: Lit, one: int, other: int) -> Lit:
    leds = lit.leds.copy()
    leds[[one, other]] = leds[[other, one]]
    return Lit(leds, lit.dark)


def _one_along(leds: FloatArray, dark: FloatArray) -> FloatArray:
    leds[:7] = np.roll(leds[:7], 1, axis=0)
    return leds


def _together(leds: FloatArray, dark: FloatArray) -> FloatArray:
    leds[3] = leds[3] + leds[4] - dark
    return leds


def leaking(lit: Lit, fraction: float = 0.03) -> Lit:
    """A scene of which LED 3 glows while it is off."""
    glow = np.float32(fraction) * (lit.leds[3] - lit.dark)
    leds = lit.leds + glow
    leds[3] = lit.leds[3]
    return Lit(leds, lit.dark + glow)


def _open_lid(lit: Lit) -> Lit:
    """A lamp in the room, from the side: a tenth of an LED's light."""
    light = np.float32(0.1) * (lit.leds[0] - lit.dark)
    return Lit(lit.leds + light, lit.dark + light)


def _other_led(twin: Twin, change: Callable[[Led], Led]) -> Twin:
    """With LED 3 changed; the finger is not rendered again, so that card and ball must show it."""
    leds = tuple(change(led) if k == 3 else led for k, led in enumerate(twin.rig.leds))
    rig = replace(twin.rig, leds=leds)
    tilt = twin.tilt_deg
    return replace(twin, rig=rig, card=card_of(rig, tilt), **solids(rig, tilt))


def moved(led: Led, mm: float = 3.0) -> Led:
    """An LED that stands beside its place."""
    x, y, z = led.position_mm or (0.0, 0.0, 0.0)
    return replace(led, position_mm=(x + mm, y, z))


def turned(led: Led, turn: Array, about_mm: Any = (0.0, 0.0, 0.0)) -> Led:
    """An LED that is turned about a place."""
    position_mm: Any = tuple((turn @ (np.subtract(led.position_mm, about_mm)) + about_mm).tolist())
    aim: Any = tuple((turn @ led.axis).tolist())
    return replace(led, position_mm=position_mm, aim=aim)


def tilted(led: Led, deg: float = 10.0) -> Led:
    """An LED that points elsewhere."""
    turn = cv2.Rodrigues(np.array([np.deg2rad(deg), 0.0, 0.0]))[0]
    aim = turn @ led.axis
    return replace(led, aim=(float(aim[0]), float(aim[1]), float(aim[2])))


def _camera_turned(twin: Twin, deg: float = 3.0) -> Twin:
    rows, columns = twin.rig.camera.image_size
    turn = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), deg, 1.0)
    return twin.lights(lambda lit: lit.warped([turn] * len(lit.leds)))


def _camera_tilted(twin: Twin) -> Twin:
    """Seen from the camera, all the rest is turned about it by 2 deg."""
    camera = twin.rig.camera
    turn = np.asarray(cv2.Rodrigues(np.array([np.deg2rad(2.0), 0.0, 0.0]))[0])
    seat = np.array([0.0, 0.0, camera.height_mm])

    rig = replace(twin.rig, leds=tuple(turned(led, turn, seat) for led in twin.rig.leds))
    tilt = (twin.tilt_deg[0] + 2.0, twin.tilt_deg[1])
    return replace(twin, rig=rig, tilt_deg=tilt, card=card_of(rig, tilt), **solids(rig, tilt))


def other_lens(twin: Twin, factor: float = 1.05) -> Twin:
    """The file of a longer lens."""
    camera = twin.file.camera
    assert camera.matrix is not None
    matrix = camera.matrix * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
    camera = replace(camera, matrix=matrix, px_per_mm=factor * camera.px_per_mm)
    return replace(twin, file=replace(twin.file, camera=camera))


def _out_of_focus(twin: Twin) -> Twin:
    """Focused 6 mm too deep."""
    return replace(
        twin,
        finger=finger_of(twin.seed, twin.rig, 7.5),
        phantom=phantom_of(twin.rig, twin.tilt_deg, -6.0),
    )


def _raised(pixels: PixelArray) -> PixelArray:
    return np.clip(pixels.astype(np.int32) + 8, 0, 255).astype(np.uint8)


def _crushed(pixels: PixelArray) -> PixelArray:
    return np.clip(pixels.astype(np.int32) - 8, 0, 255).astype(np.uint8)


def _curved(pixels: PixelArray) -> PixelArray:
    return np.rint(255.0 * (pixels / 255.0) ** 0.9).astype(np.uint8)


def _not_crossed(twin: Twin) -> Twin:
    """The analyser does not turn: the crossed series is a parallel one."""
    assert twin.films is not None
    bands = dict(twin.films.bands)
    white = bands["white"]
    bands["white_crossed"] = replace(white, name="white_crossed", polarisation="crossed")
    return replace(twin, films=replace(twin.films, bands=bands))


def _everywhere(change: Callable[[FloatArray], FloatArray]) -> Callable[[Twin], Twin]:
    """A defect of lens or sensor: `change` of every image, dark or lit."""

    def changed(lit: Lit) -> Lit:
        return Lit(np.stack([change(image) for image in lit.leds]), change(lit.dark))

    return lambda twin: twin.lights(changed)


def _spots(image: NDArray[Any], radius_px: float) -> FloatArray:
    """(H, W, 1) 25 round spots, one in their middles."""
    rows, columns = np.ogrid[: image.shape[0], : image.shape[1]]
    spots = np.zeros(image.shape[:2])
    for row, column in np.random.default_rng(25).random((25, 2)) * image.shape[:2]:
        square = (rows - row) ** 2 + (columns - column) ** 2
        spots = np.maximum(spots, np.exp(-0.5 * square / radius_px**2))
    return spots[..., None].astype(np.float32)


def _specks(image: FloatArray) -> FloatArray:
    """Dust on the sensor: a tenth darker."""
    return np.asarray(image * (1.0 - np.float32(0.1) * _spots(image, 2.0)))


def _stuck(pixels: PixelArray) -> PixelArray:
    """Pixels that are white whatever they see."""
    return np.asarray(np.where(_spots(pixels, 0.5) > 0.6, np.uint8(255), pixels))


def _smear(image: FloatArray) -> FloatArray:
    """Along two pixels, 0.13 mm, at 30 deg: a camera that trembles."""
    kernel = np.zeros((5, 5), dtype=np.float32)
    for part in np.linspace(-1.0, 1.0, 41):
        x, y = 2.0 + part * np.cos(np.pi / 6), 2.0 + part * np.sin(np.pi / 6)
        left, top = int(x), int(y)
        across, down = x - left, y - top
        square = np.outer([1 - down, down], [1 - across, across])
        kernel[top : top + 2, left : left + 2] += square
    filtered = cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(filtered)


def _thumbprint(image: FloatArray) -> FloatArray:
    """On the lens: a fifth of the light is spread over 3 mm."""
    spread = cv2.GaussianBlur(image, (0, 0), 45.0)
    return np.asarray(np.float32(0.8) * image + np.float32(0.2) * spread)


def _shadowed(image: FloatArray) -> FloatArray:
    """Something before the lens shadows a corner."""
    rows, columns = np.ogrid[: image.shape[0], : image.shape[1]]
    away = (np.hypot(rows, columns) / 150.0)[..., None].astype(np.float32)
    return np.asarray(image * np.clip(0.5 + 0.5 * away, 0.5, 1.0))


def _saturating(pixels: PixelArray) -> PixelArray:
    """A sensor that bends from 60 % of full scale on."""
    values = pixels.astype(np.float64)
    return np.rint(np.where(values > 153, 153 + 0.6 * (values - 153), values)).astype(np.uint8)


BEHIND_FILMS = "analyser does not turn"
"""The defect of a rig with films."""
DEFECTS: dict[str, Callable[[Twin], Twin]] = {
    "an LED dead": _each(_dead),
    "an LED 10 % dim": lambda twin: twin.lights(lambda lit: dimmed(lit, 3, 0.9)),
    "two LEDs exchanged": lambda twin: twin.lights(lambda lit: _exchanged(lit, 2, 3)),
    "plugs one place along": _each(_one_along),
    "two LEDs lit together": _each(_together),
    "an LED leaks 3 %": lambda twin: twin.lights(leaking),
    "an LED 3 mm off": lambda twin: _other_led(twin, moved),
    "an LED tilted by 10 deg": lambda twin: _other_led(twin, tilted),
    "lid open": lambda twin: twin.lights(_open_lid),
    "focus 6 mm off": _out_of_focus,
    "camera turned by 3 deg": _camera_turned,
    "camera tilted by 2 deg": _camera_tilted,
    "another lens's file": other_lens,
    "exposure twice too long": lambda twin: replace(twin, exposure=2.0),
    "exposure a quarter": lambda twin: replace(twin, exposure=0.25),
    "black level 3 % high": lambda twin: replace(twin, store=_raised),
    "black level 3 % low": lambda twin: replace(twin, store=_crushed),
    "response to the power 0.9": lambda twin: replace(twin, store=_curved),
    "the finger moves by 0.2 mm": lambda twin: replace(twin, moving_mm=0.2),
    BEHIND_FILMS: _not_crossed,
}
"""Each makes of a sound twin one with a defect."""


NEW: dict[str, tuple[Callable[[Twin], Twin], tuple[str, ...]]] = {
    "an LED 2 mm off": (
        lambda twin: _other_led(twin, lambda led: moved(led, 2.0)),
        ("direction",),
    ),
    "beam of an LED twice as narrow": (
        lambda twin: _other_led(
            twin, lambda led: replace(led, lobe_exponent=2.0 * led.lobe_exponent + 1.0)
        ),
        ("light across",),
    ),
    "camera turned by 1 deg": (lambda twin: _camera_turned(twin, 1.0), ("turn of all",)),
    "25 specks on the sensor": (_everywhere(_specks), ("specks",)),
    "25 stuck pixels": (lambda twin: replace(twin, store=_stuck), ("specks",)),
    "every shot smeared by 0.13 mm": (_everywhere(_smear), ("smear",)),
    "a thumbprint on the lens": (_everywhere(_thumbprint), ("haze", "light across")),
    "a corner shadowed": (_everywhere(_shadowed), ("light across",)),
    "two NIR LEDs exchanged": (
        lambda twin: twin.lights(lambda lit: _exchanged(lit, 9, 12)),
        ("LEDs out",),
    ),
    "an NIR LED 5 % dim": (
        lambda twin: twin.lights(lambda lit: dimmed(lit, 10, 0.95)),
        ("brightness",),
    ),
    "light flickers by 6 %": (lambda twin: replace(twin, flicker=0.06), ("flicker",)),
    "a sensor that saturates early": (lambda twin: replace(twin, store=_saturating), ("linear",)),
}
"""Defects that the test was extended for, and the questions, by their first words, that name
them."""
PAIRS = (
    ("an LED 2 mm off", "camera turned by 1 deg"),
    ("an LED 2 mm off", "an NIR LED 5 % dim"),
    ("beam of an LED twice as narrow", "25 specks on the sensor"),
    ("camera turned by 1 deg", "every shot smeared by 0.13 mm"),
    ("25 specks on the sensor", "light flickers by 6 %"),
    ("every shot smeared by 0.13 mm", "an NIR LED 5 % dim"),
    ("two NIR LEDs exchanged", "an NIR LED 5 % dim"),
    ("light flickers by 6 %", "two NIR LEDs exchanged"),
    ("a corner shadowed", "camera turned by 1 deg"),
    ("a sensor that saturates early", "25 specks on the sensor"),
)
"""Two at once; the first is made first, as what is rendered again forgets what was changed."""


def defective(twin: Twin, name: str) -> Twin:
    """A sound twin with a defect, or with two, their names joined by `` + ``."""
    for part in name.split(" + "):
        twin = (DEFECTS[part] if part in DEFECTS else NEW[part][0])(twin)
    return twin
