"""Small prints: what overlaps decides what is said."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.prints import read_print_png, write_print_png
from splitknit_match import match
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.methods import fmr_basis, rate, scores_of, similarity_at
from splitknit_match.matching.parameters import SMALL_MM2
from splitknit_match.matching.score import own_rates_document, read_own_rates
from splitknit_match.matching.template import VERSION, Template, leveled, pack, print_size, unpack
from splitknit_match.prints.minutiae_record import Minutiae, no_minutiae, pack_minutiae
from splitknit_match.records.templates import write_template


def cut(template: Template, top: int, left: int, side: int) -> Template:
    """A square of a template, without minutiae."""
    part = np.s_[top : top + side, left : left + side]
    made = Template(template.level[part].copy(), template.valid[part].copy(), template.pitch_mm)
    return replace(made, minutiae=no_minutiae(print_size(made)))


def test_a_small_print_is_found_in_any_pose(templates) -> None:
    """The ridges of 7 mm, turned by half a turn; the sides exchanged change nothing."""
    whole = replace(templates[0], minutiae=no_minutiae(print_size(templates[0])))
    part = cut(whole, 90, 70, 70)
    turned = replace(part, level=part.level[::-1, ::-1].copy(), valid=part.valid[::-1, ::-1].copy())
    found = fused_match(turned, whole)
    assert found.similarity > 5
    assert found.ridge.overlap_mm2 == pytest.approx(part.area_mm2, rel=0.1)
    assert abs(found.ridge.rotation_deg) == pytest.approx(180, abs=3)
    again = fused_match(whole, turned)
    assert again.similarity == found.similarity
    assert (again.ridge.rotation_deg + found.ridge.rotation_deg) % 360 == pytest.approx(0, abs=1e-6)
    stranger = replace(templates[4], minutiae=no_minutiae(print_size(templates[4])))
    assert fused_match(turned, stranger).similarity < found.similarity - 4


def test_a_print_without_minutiae_keeps_that_it_is_one(templates) -> None:
    kept = unpack(pack(cut(templates[0], 90, 70, 60)))
    assert kept.minutiae is not None
    assert kept.minutiae.count == 0


def test_what_was_compared_decides_what_is_said() -> None:
    assert scores_of("fusion", (300, SMALL_MM2 + 1), 12.0) == "fusion"
    assert (
        scores_of("fusion", (300, SMALL_MM2 - 1), 12.0)
        == scores_of("fusion", (300, 300), None)
        == "windows"
    )
    assert rate(0.9, scores_of("ridge", (300, 30), None), 30.0).answer == "undecided"
    assert rate(0.9, "ridge", 100.0).answer == "match"
    assert fmr_basis("fusion").smallest < 1e-4  # the usual decision
    photographs, both = (f"fingerphotos {of}" for of in ("alone", "and prints"))
    assert (
        sum(fmr_basis(one).impostors for one in (photographs, both))
        == fmr_basis("fingerphotos").impostors
    )
    assert [rate(4.0, one, 100.0).answer for one in (photographs, both)] == ["no match", "match"]
    assert rate(9.0, scores_of(photographs, (300, 30), None), 30.0).answer == "undecided"
    assert similarity_at(1e-4, "fusion") >= similarity_at(1e-3, "fusion")
    smallest = fmr_basis("windows").smallest
    sure = similarity_at(smallest, "windows") + 1
    assert rate(sure, "windows", 30.0).answer == "match"
    few = rate(sure, "windows", 3.0)
    assert (few.answer, few.fmr) == ("undecided", None)
    assert few.undecided is not None
    assert "only 3 mm²" in few.undecided
    some, much = rate(-3.0, "windows", 20.0), rate(-3.0, "windows", 70.0)
    assert (some.answer, much.answer) == ("undecided", "no match")
    assert some.undecided is not None
    assert "20 mm² are too few" in some.undecided
    rarer = rate(sure, "windows", 70.0, smallest / 2)
    assert rarer.answer == "undecided"
    assert rarer.decision is None


def test_nothing_to_compare_is_no_match_and_no_warning(tmp_path: Path) -> None:
    """A scrap of 2.5 mm holds less than a print must show."""
    side = np.arange(49)
    scrap = np.uint8(127 + 100 * np.sin(side[:, None] * 0.7 + 0 * side))
    write_print_png(tmp_path / "a.png", scrap, 500.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = match(tmp_path / "a.png", tmp_path / "a.png")
    assert (found.answer, found.decision, found.fmr) == ("not acquired", None, None)
    assert main(["match", str(tmp_path / "a.png"), str(tmp_path / "a.png"), "--exit-code"]) == 12
    assert main(["match", str(tmp_path / "a.png"), str(tmp_path / "a.png")]) == 0


def test_answers_end_differently(templates, tmp_path: Path, capsys) -> None:
    """Also in a gallery: a small part of a finger, searched among wholes of its own and of
    another."""
    for name, one in (("whole", templates[0]), ("other", templates[4])):
        write_template(
            tmp_path / f"{name}.skt",
            pack(replace(one, minutiae=no_minutiae(print_size(one)))),
            VERSION,
        )
    for name, side in (("part", 70), ("bit", 38)):
        write_template(tmp_path / f"{name}.skt", pack(cut(templates[0], 90, 70, side)), VERSION)
    file = {name: str(tmp_path / f"{name}.skt") for name in ("whole", "other", "part", "bit")}
    assert main(["match", file["part"], file["whole"], "--exit-code"]) == 0
    assert capsys.readouterr().out.startswith("Match, ")
    assert main(["match", file["whole"], file["other"], "--exit-code"]) == 10
    assert capsys.readouterr().out.startswith("No match, ")
    assert main(["match", file["bit"], file["other"], "--exit-code", "--json"]) == 11
    facts = json.loads(capsys.readouterr().out)
    assert facts["answer"] == "undecided"
    assert facts["decision"] is None
    assert "mm²" in facts["undecided"]
    gallery = str(tmp_path / "g.skg")
    for name in ("whole", "other"):
        assert (
            main(["enroll", gallery, file[name], "--person", name, "--finger", "right_index"]) == 0
        )
    capsys.readouterr()
    assert main(["identify", gallery, file["part"], "--exit-code"]) == 0
    assert capsys.readouterr().out.startswith("Match: whole")
    assert main(["identify", gallery, file["part"], "--fmr", "0.00005", "--exit-code"]) == 11
    assert "leave --fmr out, or give a larger one" in capsys.readouterr().out
    assert main(["gallery", "remove", gallery, "--person", "whole"]) == 0
    capsys.readouterr()
    assert main(["identify", gallery, file["bit"], "--fmr", "0.001", "--exit-code"]) == 11
    assert capsys.readouterr().out.startswith("Undecided: ")


@pytest.mark.slow
def test_own_rates(templates, tmp_path: Path, capsys) -> None:
    """``evaluate --calibrate`` writes what ``match --decision`` decides by; anything else is
    refused."""
    rng = np.random.default_rng(0)
    lines = [
        "label,score",
        *(f"0,{value:.4f}" for value in rng.normal(-3, 1, 300)),
        *["1,8.0"] * 20,
    ]
    (tmp_path / "scores.csv").write_text("\n".join(lines) + "\n")
    own, out = tmp_path / "own.json", tmp_path / "report"
    words = [
        "evaluate",
        tmp_path / "scores.csv",
        "--out",
        out,
        "--replicates",
        "20",
        "--calibrate",
        own,
    ]
    words += ["--least-mm2", "20"]
    words.insert(1, "--scores")
    assert main(list(map(str, words))) == 0
    found = read_own_rates(own)
    assert (found.method, found.rated_mm2, found.impostors) == ("fusion", 20.0, 300)
    for name, side in (("a", 80), ("b", 44)):
        write_template(tmp_path / f"{name}.skt", pack(cut(templates[0], 80, 60, side)), VERSION)
    capsys.readouterr()
    sides = [str(tmp_path / f"{name}.skt") for name in "ab"]
    assert (
        main(["match", sides[0], sides[0], "--decision", str(own), "--fmr", "0.01", "--json"]) == 0
    )
    facts = json.loads(capsys.readouterr().out)
    assert facts["answer"] == "match"
    assert facts["fmr_basis"]["population"] == "scores of scores"
    assert main(["match", *sides, "--decision", str(own), "--json", "--exit-code"]) == 11
    assert main(["match", *sides, "--decision", str(own), "--method", "ridge"]) == 2
    sound, huge = own_rates_document(rng.normal(size=200), "", "fusion", 0.0), 10**400
    wrong = [
        {"fmr": [1.0, 2.0]},
        {"impostors": huge},
        {"least_mm2": huge},
        {"similarity": [huge, 2 * huge]},
    ]
    wrong += [
        {"impostors": -1},
        {"impostors": 10**30},
        {"similarity": [[[0.0]]]},
        {"fmr": {"a": 1}},
    ]
    for change in wrong:
        own.write_text(json.dumps(sound | change))
        with pytest.raises(BadInput, match="is not a file of false match rates"):
            read_own_rates(own)
    own.write_text(json.dumps([sound]))
    assert main(["match", *sides, "--decision", str(own)]) == 2
    assert "Expected object, got array" in capsys.readouterr().err


def test_own_rates_of_dissimilarities_are_refused(tmp_path: Path, capsys) -> None:
    lines = ["label,score", *(f"0,{5 + k / 100}" for k in range(300)), *["1,0.5"] * 20]
    (tmp_path / "scores.csv").write_text("\n".join(lines) + "\n")
    words = [
        "evaluate",
        "--scores",
        tmp_path / "scores.csv",
        "--dissimilarity",
        "--calibrate",
        tmp_path / "own.json",
    ]
    assert main(list(map(str, [*words, "--out", tmp_path / "report", "--replicates", "20"]))) == 2
    said = capsys.readouterr().err.strip()
    assert (
        said.endswith("--calibrate takes similarities, as 'splitknit match' gives them.")
        and "\n" not in said
    )
    assert [path.name for path in tmp_path.iterdir()] == ["scores.csv"]


@pytest.mark.parametrize(
    "method",
    ["minutiae", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ridge", "fusion"))],
)
def test_own_rates_of_a_gallery_name_what_compared(method: str, tmp_path: Path, capsys) -> None:
    """112 impostor pairs of eight fingers in two sessions; the name given by ``--method`` is not
    taken."""
    gallery, own, rng = tmp_path / "people.skg", tmp_path / "own.json", np.random.default_rng(7)
    for number in range(8):
        finger = ridges(number)
        for session, side in ((1, 60), (2, 64)):
            part = cut(finger, 20, 20, side)
            payload = pack(part if method == "fusion" else replace(part, minutiae=None))
            if method == "minutiae":
                x, y = rng.integers(20, 180, (2, 20)).astype(np.int32)
                kind, quality = np.ones(20, np.uint8), np.full(20, 60, np.uint8)
                payload = pack_minutiae(
                    Minutiae(x, y, rng.uniform(0, 6.2, 20), kind, quality, (200, 200))
                )
            write_template(tmp_path / "one.skt", payload, VERSION)
            words = ["--person", f"S{number}", "--finger", "left_index", "--session", str(session)]
            assert main(["enroll", str(gallery), str(tmp_path / "one.skt"), *words]) == 0
    words = [
        "evaluate",
        "--gallery",
        gallery,
        "--calibrate",
        own,
        "--out",
        tmp_path / "report",
        "--replicates",
        "20",
    ]
    assert main(list(map(str, words))) == 0
    assert read_own_rates(own).method == method


def ridges(seed: int) -> Template:
    """Ridges that run anywhere, 14 x 14 mm."""
    noise = np.random.default_rng(seed).normal(size=(140, 140)).astype(np.float32)
    value = cv2.GaussianBlur(noise, (0, 0), 1.1) - cv2.GaussianBlur(noise, (0, 0), 1.8)
    return leveled(value / value.std(), np.ones(value.shape, np.bool_), 0.1)


@pytest.mark.external
def test_windows_of_real_prints_open_no_doors(data_dir: Path) -> None:
    """A window of 6 mm was taken for another finger, at a stated rate below 1 in 11,000."""
    folder = data_dir / "fvc" / "fvc2000_db3b"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    image = read_print_png(folder / "103_1.png").image
    row, column = int(0.45 * image.shape[0]) - 59, int(0.5 * image.shape[1]) - 59
    window = print_template(np.ascontiguousarray(image[row : row + 118, column : column + 118]))
    for other in ("101_1", "104_1"):
        whole = print_template(read_print_png(folder / f"{other}.png").image)
        found = fused_match(window, whole)
        scores = scores_of("fusion", (window.area_mm2, whole.area_mm2), found.minutiae)
        assert rate(found.similarity, scores, found.ridge.overlap_mm2, 1e-3).answer != "match"
