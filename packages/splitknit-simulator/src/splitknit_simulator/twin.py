"""A whole capture of the simulator: finger, skin, lights, background and sensor, with the truth;
and as a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Capture, Rig, read_rig
from splitknit.errors import require
from splitknit.io.images import read_image
from splitknit.model import Array, BoolArray, FloatArray, GreyArray
from splitknit.nominal import default_rig
from splitknit.settings import override
from splitknit_simulator.finger.conditions import conditioned_surface
from splitknit_simulator.finger.finger import (
    FingerPose,
    SimulatedFinger,
    draw_finger,
    finger_surface,
)
from splitknit_simulator.finger.master_print import (
    MasterPrint,
    MasterPrintSettings,
    master_of_print,
)
from splitknit_simulator.finger.motion import draw_path, moving_finger
from splitknit_simulator.finger.shape import shape_of_rolled_print
from splitknit_simulator.light.films import FilmSettings, with_crossed_leds
from splitknit_simulator.light.lighting import white_card
from splitknit_simulator.light.skin import BAND_CHANNELS, SkinOptics
from splitknit_simulator.mirror_twin import (
    Drawn,
    photograph_between_mirrors,
    poses_between_mirrors,
    rig_with_mirrors,
)
from splitknit_simulator.rigs import coloured_rig, with_side_lights
from splitknit_simulator.scene import (
    BACKGROUND_MM,
    Scene,
    Shot,
    Taken,
    TwinSettings,
    bands_of,
    exposures_of,
    members_of,
    optics_truth,
    photographs,
    surface_truth,
    take_capture,
)
from splitknit_simulator.surface import SimulatedSurface, Truth, Window


def twin_settings(scale: float | None, changes: Mapping[str, Any] | None) -> TwinSettings:
    """Return the twin's settings with `scale` and single fields replaced."""
    settings = override(TwinSettings(), dict(changes or {}))
    settings = settings if scale is None else replace(settings, scale=scale)
    require(
        0.05 <= settings.scale <= 1.0,
        f"scale must lie between 0.05 and 1, but it is {settings.scale:g}.",
    )
    return settings


def rig_settings(settings: TwinSettings, rig: Path | None, lights: str) -> TwinSettings:
    """The settings with the rig of a file, or with coloured `lights`: ``coloured`` or
    ``coloured9``."""
    if rig is not None:
        settings = replace(settings, rig=read_rig(rig))
    if lights != "white":
        require(
            settings.rig is None,
            "a rig file says which LEDs there are; leave out `lights`, or `rig`.",
        )
        require(
            not settings.mirrors.names,
            "mirrors have white LEDs in the twin; leave out `mirrors` or `lights`.",
        )
        exposures = {"coloured": 2, "coloured9": 3}[lights]
        settings = replace(settings, rig=coloured_rig(settings.scale, settings.rig_seed, exposures))
    return settings


def finger_of_print(path: Path, seed: int, *, rolled: bool) -> SimulatedFinger:
    """The finger that left a print of 500 pixels an inch; the outline of a print that was `rolled`
    gives its size."""
    grey = _grey_print(path)
    finger = replace(draw_finger(seed), pattern="print", printed=master_of_print(grey, seed))
    if not rolled:
        return finger
    return replace(finger, shape=shape_of_rolled_print(_inked(grey), _PRINT_PITCH_MM, finger.shape))


def master_of_print_file(
    path: Path,
    seed: int = 0,
    settings: MasterPrintSettings | None = None,
    *,
    mirrored: bool = False,
) -> MasterPrint:
    """Read a print of 500 pixels an inch (PNG, TIFF, JPEG) and return the master print of the
    finger that left it.

    `mirrored`: of the finger that would leave its mirror image.
    """
    grey = _grey_print(path)
    return master_of_print(grey[:, ::-1] if mirrored else grey, seed, settings=settings)


def _grey_print(path: Path) -> GreyArray:
    pixels = read_image(path)
    grey = pixels if pixels.ndim == 2 else pixels.mean(axis=-1)
    return np.asarray(grey / (np.iinfo(pixels.dtype).max / 255), np.uint8)


def _inked(grey: GreyArray) -> BoolArray:
    """Where a print has ridges or the valleys between them; strokes thinner than 1 mm are left
    out."""
    dark = cv2.threshold(grey, 0, 1, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU)[1]
    ink = cv2.copyMakeBorder(dark, 21, 21, 21, 21, cv2.BORDER_CONSTANT)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (21, 21))
    closed = cv2.morphologyEx(ink, cv2.MORPH_CLOSE, disc)
    return cv2.morphologyEx(closed, cv2.MORPH_OPEN, disc).astype(np.bool_)


_PRINT_PITCH_MM = 25.4 / 500
"""Size of a pixel of a print. Source: definition, 500 pixels an inch."""


def simulate_capture(
    seed: int,
    pattern: str | None = None,
    settings: TwinSettings | Mapping[str, Any] | None = None,
    *,
    impression: int = 0,
    finger: SimulatedFinger | None = None,
) -> tuple[Capture, Truth]:
    """Simulate one capture of one person's finger.

    Parameters
    ----------
    seed : of the person: finger, print and skin follow from it
    pattern : class of the print (``arch``, ``left_loop``, ``whorl``, ...); None draws it
    settings : of the simulator, or a mapping from ``stage.field`` to a value
    impression : number of the capture of this finger: pose, dust and noise change with it
    finger : photographed instead of the one that `seed` draws

    Returns
    -------
    capture : 8-bit (or 16-bit) images of both bands with ambient frames, and the rig
    truth : arrays by name, see ``docs/explain/simulator.md``

    Raises
    ------
    BadInput
        If there is no such `pattern`, or `settings` combine what the twin cannot show together
        (motion and mirrors).

    Notes
    -----
    The same arguments give the same bytes, whatever the number of workers.

    Examples
    --------
    >>> import splitknit_simulator
    >>> capture, truth = splitknit_simulator.simulate_capture(1, "whorl", {"scale": 0.08})
    >>> capture.shape
    (176, 256)
    """
    settings = (
        settings if isinstance(settings, TwinSettings) else override(TwinSettings(), settings or {})
    )
    if settings.motion.amplitude_mm > 0:
        drawn = drawn_finger(seed, pattern, settings, impression, finger)
        capture, truth = _photograph_moving(drawn, settings, [seed, impression])
    elif settings.between_mirrors:
        drawn = drawn_finger(seed, pattern, settings, impression, finger)
        capture, truth = photograph_between_mirrors(drawn, seed, settings)
    else:
        surface, drawn = lay_down(seed, pattern, settings, impression=impression, finger=finger)
        capture, truth = photograph(
            surface, drawn.rig, drawn.skin, drawn.photo_seed, settings=settings
        )
    subject = {"id": "anonymous", "finger": "simulated", "session": impression + 1}
    return replace(capture, subject=subject), truth


def lay_down(
    seed: int,
    pattern: str | None = None,
    settings: TwinSettings | None = None,
    *,
    impression: int = 0,
    finger: SimulatedFinger | None = None,
) -> tuple[SimulatedSurface, Drawn]:
    """Draw a finger, its skin and its pose as :func:`simulate_capture` does, with the same
    arguments."""
    settings = settings or TwinSettings()
    drawn = drawn_finger(seed, pattern, settings, impression, finger)
    finger, pose, skin = drawn.finger, drawn.pose, drawn.skin
    workers, camera = settings.render.workers, drawn.rig.camera
    if settings.condition.active:
        condition_seed = np.random.SeedSequence([seed, impression, 0x54])
        surface = conditioned_surface(
            finger, pose, camera, skin, settings.condition, condition_seed, workers=workers
        )
    else:
        surface = finger_surface(finger, pose, camera, workers=workers)
    return surface, drawn


def drawn_finger(
    seed: int,
    pattern: str | None,
    settings: TwinSettings,
    impression: int,
    finger: SimulatedFinger | None,
) -> Drawn:
    """Finger, pose, rig and skin of :func:`simulate_capture` with the same arguments."""
    require(seed >= 0 and impression >= 0, "seed and impression must not be negative.")
    between = settings.between_mirrors
    default = settings.rig or default_rig(settings.scale, settings.rig_seed)
    rig = rig_with_mirrors(settings) if between else with_side_lights(default, settings.side_lights)
    if settings.films.kind == "leds":
        rig = with_crossed_leds(rig)
    finger = finger or draw_finger(seed, pattern)
    person = np.random.default_rng([seed, 0x51])
    pose_seed, photo_seed = np.random.SeedSequence([seed, impression, 0x52]).spawn(2)
    skin = settings.skin if isinstance(settings.skin, SkinOptics) else settings.skin.draw(person)
    pose = settings.pose
    if not isinstance(pose, FingerPose):
        ranges = poses_between_mirrors(pose, settings, rig.camera) if between else pose
        pose = ranges.draw(np.random.default_rng(pose_seed), rig.camera)
    return Drawn(finger, pose, rig, skin, photo_seed)


def photograph(
    surface: SimulatedSurface,
    rig: Rig,
    skin: SkinOptics,
    seed: np.random.SeedSequence,
    *,
    settings: TwinSettings,
) -> tuple[Capture, Truth]:
    """Photograph `surface`, on the pixels of `rig.camera`, under every LED of `rig`; `seed`: of
    background and noise.

    Of `settings` only `render`, `background`, `sensor`, `sensor_scale` and `films` are used here.
    The truth's arrays by name: see ``docs/explain/simulator.md``. Raises BadInput if the surface
    does not fit the camera or is not in the picture.
    """
    require(
        surface.mask.shape == rig.camera.image_size,
        f"the surface has {surface.mask.shape} pixels, but the rig's camera has"
        f" {rig.camera.image_size}.",
    )
    background_seed, noise_seed = seed.spawn(2)
    scene = Scene((surface, rig, skin), settings, np.random.default_rng(background_seed))
    truth = surface_truth(surface)
    return take_capture(scene, scene.photograph, noise_seed, truth), truth


# A moving finger: every shot shows a surface of its own.


def _photograph_moving(
    drawn: Drawn, settings: TwinSettings, seed: list[int]
) -> tuple[Capture, Truth]:
    """Photograph a drawn finger that moves from shot to shot, the white band first; `seed`: of
    person and impression.

    Its pose is that of the reference shot, the middle one of the first band. The truth is that of
    this shot, ``motion_reference``; ``motion_*`` describe the motion, and ``glare_*`` lie where
    each shot shows the finger. A band's ambient frame goes with its first shot; coloured LEDs of
    one exposure with one place.
    """
    rig = drawn.rig
    members = {name: members_of(name, rig, settings) for name in bands_of(rig, settings)}
    groups = {
        name: exposures_of([rig.leds[k] for k in numbers]) for name, numbers in members.items()
    }
    # band and LEDs of every shot, in the order in which they are taken: the white band first
    shots = [
        (name, tuple(members[name][k] for k in group))
        for name, exposed in groups.items()
        for group in exposed
    ]
    path_seed, slip_seed = np.random.SeedSequence([*seed, 0x53]).spawn(2)
    reference = sum(name == shots[0][0] for name, _ in shots) // 2
    path = draw_path(np.random.default_rng(path_seed), len(shots), settings.motion, reference)
    moving = moving_finger(drawn.finger, drawn.pose, rig.camera, path, slip_seed)
    background_seed, noise_seed = drawn.photo_seed.spawn(2)
    lit: dict[str, list[Shot]] = {}
    truth: Truth = {}
    # tremor blurs a shot during its exposure of 0.02 s
    exposed_px = 0.02 * rig.camera.px_per_mm
    for number, ((name, leds), surface) in enumerate(
        zip(shots, moving.surfaces(settings.render.workers), strict=True)
    ):
        # the same dust in every shot
        scene = Scene((surface, rig, drawn.skin), settings, np.random.default_rng(background_seed))
        if number == moving.path.reference:
            truth = surface_truth(surface) | moving.truth(surface)
        smear = _smear_kernel(moving.path.speed_mm_per_s[number] * exposed_px * [1.0, -1.0])
        light = scene.behind_films(name, scene.render(name, [rig.leds[k] for k in leds]), leds)
        lit.setdefault(name, []).append(Shot(scene, light, leds, range(len(leds)), smear))

    def photograph_band(name: str, seed: np.random.SeedSequence) -> Taken:
        bright = max(
            shot.scene.brightest(shot.light, [shot.group], shot.leds)
            for shot in lit[name.removesuffix("_crossed")]
        )
        exposure = np.float32(settings.sensor.exposure / bright)
        return photographs(name, lit[name], exposure, seed)

    scene = next(iter(lit.values()))[0].scene
    return take_capture(scene, photograph_band, noise_seed, truth), truth


def _smear_kernel(length_px: Array) -> FloatArray:
    """(n, n) kernel of a straight path of `length_px` (columns, rows), its middle in the middle."""
    reach = int(np.ceil(np.abs(length_px).max() / 2)) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    for fraction in np.linspace(-0.5, 0.5, 65):
        column, row = reach + fraction * length_px
        left, top = int(np.floor(column)), int(np.floor(row))
        across, down = column - left, row - top
        kernel[top : top + 2, left : left + 2] += np.outer([1 - down, down], [1 - across, across])
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)


# A finger that stays: any of its LEDs lit, in any order, as often as one likes.

HalfArray = NDArray[np.float16]


class FingerScene:
    """One finger, laid down once, under any LEDs of a rig.

    It is that of :func:`splitknit_simulator.twin.simulate_capture` with the same arguments. Each
    band's light is rendered once, when one of its LEDs is lit first, and kept. The ambient light is
    the same whichever LED is lit.
    """

    def __init__(
        self,
        seed: int,
        pattern: str | None,
        settings: TwinSettings,
        *,
        impression: int = 0,
    ) -> None:
        """Lay a finger down, drawn as by :func:`simulate_capture`; `sensor` and `films` are not
        used here."""
        settings = replace(settings, films=FilmSettings())
        self.surface, drawn = lay_down(seed, pattern, settings, impression=impression)
        self.settings, self.rig, self.skin = settings, drawn.rig, drawn.skin
        self.camera, self.leds = drawn.rig.camera, drawn.rig.leds
        rng = np.random.default_rng(drawn.photo_seed.spawn(1)[0])
        self._scene = Scene((self.surface, self.rig, self.skin), settings, rng)
        self._bands: dict[str, tuple[Window, HalfArray]] = {}
        """Window, and planes (L, C, h, w) of diffuse light and glare, C = 3 (white) or 1 (NIR);
        half floats, whose steps are a tenth of the noise."""
        self._room: FloatArray | None = None

    def light(self, lit: Sequence[int]) -> FloatArray:
        """Noise-free light (H, W, 3) with the LEDs `lit` on; none = the ambient light alone;
        BadInput if there is no such LED.

        White-balanced linear radiance in the rig's units: a white Lambertian card that faces an LED
        of intensity one at 100 mm gives 1 / pi.
        """
        for index in lit:
            require(
                0 <= index < len(self.leds),
                f"there is no LED {index} in the rig of {len(self.leds)}.",
            )
        if self._room is None:
            self._room = self._scene.ambient("white", self.leds)
        frame, scene = self._room.copy(), self._scene
        for index in lit:
            window, all_planes = self._rendered(self.leds[index].band)
            members = [k for k, led in enumerate(self.leds) if led.band == self.leds[index].band]
            card = white_card(self.camera, self.leds[index], -BACKGROUND_MM)
            frame += scene.background(card, self.leds[index].band) * scene.shade[..., None]
            frame[window] += np.moveaxis(
                all_planes[members.index(index)] * scene.shade[window[0]], 0, -1
            )
        return scene.through_lens(frame)

    def truth(self) -> Truth:
        """Arrays by name: heights, normals, mask, landmarks and optics, see
        ``docs/explain/simulator.md``."""
        intensities = {"led_intensity": np.array([led.intensity for led in self.leds])}
        return surface_truth(self.surface) | optics_truth(self.skin) | intensities

    def _rendered(self, name: str) -> tuple[Window, HalfArray]:
        if name not in self._bands:
            require(name in BAND_CHANNELS, f"the twin's LEDs are white or nir, not '{name}'.")
            light = self._scene.render(name, [led for led in self.leds if led.band == name])
            self._bands[name] = (
                light.window,
                (light.diffuse + light.glare[:, None]).astype(np.float16),
            )
        return self._bands[name]
