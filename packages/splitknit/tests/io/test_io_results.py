"""Meshes, height maps, archives, prints, provenance."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from numpy.testing import assert_allclose, assert_array_equal

import splitknit
from refusals import bad_input
from splitknit.io.images import read_header, read_image, write_float_tiff
from splitknit.io.mesh import triangulate, write_ply
from splitknit.io.prints import write_print_png
from splitknit.io.provenance import canonical_json, provenance, settings_hash
from written_files import read_height_tiff, read_ply


def hill(shape=(13, 17)):
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    x, y = columns * 0.1, (shape[0] - 1 - rows) * 0.1
    return x, y, (1 - (x - 0.8) ** 2 - (y - 0.6) ** 2).astype(np.float32)


def test_triangles_face_the_camera_and_cover_the_mask():
    x, y, z = hill()
    mask = np.ones(z.shape, bool)
    mask[3:6, 4:9] = False
    z[10, 11] = np.nan
    valid = mask & np.isfinite(z)
    faces, index = triangulate(valid)
    vertices = np.stack([x[valid], y[valid], z[valid]], axis=1)
    assert faces.dtype == index.dtype == np.int32
    assert_array_equal(index >= 0, valid)
    assert_array_equal(index[valid], np.arange(len(vertices)))
    a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert_allclose(area, 0.005, rtol=1e-3)  # half a pixel each, and never turned over
    squares = np.lib.stride_tricks.sliding_window_view(valid, (2, 2)).sum(axis=(2, 3))
    assert len(faces) == 2 * (squares == 4).sum() + (squares == 3).sum()
    assert len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces)


def test_a_ply_file_keeps_vertices_normals_and_faces(tmp_path):
    x, y, z = hill()
    faces, _ = triangulate(np.isfinite(z))
    vertices = np.stack([x, y, z], axis=-1, dtype=np.float32).reshape(-1, 3)
    rng = np.random.default_rng(0)
    normals = rng.normal(size=vertices.shape).astype(np.float32)
    shade = rng.random(len(vertices)).astype(np.float32)
    write_ply(tmp_path / "m.ply", (vertices, normals, shade), faces, ["units mm", "splitknit"])
    mesh = read_ply(tmp_path / "m.ply")
    assert_array_equal(mesh.vertices_mm, vertices)
    assert_array_equal(mesh.normals, normals)
    assert_array_equal(mesh.quality, shade)
    assert_array_equal(mesh.faces, faces)
    assert mesh.comments == ("units mm", "splitknit")
    data = (tmp_path / "m.ply").read_bytes()
    start = data.index(b"end_header\n") + 11
    assert struct.unpack("<7f", data[start : start + 28]) == (
        *map(float, vertices[0]),
        *map(float, normals[0]),
        float(mesh.quality[0]),
    )
    assert struct.unpack("<B3i", data[start + 28 * len(vertices) :][:13]) == (
        3,
        *map(int, faces[0]),
    )


def test_a_height_tiff_keeps_heights_pitch_and_provenance(tmp_path):
    height = hill()[2]
    height[:3] = np.nan
    path = tmp_path / "h.tiff"
    # tifffile would take the settings of the shape for its own description of an array
    facts = provenance({"shape": {"sigma": 1.5}}, {"white_0.png": "ab"})
    write_float_tiff(path, height, "mm", facts, 1 / 75.7)
    read, pitch_mm, metadata = read_height_tiff(path)
    assert_array_equal(read, height)
    assert pitch_mm == 1 / 75.7
    assert metadata["unit"] == "mm" and metadata["version"] == splitknit.__version__
    assert metadata["inputs"] == {"white_0.png": "ab"}
    assert metadata["settings"] == {"shape": {"sigma": 1.5}}
    with tifffile.TiffFile(path) as file:
        tags = file.pages[0].tags
        numerator, denominator = tags["XResolution"].value
        assert numerator / denominator == pytest.approx(75.7 * 25.4, rel=1e-6)
        assert tags["XResolution"].value == tags["YResolution"].value
        assert tags["ResolutionUnit"].value == 2  # inch
    assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), height)
    first = path.read_bytes()
    write_float_tiff(path, height, "mm", facts, 1 / 75.7)
    assert path.read_bytes() == first


@pytest.mark.parametrize(
    ("shape", "pitch_mm", "words"), [((4, 5), 0.0, "pitch_mm"), ((1, 4, 5), 0.1, "shape")]
)
def test_a_height_tiff_without_pitch_or_of_three_axes_is_refused(shape, pitch_mm, words, tmp_path):
    with bad_input(words):
        write_float_tiff(tmp_path / "h.tiff", np.zeros(shape), "mm", pitch_mm=pitch_mm)


def test_a_print_keeps_its_resolution_and_texts(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (30, 20)).astype(np.uint8)
    text = {"Software": "splitknit 0.1.0", "Comment": "ridges dark, µm", "Title": "指紋"}
    path = tmp_path / "print.png"
    write_print_png(path, image, 500, text)
    data = path.read_bytes()
    stored = read_header(data, "print.png")
    np.testing.assert_array_equal(read_image(path)[..., 0], image)
    assert stored.text == text
    assert stored.ppi == pytest.approx((500, 500), abs=0.01)
    place = data.index(b"pHYs")
    assert struct.unpack(">IIB", data[place + 4 : place + 13]) == (19685, 19685, 1)
    assert place < data.index(b"IDAT")
    assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), image)
    write_print_png(path, image)
    assert read_header(path.read_bytes(), "print.png").text == {}


BLANK = np.zeros((30, 20), np.uint8)


@pytest.mark.parametrize(
    ("words", "arguments"),
    [
        ("uint8", (BLANK.astype(float),)),
        ("uint8", (BLANK[..., None],)),
        ("ppi", (BLANK, 0)),
        ("called", (BLANK, 500, {"": "x"})),
        ("called", (BLANK, 500, {"é": "x"})),
        ("called", (BLANK, 500, {"a" * 80: "x"})),
        ("NUL", (BLANK, 500, {"a": "\0"})),
    ],
)
def test_prints_that_a_png_cannot_hold_are_refused(words, arguments, tmp_path):
    with bad_input(words):
        write_print_png(tmp_path / "print.png", *arguments)


@dataclass(frozen=True)
class Settings:
    sigma: float = 0.1
    path: Path = Path("a/b")
    steps: tuple[int, ...] = (1, 2)


def test_canonical_json_depends_on_values_alone():
    value = {
        "b": np.float32(0.5),
        "a": [np.int64(3), np.bool_(True), None, "ü"],
        "c": Settings(),
        "d": np.eye(2),
    }
    text = canonical_json(value)
    assert text == (
        '{"a":[3,true,null,"\\u00fc"],"b":0.5,"c":{"path":"a/b","sigma":0.1,"steps":[1,2]},'
        '"d":[[1.0,0.0],[0.0,1.0]]}'
    )
    assert canonical_json(json.loads(text)) == text
    assert canonical_json(dict(reversed(value.items()))) == text


def test_the_settings_hash_depends_on_values_alone():
    assert settings_hash(Settings()) == settings_hash(
        {"steps": [1, 2], "path": "a/b", "sigma": 0.1}
    )
    assert settings_hash(Settings()) != settings_hash(Settings(sigma=0.2))


def test_provenance_states_software_settings_and_sorted_inputs():
    facts = provenance(Settings(), {"b": "2", "a": "1"})
    assert facts["software"] == "splitknit"
    assert facts["version"] == splitknit.__version__
    assert facts["settings_sha256"] == settings_hash(Settings())
    assert list(facts["inputs"]) == ["a", "b"]


@pytest.mark.parametrize(
    "value", [float("nan"), np.float32("inf"), {"a": [float("-inf")]}, object()]
)
def test_values_without_a_form_in_json_are_refused(value):
    with bad_input():
        canonical_json(value)
