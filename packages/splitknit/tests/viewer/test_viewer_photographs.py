"""A capture, or a folder of photographs, without a result."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.viewer.catalogue import make_catalogue
from splitknit.viewer.photographs import photographs_of
from viewer_server import Asking

Serve = Callable[..., Asking]


def photographs(folder: Path, lights: str | None = "0 0 1\n1 0 1\n0 1 1\n") -> Path:
    """Three photographs, brighter and brighter, the second of them 16-bit, and a mask."""
    folder.mkdir()
    for k, (name, dtype) in enumerate((("a 1.png", np.uint8), ("a 2.png", np.uint16), ("a 10.png", np.uint8))):
        level = np.iinfo(dtype).max * (k + 1) // 4
        cv2.imwrite(str(folder / name), np.full((40, 60, 3), level, dtype))
    cv2.imwrite(str(folder / "mask.png"), np.full((40, 60), 255, np.uint8))
    (folder / "notes.docx").write_bytes(b"words")
    if lights is not None:
        (folder / "lights.txt").write_text(lights)
    return folder


def test_a_folder_of_photographs_is_shown(asking: Serve, tmp_path: Path) -> None:
    server = asking(photographs(tmp_path / "my photos"))
    catalogue = json.loads(server.get("api/catalogue")[2])
    assert [(one["key"], one["result"]) for one in catalogue["results"]] == [("0", False)]
    meta = json.loads(server.get("api/result/0")[2])
    assert [photo["name"] for photo in meta["photos"]] == ["a 1.png", "a 2.png", "a 10.png"]
    assert meta["photos"][1]["light"] == pytest.approx([0.5**0.5, 0.0, 0.5**0.5])
    assert meta["command"] == f"splitknit reconstruct --images '{tmp_path}/my photos' --out 'my photos-result'"
    assert "notes.docx (not a photograph)" in meta["notes"][0]
    assert ["Mask", "mask.png"] in meta["facts"]
    for number, linear in enumerate((0.25, 0.5, 0.75)):
        status, _, data = server.get(f"api/result/0/photo/{number}?width=32")
        assert status == 200
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape == (21, 32, 3)
        assert picture.mean() == pytest.approx(255 * (1.055 * linear ** (1 / 2.4) - 0.055), abs=2)
    assert server.get("api/result/0/first")[0] == 404
    assert server.get("api/result/0/export/ply")[0] == 404


@pytest.mark.parametrize(
    ("lights", "words"),
    [(None, "No lights.txt"), ("0 0 1\n", "1 lights for 3"), ("0 0 x\n", "line 1"), ("b 0 0 1\n", "names 'b'")],
)
def test_lights_that_do_not_fit_are_reported(tmp_path: Path, lights: str | None, words: str) -> None:
    found = photographs_of(photographs(tmp_path / "photos", lights))
    assert any(words in note for note in found.notes)
    assert [photo.light for photo in found.photos] == [None] * 3
    assert ("--lights FILE" in found.command) == (lights is None)


def test_a_capture_is_shown(shown: Path, asking: Serve) -> None:
    meta = json.loads(asking(shown / "capture").get("api/result/0")[2])
    assert len(meta["photos"]) == 7
    assert all(np.linalg.norm(photo["light"]) == pytest.approx(1) for photo in meta["photos"])
    assert meta["command"].startswith("splitknit reconstruct ") and "--images" not in meta["command"]


def test_links_are_not_shown(tmp_path: Path) -> None:
    folder = photographs(tmp_path / "photos", None)
    (folder / "b.png").symlink_to(folder / "a 1.png")
    assert "b.png" not in [photo.name for photo in photographs_of(folder).photos]


def test_a_folder_of_neither_is_refused(tmp_path: Path) -> None:
    (tmp_path / "words.txt").write_text("words")
    with pytest.raises(BadInput, match="no photograph"):
        make_catalogue([tmp_path])
