"""People: hands whose ten fingers are similar in size, shape and skin, each with a print of its
own.

Everything is drawn from a person's number, so that a person does not depend on how many others
there are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from scipy.special import ndtr

from splitknit.errors import require
from splitknit.model import Array
from splitknit.settings import Checked, Limits
from splitknit_simulator.finger.finger import (
    TRAITS,
    SimulatedFinger,
    crease_of,
    relief_of,
    shape_of,
)
from splitknit_simulator.finger.master_print import MasterPrintSettings
from splitknit_simulator.finger.shape import FingerShape
from splitknit_simulator.finger.skin_map import SkinRelief as ReliefSettings
from splitknit_simulator.light.skin import SkinOptics, SkinRanges

Five = tuple[float, float, float, float, float]
DIGITS = ("thumb", "index", "middle", "ring", "little")
SIDES = ("right", "left")

ARCHES: Mapping[str, Five] = {
    "right": (0.03, 0.17, 0.07, 0.02, 0.01),
    "left": (0.05, 0.17, 0.08, 0.03, 0.02),
}
"""Fraction of arches by digit, thumb to little finger (Galton 1892, chapter VIII, 5000 digits of
500 persons)."""
WHORLS: Mapping[str, Five] = {
    "right": (0.44, 0.30, 0.15, 0.45, 0.13),
    "left": (0.30, 0.28, 0.16, 0.31, 0.08),
}
"""Fraction of whorls; the rest are loops (the same table)."""
RADIAL: Five = (0.01, 0.39, 0.04, 0.02, 0.01)
"""Fraction of the loops that open to the thumb's side, by digit: 39 % on fore-fingers, rare
elsewhere. Source: Galton 1892."""
TENTED = 0.44
"""Fraction of tented ones among the arches. Source: derived from
:data:`splitknit_simulator.finger.finger.FREQUENCIES`."""
TWIN = 0.18
"""Fraction of twin loops among the whorls. Source: derived from
:data:`splitknit_simulator.finger.finger.FREQUENCIES`."""


# Classes of prints by digit and hand, in the frequencies that people have.


def _pattern_class(rng: np.random.Generator, score: float, side: str, digit: str) -> str:
    """Class of a print in the digit's frequencies: arches where a standard normal `score` is low,
    whorls where high.

    Scores that are similar in a person's fingers make their classes similar. On the print of a
    right hand the little finger's side is to the right: ulnar loops open there. Source: Galton
    1892, Finger prints, chapter VIII, table I.
    """
    k = DIGITS.index(digit)
    quantile = float(ndtr(score))
    details = rng.random(2)
    if quantile < ARCHES[side][k]:
        return "tented_arch" if details[0] < TENTED else "arch"
    if quantile > 1.0 - WHORLS[side][k]:
        return "twin_loop" if details[0] < TWIN else "whorl"
    radial = bool(details[1] < RADIAL[k])
    return "right_loop" if radial != (side == "right") else "left_loop"


# From what hands are drawn.

_LENGTH_SEX_RATIO = 1.09
"""Length from tip to first crease, men's over women's. Source: Pheasant's tables of hands."""
_LENGTH_SD = 0.05
"""Standard deviation of that length between people of one sex, relative. Source: Pheasant's tables
of hands."""
_WIDTH_SEX_RATIO = 1.14
"""Breadth of the pad, men's over women's. Source: Pheasant's tables of hands."""
_WIDTH_SD = 0.055
"""Standard deviation of that breadth between people of one sex, relative. Source: Pheasant's tables
of hands."""
_PERIOD_SEX_RATIO = 1.10
"""Ridge period, men's over women's. Source: Cummins 1941, Acree 1999, Gutierrez-Redomero 2008."""
_PERIOD_SD = 0.045
"""Standard deviation of the ridge period between people of one sex, relative. Source: Cummins 1941,
Acree 1999, Gutierrez-Redomero 2008."""
_PERIOD_FINGER_SD = 0.02
"""Standard deviation of the ridge period between the fingers of a hand, relative. Source: Cummins
1941, Acree 1999, Gutierrez-Redomero 2008."""
PERIOD_MM = 0.435
"""Mean ridge period of both sexes. Source: thesis, 23 ridges per cm."""


@dataclass(frozen=True, slots=True)
class PeopleRanges(Checked):
    """From what hands are drawn; sources and reasons: ``docs/explain/population.md``."""

    _group = "people"

    men: Annotated[float, Limits(0.0, 1.0)] = 0.5
    """Fraction of men."""
    optics: SkinRanges = field(default_factory=SkinRanges)
    """Skin of a person; the fingers differ little."""


FINGERS = tuple(f"{side}_{digit}" for side in SIDES for digit in DIGITS)


@dataclass(frozen=True, slots=True)
class OwnFinger:
    """One finger of a person."""

    name: str
    finger: SimulatedFinger  # shape at rest, print, relief
    optics: SkinOptics
    habit_roll_deg: float


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody with ten fingers."""

    number: int  # from 1
    sex: str  # ``man`` or ``woman``
    fingers: Mapping[str, OwnFinger]  # by name, as in :data:`FINGERS`


def draw_person(seed: int, number: int, ranges: PeopleRanges | None = None) -> Person:
    """Draw person `number`, from 1, of the population `seed`; the others are not drawn for it."""
    ranges = ranges or PeopleRanges()
    require(
        seed >= 0 and number >= 1,
        "seeds of populations are not negative, and people are numbered from 1.",
    )
    rng = np.random.default_rng([seed, 0xB0D1, number])
    man = bool(rng.random() < ranges.men)
    optics = ranges.optics.draw(rng)
    hand = _Hand(rng)
    print_seeds = np.random.SeedSequence([seed, 0xB0D2, number]).spawn(len(FINGERS))
    fingers = {}
    for place, name in enumerate(FINGERS):
        own = np.random.default_rng([seed, 0xB0D3, number, place])
        side, digit = divmod(place, len(DIGITS))
        score = hand.score("pattern", place, 0.35, 0.25)
        pattern = _pattern_class(own, score, SIDES[side], DIGITS[digit])
        settings = _print_settings(own, hand, place, man)
        shape, relief = _shape_and_relief(own, hand, place, man)
        print_seed = int(print_seeds[place].generate_state(1, np.uint32)[0])
        fingers[name] = OwnFinger(
            name,
            SimulatedFinger(print_seed, pattern, shape, relief, _large_enough(settings, shape)),
            _own_optics(own, optics, ranges),
            float(np.clip(own.standard_normal(), -2, 2)) * 3.0,  # habitual roll, deg
        )
    return Person(number, "man" if man else "woman", fingers)


_SIZE_COMMON_TO_PERSON = 0.8
"""Fraction of the variance of breadth and length that all ten fingers share, within a sex."""


class _Hand:
    """Standard normal scores that describe how a person's fingers differ from the mean, similar
    among themselves."""

    EXTRA = ("width", "length", "period", "pattern")

    def __init__(self, rng: np.random.Generator) -> None:
        names = [*self.EXTRA, *TRAITS]
        self._column = {name: k for k, name in enumerate(names)}
        self._person = rng.standard_normal(len(names))
        self._digit = rng.standard_normal((len(DIGITS), len(names)))
        self._own = rng.standard_normal((len(FINGERS), len(names)))

    def score(self, name: str, place: int, person: float, digit: float) -> float:
        """Score of the finger `place`; `person` and `digit` are the fractions of the variance that
        are common."""
        k = self._column[name]
        z = np.sqrt(person) * self._person[k] + np.sqrt(digit) * self._digit[place % len(DIGITS), k]
        return float(z + np.sqrt(max(1.0 - person - digit, 0.0)) * self._own[place, k])

    def size(self, name: str, place: int) -> float:
        """Score of breadth or length; most of what is not the person's is common to both hands."""
        digit = 0.7 * (1.0 - _SIZE_COMMON_TO_PERSON)
        return float(np.clip(self.score(name, place, _SIZE_COMMON_TO_PERSON, digit), -2.2, 2.2))

    def trait(self, name: str, place: int) -> float:
        """Value of a trait, mirrored on the left hand where it has a side."""
        trait = TRAITS[name]
        value = trait.mean + trait.spread * self.score(name, place, 0.45, 0.40)
        value = float(np.clip(value, trait.low, trait.high))
        return -value if trait.sided and place >= len(DIGITS) else value


PERIOD_DIGIT = (1.05, 1.02, 1.0, 0.98, 0.95)
"""Ridge period by digit, thumb to little finger, relative to the mean."""


def _print_settings(
    rng: np.random.Generator, hand: _Hand, place: int, man: bool
) -> MasterPrintSettings:
    sex = (0.5 if man else -0.5) * np.log(_PERIOD_SEX_RATIO)
    person = hand.score("period", place, 1.0, 0.0)
    own = _PERIOD_FINGER_SD * np.clip(rng.standard_normal(), -2.2, 2.2)
    logs = sex + _PERIOD_SD * np.clip(person, -2.2, 2.2) + own
    period = PERIOD_MM * PERIOD_DIGIT[place % len(DIGITS)] * float(np.exp(logs))
    return MasterPrintSettings(period_mm=max(period, 0.33), period_spread=0.0)


WIDTH_MM = (20.2, 16.8, 17.0, 16.0, 14.3)
"""Mean breadth of the pad by digit, thumb to little finger, of both sexes; that of the index finger
is Greiner's (1991), the others are judged."""
LENGTH_MM = (30.5, 25.0, 26.0, 25.5, 22.8)
"""Mean length from tip to first crease by digit, thumb to little finger, of both sexes; that of the
index finger is Greiner's (1991), the others follow Buryanov and Kotiuk (2010)."""


def _shape_and_relief(
    rng: np.random.Generator, hand: _Hand, place: int, man: bool
) -> tuple[FingerShape, ReliefSettings]:
    digit = place % len(DIGITS)

    def size(name: str, means: Five, ratio: float, spread: float) -> float:
        sex = ratio ** (0.5 if man else -0.5)
        return float(means[digit] * sex * (1.0 + spread * hand.size(name, place)))

    def trait(name: str) -> float:
        return hand.trait(name, place)

    width = size("width", WIDTH_MM, _WIDTH_SEX_RATIO, _WIDTH_SD)
    length = size("length", LENGTH_MM, _LENGTH_SEX_RATIO, _LENGTH_SD)
    shape = shape_of(trait, length, width, 0.93 if digit == 0 else 1.0)
    shape = replace(shape, tip_drop_mm=trait("tip_drop") * min(shape.thickness_mm / 13.5, 1.25))
    first, second = (
        crease_of(trait, which, v_mm, lambda: int(rng.integers(0, 4)), width / 16.8)
        for which, v_mm in (("first", 0.0), ("second", -0.92 * length))
    )
    return shape, relief_of(trait, (first, second))


def _large_enough(settings: MasterPrintSettings, shape: FingerShape) -> MasterPrintSettings:
    """Large fingers have large patterns, and a map of the ridges that covers them."""
    return replace(
        settings,
        half_width_mm=max(15.0, 0.85 * shape.width_mm),
        distal_mm=max(33.0, shape.length_mm + 8.0),
        pattern_scale=float(np.sqrt(shape.width_mm / 16.8 * shape.length_mm / 25.0)),
    )


def _own_optics(rng: np.random.Generator, skin: SkinOptics, ranges: PeopleRanges) -> SkinOptics:
    draws: Array = np.clip(rng.standard_normal(2), -2, 2)
    # logarithmic standard deviations between a person's fingers
    blood = skin.blood * float(np.exp(0.10 * draws[0]))
    gain = skin.relief_gain * float(np.exp(0.05 * draws[1]))
    low, high = ranges.optics.relief_gain
    return replace(skin, blood=blood, relief_gain=float(np.clip(gain, low, high)))
