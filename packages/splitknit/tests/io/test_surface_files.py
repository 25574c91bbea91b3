"""STL and GLB: what is written is read back, by other readers where there are some."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.io.mesh import glb_chunks, stl_chunks, stl_size, surface_mesh
from written_files import read_glb, read_stl


@pytest.fixture
def mesh() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    x = np.linspace(-4, 4, 40)[None, :]
    y = np.linspace(5, -5, 60)[:, None]
    z = np.where(x**2 + y**2 < 16, 3 - 0.1 * (x**2 + y**2), np.nan)
    vertices, faces, _ = surface_mesh(x, y, z)
    normals = np.column_stack([0.2 * vertices[:, 0], 0.2 * vertices[:, 1], np.ones(len(vertices))])
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    return vertices, normals, np.arange(len(vertices)).astype(np.uint8), faces


def test_stl_is_read_back(mesh, tmp_path: Path) -> None:
    vertices, _, _, faces = mesh
    data = b"".join(stl_chunks(vertices, faces, "metric"))
    (tmp_path / "a.stl").write_bytes(data)
    assert data.startswith(b"splitknit, unit mm metric")
    assert len(data) == stl_size(len(faces))
    np.testing.assert_array_equal(read_stl(tmp_path / "a.stl"), vertices[faces])
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    stored = np.frombuffer(data, record, offset=84)
    a, b, c = np.moveaxis(vertices[faces].astype(np.float64), 1, 0)
    across = np.cross(b - a, c - a)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    np.testing.assert_allclose(stored["normal"], across, atol=1e-5)
    assert (stored["normal"][:, 2] > 0).all()


def test_stl_comes_in_pieces(mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, _, _, faces = mesh
    whole = b"".join(stl_chunks(vertices, faces))
    monkeypatch.setattr("splitknit.io.mesh._CHUNK", 100)
    assert b"".join(stl_chunks(vertices, faces)) == whole


def test_glb_is_read_back(mesh, tmp_path: Path) -> None:
    vertices, normals, intensity, faces = mesh
    _, chunks = glb_chunks(vertices, normals, intensity, faces, {"preset": "metric"})
    (tmp_path / "a.glb").write_bytes(b"".join(chunks))
    back = read_glb(tmp_path / "a.glb")
    np.testing.assert_array_equal(back.vertices_mm, vertices)
    np.testing.assert_array_equal(back.normals, normals)
    np.testing.assert_array_equal(back.intensity, intensity)
    np.testing.assert_array_equal(back.faces, faces)
    assert back.metres_per_unit == 0.001
    assert back.extras == {"preset": "metric", "buffer_unit": "mm"}


def test_glb_is_laid_out_as_the_standard_asks(mesh) -> None:
    vertices, normals, intensity, faces = mesh
    size, chunks = glb_chunks(vertices, normals, intensity, faces)
    data = b"".join(chunks)
    assert size == len(data) and size % 4 == 0
    magic, version, total, length, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), b"JSON")
    assert length % 4 == 0
    document = json.loads(data[20 : 20 + length])
    places = document["accessors"][0]
    assert places["min"] == vertices.min(axis=0).astype(float).tolist()
    assert places["max"] == vertices.max(axis=0).astype(float).tolist()
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
    assert document["buffers"][0]["byteLength"] == len(data) - 28 - length
    assert document["nodes"][0]["scale"] == [0.001] * 3  # the buffer's mm in glTF's metres


def test_faces_that_lead_nowhere_are_refused(mesh) -> None:
    vertices, normals, intensity, faces = mesh
    wrong = faces.copy()
    wrong[0, 0] = len(vertices)
    for write in (
        lambda: list(stl_chunks(vertices, wrong)),
        lambda: glb_chunks(vertices, normals, intensity, wrong),
        lambda: glb_chunks(vertices, normals, intensity, faces[:0]),
    ):
        with pytest.raises(BadInput):
            write()
