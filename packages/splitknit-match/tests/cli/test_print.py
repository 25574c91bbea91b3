"""``splitknit print``: the four methods, their files, what is refused."""

import json
import os
import re
import subprocess
import sys

import cv2
import numpy as np
import pytest

from enrolled import facts_of, refusal_of, words_of
from perfect_results import write_perfect
from splitknit.io.npz import read_npz, write_npz
from splitknit.io.pictures import upright_turn
from splitknit.io.results import read_result
from splitknit.nominal import default_rig
from splitknit_match import match
from splitknit_match.records.minutiae_files import read_minutiae_record
from splitknit_match.records.pictures import read_print_png
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A perfect reconstruction of a whorl, turned a little, with the places of its true
    minutiae."""
    camera = default_rig(0.22).camera
    seen = finger_surface(
        draw_finger(741, "whorl"), FingerPose(insertion_mm=27.0, yaw_rad=0.12), camera
    )
    more = {"minutiae_px": seen.landmarks["minutiae_px"]}
    return write_perfect(tmp_path_factory.mktemp("print") / "result", seen, camera, more=more)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "surface"), [("relief", "plane"), ("unroll", "free"), ("curvature", "plane")]
)
def test_all_files_are_written(result, tmp_path, capsys, method, surface):
    out = tmp_path / "out"
    facts = facts_of(capsys, f"print {result} --method {method} --out {out}")
    wanted = {"print.png", "enhanced.png", "map.npz", "report.html", "report.json", "minutiae.iso"}
    assert set(facts["files"]) == wanted == {path.name for path in out.iterdir()} - {".splitknit"}
    assert facts["surface"] == surface
    assert facts == {**json.loads((out / "report.json").read_text()), "out": str(out)}
    for name in ("print.png", "enhanced.png"):
        file = read_print_png(out / name)
        assert file.resolution_ppi == pytest.approx(500, abs=0.02)
        assert list(file.image.shape) == facts["size"]
        assert "splitknit" in file.text["Software"]
    assert 0.35 < facts["ridge_period_mm"]["median"] < 0.6


def test_true_minutiae_are_found_where_they_are(result, tmp_path, capsys):
    """The stored map takes the true minutiae to the print; most of what is found lies on one of
    them."""
    from scipy.spatial import cKDTree

    from splitknit_match.prints.make import make_print
    from splitknit_match.prints.sources import read_source

    out = tmp_path / "out"
    facts = facts_of(capsys, f"print {result} --out {out}")
    view = read_minutiae_record(out / "minutiae.iso")[0]
    assert set(view.type.tolist()) == {1, 2}
    assert view.size == tuple(facts["size"])
    extracted = np.stack([view.x_px, view.y_px], axis=1).astype(float)
    flat_print = make_print(read_source(result, photo=False, surface=True), "unroll")
    true = flat_print.map.print_from_input(read_npz(result / "height.npz")["minutiae_px"])
    inside = cv2.erode((flat_print.weight > 0.5).astype(np.uint8), np.ones((41, 41))) > 0
    true, extracted = (
        points[[bool(np.isfinite(p).all() and inside[round(p[1]), round(p[0])]) for p in points]]
        for points in (true, extracted)
    )
    assert len(true) > 30
    assert (cKDTree(extracted).query(true)[0] < 5).mean() > 0.7
    assert (cKDTree(true).query(extracted)[0] < 5).mean() > 0.7
    mirrored = [flat_print.image.shape[1] - 1, 0] + true * [-1, 1]
    assert (cKDTree(extracted).query(mirrored)[0] < 5).mean() < 0.4


def test_the_page_has_the_minutiae_on_the_surface(result, tmp_path, capsys):
    """Their places are those of the mesh, x right and y to the tip, and they lie on the true
    minutiae."""
    from scipy.spatial import cKDTree

    facts_of(capsys, f"print {result} --out {tmp_path}/out")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    (surface,) = json.loads(re.search(r'id="surfaces">(.*?)</script>', page, re.DOTALL)[1])
    places = np.array(surface["minutiae"])[:, :2]
    source = read_result(result)
    columns, rows = read_npz(result / "height.npz")["minutiae_px"].T
    at = np.rint(rows).astype(int), np.rint(columns).astype(int)
    known = source.mask[at]
    turn = upright_turn(source.input_from_upright)
    height, width = source.mask.shape
    x = (columns - (width - 1) / 2) * source.pitch_mm if source.x_mm is None else source.x_mm[at]
    y = ((height - 1) / 2 - rows) * source.pitch_mm if source.y_mm is None else source.y_mm[at]
    true = (turn @ np.stack([x, y])).T[known]
    assert (cKDTree(true).query(places)[0] < 0.3).mean() > 0.6


@pytest.mark.slow
def test_resolution_surface_and_settings(result, tmp_path, capsys):
    coarse = facts_of(capsys, f"print {result} --method relief --out {tmp_path}/a")
    fine = facts_of(capsys, f"print {result} --method relief --ppi 1000 --out {tmp_path}/b")
    assert read_print_png(tmp_path / "b" / "print.png").resolution_ppi == pytest.approx(
        1000, abs=0.02
    )
    assert np.allclose(np.array(fine["size"]) / 2, coarse["size"], atol=1)
    assert fine["ridge_period_mm"]["median"] == pytest.approx(
        coarse["ridge_period_mm"]["median"], rel=0.02
    )
    wide = facts_of(
        capsys, f"print {result} --method curvature --surface arc --out", tmp_path / "d"
    )
    assert wide["size"][1] > coarse["size"][1]
    assert "distortion" in wide


@pytest.mark.slow
def test_the_threads_of_blas_change_nothing(result, tmp_path):
    """Its kernels without AVX-512, which most processors run, round sums by how threads share
    them."""
    for threads in "12":
        out = tmp_path / threads
        subprocess.run(
            [
                sys.executable,
                "-m",
                "splitknit.cli.main",
                "print",
                result,
                "--method",
                "unroll",
                "--out",
                out,
            ],
            env={**os.environ, "OPENBLAS_CORETYPE": "Haswell", "OPENBLAS_NUM_THREADS": threads},
            check=True,
        )
    for name in ("print.png", "enhanced.png"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes(), name


@pytest.mark.slow
def test_the_photograph(twin_folder, tmp_path, capsys):
    facts = facts_of(capsys, f"print {twin_folder} --method photo --out {tmp_path}/photo")
    assert facts["source"]["kind"] == "capture"
    assert facts["surface"] == "plane"
    assert facts["ridge_area_mm2"] > 150


def test_the_photograph_shows_the_ridges(twin_folder):
    """Ridges are dark in it where they are high in the truth."""
    from splitknit.finger.ridges import ink
    from splitknit_match.prints.make import make_print
    from splitknit_match.prints.print_map import resample
    from splitknit_match.prints.sources import read_source

    source = read_source(twin_folder, photo=True, surface=False)
    photo = make_print(source, "photo")
    truth = np.load(twin_folder / "truth.npz")
    relief = (truth["height_mm"] - truth["shape_mm"]).astype(np.float32)
    known = source.mask & np.isfinite(relief)
    true = ink(*resample(np.where(known, relief, np.float32(0)), known, source.pitch_mm, photo.map))
    middle = tuple(slice(n // 2 - 90, n // 2 + 90) for n in true.shape)
    assert np.corrcoef(photo.image[middle].ravel(), true[middle].ravel())[0, 1] > 0.3


def test_bad_input_is_one_sentence(result, twin_folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert "there is no" in refusal_of(capsys, f"print {tmp_path}/nothing --out {out}")
    (tmp_path / "empty").mkdir()
    assert "neither a capture" in refusal_of(capsys, f"print {tmp_path}/empty --out {out}")
    assert "no photograph" in refusal_of(capsys, f"print {result} --method photo --out {out}")
    assert "--method relief" in refusal_of(
        capsys, f"print {result} --method unroll --surface", "plane", "--out", out
    )
    arrays = read_npz(result / "height.npz")

    def changed(name, **others):
        folder = tmp_path / name
        folder.mkdir()
        write_npz(folder / "height.npz", {**arrays, **others})
        return folder

    assert "no scale" in refusal_of(
        capsys, "print", changed("scale", pitch_mm=np.float64(0.0)), "--out", out
    )
    without = {name: value for name, value in arrays.items() if name != "pitch_mm"}
    (tmp_path / "without").mkdir()
    write_npz(tmp_path / "without" / "height.npz", without)
    assert "no scale" in refusal_of(capsys, f"print {tmp_path}/without --out {out}")
    flat = changed("flat", ridge_mm=np.zeros_like(arrays["ridge_mm"]))
    for method in ("relief", "unroll"):
        assert "no ridges" in refusal_of(capsys, f"print {flat} --method {method} --out {out}")
    assert "another shape" in refusal_of(
        capsys, "print", changed("shape", ridge_mm=np.zeros((3, 3), np.float32)), "--out", out
    )
    assert "mask is empty" in refusal_of(
        capsys, "print", changed("mask", mask=np.zeros_like(arrays["mask"])), "--out", out
    )
    (tmp_path / "scale" / "height.npz").write_bytes(b"PK nonsense")
    refusal_of(capsys, f"print {tmp_path}/scale --out {out}")
    assert not out.exists()


@pytest.mark.slow
def test_ridges_do_not_doubt_a_calibrated_camera(result, tmp_path, capsys):
    """A finger whose ridges are unusually close keeps the scale that its camera gives it; a print's
    file does not."""
    fine = tmp_path / "fine"
    fine.mkdir()
    arrays = read_npz(result / "height.npz")
    write_npz(fine / "height.npz", {**arrays, "pitch_mm": np.float64(0.6) * arrays["pitch_mm"]})
    finger = ("--person", "Ann", "--finger", "left_index")
    facts_of(capsys, f"print {fine} --method relief --out {tmp_path}/relief")
    facts_of(capsys, f"enroll {tmp_path}/people.skg {tmp_path}/relief", *finger)
    assert match(tmp_path / "relief", tmp_path / "relief").answer == "match"
    facts_of(capsys, f"print {tmp_path}/relief/print.png --out {tmp_path}/file")
    for doubted in (tmp_path / "file", tmp_path / "relief" / "print.png"):
        message = refusal_of(capsys, f"enroll {tmp_path}/none.skg {doubted}", *finger)
        assert "check the resolution" in message


@pytest.mark.slow
def test_the_report_tells_the_quality(result, tmp_path, capsys):
    """A good finger is called good; a shallow one scores less, and a sentence says what to do."""
    printed = facts_of(capsys, f"print {result} --out {tmp_path}/good")
    good = printed["quality"]
    assert good["ours"] > 70
    assert "weak-ridges" not in [finding["code"] for finding in printed["findings"]]
    assert 0.35 < good["figures"]["period_mm"] < 0.6
    arrays = read_npz(result / "height.npz")
    shallow = tmp_path / "shallow_result"
    shallow.mkdir()
    write_npz(shallow / "height.npz", {**arrays, "ridge_mm": np.float32(0.3) * arrays["ridge_mm"]})
    command = "print", shallow, "--out", tmp_path / "shallow", "--ppi", 1000
    words = words_of(capsys, *command).splitlines()
    facts = json.loads((tmp_path / "shallow" / "report.json").read_text())
    weak = facts["quality"]
    assert weak["ours"] < good["ours"] - 5
    assert weak["figures"]["ridge_height_um"] == pytest.approx(
        0.3 * good["figures"]["ridge_height_um"], rel=0.1
    )
    advice = {finding["code"]: finding["message"] for finding in facts["findings"]}
    assert 1 <= len(advice) <= 3
    assert "moisten the finger" in advice["weak-ridges"]
    assert {f"Please note: {sentence}" for sentence in advice.values()} <= set(words)
    assert f"Quality: {weak['ours']:.0f} of 100" in " ".join(words)
    record = read_minutiae_record(tmp_path / "shallow" / "minutiae.iso")
    assert record[0].finger_quality == round(weak["ours"])
    (shallow / "report.json").write_text('{"facts": {"material": "opaque"}}')
    cast = facts_of(capsys, f"print {shallow} --out {tmp_path}/cast --ppi 1000")
    assert (cast["quality"]["figures"], cast["findings"]) == (weak["figures"], [])


def test_advice_is_chosen_by_the_worst_figure():
    from dataclasses import replace

    from splitknit_match.prints.folder import advice
    from splitknit_match.prints.print_quality import PrintQuality, QualityFigures, score_of

    good = QualityFigures(0.9, 50.0, 0.97, 0.97, 0.5, 0.11, 400.0, 450.0, 24.0, 0.05, 0.3)

    def advice_on(**changes):
        figures = replace(good, **changes)
        return tuple(map(str, advice(PrintQuality(*score_of(figures), figures))))

    assert advice_on() == ()
    wanted = {
        "moisten": {"ridge_height_um": 15.0},
        "clean finger and lens": {"ridge_share": 0.4},
        "wipe the finger": {"gap_share": 0.3},
        "directions": {"coherence": 0.6},
        "distances": {"plausible_share": 0.6},
        "focus the camera": {"sharpness": 0.04, "ridge_height_um": 40.0},
        "push the finger": {"ridge_length_mm": 9.0},
        "turn its pad": {"centre_offset_mm": 6.0},
    }
    for words, changes in wanted.items():
        assert len(advice_on(**changes)) == 1
        assert words in advice_on(**changes)[0], words
    assert advice_on(sharpness=0.04) == ()  # high ridges: the finger's own
    many = advice_on(
        ridge_length_mm=7.0,
        ridge_area_mm2=40.0,
        ridge_height_um=10.0,
        gap_share=0.25,
        centre_offset_mm=5.0,
    )
    assert len(many) == 3
    assert "push" in many[0]
    assert "moisten" in many[1]
