"""People: hands whose ten fingers are alike in size, shape and skin, each with a print of its own.

Everything is drawn from a person's number, so that a person does not depend on how many others there are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.simulator.finger import Finger
from splitknit.simulator.finger_shape import FingerShape
from splitknit.simulator.master_print import MasterPrintSettings
from splitknit.simulator.pattern_classes import DIGITS, SIDES, pattern_class
from splitknit.simulator.people_ranges import Five, PeopleRanges
from splitknit.simulator.skin import SkinSettings
from splitknit.simulator.skin_map import Crease
from splitknit.simulator.skin_map import SkinSettings as ReliefSettings

FINGERS = tuple(f"{side}_{digit}" for side in SIDES for digit in DIGITS)


@dataclass(frozen=True, slots=True)
class OwnFinger:
    """One finger of a person."""

    name: str
    finger: Finger
    """Shape at rest, print, relief."""
    optics: SkinSettings
    habit_roll_deg: float


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody with ten fingers."""

    number: int
    """From 1."""
    sex: str
    """``man`` or ``woman``."""
    fingers: Mapping[str, OwnFinger]
    """By name, as in :data:`FINGERS`."""


def draw_person(seed: int, number: int, ranges: PeopleRanges | None = None) -> Person:
    """Draw a person of the population `seed`.

    Parameters
    ----------
    seed : of the population
    number : of the person, from 1; the others are not drawn for it
    ranges : from what

    Raises
    ------
    BadInput
        If `seed` or `number` is negative.
    """
    ranges = ranges or PeopleRanges()
    require(seed >= 0 and number >= 1, "seeds of populations are not negative, and people are numbered from 1.")
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0xB0D1, number]))
    man = bool(rng.random() < ranges.men)
    optics = ranges.optics.draw(rng)
    hand = _Hand(rng)
    prints = [
        int(child.generate_state(1, np.uint32)[0])
        for child in np.random.SeedSequence([seed, 0xB0D2, number]).spawn(len(FINGERS))
    ]
    fingers = {}
    for place, name in enumerate(FINGERS):
        own = np.random.default_rng(np.random.SeedSequence([seed, 0xB0D3, number, place]))
        side, digit = divmod(place, len(DIGITS))
        pattern = pattern_class(own, hand.pattern_score(place, ranges), SIDES[side], DIGITS[digit])
        settings = _print_settings(own, hand, place, man, ranges)
        shape, relief = _shape_and_relief(own, hand, place, man, ranges)
        settings = _large_enough(settings, shape)
        fingers[name] = OwnFinger(
            name,
            Finger(prints[place], pattern, shape, relief, settings),
            _own_optics(own, optics, ranges),
            float(np.clip(own.standard_normal(), -2, 2)) * ranges.habit_roll_sd_deg,
        )
    return Person(number, "man" if man else "woman", fingers)


class _Hand:
    """Standard normal scores that say how a person's fingers differ from the mean, alike among themselves."""

    EXTRA = ("width", "length", "period", "pattern")

    def __init__(self, rng: np.random.Generator) -> None:
        names = [*self.EXTRA, *TRAITS]
        self._column = {name: k for k, name in enumerate(names)}
        self._person = rng.standard_normal(len(names))
        self._digit = rng.standard_normal((len(DIGITS), len(names)))
        self._own = rng.standard_normal((len(FINGERS), len(names)))

    def score(self, name: str, place: int, person: float, digit: float) -> float:
        """Score of the finger `place`; `person` and `digit` are the shares of the variance that are common."""
        k = self._column[name]
        z = np.sqrt(person) * self._person[k] + np.sqrt(digit) * self._digit[place % len(DIGITS), k]
        return float(z + np.sqrt(max(1.0 - person - digit, 0.0)) * self._own[place, k])

    def pattern_score(self, place: int, ranges: PeopleRanges) -> float:
        return self.score("pattern", place, ranges.pattern_person_share, ranges.pattern_digit_share)

    def size(self, name: str, place: int, person: float) -> float:
        """Score of breadth or length; most of what is not the person's is common to both hands."""
        return float(np.clip(self.score(name, place, person, 0.7 * (1.0 - person)), -2.2, 2.2))

    def trait(self, name: str, place: int) -> float:
        """Value of a trait, mirrored on the left hand where it has a side."""
        trait = TRAITS[name]
        value = trait.mean + trait.spread * self.score(name, place, 0.45, 0.40)
        value = float(np.clip(value, trait.low, trait.high))
        return -value if trait.sided and place >= len(DIGITS) else value


def _print_settings(
    rng: np.random.Generator, hand: _Hand, place: int, man: bool, ranges: PeopleRanges
) -> MasterPrintSettings:
    sex = (0.5 if man else -0.5) * np.log(ranges.period_sex_ratio)
    person = hand.score("period", place, 1.0, 0.0)
    own = ranges.period_own_spread * np.clip(rng.standard_normal(), -2.2, 2.2)
    logs = sex + ranges.period_spread * np.clip(person, -2.2, 2.2) + own
    period = ranges.period_mm * ranges.period_digit[place % len(DIGITS)] * float(np.exp(logs))
    return MasterPrintSettings(period_mm=max(period, 0.33), period_spread=0.0)


def _shape_and_relief(
    rng: np.random.Generator, hand: _Hand, place: int, man: bool, ranges: PeopleRanges
) -> tuple[FingerShape, ReliefSettings]:
    digit = place % len(DIGITS)

    def size(name: str, means: Five, ratio: float, spread: float) -> float:
        sex = ratio ** (0.5 if man else -0.5)
        return float(means[digit] * sex * (1.0 + spread * hand.size(name, place, ranges.person_share)))

    def trait(name: str) -> float:
        return hand.trait(name, place)

    width = size("width", ranges.width_mm, ranges.width_sex_ratio, ranges.width_spread)
    length = size("length", ranges.length_mm, ranges.length_sex_ratio, ranges.length_spread)
    thickness = width * trait("thickness") * (0.93 if digit == 0 else 1.0)
    shape = FingerShape(
        length_mm=length,
        width_mm=width,
        thickness_mm=thickness,
        squareness=trait("squareness"),
        tip_length_mm=min(0.5 * width * trait("tip_length"), 13.8),
        tip_squareness=trait("tip_squareness"),
        taper=trait("taper"),
        pad_bulge=trait("pad_bulge"),
        pad_center=trait("pad_center"),
        neck=trait("neck"),
        arching_per_mm=trait("arching_per_mm"),
        sideways_mm=trait("sideways_mm"),
        skew=trait("skew"),
        tip_drop_mm=trait("tip_drop") * min(thickness / 13.5, 1.25),
    )
    broad = width / 16.8
    first, second = (
        Crease(
            v_mm=v_mm,
            depth_mm=trait(f"{which}_depth"),
            width_mm=trait(f"{which}_width"),
            tilt=trait(f"{which}_tilt"),
            bow_per_mm=trait(f"{which}_bow"),
            reach_mm=trait(f"{which}_reach") * broad,
            side_lines=int(rng.integers(0, 4)),
            darkening=trait(f"{which}_darkening"),
        )
        for which, v_mm in (("first", 0.0), ("second", -0.92 * length))
    )
    relief = ReliefSettings(
        ridge_depth_um=trait("ridge_depth"),
        depth_variation=trait("depth_variation"),
        pore_depth_um=trait("pore_depth"),
        pore_darkening=trait("pore_darkening"),
        creases=(first, second),
    )
    return shape, relief


def _large_enough(settings: MasterPrintSettings, shape: FingerShape) -> MasterPrintSettings:
    """Large fingers have large patterns, and a map of the ridges that covers them."""
    return replace(
        settings,
        half_width_mm=max(15.0, 0.85 * shape.width_mm),
        distal_mm=max(33.0, shape.length_mm + 8.0),
        pattern_scale=float(np.sqrt(shape.width_mm / 16.8 * shape.length_mm / 25.0)),
    )


def _own_optics(rng: np.random.Generator, skin: SkinSettings, ranges: PeopleRanges) -> SkinSettings:
    draws: NDArray[np.float64] = np.clip(rng.standard_normal(2), -2, 2)
    blood = skin.blood * float(np.exp(ranges.blood_own_spread * draws[0]))
    gain = skin.relief_gain * float(np.exp(ranges.relief_gain_own_spread * draws[1]))
    low, high = ranges.optics.relief_gain
    return replace(skin, blood=blood, relief_gain=float(np.clip(gain, low, high)))


# What makes fingers look like their owner's: forms of the pad, creases and ridge depths, with their spread.


@dataclass(frozen=True, slots=True)
class Trait:
    """A normally distributed number that is cut off."""

    mean: float
    spread: float
    low: float
    high: float
    sided: bool = False
    """Whether the left hand has it mirrored."""


TRAITS: Mapping[str, Trait] = {
    "thickness": Trait(0.80, 0.05, 0.68, 0.92),
    "squareness": Trait(0.18, 0.09, 0.02, 0.40),
    "tip_length": Trait(1.02, 0.12, 0.78, 1.30),
    "tip_squareness": Trait(0.12, 0.10, 0.0, 0.38),
    "taper": Trait(0.06, 0.025, 0.01, 0.12),
    "pad_bulge": Trait(0.06, 0.025, 0.01, 0.12),
    "pad_center": Trait(0.50, 0.06, 0.38, 0.62),
    "neck": Trait(0.03, 0.012, 0.005, 0.06),
    "arching_per_mm": Trait(0.0015, 0.0010, -0.0005, 0.004),
    "sideways_mm": Trait(0.0, 0.35, -0.9, 0.9, sided=True),
    "skew": Trait(0.0, 0.03, -0.08, 0.08, sided=True),
    "tip_drop": Trait(2.0, 0.5, 0.8, 3.2),
    "ridge_depth": Trait(65.0, 13.0, 40.0, 95.0),
    "depth_variation": Trait(0.12, 0.03, 0.05, 0.2),
    "pore_depth": Trait(25.0, 6.0, 10.0, 45.0),
    "pore_darkening": Trait(0.06, 0.02, 0.0, 0.12),
    "first_depth": Trait(0.38, 0.09, 0.2, 0.6),
    "first_width": Trait(0.28, 0.05, 0.18, 0.42),
    "first_tilt": Trait(0.0, 0.04, -0.1, 0.1, sided=True),
    "first_bow": Trait(0.003, 0.006, -0.01, 0.015),
    "first_reach": Trait(10.5, 1.2, 8.0, 13.0),
    "first_darkening": Trait(0.22, 0.06, 0.08, 0.4),
    "second_depth": Trait(0.48, 0.08, 0.3, 0.6),
    "second_width": Trait(0.34, 0.05, 0.2, 0.5),
    "second_tilt": Trait(0.0, 0.03, -0.1, 0.1, sided=True),
    "second_bow": Trait(0.0, 0.005, -0.01, 0.01),
    "second_reach": Trait(11.5, 1.2, 8.0, 14.0),
    "second_darkening": Trait(0.25, 0.06, 0.08, 0.4),
}
"""Means, spreads and limits are those of :func:`splitknit.simulator.finger.draw_finger`, where their sources stand; the
tip's drop (for a finger 13.5 mm thick) is ours: a fingertip ends near its nail, not half-way down."""
