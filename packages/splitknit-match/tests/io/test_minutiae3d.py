"""Minutiae in space: written, read, refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from io_shared import edit
from splitknit.errors import BadInput
from splitknit_match.records.minutiae3d import Minutiae3D, angles_of, read_minutiae3d, write_minutiae3d


def some(count: int = 5, **changes) -> Minutiae3D:
    random = np.random.default_rng(count)
    theta, phi = angles_of(random.standard_normal((count, 3)))
    fields = {
        "x_mm": random.uniform(-9, 9, count),
        "y_mm": random.uniform(-14, 14, count),
        "z_mm": random.uniform(-6, 0, count),
        "theta_rad": theta,
        "phi_rad": phi,
        "type": random.integers(0, 3, count),
        "quality": random.integers(0, 101, count),
        "finger": "left_ring",
        **changes,
    }
    return Minutiae3D(**fields)


@pytest.mark.parametrize("count", [0, 1, 40])
def test_what_is_written_is_read_exactly(tmp_path: Path, count: int) -> None:
    minutiae = some(count, provenance={"software": "splitknit"})
    write_minutiae3d(tmp_path / "a.json", minutiae)
    read = read_minutiae3d(tmp_path / "a.json")
    for name in ("x_mm", "y_mm", "z_mm", "theta_rad", "phi_rad", "type", "quality"):
        np.testing.assert_array_equal(getattr(read, name), getattr(minutiae, name))
    assert (read.finger, read.count, dict(read.provenance)) == ("left_ring", count, {"software": "splitknit"})
    write_minutiae3d(tmp_path / "b.json", read)
    assert (tmp_path / "b.json").read_bytes() == (tmp_path / "a.json").read_bytes()


def test_the_file_is_as_described(tmp_path: Path) -> None:
    one = Minutiae3D(
        np.array([1.5]), np.array([-2.0]), np.array([0.25]), np.array([1.0]), np.array([-0.5]), np.array([2]),
        np.array([80]), "right_index",
    )  # fmt: skip
    write_minutiae3d(tmp_path / "a.json", one)
    assert json.loads((tmp_path / "a.json").read_text()) == {
        "format": "splitknit-minutiae3d", "version": 1, "finger": "right_index", "x_mm": [1.5], "y_mm": [-2.0],
        "z_mm": [0.25], "theta_rad": [1.0], "phi_rad": [-0.5], "type": [2], "quality": [80],
    }  # fmt: skip
    np.testing.assert_allclose(one.direction, [[0.4741599, 0.7384603, -0.4794255]], atol=1e-6)


@settings(max_examples=50, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(arrays(np.float64, (4, 3), elements=st.floats(-5, 5)))
def test_angles_give_their_direction_again(vectors: np.ndarray) -> None:
    vectors = vectors + np.array([0, 0, 6.0])
    theta, phi = angles_of(vectors)
    assert ((theta >= 0) & (theta < 2 * np.pi)).all()
    again = some(4, theta_rad=theta, phi_rad=phi).direction
    np.testing.assert_allclose(again, vectors / np.linalg.norm(vectors, axis=1)[:, None], atol=1e-7)


def test_directions_must_be_vectors() -> None:
    for bad in (np.zeros((1, 3)), np.array([[np.nan, 0, 1]]), np.ones(3), np.ones((2, 2))):
        with pytest.raises(BadInput, match="finite vectors"):
            angles_of(bad)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"x_mm": np.zeros(4)}, "one length"),
        ({"z_mm": np.full(5, np.inf)}, "z_mm of minutiae must be finite"),
        ({"y_mm": np.full(5, 1001.0)}, "from -1000 to 1000"),
        ({"phi_rad": np.full(5, 1.6)}, "phi_rad"),
        ({"theta_rad": np.full(5, -0.1)}, "theta_rad"),
        ({"type": np.full(5, 3)}, "type of minutiae must be whole numbers from 0 to 2"),
        ({"quality": np.full(5, 1.0)}, "quality of minutiae must be whole"),
        ({"finger": "pinky"}, "'pinky' is not a finger"),
    ],
)
def test_minutiae_are_checked(changes: dict, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        some(**changes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.pop("x_mm"), "x_mm is missing"),
        (lambda d: d.update(format="other"), 'format must be "splitknit-minutiae3d"'),
        (lambda d: d.update(version=2), "version must be 1"),
        (lambda d: d["z_mm"].append(1.0), "one length"),
        (lambda d: d.update(z_mm=["1"] * 5), "finite numbers"),
        (lambda d: d.update(type=[1, 1, 1, 1, 1.5]), "type must be a list of whole numbers"),
        (lambda d: d.update(type=[1, 1, 1, 1, 7]), "type of minutiae"),
        (lambda d: d.update(quality=[1e5] * 5), "quality must be a list of whole numbers"),
        (lambda d: d.update(finger="x"), "'x' is not a finger"),
        (lambda d: d.update(colour=1), "unknown field 'colour'"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, change, words: str) -> None:
    write_minutiae3d(tmp_path / "a.json", some())
    edit(tmp_path / "a.json", change)
    with pytest.raises(BadInput, match=words) as refused:
        read_minutiae3d(tmp_path / "a.json")
    assert "a.json" in str(refused.value)


def test_what_is_no_json_is_refused(tmp_path: Path) -> None:
    for data in (b"", b"[1]", b"{", b"\xff\xfe", b'{"format": NaN}'):
        (tmp_path / "a.json").write_bytes(data)
        with pytest.raises(BadInput, match=r"a\.json"):
            read_minutiae3d(tmp_path / "a.json")
