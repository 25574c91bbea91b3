"""How good a print is: one score made of figures that say what is wrong with it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields

import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.prints.print_quality_figures import QualityFigures, quality_figures
from splitknit.prints.ridge_field import RidgeField

_LEAST_PART = 0.01
"""What the worst figure is worth: no single one makes the score 0."""


@dataclass(frozen=True, slots=True)
class Part:
    """How one figure enters the score: worth nothing at `useless`, all from `good` on, straight in between."""

    useless: float
    """Figure that is worth nothing; above `good` where less is better."""
    good: float
    """Figure from which on nothing is lost."""
    weight: float
    """Exponent in the score; 0 leaves the figure out."""

    def __post_init__(self) -> None:
        usable = bool(np.isfinite([self.useless, self.good, self.weight]).all())
        require(usable and self.useless != self.good, "useless and good of a quality must be two different numbers.")
        require(self.weight >= 0, f"a quality's weight must not be negative, but it is {self.weight}.")

    def worth(self, figure: float) -> float:
        """0.01 to 1, the better the higher."""
        return float(np.clip((figure - self.useless) / (self.good - self.useless), _LEAST_PART, 1.0))


_MIN_PURITY = 0.3
"""Share of what varies around a place that one wave must explain, or there are no ridges."""
_MIN_HEIGHT_UM = 10.0
"""Ridges that rise less above their valleys count as none (prints of the relief)."""
_PERIOD_TOLERANCE = 0.35
"""A ridge period further from the finger's median than this, relative, is not plausible."""


@dataclass(frozen=True, slots=True)
class PrintQualitySettings:
    """What counts as ridges, and how the figures make the score."""

    ridge_share: Part = field(default_factory=lambda: Part(0.2, 1.0, 0.3))
    """Share of the finger's area on the print that has ridges."""
    ridge_height_um: Part = field(default_factory=lambda: Part(5.0, 50.0, 0.3))
    """Height of the ridges above their valleys in um (prints of the relief)."""
    coherence: Part = field(default_factory=lambda: Part(0.5, 1.0, 0.15))
    """How much ridges agree in their direction, 0 to 1."""
    plausible_share: Part = field(default_factory=lambda: Part(0.5, 1.0, 0.15))
    """Share of the ridges whose period is plausible."""
    sharpness: Part = field(default_factory=lambda: Part(0.02, 0.11, 0.15))
    """Second harmonic of the ridges over the first."""
    ridge_area_mm2: Part = field(default_factory=lambda: Part(20.0, 300.0, 0.15))
    """Ridges in mm2."""
    ridge_length_mm: Part = field(default_factory=lambda: Part(6.0, 20.0, 0.3))
    """From the tip to the last ridges in mm."""
    gap_share: Part = field(default_factory=lambda: Part(0.4, 0.0, 0.15))
    """Share without ridges of what ridges surround: creases, scars, glare, shadows."""
    centre_offset_mm: Part = field(default_factory=lambda: Part(8.0, 1.0, 0.1))
    """How far the ridges' centre lies beside the finger's middle, in mm."""

    def __post_init__(self) -> None:
        require(sum(part.weight for part in self.parts().values()) > 0, "a quality's weight must be above 0.")

    def parts(self) -> dict[str, Part]:
        """Parts of the score by the name of their figure."""
        return {f.name: getattr(self, f.name) for f in fields(self) if isinstance(getattr(self, f.name), Part)}


@dataclass(frozen=True, slots=True)
class PrintQuality:
    """Quality of a print."""

    score: float
    """0 to 100, the higher the better."""
    figures: QualityFigures
    worth: dict[str, float]
    """What each figure is worth, 0.01 to 1, by its name."""


def print_quality(
    values: FloatArray,
    weight: FloatArray,
    found: RidgeField,
    ppi: float = 500.0,
    *,
    in_um: bool = True,
    settings: PrintQualitySettings | None = None,
) -> PrintQuality:
    """Measure how good a print is.

    Parameters
    ----------
    values : (h, w) float32
        What is inked: the relief in um, or anything else that is high on ridges (`in_um` false: no heights then).
    weight : (h, w) float32
        Share of the pixel that lies on the finger, 0 to 1; the tip is at row 0.
    found : RidgeField
        Of the print.
    ppi : float
    in_um : bool
    settings : PrintQualitySettings, optional

    Raises
    ------
    BadInput
        If the shapes disagree or nothing lies on the finger.

    References
    ----------
    ISO/IEC 29794-4:2017, Biometric sample quality, part 4, sections on orientation certainty and ridge-valley
    uniformity; M. Lim, X. Jiang and W. Yau 2002, Fingerprint quality and validity analysis, section 2 (coherence,
    periods, ridge strength). Second harmonic against the first: the idea of the bispectrum (D. Brillinger 1965).
    """
    settings = settings or PrintQualitySettings()
    figures = quality_figures(
        values,
        weight,
        found,
        ppi,
        least_purity=_MIN_PURITY,
        least_height_um=_MIN_HEIGHT_UM if in_um else None,
        period_tolerance=_PERIOD_TOLERANCE,
    )
    score, worth = score_of(figures, settings)
    return PrintQuality(score, figures, worth)


def score_of(figures: QualityFigures, settings: PrintQualitySettings | None = None) -> tuple[float, dict[str, float]]:
    """Score of figures, 0 to 100, and what each is worth.

    100 times the product of the figures' worths, each to the power of its weight: it never falls when a figure gets
    better, and one bad figure cannot be made up for by many good ones. 0 where there are no ridges. Figures that are
    None are left out.
    """
    parts = (settings or PrintQualitySettings()).parts()
    measured = {name: value for name, value in asdict(figures).items() if name in parts and value is not None}
    worth = {name: parts[name].worth(value) for name, value in measured.items()}
    if figures.ridge_area_mm2 <= 0.0:
        return 0.0, worth
    return 100.0 * float(np.prod([value ** parts[name].weight for name, value in worth.items()])), worth
