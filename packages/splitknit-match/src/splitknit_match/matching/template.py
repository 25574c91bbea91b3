"""The compact template of one finger: the ridge band in four levels, and where it is valid.

A template is what a gallery keeps. Its payload, little-endian: what it is made of (a byte, its
place in :data:`splitknit_match.records.minutiae_record.KINDS`); rows and columns (uint16 each),
number of runs (uint32), pitch in micrometres (uint16); the lengths of alternating runs of missing
and valid pixels in row order (uint16 each, or 65535 and a uint32 for longer ones); two bits for
each valid pixel, the first pixel in the lowest bits; of a surface, the payload of its print; and of
a print, where they were found, its minutiae
(:func:`splitknit_match.records.minutiae_record.pack_minutiae`, with a version of their own). A
finger that could not be acquired is a payload of zero bytes.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.geometry import bounding_box
from splitknit.model import BoolArray, FloatArray
from splitknit_match.matching.ridge_band import RidgeBand
from splitknit_match.records.minutiae_record import (
    KINDS,
    LARGEST_MM2,
    PPI,
    Minutiae,
    holds_minutiae,
    no_minutiae,
    pack_minutiae,
    unpack_minutiae,
)

VERSION = 2
"""Version of the payload; a reader refuses others. Source: definition of the payload."""
_HEAD = struct.Struct("<BHHIH")
_THRESHOLD = 0.98
"""Between a ridge and a high one, in standard deviations. Source: best quantiser of a normal
distribution with four levels (J. Max, 1960)."""
_LEVELS = (-1.51, -0.45, 0.45, 1.51)
"""Values of the four levels, in standard deviations. Source: best quantiser of a normal
distribution with four levels (J. Max, 1960)."""
_SHIFTS = np.array([0, 2, 4, 6], dtype=np.uint8)
"""Place of each of four pixels in a byte. Source: definition of the payload."""
_LONG = 65535
"""Announces a longer run. Source: definition of the payload."""
_NO_MINUTIAE = b"SKMI"
"""In place of the minutiae of a print that has none."""
_CONTACTLESS = bytes([KINDS.index("contactless")])
"""First byte of a surface's print."""
_CHANCE = (-6.257, 1.233, 0.645)
"""Logistic regression behind the chance of a match: offset, weights of the logarithm of the area in
mm2, and of the root of how many minutiae another print is expected to show. Chosen on: real prints
(35 fingers on seven sensors, validation/match/matchability.py)."""


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """One finger, ready to be compared; empty if nothing could be acquired."""

    level: NDArray[np.uint8] = field(repr=False)
    """(H, W) 0 to 3: deep valley, valley, ridge, high ridge; 0 where not `valid`."""
    valid: BoolArray = field(repr=False)
    """(H, W)."""
    pitch_mm: float
    minutiae: Minutiae | None = field(default=None, repr=False)
    """Minutiae of a print; None where none were sought or found."""
    kind: str = "print"
    """What it is made of, one of :data:`KINDS`."""
    flat: Template | None = field(default=None, repr=False)
    """Print of a surface, which is compared with all but surfaces; None where none was made."""
    lacks: str = ""
    """Why nothing could be acquired, where it is known; not kept."""

    @property
    def empty(self) -> bool:
        """Whether the finger could not be acquired."""
        return not bool(self.valid.any())

    @property
    def area_mm2(self) -> float:
        """Skin in the template."""
        return float(self.valid.sum()) * self.pitch_mm**2

    @property
    def chance(self) -> float | None:
        """Chance that another impression of the finger, about as large, matches this one, 0 to 1;
        None where that was not measured: of what is no print, or without minutiae."""
        if self.kind != "print" or self.minutiae is None:
            return None
        found_again = float(self.minutiae.quality.sum()) / 100
        offset, area, minutiae = _CHANCE
        logit = offset + area * math.log(max(self.area_mm2, 1.0)) + minutiae * found_again**0.5
        return round(1 / (1 + math.exp(-logit)), 3)

    @property
    def printed(self) -> Template:
        """As prints are compared with it: a surface by its print."""
        return self.flat or self

    def value(self) -> FloatArray:
        """(H, W) ridge band of about unit variance, zero where not valid."""
        return np.where(self.valid, np.asarray(_LEVELS, dtype=np.float32)[self.level], 0.0)


LEAST_MM2 = 30.0  # smallest area of ridges; less is a failure to acquire


def make_template(band: RidgeBand, least_mm2: float = LEAST_MM2) -> Template:
    """Return the template of a ridge band, cut to what is valid.

    It is empty where less than `least_mm2` is valid: a failure to acquire. Raises BadInput if the
    band is larger than the format allows: larger than any finger.

    >>> import numpy as np
    >>> from splitknit_match.matching.ridge_band import ridge_band
    >>> waves = np.sin(np.arange(200) * 1.4)[None, :] * np.ones((200, 1))
    >>> make_template(ridge_band(waves.astype(np.float32), np.ones((200, 200), bool), 0.1)).empty
    False
    """
    if not band.valid.any() or band.area_mm2 < least_mm2:
        return failed_template(band.pitch_mm)
    box = bounding_box(band.valid)
    valid = np.ascontiguousarray(band.valid[box])
    require(
        _is_a_fingers(valid.shape, round(1000 * band.pitch_mm)),
        f"the ridge band has {valid.shape} pixels, more than a finger's; check the pitch"
        f" ({band.pitch_mm:g} mm).",
    )
    return leveled(band.value[box], valid, band.pitch_mm)


_FINEST_UM = 50
"""Finer pixels count as if they were so large: work grows with their number. Chosen on: speed."""


def _is_a_fingers(shape: tuple[int, ...], pitch_um: int) -> bool:
    """Whether a template of some rows and columns is no larger than one finger's."""
    rows, columns = shape
    area_mm2 = rows * columns * max(pitch_um, _FINEST_UM) ** 2 / 1e6
    return max(shape) <= 2048 and 0 < area_mm2 <= LARGEST_MM2  # rows or columns at most, in px


def leveled(value: FloatArray, valid: BoolArray, pitch_mm: float) -> Template:
    """Template of a ridge band (H, W) in four levels."""
    level = np.digitize(value, (-_THRESHOLD, 0.0, _THRESHOLD)).astype(np.uint8)
    return Template(np.where(valid, level, 0), valid, pitch_mm)


def scaled(template: Template, scale: float) -> Template:
    """The template of a finger that is so many times as large."""
    if template.empty:
        return template
    rows, columns = (max(1, round(side * scale)) for side in template.valid.shape)
    value = np.asarray(cv2.resize(template.value(), (columns, rows)), dtype=np.float32)
    valid = cv2.resize(template.valid.astype(np.float32), (columns, rows)) > 0.5
    larger = replace(leveled(value, valid, template.pitch_mm), kind=template.kind)
    minutiae = template.minutiae
    if minutiae is None:
        return larger
    size = print_size(larger)
    if not minutiae.count:  # and a size of none, where it was read from a file
        return replace(larger, minutiae=no_minutiae(size))
    x, y = (
        np.minimum(np.rint((place + 0.5) * (new / old) - 0.5).astype(np.int32), new - 1)
        for place, new, old in zip(
            (minutiae.x_px, minutiae.y_px), size[::-1], minutiae.size[::-1], strict=True
        )
    )
    return replace(larger, minutiae=replace(minutiae, x_px=x, y_px=y, size=size))


def mirrored(template: Template) -> Template:
    """The template of the same picture seen in a mirror."""
    minutiae = template.minutiae
    if minutiae is not None and minutiae.count:
        x = (minutiae.size[1] - 1 - minutiae.x_px).astype(np.int32)
        minutiae = replace(
            minutiae, x_px=x, direction_rad=(np.pi - minutiae.direction_rad) % (2 * np.pi)
        )
    level = np.ascontiguousarray(template.level[:, ::-1])
    valid = np.ascontiguousarray(template.valid[:, ::-1])
    flat = template.flat and mirrored(template.flat)
    return replace(template, level=level, valid=valid, minutiae=minutiae, flat=flat)


def inverted(template: Template) -> Template:
    """The template of the same picture's negative: ridges and valleys change places, and minutiae
    stay where they are."""
    return replace(template, level=np.where(template.valid, 3 - template.level, 0))


def with_minutiae(template: Template, valid: BoolArray, minutiae: Minutiae) -> Template:
    """`template` with the minutiae of its print, on a grid of 500 ppi whose middle is the
    template's, as they are kept.

    `valid`: (H, W) of the whole band that the template was cut from. Those beyond the template's
    border are left out.
    """
    # directions in steps: the same before and after
    minutiae = unpack_minutiae(pack_minutiae(minutiae))
    if template.empty:
        return replace(template, minutiae=minutiae)
    step = template.pitch_mm * PPI / 25.4
    rows, columns = print_size(template)
    # the band is the mirrored print: its column c lies at the print's column (width - 1) - c step
    row, column = (0.5 * (side.start + side.stop - 1) * step for side in bounding_box(valid))
    x = minutiae.x_px - round(minutiae.size[1] - 1 - column - (columns - 1) / 2)
    y = minutiae.y_px - round(row - (rows - 1) / 2)
    inside = (x >= 0) & (y >= 0) & (x < columns) & (y < rows)
    minutiae = replace(minutiae.taken(inside), x_px=x[inside], y_px=y[inside], size=(rows, columns))
    return replace(template, minutiae=minutiae)


def print_size(template: Template) -> tuple[int, int]:
    """Rows and columns of the grid of its minutiae."""
    step = template.pitch_mm * PPI / 25.4
    rows, columns = (round((side - 1) * step) + 1 for side in template.valid.shape)
    return rows, columns


def failed_template(pitch_mm: float = 0.1) -> Template:
    """Return the template of a failure to acquire."""
    return Template(np.zeros((0, 0), dtype=np.uint8), np.zeros((0, 0), dtype=bool), pitch_mm)


def pack(template: Template) -> bytes:
    """Payload of a template; no bytes for a failure to acquire."""
    if template.empty:
        return b""
    inside = template.valid.ravel()
    edges = np.flatnonzero(np.diff(inside, prepend=False))
    runs = np.diff(edges, prepend=0, append=inside.size)
    kind = KINDS.index(template.kind)
    head = _HEAD.pack(kind, *template.valid.shape, len(runs), round(1000 * template.pitch_mm))
    if runs.max() < _LONG:
        lengths = runs.astype("<u2").tobytes()
    else:
        lengths = b"".join(
            struct.pack("<H", n) if n < _LONG else struct.pack("<HI", _LONG, n)
            for n in runs.tolist()
        )
    level = template.level.ravel()[inside]
    quads = np.pad(level, (0, -len(level) % 4)).reshape(-1, 4)
    packed: NDArray[np.uint8] = (quads << _SHIFTS).sum(axis=1, dtype=np.uint8)
    minutiae = (
        b"" if template.minutiae is None else pack_minutiae(template.minutiae) or _NO_MINUTIAE
    )
    flat = b"" if template.flat is None else pack(template.flat)
    return head + lengths + packed.tobytes() + flat + minutiae


def unpack(payload: bytes) -> Template:
    """Read what :func:`pack` wrote. Raises BadInput if the payload is damaged."""
    if not payload:
        return failed_template()
    require(
        not holds_minutiae(payload),
        "the template holds minutiae, no ridges; compare it by the method minutiae.",
    )
    wrong = "the template's content contradicts itself; enroll the finger again."
    require(len(payload) >= _HEAD.size, wrong)
    number, height, width, count, pitch_um = _HEAD.unpack_from(payload)
    require(height > 0 and width > 0 and pitch_um > 0 and number < len(KINDS), wrong)
    require(0 < count <= height * width + 1 and len(payload) >= _HEAD.size + 2 * count, wrong)
    short = np.frombuffer(payload, "<u2", count, _HEAD.size).tolist()
    runs, position = ([], _HEAD.size) if _LONG in short else (short, _HEAD.size + 2 * count)
    while len(runs) < count:
        require(position + 2 <= len(payload), wrong)
        (length,) = struct.unpack_from("<H", payload, position)
        position += 2
        if length == _LONG:
            require(position + 4 <= len(payload), wrong)
            (length,) = struct.unpack_from("<I", payload, position)
            position += 4
        runs.append(length)
    require(sum(runs) == height * width and all(runs[1:]), wrong)
    require(
        _is_a_fingers((height, width), pitch_um),
        f"the template shows {height * width * pitch_um**2 / 1e6:.0f} mm² in {height} x {width}"
        f" pixels, more than a finger's {LARGEST_MM2:.0f} mm²; enroll one finger.",
    )
    inside = np.repeat(np.arange(count) % 2 == 1, runs)
    known = int(inside.sum())
    end = position + (known + 3) // 4
    require(known > 0 and len(payload) >= end, wrong)
    rest = payload[end:]
    flat, minutiae = None, None
    if KINDS[number] == "surface":
        require(rest[:1] in (b"", _CONTACTLESS), wrong)
        flat = unpack(rest) if rest else replace(failed_template(), minutiae=no_minutiae())
    elif rest:
        require(rest[:4] == _NO_MINUTIAE, wrong)
        minutiae = no_minutiae() if rest == _NO_MINUTIAE else unpack_minutiae(rest)
    packed = np.frombuffer(payload[:end], dtype=np.uint8, offset=position)
    level = np.zeros(height * width, dtype=np.uint8)
    level[inside] = (packed[:, None] >> _SHIFTS & 3).ravel()[:known]
    shape = height, width
    template = Template(
        level.reshape(shape), inside.reshape(shape), pitch_um / 1000, minutiae, KINDS[number], flat
    )
    require(not (minutiae and minutiae.count) or minutiae.size == print_size(template), wrong)
    return template
