"""Very many simulated fingers as ridge templates, cheaply: ridges grown flat, seen through other fingers' outlines.

Codes are learned on them (the same finger laid down several times, with the true alignment known), and they are the
impostors of large galleries. No body is rolled or unrolled: an impression is a shifted, turned and slightly deformed
piece of a flat wave, cut to the outline (valid skin) of a finger that was simulated in full (``code_fingers.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.io.atomic import atomic_file
from splitknit.model import BoolArray, FloatArray
from splitknit_match.matching.ridge_band import RidgeBandSettings, even
from splitknit_match.matching.template import Template, make_template, pack, unpack
from splitknit_simulator.finger.master_print import (
    FAN_WIDENING,
    PERIOD_VARIATION,
    PROXIMAL_WIDENING,
    MasterPrintSettings,
)
from splitknit_simulator.finger.ridges import (
    OrientationField,
    fan_log_period,
    grow_ridges,
    orientation_field,
    smooth_noise,
)
from splitknit_simulator.population.people import FINGERS, draw_person

PITCH_MM = 0.1
BELOW_TIP_MM = 2.0
"""Of the body's length above the uppermost skin that a camera sees steeply enough, along the skin."""
MARGIN_MM = 4.0
SIZE_MM = (32.0, 26.0)
SMOOTH_MM = 5.0
CHUNK = 250


@dataclass(frozen=True, slots=True, eq=False)
class FlatFinger:
    """The ridges of one finger on a plane."""

    wave: FloatArray
    """(H, W) on a grid of 0.1 mm; the uppermost skin that is seen lies `MARGIN_MM` below the first row."""


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """One impression, and where it lies: place (column, row, 1) in it to place in the wave, without deformation."""

    template: Template
    wave_from_template: NDArray[np.float64]


def log_periods(  # noqa: PLR0917
    field: OrientationField,
    prints: MasterPrintSettings,
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    pitch_mm: float,
    rng: np.random.Generator,
) -> NDArray[np.floating[Any]]:
    """(v, u) logarithm of the ridge period over its mean, drawn as the twin's master prints draw it."""
    logs = PERIOD_VARIATION * np.clip(smooth_noise(rng, (v.size, u.size), 4.0 / pitch_mm), -2.5, 2.5)
    logs += FAN_WIDENING * fan_log_period(field.angle_rad, pitch_mm)
    logs = 0.2 * np.tanh(logs / 0.2)
    centre = field.cores_mm[0][1] * prints.pattern_scale if field.cores_mm else 14.0
    widening = PROXIMAL_WIDENING * rng.uniform(0.4, 1.6)
    logs += (widening * 0.5 * (1.0 - np.tanh((v - 0.45 * centre) / 4.0)))[:, None]
    logs += (rng.uniform(-0.02, 0.08) * np.clip(np.abs(u) / 10.0, 0.0, 1.5) ** 2)[None, :]
    return logs


def flat_finger(seed: int, number: int) -> FlatFinger:
    """One finger of the person `number` of the population `seed` (the ten fingers in turn)."""
    own = draw_person(seed, number).fingers[FINGERS[number % len(FINGERS)]]
    finger, prints = own.finger, own.finger.print_settings
    rng = np.random.default_rng([seed, 0xF1A7, number])
    rows, columns = (round(side / PITCH_MM) for side in SIZE_MM)
    u = (np.arange(columns) - (columns - 1) / 2) * PITCH_MM
    v = finger.shape.length_mm - BELOW_TIP_MM + MARGIN_MM - np.arange(rows) * PITCH_MM
    field = orientation_field(finger.pattern, rng, u / prints.pattern_scale, v / prints.pattern_scale)
    logs = log_periods(field, prints, u, v, PITCH_MM, rng)
    noise = rng.standard_normal((rows, columns)).astype(np.float32)
    wave = grow_ridges(noise, field.angle_rad, prints.period_mm * np.exp(logs) / PITCH_MM, iterations=prints.iterations)
    return FlatFinger(wave)


def laid(finger: FlatFinger, outline: BoolArray, rng: np.random.Generator) -> Laid:
    """Lay the finger down within `outline` (H, W): shifted, turned, swollen, its skin moved by up to 0.5 mm.

    Swelling and skin deformation are the population's. Shifts and turns in the frame of a code are those of full
    simulations (two impressions of 50 fingers of seed 7001: standard deviations of their differences 0.63 mm across,
    0.60 mm along, 3.8 deg).
    """
    rows, columns = outline.shape
    shift = np.array([rng.normal(0.0, 0.45), rng.normal(0.0, 0.42)]) / PITCH_MM
    angle = np.deg2rad(2.7 * float(np.clip(rng.standard_normal(), -3, 3)))
    swelling = 1.0 + 0.015 * float(np.clip(rng.standard_normal(), -2, 2))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) / swelling
    middle = np.array([(columns - 1) / 2, (rows - 1) / 2])
    there = np.array([(finger.wave.shape[1] - 1) / 2, MARGIN_MM / PITCH_MM + (rows - 1) / 2]) + shift
    matrix = np.hstack([turn, (there - turn @ middle)[:, None]])
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    places = np.einsum("ij,jhw->ihw", turn, np.stack([x, y]).astype(np.float64)) + matrix[:, 2][:, None, None]
    moved = np.stack([smooth_noise(rng, outline.shape, SMOOTH_MM / PITCH_MM) for _ in range(2)])
    moved *= rng.uniform(0.2, 0.5) / PITCH_MM / max(float(np.hypot(*moved).max()), 1e-9)
    source = (places + moved).astype(np.float32)
    value = cv2.remap(finger.wave, source[0], source[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    band = even(np.asarray(value, dtype=np.float32), outline, RidgeBandSettings())
    if bool(band.valid.any()):  # a template is cut to what is valid
        first = np.array([band.valid.any(axis=0).argmax(), band.valid.any(axis=1).argmax()], dtype=np.float64)
        matrix[:, 2] += turn @ first
    return Laid(make_template(band), matrix)


def make_flat(folder: Path, seed: int, fingers: int, impressions: int, outlines: list[BoolArray]) -> None:
    """Write impressions of the fingers 1 to `fingers` in files of `CHUNK` fingers; what is there stays."""
    folder.mkdir(parents=True, exist_ok=True)
    for first in range(1, fingers + 1, CHUNK):
        target = folder / f"flat{seed}_{first:05d}.npz"
        if target.is_file():
            continue
        payloads, owners, matrices = [], [], []
        for number in range(first, first + CHUNK):
            finger, rng = flat_finger(seed, number), np.random.default_rng([seed, 0x1A1D, number])
            for _ in range(impressions):
                found = laid(finger, outlines[int(rng.integers(len(outlines)))], rng)
                payloads.append(np.frombuffer(pack(found.template), dtype=np.uint8))
                owners.append(number)
                matrices.append(found.wave_from_template)
        lengths = np.array([len(payload) for payload in payloads])
        with atomic_file(target) as file:
            np.savez(
                file,
                payload=np.concatenate(payloads),
                length=lengths,
                owner=np.array(owners),
                matrix=np.stack(matrices),
            )


def load_flat(folder: Path, seed: int, fingers: int) -> tuple[list[Laid], list[int]]:
    """Impressions of the fingers 1 to `fingers` and their numbers."""
    found, owners = [], []
    for file in sorted(folder.glob(f"flat{seed}_*.npz")):
        with np.load(file) as arrays:
            ends = np.cumsum(arrays["length"])
            payload, owner, matrix = arrays["payload"], arrays["owner"].tolist(), arrays["matrix"]
        for k, end in enumerate(ends):
            if owner[k] <= fingers:
                start = 0 if k == 0 else ends[k - 1]
                found.append(Laid(unpack(payload[start:end].tobytes()), matrix[k]))
                owners.append(owner[k])
    return found, owners
