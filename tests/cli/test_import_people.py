"""White and near-infrared photographs of one finger and of many people become captures, by one command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import splitknit
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.capture import read_capture
from splitknit.io.photo_tree import read_tree
from splitknit_match.batch.population import read_population

AZIMUTH = 2 * np.pi * np.arange(7) / 7
THESIS = Path(__file__).resolve().parents[2] / "examples" / "thesis_tips.csv"
PATTERN = "{subject}/day{session}/{finger}/white_{light}.png"
NIR = "{subject}/day{session}/{finger}/ir_{light}.png"
SIZE = (220, 320)
CIRCLE = ("--px-per-mm", "7.57", "--led-height-cm", "14", "--led-radius-cm", "5", "--led-centre-px", "160,110")


def photograph(file: Path, turn: float) -> None:
    """Shading of a ball by a light at the azimuth `turn`; its middle value names the light."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    x, y = (columns - 159.5) / 150.0, (109.5 - rows) / 150.0
    z = np.sqrt(np.clip(1 - x * x - y * y, 0.0, None))
    shade = np.clip(0.35 * (np.cos(turn) * x + np.sin(turn) * y) + 0.94 * z, 0.0, 1.0) * (z > 0.5)
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.rint(200 * shade).astype(np.uint8)).save(file)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Shadow tips of 14 LEDs of a circle, nail 13 mm high at two places, at a tenth of the thesis's scale."""
    lines = ["band,led,nail,nail_x_px,nail_y_px,tip_x_px,tip_y_px"]
    for band, step in (("white", 0.0), ("nir", np.pi / 7)):
        for led, turn in enumerate(AZIMUTH + step):
            for nail, (x, y) in enumerate(((6.0, 2.0), (-5.0, -4.0))):
                far = np.array([x, y]) + 13.0 / (140.0 - 13.0) * (
                    np.array([x, y]) - 50 * np.array([np.cos(turn), np.sin(turn)])
                )
                cells = [159.5 + 7.57 * x, 109.5 - 7.57 * y, 159.5 + 7.57 * far[0], 109.5 - 7.57 * far[1]]
                lines.append(f"{band},{led},{nail}," + ",".join(f"{cell:.3f}" for cell in cells))
    file = tmp_path_factory.mktemp("table") / "tips.csv"
    file.write_text("\n".join(lines))
    return file


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Two people, two days, two fingers; of P2, day 2, left thumb one photograph is missing and one is doubled."""
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


def run(*words: object) -> int:
    return main(["import", *map(str, words)])


def test_white_and_nir_folders_and_a_table_become_one_capture(tree, table, tmp_path, capsys):
    finger = tree / "P1" / "day1" / "Right Index"
    words = ("--images", finger / "white_{light}.png", "--nir", finger / "ir_{light}.png", "--table", table)
    assert run(*words, *CIRCLE, "--out", tmp_path / "one", "--json") == 0
    assert json.loads(capsys.readouterr().out)["nir"] == 7
    capture = read_capture(tmp_path / "one")
    assert capture.material == "skin" and capture.rig.camera.px_per_mm == 7.57
    assert [led.band for led in capture.rig.leds] == ["white"] * 7 + ["nir"] * 7
    assert capture.bands["nir"].leds == tuple((k,) for k in range(7, 14))
    for led, turn in zip(capture.rig.leds, [*AZIMUTH, *(AZIMUTH + np.pi / 7)], strict=True):
        np.testing.assert_allclose(led.position_mm, [50 * np.cos(turn), 50 * np.sin(turn), 140.0], atol=0.7)
    stored = np.asarray(Image.open(finger / "ir_6.png"))
    np.testing.assert_array_equal(capture.bands["nir"].pixels[6, ..., 0], stored)


def test_lists_of_lights_lie_beside_both_series(tree, tmp_path, capsys):
    for band, step in (("white", 0.0), ("ir", np.pi / 7)):
        folder = tmp_path / band
        lights = np.stack([0.35 * np.cos(AZIMUTH + step), 0.35 * np.sin(AZIMUTH + step), np.full(7, 0.94)], axis=1)
        for led, turn in enumerate(AZIMUTH + step):
            photograph(folder / f"{led}.png", turn)
        np.savetxt(folder / "lights.txt", lights)
    words = ("--images", tmp_path / "white", "--nir", tmp_path / "ir", "--px-per-mm", 7.57)
    assert run(*words, "--out", tmp_path / "one") == 0
    assert "7 grey and 7 near-infrared photographs" in capsys.readouterr().out
    capture = read_capture(tmp_path / "one")
    np.testing.assert_allclose(capture.rig.leds[7].direction, lights[0] / np.linalg.norm(lights[0]), atol=1e-6)
    same = splitknit.read_photographs(tmp_path / "white", px_per_mm=7.57, material="skin", nir=tmp_path / "ir")
    np.testing.assert_array_equal(same.bands["nir"].pixels, capture.bands["nir"].pixels)
    for k in range(7):
        (tmp_path / "white" / f"ir_{k}.png").write_bytes((tmp_path / "ir" / f"{k}.png").read_bytes())
    both = ("--images", tmp_path / "white" / "{light}.png", "--nir", tmp_path / "white" / "ir_{light}.png")
    assert run(*both, "--out", tmp_path / "two") == 2
    assert "lie in one folder" in capsys.readouterr().err
    for k in range(7):
        (tmp_path / "white" / f"ir_{k}.png").unlink()
    photograph(tmp_path / "ir" / "7.png", 0.0)
    assert run(*words, "--out", tmp_path / "two") == 2
    assert "8 photographs" in capsys.readouterr().err and not (tmp_path / "two").exists()


def test_a_tree_becomes_a_population(tree, table, tmp_path, capsys):
    out = tmp_path / "people"
    words = ("--people", tree, "--images", PATTERN, "--nir", NIR, "--table", table, *CIRCLE, "--out", out)
    assert run(*words, "--dry-run") == 0
    said = capsys.readouterr().out
    assert not out.exists()
    assert f"S01/session_1/right_index: {tree}/P1/day1/Right Index/white_{{light}}.png" in said
    assert "8 captures planned, 7 complete: 7 would be written" in said
    for words_of_fault in (
        "S02, session 2, left thumb (P2 2 left_thumb)",
        "lacks NIR 3",
        "second file for a white light, P2/day2/left_thumb/white_4.png",
        "1 files fit no pattern: notes.txt",
    ):
        assert words_of_fault in said
    damaged = tree / "P1" / "day1" / "left_thumb" / "ir_2.png"
    damaged.write_bytes(damaged.read_bytes()[:200])
    assert run(*words) == 0
    said = capsys.readouterr().out
    assert "6 written" in said and "S01, session 1, left thumb: " in said
    assert said.count("--encoding") == 1  # what was assumed of all
    population = read_population(out)
    assert population.planned == 8 and len(population.captures) == 6
    assert read_capture(out / "S02/session_1/left_thumb").subject == {"id": "S02", "finger": "left_thumb", "session": 1}
    photograph(damaged, AZIMUTH[2] + np.pi / 7)
    assert run(*words) == 0  # goes on where it was stopped
    assert "1 written" in capsys.readouterr().out and len(read_population(out).captures) == 7
    (tree / "P3" / "day1").mkdir(parents=True)
    (tree / "P1" / "day1" / "Right Index").rename(tree / "P3" / "day1" / "Right Index")
    assert run(*words) == 2
    assert "population of other people" in capsys.readouterr().err


def test_the_thesiss_own_table_is_refused_unless_kept(tree, tmp_path, capsys):
    finger = tree / "P1" / "day1" / "Right Index"
    header, *rows = THESIS.read_text().splitlines()
    tenth = [[*row.split(",")[:3], *(f"{float(cell) / 10}" for cell in row.split(",")[3:])] for row in rows]
    (tmp_path / "tips.csv").write_text("\n".join([header, *map(",".join, tenth)]))
    table = ("--table", tmp_path / "tips.csv")
    words = ("--images", finger / "white_{light}.png", "--nir", finger / "ir_{light}.png", *table)
    assert run(*words, *CIRCLE, "--out", tmp_path / "one") == 2
    assert "--keep" in capsys.readouterr().err and not (tmp_path / "one").exists()
    people = ("--people", tree, "--images", PATTERN, "--lights", tmp_path / "tips.csv", "--out", tmp_path / "people")
    assert run(*people) == 2
    assert "nothing was written: S01" in capsys.readouterr().err and not (tmp_path / "people").exists()
    assert run(*words, *CIRCLE, "--out", tmp_path / "one", "--keep") == 0
    assert len(read_capture(tmp_path / "one").bands["nir"].leds) == 7


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
def test_fingers_are_known_by_many_names(tmp_path, names, finger):
    (tmp_path / "a7" / names).mkdir(parents=True)
    (tmp_path / "a7" / names / "1.png").touch()
    tree = read_tree(tmp_path, ["{subject}/{finger}/{light}.png"])
    assert [place.folder for place, _ in tree.captures] == [f"S01/session_1/{finger}"]


def test_numbers_of_people_and_sessions_are_kept_where_small(tmp_path):
    for person, day in (("P2", "2024-03-01"), ("P3", "2024-03-02"), ("P3", "2024-02-09")):
        (tmp_path / person / day).mkdir(parents=True)
        (tmp_path / person / day / "right_3_0.png").touch()
    tree = read_tree(tmp_path, ["{subject}/{session}/{hand}_{finger}_{light}.png"])
    assert [place.folder for place, _ in tree.captures] == [
        "S03/session_1/right_middle", "S02/session_2/right_middle", "S03/session_3/right_middle"
    ]  # fmt: skip
    assert tree.plan["subjects"] == 3 and "nothing is there of S01, session 1, right middle" in tree.faults[0]


@pytest.mark.parametrize(
    ("pattern", "words"),
    [
        ("{subject}/{light}.png", "lacks {finger}"),
        ("{subject}/{finger}/{light}/a.png", "in the file's name"),
        ("{person}/{finger}/{light}.png", "a field {person}"),
        ("{subject}/{finger}_{light}.png", "none of 1 files"),
    ],
)
def test_patterns_that_cannot_be_are_refused(tmp_path, pattern, words):
    (tmp_path / "1.png").touch()
    with pytest.raises(BadInput, match=words.replace("{", r"\{")):
        read_tree(tmp_path, [pattern])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--keep",), "--keep goes with --table"),
        (("--table", "a.csv", "--lights", "b.txt"), "choose one"),
        (("--table", "a.csv"), "--px-per-mm"),
        (("--dry-run",), "goes with --people"),
        (("--nir", "b", "--mosaic", "mono"), "--nir does not go with"),
    ],
)
def test_options_without_their_partner_are_refused(tmp_path, given, words, capsys):
    assert run("--images", tmp_path, *given, "--out", tmp_path / "out") == 2
    assert words in capsys.readouterr().err
