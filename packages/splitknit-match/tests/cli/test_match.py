"""``splitknit match``: what comes in, what is printed, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from enrolled import facts_of, refusal_of, words_of
from perfect_results import write_impressions
from splitknit.io.npz import write_npz
from splitknit.io.prints import write_print_png
from splitknit_match.matching.template import VERSION, pack, unpack
from splitknit_match.records.templates import read_template
from splitknit_simulator.finger.finger import FingerPose


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Two impressions of one finger and one of another, as result folders of perfect
    reconstructions."""
    turned = FingerPose(insertion_mm=26.0, yaw_rad=0.15, roll_rad=0.08)
    return write_impressions(tmp_path_factory.mktemp("match"), 0.15, 721, turned)


def test_templates_stand_for_results(results, tmp_path, capsys):
    direct = facts_of(capsys, f"match {results}/a {results}/again --template {tmp_path}/a.skt")
    size = (tmp_path / "a.skt").stat().st_size
    assert direct["template"]["bytes"] == size < 30_000  # with its print
    surface = unpack(read_template(tmp_path / "a.skt", VERSION))
    assert len(pack(replace(surface, flat=None))) < 20_000
    stored = facts_of(capsys, f"match {tmp_path}/a.skt {results}/again")
    assert stored["similarity"] == direct["similarity"]
    alone = facts_of(capsys, f"match {results}/a/height.npz --template {tmp_path}/b.skt")
    assert "similarity" not in alone
    assert (tmp_path / "a.skt").read_bytes() == (tmp_path / "b.skt").read_bytes()


def test_the_thesis_method(results, capsys):
    arguments = ("--method", "thesis", "--set", "thesis.gate=0.5")
    same = facts_of(capsys, f"match {results}/a {results}/again", *arguments)
    impostor = facts_of(capsys, f"match {results}/a {results}/other", *arguments)
    assert same["similarity"] > impostor["similarity"]
    assert 0.5 < same["overlap"] < 1
    assert set(same["dissimilarity"]) == {"normals", "relief"}
    gated = facts_of(
        capsys, f"match {results}/a {results}/other --method thesis --set", "thesis.gate=1"
    )
    assert not gated["compared"]


@pytest.mark.slow
def test_a_capture_is_reconstructed(twin_folder, capsys):
    report = facts_of(capsys, f"match {twin_folder} {twin_folder} --preset ea")
    assert report["a"]["kind"] == "capture"
    assert report["similarity"] == pytest.approx(1.0, abs=1e-3)


def test_words_for_people(results, tmp_path, capsys):
    same_pair, template = (results / "a", results / "again"), tmp_path / "t.skt"
    words = words_of(capsys, "match", *same_pair, "--template", template)
    assert words.startswith("Match, decided at a false match rate of 1 in 10,000 (method ridge).")
    basis = "11,175 impostor comparisons, true surfaces of 150 simulated fingers"
    assert f"Estimated false match rate: below 1 in 11,000 (measured on {basis})." in words
    assert "score" not in words.lower()  # whose scale nobody knows
    assert "overlap" in words
    assert "turned by" in words
    assert "version 2" in words
    impostor_pair = results / "a", results / "other"
    words = words_of(capsys, "match", *impostor_pair, "--method", "thesis")
    assert "intersection over union" in words and words.startswith("Undecided")


def test_the_decision_is_at_a_stated_rate(results, capsys):
    """One scale for people, by every method; the method's own score where it is asked for."""
    same_pair, impostor_pair = ((results / "a", results / name) for name in ("again", "other"))
    same, impostor = (
        facts_of(capsys, "match", *same_pair),
        facts_of(capsys, "match", *impostor_pair),
    )
    assert same["decision"]["match"] and not impostor["decision"]["match"]
    assert same["decision"]["fmr"] == 1e-4 and impostor["fmr"] > 1e-3
    assert impostor["similarity"] < same["decision"]["threshold"] < same["similarity"]
    assert same["fmr_basis"]["impostors"] == 11175 and same["fmr_missing"] is None
    assert facts_of(capsys, "match", *impostor_pair, "--fmr", "0.9")["decision"]["match"] == (
        impostor["fmr"] <= 0.9
    )
    words = words_of(capsys, "match", *impostor_pair, "--raw")
    assert words.startswith("No match, decided at")
    threshold = same["decision"]["threshold"]
    assert (
        f"Score {impostor['similarity']:.4f} (1 = the same picture), a match from"
        f" {threshold:.4f} on." in words
    )
    message = refusal_of(capsys, "match", *same_pair, "--fmr", "1e-9")
    assert "rates below 8.9e-07 cannot be estimated" in message
    smaller = facts_of(capsys, "match", *same_pair, "--fmr", "1e-5")["decision"]
    assert smaller["threshold"] > threshold and "expected_fmr" not in same["decision"]
    assert 0 < smaller["expected_fmr"] < smaller["fmr"] == 1e-5
    words = words_of(capsys, "match", *same_pair, "--fmr", "1e-5")
    assert "1 in 100,000 (beyond what was measured: extrapolated; expected is 1 in 1," in words


@pytest.mark.slow
def test_folders_of_print_are_matched(results, tmp_path, capsys):
    """By their pictures, and by the minutiae that ``print`` has counted."""
    counts = []
    for name in ("a", "again"):
        facts = facts_of(capsys, f"print {results}/{name} --out {tmp_path}/{name}")
        counts.append(facts["minutiae"]["count"])
    report = facts_of(capsys, f"match {tmp_path}/a {tmp_path}/again")
    assert (report["a"]["kind"], report["b"]["kind"]) == ("print", "print")
    assert report["decision"]["match"]
    report = facts_of(capsys, f"match {tmp_path}/a {tmp_path}/again --method minutiae")
    assert [report[side]["minutiae"] for side in ("a", "b")] == counts
    record = facts_of(
        capsys, "match", tmp_path / "a" / "minutiae.iso", tmp_path / "again" / "minutiae.iso"
    )
    assert (record["a"]["minutiae"], record["similarity"]) == (counts[0], report["similarity"])
    # a print from a file has as many minutiae as 'print' finds in it
    picture = results / "a" / "print.png"
    facts = facts_of(capsys, f"print {picture} --out {tmp_path}/file")
    report = facts_of(capsys, f"match {picture} {picture} --method minutiae")
    assert report["a"]["minutiae"] == facts["minutiae"]["count"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("NOWHERE a", "there is no"),
        ("a", "second finger"),
        ("a --template NOWHERE --fmr 0.1", "is of a comparison"),
        ("EMPTY a", "neither a result"),
        ("TEXT a", "prints and minutiae are read"),
        ("BROKEN a", "cannot be read"),
        ("PARTIAL a", "holds no 'ridge_mm'"),
        ("COARSE a", "pixels per inch"),
        ("a a/print.png --method thesis", "compares surfaces"),
        ("a again --set thesis.gate=2", "gate"),
        ("a again --set ridge.speed=1", "speed"),
        ("a again --fmr nan", "--fmr must lie between 0 and 1"),
        ("a again --template a/height.npz/x.skt", "cannot write"),
    ],
)
def test_bad_input_is_one_sentence(results, tmp_path, capsys, arguments, words):
    (tmp_path / "EMPTY").mkdir()
    (tmp_path / "TEXT").write_text("hello")
    (tmp_path / "BROKEN").mkdir()
    (tmp_path / "BROKEN" / "height.npz").write_bytes(b"PK but not really")
    (tmp_path / "PARTIAL").mkdir()
    write_npz(tmp_path / "PARTIAL" / "height.npz", {"mask": np.ones((3, 3), np.bool_)})
    write_print_png(tmp_path / "COARSE.png", np.full((90, 90), 200, np.uint8), 100.0)
    names = {"COARSE": tmp_path / "COARSE.png", "NOWHERE": tmp_path / "NOWHERE"}
    names |= {name: tmp_path / name for name in ("EMPTY", "TEXT", "BROKEN", "PARTIAL")}
    before = sorted(path.name for path in tmp_path.iterdir())
    full = [
        (
            str(names.get(word, results / word))
            if (results / word.split("/")[0]).exists() or word in names
            else word
        )
        for word in arguments.split()
    ]
    assert words in refusal_of(capsys, "match", *full)
    assert sorted(path.name for path in tmp_path.iterdir()) == before
