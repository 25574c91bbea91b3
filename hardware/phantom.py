"""Draw a phantom for a resin printer: ``python -m hardware.phantom [--out phantom]``.

Half a finger with ridges of known height, period and direction: ``phantom.stl`` (mm),
``height.npz`` (its heights as drawn, a result that ``splitknit compare`` takes as B) and
``phantom.json`` (its fields).
"""

from __future__ import annotations

import json
from argparse import ArgumentParser
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.sizes import Array
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.io.mesh import triangulate
from splitknit.io.provenance import provenance
from splitknit.io.results import write_arrays
from splitknit.model import FloatArray, Reconstruction

PITCH_MM = 0.05
PLATE_MM = (20.0, 34.0)
"""Sides of the plate that carries the half cylinder."""
PLATE_THICK_MM = 2.0
RADIUS_MM = 8.5
"""Radius of the half cylinder."""
STEEPEST_DEG = 62.0
"""Steepest slope of the half cylinder's skirts."""
ENDS_MM = (-14.5, 6.0)
"""Where the half cylinder begins, and where its round tip starts."""
HEIGHTS_UM = (25.0, 50.0, 75.0, 100.0)
"""Heights of ridges from valley to top, a row of fields each."""
PERIODS_MM = (0.35, 0.45, 0.6)
"""Ridge periods of the fields, in turn."""
TURNS_DEG = (0.0, 60.0, 120.0)
"""Directions across the ridges of the fields, in turn."""
FIELD_MM = 4.6
"""Side of a field of ridges, along the skin."""
FIELD_SPACING_MM = 5.2
"""From the middle of a field to that of the next, along the skin."""
MARKS_MM = ((-3.5, 9.0), (0.6, 9.4), (3.0, 8.6), (-0.6, 10.8))
"""Across and along the skin: domes of 0.15 mm that no turn takes to each other."""


def phantom() -> tuple[Reconstruction, list[dict[str, Any]]]:
    """The phantom's surface as drawn, as a result, and its fields of ridges: ``middle_mm`` across
    and along the skin, ``height_um``, ``period_mm``, ``turn_deg``.
    """
    columns, rows = (round(side / PITCH_MM) + 1 for side in PLATE_MM)
    x = (np.arange(columns) - (columns - 1) / 2) * PITCH_MM
    y = (((rows - 1) / 2 - np.arange(rows)) * PITCH_MM)[:, None]
    beside = np.hypot(x, np.maximum(y - ENDS_MM[1], 0.0))
    steep = np.deg2rad(STEEPEST_DEG)
    mask = (beside < RADIUS_MM * np.sin(steep)) & (y > ENDS_MM[0])
    top = np.sqrt(np.maximum(RADIUS_MM**2 - beside**2, 0.0))
    shape = np.where(mask, top - RADIUS_MM * np.cos(steep), 0.0)
    across = RADIUS_MM * np.arcsin(np.clip(x / RADIUS_MM, -1.0, 1.0))
    along = y
    relief: Array = np.zeros(shape.shape)
    fields = []
    for row, high in enumerate(HEIGHTS_UM):
        for column in range(3):
            middle = FIELD_SPACING_MM * (column - 1), ENDS_MM[0] + 3.0 + FIELD_SPACING_MM * row
            period, turn = PERIODS_MM[(row + column) % 3], TURNS_DEG[(row + 2 * column) % 3]
            u, v = across - middle[0], along - middle[1]
            phase = (
                2.0 * np.pi / period * (np.cos(np.deg2rad(turn)) * u + np.sin(np.deg2rad(turn)) * v)
            )
            edge = np.clip((0.5 * FIELD_MM - np.maximum(np.abs(u), np.abs(v))) / 0.4, 0.0, 1.0)
            relief += 1e-3 * high * edge * edge * (3.0 - 2.0 * edge) * (0.5 - 0.5 * np.cos(phase))
            fields.append(
                {"middle_mm": middle, "height_um": high, "period_mm": period, "turn_deg": turn}
            )
    for right, high in MARKS_MM:
        relief += 0.15 * np.clip(
            1.0 - ((across - right) ** 2 + (along - high) ** 2) / 0.36, 0.0, 1.0
        )
    drawn = np.where(mask, shape + relief * RADIUS_MM / np.maximum(top, 1e-3), 0.0)
    height: FloatArray = drawn.astype(np.float32)
    seen = np.where(mask, 1.0, np.nan).astype(np.float32)
    smooth: FloatArray = (shape * seen).astype(np.float32)
    result = Reconstruction(
        height * seen,
        height * seen - smooth,
        smooth,
        mask,
        normals_from_gradients(*height_gradients(height, PITCH_MM)),
        seen,
        PITCH_MM,
        np.eye(3),
        mask.shape,
        "phantom",
        facts={"material": "opaque"},
    )
    return result, fields


def phantom_mesh(result: Reconstruction) -> tuple[FloatArray, NDArray[np.int32]]:
    """The phantom on its plate as a closed mesh: vertices (N, 3) in mm, and faces (M, 3)."""
    rows, columns = result.mask.shape
    x = (np.arange(columns) - (columns - 1) / 2) * result.pitch_mm
    y = ((rows - 1) / 2 - np.arange(rows))[:, None] * result.pitch_mm
    height = np.where(result.mask, result.height_mm, np.float32(0.0))
    faces, index = triangulate(np.isfinite(height))
    vertices = (
        np.stack(np.broadcast_arrays(x, y, height), axis=-1).reshape(-1, 3).astype(np.float32)
    )
    # counter-clockwise
    rim = np.concatenate([index[-1, :-1], index[:0:-1, -1], index[0, :0:-1], index[:-1, 0]])
    below = vertices[rim] * np.array([1, 1, 0]) - np.array([0, 0, PLATE_THICK_MM])
    low = len(vertices) + np.arange(len(rim))
    after = np.roll(rim, -1)
    low_after = np.roll(low, -1)
    middle = np.full(len(rim), len(vertices) + len(rim))
    sides = [(low, low_after, after), (low, after, rim), (middle, low_after, low)]
    closing = np.concatenate([np.stack(side, axis=1) for side in sides]).astype(np.int32)
    points = np.concatenate([vertices, below, [[0, 0, -PLATE_THICK_MM]]])
    return points.astype(np.float32), np.concatenate([faces, closing])


def write_phantom(out: Path) -> dict[str, Any]:
    """Write the phantom; return the facts of ``phantom.json``."""
    result, fields = phantom()
    vertices, faces = phantom_mesh(result)
    triangles = np.zeros(
        len(faces), np.dtype([("normal", "<3f4"), ("corners", "<(3,3)f4"), ("unused", "<u2")])
    )
    triangles["corners"] = vertices[faces]
    size = [*PLATE_MM, round(float(vertices[:, 2].max()) + PLATE_THICK_MM, 3)]
    facts = {
        "pitch_mm": PITCH_MM,
        "size_mm": size,
        "triangles": len(faces),
        "fields": fields,
        "marks_mm": MARKS_MM,
    }
    out.mkdir(parents=True, exist_ok=True)
    header = b"phantom".ljust(80) + np.uint32(len(faces)).tobytes()
    (out / "phantom.stl").write_bytes(header + triangles.tobytes())
    write_arrays(out / "height.npz", result, provenance())
    (out / "phantom.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="ascii")
    return facts


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("phantom"), help="folder to write")
    folder = parser.parse_args().out
    size = " x ".join(f"{side:.1f}" for side in write_phantom(folder)["size_mm"])
    print(
        f"{folder / 'phantom.stl'}: {size} mm; its heights as drawn are B of 'splitknit compare A"
        f" {folder} --out R'."
    )
