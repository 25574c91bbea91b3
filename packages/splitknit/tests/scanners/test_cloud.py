"""Point clouds of all formats become the surface that they were sampled from."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.clouds import Cloud, read_cloud
from splitknit.io.mesh import write_ply
from splitknit.io.results import read_result
from splitknit.methods.cloud import CloudView, facing, result_of_cloud

pytest.importorskip("trimesh")
STEP = 0.08


def finger_height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A cylinder with a round tip and ridges, mm."""
    shape = np.sqrt(np.maximum(81.0 - x**2 - np.maximum(y - 5, 0) ** 2, 0.0)) - 4.0
    return shape + 0.02 * np.cos(2 * np.pi * np.hypot(x, y - 2) / 0.5)


def grid_of_points() -> np.ndarray:
    """(H, W, 3), a hole in it and nothing beside the finger."""
    y, x = np.meshgrid(np.arange(12, -12, -STEP), np.arange(-7, 7, STEP), indexing="ij")
    z = finger_height(x, y)
    z[(np.hypot(x - 1, y + 3) < 1) | (np.hypot(x, np.maximum(y - 5, 0)) > 7)] = np.nan
    return np.stack([x, y, z], axis=2)


def turned(points: np.ndarray, degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])


@pytest.fixture(scope="module")
def grid() -> np.ndarray:
    return grid_of_points()


@pytest.fixture(scope="module")
def points(grid) -> np.ndarray:
    flat = grid.reshape(-1, 3)
    return flat[np.isfinite(flat[:, 2])]


def text(rows: np.ndarray, before: str = "", more: str = "") -> bytes:
    return "".join(before + " ".join(f"{one:.5f}" for one in row) + more + "\n" for row in rows.tolist()).encode()


def ply(rows: np.ndarray, kind: str) -> bytes:
    head = f"ply\nformat {kind} 1.0\ncomment a\nelement vertex {len(rows)}\n" + "".join(
        f"property {'double' if kind[0] == 'b' else 'float'} {axis}\n" for axis in "xyz"
    )
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    order = ">" if "big" in kind else "<"
    body = rows.astype(f"{order}f8").tobytes() + b"\3" + bytes(12) if kind[0] == "b" else text(rows) + b"3 0 1 2\n"
    return head.encode() + body


def stl_text(rows: np.ndarray) -> bytes:
    rows = np.concatenate([rows, rows[: -len(rows) % 3]])
    body = b"".join(b"facet normal 0 0 1\nouter loop\n" + text(three, "vertex ") + b"endloop\nendfacet\n"
                    for three in rows.reshape(-1, 3, 3))  # fmt: skip
    return b"solid a\n" + body + b"endsolid a\n"


FORMATS: dict[str, tuple[str, Callable[[np.ndarray], bytes]]] = {
    "little ply": ("ply", lambda p: ply(p, "binary_little_endian")),
    "big ply": ("ply", lambda p: ply(p, "binary_big_endian")),
    "text ply": ("ply", lambda p: ply(p, "ascii")),
    "xyz": ("xyz", text),
    "obj": ("obj", lambda p: b"# a\no finger\n" + text(p, "v ")),
    "coloured obj": ("obj", lambda p: text(p, "v ", " 0.5 0.5 0.5")),
    "text stl": ("stl", stl_text),
}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_keeps_the_points(name: str, points, tmp_path: Path) -> None:
    suffix, write = FORMATS[name]
    (tmp_path / f"a.{suffix}").write_bytes(write(points))
    found = read_cloud(tmp_path / f"a.{suffix}")
    np.testing.assert_allclose(found.points_mm, points, atol=1e-5)
    assert found.kind == suffix.upper()
    assert found.quality is None


@pytest.mark.parametrize("degrees", [0.0, 13.0, -40.0])
def test_a_lattice_of_any_turn_keeps_its_grid(points, degrees: float) -> None:
    rows = turned(points, degrees).astype(np.float32)
    result = result_of_cloud(Cloud(rows, "PLY"))
    assert result.facts["cloud"]["grid"] == "lattice"
    assert result.pitch_mm == pytest.approx(STEP, rel=1e-5)
    assert result.mask.sum() == len(points)
    assert not result.mask[result.mask.shape[0] // 2 :, :].all()
    np.testing.assert_allclose(np.sort(result.height_mm[result.mask]), np.sort(rows[:, 2]), atol=1e-6)
    assert result.facts["yaw_deg"] == pytest.approx(0.0, abs=3.0 + abs(degrees))


def test_own_mesh_comes_back(points, tmp_path: Path) -> None:
    rows = points.astype(np.float32)
    first = result_of_cloud(Cloud(rows, "PLY"))
    first.save(tmp_path / "first")
    assert main(["import", str(tmp_path / "first" / "phalange.ply"), "--out", str(tmp_path / "again")]) == 0
    again = read_result(tmp_path / "again")
    np.testing.assert_array_equal(again.mask, first.mask)
    assert np.nanmax(np.abs(again.height_mm - first.height_mm)) < 0.002
    np.testing.assert_allclose(again.ridge_mm[again.mask], first.ridge_mm[again.mask], atol=1e-5)
    assert (tmp_path / "again" / "height.npz").stat().st_mode & 0o077 == 0


def test_scattered_points_are_fitted_and_the_hole_stays(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-6, 6, 200_000), rng.uniform(-8, 8, 200_000)
    away = np.hypot(x - 1, y + 3) > 1
    rows = np.stack([x, y, finger_height(x, y)], axis=1)[away].astype(np.float32)
    result = result_of_cloud(Cloud(rows, "XYZ"))
    assert result.facts["cloud"]["grid"] == "fitted"
    rows_at, columns_at = np.nonzero(result.mask)
    x_mm, y_mm = rows[:, 0].min() + columns_at * result.pitch_mm, rows[:, 1].max() - rows_at * result.pitch_mm
    error = result.height_mm[result.mask] - finger_height(x_mm, y_mm)
    assert np.sqrt((error**2).mean()) < 0.0015
    assert np.hypot(x_mm - 1, y_mm + 3).min() > 0.9
    assert result.mask.mean() == pytest.approx(1 - np.pi / 192, abs=0.01)


def test_of_two_layers_the_nearer_is_taken(points) -> None:
    below = points * [1, 1, -1] - [0, 0, 3]
    both = np.random.default_rng(1).permutation(np.concatenate([points, below])).astype(np.float32)
    up, down = (result_of_cloud(Cloud(both, "PLY"), CloudView(up)) for up in ("z", "-z"))
    assert np.nanmin(up.height_mm) > -1
    assert np.nanmean(up.height_mm) == pytest.approx(np.nanmean(points[:, 2]), abs=0.05)
    assert np.nanmean(down.height_mm) == pytest.approx(np.nanmean(points[:, 2]) + 3, abs=0.05)


@pytest.mark.parametrize(("axis", "turn"), [("x", [2, 0, 1]), ("-y", [0, 2, 1]), ("y", [0, 2, 1])])
def test_the_view_is_found_along_any_axis(points, axis: str, turn: list[int]) -> None:
    rows = points[:, turn] * ([1, -1, 1] if axis == "-y" else [1, 1, 1])
    up, how = facing(Cloud(rows.astype(np.float32), "PLY"))
    assert how == "shape"
    found = result_of_cloud(Cloud(rows.astype(np.float32), "PLY"))
    assert up["xyz".index(axis[-1])] == (-1 if axis[0] == "-" else 1)
    assert np.nanmean(found.height_mm) == pytest.approx(points[:, 2].mean(), abs=1e-3)


def test_normals_show_the_view(points) -> None:
    normals = np.tile([0.1, 0.0, -0.9], (len(points), 1)).astype(np.float32)
    up, how = facing(Cloud(points.astype(np.float32), "PLY", normals))
    assert how == "normals"
    assert up.tolist() == [0, 0, -1]


def test_units_and_far_clouds(points, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_bytes(text(points / 25.4 + [1000, 0, 0]))
    far = read_cloud(tmp_path / "a.xyz", "in")
    assert "moved" in far.notes[0]
    np.testing.assert_allclose(np.ptp(far.points_mm, axis=0), np.ptp(points, axis=0), atol=1e-3)


BAD = {
    "empty.ply": (b"", "damaged"),
    "short.ply": (b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\nproperty float y\n"
                  b"property float z\nend_header\n" + bytes(20), "damaged"),
    "huge.ply": (b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nproperty float y\n"
                 b"property float z\nend_header\n1 2 3\n", "16 at least"),
    "flat.ply": (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n"
                 b"1 2\n", "damaged"),
    "words.xyz": (b"1 2 3\n4 five 6\n", "damaged"),
    "few.xyz": (b"1 2 3\n4 5 6\n", "16 at least"),
    "wide.xyz": (b"".join(b"%d 0 %d\n" % (k * k, k) for k in range(99)), "check its unit"),
    "ragged.xyz": (b"1 2 3\n4 5\n", "damaged"),
    "nothing.obj": (b"# no vertex\n", "no point"),
    "binary.stl": (bytes(84), "no point"),
    "far.ply": (b"ply\nformat binary_little_endian 1.0\nelement vertex 20\nproperty float x\nproperty float y\n"
                b"property float z\nend_header\n" + (np.arange(60, dtype="<f4") + 4e7).tobytes(), "4 mm apart"),
    "centimetres.xyz": (text(grid_of_points()[20:-20:2, 20:-20:2].reshape(-1, 3) / 10), "width is 1"),
    "rounded.xyz": (text(np.round(grid_of_points()[::2, ::2].reshape(-1, 3), 1)), "rounded to 0.1 mm"),
    "random.xyz": (text(np.random.default_rng(0).uniform(0, 10, (5000, 3))), "is not a surface"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_sentence(name: str, tmp_path: Path, capsys) -> None:
    data, words = BAD[name]
    (tmp_path / name).write_bytes(data)
    assert main(["import", str(tmp_path / name), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert re.search(words, said), said
    assert name in said
    assert [one.name for one in tmp_path.iterdir()] == [name]


def test_options_that_do_not_fit_are_refused(points, tmp_path: Path, capsys) -> None:
    (tmp_path / "a.xyz").write_bytes(text(points[:99]))
    out = ["--out", str(tmp_path / "out")]
    for more, words in (
        (["--px-per-mm", "20"], "--px-per-mm does not go"),
        (["--pitch", "0"], "--pitch must be"),
        ([str(tmp_path / "a.xyz")], "one at a time"),
    ):
        assert main(["import", str(tmp_path / "a.xyz"), *more, *out]) == 2
        assert words in capsys.readouterr().err
    assert main(["import", "print.png", "--up=-x", *out]) == 2
    assert "--up goes with a point cloud" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_surface_needs_a_sensible_pitch(points) -> None:
    for pitch in (1e-4, 9.0):
        with pytest.raises(BadInput, match="pitch"), contextlib.suppress(MemoryError):
            result_of_cloud(Cloud(points.astype(np.float32), "PLY"), CloudView(pitch_mm=pitch))
    with pytest.raises(BadInput, match="check its unit"):
        result_of_cloud(Cloud((points * 1000).astype(np.float32), "PLY"))


def test_the_mesh_writer_is_read(tmp_path: Path, points) -> None:
    rows = points.astype(np.float32)
    write_ply(
        tmp_path / "a.ply", rows, np.tile(np.float32([0, 0, 1]), (len(rows), 1)), np.full(len(rows), 128, np.uint8)
    )
    cloud = read_cloud(tmp_path / "a.ply")
    np.testing.assert_array_equal(cloud.points_mm, rows)
    assert cloud.normals is not None and cloud.quality is not None
    np.testing.assert_allclose(cloud.quality, 128 / 255, atol=1e-6)
