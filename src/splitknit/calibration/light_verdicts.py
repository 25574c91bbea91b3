"""Which LEDs of a table of nail and shadow tips can be trusted: what is refused, and the sentence that says so."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.light_table import Tip, led_name, pixels
from splitknit.errors import require
from splitknit.imaging.view import plane_points
from splitknit.model import Camera

Points = NDArray[np.float64]
OK, DISAGREES, COPIED, UNCHECKED, STRAYS = "ok", "disagrees", "copied", "unchecked", "off the circle"


@dataclass(frozen=True, slots=True)
class LightLimits:
    """What is refused."""

    limit_deg: float = 5.0
    """Directions of one LED that are further apart than this disagree."""
    copy_mm: float = 0.4
    """Shadow tips of two nail positions that are nearer than this, on the finger plane, repeat: a true tip moves
    further than its nail. The thesis's copies lie up to 0.22 mm apart."""
    move_mm: float = 1.0
    """Nail positions that are nearer than this are one position."""
    same_nail_mm: float = 1.0
    """The nail's pixel may differ so much between the rows of one position."""

    def __post_init__(self) -> None:
        require(0 < self.limit_deg <= 90, f"limit_deg must lie between 0 and 90 deg, but it is {self.limit_deg}.")
        for name in ("copy_mm", "move_mm", "same_nail_mm"):
            require(0 <= getattr(self, name) <= 100, f"LightLimits: {name} must lie between 0 and 100 mm.")
        require(self.copy_mm <= self.move_mm, "LightLimits: copy_mm must not exceed move_mm.")


def copied_leds(tips: Sequence[Tip], camera: Camera, limits: LightLimits | None = None) -> set[tuple[str, int]]:
    """Return the LEDs, band and number, whose shadow tips repeat although the nail moved: copying errors.

    A tip always moves further than its nail, so that no true pair of tips can come under the limit.
    """
    limits = limits or LightLimits()
    nails, ends = (plane_points(camera, part) for part in pixels(tips))
    found = set()
    for i, first in enumerate(tips):
        for j in range(i + 1, len(tips)):
            if (first.band, first.led) == (tips[j].band, tips[j].led):
                moved = float(np.linalg.norm(nails[i] - nails[j]))
                if np.linalg.norm(ends[i] - ends[j]) <= limits.copy_mm and moved > limits.move_mm:
                    found.add((first.band, first.led))
    return found


def check_nails(tips: Sequence[Tip], camera: Camera, limits: LightLimits | None = None) -> None:
    """Check that a nail number is one place, and two numbers two places.

    Raises
    ------
    BadInput
        Naming the nail numbers.
    """
    limits = limits or LightLimits()
    nails = plane_points(camera, pixels(tips)[0])
    middles: dict[tuple[str, int], Points] = {}
    for band, nail in dict.fromkeys((tip.band, tip.nail) for tip in tips):
        places = nails[[(tip.band, tip.nail) == (band, nail) for tip in tips]]
        middle = np.median(places, axis=0)
        spread = float(np.linalg.norm(places - middle, axis=1).max())
        require(
            spread <= limits.same_nail_mm,
            f"nail {nail} of the {band} LEDs stands at places {spread:.1f} mm from each other; a nail number is one "
            f"position, so correct its pixels or give each position a number of its own.",
        )
        middles[band, nail] = middle
    for (band, nail), middle in middles.items():
        for (other_band, other), place in middles.items():
            distance = float(np.linalg.norm(middle - place))
            require(
                band != other_band or nail >= other or distance > limits.move_mm,
                f"nails {nail} and {other} of the {band} LEDs stand {distance:.2f} mm from each other, which is one "
                f"position; move the nail by a centimetre between them, or correct its pixels.",
            )


@dataclass(frozen=True, slots=True)
class Judged:
    """One LED and what is thought of it."""

    band: str
    led: int
    disagreement_deg: float | None
    verdict: str

    @property
    def refused(self) -> bool:
        """Whether it must not be used without a word from the user."""
        return self.verdict not in (OK, UNCHECKED)

    @property
    def name(self) -> str:
        """Such as ``white 3``."""
        return led_name(self.band, self.led)


def judge(
    found: Sequence[tuple[str, int, float | None]],
    copied: Set[tuple[str, int]],
    strays: Set[tuple[str, int]] = frozenset(),
    limit_deg: float = 5.0,
) -> tuple[Judged, ...]:
    """Give every LED (band, number, disagreement in degrees or None) its verdict.

    ``copied`` goes before ``off the circle``, that before ``disagrees``; ``unchecked`` is an LED that one position of
    the nail shows.
    """
    judged = []
    for band, led, apart in found:
        if (band, led) in copied:
            word = COPIED
        elif (band, led) in strays:
            word = STRAYS
        elif apart is None:
            word = UNCHECKED
        else:
            word = DISAGREES if apart > limit_deg else OK
        judged.append(Judged(band, led, apart, word))
    return tuple(judged)


def refusal(judged: Sequence[Judged], limit_deg: float, stray_mm: float = 10.0) -> str | None:
    """One sentence that names every LED that is refused and what to do; None where there is none."""
    apart = [f"{one.name} ({one.disagreement_deg:.1f} deg)" for one in judged if one.verdict == DISAGREES]
    same = [one.name for one in judged if one.verdict == COPIED]
    away = [one.name for one in judged if one.verdict == STRAYS]
    parts = []
    if apart:
        parts.append(f"two nail positions disagree by more than {limit_deg:g} deg about {_listed(apart)}")
    if same:
        parts.append(f"the shadow tips of {_listed(same)} are copies: they repeat although the nail moved")
    if away:
        parts.append(f"{_listed(away)} would stand more than {stray_mm:g} mm outside or inside the LED circle")
    if not parts:
        return None
    return (
        f"{', and '.join(parts)}; correct the pixels or photograph the nail again under these LEDs, or keep them as "
        f"they are (--keep)."
    )


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
