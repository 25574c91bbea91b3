"""``splitknit forget``: what is kept of a person is found by what we wrote, erased, and nothing else is touched."""

from __future__ import annotations

import csv
import json
import os
import shutil
from pathlib import Path

import pytest

from enrolled import facts_of, refusal_of
from splitknit.cli.main import main
from splitknit.io.atomic import _write_manifest
from splitknit_match.batch.chunks import column_type, load, read_chunk, write_chunk
from splitknit_match.batch.scores import score_schema
from splitknit_match.gallery.gallery import Gallery

S01, S02 = "S01/session_1/right_index", "S02/session_1/right_index"


@pytest.fixture(scope="module")
def made(people_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A gallery with its shards, the enrolment it was made of, exports, and a store; not to be changed."""
    root = tmp_path_factory.mktemp("kept")
    shutil.copytree(people_folder, root / "people")
    for result in (root / "people").glob("*/*/*"):
        _write_manifest(result)
    gallery = str(root / "people.skg")
    for words in (
        ["enroll", gallery, "--population", str(root / "people")],
        ["gallery", "index", gallery, "--shards", str(root / "codes")],
        ["gallery", "export", gallery, "--out", str(root / "plain")],
        ["export", gallery, "--to", "iso-19794-2", "--out", str(root / "records")],
    ):
        assert main(words) == 0
    store = root / "store"
    (store / "features" / "ea").mkdir(parents=True)
    (store / "timings" / "ea").mkdir(parents=True)
    (store / "csv").mkdir()
    (store / "store.json").write_text('{"format": "splitknit-batch"}')
    schema = load("pyarrow", "batch").schema([(name, column_type(name)) for name in ("capture", "template")])
    both = {"capture": [S01, S02], "template": [b"ridges of S01", b"ridges of S02"]}
    write_chunk(store / "features" / "ea" / "00000.parquet", both, schema, {"software": "splitknit"})
    only = {"capture": [S01], "template": [b"ridges of S01"]}
    write_chunk(store / "features" / "ea" / "00001.parquet", only, schema, {"software": "splitknit"})
    (store / "scores" / "ea" / "ridge").mkdir(parents=True)
    scores = {
        "a": [S01, S02],
        "b": [S02, S02],
        "genuine": [False, True],
        "similarity": [0.1, 0.9],
        "compared": [True] * 2,
    }
    write_chunk(store / "scores" / "ea" / "ridge" / "0.parquet", scores, score_schema(()), {"software": "splitknit"})
    (store / "timings" / "ea" / "00000.json").write_text(json.dumps({S01: 1.0, S02: 2.0}))
    (store / "csv" / "ea_ridge.csv").write_text("label,score,subject_a,subject_b\n0,0.1,S01,S02\n1,0.9,S02,S02\n")
    return root


@pytest.fixture
def kept(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "kept"))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


def contents_of_others(folder: Path) -> dict[str, bytes]:
    """Files of another program that have the names of ours."""
    folder.mkdir()
    for name in ("shards.json", "codes-000000.skc", "store.json", "gallery.json", "population.json", "export.json"):
        (folder / name).write_text('{"files": [{"person": "S01", "file": "gallery.csv"}]}')
    for name in ("gallery.csv", "population.csv", "scores.csv"):
        (folder / name).write_text("person,subject\nS01,S02\n")
    return contents(folder)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
def test_a_strangers_folder_holds_no_erasure_up(kept: Path, capsys) -> None:
    for name, form in (("pipe", os.mkfifo), ("zero", lambda mark: mark.symlink_to("/dev/zero"))):
        (kept / name).mkdir()
        (kept / name / "report.json").write_text('{"capture": {"subject": {"id": "S01"}}}')
        form(kept / name / ".splitknit")
    assert "1 places could not be looked into" in refusal_of(capsys, "forget", "--person", "S01", kept, "--yes")
    with Gallery.open(kept / "people.skg") as gallery:
        assert {one.entry.person for one in gallery.entries()} == {"S02"}
    assert {name.name for name in (kept / "pipe").iterdir()} == {"report.json", ".splitknit"}
    assert "neither a gallery" in refusal_of(capsys, "forget", "--person", "S01", kept / "pipe" / ".splitknit", "--yes")


def test_nothing_of_the_person_is_left_and_the_others_are(kept: Path, capsys) -> None:
    (kept / "mine.csv").write_text("person,phone\nS01,1234\n")
    (kept / "people" / "S01" / "notes.txt").write_text("hello")
    mine = contents_of_others(kept / "mine")
    facts = facts_of(capsys, "forget", "--person", "S01", kept / "people.skg", kept, kept / "store", "--yes")
    assert len(facts["found"]) == 8
    assert {one["what"] for one in facts["found"]} == {
        "gallery", "capture or result", "export of a gallery", "export", "store",
    }  # fmt: skip
    with Gallery.open(kept / "people.skg") as gallery:
        assert {one.entry.person for one in gallery.entries()} == {"S02"}
    assert facts_of(capsys, "gallery", "check", kept / "people.skg", "--shards", kept / "codes")["sound"]
    assert {path.parent.name for path in (kept / "people").glob("*/session_*")} == {"S02"}
    assert [path.name for path in (kept / "people" / "S01").iterdir()] == ["notes.txt"]
    assert "S01" not in (kept / "plain" / "gallery.csv").read_text()
    assert len(list((kept / "plain" / "templates").iterdir())) == 2
    assert facts_of(capsys, "gallery", "import", kept / "new.skg", kept / "plain")["new"] == 2
    assert len(list((kept / "records").glob("*.iso"))) == 2
    assert b"S01" not in (kept / "records" / "export.json").read_bytes()
    store = kept / "store"
    assert read_chunk(store / "features" / "ea" / "00000.parquet").to_pydict()["template"] == [b"ridges of S02"]
    assert read_chunk(store / "features" / "ea" / "00001.parquet").num_rows == 0
    assert read_chunk(store / "scores" / "ea" / "ridge" / "0.parquet").num_rows == 1
    assert json.loads((store / "timings" / "ea" / "00000.json").read_text()) == {S02: 2.0}
    assert "S01" not in (store / "csv" / "ea_ridge.csv").read_text()
    # what we did not write is named, not touched
    assert contents(kept / "mine") == mine
    assert set(facts["mentions"]) == {str(kept / "mine.csv"), *(str(kept / "mine" / name) for name in mine)}
    assert (kept / "mine.csv").read_text() == "person,phone\nS01,1234\n"


def test_nothing_is_erased_without_a_yes(kept: Path, capsys) -> None:
    before = contents(kept)
    assert main(["forget", "--person", "S01", str(kept)]) == 2
    said = capsys.readouterr()
    assert "4 records of" in said.out
    assert said.err == "splitknit: error: nothing was erased; give --yes to erase what was found.\n"
    assert main(["forget", "--person", "S01", str(kept), "--json"]) == 2
    assert not json.loads(capsys.readouterr().out)["erased"]
    assert "nothing of S09 was found" in refusal_of(capsys, "forget", "--person", "S09", kept / "people", "--yes")
    for place in ("nowhere", "plain/gallery.csv"):
        words = refusal_of(capsys, "forget", "--person", "S01", kept / place, "--yes")
        assert "is neither a gallery nor a folder" in words
    assert contents(kept) == before


def test_what_a_file_held_is_overwritten(kept: Path, capsys) -> None:
    """A second name of the same file shows what is left on the disk."""
    template = kept / "plain" / "templates" / "0001.skt"
    chunk = kept / "store" / "features" / "ea" / "00000.parquet"
    second = [kept.parent / "template", kept.parent / "chunk"]
    for link, file in zip(second, (template, chunk), strict=True):
        link.hardlink_to(file)
    facts_of(capsys, "forget", "--person", "S01", kept, "--yes")
    assert [set(link.read_bytes()) for link in second] == [{0}, {0}]


def test_links_and_tables_do_not_lead_out(kept: Path, capsys) -> None:
    outside = kept.parent / "outside"
    outside.mkdir()
    (outside / "mine.skt").write_bytes(b"mine")
    (kept / "link").symlink_to(outside)
    table = kept / "plain" / "gallery.csv"
    table.write_text(table.read_text().replace("templates/0001.skt", str(outside / "mine.skt")))
    (kept / "records" / "S01_left_thumb_1.iso").unlink()
    (kept / "records" / "S01_left_thumb_1.iso").symlink_to(outside / "mine.skt")
    assert main(["forget", "--person", "S01", str(kept), "--yes", "--json"]) == 2
    facts = json.loads(capsys.readouterr().out)
    reasons = " ".join(one["reason"] for one in facts["unreached"])
    assert "a link is not followed" in reasons and "names a file outside of it" in reasons
    assert (outside / "mine.skt").read_bytes() == b"mine"
    with Gallery.open(kept / "people.skg") as gallery:  # the rest is erased
        assert {one.entry.person for one in gallery.entries()} == {"S02"}


def test_a_person_is_given_all_that_is_kept(made: Path, tmp_path: Path, capsys) -> None:
    facts = facts_of(capsys, "gallery", "export", made / "people.skg", "--person", "S02", "--out", tmp_path / "out")
    assert facts["captures"] == 2
    rows = list(csv.DictReader((tmp_path / "out" / "gallery.csv").read_text().splitlines()))
    with Gallery.open(made / "people.skg") as gallery:
        codes = [code for row, code in gallery.codes(1).items() if gallery.entries_at([row])[row].entry.person == "S02"]
    assert [bytes.fromhex(row["code"]) for row in rows] == codes
    assert {row["person"] for row in rows} == {"S02"}
    assert facts_of(capsys, "gallery", "import", tmp_path / "again.skg", tmp_path / "out")["new"] == 2
    words = refusal_of(capsys, "gallery", "export", made / "people.skg", "--person", "S09", "--out", tmp_path / "no")
    assert "holds nothing of person 'S09'" in words and not (tmp_path / "no").exists()


def test_who_opened_a_gallery_is_put_down_where_that_is_wanted(kept: Path, capsys) -> None:
    file, log = kept / "people.skg", kept / "people.skg.log"
    facts_of(capsys, "gallery", "list", file)
    assert not log.exists()
    log.touch(mode=0o644)
    facts_of(capsys, "gallery", "list", file)
    with Gallery.open(file):
        pass
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert lines[0]["verb"] == "gallery list"
    assert all(line["gallery"] == str(file) and line["user"] and line["time"].endswith("+00:00") for line in lines)
    assert log.stat().st_mode & 0o777 == 0o600
    log.unlink()
    log.symlink_to(kept / "elsewhere")
    assert "the access log" in refusal_of(capsys, "gallery", "list", file)
    assert not (kept / "elsewhere").exists()
    log.unlink()
    os.mkfifo(log)  # it held the program
    assert "the access log" in refusal_of(capsys, "gallery", "list", file)


def test_a_name_that_tables_hold_as_text_is_found(kept: Path, capsys) -> None:
    table = kept / "plain" / "gallery.csv"
    table.write_text(table.read_text().replace(",S01,", ",'=S01,"))  # as tables hold the name =S01
    facts_of(capsys, "forget", "--person", "=S01", kept / "plain", "--yes")
    assert "S01" not in table.read_text()
    assert len(list((kept / "plain" / "templates").iterdir())) == 2


def test_chunks_are_read_within_the_bounds_of_all_chunks(kept: Path, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splitknit_match.batch.chunks._MAX_ROWS", 1)
    assert main(["forget", "--person", "S01", str(kept / "store"), "--json"]) == 2
    facts = json.loads(capsys.readouterr().out)
    assert [one["path"] for one in facts["unreached"]] == [str(kept / "store")]
    assert ".parquet' is too large" in facts["unreached"][0]["reason"]
