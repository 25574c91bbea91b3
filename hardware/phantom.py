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

from splitknit.io.mesh import triangulate
from splitknit.io.provenance import provenance
from splitknit.io.results import write_arrays
from splitknit.model import FloatArray
from splitknit.reconstruction import Reconstruction
from splitknit_rig.calibration.phantom import MARKS_MM, PITCH_MM, PLATE_MM, phantom

PLATE_THICK_MM = 2.0


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
