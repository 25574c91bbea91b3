"""Do COLMAP's readers accept a surface and its normal map, and do they mean the same?

    pip install pycolmap
    python validation/objects/in_colmap.py

A rendered relief is reconstructed. COLMAP simplifies its `surface.ply`, and makes points with
normals of its height and normal map, given as depth map and normal map of one view; these are
compared with the surface. Writes tables/colmap.json.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from render import PX_PER_MM, rendered
from scipy.spatial import cKDTree

import splitknit
from splitknit.reconstruction import Reconstruction
from splitknit.report.result import write_results

TABLES = Path(__file__).with_name("tables")
DISTANCE_MM = 1e4
"""Of COLMAP's camera, which is perspective, from the plane z = 0: so far away that its rays are
parallel to 0.1 deg."""
PLY = {"float": "<f4", "uchar": "u1"}


def write_view(result: Reconstruction, folder: Path) -> None:
    """A workspace of COLMAP's dense reconstruction with one view: camera, photograph, depth map and
    normal map. COLMAP's axes are x right, y down and z away from the camera; lengths are mm."""
    for part in ("images", "sparse", "stereo/depth_maps", "stereo/normal_maps"):
        (folder / part).mkdir(parents=True)
    rows, columns = result.mask.shape
    grey = np.rint(255 * np.clip(np.nan_to_num(result.albedo), 0, 1)).astype(np.uint8)
    cv2.imwrite(str(folder / "images/view.png"), np.repeat(grey[..., None], 3, axis=2))
    focal = DISTANCE_MM * PX_PER_MM
    camera = f"1 PINHOLE {columns} {rows} {focal} {focal} {columns / 2} {rows / 2}\n"
    (folder / "sparse/cameras.txt").write_text(camera)
    (folder / "sparse/images.txt").write_text("1 1 0 0 0 0 0 0 1 view.png\n\n")
    (folder / "sparse/points3D.txt").write_text("")
    (folder / "stereo/fusion.cfg").write_text("view.png\n")
    depth = np.where(result.mask, DISTANCE_MM - result.height_mm, 0)[..., None]
    normals = np.where(result.mask[..., None], result.normals * (1, -1, -1), 0)
    for part, each in (("depth_maps", depth), ("normal_maps", normals)):
        # channel after channel; pycolmap's own NormalMap.from_array mixes them (4.2.1)
        data = np.ascontiguousarray(np.moveaxis(each, 2, 0), dtype="<f4").tobytes()
        header = f"{columns}&{rows}&{each.shape[2]}&".encode("ascii")
        (folder / f"stereo/{part}/view.png.geometric.bin").write_bytes(header + data)


def read_points(path: Path) -> tuple[np.ndarray, np.ndarray, int]:
    """Places and normals (N, 3) of a binary PLY file, NaN without normals, and its number of
    faces."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    words = [line.split() for line in data[:end].decode("ascii").splitlines()]
    counts = {line[1]: int(line[2]) for line in words if line[0] == "element"}
    kind = np.dtype([(w[2], PLY[w[1]]) for w in words if w[0] == "property" and w[1] in PLY])
    points = np.frombuffer(data, kind, counts["vertex"], end)

    def columns(names: str) -> np.ndarray:
        known = set(names.split()) <= set(points.dtype.names)
        parts = [points[n] if known else np.full(len(points), np.nan) for n in names.split()]
        return np.stack(parts, axis=1).astype(np.float64)

    return columns("x y z"), columns("nx ny nz"), counts.get("face", 0)


def compared(result: Reconstruction, folder: Path) -> dict[str, float | int | str]:
    """What COLMAP makes of the mesh and of the maps."""
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.WARNING
    write_results(result, None, folder / "result")
    own, own_normals, faces = read_points(folder / "result/surface.ply")
    pycolmap.simplify_mesh(folder / "result/surface.ply", folder / "simplified.ply")
    simplified, _, faces_left = read_points(folder / "simplified.ply")
    off_box = np.ptp(simplified, axis=0) - np.ptp(own, axis=0)

    write_view(result, folder / "view")
    options = pycolmap.StereoFusionOptions(min_num_pixels=1)
    pycolmap.stereo_fusion(
        folder / "fused.ply", folder / "view", options=options, output_type="ply"
    )
    fused, normals, _ = read_points(folder / "fused.ply")
    turned = np.array([1, -1, -1])
    places = fused * turned + (0, 0, DISTANCE_MM)
    tree = cKDTree(own)
    off, _ = tree.query(places)
    # fusion takes a pixel's middle at its column and row, cameras half a pixel further
    half_mm = np.array([0.5, -0.5, 0]) / PX_PER_MM
    off_without_half, nearest = tree.query(places + half_mm)
    cosine = np.einsum("ni,ni->n", normals * turned, own_normals[nearest])
    return {
        "pycolmap": pycolmap.__version__,
        "mesh_faces": faces,
        "simplified_faces": faces_left,
        "size_changed_mm": round(float(np.abs(off_box).max()), 4),
        "pixels": int(result.mask.sum()),
        "fused_points": len(fused),
        "fused_off_mm": round(float(np.max(off)), 4),
        "fused_off_without_half_pixel_mm": round(float(np.max(off_without_half)), 4),
        "fused_normals_off_deg": round(
            float(np.rad2deg(np.median(np.arccos(np.minimum(cosine, 1.0))))), 3
        ),
    }


def main() -> None:
    """Reconstruct, hand over, compare."""
    thing = rendered(82, shape="relief")
    result = splitknit.reconstruct_images(
        thing.images, thing.lights, thing.mask, px_per_mm=PX_PER_MM
    )
    with tempfile.TemporaryDirectory() as folder:
        row = compared(result, Path(folder))
    text = json.dumps(row, indent=1) + "\n"
    (TABLES / "colmap.json").write_text(text, encoding="utf-8")
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
