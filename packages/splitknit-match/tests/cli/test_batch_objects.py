"""``splitknit batch`` of things that are no fingers."""

import shutil

import cv2
import numpy as np

import splitknit
from enrolled import facts_of, refusal_of, words_of

SIDE = 60
LIGHTS = np.array([[0.6, 0, 0.8], [-0.6, 0, 0.8], [0, 0.6, 0.8], [0, -0.6, 0.8], [0.36, 0.48, 0.8]])


def write_object(folder, bend):
    folder.mkdir(parents=True)
    y, x = np.mgrid[1 : -1 : SIDE * 1j, -1 : 1 : SIDE * 1j]
    normals = np.dstack([bend * x, bend * y, np.ones_like(x)])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    for number, light in enumerate(LIGHTS):
        image = np.round(50_000 * np.clip(normals @ light, 0, 1)).astype(np.uint16)
        cv2.imwrite(str(folder / f"photo_{number}.png"), image)


def test_objects_are_reconstructed_each_into_a_folder_of_its_name(tmp_path, capsys):
    coins, out = tmp_path / "coins", tmp_path / "results"
    for number, bend in ((2, 0.3), (10, 0.5), (11, 0.4)):
        write_object(coins / f"coin_{number}", bend)
    np.savetxt(tmp_path / "lights.txt", LIGHTS)
    words = [
        "batch", coins, "--out", out, "--lights", tmp_path / "lights.txt", "--px-per-mm", 10,
        "--mask", "all",
    ]  # fmt: skip
    shutil.copy(tmp_path / "lights.txt", coins / "coin_11" / "photo_5.png")  # no picture
    assert "1 of 3 objects were not reconstructed" in refusal_of(capsys, *words)
    (coins / "coin_11" / "photo_5.png").unlink()
    facts = facts_of(capsys, *words)
    assert (list(facts["objects"]), facts["found"]) == (["coin_11"], 2)
    assert splitknit.read_result(out / "coin_10").pitch_mm == 0.1
    assert "0 objects reconstructed now, 3 were there" in words_of(capsys, *words)
    assert "--cases is for fingers" in refusal_of(capsys, *words, "--cases", "ea")


def test_a_folder_without_photographs_is_refused(tmp_path, capsys):
    (tmp_path / "empty" / "a").mkdir(parents=True)
    words = refusal_of(capsys, f"batch {tmp_path}/empty --out {tmp_path}/out")
    assert "or of folders of photographs" in words
