"""Minutiae in space, ``minutiae3d.json``: where on the finger each lies, and where its ridge runs. No standard exists.

One JSON object::

    {"format": "splitknit-minutiae3d", "version": 1, "finger": "right_index",
     "x_mm": [...], "y_mm": [...], "z_mm": [...], "theta_rad": [...], "phi_rad": [...],
     "type": [1, 2, ...], "quality": [90, 35, ...]}

with lists of one length, and whatever else its writer adds under ``"provenance"``. The frame is that of the upright
finger (``phalange.ply``): x to the right and y to the tip as the camera sees it, z to the camera, in millimetres. It is
not that of the print, which is its mirror image.

Source: A. Kumar and C. Kwong, "Towards contactless, low-cost and accurate 3D fingerprint identification", IEEE Trans.
PAMI 37(3), 2015: minutiae as (x, y, z, theta, phi).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput, Fields, canonical_json, read_json, require, write_file
from splitknit_match.records.minutiae_record import BIFURCATION, FINGER_CODES

FORMAT, VERSION = "splitknit-minutiae3d", 1
_LARGEST_MM = 1000.0
_MAX = 100_000
_NUMBERS = ("x_mm", "y_mm", "z_mm", "theta_rad", "phi_rad")
_WHOLE = {"type": BIFURCATION, "quality": 100}
"""The largest of each."""


@dataclass(frozen=True, slots=True, eq=False)
class Minutiae3D:
    """N minutiae of one finger, in its upright frame."""

    x_mm: NDArray[np.float64]
    """(N,) to the right, as the camera sees it."""
    y_mm: NDArray[np.float64]
    """(N,) towards the tip."""
    z_mm: NDArray[np.float64]
    """(N,) towards the camera."""
    theta_rad: NDArray[np.float64]
    """(N,) azimuth of the minutia's direction, counter-clockwise from x, in [0, 2 pi)."""
    phi_rad: NDArray[np.float64]
    """(N,) its elevation above the plane of x and y, in [-pi/2, pi/2]; the direction is the unit vector
    (cos phi cos theta, cos phi sin theta, sin phi), from an ending back along its ridge, from a bifurcation between its
    branches."""
    type: NDArray[np.uint8]
    """(N,) 1 ridge ending, 2 bifurcation, 0 other."""
    quality: NDArray[np.uint8]
    """(N,) 0 (none known) to 100."""
    finger: str = "unknown"
    """``right_thumb`` to ``left_little``, or ``unknown``."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """What its writer adds: see :func:`splitknit.io.provenance`."""

    def __post_init__(self) -> None:
        shapes = [np.shape(getattr(self, name)) for name in (*_NUMBERS, *_WHOLE)]
        require(
            shapes[0] == (len(self.x_mm),) and len(set(shapes)) == 1,
            f"minutiae in space must be lists of one length, but they have the shapes {shapes}.",
        )
        require(len(self.x_mm) <= _MAX, f"a finger has no {len(self.x_mm)} minutiae (at most {_MAX} are taken).")
        require(self.finger in FINGER_CODES, f"'{self.finger}' is not a finger; choose {', '.join(FINGER_CODES)}.")
        limits = {"theta_rad": (0.0, 2 * np.pi), "phi_rad": (-np.pi / 2, np.pi / 2)}
        for name in _NUMBERS:
            low, high = limits.get(name, (-_LARGEST_MM, _LARGEST_MM))
            values = np.asarray(getattr(self, name))
            within = bool(np.isfinite(values).all() and ((values >= low) & (values <= high)).all())
            require(within, f"{name} of minutiae must be finite numbers from {low:g} to {high:g}; there is another.")
        for name, most in _WHOLE.items():
            values = np.asarray(getattr(self, name))
            within = values.dtype.kind in "iu" and bool(((values >= 0) & (values <= most)).all())
            require(within, f"{name} of minutiae must be whole numbers from 0 to {most}; there is another.")

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.x_mm)

    @property
    def direction(self) -> NDArray[np.float64]:
        """(N, 3) unit vectors."""
        flat = np.cos(self.phi_rad)
        return np.stack([flat * np.cos(self.theta_rad), flat * np.sin(self.theta_rad), np.sin(self.phi_rad)], axis=-1)


def angles_of(direction: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Azimuth theta in [0, 2 pi) and elevation phi of vectors (N, 3) of any length but zero.

    >>> theta, phi = angles_of(np.array([[0.0, 2.0, 0.0], [0.0, 0.0, 1.0]]))
    >>> np.rad2deg(theta[0]).round(6), np.rad2deg(phi).round(6).tolist()
    (np.float64(90.0), [0.0, 90.0])
    """
    vectors = np.asarray(direction, dtype=np.float64)
    length = np.linalg.norm(vectors, axis=-1) if vectors.ndim == 2 and vectors.shape[1] == 3 else np.zeros(1)
    require(
        bool((length > 0).all() and np.isfinite(vectors).all()),
        f"directions must be finite vectors (N, 3), none of them zero, but they have the shape {vectors.shape}.",
    )
    theta = np.arctan2(vectors[:, 1], vectors[:, 0]) % (2 * np.pi)
    return np.where(theta >= 2 * np.pi, 0.0, theta), np.arcsin(np.clip(vectors[:, 2] / length, -1, 1))


def write_minutiae3d(path: str | os.PathLike[str], minutiae: Minutiae3D) -> None:
    """Write minutiae as JSON, whole or not at all; equal minutiae give equal bytes, and are read exactly as they are.
    Raises BadInput if the file cannot be written, or the provenance has no form in JSON.
    """
    document: dict[str, Any] = {"format": FORMAT, "version": VERSION, "finger": minutiae.finger}
    document |= {name: np.asarray(getattr(minutiae, name), dtype=np.float64).tolist() for name in _NUMBERS}
    document |= {name: np.asarray(getattr(minutiae, name)).tolist() for name in _WHOLE}
    if minutiae.provenance:
        document["provenance"] = dict(minutiae.provenance)
    write_file(path, canonical_json(document).encode("ascii") + b"\n")


def read_minutiae3d(path: str | os.PathLike[str]) -> Minutiae3D:
    """Read minutiae that :func:`write_minutiae3d` wrote, or anybody else. Raises BadInput if the file is missing, no
    JSON, of another format or version, or a field is missing or wrong.
    """
    document, _ = read_json(Path(path))
    name = os.fspath(path)
    fields = Fields(document, name)
    fields.format(FORMAT, VERSION)
    known = {"format", "version", "finger", "provenance", *_NUMBERS, *_WHOLE}
    for key in fields.keys():  # noqa: SIM118 - no mapping
        require(key in known, f"{name} has an unknown field {key[:40]!a}; fields are {', '.join(sorted(known))}.")
    columns: dict[str, Any] = {key: _column(fields, key) for key in _NUMBERS}
    whole = {key: _column(fields, key) for key in _WHOLE}
    for key, values in whole.items():
        if bool((values % 1 != 0).any()) or bool((np.abs(values) > 255).any()):
            fields.refuse(key, f"a list of whole numbers from 0 to {_WHOLE[key]}")
        columns[key] = values.astype(np.int16)
    try:
        return Minutiae3D(**columns, finger=fields.text("finger", "unknown"), provenance=fields.mapping("provenance"))
    except BadInput as error:
        raise BadInput(str(error) if name in str(error) else f"{name}: {error}") from error


def _column(fields: Fields, key: str) -> NDArray[np.float64]:
    count = len(fields.items(key))
    return np.array(fields.numbers(key, (count,)), dtype=np.float64)
