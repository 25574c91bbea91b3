"""STL: what is written is read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.io.mesh import stl_chunks, surface_mesh
from written_files import read_stl


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
    assert len(data) == 84 + 50 * len(faces)
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


def test_faces_that_lead_nowhere_are_refused(mesh) -> None:
    vertices, _, _, faces = mesh
    wrong = faces.copy()
    wrong[0, 0] = len(vertices)
    with pytest.raises(BadInput):
        list(stl_chunks(vertices, wrong))
