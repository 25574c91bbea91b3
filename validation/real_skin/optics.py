"""The simulator's optics of skin against published measurements: each check passes, or says why it
differs.

    python validation/real_skin/optics.py    # prints the table and writes tables/optics.csv

Coefficients (Jensen et al. 2001), reflectance at 780 nm (Cooksey et al. 2017), and how much of the
detail is left in red, by its scale. What is drawn for a simulated finger (`SkinRanges`) should
cover what was measured.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from splitknit_simulator.light.skin import (
    EFFECTIVE,
    Channel,
    ChannelOptics,
    Profile,
    SkinOptics,
    SkinRanges,
    diffusion_profile,
    fresnel,
)

TABLE = Path(__file__).with_name("tables") / "optics.csv"
VISIBLE: tuple[Channel, ...] = ("red", "green", "blue")
JENSEN = {
    "skin1": {"scattering": (0.74, 0.88, 1.01), "absorption": (0.032, 0.17, 0.48)},
    "skin2": {"scattering": (1.09, 1.59, 1.79), "absorption": (0.013, 0.070, 0.145)},
}
"""Reduced scattering and absorption per mm in red, green and blue."""
NIST = (0.526, 0.617, 0.665)
"""Reflectance of the forearm's inside at 780 nm, least, mean and most of 100 people."""
AT_780_NM = replace(
    EFFECTIVE["nir"],
    scattering_nm=780.0,
    absorption_nm=780.0,
    oxygenated=0.38,
    deoxygenated=0.58,
    water=0.0025,
)
"""Blood of 150 g/l by Prahl's compilation (710 and 1075 per cm and mol/l), water by Hale and Querry
1973, per mm."""
FACE_RED_OVER_GREEN = (0.63, 0.76)
"""Detail in red over that in green on a real face under seven lights: nearly the same at all
scales, whose size in mm is not known."""
PERIODS_MM = (4, 2, 1, 0.5, 0.25)
FINGERS = 400
SEED = 1


@dataclass(frozen=True, slots=True)
class Check:
    """One figure of the literature and ours."""

    name: str
    literature: str
    simulator: str
    passed: bool
    why: str = ""
    """Where it differs."""


def jensen() -> Iterator[Check]:
    """Coefficients against the range of what is drawn."""
    usual = replace(SkinOptics(), scattering_factor=1.0)
    fingers = drawn_fingers()
    factors = np.array([finger.scattering_factor for finger in fingers])
    for skin, coefficients in JENSEN.items():
        scattering = dict(zip(VISIBLE, coefficients["scattering"], strict=True))
        needed = [
            value / usual.channel(channel).scattering_per_mm
            for channel, value in scattering.items()
        ]
        passed = bool(factors.min() <= min(needed) and max(needed) <= factors.max())
        values_text = ", ".join(f"{value:g}" for value in scattering.values())
        literature = f"{values_text} (factor {min(needed):.2f} to {max(needed):.2f})"
        name = f"Jensen's {skin}: scattering in red, green, blue, per mm"
        simulator = f"factor {factors.min():.2f} to {factors.max():.2f}"
        yield Check(name, literature, simulator, passed, "" if passed else WHY_SCATTERING)
        for channel, value in zip(VISIBLE, coefficients["absorption"], strict=True):
            absorption = np.array([finger.channel(channel).absorption_per_mm for finger in fingers])
            passed = bool(absorption.min() <= value <= absorption.max())
            name = f"Jensen's {skin}: absorption in {channel}, per mm"
            yield Check(
                name, f"{value:g}", _range(absorption), passed, "" if passed else WHY_ABSORPTION
            )


WHY_SCATTERING = (
    "Jensen et al. fit a diffusion model to light that leaves living skin some way from a beam,"
    " while the simulator takes Jacques's mean of published measurements of tissue (46 per cm at"
    " 500 nm); no measurement of a finger's pad decides between them."
)
WHY_ABSORPTION = (
    "it lies outside what is drawn: fingers get a grey absorption of 0.008 per mm, blood from 0.3"
    " %, and in blue 0.105 per mm for the pad's thick horny layer, which other skin lacks."
)


def nist() -> Check:
    """Reflectance of flat skin at 780 nm, surface reflection included, as an integrating sphere
    sees it."""
    surface = float(fresnel(np.array(1.0)))
    # the simulator's own mixture at another wavelength
    with mock.patch.dict(EFFECTIVE, nir=AT_780_NM):
        optics = [finger.channel("nir") for finger in drawn_fingers()]
    simulator = surface + (1 - surface) * np.array([_profile(channel).albedo for channel in optics])
    low, mean, high = NIST
    passed = bool(simulator.min() <= low and simulator.max() >= high)
    return Check(
        "reflectance at 780 nm",
        f"{mean:g}, {low:g} to {high:g}",
        _range(simulator),
        passed,
        "" if passed else WHY_NIST,
    )


WHY_NIST = (
    "the simulator's absorption is that of its reference renders and was not fitted to people, and"
    " the forearm's skin is not the finger pad's."
)


def face() -> Check:
    """Slopes left in red over those left in green behind scattering, from coarse to fine."""
    usual, (low, high) = SkinOptics(), FACE_RED_OVER_GREEN

    def ratios(red: ChannelOptics, green: ChannelOptics) -> NDArray[np.float64]:
        """Light left of a pattern in red over that in green, relative to the mean of each."""
        left = [
            profile.transfer(cycles) / profile.albedo
            for profile in (_profile(red), _profile(green))
        ]
        return np.asarray(left[0] / left[1])

    cycles = 1 / np.array(PERIODS_MM)
    passed = False
    for finger in drawn_fingers():
        simulator = ratios(finger.channel("red"), finger.channel("green"))
        passed |= bool(((low <= simulator) & (simulator <= high)).all())
    jensen_ratios = [
        ratios(
            *(
                ChannelOptics(s, a, 0.0)
                for s, a in zip(c["scattering"][:2], c["absorption"][:2], strict=True)
            )
        )
        for c in JENSEN.values()
    ]
    gloss = _profile(usual.channel("green")).albedo / _profile(usual.channel("red")).albedo
    why = (
        "behind a diffuse boundary the ratio falls down to periods of about 1 mm and is lower than"
        " the face's below; Jensen's coefficients make it flatter but lower still"
        f" ({np.min(jensen_ratios):.2f} to {np.max(jensen_ratios):.2f}); specular reflection alone"
        f" has the ratio of the brightness in green to that in red, {gloss:.2f}, at all scales, so"
        " that a face whose detail is mostly specular would look as it does; crossed polarisers"
        " would tell."
    )
    simulated = ", ".join(
        f"{ratio:.2f}" for ratio in ratios(usual.channel("red"), usual.channel("green"))
    )
    name = (
        "red over green detail at periods of"
        f" {', '.join(f'{period:g}' for period in PERIODS_MM)} mm"
    )
    return Check(
        name, f"{low:g} to {high:g} at all scales (face)", simulated, passed, "" if passed else why
    )


def _profile(optics: ChannelOptics) -> Profile:
    return diffusion_profile(optics.scattering_per_mm, optics.absorption_per_mm)


def drawn_fingers() -> list[SkinOptics]:
    """The skin of many fingers."""
    rng = np.random.default_rng(SEED)
    return [SkinRanges().draw(rng) for _ in range(FINGERS)]


def _range(values: NDArray[np.float64]) -> str:
    return f"{values.min():.3g} to {values.max():.3g}, median {np.median(values):.3g}"


def checks() -> list[Check]:
    """All of them."""
    return [*jensen(), nist(), face()]


def table(results: Sequence[Check]) -> list[list[str]]:
    """Rows of ``tables/optics.csv``."""
    rows = [
        [
            check.name,
            check.literature,
            check.simulator,
            "pass" if check.passed else "differs",
            check.why,
        ]
        for check in results
    ]
    return [["figure", "literature", "simulator", "verdict", "why"], *rows]


def main() -> int:
    """Print and write the table; zero where every check passes or is explained."""
    results = checks()
    print("\n".join("; ".join(part for part in row if part) for row in table(results)))
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(table(results))
    return int(any(not check.passed and not check.why for check in results))


if __name__ == "__main__":
    sys.exit(main())
