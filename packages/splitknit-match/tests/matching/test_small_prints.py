"""Small prints: the overlap decides which rates are stated."""

import json
import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.io.prints import write_print_png
from splitknit_match import match
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.methods import fmr_table, rate, scores_of
from splitknit_match.matching.score import read_own_rates
from splitknit_match.matching.template import VERSION, leveled, pack, print_size, unpack
from splitknit_match.records.minutiae_record import Minutiae, no_minutiae, pack_minutiae
from splitknit_match.records.pictures import read_print_png
from splitknit_match.records.templates import write_template


def cut(template, top, left, side):
    """A square of a template, without minutiae."""
    part = np.s_[top : top + side, left : left + side]
    square = replace(template, level=template.level[part].copy(), valid=template.valid[part].copy())
    return without_minutiae(square)


def without_minutiae(template):
    return replace(template, minutiae=no_minutiae(print_size(template)))


def template_file(path, template):
    write_template(path, pack(template), VERSION)
    return str(path)


def calibration(tmp_path, impostors, genuine):
    """Arguments that write rates of impostor scores, and of twenty genuine ones."""
    lines = ["label,score", *(f"0,{score:.4f}" for score in impostors), *[f"1,{genuine}"] * 20]
    (tmp_path / "scores.csv").write_text("\n".join(lines) + "\n")
    return calibrate(tmp_path, "--scores", "scores.csv")


def calibrate(tmp_path, option, source):
    files = {option: source, "--calibrate": "own.json", "--out": "report"}
    words = [word for option, name in files.items() for word in (option, str(tmp_path / name))]
    return ["evaluate", *words, "--replicates", "20"]


def test_a_small_print_matches_in_any_pose(templates):
    """The ridges of 7 mm, turned by half a turn; the sides exchanged change nothing."""
    whole, part = without_minutiae(templates[0]), cut(templates[0], 90, 70, 70)
    turned = replace(part, level=part.level[::-1, ::-1].copy(), valid=part.valid[::-1, ::-1].copy())
    match = fused_match(turned, whole)
    assert match.similarity > 5
    assert match.ridge.overlap_mm2 == pytest.approx(part.area_mm2, rel=0.1)
    assert abs(match.ridge.rotation_deg) == pytest.approx(180, abs=3)
    back = fused_match(whole, turned)
    assert back.similarity == match.similarity
    assert (back.ridge.rotation_deg + match.ridge.rotation_deg) % 360 == pytest.approx(0, abs=1e-6)
    impostor = fused_match(turned, without_minutiae(templates[4]))
    assert impostor.similarity < match.similarity - 4


def test_a_template_keeps_that_its_print_had_no_minutiae(templates):
    again = unpack(pack(cut(templates[0], 90, 70, 60)))
    assert again.minutiae.count == 0


def test_fingerphotos_are_rated_alone_and_with_prints():
    alone, with_prints = "fingerphotos alone", "fingerphotos and prints"
    assert rate(3.0, alone, 100.0).answer == "no match"
    assert rate(3.0, with_prints, 100.0).answer == "match"
    assert rate(9.0, scores_of(alone, (300, 30), None), 30.0).answer == "undecided"


def test_too_little_overlap_or_too_rare_a_rate_is_undecided():
    smallest = fmr_table("windows").smallest
    high = fmr_table("windows").threshold(smallest) + 1
    assert rate(high, "windows", 30.0).answer == "match"
    assert rate(-3.0, "windows", 70.0).answer == "no match"
    tiny, small = rate(high, "windows", 3.0), rate(-3.0, "windows", 20.0)
    assert (tiny.answer, tiny.fmr, small.answer) == ("undecided", None, "undecided")
    assert "only 3 mm²" in str(tiny.undecided)
    assert "20 mm² are too few" in str(small.undecided)
    rarer = rate(high, "windows", 70.0, smallest / 2)
    assert (rarer.answer, rarer.decision) == ("undecided", None)


def test_a_scrap_of_a_print_is_not_acquired_and_gives_no_warning(tmp_path):
    """2.5 mm: less than a print must show."""
    side = np.arange(49)
    scrap = np.uint8(127 + 100 * np.sin(side[:, None] * 0.7 + 0 * side))
    file = str(tmp_path / "a.png")
    write_print_png(tmp_path / "a.png", scrap, 500.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = match(file, file)
    assert (result.answer, result.decision, result.fmr) == ("not acquired", None, None)
    assert main(["match", file, file, "--exit-code"]) == 12
    assert main(["match", file, file]) == 0


@pytest.fixture
def files(templates, tmp_path):
    """Templates of a whole finger, of two parts of it, and of another finger."""
    by_name = {
        "whole": without_minutiae(templates[0]),
        "impostor": without_minutiae(templates[4]),
        "part": cut(templates[0], 90, 70, 70),
        "bit": cut(templates[0], 90, 70, 38),
    }
    return {name: template_file(tmp_path / f"{name}.skt", t) for name, t in by_name.items()}


def test_each_answer_of_match_has_an_exit_code(files, capsys):
    assert main(["match", files["part"], files["whole"], "--exit-code"]) == 0
    assert capsys.readouterr().out.startswith("Match, ")
    assert main(["match", files["whole"], files["impostor"], "--exit-code"]) == 10
    assert capsys.readouterr().out.startswith("No match, ")
    assert main(["match", files["bit"], files["impostor"], "--exit-code", "--json"]) == 11
    facts = json.loads(capsys.readouterr().out)
    assert facts["answer"] == "undecided"
    assert facts["decision"] is None
    assert "mm²" in facts["undecided"]


def test_a_part_of_a_finger_is_identified_or_undecided(files, tmp_path, capsys):
    gallery = str(tmp_path / "g.skg")
    for name in ("whole", "impostor"):
        whose = ["--person", name, "--finger", "right_index"]
        assert main(["enroll", gallery, files[name], *whose]) == 0
    capsys.readouterr()
    assert main(["identify", gallery, files["part"], "--exit-code"]) == 0
    assert capsys.readouterr().out.startswith("Match: whole")
    assert main(["identify", gallery, files["part"], "--fmr", "0.00005", "--exit-code"]) == 11
    assert "leave --fmr out, or give a larger one" in capsys.readouterr().out
    assert main(["gallery", "remove", gallery, "--person", "whole"]) == 0
    capsys.readouterr()
    assert main(["identify", gallery, files["bit"], "--fmr", "0.001", "--exit-code"]) == 11
    assert capsys.readouterr().out.startswith("Undecided: ")


@pytest.mark.slow
def test_matches_are_decided_by_own_rates(templates, tmp_path, capsys):
    """``match --decision`` uses the file that ``evaluate --calibrate`` writes."""
    impostors = np.random.default_rng(0).normal(-3, 1, 300)
    assert main([*calibration(tmp_path, impostors, 8.0), "--least-mm2", "20"]) == 0
    rates, own = read_own_rates(tmp_path / "own.json"), str(tmp_path / "own.json")
    assert (rates.method, rates.rated_mm2, rates.impostors) == ("fusion", 20.0, 300)
    large, small = (
        template_file(tmp_path / f"{side}.skt", cut(templates[0], 80, 60, side))
        for side in (80, 44)
    )
    capsys.readouterr()
    assert main(["match", large, large, "--decision", own, "--fmr", "0.01", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["answer"] == "match"
    assert facts["fmr_basis"]["population"] == "scores of scores"
    assert main(["match", large, small, "--decision", own, "--json", "--exit-code"]) == 11
    assert main(["match", large, small, "--decision", own, "--method", "ridge"]) == 2


def test_a_file_without_rates_is_refused_by_match(files, tmp_path, capsys):
    (tmp_path / "own.json").write_text("[{}]")
    words = ["match", files["part"], files["bit"], "--decision", str(tmp_path / "own.json")]
    assert main(words) == 2
    assert "Expected object, got array" in capsys.readouterr().err


def test_own_rates_of_dissimilarities_are_refused(tmp_path, capsys):
    impostors = 5 + np.arange(300) / 100
    assert main([*calibration(tmp_path, impostors, 0.5), "--dissimilarity"]) == 2
    message = capsys.readouterr().err.strip()
    assert message.endswith("--calibrate takes similarities, as 'splitknit match' gives them.")
    assert "\n" not in message
    assert [path.name for path in tmp_path.iterdir()] == ["scores.csv"]


@pytest.mark.parametrize(
    "method",
    ["minutiae", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ridge", "fusion"))],
)
def test_own_rates_of_a_gallery_name_what_compared(method, tmp_path, capsys):
    """112 impostor pairs of eight fingers in two sessions."""
    gallery, file, rng = tmp_path / "people.skg", tmp_path / "finger.skt", np.random.default_rng(7)
    for number in range(8):
        finger = ridges(number)
        for session, side in ((1, 60), (2, 64)):
            part = cut(finger, 20, 20, side)
            payload = pack(part if method == "fusion" else replace(part, minutiae=None))
            if method == "minutiae":
                x, y = rng.integers(20, 180, (2, 20)).astype(np.int32)
                kind, quality = np.ones(20, np.uint8), np.full(20, 60, np.uint8)
                direction_rad = rng.uniform(0, 6.2, 20)
                minutiae = Minutiae(x, y, direction_rad, kind, quality, (200, 200))
                payload = pack_minutiae(minutiae)
            write_template(file, payload, VERSION)
            whose = f"--person S{number} --finger left_index --session {session}".split()
            assert main(["enroll", str(gallery), str(file), *whose]) == 0
    assert main(calibrate(tmp_path, "--gallery", gallery.name)) == 0
    assert read_own_rates(tmp_path / "own.json").method == method


def ridges(seed):
    """Ridges that run anywhere, 14 x 14 mm."""
    noise = np.random.default_rng(seed).normal(size=(140, 140)).astype(np.float32)
    value = cv2.GaussianBlur(noise, (0, 0), 1.1) - cv2.GaussianBlur(noise, (0, 0), 1.8)
    return leveled(value / value.std(), np.ones(value.shape, np.bool_), 0.1)


@pytest.mark.external
def test_windows_of_real_prints_do_not_match_another_finger(data_dir):
    """This window of 6 mm once did, at a stated rate below 1 in 11,000."""
    folder = data_dir / "fvc" / "fvc2000_db3b"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    image = read_print_png(folder / "103_1.png").image
    row, column = int(0.45 * image.shape[0]) - 59, int(0.5 * image.shape[1]) - 59
    window = print_template(np.ascontiguousarray(image[row : row + 118, column : column + 118]))
    for impostor in ("101_1", "104_1"):
        whole = print_template(read_print_png(folder / f"{impostor}.png").image)
        match = fused_match(window, whole)
        scores = scores_of("fusion", (window.area_mm2, whole.area_mm2), match.minutiae)
        assert rate(match.similarity, scores, match.ridge.overlap_mm2, 1e-3).answer != "match"
