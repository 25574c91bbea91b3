"""How far presets are from objects of known normals: the script on a hemisphere, and on bad
input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of


@pytest.fixture(scope="module")
def objects():
    with scripts_of(VALIDATION / "accuracy") as script:
        yield script("objects")


@pytest.fixture
def hemisphere(tmp_path: Path) -> Path:
    """A matt ball under eight lights."""
    y, x = (30 - np.mgrid[0:61, 0:61][0]) / 28, (np.mgrid[0:61, 0:61][1] - 30) / 28
    mask = np.hypot(x, y) < 0.8
    normals = np.where(
        mask[..., None], np.dstack([x, y, np.sqrt(np.clip(1 - x * x - y * y, 0, None))]), 0.0
    )
    azimuth = np.arange(8) * np.pi / 4
    lights = np.stack(
        [0.4 * np.cos(azimuth), 0.4 * np.sin(azimuth), np.full(8, np.sqrt(0.84))], axis=1
    )
    images = np.round(40000 * np.clip(np.einsum("hwi,li->lhw", normals, lights), 0, None)).astype(
        np.uint16
    )
    np.savez(tmp_path / "ball.npz", images=images, lights=lights, mask=mask, normals=normals)
    return tmp_path / "ball.npz"


def test_a_matt_ball_is_found(objects, hemisphere: Path) -> None:
    ball = objects.scanned(hemisphere)
    measured, surface = objects.errors_of(ball, range(8), "ea", {})
    assert measured < 0.1 and surface < 0.6
    turned = objects.Object(
        ball.name, ball.images, ball.lights[:, [1, 0, 2]], ball.mask, ball.normals
    )
    assert objects.errors_of(turned, range(8), "ea", {})[0] > 20  # lights in a wrong frame show


def test_a_file_without_truth_is_refused(objects, tmp_path: Path, capsys) -> None:
    np.savez(tmp_path / "bare.npz", images=np.zeros((3, 4, 4), np.uint16))
    assert objects.main([str(tmp_path / "bare.npz")]) == 2
    assert "has no lights, mask, normals" in capsys.readouterr().err
