"""The twin passes the acceptance test; a dead LED and a wrong lens file fail it."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit import Band, Capture, read_rig, write_rig
from splitknit.cli.exits import ANSWERS
from splitknit.errors import BadInput
from splitknit_rig.acceptance.phantom import ridge_heights
from splitknit_rig.acceptance.questions import (
    DARK,
    LINEAR,
    LIT,
    RIDGES,
    SHARP,
    Answer,
    _beyond,
    _changes,
    _specks,
    answers_of_sensor,
)
from splitknit_rig.calibration.phantom import phantom
from splitknit_rig.check import RigCheck, check_rig
from splitknit_simulator.rigs import built_rig

TIMES = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
LIGHT = np.linspace(0.02, 0.14, 200)


def by_question(answers):
    return {answer.question: answer for answer in answers}


def card(black):
    """A card whose camera states a level of no light; its pictures are not looked at."""
    pixels = np.zeros((3, 8, 8, 3), dtype=np.uint8)
    band = Band("white", pixels, ((0,), (1,), (2,)), np.ones(3), np.full(3, float(black)))
    return Capture(built_rig(3, scale=0.1), {"white": band})


def test_sensor():
    values = 0.04 + TIMES[:, None] * LIGHT
    sound = by_question(answers_of_sensor(card(10), values, TIMES))
    assert sound[DARK.question].measured == pytest.approx(0.08, abs=0.01)  # 10 / 255
    assert sound[LINEAR.question].passed
    raised = by_question(answers_of_sensor(card(0), values, TIMES))
    assert raised[DARK.question].measured == pytest.approx(4.0, abs=0.01)
    curved = by_question(answers_of_sensor(card(0), values**0.8, TIMES))
    assert not curved[LINEAR.question].passed


def test_a_question_that_cannot_be_asked_fails_and_says_why():
    clipped = answers_of_sensor(card(0), np.full((6, 200), np.nan), TIMES)
    black = answers_of_sensor(BadInput("white_3.png is black."), np.empty((0, 0)), np.empty(0))
    for answers, words in ((clipped, "clipped"), (black, "white_3.png is black")):
        for answer in answers:
            assert not answer.passed
            assert answer.measured is None
            assert words in answer.note


def test_specks_and_stuck_pixels_are_counted():
    rig = built_rig(3, scale=0.1)
    rig = replace(rig, camera=replace(rig.camera, shading=()))
    rows, columns = rig.camera.image_size
    rng = np.random.default_rng(0)
    even = 150.0 * (1.0 - 0.1 * np.linspace(0, 1, columns)) + np.zeros((3, rows, columns))

    def counted(factor):
        noisy = factor * even * (1.0 + 0.01 * rng.standard_normal(even.shape))
        pixels = np.repeat(np.rint(noisy).astype(np.uint8)[..., None], 3, axis=3)
        band = Band("white", pixels, ((0,), (1,), (2,)), np.ones(3), np.zeros(3))
        return _specks(Capture(rig, {"white": band}), 7.5)

    assert counted(1.0) == (0.0, "")
    specked = np.ones((rows, columns))
    for k in range(5):
        specked[40 + 20 * k : 43 + 20 * k, 100:103] = 0.9 if k else 1.5
    number, words = counted(specked)
    assert number == 5.0
    assert words.endswith(("column 101, row 41", "column 100, row 41", "column 101, row 40"))


def test_a_light_that_changes_between_captures_or_within_one_is_flicker():
    rng = np.random.default_rng(1)
    inside = np.zeros((80, 60), dtype=bool)
    inside[8:72, 10:50] = True
    first = (1.0 + rng.random((4, 80, 60))).astype(np.float32)
    # the finger a little elsewhere, all lights a tenth brighter, one twentieth of one
    second = 1.1 * first * (1.0 + 0.01 * rng.standard_normal(first.shape))
    assert _changes(first, second, inside).max() < 0.01
    second[2] *= 1.05
    assert _changes(first, second, inside) == pytest.approx([0, 0, np.log(1.05), 0], abs=0.012)
    second[1, 24:40] *= 0.9
    assert _changes(first, second, inside)[1] == pytest.approx(-np.log(0.9), abs=0.02)


def test_every_led_beyond_a_limit_is_named():
    rig = built_rig(3, scale=0.1)
    values = np.linspace(0.0, 1.3, 14)
    assert _beyond(values, 1.15, rig) == "nir 5 and nir 6"
    assert _beyond(values, 2.0, rig) == "nir 6"


def test_a_blur_lowers_fine_ridges_of_the_phantom_and_a_low_print_does_not():
    drawn, _ = phantom()

    def fine(change):
        height = change(np.nan_to_num(drawn.ridge_mm).astype(np.float32))
        changed = np.where(drawn.mask, drawn.shape_mm + height, np.nan)
        return ridge_heights(replace(drawn, height_mm=changed))

    whole, likeness, sharp = fine(lambda height: height)
    assert (whole, likeness, sharp) == pytest.approx((1.0, 1.0, 1.0), abs=0.05)
    low = fine(lambda height: np.float32(0.8) * height)
    assert low[0] < 0.9 * whole
    assert low[1:] == pytest.approx((likeness, sharp), abs=0.02)
    blurred = fine(lambda height: cv2.GaussianBlur(height, (0, 0), 0.06 / 0.05))
    assert blurred[1] > RIDGES.limit
    assert blurred[2] < SHARP.limit


def test_exit_codes():
    assert (ANSWERS["passed"], ANSWERS["failed"]) == (0, 10)


def test_the_table():
    answers = (
        Answer("dark level", 1.0, "% of full scale", measured=0.1234, passed=True),
        Answer("focus", 2.0, "%", at_least=True, note="no skin"),
    )
    lines = str(RigCheck(answers, {"out": "there"})).splitlines()
    assert " ".join(lines[1].split()) == "dark level 0.123 <= 1 % of full scale passed"
    assert " ".join(lines[2].split()) == "focus - >= 2 % failed no skin"
    assert lines[3] == "1 of 2 questions failed. Written to there: check.html, check.json."


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("rig") / "rig.json"
    write_rig(built_rig(3, scale=0.1), file)
    return file


def test_refused(rig_file, tmp_path):
    out = tmp_path / "out"
    no_phantom = {"card": "a", "ball": "b", "finger": ("c", "d")}
    for folders_named in ({}, {**no_phantom, "phantom": "p", "finger": ("c",)}, no_phantom):
        with bad_input("name the photographs, `card`, `phantom`, `ball` and"):
            check_rig(rig_file, out=out, **folders_named)
    with bad_input("`card` does not go with `device`"):
        check_rig(rig_file, out=out, device="twin", card="a")
    with bad_input(r"a.*capture"):
        absent = {**no_phantom, "card": tmp_path / "a", "phantom": "p"}
        check_rig(rig_file, out=out, **absent)
    with bad_input("`ball_mm` must be positive"):
        check_rig(rig_file, out=out, device="twin", ball_mm=0.0)
    assert not out.exists()


@pytest.fixture(scope="module")
def tested(rig_file, tmp_path_factory):
    out = tmp_path_factory.mktemp("check") / "out"
    return check_rig(rig_file, out=out, device="twin"), out


def folders(out):
    return {
        "card": out / "card",
        "phantom": out / "phantom",
        "ball": out / "ball",
        "finger": (out / "finger_1", out / "finger_2"),
    }


@pytest.mark.slow
def test_the_twin_passes(tested):
    result, out = tested
    # at 8 px/mm ridges are not judged by these limits
    failed = [answer.question for answer in result.answers if not answer.passed]
    assert all(name.startswith("ridges") for name in failed), str(result)
    ridges = by_question(result.answers)[RIDGES.question]
    assert ridges.measured > 0.82 and "% of the height drawn" in ridges.note
    written = json.loads((out / "check.json").read_text())
    assert written["rows"] == result.facts["rows"]
    assert "card/white_0.png" in written["inputs"]
    page = (out / "check.html").read_text()
    assert all(answer.question in page for answer in result.answers)


@pytest.mark.slow
def test_a_dead_led_and_a_wrong_lens_fail(tested, rig_file, tmp_path):
    result, out = tested
    again = check_rig(rig_file, out=tmp_path / "again", **folders(out))
    assert again.answers == result.answers
    photographs = tmp_path / "photographs"
    shutil.copytree(out, photographs)
    for part in ("card", "ball"):
        file = photographs / part / "white_3.png"
        cv2.imwrite(str(file), np.zeros_like(cv2.imread(str(file))))
    rig = read_rig(rig_file)
    matrix = rig.camera.matrix * np.array([[1.05, 1, 1], [1, 1.05, 1], [1, 1, 1]])
    other_rig = tmp_path / "other.json"
    camera = replace(rig.camera, matrix=matrix, px_per_mm=1.05 * rig.camera.px_per_mm)
    write_rig(replace(rig, camera=camera), other_rig)
    dead = check_rig(rig_file, out=tmp_path / "dead", **folders(photographs))
    assert dead.facts["answer"] == "failed"
    unlit = by_question(dead.answers)[LIT.question]
    assert (unlit.measured, unlit.passed, unlit.note) == (1.0, False, "white 3")
    # what the other LEDs show is answered all the same
    assert by_question(dead.answers)["brightness by light"].passed
    assert by_question(dead.answers)["direction of each LED"].passed
    lens = by_question(check_rig(other_rig, out=tmp_path / "lens", **folders(out)).answers)
    assert not lens["radius of the ball"].passed
    wrong_phantom = {**folders(out), "phantom": out / "ball"}
    unlike = by_question(check_rig(rig_file, out=tmp_path / "unlike", **wrong_phantom).answers)
    assert not unlike[RIDGES.question].passed
    assert "the phantom's ridges are not seen" in unlike[RIDGES.question].note
