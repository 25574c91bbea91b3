"""What is read of a result, and in which pieces it is handed out."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from handmade import capture_of, finger
from splitknit.errors import BadInput
from splitknit.io.npz import read_npz, write_npz
from splitknit.report.result import write_results
from splitknit.viewer.surface import TILE, ResultSurface, read_surface, section
from written_files import read_ply


@pytest.fixture(scope="module")
def surface(shown: Path) -> ResultSurface:
    return read_surface(shown / "metric")


def test_places_are_those_of_the_mesh(shown: Path, surface: ResultSurface) -> None:
    mesh = read_ply(shown / "metric" / "phalange.ply")
    points = np.stack([surface.x_mm, surface.y_mm, surface.height_mm], axis=-1)[surface.mask]
    np.testing.assert_allclose(points, mesh.vertices_mm, atol=2e-6)
    np.testing.assert_allclose(surface.low_mm, mesh.vertices_mm.min(axis=0), atol=2e-6)
    np.testing.assert_allclose(surface.high_mm, mesh.vertices_mm.max(axis=0), atol=2e-6)
    assert surface.count == len(mesh.vertices_mm)


def test_rays_of_a_perspective_camera_are_kept(tmp_path: Path) -> None:
    result, _ = finger()
    height, width = result.mask.shape
    x = ((np.arange(width) - (width - 1) / 2) * result.pitch_mm)[None, :] * (1 - result.height_mm / 140)
    y = (((height - 1) / 2 - np.arange(height)) * result.pitch_mm)[:, None] * (1 - result.height_mm / 140)
    object.__setattr__(result, "x_mm", x.astype(np.float32))
    object.__setattr__(result, "y_mm", y.astype(np.float32))
    write_results(result, capture_of(result), tmp_path / "result")
    surface = read_surface(tmp_path / "result")
    points = np.stack([surface.x_mm, surface.y_mm, surface.height_mm], axis=-1)[surface.mask]
    np.testing.assert_allclose(points, read_ply(tmp_path / "result" / "phalange.ply").vertices_mm, atol=2e-6)


def read_tile(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Head and fields of the first tile of `data`, as the page reads them."""
    head = np.frombuffer(data, "<i4", 8)
    assert head[0] <= len(data)
    quantum, rows, columns = np.frombuffer(data, "<f8", 1, 32)[0], int(head[4]), int(head[5])
    known = np.frombuffer(data, bool, rows * columns, 40).reshape(rows, columns)
    bytes_ = np.frombuffer(data, np.uint8, 16 * rows * columns, 40 + rows * columns).reshape(4, 4, -1)
    zigzag = np.ascontiguousarray(bytes_.transpose(0, 2, 1)).view("<u4")[..., 0]
    step = (zigzag >> 1).astype(np.int32) ^ -(zigzag & 1).astype(np.int32)
    whole = step.reshape(4, rows, columns).cumsum(axis=2, dtype=np.int32).cumsum(axis=1, dtype=np.int32)
    return head, np.where(known, whole * quantum, np.nan).astype(np.float32)


def test_tiles_hold_every_value_once(surface: ResultSurface) -> None:
    seen = np.zeros(surface.mask.shape, dtype=int)
    for row, column in surface.filled_tiles(1):
        head, (x, y, z, relief) = read_tile(surface.tile(1, row, column))
        top, left = int(head[6]) - surface.corner[0], int(head[7]) - surface.corner[1]
        own = slice(1, min(TILE + 1, z.shape[0] - 1)), slice(1, min(TILE + 1, z.shape[1] - 1))
        rows = slice(top + 1, top + own[0].stop)
        columns = slice(left + 1, left + own[1].stop)
        seen[rows, columns] += 1
        np.testing.assert_allclose(z[own], surface.height_mm[rows, columns], atol=surface.pitch_mm / 2000)
        known = np.isfinite(z[own])
        for values, field in ((x, surface.x_mm), (y, surface.y_mm), (relief, surface.ridge_mm)):
            np.testing.assert_allclose(values[own][known], field[rows, columns][known], atol=surface.pitch_mm / 2000)
    assert (seen[surface.mask] == 1).all()
    assert seen.max() == 1


def test_coarse_points_are_fine_points(surface: ResultSurface) -> None:
    step = surface.strides[0]
    assert step > 1
    head, (_, _, z, _) = read_tile(surface.tile(step, 0, 0))
    top, left = int(head[6]) - surface.corner[0], int(head[7]) - surface.corner[1]
    assert (top, left) == (-step, -step)  # the rim
    there = surface.height_mm[: 4 * step : step, : 4 * step : step]
    np.testing.assert_allclose(z[1:5, 1:5], there, atol=step * surface.pitch_mm / 2000)
    assert np.isnan(z[0]).all()


def test_the_first_view_is_small_and_whole(surface: ResultSurface) -> None:
    data, points = surface.first_view(), 0
    assert len(gzip.compress(data)) < 0.35 * 16 * surface.count / surface.strides[0] ** 2  # of plain floats
    while data:
        head, fields = read_tile(data)
        points += int(np.isfinite(fields[2]).sum())
        data = data[head[0] :]
    assert surface.count / surface.strides[0] ** 2 <= 70_000
    assert 0.9 * surface.count < points * surface.strides[0] ** 2 < 1.4 * surface.count  # rims are there twice


@pytest.mark.parametrize("where", [(3, 0, 0), (1, 99, 0), (1, 0, 99)])
def test_tiles_that_are_not_there_are_refused(surface: ResultSurface, where: tuple[int, int, int]) -> None:
    with pytest.raises(BadInput):
        surface.tile(*where)


@pytest.fixture
def arrays(shown: Path, tmp_path: Path) -> tuple[dict[str, np.ndarray], Path]:
    return read_npz(shown / "metric" / "height.npz"), tmp_path / "result"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ridge_mm": None}, "holds no 'ridge_mm'"),
        ({"height_mm": np.zeros((3, 4), np.float32)}, "'height_mm' has another shape"),
        ({"pitch_mm": np.float64(0.0)}, "has no scale"),
        ({"input_from_upright": np.zeros((3, 3))}, "'input_from_upright'"),
        ({"height_mm": np.full((440, 640), np.nan, np.float32)}, "holds no heights"),
        ({"mask": np.zeros((440, 640), bool)}, "holds no heights"),
        ({"mask": np.zeros(440, bool)}, "another shape"),
        ({"ridge_mm": np.array("text")}, "'ridge_mm' has another shape"),
    ],
)
def test_arrays_of_another_kind_are_refused(arrays, change: dict, words: str) -> None:
    there, folder = arrays
    folder.mkdir()
    there.update(change)
    write_npz(folder / "height.npz", {name: value for name, value in there.items() if value is not None})
    with pytest.raises(BadInput, match=words):
        read_surface(folder)


@pytest.mark.parametrize("damage", ["cut", "flip", "text", "link", "none"])
def test_a_damaged_result_is_refused_in_one_sentence(shown: Path, tmp_path: Path, damage: str) -> None:
    file, data = tmp_path / "height.npz", bytearray((shown / "metric" / "height.npz").read_bytes())
    if damage == "cut":
        file.write_bytes(data[: len(data) // 2])
    elif damage == "flip":
        data[len(data) // 20] ^= 255
        file.write_bytes(data)
    elif damage == "text":
        file.write_text("no arrays")
    elif damage == "link":
        file.symlink_to(shown / "metric" / "height.npz")
    with pytest.raises(BadInput) as refused:
        read_surface(tmp_path)
    assert "\n" not in str(refused.value)
    assert str(tmp_path) in str(refused.value)


def test_arrays_by_columns_are_read(tmp_path: Path) -> None:
    array = np.asfortranarray(np.arange(12.0).reshape(3, 4))
    write_npz(tmp_path / "a.npz", {"a": array})
    np.testing.assert_array_equal(read_npz(tmp_path / "a.npz", ("a",))["a"], array)


def test_a_result_without_a_scale_is_in_pixels(shown: Path, arrays) -> None:
    there, folder = arrays
    folder.mkdir()
    pitch = float(there.pop("pitch_mm"))
    for name in ("height", "ridge", "shape"):
        there[f"{name}_px"] = there.pop(f"{name}_mm") / np.float32(pitch)
    write_npz(folder / "height.npz", there)
    surface, known = read_surface(folder), read_surface(shown / "metric")
    assert (surface.unit.name, surface.pitch_mm, surface.unit.small_per_mm) == ("px", 1.0, 1.0)
    np.testing.assert_allclose(np.array(surface.high_mm) * pitch, known.high_mm, rtol=1e-5)
    cut, wanted = (section(one, (0.0, 3.0 * n), (0.0, 8.0 * n)) for one, n in ((surface, 1 / pitch), (known, 1)))
    assert cut.figures["flat_mm"] == pytest.approx(5.0 / pitch)
    assert cut.figures["relief_um"] * pitch * 1000 == pytest.approx(wanted.figures["relief_um"], rel=1e-3)
    assert cut.figures["ridges"] is None  # their distance is known in mm only
