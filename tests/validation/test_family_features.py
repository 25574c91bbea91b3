"""The measurement of Kumar's and Lin's features runs, goes on where it stopped, and counts failures to acquire."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from script_folder import Script, scripts_of
from splitknit.errors import BadInput
from splitknit.finger.orientation import find_upright
from splitknit.model import Surface, default_rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface

FOLDER = Path(__file__).resolve().parents[2] / "validation" / "family"
PATTERNS = ("left_loop", "whorl", "right_loop", "left_loop")


@pytest.fixture(scope="module")
def script() -> Iterator[Script]:
    with scripts_of(FOLDER) as named:
        yield named


def true_surface(name: str) -> Surface:
    """What a perfect reconstruction of a small capture would give."""
    subject, session, finger = name.split("/")
    seed = 10 * int(subject[1:]) + ("right_thumb", "right_index").index(finger)
    pose = FingerPose(insertion_mm=25.0 + int(session[-1]), yaw_rad=0.05 * int(session[-1]))
    camera = default_rig(0.2).camera
    seen = finger_surface(draw_finger(seed, PATTERNS[seed % 4]), pose, camera)
    upright = find_upright(seen.mask)
    ridge = (seen.height_mm - seen.shape_mm).astype(np.float32)
    place = upright.input_from_upright, upright.size
    return Surface(ridge, seen.shape_mm, seen.normals, seen.mask, camera.pitch_mm, *place)


@pytest.mark.slow
def test_it_measures(script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    pytest.importorskip("nbis")
    features = script("features")
    monkeypatch.setattr(features, "FINGERS", ("right_thumb", "right_index"))
    names = features.captures("tuned")
    assert len(names) == 8
    folder = tmp_path / "kumar"

    def surface(name: str) -> Surface:
        if name == "S02/session_2/right_index":
            raise BadInput("there is no finger.")
        return true_surface(name)

    assert features.make(surface, names, folder) == 8
    assert features.make(surface, names, folder) == 0
    out = tmp_path / "features.json"
    arguments = ["report", "--work", str(tmp_path), "--part", "tuned", "--out", str(out), "--replicates", "50"]
    assert features.main(arguments) == 0
    capsys.readouterr()
    figures = json.loads(out.read_text())["kumar"]["tuned"]
    assert figures["captures"] == 8
    assert set(figures["failures_to_acquire"].values()) == {1}
    assert set(figures["methods"]) >= {*features.METHODS, "minutiae + minutiae3d"}
    for name in features.METHODS:
        one = figures["methods"][name]
        assert one["pairs"] == [3, 9]
        assert one["least_and_median_genuine"][1] > one["median_and_largest_impostor"][0]
        assert one["d_prime"][1] <= one["d_prime"][0] <= one["d_prime"][2]
    assert features.main(["table", "--out", str(out)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(figures["methods"])
    assert lines[2].startswith("| kumar | tuned, 3 | minutiae | ")
