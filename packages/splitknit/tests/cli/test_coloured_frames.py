"""``splitknit reconstruct --frames``: colour photographs under three coloured lights at once, each a surface."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.io import photos
from splitknit.io.results import read_result


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """Two frames of a bowl's back, flatter in the second, a mask, and three lights: red, green, blue."""
    lights = np.array([[0.5, 0.0, 0.87], [-0.25, 0.43, 0.87], [-0.25, -0.43, 0.87]])
    y, x = np.mgrid[1:-1:80j, -1:1:80j]
    folder = tmp_path / "frames"
    folder.mkdir()
    for name, steep in (("a", 0.6), ("b", 0.2)):
        normals = np.dstack([steep * x, steep * y, np.ones_like(x)])
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        colours = np.clip(50000 * normals @ lights.T, 0, 65535).astype(np.uint16)
        cv2.imwrite(str(folder / f"{name}.png"), colours[..., ::-1])
    cv2.imwrite(str(folder / "mask.png"), 255 * (np.hypot(x, y) < 0.9).astype(np.uint8))
    np.savetxt(folder / "lights.txt", lights)
    return folder


def test_each_frame_is_a_surface(frames: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    given = ["--images", str(frames), "--px-per-mm", "10", "--encoding", "linear"]
    assert main(["reconstruct", *given, "--frames", "--out", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert sorted(facts["frames"]) == ["a", "b"]
    deep, flat = (
        np.nanmax(one.height_mm) - np.nanmin(one.height_mm) for one in map(read_result, (out / "a", out / "b"))
    )
    assert deep == pytest.approx(0.6 * 0.81 / 2 * 4, rel=0.05)  # slope times radius over two; the side is 8 mm
    assert flat == pytest.approx(deep / 3, rel=0.05)


def test_one_frame_that_cannot_be_used_refuses_all(frames: Path, tmp_path: Path, capsys) -> None:
    given = ["reconstruct", "--images", str(frames), "--px-per-mm", "10", "--frames", "--out", str(tmp_path / "out")]
    cv2.imwrite(str(frames / "c.png"), np.zeros((80, 80), dtype=np.uint8))
    assert main(given) == 2
    assert "c.png" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    (frames / "c.png").rename(frames / "A.tiff")
    assert main(given) == 2
    assert "two photographs of one name" in capsys.readouterr().err
    assert main(["reconstruct", str(frames), "--frames", "--out", str(tmp_path / "out")]) == 2


def test_a_frame_is_decoded_once(frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded: list[str] = []

    def counted(data: bytes, name: str, *, room: int | None = None) -> photos.Photo:
        decoded.append(Path(name).name)
        return decode(data, name, room=room)

    decode = photos.decode_photo
    monkeypatch.setattr(photos, "decode_photo", counted)
    given = ["--images", str(frames), "--px-per-mm", "10", "--frames", "--out", str(tmp_path / "out")]
    assert main(["reconstruct", *given]) == 0
    assert decoded.count("a.png") == decoded.count("b.png") == 1
