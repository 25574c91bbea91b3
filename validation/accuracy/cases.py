"""Which fingers are photographed: a drawn population, and single things varied while all others stay."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.model import Capture, default_rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.light.skin import SkinOptics
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.surface import SimulatedSurface
from splitknit_simulator.twin import photograph, simulate_capture

Truth = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Case:
    """One capture of one finger."""

    seed: int
    impression: int = 0
    vary: str = ""
    """Empty: everything is drawn from the twin's own ranges. Else what is varied from :data:`BASE`."""
    value: float = 0.0
    scale: float = 0.5

    @property
    def name(self) -> str:
        """Unique, fit for a file."""
        what = f"{self.vary}_{self.value:g}" if self.vary else f"population_{self.impression}"
        return f"{what}_{self.seed:05d}"


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything of a capture that can be varied."""

    ridge_depth_um: float = 65.0
    pose: FingerPose = field(default_factory=lambda: FingerPose(insertion_mm=27.0))
    skin: SkinOptics = field(default_factory=SkinOptics)
    render: RenderSettings = field(default_factory=RenderSettings)


BASE = Scene()


@dataclass(frozen=True, slots=True)
class Variation:
    """One thing that is varied."""

    words: str
    unit: str
    values: tuple[float, ...]
    base: float
    change: Callable[[Scene, float], Scene]


def _skin(name: str) -> Callable[[Scene, float], Scene]:
    return lambda scene, value: replace(scene, skin=replace(scene.skin, **{name: value}))


def _pose(name: str) -> Callable[[Scene, float], Scene]:
    return lambda scene, value: replace(scene, pose=replace(scene.pose, **{name: float(np.deg2rad(value))}))


VARIATIONS: dict[str, Variation] = {
    "scattering": Variation(
        "Reduced scattering over Jacques's", "", (0.5, 0.7, 1.0, 1.4, 2.0), 1.0, _skin("scattering_factor")
    ),
    "glare": Variation("Weight of the glare (1 = bare skin)", "", (0.0, 0.5, 1.0, 1.5), 1.0, _skin("glare")),
    "roughness": Variation("Roughness of the skin (GGX alpha)", "", (0.15, 0.25, 0.35), 0.25, _skin("roughness")),
    "ridge_depth": Variation(
        "Ridge depth", "um", (50.0, 65.0, 75.0, 90.0), 65.0, lambda s, v: replace(s, ridge_depth_um=v)
    ),
    "rim": Variation(
        "Light at the outline (0: what falls beside is lost, 0.75: as random walks, 1: as elsewhere)",
        "",
        (0.0, 0.4, 0.75, 1.0),
        0.75,
        lambda s, v: replace(s, render=replace(s.render, rim_exponent=v)),
    ),
    "relief_gain": Variation(
        "Brightness of ridges over valleys (0.78 measured)", "", (0.55, 0.78, 1.55), 0.78, _skin("relief_gain")
    ),
    "melanin": Variation(
        "Melanin (volume fraction)", "", (0.0002, 0.00056, 0.002, 0.006, 0.02), 0.00056, _skin("melanin")
    ),
    "defocus": Variation(
        "Diameter of the lens's pupil, in focus 1.5 mm below the top",
        "mm",
        (0.0, 1.4, 2.8, 5.5),
        0.0,
        lambda s, v: replace(s, render=replace(s.render, aperture_mm=v)),
    ),
    "roll": Variation("Roll", "deg", (-16.0, -8.0, 0.0, 8.0, 16.0), 0.0, _pose("roll_rad")),
    "pitch": Variation("Pitch (tip up)", "deg", (-6.0, -3.0, 0.0, 3.0, 6.0), 0.0, _pose("pitch_rad")),
    "yaw": Variation("Yaw", "deg", (-18.0, -9.0, 0.0, 9.0, 18.0), 0.0, _pose("yaw_rad")),
}


def varied(name: str, values: Iterable[float] | None, seeds: Iterable[int], scale: float) -> list[Case]:
    """Cases of one variation, by seed (captures of one finger in one pose follow each other).

    The value that :data:`BASE` has anyway is one case, whatever is varied.
    """
    chosen = VARIATIONS[name].values if values is None else tuple(values)
    base = VARIATIONS[name].base
    return [
        Case(seed, 0, "base", 0.0, scale) if value == base else Case(seed, 0, name, value, scale)
        for seed in seeds
        for value in chosen
    ]


def photographed(case: Case) -> tuple[Capture, Truth]:
    """Simulate the capture of a case."""
    if not case.vary:
        return simulate_capture(case.seed, None, TwinSettings(scale=case.scale), impression=case.impression)
    scene = BASE if case.vary == "base" else VARIATIONS[case.vary].change(BASE, case.value)
    surface = _surface(case.seed, scene.ridge_depth_um, scene.pose, case.scale)
    rig = default_rig(case.scale, 0)
    # the same noise for every value of what is varied
    noise = np.random.SeedSequence([case.seed, 0xACC])
    return photograph(surface, rig, scene.skin, noise, settings=TwinSettings(scale=case.scale, render=scene.render))


@lru_cache(maxsize=2)
def _surface(seed: int, ridge_depth_um: float, pose: FingerPose, scale: float) -> SimulatedSurface:
    finger = draw_finger(seed)
    finger = replace(finger, skin=replace(finger.skin, ridge_depth_um=ridge_depth_um))
    return finger_surface(finger, pose, default_rig(scale, 0).camera)
