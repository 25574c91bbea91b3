"""Photographs of many people become a population, by the script of the thesis's authors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from script_folder import VALIDATION, scripts_of
from splitknit.errors import BadInput
from splitknit.io.capture import read_capture
from splitknit.io.rig import write_rig
from splitknit.nominal import default_rig
from splitknit_match.batch.population import read_population

AZIMUTH = 2 * np.pi * np.arange(7) / 7
PATTERN = "{subject}/day{session}/{finger}/white_{light}.png"
NIR = "{subject}/day{session}/{finger}/ir_{light}.png"
SIZE = (220, 320)


@pytest.fixture(scope="module")
def people():
    """The script validation/thesis/people.py."""
    with scripts_of(VALIDATION / "thesis") as script:
        yield script("people")


def photograph(file: Path, turn: float) -> None:
    """Shading of a ball by a light at the azimuth `turn`; its middle value names the light."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    x, y = (columns - 159.5) / 150.0, (109.5 - rows) / 150.0
    z = np.sqrt(np.clip(1 - x * x - y * y, 0.0, None))
    shade = np.clip(0.35 * (np.cos(turn) * x + np.sin(turn) * y) + 0.94 * z, 0.0, 1.0) * (z > 0.5)
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.rint(200 * shade).astype(np.uint8)).save(file)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Two people, two days, two fingers; of P2, day 2, left thumb one photograph is missing and one
    is doubled."""
    root = tmp_path / "tree"
    for person in ("P1", "P2"):
        for day in (1, 2):
            for finger in ("Right Index", "left_thumb"):
                for led, turn in enumerate(AZIMUTH):
                    folder = root / person / f"day{day}" / finger
                    photograph(folder / f"white_{led}.png", turn)
                    photograph(folder / f"ir_{led}.png", turn + np.pi / 7)
    bad = root / "P2" / "day2" / "left_thumb"
    (bad / "ir_3.png").unlink()
    (bad / "white_04.png").write_bytes((bad / "white_4.png").read_bytes())
    (root / "notes.txt").write_text("mine")
    return root


def test_a_tree_becomes_a_population(people, tree, tmp_path, capsys):
    out, rig = tmp_path / "people", tmp_path / "rig.json"
    write_rig(default_rig(0.1), rig)
    words = [str(tree), "--images", PATTERN, "--nir", NIR, "--lights", str(rig), "--out", str(out)]
    capsys.readouterr()
    assert people.main([*words, "--dry-run"]) == 0
    output = capsys.readouterr().out
    assert not out.exists() and "7 complete captures, 7 would be written" in output
    assert f"S01/session_1/right_index: {tree}/P1/day1/Right Index/white_{{light}}.png" in output
    for fault in (
        "S02, session 2, left thumb (P2 2 left_thumb)",
        "lacks NIR 3",
        "second file for a white light, P2/day2/left_thumb/white_4.png",
        "1 files fit no pattern: notes.txt",
    ):
        assert fault in output
    damaged = tree / "P1" / "day1" / "left_thumb" / "ir_2.png"
    damaged.write_bytes(damaged.read_bytes()[:200])
    assert people.main(words) == 0
    output = capsys.readouterr().out
    assert "6 written" in output and "S01, session 1, left thumb: " in output
    population = read_population(out)
    assert population.planned == 8 and len(population.captures) == 6
    capture = read_capture(out / "S02/session_1/left_thumb")
    assert capture.subject == {"id": "S02", "finger": "left_thumb", "session": 1}
    assert capture.material == "skin" and capture.bands["nir"].leds == tuple(
        (k,) for k in range(7, 14)
    )
    photograph(damaged, AZIMUTH[2] + np.pi / 7)
    assert people.main(words) == 0  # goes on where it was stopped
    assert " 1 written" in capsys.readouterr().out and len(read_population(out).captures) == 7
    (tree / "P3" / "day1").mkdir(parents=True)
    (tree / "P1" / "day1" / "Right Index").rename(tree / "P3" / "day1" / "Right Index")
    with pytest.raises(SystemExit, match="population of other people"):
        people.main(words)


@pytest.mark.parametrize(
    ("names", "finger"),
    [
        ("R2", "right_index"),
        ("L5", "left_little"),
        ("6", "left_thumb"),
        ("left ring finger", "left_ring"),
        ("thumb-r", "right_thumb"),
    ],
)
def test_fingers_are_known_by_many_names(people, tmp_path, names, finger):
    (tmp_path / "a7" / names).mkdir(parents=True)
    (tmp_path / "a7" / names / "1.png").touch()
    tree = people.read_tree(tmp_path, ["{subject}/{finger}/{light}.png"])
    assert [place.folder for place, _ in tree.captures] == [f"S01/session_1/{finger}"]


def test_numbers_of_people_and_sessions_are_kept_where_small(people, tmp_path):
    for person, day in (("P2", "2024-03-01"), ("P3", "2024-03-02"), ("P3", "2024-02-09")):
        (tmp_path / person / day).mkdir(parents=True)
        (tmp_path / person / day / "right_3_0.png").touch()
    tree = people.read_tree(tmp_path, ["{subject}/{session}/{hand}_{finger}_{light}.png"])
    assert [place.folder for place, _ in tree.captures] == [
        "S03/session_1/right_middle", "S02/session_2/right_middle", "S03/session_3/right_middle"
    ]  # fmt: skip
    assert (
        tree.plan["subjects"] == 3
        and "nothing is there of S01, session 1, right middle" in tree.faults[0]
    )


@pytest.mark.parametrize(
    ("pattern", "words"),
    [
        ("{subject}/{light}.png", "lacks {finger}"),
        ("{subject}/{finger}/{light}/a.png", "in the file's name"),
        ("{person}/{finger}/{light}.png", "a field {person}"),
        ("{subject}/{finger}_{light}.png", "none of 1 files"),
    ],
)
def test_patterns_that_cannot_be_are_refused(people, tmp_path, pattern, words):
    (tmp_path / "1.png").touch()
    with pytest.raises(BadInput, match=words.replace("{", r"\{")):
        people.read_tree(tmp_path, [pattern])
