"""The twin as the devices of ``splitknit capture``, a finger or calibration target; registered as
``twin``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from splitknit import Rig
from splitknit.devices import Opened
from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.model import FloatArray
from splitknit.nominal import default_rig
from splitknit_simulator.bench_photos import BOARD
from splitknit_simulator.calibration_set.bench import BenchSettings
from splitknit_simulator.calibration_set.flat import BoardScene, CardScene, board_poses
from splitknit_simulator.calibration_set.solids import NailScene, ReliefScene, SphereScene
from splitknit_simulator.camera.device import Clock, LitScene, TwinCamera, TwinLightBank
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import FingerScene, twin_settings

TARGETS = ("card", "nail", "board", "sphere", "ball", "phantom")


@dataclass(frozen=True, slots=True)
class Twin:
    """The twin, set up: every finger is photographed with devices of its own."""

    settings: TwinSettings

    @classmethod
    def made(cls, changes: Mapping[str, Any], rig: Rig | None, scale: float | None) -> Twin:
        """Change settings of finger, skin, light and sensor; BadInput if unknown, or the rig is
        another camera's."""
        settings = twin_settings(scale, changes)
        if rig is not None:
            require(
                "films" not in rig.provenance,
                "the rig file has polarising films, which the twin's camera and LEDs have not;"
                " capture with `device` pi, or take provenance.films out of the file.",
            )
            size = (default_rig(scale) if scale is not None else rig).camera.image_size
            require(
                size == rig.camera.image_size,
                f"the rig file is for another camera: its images have {rig.camera.image_size[0]} x"
                f" {rig.camera.image_size[1]} pixels (rows x columns), those of `scale` {scale}"
                f" have {size[0]} x {size[1]}; leave `scale` out.",
            )
            settings = replace(settings, rig=rig)
        return cls(settings)

    @contextmanager
    def opened(
        self,
        seed: int,
        impression: int = 0,
        *,
        pattern: str | None = None,
        target: str | None = None,
        relief: tuple[FloatArray, float] | None = None,
    ) -> Iterator[Opened]:
        """Open the devices around a simulated finger, or around a target; `relief`: heights of the
        target ``phantom`` and their pitch, mm."""
        truth: Mapping[str, Any] | None = None
        findings: tuple[Finding, ...] = ()
        twin, clock = self.settings, Clock()
        scene: LitScene
        if target is None:
            scene = FingerScene(seed, pattern, twin, impression=impression)
            truth, rig = scene.truth(), scene.rig
        else:
            rig = twin.rig or default_rig(twin.scale, twin.rig_seed)
            bench = BenchSettings(aperture_mm=twin.render.aperture_mm)
            under = {"camera": rig.camera, "leds": rig.leds, "bench": bench}
            scene, words = _target_scene(target, under, seed, relief)
            findings = (Finding("simulated-target", f"{words}."),)
        noise = int(
            np.random.SeedSequence([seed, impression, 0xCA]).generate_state(1, np.uint32)[0]
        )
        sensor: dict[str, Any] = {
            "sensor": twin.sensor,
            "sensor_scale": twin.sensor_scale,
            "seed": noise,
        }
        with (
            TwinLightBank(scene, clock) as lights,
            TwinCamera(scene, lights, clock, **sensor) as camera,
        ):
            yield Opened(
                "twin", camera, lights, rig, {"twin": twin}, truth=truth, findings=findings
            )


def _target_scene(
    name: str, under: Mapping[str, Any], seed: int, relief: tuple[FloatArray, float] | None
) -> tuple[LitScene, str]:
    """Return a target under the rig, and what it is; the seed draws its place where it has one."""
    if name == "nail":
        x, y = np.random.default_rng([seed, 0x7A]).uniform(-8.0, 8.0, 2).round(2).tolist()
        return (
            NailScene(**under, position_mm=(x, y)),
            f"a nail of 13 mm stood at x {x}, y {y} mm",
        )
    if name == "board":
        pose = board_poses(seed, 1, under["camera"], BOARD)[0]
        scene = BoardScene(**under, board=BOARD, **pose)
        size = f"{BOARD.columns}x{BOARD.rows}"
        return scene, f"a checkerboard of {size} inner corners (board {size}) was held"
    makers: dict[str, Any] = {
        "card": CardScene,
        "sphere": SphereScene,
        "ball": partial(SphereScene, chrome=False),
    }
    if relief is not None:
        makers["phantom"] = partial(ReliefScene, height_mm=relief[0], pitch_mm=relief[1])
    require(name in makers, f"the twin has no target '{name}'; it has {', '.join(TARGETS)}.")
    return makers[name](**under), f"{name}, without a finger"
