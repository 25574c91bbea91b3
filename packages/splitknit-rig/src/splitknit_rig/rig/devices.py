"""The devices of a rig: a Raspberry Pi's, or simulated ones around a simulated finger or target."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splitknit import Rig, default_rig, flatten, nominal_rig, override, require
from splitknit_rig.capture.folder import Opened
from splitknit_rig.capture.pi import UNTESTED, PiCameraSettings, open_analyser, open_pi
from splitknit_rig.capture.pins import rig_films
from splitknit_rig.capture.session import SessionSettings
from splitknit_simulator import (
    BOARD,
    BoardScene,
    CardScene,
    Clock,
    DiscScene,
    FingerScene,
    LitScene,
    NailScene,
    SphereScene,
    TwinCamera,
    TwinDeviceSettings,
    TwinLightBank,
    TwinSettings,
    board_poses,
    twin_settings,
)

TARGETS = ("card", "disc", "nail", "board", "sphere")
NOMINAL = "no rig file was given: the LEDs' nominal positions are assumed; calibrate the rig and name its file by `rig`"


@dataclass(frozen=True, slots=True)
class DeviceSettings:
    """Everything that can be set about a capture."""

    capture: SessionSettings
    """Settings of the session."""
    pi: PiCameraSettings
    twin: TwinSettings
    device: TwinDeviceSettings
    """Settings of the twin's devices."""

    def used(self, device: str) -> dict[str, Any]:
        """Those of the device ``pi`` or ``twin``, by name, for ``session.json``."""
        return {"pi": self.pi} if device == "pi" else {"twin": self.twin, "devices": self.device}


def read_settings(device: str, changes: Mapping[str, Any], rig: Rig | None, scale: float | None) -> DeviceSettings:
    """Sort settings: ``capture.*`` to the session, ``pi.*`` to the Pi's camera, ``device.*`` to the twin's devices, the
    rest to its finger, skin, light and sensor. BadInput if one is unknown, or the twin's where the device is not.
    """
    flat = flatten(changes)
    parts: dict[str, dict[str, Any]] = {"capture": {}, "pi": {}, "device": {}, "": {}}
    for name, value in flat.items():
        stage, _, rest = name.partition(".")
        known = stage in parts and bool(rest)
        parts[stage if known else ""][rest if known else name] = value
    if device == "pi":
        strays = [*parts[""], *(f"device.{name}" for name in parts["device"])]
        require(
            not strays and scale is None,
            f"'{strays[0] if strays else 'scale'}' is a setting of the twin; with `device` pi leave it out, or use "
            "names that begin with capture. or pi.",
        )
    twin = twin_settings(scale, parts[""])
    if rig is not None and device == "twin":
        require(
            rig_films(rig) is None,
            "the rig file has polarising films, which the twin's camera and LEDs have not; capture with `device` pi, "
            "or take provenance.films out of the file.",
        )
        if scale is not None:
            size = default_rig(scale).camera.image_size
            require(
                size == rig.camera.image_size,
                f"the rig file is for another camera: its images have {rig.camera.image_size[0]} x "
                f"{rig.camera.image_size[1]} pixels (rows x columns), those of `scale` {scale:g} have {size[0]} x "
                f"{size[1]}; leave `scale` out.",
            )
        twin = replace(twin, rig=rig)
    return DeviceSettings(
        capture=override(SessionSettings(), parts["capture"]),
        pi=override(PiCameraSettings(), parts["pi"]),
        twin=twin,
        device=override(TwinDeviceSettings(), parts["device"]),
    )


@contextmanager
def opened_pi(rig: Rig | None, settings: DeviceSettings) -> Iterator[Opened]:
    """Open the Raspberry Pi's devices; all LEDs are off before and after. BadInput if there is none."""
    with ExitStack() as stack:
        chosen = rig or replace(nominal_rig(), provenance={"source": "as drawn, not calibrated"})
        camera, lights = open_pi(stack, chosen, settings.pi)
        analyser = open_analyser(chosen)
        if analyser is not None:
            stack.enter_context(analyser)
        untested = f"the {settings.pi.camera} camera was {UNTESTED}"
        notes = (untested,) if rig is not None else (NOMINAL, untested)
        yield Opened("pi", camera, lights, chosen, notes=notes, turn=analyser)


@contextmanager
def opened_twin(
    settings: DeviceSettings, seed: int, impression: int = 0, *, pattern: str | None = None, target: str | None = None
) -> Iterator[Opened]:
    """Open the twin's devices around a simulated finger, or around a calibration target."""
    truth: Mapping[str, Any] | None = None
    notes: tuple[str, ...] = ()
    twin, device, clock = settings.twin, settings.device, Clock()
    scene: LitScene
    if target is None:
        scene = FingerScene(seed, pattern, twin, impression=impression)
        truth, rig = scene.truth(), scene.rig
    else:
        rig = twin.rig or default_rig(twin.scale, twin.rig_seed, twin.intensity_spread)
        scene, words = _target_scene(target, rig, seed)
        notes = (words,)
    noise = int(np.random.SeedSequence([seed, impression, 0xCA]).generate_state(1, np.uint32)[0])
    sensor: dict[str, Any] = {"sensor": twin.sensor, "sensor_scale": twin.sensor_scale, "seed": noise}
    with TwinLightBank(scene, clock, device) as lights, TwinCamera(scene, lights, clock, device, **sensor) as camera:
        yield Opened("twin", camera, lights, rig, truth=truth, notes=notes)


def _target_scene(name: str, rig: Rig, seed: int) -> tuple[LitScene, str]:
    """Return a target under the rig, and what it is; the seed draws its place where it has one."""
    camera, leds = rig.camera, rig.leds
    if name == "nail":
        x, y = np.random.default_rng(np.random.SeedSequence([seed, 0x7A])).uniform(-8.0, 8.0, 2).round(2).tolist()
        return NailScene(camera=camera, leds=leds, position_mm=(x, y)), f"a nail of 13 mm stood at x {x}, y {y} mm"
    if name == "board":
        scene = BoardScene(camera=camera, leds=leds, board=BOARD, **board_poses(seed, 1, camera, BOARD)[0])
        size = f"{BOARD.columns}x{BOARD.rows}"
        return scene, f"a checkerboard of {size} inner corners (board {size}) was held"
    makers: dict[str, Any] = {"card": CardScene, "disc": DiscScene, "sphere": SphereScene}
    require(name in makers, f"the twin has no target '{name}'; it has {', '.join(TARGETS)}.")
    return makers[name](camera=camera, leds=leds), f"{name}, without a finger"
