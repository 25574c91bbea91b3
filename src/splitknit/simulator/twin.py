"""A whole capture of the digital twin: finger, skin, lights, background and sensor, with the truth."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Capture, Rig
from splitknit.simulator.background import BackgroundSettings
from splitknit.simulator.conditions import Condition, conditioned_surface
from splitknit.simulator.diffusion import WalkTable, load_walks
from splitknit.simulator.finger import Finger, Pose, draw_finger, finger_surface
from splitknit.simulator.mirror_settings import MirrorViews
from splitknit.simulator.mirror_twin import has_mirrors, mirror_pose, photograph_between_mirrors, rig_with_mirrors
from splitknit.simulator.motion import HandMotion
from splitknit.simulator.moving import MovingFinger, moving_finger
from splitknit.simulator.moving_scene import photograph_moving, reference_of, shots_of
from splitknit.simulator.pose_ranges import PoseRanges
from splitknit.simulator.renderer import RenderSettings
from splitknit.simulator.rig import default_rig
from splitknit.simulator.sensor import SensorSettings
from splitknit.simulator.skin import BAND_CHANNELS, SkinRanges, SkinSettings
from splitknit.simulator.surface import Surface
from splitknit.simulator.truth import optics_truth, surface_truth
from splitknit.simulator.twin_scene import Scene


@dataclass(frozen=True, slots=True)
class TwinSettings:
    """One simulated capture."""

    scale: float = 0.5
    """Size of the images relative to the full frame of 2200 x 3200 pixels; not used where `rig` is given."""
    rig_seed: int | None = 0
    """Seed of the LEDs' individual intensities; None makes them equal."""
    intensity_spread: float = 0.1
    """Standard deviation of the LEDs' intensities."""
    skin: SkinSettings | SkinRanges = field(default_factory=SkinRanges)
    """The skin itself, or the ranges from which each finger's is drawn."""
    pose: Pose | PoseRanges = field(default_factory=PoseRanges)
    """The pose itself, or the ranges from which each impression's is drawn."""
    render: RenderSettings = field(default_factory=RenderSettings)
    background: BackgroundSettings = field(default_factory=BackgroundSettings)
    sensor: SensorSettings = field(default_factory=SensorSettings)
    rig: Rig | None = None
    """Camera and LEDs as they are: any camera model, size, height, aims and lobes. None: the thesis's rig, made from
    `scale`, `rig_seed` and `intensity_spread`."""
    sensor_scale: float | None = None
    """Side of the sensor's pixels over side of a picture's pixels, for the noise: 1 = full resolution, 0.5 = 2 x 2
    binned. None: as :func:`splitknit.simulator.sensor.binning_scale` tells it of the camera."""
    motion: HandMotion = field(default_factory=HandMotion)
    """How the finger moves between the shots; it lies still unless `motion.amplitude_mm` is above zero."""
    mirrors: MirrorViews = field(default_factory=MirrorViews)
    """Mirrors beside the finger: none unless they are named, or a given `rig` has them."""
    condition: Condition = field(default_factory=Condition)
    """State of the finger's skin: clean unless `condition.kind` says wet, dry, dusty, scarred or glossy."""

    def __post_init__(self) -> None:
        require(
            not self.condition.active or (self.motion.amplitude_mm == 0 and not has_mirrors(self)),
            "a finger in some condition lies still and without mirrors in the twin; leave out motion and mirrors, or "
            "condition.",
        )
        require(
            self.motion.amplitude_mm == 0 or not has_mirrors(self),
            "a moving finger has no mirrors beside it in the twin; leave out motion or mirrors.",
        )
        require(
            self.sensor_scale is None or 0.0 < self.sensor_scale <= 1.0,
            f"twin.sensor_scale must lie in (0, 1] or be None, but it is {self.sensor_scale}.",
        )


def simulate_capture(
    seed: int,
    pattern: str | None = None,
    settings: TwinSettings | None = None,
    *,
    impression: int = 0,
    finger: Finger | None = None,
) -> tuple[Capture, dict[str, NDArray[Any]]]:
    """Simulate one capture of one person's finger.

    Parameters
    ----------
    seed : of the person: finger, print and skin follow from it
    pattern : class of the print (``arch``, ``left_loop``, ``whorl``, ...); None draws it
    settings : of the twin
    impression : number of the capture of this finger: pose, dust and noise change with it
    finger : photographed instead of the one that `seed` draws

    Returns
    -------
    capture : 8-bit (or 16-bit) images of both bands with ambient frames, and the rig
    truth : arrays by name, see ``docs/twin.md``

    Raises
    ------
    BadInput
        If there is no such `pattern`, or `settings` ask for what the twin cannot show together (motion and mirrors).

    Notes
    -----
    The same arguments give the same bytes, whatever the number of workers.
    """
    settings = settings or TwinSettings()
    subject = {"id": "anonymous", "finger": "simulated", "session": impression + 1}
    if settings.motion.amplitude_mm > 0:
        require(
            not has_mirrors(settings), "a finger between mirrors lies still in the twin; leave out motion or mirrors."
        )
        moving, rig, skin, photo_seed = _set_in_motion(seed, pattern, settings, impression, finger)
        capture, truth = photograph_moving(moving, rig, skin, photo_seed, settings)
        return replace(capture, subject=subject), truth
    if has_mirrors(settings):
        finger, pose, rig, skin, photo_seed = _drawn(seed, pattern, settings, impression, finger)
        capture, truth = photograph_between_mirrors(
            finger, pose, rig, skin, seeds=(photo_seed, seed), settings=settings
        )
        return replace(capture, subject=subject), truth
    laid = lay_down(seed, pattern, settings, impression=impression, finger=finger)
    capture, truth = photograph(laid.surface, laid.rig, laid.skin, laid.photo_seed, settings=settings)
    return replace(capture, subject=subject), truth


@dataclass(frozen=True, slots=True, eq=False)
class LaidDown:
    """A finger under a rig."""

    surface: Surface
    rig: Rig
    skin: SkinSettings
    photo_seed: np.random.SeedSequence
    """Of background and noise."""


def lay_down(
    seed: int,
    pattern: str | None = None,
    settings: TwinSettings | None = None,
    *,
    impression: int = 0,
    finger: Finger | None = None,
) -> LaidDown:
    """Draw a finger, its skin and its pose as :func:`simulate_capture` does, with the same arguments."""
    settings = settings or TwinSettings()
    finger, pose, rig, skin, photo_seed = _drawn(seed, pattern, settings, impression, finger)
    workers, camera = settings.render.workers, rig.camera
    if settings.condition.active:
        condition_seed = np.random.SeedSequence([seed, impression, 0x54])
        surface = conditioned_surface(finger, pose, camera, skin, settings.condition, condition_seed, workers=workers)
    else:
        surface = finger_surface(finger, pose, camera, workers=workers)
    return LaidDown(surface, rig, skin, photo_seed)


def _drawn(
    seed: int, pattern: str | None, settings: TwinSettings, impression: int, finger: Finger | None
) -> tuple[Finger, Pose, Rig, SkinSettings, np.random.SeedSequence]:
    """Draw what a seed stands for: finger, pose, rig, skin, and the seed of background and noise."""
    require(seed >= 0 and impression >= 0, "seed and impression must not be negative.")
    between = has_mirrors(settings)
    if between:
        rig = rig_with_mirrors(settings)
    else:
        rig = settings.rig or default_rig(settings.scale, settings.rig_seed, settings.intensity_spread)
    finger = finger or draw_finger(seed, pattern)
    person = np.random.default_rng(np.random.SeedSequence([seed, 0x51]))
    pose_seed, photo_seed = np.random.SeedSequence([seed, impression, 0x52]).spawn(2)
    skin = settings.skin if isinstance(settings.skin, SkinSettings) else settings.skin.draw(person)
    pose_rng = np.random.default_rng(pose_seed)
    if isinstance(settings.pose, Pose):
        pose = settings.pose
    else:
        pose = mirror_pose(settings, rig.camera, pose_rng) if between else settings.pose.draw(pose_rng, rig.camera)
    return finger, pose, rig, skin, photo_seed


def _set_in_motion(
    seed: int, pattern: str | None, settings: TwinSettings, impression: int, finger: Finger | None
) -> tuple[MovingFinger, Rig, SkinSettings, np.random.SeedSequence]:
    """Draw the same finger in the same pose as :func:`lay_down` does, and its motion from there."""
    finger, pose, rig, skin, photo_seed = _drawn(seed, pattern, settings, impression, finger)
    motion_seed = np.random.SeedSequence([seed, impression, 0x53])
    shots, workers = len(shots_of(rig)), settings.render.workers
    moving = moving_finger(
        finger, pose, rig.camera, motion_seed, settings.motion, shots, workers, reference_of(rig)
    )  # fmt: skip
    return moving, rig, skin, photo_seed


def photograph(
    surface: Surface,
    rig: Rig,
    skin: SkinSettings,
    seed: np.random.SeedSequence,
    *,
    settings: TwinSettings | None = None,
    walks: WalkTable | None = None,
) -> tuple[Capture, dict[str, NDArray[Any]]]:
    """Photograph `surface` under every LED of `rig`.

    Parameters
    ----------
    surface : on the pixels of `rig.camera`
    rig : LEDs of the bands ``white`` and ``nir``; each lights one image
    skin : optics of the finger
    seed : of background and noise
    settings : only `render`, `background`, `sensor` and `sensor_scale` are used here
    walks : table of random walks; None loads the shipped one

    Returns
    -------
    capture : as a camera would store it
    truth : arrays by name, see ``docs/twin.md``

    Raises
    ------
    BadInput
        If the surface does not fit the camera or no part of it is in the picture.
    """
    settings = settings or TwinSettings()
    require(
        surface.mask.shape == rig.camera.image_size,
        f"the surface has {surface.mask.shape} pixels, but the rig's camera has {rig.camera.image_size}.",
    )
    walks = walks or load_walks()
    background_seed, noise_seed = seed.spawn(2)
    scene = Scene((surface, rig, skin), settings, np.random.default_rng(background_seed), walks)
    truth = surface_truth(surface)
    bands = {}
    names = [name for name in BAND_CHANNELS if any(led.band == name for led in rig.leds)]
    for name, band_seed in zip(names, noise_seed.spawn(len(names)), strict=True):
        bands[name], truth[f"glare_{name}"], truth[f"exposure_{name}"] = scene.photograph(name, band_seed)
    truth |= optics_truth(skin)
    truth["led_intensity"] = np.array([led.intensity for led in rig.leds])
    capture = Capture(
        rig=rig,
        bands=bands,
        encoding=settings.sensor.encoding,
        material="skin",
        subject={"id": "anonymous"},
    )
    return capture, truth
