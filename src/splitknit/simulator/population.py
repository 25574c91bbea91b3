"""A population: people, their ten fingers, and captures of them in several sessions, with the truth.

Every capture follows from the settings and its own place (person, finger, session) alone: it is the same whatever else
is simulated, in whatever order and by however many workers.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Capture, Rig
from splitknit.simulator.background import BackgroundSettings
from splitknit.simulator.deformation import deformed, draw_deformation
from splitknit.simulator.finger import Finger, finger_surface
from splitknit.simulator.master_print import MasterPrint
from splitknit.simulator.people import FINGERS, OwnFinger, Person, draw_person
from splitknit.simulator.people_ranges import PeopleRanges
from splitknit.simulator.renderer import RenderSettings
from splitknit.simulator.rig import default_rig
from splitknit.simulator.sensor import SensorSettings
from splitknit.simulator.sessions import Impression, SessionRanges, draw_impression
from splitknit.simulator.skin import SkinSettings
from splitknit.simulator.twin import TwinSettings, photograph

DRAWS = 1
"""Version of the draws: it rises when the same settings give other captures."""
LARGE = ("normals", "glare_white", "glare_nir")
"""Arrays of the truth that only ``truth = "full"`` keeps."""


@dataclass(frozen=True, slots=True)
class PopulationSettings:
    """A whole population; how many people, fingers and sessions of it are simulated is not part of it."""

    seed: int = 0
    """What all people, fingers and captures are drawn from: the same number gives the same bytes. 0 or more."""
    scale: float = 0.5
    """Size of the images relative to the full frame of 2200 x 3200 pixels."""
    rig_seed: int | None = 0
    """Seed of the LEDs' individual intensities; None makes them equal."""
    people: PeopleRanges = field(default_factory=PeopleRanges)
    sessions: SessionRanges = field(default_factory=SessionRanges)
    render: RenderSettings = field(default_factory=lambda: RenderSettings(workers=1))
    truth: Literal["surface", "full"] = "surface"
    """``surface``: heights, shape, relief, mask, landmarks; ``full``: normals and glare, too (five times as large)."""

    def __post_init__(self) -> None:
        require(0.05 <= self.scale <= 1.0, f"population.scale must lie in [0.05, 1], but it is {self.scale}.")
        require(self.seed >= 0, f"population.seed must not be negative, but it is {self.seed}.")
        require(self.truth in ("surface", "full"), f"population.truth must be surface or full, not '{self.truth}'.")

    def rig(self) -> Rig:
        """The rig as it was calibrated."""
        return default_rig(self.scale, self.rig_seed)

    def person(self, number: int) -> Person:
        """Draw the person `number`, from 1."""
        return draw_person(self.seed, number, self.people)


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """One capture of the population."""

    capture: Capture
    truth: dict[str, NDArray[Any]]
    facts: dict[str, Any]
    """Who, which finger and session, how it lay, how its skin was: plain numbers and words."""


def population_capture(
    settings: PopulationSettings,
    person: Person,
    finger: str,
    session: int,
    *,
    master: MasterPrint | None = None,
) -> Shown:
    """Simulate one capture.

    Parameters
    ----------
    settings : of the population
    person : as :meth:`PopulationSettings.person` draws them
    finger : ``right_thumb`` ... ``left_little``
    session : from 1
    master : of this finger where it was drawn already, else it is drawn

    Raises
    ------
    BadInput
        If there is no such finger or session.
    """
    require(finger in person.fingers, f"'{finger}' is no finger; fingers are {', '.join(FINGERS)}.")
    own = person.fingers[finger]
    rig = settings.rig()
    impression = draw_impression(
        own, settings.sessions, rig.camera, seed=settings.seed, number=person.number, session=session
    )
    place = [settings.seed, 0x5E53, person.number, FINGERS.index(finger), session]
    skin_seed, drift_seed, photo_seed = np.random.SeedSequence(place).spawn(3)
    master = master or own.finger.master()
    deformation = draw_deformation(
        np.random.default_rng(skin_seed),
        master,
        impression.deformation_mm,
        settings.sessions.deformation_smooth_mm,
        impression.swelling,
    )
    today = finger_of_today(own.finger, impression)
    surface = finger_surface(
        today, impression.pose(), rig.camera, master=deformed(master, deformation), workers=settings.render.workers
    )
    lit = drifted(rig, np.random.default_rng(drift_seed), settings.sessions.led_drift_sd)
    capture, truth = photograph(
        surface, lit, skin_of_today(own, impression), photo_seed, settings=_twin_settings(settings, impression)
    )
    subject = {"id": f"S{person.number:02d}", "finger": finger, "session": session}
    facts = {"subject": subject["id"], "finger": finger, "session": session}
    facts |= _facts(person, own, today, master, impression)
    if settings.truth == "surface":
        truth = {name: value for name, value in truth.items() if name not in LARGE}
    truth["master_minutiae_mm"] = master.minutiae
    truth["deformation_shift_mm"] = deformation.shift_mm
    truth["deformation_u_mm"], truth["deformation_v_mm"] = deformation.u_mm, deformation.v_mm
    truth |= {f"impression_{name}": np.asarray(value) for name, value in facts.items()}
    return Shown(replace(capture, rig=rig, subject=subject), truth, facts)


def finger_of_today(finger: Finger, impression: Impression) -> Finger:
    """The finger, swollen and pressed as in this impression, its ridges as deep as its moisture makes them."""
    shape, skin = finger.shape, finger.skin
    return replace(
        finger,
        shape=replace(
            shape,
            width_mm=shape.width_mm * (1.0 + impression.swelling + impression.flattening),
            thickness_mm=shape.thickness_mm * (1.0 + impression.swelling - impression.flattening),
        ),
        skin=replace(
            skin,
            ridge_depth_um=skin.ridge_depth_um * impression.ridge_contrast,
            pore_depth_um=skin.pore_depth_um * impression.ridge_contrast,
        ),
    )


def skin_of_today(own: OwnFinger, impression: Impression) -> SkinSettings:
    """The optics of the finger's skin, as moist and as full of blood as in this impression."""
    return replace(
        own.optics,
        blood=float(np.clip(own.optics.blood * impression.blood_factor, 0.002, 0.02)),
        oxygenation=impression.oxygenation,
        glare=impression.glare,
        roughness=impression.roughness,
    )


def drifted(rig: Rig, rng: np.random.Generator, spread: float) -> Rig:
    """The rig as it is: LEDs a little brighter or darker than when they were calibrated."""
    changes = 1.0 + spread * np.clip(rng.standard_normal(len(rig.leds)), -2.5, 2.5)
    leds = tuple(
        replace(led, intensity=float(led.intensity * change)) for led, change in zip(rig.leds, changes, strict=True)
    )
    return replace(rig, leds=leds)


def _twin_settings(settings: PopulationSettings, impression: Impression) -> TwinSettings:
    return TwinSettings(
        render=settings.render,
        background=BackgroundSettings(
            ambient=impression.ambient, hand_shadow=impression.hand_shadow, dust_per_cm2=impression.dust_per_cm2
        ),
        sensor=SensorSettings(
            exposure=impression.exposure, full_well_e=impression.full_well_e, read_noise_e=impression.read_noise_e
        ),
    )


def _facts(
    person: Person, own: OwnFinger, today: Finger, master: MasterPrint, impression: Impression
) -> dict[str, Any]:
    return {
        "sex": person.sex,
        "pattern": own.finger.pattern,
        "print_seed": own.finger.seed,
        "width_mm": today.shape.width_mm,
        "length_mm": today.shape.length_mm,
        "thickness_mm": today.shape.thickness_mm,
        "period_mm": master.period_mm,
        "ridge_depth_um": today.skin.ridge_depth_um,
        "minutiae": len(master.minutiae),
    } | asdict(impression)
