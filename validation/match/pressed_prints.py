"""Prints of simulated fingers as a pressed sensor gives them: turned, shifted, stretched, partial,
wet, dry, noisy.

Made to choose settings of the minutiae route on prints that are nobody's. The ranges were fixed
before any setting was tried on them; they are wide, so that the plain route fails on some.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit_simulator.finger.finger import FREQUENCIES
from splitknit_simulator.finger.master_print import MasterPrint, master_print
from splitknit_simulator.finger.ridges import smooth_noise

PITCH_MM = 25.4 / 500
PRINT_SIZE = (380, 380)
"""Rows and columns of a print, pixels at 500 ppi."""
PRESS_CENTRE_MM = 13.5
"""Above the first crease lies the middle of a press."""
MAX_STRAIN = 0.4
"""By which a pull stretches skin at most."""
STICKS = (0.1, 0.6)
"""Half axes of the middle that sticks under a pull over those of the contact."""


@dataclass(frozen=True, slots=True)
class PressRanges:
    """How presses of one finger differ; spreads are standard deviations."""

    turn_deg: float = 9.0
    across_mm: float = 2.0
    along_mm: float = 2.5
    stretch_mm: float = 0.25
    """Of the skin's smooth shift, over distances of 4 mm."""
    pull_mm: float = 0.0
    """By which the rim has slipped along each axis while the middle stuck."""
    twist_deg: float = 0.0
    half_width_mm: tuple[float, float] = (5.5, 8.5)
    half_height_mm: tuple[float, float] = (7.0, 10.0)
    moisture: tuple[float, float] = (0.42, 0.88)
    """Skin above this height inks: low is wet, high is dry."""
    patches: float = 0.1
    """By which moisture varies over a print."""
    dropouts: tuple[float, float] = (0.0, 0.45)
    """How much ridges are broken up by dry skin."""
    noise_grey: tuple[float, float] = (4.0, 16.0)
    scratches: int = 3
    """At most."""


DEFAULT = PressRanges()
PULLED = replace(DEFAULT, pull_mm=0.8, twist_deg=6.0)
"""Presses on which skin is strained by up to 40 %."""
SENSORS = {
    "fvc2000_db2b": replace(DEFAULT, half_width_mm=(6.0, 7.5), half_height_mm=(8.0, 9.5)),
    "fvc2000_db3b": replace(DEFAULT, half_width_mm=(7.5, 11.0), half_height_mm=(9.6, 16.0)),
    "fvc2002_db2b": replace(DEFAULT, half_width_mm=(5.0, 9.0), half_height_mm=(6.5, 11.5)),
    "fvc2004_db1b": replace(
        DEFAULT, half_width_mm=(4.5, 9.0), half_height_mm=(6.0, 11.5), stretch_mm=0.6, turn_deg=15.0
    ),
    "fvc2004_db2b": replace(
        DEFAULT,
        half_width_mm=(5.0, 8.5),
        half_height_mm=(6.5, 10.0),
        moisture=(0.3, 0.95),
        dropouts=(0.1, 0.6),
        patches=0.2,
    ),
    "fvc2004_db3b": replace(
        DEFAULT, half_width_mm=(4.8, 8.5), half_height_mm=(6.0, 10.5), noise_grey=(2.0, 6.0)
    ),
}
"""Presses on six models of sensors: as large as the prints of these sets, and as FVC says of the
set."""


def finger(seed: int) -> MasterPrint:
    """The ridges of one finger, of a class by its natural frequency."""
    rng = np.random.default_rng([seed, 21])
    return master_print(
        str(rng.choice(list(FREQUENCIES), p=np.array(list(FREQUENCIES.values())))), seed
    )


def pulled(
    place: NDArray[np.complex128],
    edge: NDArray[np.float64],
    r: PressRanges,
    rng: np.random.Generator,
) -> NDArray[np.complex128]:
    """By how much, mm, skin has slipped at places (H, W), mm, under a pull and a twist; `edge` is 0
    in the middle of the contact and 1 at its rim.

    Source: R. Cappelli, D. Maio and D. Maltoni, "Modelling plastic distortion in fingerprint
    images", ICAPR 2001 (distance from what sticks, brake).
    """
    pull = rng.normal(0, r.pull_mm) + 1j * rng.normal(0, r.pull_mm)
    twist = np.deg2rad(np.clip(rng.normal(0, r.twist_deg), -2 * r.twist_deg, 2 * r.twist_deg))
    stick = rng.uniform(*STICKS)
    brake = 0.5 - 0.5 * np.cos(np.pi * np.clip((edge - stick) / (1.3 - stick), 0, 1))
    shift = brake * (pull + place * (np.exp(1j * twist) - 1))
    strain = max(float(np.abs(part).max()) for part in np.gradient(shift, PITCH_MM))
    return shift * min(1.0, MAX_STRAIN / max(strain, 1e-9))


def press(master: MasterPrint, seed: int, ranges: PressRanges | None = None) -> NDArray[np.uint8]:
    """One print (380, 380) uint8 of a finger."""
    r = ranges or PressRanges()
    rng = np.random.default_rng([master.seed, seed, 22])
    rows, columns = PRINT_SIZE
    down, right = np.mgrid[0:rows, 0:columns].astype(np.float64)
    x, y = (right - (columns - 1) / 2) * PITCH_MM, ((rows - 1) / 2 - down) * PITCH_MM
    half = rng.uniform(*r.half_width_mm), rng.uniform(*r.half_height_mm)
    edge = np.hypot(x / half[0], y / half[1]) + 0.04 * smooth_noise(rng, PRINT_SIZE, 1.5 / PITCH_MM)
    contact = 1 / (1 + np.exp((edge - 1) / 0.015))
    turn = np.deg2rad(np.clip(rng.normal(0, r.turn_deg), -25, 25))
    bent = [r.stretch_mm * smooth_noise(rng, PRINT_SIZE, 4 / PITCH_MM) for _ in range(2)]
    x_skin, y_skin = x, y
    if r.pull_mm or r.twist_deg:
        away = np.hypot(x / half[0], y / half[1])
        slip = pulled(x + 1j * y, away, r, np.random.default_rng([master.seed, seed, 23]))
        x_skin, y_skin = x + slip.real, y + slip.imag
    u = (
        -(np.cos(turn) * x_skin - np.sin(turn) * y_skin)
        + bent[0]
        + np.clip(rng.normal(0, r.across_mm), -5, 5)
    )
    v = (
        np.sin(turn) * x_skin
        + np.cos(turn) * y_skin
        + bent[1]
        + PRESS_CENTRE_MM
        + np.clip(rng.normal(0, r.along_mm), -6, 5)
    )
    pitch = float(master.u_mm[1] - master.u_mm[0])
    skin = cv2.GaussianBlur(
        np.clip(master.ridge - 0.6 * master.pores, 0, 1), (0, 0), 0.4 * PITCH_MM / pitch
    )
    place = (
        ((u - master.u_mm[0]) / pitch).astype(np.float32),
        ((master.v_mm[0] - v) / pitch).astype(np.float32),
    )
    height = cv2.remap(skin, *place, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    level = rng.uniform(*r.moisture) + r.patches * smooth_noise(rng, PRINT_SIZE, 2.5 / PITCH_MM)
    dry = rng.uniform(*r.dropouts) * smooth_noise(rng, PRINT_SIZE, 0.09 / PITCH_MM)
    ink = 1 / (1 + np.exp(-(height - level + dry) / 0.12))
    for _ in range(rng.integers(0, r.scratches + 1)):
        angle = rng.uniform(0, np.pi)
        offset = rng.uniform(-6, 6)
        away = np.abs(np.cos(angle) * x + np.sin(angle) * y - offset)
        ink *= 1 - np.exp(-((away / rng.uniform(0.08, 0.2)) ** 2))
    paper = rng.uniform(215, 250)
    dark = rng.uniform(20, 90)
    grey = (
        paper
        - (paper - dark) * contact * ink
        + rng.normal(0, rng.uniform(*r.noise_grey), PRINT_SIZE)
    )
    soft = cv2.GaussianBlur(grey, (0, 0), 0.6)
    return np.asarray(np.clip(np.round(soft), 0, 255).astype(np.uint8))
