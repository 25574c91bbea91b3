"""Meshes, height maps, archives, prints, provenance."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import tracemalloc
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

import splitknit
from handmade import finger
from splitknit.errors import BadInput
from splitknit.io.mesh import surface_mesh, write_ply
from splitknit.io.npz import read_npz, write_npz
from splitknit.io.prints import read_print_png, write_print_png
from splitknit.io.provenance import canonical_json, provenance, settings_hash
from splitknit.io.results import write_mesh
from splitknit.io.tiff import write_float_tiff
from written_files import read_height_tiff, read_ply


def hill(shape: tuple[int, int] = (13, 17)) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    x, y = columns * 0.1, (shape[0] - 1 - rows) * 0.1
    return x, y, (1 - (x - 0.8) ** 2 - (y - 0.6) ** 2).astype(np.float32)


def test_triangles_face_the_camera_and_cover_the_mask() -> None:
    x, y, z = hill()
    mask = np.ones(z.shape, bool)
    mask[3:6, 4:9] = False
    z[10, 11] = np.nan
    valid = mask & np.isfinite(z)
    vertices, faces, index = surface_mesh(x, y, z, mask)
    assert vertices.dtype == np.float32
    assert faces.dtype == index.dtype == np.int32
    np.testing.assert_array_equal(vertices, np.stack([x[valid], y[valid], z[valid]], axis=1))
    np.testing.assert_array_equal(index >= 0, valid)
    np.testing.assert_array_equal(index[valid], np.arange(len(vertices)))
    a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    np.testing.assert_allclose(area, 0.005, rtol=1e-3)  # half a pixel each, and never turned over
    squares = np.lib.stride_tricks.sliding_window_view(valid, (2, 2)).sum(axis=(2, 3))
    assert len(faces) == 2 * (squares == 4).sum() + (squares == 3).sum()
    assert len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces)


def test_meshes_of_odd_sizes() -> None:
    for shape in ((1, 1), (1, 5), (5, 1), (2, 2)):
        vertices, faces, _ = surface_mesh(np.arange(shape[1]), np.arange(shape[0])[::-1, None], np.zeros(shape))
        assert vertices.shape == (shape[0] * shape[1], 3)
        assert len(faces) == 2 * (shape[0] - 1) * (shape[1] - 1)
    vertices, faces, _ = surface_mesh(np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3), bool))
    assert vertices.shape == faces.shape == (0, 3)
    with pytest.raises(BadInput, match="y_mm"):
        surface_mesh(np.zeros(3), np.zeros(4), np.zeros((3, 3)))
    with pytest.raises(BadInput, match="mask"):
        surface_mesh(np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 4), bool))


def test_a_mesh_in_bands_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y, z = hill((40, 30))
    z[np.random.default_rng(0).random(z.shape) < 0.2] = np.nan
    whole = surface_mesh(x, y, z)
    monkeypatch.setattr("splitknit.io.mesh._CHUNK", 70)  # two rows
    for found, expected in zip(surface_mesh(x, y, z), whole, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_a_mesh_is_not_held_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splitknit.io.mesh._CHUNK", 1 << 13)
    result, _ = finger(px_per_mm=50.0)
    write_mesh(
        tmp_path / "first.ply", finger()[0], provenance({}, {})
    )  # modules that it loads are not part of the mesh
    tracemalloc.start()
    write_mesh(tmp_path / "m.ply", result, provenance({}, {}))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.4 * (tmp_path / "m.ply").stat().st_size


@pytest.mark.parametrize("size", [(13, 17), (300, 299)])  # below and above one chunk
def test_ply_round_trip(tmp_path: Path, size: tuple[int, int]) -> None:
    vertices, faces, _ = surface_mesh(*hill(size))
    rng = np.random.default_rng(0)
    normals = rng.normal(size=vertices.shape).astype(np.float32)
    shade = rng.integers(0, 256, len(vertices)).astype(np.uint8)
    write_ply(tmp_path / "m.ply", vertices, normals, shade, faces, ["units mm", "splitknit"])
    mesh = read_ply(tmp_path / "m.ply")
    np.testing.assert_array_equal(mesh.vertices_mm, vertices)
    np.testing.assert_array_equal(mesh.normals, normals)
    np.testing.assert_allclose(mesh.quality, shade / 255, atol=1e-7)
    np.testing.assert_array_equal(mesh.faces, faces)
    assert mesh.comments == ("units mm", "splitknit")
    data = (tmp_path / "m.ply").read_bytes()
    start = data.index(b"end_header\n") + 11
    assert struct.unpack("<7f", data[start : start + 28]) == (
        *map(float, vertices[0]),
        *map(float, normals[0]),
        float(mesh.quality[0]),
    )
    assert struct.unpack("<B3i", data[start + 28 * len(vertices) :][:13]) == (3, *map(int, faces[0]))
    write_ply(tmp_path / "cloud.ply", vertices, normals, mesh.quality)
    assert read_ply(tmp_path / "cloud.ply").faces.shape == (0, 3)
    np.testing.assert_array_equal(read_ply(tmp_path / "cloud.ply").quality, mesh.quality)


def test_ply_refuses_what_does_not_fit(tmp_path: Path) -> None:
    points, shade = np.zeros((3, 3), np.float32), np.zeros(3, np.uint8)
    cases: list[tuple[str, tuple[Any, ...]]] = [
        ("vertices_mm", (points[:, :2], points, shade)),
        ("normals", (points, points[:2], shade)),
        ("intensity", (points, points, shade[:2])),
        ("faces must", (points, points, shade, np.zeros((1, 4), np.int32))),
        ("not there", (points, points, shade, np.array([[0, 1, 3]], np.int32))),
        ("not there", (points, points, shade, np.array([[0, 1, -1]], np.int32))),
        ("comment", (points, points, shade, None, ["two\nlines"])),
    ]
    for words, arguments in cases:
        with pytest.raises(BadInput, match=words):
            write_ply(tmp_path / "x.ply", *arguments)
    assert list(tmp_path.iterdir()) == []


def test_height_tiff(tmp_path: Path) -> None:
    height = hill()[2]
    height[:3] = np.nan
    path = tmp_path / "h.tiff"
    write_float_tiff(path, height, "mm", provenance({"sigma": 1.5}, {"white_0.png": "ab"}), 1 / 75.7)
    found, pitch_mm, metadata = read_height_tiff(path)
    np.testing.assert_array_equal(found, height)
    assert pitch_mm == 1 / 75.7
    assert (metadata["unit"], metadata["version"], metadata["inputs"]) == (
        "mm",
        splitknit.__version__,
        {"white_0.png": "ab"},
    )
    with tifffile.TiffFile(path) as file:
        tags = file.pages[0].tags
        numerator, denominator = tags["XResolution"].value
        assert numerator / denominator == pytest.approx(757.0, rel=1e-6)
        assert tags["XResolution"].value == tags["YResolution"].value
        assert tags["ResolutionUnit"].value == 3  # centimetre
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), height)
    first = path.read_bytes()
    write_float_tiff(path, height, "mm", provenance({"sigma": 1.5}, {"white_0.png": "ab"}), 1 / 75.7)
    assert path.read_bytes() == first
    with pytest.raises(BadInput, match="pitch_mm"):
        write_float_tiff(path, height, "mm", pitch_mm=0.0)
    with pytest.raises(BadInput, match="shape"):
        write_float_tiff(path, height[None], "mm", pitch_mm=0.1)


ARRAYS: dict[str, Any] = {
    "height_mm": np.linspace(0, 1, 700_001, dtype=np.float32),
    "fortran": np.asfortranarray(np.arange(12.0).reshape(3, 4)),
    "strided": np.arange(40, dtype=np.int16).reshape(4, 10)[:, ::3],
    "mask": np.array([[True, False]]),
    "pitch_mm": 0.0132,
    "empty": np.zeros((0, 3), np.float32),
    "text": np.array(["whorl", "arch"]),
    "big_endian": np.arange(3, dtype=">i4"),
}


def test_archives(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_npz(path, ARRAYS)
    with np.load(path) as archive:
        assert archive.files == list(ARRAYS)
        for name, value in ARRAYS.items():
            np.testing.assert_array_equal(archive[name], value)
            assert archive[name].dtype == np.asarray(value).dtype
    assert list(read_npz(path)) == list(ARRAYS)
    with zipfile.ZipFile(path) as file:
        assert file.testzip() is None
        assert {info.date_time for info in file.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        members = file.infolist()
    first = path.read_bytes()
    for info in members:  # each stream ends properly, which not every reader insists on
        engine = zlib.decompressobj(-15)
        start = info.header_offset + 30 + len(info.filename)
        engine.decompress(first[start : start + info.compress_size])
        assert engine.eof
    write_npz(path, ARRAYS)
    assert path.read_bytes() == first


def test_an_archive_does_not_depend_on_the_number_of_cores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for cores in (1, 7):
        monkeypatch.setattr("splitknit.io.npz.os.cpu_count", lambda cores=cores: cores)
        write_npz(tmp_path / f"{cores}.npz", ARRAYS)
    assert (tmp_path / "1.npz").read_bytes() == (tmp_path / "7.npz").read_bytes()


def test_archives_that_are_refused(tmp_path: Path) -> None:
    for arrays, words in (({"a/b": 1}, "named"), ({"": 1}, "named"), ({"a": np.array([None])}, "objects")):
        with pytest.raises(BadInput, match=words):
            write_npz(tmp_path / "a.npz", arrays)
    assert list(tmp_path.iterdir()) == []
    write_npz(tmp_path / "a.npz", ARRAYS)
    data = (tmp_path / "a.npz").read_bytes()
    for damaged in (b"", data[:-30], data[:5000] + b"\0" * 50 + data[5050:]):
        (tmp_path / "a.npz").write_bytes(damaged)
        with pytest.raises(BadInput, match="cannot be read"):
            read_npz(tmp_path / "a.npz")


def test_prints_carry_their_resolution_and_texts(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (30, 20)).astype(np.uint8)
    text = {"Software": "splitknit 0.1.0", "Comment": "ridges dark, µm", "Title": "指紋"}
    path = tmp_path / "print.png"
    write_print_png(path, image, 500, text)
    found = read_print_png(path)
    np.testing.assert_array_equal(found.image, image)
    assert found.text == text
    assert found.resolution_ppi == pytest.approx(500, abs=0.01)
    data = path.read_bytes()
    place = data.index(b"pHYs")
    assert struct.unpack(">IIB", data[place + 4 : place + 13]) == (19685, 19685, 1)
    assert place < data.index(b"IDAT")
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), image)
    write_print_png(path, image)
    assert read_print_png(path).text == {}
    for words, arguments in (
        ("uint8", (image.astype(float),)),
        ("uint8", (image[..., None],)),
        ("ppi", (image, 0)),
        ("called", (image, 500, {"": "x"})),
        ("called", (image, 500, {"é": "x"})),
        ("called", (image, 500, {"a" * 80: "x"})),
        ("NUL", (image, 500, {"a": "\0"})),
    ):
        with pytest.raises(BadInput, match=words):
            write_print_png(path, *arguments)


@dataclass(frozen=True)
class Settings:
    sigma: float = 0.1
    path: Path = Path("a/b")
    steps: tuple[int, ...] = (1, 2)


def test_provenance_and_canonical_json() -> None:
    value = {"b": np.float32(0.5), "a": [np.int64(3), np.bool_(True), None, "ü"], "c": Settings(), "d": np.eye(2)}
    text = canonical_json(value)
    assert text == (
        '{"a":[3,true,null,"\\u00fc"],"b":0.5,"c":{"path":"a/b","sigma":0.1,"steps":[1,2]},"d":[[1.0,0.0],[0.0,1.0]]}'
    )
    assert canonical_json(json.loads(text)) == text
    assert canonical_json(dict(reversed(value.items()))) == text
    assert settings_hash(Settings()) == settings_hash({"steps": [1, 2], "path": "a/b", "sigma": 0.1})
    assert settings_hash(Settings()) != settings_hash(Settings(sigma=0.2))
    facts = provenance(Settings(), {"b": "2", "a": "1"})
    assert facts["software"] == "splitknit"
    assert facts["version"] == splitknit.__version__
    assert facts["settings_sha256"] == settings_hash(Settings())
    assert list(facts["inputs"]) == ["a", "b"]
    for wrong in (float("nan"), np.float32("inf"), {"a": [float("-inf")]}, {1: 2}, object()):
        with pytest.raises(BadInput):
            canonical_json(wrong)


def test_importing_io_needs_no_image_library() -> None:
    code = "import sys, splitknit.io; sys.exit(bool({'cv2', 'scipy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
