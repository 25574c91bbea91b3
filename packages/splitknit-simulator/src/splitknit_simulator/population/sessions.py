"""A population: people, their ten fingers, and captures of them in several sessions, with the
truth.

Every capture follows from the settings and its own place (person, finger, session) alone: it is the
same whatever else is simulated, in whatever order and by however many workers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
from scipy.special import ndtr

from splitknit import Camera, Capture, Rig
from splitknit.errors import require
from splitknit.nominal import default_rig
from splitknit.settings import Checked, Limits
from splitknit_simulator.camera.lens import picture_on_plane
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.finger.deformation import deformed, draw_deformation
from splitknit_simulator.finger.finger import FingerPose, SimulatedFinger, finger_surface
from splitknit_simulator.finger.master_print import MasterPrint
from splitknit_simulator.light.films import FilmSettings
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.light.skin import SkinOptics
from splitknit_simulator.population.people import (
    FINGERS,
    OwnFinger,
    PeopleRanges,
    Person,
    draw_person,
)
from splitknit_simulator.scene import BackgroundSettings, TwinSettings
from splitknit_simulator.surface import Truth
from splitknit_simulator.twin import photograph

# What changes from one session to the next: how a finger is laid down, its skin, the camera and the
# lights.

Range = tuple[float, float]
_EVEN: Mapping[str, Range] = {
    "x_mm": (-3.0, 3.0),  # where the middle of the finger lies beside the image centre
    "height_mm": (-0.5, 0.5),  # z of the pad's highest point
    # relative gain in breadth, and loss in thickness, of a resting finger
    "flattening": (0.0, 0.02),
    "exposure": (0.5, 0.8),  # fraction of full scale that the brightest skin reaches
    "ambient": (0.0005, 0.004),  # ambient light relative to one LED
    # fraction of the light that the hand takes away at the finger's base
    "hand_shadow": (0.0, 0.15),
    "dust_per_cm2": (0.0, 0.6),  # bright specks on the background, for each square centimetre
}
"""What is drawn evenly between two values."""
_BY_MOISTURE: Mapping[str, Range] = {
    "glare": (0.5, 1.3),  # weight of the surface reflection of dry and of moist skin
    "roughness": (0.35, 0.18),  # GGX alpha of dry and of moist skin
    # depth of ridges and pores relative to the finger's own, dry and moist
    "ridge_contrast": (0.88, 1.08),
}
"""What lies between its value on dry and on moist skin."""


@dataclass(frozen=True, slots=True)
class SessionRanges(Checked):
    """From what impressions are drawn; sources and reasons: ``docs/explain/population.md``."""

    _group = "sessions"

    roll_sd_deg: Annotated[float, Limits(0.0, 12.0)] = 6.0
    """Standard deviation of the finger's turn about its own axis, on top of its habit; no turn is
    beyond twice that. 0 to 12."""
    partial_share: Annotated[float, Limits(0.0, 1.0)] = 0.1
    """Fraction of impressions that show too little of the finger."""


@dataclass(frozen=True, slots=True)
class _Impression:
    """One finger in one session."""

    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    x_mm: float
    insertion_mm: float
    height_mm: float
    partial: bool  # whether it was laid down too short
    swelling: float
    flattening: float
    deformation_mm: float
    moisture: float
    glare: float
    roughness: float
    ridge_contrast: float
    blood_factor: float
    oxygenation: float
    exposure: float
    full_well_e: float
    read_noise_e: float
    ambient: float
    hand_shadow: float
    dust_per_cm2: float

    def pose(self) -> FingerPose:
        """How the finger lies."""
        yaw, pitch, roll = (
            float(np.deg2rad(angle)) for angle in (self.yaw_deg, self.pitch_deg, self.roll_deg)
        )
        return FingerPose(yaw, pitch, roll, self.x_mm, self.insertion_mm, self.height_mm)


SWELLING_SD = 0.015
"""Standard deviation of the change of breadth and thickness (water, warmth, weight)."""
DEFORMATION_MM = (0.2, 0.5)  # largest shift of the skin against the body


def draw_impression(
    own: OwnFinger, ranges: SessionRanges, camera: Camera, place: tuple[int, int, int]
) -> _Impression:
    """Draw how a finger is laid down; `place`: seed of the population, number of the person,
    session from 1.

    What a person's fingers share in a session (swelling, moisture, gain of the camera) is drawn for
    the person.
    """
    seed, number, session = place
    require(session >= 1, f"sessions are numbered from 1, but this is {session}.")
    day = np.random.default_rng([seed, 0x5E51, number, session])
    which = FINGERS.index(own.name)
    rng = np.random.default_rng([seed, 0x5E52, number, which, session])

    def normal() -> float:
        return float(np.clip(rng.standard_normal(), -2.0, 2.0))

    def between(limits: Range, fraction: float) -> float:
        return float(limits[0] + (limits[1] - limits[0]) * fraction)

    def even(limits: Range) -> float:
        return between(limits, rng.random())

    def shared(common: float) -> float:
        # `common`: fraction of the variance that a person's fingers have in common in a session
        both = (
            np.sqrt(common) * day.standard_normal() + np.sqrt(1.0 - common) * rng.standard_normal()
        )
        return float(np.clip(both, -2.0, 2.0))

    swelling = SWELLING_SD * shared(0.8)
    moisture = float(ndtr(shared(0.6)))
    # electrons at full scale, fewer with a higher gain; noise of reading out
    full_well, read_noise = (
        between(limits, day.random()) for limits in ((2500.0, 4700.0), (2.5, 4.0))
    )
    partial = bool(rng.random() < ranges.partial_share)
    full, short = even((26.0, 28.4)), even((18.0, 22.0))  # mm, from the lower border to the tip
    _, lower, upper = picture_on_plane(camera)
    return _Impression(
        yaw_deg=5.0 * normal(),
        pitch_deg=2.0 * normal(),
        roll_deg=own.habit_roll_deg + ranges.roll_sd_deg * normal(),
        insertion_mm=min(short if partial else full, upper - lower - 0.6),
        partial=partial,
        swelling=swelling,
        **{name: even(_EVEN[name]) for name in ("x_mm", "height_mm", "flattening")},
        deformation_mm=even(DEFORMATION_MM),
        moisture=moisture,
        **{name: between(limits, moisture) for name, limits in _BY_MOISTURE.items()},
        blood_factor=float(np.exp(0.25 * shared(0.8))),  # warmth, pressure
        oxygenation=between((0.6, 0.85), day.random()),  # of all of a person's fingers
        full_well_e=full_well,
        read_noise_e=read_noise,
        **{
            name: even(_EVEN[name])
            for name in ("exposure", "ambient", "hand_shadow", "dust_per_cm2")
        },
    )


DRAWS_VERSION = 1
"""Version of the draws: it rises when the same settings give other captures. Source: definition."""
# arrays of the truth that only ``truth = "full"`` keeps
LARGE = ("normals", "glare_white", "glare_nir")


@dataclass(frozen=True, slots=True)
class PopulationSettings(Checked):
    """A whole population; how many people, fingers and sessions of it are simulated is not part of
    it."""

    seed: Annotated[int, Limits(0)] = 0
    """Seed of all people, fingers and captures: the same seed gives the same bytes. 0 or more."""
    scale: Annotated[float, Limits(0.05, 1.0)] = 0.5
    """Size of the images relative to the full frame of 2200 x 3200 pixels."""
    rig_seed: int | None = 0
    """Seed of the LEDs' individual intensities; None makes them equal."""
    people: PeopleRanges = field(default_factory=PeopleRanges)
    sessions: SessionRanges = field(default_factory=SessionRanges)
    render: RenderSettings = field(default_factory=lambda: RenderSettings(workers=1))
    films: FilmSettings = field(default_factory=FilmSettings)
    """Polarising films: none unless `films.kind` is analyser or leds."""
    truth: Literal["surface", "full"] = "surface"
    """``surface``: heights, shape, relief, mask, landmarks; ``full``: normals and glare, too (five
    times as large)."""

    def rig(self) -> Rig:
        """The rig as it was calibrated."""
        return default_rig(self.scale, self.rig_seed)

    def person(self, number: int) -> Person:
        """Draw the person `number`, from 1."""
        return draw_person(self.seed, number, self.people)


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """One capture of the population."""

    capture: Capture
    truth: Truth
    # who, which finger and session, how it lay, how its skin was: plain numbers and words
    facts: dict[str, Any]


def population_capture(
    settings: PopulationSettings,
    person: Person,
    finger: str,
    session: int,
    *,
    master: MasterPrint | None = None,
) -> _Shown:
    """Simulate one capture; `session` from 1, `master` of this finger where it was drawn
    already."""
    require(
        finger in person.fingers, f"'{finger}' is not a finger; fingers are {', '.join(FINGERS)}."
    )
    own = person.fingers[finger]
    rig = settings.rig()
    impression = draw_impression(
        own, settings.sessions, rig.camera, (settings.seed, person.number, session)
    )
    place = [settings.seed, 0x5E53, person.number, FINGERS.index(finger), session]
    skin_seed, drift_seed, photo_seed = np.random.SeedSequence(place).spawn(3)
    master = master or own.finger.master()
    rng = np.random.default_rng(skin_seed)
    deformation = draw_deformation(
        rng, master, impression.deformation_mm, stretch=impression.swelling
    )
    today = finger_of_today(own.finger, impression)
    worn = replace(today, printed=deformed(master, deformation))
    surface = finger_surface(worn, impression.pose(), rig.camera, workers=settings.render.workers)
    # since the LEDs were calibrated, which the rig file does not have
    lit = _drifted(rig, np.random.default_rng(drift_seed), 0.007)
    skin, twin = skin_of_today(own, impression), twin_settings_of(settings, impression)
    capture, truth = photograph(surface, lit, skin, photo_seed, settings=twin)
    subject = {"id": f"S{person.number:02d}", "finger": finger, "session": session}
    facts = {"subject": subject["id"], "finger": finger, "session": session}
    facts |= _facts(person, own, today, master, impression)
    if settings.truth == "surface":
        truth = {name: value for name, value in truth.items() if name not in LARGE}
    truth["master_minutiae_mm"] = master.minutiae
    truth["deformation_shift_mm"] = deformation.shift_mm
    truth["deformation_u_mm"], truth["deformation_v_mm"] = deformation.u_mm, deformation.v_mm
    truth |= {f"impression_{name}": np.asarray(value) for name, value in facts.items()}
    return _Shown(replace(capture, rig=rig, subject=subject), truth, facts)


def finger_of_today(finger: SimulatedFinger, impression: _Impression) -> SimulatedFinger:
    """The finger, swollen and pressed as in this impression, its ridges as deep as its moisture
    makes them."""
    shape, skin = finger.shape, finger.skin
    width_mm = shape.width_mm * (1.0 + impression.swelling + impression.flattening)
    thickness_mm = shape.thickness_mm * (1.0 + impression.swelling - impression.flattening)
    ridge_um, pore_um = (
        depth * impression.ridge_contrast for depth in (skin.ridge_depth_um, skin.pore_depth_um)
    )
    shape = replace(shape, width_mm=width_mm, thickness_mm=thickness_mm)
    return replace(
        finger, shape=shape, skin=replace(skin, ridge_depth_um=ridge_um, pore_depth_um=pore_um)
    )


def skin_of_today(own: OwnFinger, impression: _Impression) -> SkinOptics:
    """The optics of the finger's skin, as moist and as full of blood as in this impression."""
    return replace(
        own.optics,
        blood=float(np.clip(own.optics.blood * impression.blood_factor, 0.002, 0.02)),
        oxygenation=impression.oxygenation,
        glare=impression.glare,
        roughness=impression.roughness,
    )


def _drifted(rig: Rig, rng: np.random.Generator, spread: float) -> Rig:
    """The rig as it is: LEDs a little brighter or darker than when they were calibrated."""
    changes = 1.0 + spread * np.clip(rng.standard_normal(len(rig.leds)), -2.5, 2.5)
    lit = zip(rig.leds, changes, strict=True)
    return replace(
        rig,
        leds=tuple(replace(led, intensity=float(led.intensity * change)) for led, change in lit),
    )


def twin_settings_of(settings: PopulationSettings, impression: _Impression) -> TwinSettings:
    """Surroundings and camera of this impression."""
    return TwinSettings(
        render=settings.render,
        films=settings.films,
        background=BackgroundSettings(
            ambient=impression.ambient,
            hand_shadow=impression.hand_shadow,
            dust_per_cm2=impression.dust_per_cm2,
        ),
        sensor=SensorSettings(
            exposure=impression.exposure,
            full_well_e=impression.full_well_e,
            read_noise_e=impression.read_noise_e,
        ),
    )


def _facts(
    person: Person,
    own: OwnFinger,
    today: SimulatedFinger,
    master: MasterPrint,
    impression: _Impression,
) -> dict[str, Any]:
    return {
        "sex": person.sex,
        "pattern": master.pattern,
        "print_seed": own.finger.seed,
        "width_mm": today.shape.width_mm,
        "length_mm": today.shape.length_mm,
        "thickness_mm": today.shape.thickness_mm,
        "period_mm": master.period_mm,
        "ridge_depth_um": today.skin.ridge_depth_um,
        "minutiae": len(master.minutiae),
    } | asdict(impression)
