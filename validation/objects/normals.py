"""Depth from normal maps by `splitknit.surface_of_normals`: mean absolute error in mm, beside that
of Cao et al. 2022.

    python validation/objects/normals.py [FOLDER]

FOLDER (by default `integration` in $SPLITKNIT_DATA) holds a folder for each object, with
`normal_map.png` (16 bit), `mask.png`, `depth_gt.npz` and the camera matrix `K.txt`. Depth is
compared after its scale is aligned by the median. Writes tables/normals.json.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np

import splitknit
from splitknit.io.normal_maps import read_mask, read_normal_map

TABLES = Path(__file__).with_name("tables")
PUBLISHED_MM = {
    "bear": 0.334,
    "buddha": 1.098,
    "cat": 0.074,
    "cow": 0.058,
    "goblet": 9.018,
    "harvest": 1.838,
    "pot1": 0.635,
    "pot2": 0.220,
    "reading": 0.257,
}
"""X. Cao et al., "Bilateral normal integration", ECCV 2022."""


def errors_mm(folder: Path) -> dict[str, float | None]:
    """Error of an object with the camera's rays, and with parallel ones, and the published one."""
    normals, _ = read_normal_map(folder / "normal_map.png")
    shape = normals.shape[:2]
    mask, _ = read_mask(folder / "mask.png", shape)
    with np.load(folder / "depth_gt.npz") as data:
        depth = data[data.files[0]]
    matrix = np.loadtxt(folder / "K.txt")
    distance = float(np.nanmedian(depth[mask]))
    scale = matrix[0, 0] / distance
    camera = splitknit.Camera(scale, shape, distance, "perspective", matrix, (0.0,) * 5)
    figures = {
        "camera_mm": splitknit.surface_of_normals(normals, mask, camera=camera),
        "parallel_mm": splitknit.surface_of_normals(normals, mask, scale),
    }
    rows = {name: _off(depth, distance - each.height_mm) for name, each in figures.items()}
    return {**rows, "published_mm": PUBLISHED_MM.get(folder.name)}


def _off(depth: np.ndarray, estimate: np.ndarray) -> float:
    scaled = np.nanmedian(depth / estimate) * estimate
    return round(float(np.nanmean(np.abs(scaled - depth))), 3)


def main() -> None:
    """Measure all objects of the folder."""
    default = Path(os.environ.get("SPLITKNIT_DATA", "../shared/data")) / "integration"
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    objects = sorted(each.parent for each in folder.glob("*/normal_map.png"))
    rows = {each.name: errors_mm(each) for each in objects}
    TABLES.mkdir(exist_ok=True)
    (TABLES / "normals.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    sys.stdout.write(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
