"""The batch itself: what it writes, that it goes on where it stopped, and what it refuses."""

import fcntl
import json
import shutil

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from batch_stores import CASES, pairs_of, rows_of, run, tables
from refusals import bad_input
from splitknit.errors import Refused
from splitknit.finger.ridges import relief_print
from splitknit.io.capture import read_capture
from splitknit.io.images import read_image, write_image
from splitknit.pipeline import reconstruct
from splitknit.reconstruction import surface_of
from splitknit_match.batch.cases import Case
from splitknit_match.batch.store import Store, read_origin
from splitknit_match.evaluation.scores import read_scores
from splitknit_match.matching.ridge import ridge_match
from splitknit_match.matching.surface import surface_images, surface_template
from splitknit_match.matching.template import pack, unpack
from splitknit_match.matching.thesis import ThesisSettings, thesis_match
from splitknit_match.matching.thesis_code import code_match, code_side
from splitknit_match.records.pictures import read_print_png


@pytest.mark.slow
def test_rows_are_what_a_reconstruction_gives(people, reconstructed, tmp_path):
    table = Store(reconstructed).features("ea")
    assert table["capture"].tolist() == sorted(
        f"S{s:02d}/session_{k}/right_index" for s in (1, 2) for k in (1, 2)
    )
    row = rows_of(table)[1]
    result = reconstruct(read_capture(people / row["capture"]), "ea")
    surface = surface_of(result)
    assert row["finger"] == "S01/right_index"
    assert row["session"] == "2"
    assert row["acquired"]
    assert row["template"] == pack(surface_template(surface))
    assert row["area_mm2"] == pytest.approx(result.mask.sum() * result.pitch_mm**2)
    assert row["sharpness_white"] == result.quality["white"]["sharpness"]
    (tmp_path / "print.png").write_bytes(row["print"])
    written = read_print_png(tmp_path / "print.png")
    place = result.input_from_upright, result.upright_size
    assert_array_equal(
        written.image, relief_print(result.ridge_mm, result.mask, 1 / result.pitch_mm, *place)
    )
    assert written.resolution_ppi == pytest.approx(500, rel=1e-3)
    kept = Store(reconstructed).places("features", "ea")[row["capture"]].surface()
    for name, channel in surface_images(surface).channels.items():
        assert_array_equal(surface_images(kept).channels[name], channel)


def test_tables_hold_where_they_come_from(people, reconstructed):
    file = Store(reconstructed).files("features", "ea")[0]
    origin = read_origin(file)
    assert origin["software"] == "splitknit"
    assert origin["kind"] == "features"
    assert origin["settings"]["settings_sha256"] == CASES[0].document()["settings_sha256"]
    assert [len(sha256) for sha256 in origin["inputs"].values()] == [64]
    assert origin["inputs"].keys() == {
        file.relative_to(reconstructed / "features/ea").with_suffix("").as_posix()
    }


@pytest.mark.slow
def test_two_processes_leave_what_one_leaves(people, reconstructed, tmp_path):
    run(people, tmp_path / "other", jobs=2)
    assert tables(tmp_path / "other") == tables(reconstructed)
    assert len(tables(reconstructed)) == 8  # features and surfaces


def test_a_lost_table_alone_is_made_again_and_leftovers_go(people, store):
    before = tables(store)
    lost = Store(store).files("features", "ea")[1]
    lost.unlink()
    leftover = lost.with_name(".splitknit-0123456789ab.tmp")
    leftover.mkdir()
    (leftover / "new").write_bytes(b"half")
    (leftover / "mark.json").write_text(
        json.dumps({"format": "splitknit-temporary", "version": 1, "target": lost.name})
    )
    mine = lost.with_name(f".{lost.name}.0123.tmp")
    mine.write_bytes(b"mine")
    facts = run(people, store)
    assert facts["reconstructed"] == 1
    assert tables(store) == before
    assert not leftover.exists()
    assert mine.read_bytes() == b"mine"


@pytest.mark.slow
def test_nothing_is_written_or_read_through_a_link(people, store, tmp_path):
    """A store or a population that came from someone else may hold links: to files of the user, or
    of the system."""
    away = tmp_path / "away"
    away.mkdir()
    for name in ("ea_ridge.csv", ".0.tmp"):
        (away / name).write_text("mine")
    (store / "csv").mkdir()
    for link, target in (
        ("csv/ea_ridge.csv", away / "ea_ridge.csv"),
        ("csv", away),
        (".lock", away / "lock"),
        ("features", away),
        ("scores", away),
    ):
        place = store / link
        kept = store.with_name("kept")
        place.rename(kept) if place.exists() else None
        place.symlink_to(target)
        with bad_input(r"is a link inside a folder|is not a score file"):
            run(people, store, "ridge")
        place.unlink()
        kept.rename(place) if kept.exists() else None
    assert {path.name: path.read_text() for path in away.iterdir()} == {
        "ea_ridge.csv": "mine",
        ".0.tmp": "mine",
    }
    linked = tmp_path / "people"
    shutil.copytree(people, linked)
    photo = linked / "S01" / "session_1" / "right_index" / "white_0.png"
    # the link leads to the folder itself
    photo.symlink_to(photo.rename(photo.with_name("photo.png")))
    with pytest.raises(
        Refused,
        match=r"1 of 4 captures .*white_0.png' is a link inside a folder.*the others are done",
    ):
        run(linked, tmp_path / "new")


def test_a_score_file_of_the_user_is_not_replaced(people, store, tmp_path):
    file = store / "csv" / "ea_ridge.csv"
    for _ in range(2):  # our own is replaced
        assert run(people, store, "ridge")["csv"] == [str(file)]
    file.write_text("label,score\n1,0.9\n")
    with bad_input("exists and is not a score file of a batch; name another"):
        run(people, store, "ridge")
    assert file.read_text() == "label,score\n1,0.9\n"


@pytest.mark.slow
def test_a_growing_population_is_taken_as_it_comes(people, store, tmp_path):
    grown = tmp_path / "grown"
    shutil.copytree(people, grown)
    shutil.rmtree(grown / "S02" / "session_2" / "right_index")
    out = tmp_path / "out"
    facts = run(grown, out)
    assert (facts["captures"], facts["planned"], facts["reconstructed"]) == (3, 4, 3)
    shutil.copytree(
        people / "S02" / "session_2" / "right_index", grown / "S02" / "session_2" / "right_index"
    )
    facts = run(grown, out)
    assert (facts["reconstructed"], facts["found"]) == (1, 3)
    assert rows_of(Store(out).features("ea")) == rows_of(Store(store).features("ea"))


@pytest.mark.slow
def test_a_capture_without_a_finger_is_a_row(people, tmp_path):
    spoiled = tmp_path / "people"
    shutil.copytree(people, spoiled)
    image = spoiled / "S01" / "session_1" / "right_index" / "white_0.png"
    write_image(image, np.zeros_like(read_image(image)))
    facts = run(spoiled, tmp_path / "out")
    assert len(facts["failures"]) == 1
    table = Store(tmp_path / "out").features("ea")
    assert table["acquired"].tolist() == [False, True, True, True]
    assert table["failure"][0].startswith("white_0.png is black")
    assert table["failure"][1] == ""
    assert table["print"][0] == table["template"][0] == b""


def test_comparisons_are_the_matchers_own(copies):
    population, out = copies
    facts = run(population, out, "ridge")
    assert facts["scores"][0]["compared"] == 48
    pairs = pairs_of(out, "ridge")
    assert pairs == sorted(set(pairs))
    assert len(pairs) == 48
    table = Store(out).scores("ea", "ridge")
    templates = dict(
        zip(
            Store(out).features("ea")["capture"].tolist(),
            Store(out).features("ea")["template"].tolist(),
            strict=True,
        )
    )
    for row in rows_of(table)[::7]:
        if row["compared"]:
            direct = ridge_match(unpack(templates[row["a"]]), unpack(templates[row["b"]]))
            assert row["similarity"] == direct.similarity
            assert row["rotation_deg"] == direct.rotation_deg
        assert row["genuine"] == (row["a"].split("/")[::2] == row["b"].split("/")[::2])
    failed = [row for row in rows_of(table) if "S02/session_3/right_index" in (row["a"], row["b"])]
    assert len(failed) == 8
    assert not any(row["compared"] for row in failed)
    assert all(np.isnan(row["similarity"]) for row in failed)


def test_score_files_hold_what_the_store_holds(copies, tmp_path):
    population, out = copies
    run(population, out, "ridge")
    table = Store(out).scores("ea", "ridge")
    read = read_scores(out / "csv" / "ea_ridge.csv").scores
    assert_array_equal(read.score, table["similarity"])
    assert_array_equal(read.label, table["genuine"])
    assert read.label.sum() == 12
    assert np.isnan(read.score).sum() == 8
    assert np.nanmin(read.genuine) > np.nanmax(read.impostor)
    assert read.subject is not None and read.finger is not None
    assert read.subject.names == ("S01", "S02")
    assert len(read.finger.names) == 4


def test_more_impostors_are_added_to_those_that_are_there(copies):
    population, out = copies
    some = run(population, out, "ridge", impostors=0.6)["scores"][0]["compared"]
    first = pairs_of(out, "ridge")
    rest = run(population, out, "ridge")["scores"][0]["compared"]
    assert 12 < some < 36
    assert some + rest == 48 == len(set(pairs_of(out, "ridge")))
    assert set(first) < set(pairs_of(out, "ridge"))
    assert json.loads((out / "store.json").read_text())["pairs"]["impostors"] == 1.0
    with bad_input(r"another pairs\.seed"):
        run(population, out, "ridge", seed=5)


def test_a_lost_table_of_scores_is_made_again(copies, monkeypatch):
    monkeypatch.setattr("splitknit_match.batch.population.PAIRS", 8)
    population, out = copies
    run(population, out, "ridge")
    before = tables(out)
    next(iter(sorted((out / "scores" / "ea" / "ridge").iterdir()))).unlink()
    facts = run(population, out, "ridge")
    assert facts["scores"][0]["compared"] == 8
    assert tables(out) == before


def test_the_thesis_and_minutiae_compare_what_is_kept(people, store):
    pytest.importorskip("nbis")
    run(people, store, "thesis", "thesis-code", "minutiae")
    table = Store(store).scores("ea", "thesis")
    assert len(table["a"]) == 4
    row = rows_of(table)[1]
    places = Store(store).places("features", "ea")
    sides = [surface_images(places[row[side]].surface()) for side in "ab"]
    direct = thesis_match(sides[0], sides[1], ThesisSettings(gate=0.0))
    assert row["similarity"] == pytest.approx(direct.similarity, abs=1e-15)
    assert row["dissimilarity_relief"] == direct.dissimilarity["relief"]
    assert row["ratio"] == direct.ratio
    assert (
        rows_of(Store(store).scores("ea", "thesis-code"))[1]["shift_px"]
        == code_match(*map(code_side, sides)).shift_px
    )
    scores = Store(store).scores("ea", "minutiae")
    assert (
        scores["similarity"][scores["genuine"]].min()
        > scores["similarity"][~scores["genuine"]].max()
    )
    # made once: the second run reads them
    before = tables(store)
    run(people, store, "thesis", "minutiae")
    assert tables(store) == before


@pytest.mark.slow
def test_stores_without_surfaces_say_so(people, tmp_path):
    run(people, tmp_path / "out", surfaces=False)
    with bad_input("made without its surface"):
        run(people, tmp_path / "out", "thesis")


def test_other_settings_are_refused_by_name(people, store):
    case = Case("ea", "ea", {"height.method": "poisson"})
    with bad_input(r"another cases\.ea\.settings\.height\.method"):
        run(people, store, cases=(case,))


def test_other_populations_versions_and_folders_are_refused(people, store, tmp_path):
    changed_people = tmp_path / "other"
    shutil.copytree(people, changed_people, ignore=shutil.ignore_patterns("*.png", "truth.npz"))
    document = json.loads((changed_people / "population.json").read_text())
    (changed_people / "population.json").write_text(
        json.dumps(document | {"settings_sha256": "0" * 64})
    )
    with bad_input(r"another population\.sha256"):
        run(changed_people, store)
    kept = (store / "store.json").read_text()
    for change, words in (
        (
            {"format_version": 2},
            "version 2, and this is a reader of version 4; run the batch again",
        ),
        ({"version": "9.9"}, "made with another version"),
        ({"cases": 3}, "damaged"),
        ({"cases": {"ea": 3}}, "made with another cases.ea"),
        ({"pairs": []}, "damaged"),
    ):
        (store / "store.json").write_text(json.dumps(json.loads(kept) | change))
        with bad_input(words):
            run(people, store)
    (store / "store.json").write_text(kept[:100])
    with bad_input("damaged"):
        run(people, store)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").touch()
    with bad_input("not a store"):
        run(people, tmp_path / "full")
    assert (tmp_path / "full" / "thesis.txt").exists()


def test_no_captures_and_no_population(people, tmp_path):
    with bad_input("not a population"):
        run(tmp_path / "nothing", tmp_path / "out")
    empty = tmp_path / "empty"
    empty.mkdir()
    shutil.copy(people / "enrolment.json", empty)
    with bad_input("no finished capture"):
        run(empty, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage", [lambda data: data[:200], lambda data: b"PAR1" + data[4:-60] + b"\0" * 60]
)
def test_damaged_tables_are_named(people, store, damage):
    file = Store(store).files("features", "ea")[0]
    file.write_bytes(damage(file.read_bytes()))
    with bad_input(f"{file.name}' is damaged; delete it"):
        run(people, store, "ridge")
    file.unlink()
    assert run(people, store, "ridge")["reconstructed"] == 1


def test_two_runs_into_one_store(people, store):
    before = tables(store)
    with (store / ".lock").open("ab") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with bad_input("another run is writing"):
            run(people, store)
    assert tables(store) == before
    assert run(people, store)["found"] == 4


def test_cases_and_matchers_that_cannot_be(people, tmp_path):
    with bad_input("name of a case"):
        Case("a/b", "ea")
    with bad_input("no preset"):
        Case("mine", "eb")
    with bad_input("did you mean"):
        Case("mine", "ea", {"height.metod": 3})
    for changes, fault in (
        ({"cases": (Case("a", "ea"), Case("a", "pr"))}, "two cases have one name"),
        ({"cases": ()}, "at least one case"),
        ({"matchers": ("eyes",)}, "no matcher 'eyes'"),
        ({"impostors": 1.5}, "impostors must be from 0 to 1"),
        ({"jobs": 0}, "jobs must be 1 to 1024"),
    ):
        with bad_input(fault):
            run(people, tmp_path / "out", **changes)
