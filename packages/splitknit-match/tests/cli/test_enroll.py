"""``splitknit enroll`` and ``splitknit gallery``: what goes in, what can be seen, what is gone,
what is refused."""

import csv
import io
import json
import re
import shlex
import shutil
import stat
from pathlib import Path

import numpy as np
import pytest

from enrolled import facts_of, refusal_of, words_of
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.prints import write_print_png

PHRASE = "a phrase for tests"


@pytest.fixture(scope="module")
def whole(people_folder, tmp_path_factory):
    """Gallery of the whole population; not to be changed."""
    file = tmp_path_factory.mktemp("whole") / "people.skg"
    assert main(f"enroll {file} --population {people_folder}".split()) == 0
    return file


@pytest.fixture
def gallery(whole, tmp_path):
    """The same, to be changed."""
    return Path(shutil.copy(whole, tmp_path / "people.skg"))


def who(capsys, gallery, *more):
    captures = facts_of(capsys, f"gallery list {gallery}", *more)["captures"]
    return [(capture["person"], capture["finger"], capture["session"]) for capture in captures]


def test_a_gallery_begins_with_its_first_finger(people_folder, tmp_path, capsys):
    source = people_folder / "S01/session_1/right_index"
    arguments = ("--person", "Zoe\u0308 Example", "--finger", "right_index")
    facts = facts_of(capsys, f"enroll {tmp_path}/g.skg {source}", *arguments)
    assert facts["created"]
    assert (facts["captures"], facts["fingers"], facts["people"]) == (1, 1, 1)
    (capture,) = facts["enrolled"]
    assert capture["person"] == "Zo\u00eb Example"
    assert capture["session"] == "1"
    assert capture["new"]
    assert capture["acquired"]
    assert 100 < capture["area_mm2"] < 500
    assert stat.S_IMODE((tmp_path / "g.skg").stat().st_mode) == 0o600
    listed = facts_of(capsys, f"gallery list {tmp_path}/g.skg")["captures"]
    assert listed[0]["enrolled_at"] is None
    # the same again is not a second finger
    again = facts_of(capsys, f"enroll {tmp_path}/g.skg {source}", *arguments)
    assert not again["created"]
    assert not again["enrolled"][0]["new"]
    assert again["captures"] == 1
    # equal enrolments, equal files
    facts_of(capsys, f"enroll {tmp_path}/h.skg {source}", *arguments)
    assert (tmp_path / "g.skg").read_bytes() == (tmp_path / "h.skg").read_bytes()


@pytest.mark.slow
def test_several_sources_are_sessions(people_folder, tmp_path, capsys):
    first, second = (people_folder / f"S02/session_{k}/right_index" for k in (1, 2))
    finger = ("--person", "Bob", "--finger", "right_index")
    words = words_of(capsys, f"enroll {tmp_path}/g.skg {first}/height.npz {second}", *finger)
    assert "Enrolled Bob, right index, session 1" in words
    assert "session 2" in words
    assert "holds 2 captures of 1 finger of 1 person." in words
    facts = facts_of(capsys, f"enroll {tmp_path}/g.skg {second}/print.png", *finger, "--with-time")
    assert facts["enrolled"][0]["session"] == "3"
    listed = facts_of(capsys, f"gallery list {tmp_path}/g.skg")["captures"]
    assert [capture["kind"] for capture in listed] == ["result", "result", "print"]
    assert listed[2]["enrolled_at"].endswith("+00:00")
    refusal = refusal_of(
        capsys, f"enroll {tmp_path}/g.skg {first}/print.png", *finger, "--session", "2"
    )
    assert "already" in refusal
    assert "--replace" in refusal
    facts_of(
        capsys, f"enroll {tmp_path}/g.skg {first}/print.png", *finger, "--session", "2", "--replace"
    )
    assert [
        capture["kind"]
        for capture in facts_of(capsys, f"gallery list {tmp_path}/g.skg")["captures"]
    ] == ["result", "print", "print"]


@pytest.mark.parametrize("grey", [0, 255])
def test_a_print_without_ridges_is_not_enrolled(grey, tmp_path, capsys):
    write_print_png(tmp_path / "a.png", np.full((400, 300), grey, np.uint8))
    whose = ("--person", "Ann", "--finger", "left_ring")
    refusal = refusal_of(capsys, f"enroll {tmp_path}/g.skg {tmp_path}/a.png", *whose)
    assert "failure to acquire" in refusal and "nothing was enrolled" in refusal
    assert not (tmp_path / "g.skg").exists()


def test_a_failure_to_acquire_is_kept_as_such(people_folder, tmp_path, capsys):
    (tmp_path / "none.skt").write_bytes(b"")
    arguments = (
        "enroll",
        tmp_path / "g.skg",
        tmp_path / "none.skt",
        "--person",
        "Ann",
        "--finger",
        "left_ring",
    )
    words = words_of(capsys, *arguments)
    assert "failure to acquire" in words
    assert "match nobody" in words
    facts = facts_of(capsys, f"gallery info {tmp_path}/g.skg")
    assert (facts["captures"], facts["failures"]) == (1, 1)
    assert "failure to acquire" in words_of(capsys, f"gallery list {tmp_path}/g.skg")


def test_a_population_with_one_call(people_folder, whole, tmp_path, capsys):
    assert who(capsys, whole) == [
        (person, finger, session)
        for person, finger in (
            ("S01", "left_thumb"),
            ("S01", "right_index"),
            ("S02", "right_index"),
        )
        for session in "12"
    ]
    facts = facts_of(capsys, f"gallery info {whole}")
    assert (facts["people"], facts["fingers"], facts["captures"]) == (2, 3, 6)
    assert facts["failures"] == 0


@pytest.mark.slow
def test_a_population_of_prints(people_folder, tmp_path, capsys):
    for picture in people_folder.glob("*/*/*/print.png"):
        copy = tmp_path / "prints" / picture.parent.relative_to(people_folder).with_suffix(".png")
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(picture, copy)
    file = tmp_path / "people.skg"
    facts = facts_of(capsys, f"enroll {file} --population {tmp_path}/prints")
    assert (facts["new"], facts["people"], facts["fingers"]) == (6, 2, 3)
    assert facts_of(capsys, f"enroll {file} --population {tmp_path}/prints")["known"] == 6
    (tmp_path / "prints" / "S01" / "session_1" / "right_index.skt").touch()
    words = refusal_of(capsys, f"enroll {file} --population {tmp_path}/prints")
    assert "are of one finger and session" in words


def test_a_population_goes_on_where_it_was_stopped(people_folder, tmp_path, capsys, monkeypatch):
    from splitknit_match.batch import enrol as enrolling_population

    file, calls = tmp_path / "g.skg", []
    original = enrolling_population.made_of

    def stopped(path, *options):
        calls.append(path)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return original(path, *options)

    monkeypatch.setattr(enrolling_population, "made_of", stopped)
    assert main(f"enroll {file} --population {people_folder}".split()) == 130
    capsys.readouterr()
    assert len(who(capsys, file)) == 3
    facts = facts_of(capsys, f"enroll {file} --population {people_folder}")
    assert (facts["found"], facts["known"], facts["new"]) == (6, 3, 3)
    assert len(calls) == 7
    again = facts_of(capsys, f"enroll {file} --population {people_folder}")
    assert (again["known"], again["new"]) == (6, 0)


def test_failures_and_damage_in_a_population(people_folder, tmp_path, capsys):
    folder, file = tmp_path / "people", tmp_path / "g.skg"
    for name in (
        "S01/session_1/left_thumb",
        "S02/session_1/right_index",
        "S02/session_2/right_index",
    ):
        shutil.copytree(people_folder / name, folder / name)
    with np.load(folder / "S02/session_1/right_index/height.npz") as arrays:
        smooth = dict(arrays) | {"ridge_mm": np.zeros_like(arrays["ridge_mm"])}
    np.savez(folder / "S02/session_1/right_index/height.npz", **smooth)
    sound = (folder / "S02/session_2/right_index/height.npz").read_bytes()
    (folder / "S02/session_2/right_index/height.npz").write_bytes(sound[:2000])
    assert main(f"enroll {file} --population {folder} --json".split()) == 2
    printed = capsys.readouterr()
    assert "1 of 3 captures cannot be read, the others are enrolled" in printed.err
    facts = json.loads(printed.out)
    assert (facts["new"], facts["failures"], len(facts["unreadable"])) == (2, 1, 1)
    assert facts["failures_to_acquire"][0]["path"].endswith("S02/session_1/right_index")
    (folder / "S02/session_2/right_index/height.npz").write_bytes(sound)
    assert facts_of(capsys, f"enroll {file} --population {folder}")["new"] == 1
    # other files under the same names are noticed
    shutil.copy(
        people_folder / "S01/session_2/left_thumb/height.npz",
        folder / "S01/session_1/left_thumb/height.npz",
    )
    assert "is not what was enrolled" in refusal_of(capsys, f"enroll {file} --population", folder)
    assert facts_of(capsys, f"enroll {file} --population {folder} --replace")["new"] == 1
    assert len(who(capsys, file)) == 3


def test_a_capture_without_a_finger_is_a_failure_not_an_error(twin_folder, monkeypatch):
    from splitknit_match.batch import enrol
    from splitknit_match.gallery import gallery

    def refuses(path, *rest, **more):
        raise BadInput(f"{path}: no finger is seen.")

    monkeypatch.setattr(gallery, "read_side", refuses)
    source = enrol._Source("Ann", "right_index", "1", twin_folder)
    capture = enrol._template_of(source, gallery.Enrolling(preset="ea"))
    assert capture.template == b""
    assert capture.failure == "no finger is seen."
    assert capture.source_sha256 == gallery.source_hash(twin_folder)


def test_a_capture_is_its_files_without_the_truth(twin_folder, tmp_path):
    from splitknit_match.gallery.gallery import source_hash

    copy = Path(shutil.copytree(twin_folder, tmp_path / "copy"))
    (copy / "truth.npz").unlink()
    assert source_hash(copy) == source_hash(twin_folder)
    (copy / "white_0.png").write_bytes((copy / "white_1.png").read_bytes())
    assert source_hash(copy) != source_hash(twin_folder)


@pytest.mark.slow
def test_workers_change_nothing(people_folder, whole, tmp_path, capsys):
    facts = facts_of(capsys, f"enroll {tmp_path}/g.skg --population {people_folder} --workers", 2)
    assert facts["new"] == 6
    for file in (whole, tmp_path / "g.skg"):
        facts_of(capsys, f"gallery export {file} --out", tmp_path / file.parent.name / "x")
    serial, parallel = (
        {
            row["person"] + row["finger"] + row["session"]: (folder / row["template"]).read_bytes()
            for row in rows
        }
        for folder in (tmp_path / whole.parent.name / "x", tmp_path / tmp_path.name / "x")
        for rows in [csv.DictReader(io.StringIO((folder / "gallery.csv").read_text()))]
    )
    assert serial == parallel


def test_a_gallery_that_others_can_read_gets_a_note(whole, tmp_path, capsys, monkeypatch):
    file = tmp_path / "g.skg"
    file.write_bytes(whole.read_bytes())
    for mode, noted in ((0o600, False), (0o644, True)):
        file.chmod(mode)
        assert main(["gallery", "info", str(file)]) == 0
        assert ("Please note: the gallery" in capsys.readouterr().out) == noted


@pytest.mark.slow
def test_an_encrypted_gallery(people_folder, tmp_path, capsys, monkeypatch):
    pytest.importorskip("sqlcipher3")
    file, key = tmp_path / "g.skg", tmp_path / "key"
    key.write_text(PHRASE + "\n")
    key.chmod(0o644)
    source = people_folder / "S01/session_1/left_thumb"
    arguments = ("enroll", file, source, "--person", "Ann Example", "--finger", "left_thumb")
    assert main([*map(str, arguments), "--key-file", str(key)]) == 0
    out = capsys.readouterr().out
    assert "encrypted" in out
    assert "can be read by others" in out
    assert b"Ann" not in file.read_bytes()
    assert "it is encrypted; give its key" in refusal_of(capsys, *arguments)
    monkeypatch.setenv("SPLITKNIT_GALLERY_KEY", "another phrase")
    refusal = refusal_of(capsys, f"gallery list {file}")
    assert "the key is not that of the gallery" in refusal
    assert "another phrase" not in refusal
    monkeypatch.setenv("SPLITKNIT_GALLERY_KEY", PHRASE)
    assert who(capsys, file) == [("Ann Example", "left_thumb", "1")]
    assert facts_of(capsys, f"gallery info {file}")["encrypted"]
    assert facts_of(capsys, f"identify {file} {source}")["candidates"][0]["person"] == "Ann Example"
    # without the key, and back under it
    facts_of(capsys, f"gallery export {file} --out {tmp_path}/out")
    facts_of(capsys, f"gallery import {tmp_path}/h.skg {tmp_path}/out")
    monkeypatch.delenv("SPLITKNIT_GALLERY_KEY")
    assert "it is encrypted; give its key" in refusal_of(
        capsys, "gallery", "list", tmp_path / "h.skg"
    )
    facts_of(capsys, f"gallery import {tmp_path}/plain.skg {tmp_path}/out")
    assert b"Ann" in (tmp_path / "plain.skg").read_bytes()
    refusal = refusal_of(capsys, f"gallery list {tmp_path}/plain.skg --key-file {key}")
    assert "is not encrypted; leave the key out" in refusal


def test_what_is_removed_is_gone(gallery, capsys):
    assert b"S02" in gallery.read_bytes()
    facts = facts_of(capsys, f"gallery remove {gallery} --person S02")
    assert (facts["removed"], facts["captures"]) == (2, 4)
    assert b"S02" not in gallery.read_bytes()
    assert (
        facts_of(capsys, f"gallery remove {gallery} --person S01 --finger left_thumb")["removed"]
        == 2
    )
    words = words_of(capsys, f"gallery remove {gallery} --person S01 --session 2")
    assert "Removed 1 capture from" in words
    assert who(capsys, gallery) == [("S01", "right_index", "1")]
    assert [path.name for path in gallery.parent.iterdir()] == [gallery.name]


def test_export_and_import(gallery, tmp_path, capsys):
    out = tmp_path / "out"
    assert "not encrypted" in words_of(capsys, f"gallery export {gallery} --out {out}")
    assert stat.S_IMODE(out.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in out.glob("*/*.skt")} == {0o600}
    facts = facts_of(capsys, f"gallery import {tmp_path}/new.skg {out}")
    assert (facts["found"], facts["new"], facts["captures"]) == (6, 6, 6)
    assert who(capsys, tmp_path / "new.skg") == who(capsys, gallery)
    again = facts_of(capsys, f"gallery import {tmp_path}/new.skg {out}")
    assert (again["new"], again["captures"]) == (0, 6)
    assert main(f"gallery export {tmp_path}/new.skg --out {tmp_path}/out2".split()) == 0
    capsys.readouterr()
    names = sorted(path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file())
    assert len(names) == 9
    assert all(
        (out / name).read_bytes() == (tmp_path / "out2" / name).read_bytes() for name in names
    )
    # an exported template is a template
    match = facts_of(capsys, f"match {out}/templates/0001.skt {out}/templates/0001.skt")
    assert match["similarity"] == pytest.approx(1, abs=1e-3)


def test_a_name_is_no_formula_in_an_exported_table(gallery, tmp_path, capsys):
    name = '=HYPERLINK("http://x","open")'
    out = tmp_path / "out"
    facts_of(capsys, f"gallery export {gallery} --out {out}")
    table = (
        (out / "gallery.csv").read_text().replace(",S01,", ",\"'" + name.replace('"', '""') + '",')
    )
    (out / "gallery.csv").write_text(table)
    facts_of(capsys, f"gallery import {tmp_path}/new.skg {out}")
    assert name in {person for person, *_ in who(capsys, tmp_path / "new.skg")}
    facts_of(capsys, f"gallery export {tmp_path}/new.skg --out {tmp_path}/again")
    assert (tmp_path / "again/gallery.csv").read_text() == table


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("gallery.json", lambda data: b"{}", "format: expected str"),
        (
            "gallery.json",
            lambda data: data.replace(b'_version": 2', b'_version": 1e999'),
            "Number out of range",
        ),
        (
            "gallery.csv",
            lambda data: re.sub(rb",\d+\.\d+,", b",1e999,", data),
            "area_mm2 must be a number",
        ),
        ("gallery.csv", lambda data: data + b"\xff\n", "cannot be read as a table"),
        (
            "gallery.json",
            lambda data: data.replace(b'"template_version": 2', b'"template_version": 9'),
            "version 9",
        ),
        (
            "gallery.csv",
            lambda data: data.replace(b"0001.skt", b"../a.skt"),
            "line 2: a template is named",
        ),
        (
            "gallery.csv",
            lambda data: data.replace(b"right_index", b"Right Index"),
            "cannot be a finger",
        ),
        ("gallery.csv", lambda data: data.replace(b"session", b"seance", 1), "columns"),
        ("gallery.csv", lambda data: data.splitlines(keepends=True)[0], "lists no finger"),
        (
            "gallery.csv",
            lambda data: data + data.splitlines()[1],
            "lines 2 and 8 are of the same finger and session",
        ),
        ("templates/0003.skt", lambda data: data[:-1] + bytes([data[-1] ^ 1]), "line 4: .*damaged"),
        ("templates/0003.skt", None, "line 4: .*does not exist"),
    ],
)
def test_a_damaged_export_is_not_imported(whole, tmp_path, capsys, *, file, change, words):
    out = tmp_path / "out"
    facts_of(capsys, f"gallery export {whole} --out {out}")
    data = (out / file).read_bytes()
    (out / file).unlink()
    if change is not None:
        (out / file).write_bytes(change(data))
    assert re.search(words, refusal_of(capsys, f"gallery import {tmp_path}/new.skg {out}"))
    assert not (tmp_path / "new.skg").exists()


@pytest.mark.parametrize("name", ["templates/0001.skt", "gallery.csv"])
def test_an_export_with_a_link_is_not_imported(whole, tmp_path, capsys, *, name):
    out, away = tmp_path / "out", tmp_path / "away"
    facts_of(capsys, f"gallery export {whole} --out {out}")
    away.mkdir()
    (out / name).rename(away / "file")
    (out / name).symlink_to(away / "file")
    (tmp_path / "link").symlink_to(out)  # what is named may be one
    assert "is a link inside a folder" in refusal_of(
        capsys, "gallery", "import", tmp_path / "new.skg", tmp_path / "link"
    )
    assert not (tmp_path / "new.skg").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("enroll NEW SOURCE", "name whose finger"),
        ("enroll NEW --person A --finger right_index", "name a capture"),
        ("enroll NEW SOURCE --person A --finger nose", "is not a finger"),
        ("enroll NEW SOURCE --person '' --finger right_index", "person's name"),
        ("enroll NEW SOURCE --person A --finger right_index --session 'a b'", "a session"),
        ("enroll NEW SOURCE SOURCE --person A --finger right_index --session 1", "one so"),
        ("enroll NEW NOWHERE --person A --finger right_index", "there is no"),
        ("enroll NOWHERE/g SOURCE --person A --finger right_index", "there is no folder"),
        ("enroll TEXT SOURCE --person A --finger right_index", "is not a gallery"),
        ("enroll FOLDER SOURCE --person A --finger right_index", "is not a file"),
        ("enroll NEW SOURCE --person A --finger right_index --key-file NOWHERE", "key file"),
        ("enroll NEW SOURCE --person A --finger right_index --workers 2", "--population"),
        ("enroll NEW --population FOLDER", "holds nothing to enrol"),
        ("enroll NEW --population NOWHERE", "there is no folder"),
        ("enroll NEW --population FOLDER --person A", "does not go with"),
        ("enroll NEW SOURCE --population FOLDER", "not both"),
        ("gallery list NOWHERE", "there is no gallery"),
        ("gallery list WHOLE --person Nobody", "holds nothing of"),
        ("gallery remove WHOLE --person Nobody", "holds nothing of Nobody"),
        ("gallery export TEXT --out NEW", "is not a gallery"),
        ("gallery import NEW FOLDER", "is not an export"),
    ],
)
def test_bad_input_is_one_sentence(people_folder, whole, tmp_path, capsys, *, arguments, words):
    (tmp_path / "TEXT").write_text("hello")
    (tmp_path / "FOLDER").mkdir()
    names = {"SOURCE": people_folder / "S02/session_1/right_index", "WHOLE": whole}
    names |= {name: tmp_path / name for name in ("NEW", "NOWHERE", "NOWHERE/g", "TEXT", "FOLDER")}
    before, data = sorted(path.name for path in tmp_path.iterdir()), whole.read_bytes()
    assert words in refusal_of(capsys, *(names.get(word, word) for word in shlex.split(arguments)))
    assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert whole.read_bytes() == data
