"""What is no print of a finger is not acquired, and what is larger than one costs nothing: refused
before its band."""

import cv2
import numpy as np
import pytest

import splitknit_match
from refusals import bad_input
from splitknit import reconstruct
from splitknit.finger.ridges import surface_print
from splitknit.io.prints import write_print_png
from splitknit_match.matching import inputs
from splitknit_match.matching.inputs import print_template
from splitknit_match.prints.pressed import pressed_ridges
from splitknit_match.records.minutiae_record import PPI
from splitknit_simulator import simulate_capture
from splitknit_simulator.twin import twin_settings

from test_open_gallery import press  # isort: skip


def picture(wave, seed=0):
    """A wave of -1 to 1 on 400 x 400 pixels, with noise."""
    y, x = np.mgrid[:400, :400].astype(np.float32)
    noise = 6 * np.random.default_rng(seed).standard_normal(x.shape)
    return np.clip(127 + 100 * wave(x, y) + noise, 0, 255).astype(np.uint8)


def bars(x, y):
    widths = np.random.default_rng(3).integers(1, 4, 400) * 4
    return np.broadcast_to(2.0 * np.repeat(np.arange(400) % 2, widths)[:400] - 1, x.shape)


def blocks(x, y):
    return np.kron(np.random.default_rng(4).integers(0, 2, (50, 50)) * 2.0 - 1, np.ones((8, 8)))


def labyrinth(x, y):
    values = np.random.default_rng(5).standard_normal(x.shape).astype(np.float32)
    for _ in range(30):
        narrow, wide = (cv2.GaussianBlur(values, (0, 0), 9 * sigma) for sigma in (0.2, 0.45))
        values = np.tanh(3 * (narrow - wide) / (narrow - wide).std())
    return values


@pytest.mark.parametrize(
    ("wave", "words"),
    [
        (lambda x, y: np.sin(0.7 * x + 0.3 * y), "run straight on"),
        (bars, "run straight on"),
        (lambda x, y: np.sin(0.7 * np.hypot(x - 200, y - 260)), "lines end or fork"),
        (labyrinth, "break off"),
        (blocks, ""),
    ],
)
def test_lines_that_are_no_ridges_are_not_acquired(wave, words):
    template = print_template(picture(wave))
    assert template.empty
    assert words in template.lacks


def test_what_is_no_print_is_not_enrolled_and_says_why(tmp_path):
    stripes = picture(lambda x, y: np.sin(0.7 * x))
    with bad_input("no print of a finger: its lines run straight on"):
        splitknit_match.enroll(
            tmp_path / "g.skg", stripes, "Ann", "right_index", resolution_ppi=500
        )
    assert not (tmp_path / "g.skg").exists()
    match = splitknit_match.match(stripes, press(1), resolution_ppi=500)
    assert match.answer == "not acquired"
    assert match.findings[-1].code == "not-a-print"


@pytest.mark.parametrize(("axis", "gap"), [(0, 0), (1, 20)], ids=["stacked", "side by side"])
def test_a_sheet_of_several_prints_is_refused(axis, gap, tmp_path):
    prints = [np.pad(press(seed)[20:-20, 20:-20], gap // 2, constant_values=255) for seed in (1, 2)]
    sheet, gallery = np.concatenate(prints, axis=axis), tmp_path / "g.skg"
    words = "array: the picture shows prints of several fingers; cut them apart"
    ppi = {"resolution_ppi": 500}
    with bad_input(words):
        splitknit_match.enroll(gallery, sheet, "Ann", "right_index", **ppi)
    with bad_input(words):
        splitknit_match.make_template(sheet, **ppi)
    with bad_input(words):
        splitknit_match.match(press(1), sheet, **ppi)
    assert not gallery.exists()
    splitknit_match.enroll(gallery, press(1), "Ann", "right_index", **ppi)
    with bad_input(words):
        splitknit_match.identify(gallery, sheet, **ppi)


@pytest.mark.slow
def test_a_coarse_capture_whose_delta_is_cut_off_is_one_finger(tmp_path):
    """Half a delta at the edge curves as a core does."""
    capture, _ = simulate_capture(3, settings=twin_settings(0.1, {"render.workers": 1}))
    printed = surface_print(reconstruct(capture, "ea"), PPI)
    assert not pressed_ridges(printed).several
    enrolment = splitknit_match.enroll(
        tmp_path / "g.skg", printed, "Ann", "right_index", resolution_ppi=PPI
    )
    assert enrolment.content.fingers == 1


def test_small_prints_are_not_judged_by_their_lines():
    small = picture(lambda x, y: np.sin(0.7 * x))[:110, :110]
    assert not print_template(small).lacks


@pytest.mark.parametrize("verb", ["match", "make_template", "enroll", "identify"])
def test_a_large_print_is_refused_before_anything_is_made_of_it(verb, tmp_path, monkeypatch):
    def never(*_, **__):
        raise AssertionError("a band was made")

    file, gallery = tmp_path / "stripes.png", tmp_path / "g.skg"
    write_print_png(file, np.tile(picture(lambda x, y: np.sin(0.7 * x)), (5, 5)), 500.0)
    if verb == "identify":
        splitknit_match.enroll(gallery, press(1), "Ann", "right_index", resolution_ppi=500)
    monkeypatch.setattr(inputs, "print_band", never)
    monkeypatch.setattr("splitknit_match.prints.pressed.pressed_ridges", never)
    monkeypatch.setattr("splitknit_match.prints.from_file.pressed_ridges", never)
    calls = {
        "match": lambda: splitknit_match.match(file, file),
        "make_template": lambda: splitknit_match.make_template(file),
        "enroll": lambda: splitknit_match.enroll(gallery, file, "Ann", "right_index"),
        "identify": lambda: splitknit_match.identify(gallery, file),
    }
    with bad_input("larger than a finger's"):
        calls[verb]()


@pytest.mark.slow
def test_a_mirrored_print_is_named(tmp_path):
    upright, again = press(1), press(1, 9, 12.0)
    flipped = np.ascontiguousarray(again[:, ::-1])
    match = splitknit_match.match(upright, flipped, resolution_ppi=500)
    assert match.answer == "undecided"
    assert "mirrored" in str(match.undecided)
    gallery = tmp_path / "g.skg"
    splitknit_match.enroll(gallery, upright, "Ann", "right_index", resolution_ppi=500)
    done = splitknit_match.enroll(gallery, flipped, "Ann", "right_index", resolution_ppi=500)
    assert "only in a mirror" in str(done.findings[0])


@pytest.mark.slow
def test_a_finger_named_wrong_gets_a_note(tmp_path):
    gallery = tmp_path / "g.skg"
    splitknit_match.enroll(gallery, press(1), "Ann", "right_index", resolution_ppi=500)
    same = splitknit_match.enroll(
        gallery, press(1), "Ann", "left_index", resolution_ppi=500, duplicates="refuse"
    )
    assert [(duplicate.person, duplicate.finger) for duplicate in same.alike] == [
        ("Ann", "right_index")
    ]
    again = splitknit_match.enroll(
        gallery, press(1, 9, 12.0), "Ann", "right_index", resolution_ppi=500
    )
    assert "unlike-earlier" not in [finding.code for finding in again.findings]
    enrolment = splitknit_match.enroll(gallery, press(2), "Ann", "right_index", resolution_ppi=500)
    assert "unlike-earlier" in [finding.code for finding in enrolment.findings]
