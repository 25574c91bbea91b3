"""Ridge fields of very many simulated fingers, cheapest of all: directions and periods as drawn, no ridges grown.

From them codes are learned, and they are the impostors of galleries of ten thousand and more. That impostors made by
this method score like impostors whose ridges were grown or seen on true surfaces is checked by ``codes.py``.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from flat_fingers import BELOW_TIP_MM, log_periods

from splitknit.io.atomic import atomic_file
from splitknit.model import FloatArray
from splitknit_match.matching.code import CELLS, CHANNELS, COLUMNS, ROWS, STEP_MM, code_field
from splitknit_match.matching.template import Template
from splitknit_simulator.finger.ridges import orientation_field
from splitknit_simulator.population.people import FINGERS, OwnFinger, draw_person

PITCH_MM = 0.5
MARGIN = 4
"""Grid pixels beyond the grid of a code, all around."""
WINDOW_MM = 0.7
SHIFT_MM = (0.45, 0.42)
CHUNK = 500


@lru_cache(maxsize=1)
def frequency_of_period() -> tuple[FloatArray, FloatArray]:
    """Periods (mm) and the frequency channel of straight ridges of that period."""
    periods = np.linspace(0.28, 0.9, 26)
    found = []
    for period in periods:
        wave = np.sqrt(2.0) * np.sin(2 * np.pi * np.arange(160) * 0.1 / period)
        level = np.digitize(np.tile(wave, (160, 1)), (-0.98, 0.0, 0.98)).astype(np.uint8)
        field = code_field(Template(level, np.ones(level.shape, dtype=np.bool_), 0.1))
        found.append(float(np.median(field.maps[2])))
    return periods.astype(np.float32), np.array(found, dtype=np.float32)


def field_of(own: OwnFinger, rng: np.random.Generator) -> FloatArray:
    """(CHANNELS, CELLS) channels of a finger on the grid of a code, complete, in a frame that is off as frames are."""
    prints, shape = own.finger.print_settings, own.finger.shape
    per = round(STEP_MM / PITCH_MM)
    columns, rows = (COLUMNS - 1) * per + 1 + 2 * MARGIN, (ROWS - 1) * per + 1 + 2 * MARGIN
    u = (np.arange(columns) - (columns - 1) / 2) * PITCH_MM + rng.normal(0.0, SHIFT_MM[0])
    top = shape.length_mm - BELOW_TIP_MM - STEP_MM + rng.normal(0.0, SHIFT_MM[1])
    v = top + (MARGIN - np.arange(rows)) * PITCH_MM
    field = orientation_field(own.finger.pattern, rng, u / prints.pattern_scale, v / prints.pattern_scale)
    logs = log_periods(field, prints, u, v, PITCH_MM, rng)
    turn = np.deg2rad(rng.normal(0.0, 2.7))
    across = 2 * (field.angle_rad + 0.5 * np.pi + turn)
    frequency = np.interp(prints.period_mm * np.exp(logs), *frequency_of_period())
    maps = np.stack([np.cos(across), np.sin(across), frequency], axis=2).astype(np.float32)
    # the window's mean, and the template's own low-pass, as ridge_field takes them
    maps = cv2.GaussianBlur(maps, (0, 0), WINDOW_MM / PITCH_MM, borderType=cv2.BORDER_REFLECT_101)
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, MARGIN + (10.0 - STEP_MM) / PITCH_MM), np.rad2deg(turn), 1.0)
    maps = cv2.warpAffine(maps, matrix, (columns, rows), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    inner = maps[MARGIN : rows - MARGIN : per, MARGIN : columns - MARGIN : per]
    return np.ascontiguousarray(inner.transpose(2, 0, 1).reshape(3, CELLS))


def make_fields(folder: Path, seed: int, count: int) -> None:
    """Write fields of the ten fingers of the people 1, 2 ... of the population `seed`, in files of 500."""
    folder.mkdir(parents=True, exist_ok=True)
    for first in range(0, count, CHUNK):
        target = folder / f"field{seed}_{first:06d}.npy"
        if target.is_file():
            continue
        found = np.empty((CHUNK, CHANNELS, CELLS), dtype=np.float16)
        for n in range(first, first + CHUNK):
            number, place = divmod(n, len(FINGERS))
            if place == 0:
                person = draw_person(seed, number + 1)
            found[n - first] = field_of(person.fingers[FINGERS[place]], np.random.default_rng([seed, 0xF1E1, n]))
        with atomic_file(target) as file:
            np.save(file, found)


def load_fields(folder: Path, seed: int, count: int) -> FloatArray:
    """(count, CHANNELS, CELLS) of the fingers that are there, at most `count`."""
    files = sorted(folder.glob(f"field{seed}_*.npy"))
    return np.concatenate([np.load(file) for file in files]).astype(np.float32)[:count]
