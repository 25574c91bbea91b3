"""The published matchers tell a finger from others, on little that is invented."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from script_folder import VALIDATION, Script

FOLDER = VALIDATION / "published"


def skin(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Minutiae on 14 x 20 mm of bent skin: places and directions."""
    rng = np.random.default_rng(seed)
    x, y, ahead = rng.uniform(-7, 7, 60), rng.uniform(-10, 10, 60), rng.uniform(0, 2 * np.pi, 60)
    rise = -x / 7 * np.cos(ahead) - y / 30 * np.sin(ahead)
    along = np.stack([np.cos(ahead), np.sin(ahead), rise], axis=1)
    return np.stack([x, y, -(x**2) / 14 - y**2 / 60], axis=1), along


@pytest.mark.parametrize(("name", "kind"), [("minutiae3d", "Pairs"), ("tetrahedra", "Tetrahedra")])
def test_minutiae_in_space(script: Script, name: str, kind: str) -> None:
    module, minutiae3d = script(name), script("minutiae3d")

    def side(seed: int, turned: bool = False) -> object:
        place, along = skin(seed)
        if turned:  # a quarter lost, all a little off, and moved rigidly
            rng = np.random.default_rng([seed, 1])
            place, along = (
                place[15:] + rng.normal(0, 0.1, (45, 3)),
                along[15:] + rng.normal(0, 0.08, (45, 3)),
            )
            motion, _ = np.linalg.qr(rng.normal(size=(3, 3)))
            motion[:, 0] *= np.linalg.det(motion)
            place, along = place @ motion.T + 20, along @ motion.T
        unit = along / np.linalg.norm(along, axis=1, keepdims=True)
        return getattr(module, kind)(minutiae3d.SpaceMinutiae(place, unit))

    alike = minutiae3d.similarity
    assert alike(side(1), side(1)) == 1.0
    assert alike(side(1), side(1, True)) == alike(side(1, True), side(1)) > 0.4
    assert alike(side(1), side(2, True)) < 0.15


def test_features_that_the_thesis_dropped(script: Script) -> None:
    rng = np.random.default_rng(0)
    image, different = (
        np.kron(rng.random((20, 20)), np.ones((10, 10))).astype(np.float32) for _ in range(2)
    )
    for extract in script("image_features").FEATURES.values():
        still, moved, away = (
            extract(values, 30.0) for values in (image, np.roll(image, 1, axis=1), different)
        )
        assert np.linalg.norm(still - moved) < np.linalg.norm(still - away)


def test_scores_of_people_are_a_score_file(script: Script, tmp_path: Path) -> None:
    scored = script("scored")
    for person in ("S01", "S02"):
        for session in (1, 2):
            folder = tmp_path / "people" / person / f"session_{session}" / "right_index"
            folder.mkdir(parents=True)
            (folder / "capture.json").write_text(person)

    def features(finger: Path, preset: str) -> int:
        return int((finger / "capture.json").read_text()[1:])

    out = tmp_path / "scores.csv"
    words = [str(tmp_path / "people"), "--out", str(out)]
    assert scored.run(features, lambda a, b: float(a == b), "metric", words) == 0
    lines = out.read_text().split()
    assert lines[0] == "label,score,finger_a,finger_b,subject_a,subject_b,session_a,session_b"
    assert [line.split(",")[:2] for line in lines[1:]] == [
        ["1", "1.0"],
        ["0", "0.0"],
        ["0", "0.0"],
        ["1", "1.0"],
    ]
    assert lines[1].endswith(",1,2"), "sessions have the names of splitknit batch's scores"
