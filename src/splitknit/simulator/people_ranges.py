"""From what people's hands are drawn: sizes, ridges, classes of prints, skin."""

from __future__ import annotations

from dataclasses import dataclass, field

from splitknit.errors import require
from splitknit.simulator.skin import SkinRanges

Five = tuple[float, float, float, float, float]
"""A number for each digit, thumb to little finger."""


@dataclass(frozen=True, slots=True)
class PeopleRanges:
    """From what hands are drawn; sources and reasons: ``docs/population.md``."""

    men: float = 0.5
    """Share of men."""
    width_mm: Five = (20.2, 16.8, 17.0, 16.0, 14.3)
    """Mean breadth of the pad by digit, thumb to little finger, both sexes."""
    length_mm: Five = (30.5, 25.0, 26.0, 25.5, 22.8)
    """Mean length from tip to first crease."""
    width_sex_ratio: float = 1.14
    """Men's over women's breadth."""
    length_sex_ratio: float = 1.09
    """Men's over women's length from tip to first crease; 0.8 to 1.4."""
    width_spread: float = 0.055
    """Relative standard deviation of the breadth between people of one sex."""
    length_spread: float = 0.05
    """Relative standard deviation of that length between people of one sex; 0 to 0.12."""
    person_share: float = 0.8
    """Share of the variance of breadth and length, within a sex, that all ten fingers have in common."""
    period_mm: float = 0.435
    """Mean ridge period, both sexes: 23 ridges per cm, as in the thesis."""
    period_sex_ratio: float = 1.10
    """Men's over women's ridge period."""
    period_digit: Five = (1.05, 1.02, 1.0, 0.98, 0.95)
    """The digits' ridge periods, relative."""
    period_spread: float = 0.045
    """Between people of one sex, relative."""
    period_own_spread: float = 0.02
    """Between the fingers of a hand."""
    pattern_person_share: float = 0.35
    """How far a person's fingers tend to one class of print: share of the latent variance."""
    pattern_digit_share: float = 0.25
    """The same for the two fingers of one name."""
    optics: SkinRanges = field(default_factory=SkinRanges)
    """Skin of a person; the fingers differ little."""
    blood_own_spread: float = 0.10
    """Logarithmic standard deviation of the blood content between the fingers of a person; 0 to 0.5."""
    relief_gain_own_spread: float = 0.05
    """The same for the relief gain; 0 to 0.5."""
    habit_roll_sd_deg: float = 3.0
    """How far a finger is rolled whenever its owner lays it down."""

    def __post_init__(self) -> None:
        for name in ("men", "person_share", "pattern_person_share", "pattern_digit_share"):
            value = getattr(self, name)
            require(0 <= value <= 1, f"people.{name} must lie in [0, 1], but it is {value}.")
        require(
            self.pattern_person_share + self.pattern_digit_share <= 1,
            "people.pattern_person_share and people.pattern_digit_share must not exceed 1 together.",
        )
        for name in ("width_sex_ratio", "length_sex_ratio", "period_sex_ratio"):
            value = getattr(self, name)
            require(0.8 <= value <= 1.4, f"people.{name} must lie in [0.8, 1.4], but it is {value}.")
        for name in ("width_spread", "length_spread", "period_spread", "period_own_spread"):
            value = getattr(self, name)
            require(0 <= value <= 0.12, f"people.{name} must lie in [0, 0.12], but it is {value}.")
        for name, low, high in (("width_mm", 11, 23), ("length_mm", 18, 34), ("period_digit", 0.9, 1.1)):
            values = getattr(self, name)
            sound = all(low <= value <= high for value in values)
            require(sound, f"people.{name} must lie in [{low}, {high}], but it is {values}.")
        require(0.38 <= self.period_mm <= 0.5, f"people.period_mm must lie in [0.38, 0.5], but it is {self.period_mm}.")
        for name, high in (("blood_own_spread", 0.5), ("relief_gain_own_spread", 0.5), ("habit_roll_sd_deg", 10)):
            value = getattr(self, name)
            require(0 <= value <= high, f"people.{name} must lie in [0, {high}], but it is {value}.")
