"""``splitknit evaluate --gallery``: every session against every other, and the scores as a file."""

import csv
import json
import shutil
from pathlib import Path

import pytest

from enrolled import facts_of, refusal_of
from splitknit.cli.main import main
from splitknit_match.evaluation import gallery_scores as evaluation_gallery
from splitknit_match.gallery.file import GalleryFile
from splitknit_match.matching.ridge import ridge_match
from splitknit_match.matching.template import unpack

QUICK = ("--replicates", 40)


@pytest.fixture(scope="module")
def gallery(people_folder, tmp_path_factory):
    """Three fingers in two sessions; not to be changed."""
    file = tmp_path_factory.mktemp("evaluate") / "people.skg"
    assert main(f"enroll {file} --population {people_folder}".split()) == 0
    return file


def table_of(folder):
    with (folder / "scores.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
def test_all_sessions_with_each_other(gallery, tmp_path, capsys):
    facts = facts_of(capsys, f"evaluate --gallery {gallery} --out {tmp_path}/report", *QUICK)
    assert facts["system"] == "people"
    counts = facts["systems"]["people"]["comparisons"]
    assert (counts["genuine"], counts["impostor"]) == (3, 12)  # six of them of one session
    assert facts["eer"]["value"] == 0
    assert {path.name for path in (tmp_path / "report").iterdir()} == {
        ".splitknit",
        "det.svg",
        "report.html",
        "report.json",
        "roc.svg",
        "scores.csv",
        "scores.svg",
    }
    assert "scores.csv" in facts["files"]
    rows = table_of(tmp_path / "report")
    assert len(rows) == 15
    with GalleryFile(gallery) as opened:
        payloads = opened.people().templates
        place = {entry.names: payloads[entry.row] for entry in opened.entries()}
    for row in rows:
        a, b = (place[row[f"subject_{k}"], row[f"finger_{k}"], row[f"session_{k}"]] for k in "ab")
        sessions = row["session_a"], row["session_b"]
        assert sessions in (("1", "2"), ("1", "1"), ("2", "2"))
        assert sessions == ("1", "2") or row["label"] == "0"
        assert float(row["score"]) == ridge_match(unpack(a), unpack(b)).similarity
        same = row["finger_a"] == row["finger_b"] and row["subject_a"] == row["subject_b"]
        assert row["label"] == str(int(same))
    # anyone can evaluate the table again
    again = facts_of(
        capsys, f"evaluate --scores {tmp_path}/report/scores.csv --out", tmp_path / "again", *QUICK
    )
    for name in ("eer", "gar_at_far"):
        assert again[name] == facts[name]


def test_blocks_change_nothing(gallery, monkeypatch):
    whole = evaluation_gallery.gallery_scores(gallery)
    monkeypatch.setattr(evaluation_gallery, "KEPT_FINGERS", 1)
    assert evaluation_gallery.gallery_scores(gallery).table == whole.table


def test_failures_to_acquire_give_no_score(gallery, tmp_path, capsys):
    file = Path(shutil.copy(gallery, tmp_path / "g.skg"))
    (tmp_path / "none.skt").write_bytes(b"")
    finger = ("--person", "S02", "--finger", "right_index", "--session", "2")
    facts_of(capsys, f"enroll {file} {tmp_path}/none.skt", *finger, "--replace")
    file.chmod(0o644)
    facts = facts_of(capsys, f"evaluate --gallery {file} --out {tmp_path}/out", *QUICK)
    assert "readable-by-others" in [finding["code"] for finding in facts["findings"]]
    assert "1 of 6 captures are failures to acquire." in [
        finding["message"] for finding in facts["findings"]
    ]
    blank = [row for row in table_of(tmp_path / "out") if row["score"] == ""]
    assert len(blank) == 5
    for row in blank:
        assert ("S02", "right_index", "2") in {
            (row[f"subject_{k}"], row[f"finger_{k}"], row[f"session_{k}"]) for k in "ab"
        }
    assert facts["gar_at_far"]["0.01"]["value"] == pytest.approx(2 / 3)


@pytest.mark.slow
def test_no_name_leaves_an_encrypted_gallery(gallery, tmp_path, capsys):
    pytest.importorskip("sqlcipher3")
    file = tmp_path / "g.skg"
    (tmp_path / "key").write_text("0a" * 32)
    (tmp_path / "key").chmod(0o600)
    facts_of(capsys, f"gallery export {gallery} --out {tmp_path}/all")
    facts_of(capsys, f"gallery import {file} {tmp_path}/all --key-file {tmp_path}/key")
    arguments = ("evaluate", "--gallery", file, "--out", tmp_path / "out", *QUICK)
    assert "is encrypted" in refusal_of(capsys, *arguments)
    facts_of(capsys, *arguments, "--key-file", tmp_path / "key")
    for path in (tmp_path / "out").iterdir():
        assert b"S01" not in path.read_bytes()
    rows = table_of(tmp_path / "out")
    assert {row["subject_a"] for row in rows} == {"P001", "P002"}
    assert (
        facts_of(capsys, f"evaluate --gallery {gallery} --out {tmp_path}/plain", *QUICK)["eer"]
        == json.loads((tmp_path / "out/report.json").read_text())["eer"]
    )


def test_bad_input_is_one_sentence(gallery, tmp_path, capsys):
    single = Path(shutil.copy(gallery, tmp_path / "one.skg"))
    for person in ("S01", "S02"):
        facts_of(capsys, f"gallery remove {single} --person {person} --session 2")
    refusal_text = refusal_of(capsys, f"evaluate --gallery {single} --out {tmp_path}/out")
    assert "two sessions at least" in refusal_text
    assert str(single) in refusal_text
    scores = tmp_path / "scores.csv"
    scores.write_text("label,score\n1,0.9\n0,0.1\n")
    for arguments, words in (
        (("--gallery", scores), "is not a gallery"),
        (("--gallery", gallery, "--dissimilarity"), "--dissimilarity is for --scores"),
        (("--scores", scores, "--key-file", scores), "--key-file is for --gallery"),
    ):
        assert words in refusal_of(capsys, "evaluate", *arguments, "--out", tmp_path / "out")
    assert main(["evaluate", "--out", str(tmp_path / "out")]) == 2
    assert "--gallery" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
