"""The batch itself: what it writes, that it goes on where it stopped, and what it refuses."""

from __future__ import annotations

import fcntl
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from batch_stores import EA, chunks, pairs_of, rows_of
from splitknit.errors import BadInput, Refused
from splitknit.finger.ridges import relief_print
from splitknit.io.capture import read_capture
from splitknit.io.images import read_image, write_image
from splitknit.io.prints import read_print_png
from splitknit.model import surface_of
from splitknit.pipeline import reconstruct
from splitknit_match.batch.chunks import read_chunk, read_origin
from splitknit_match.batch.engine import run_batch, to_scores
from splitknit_match.batch.settings import BatchSettings, Case, preset_cases
from splitknit_match.batch.store import Store
from splitknit_match.evaluation.scores import read_scores
from splitknit_match.matching.ridge import ridge_match
from splitknit_match.matching.surface import MatchingSettings, surface_images, surface_template
from splitknit_match.matching.template import TemplateSettings, pack, unpack
from splitknit_match.matching.thesis import ThesisSettings, thesis_match

RIDGE = BatchSettings(cases=preset_cases(("ea",)), matchers=("ridge",))


def test_rows_are_what_a_reconstruction_gives(people: Path, reconstructed: Path, tmp_path: Path) -> None:
    table = Store(reconstructed).features("ea")
    assert table["capture"].tolist() == sorted(f"S{s:02d}/session_{k}/right_index" for s in (1, 2) for k in (1, 2))
    row = rows_of(table)[1]
    result = reconstruct(read_capture(people / row["capture"]), "ea")
    surface = surface_of(result)
    assert row["finger"] == "S01/right_index"
    assert row["session"] == "2"
    assert row["acquired"]
    assert row["template"] == pack(surface_template(surface, MatchingSettings()))
    assert row["area_mm2"] == pytest.approx(result.mask.sum() * result.pitch_mm**2)
    assert row["sharpness_white"] == result.quality["white"]["sharpness"]
    (tmp_path / "print.png").write_bytes(row["print"])
    shown = read_print_png(tmp_path / "print.png")
    place = result.input_from_upright, result.upright_size
    np.testing.assert_array_equal(shown.image, relief_print(result.ridge_mm, result.mask, 1 / result.pitch_mm, *place))
    assert shown.resolution_ppi == pytest.approx(500, rel=1e-3)
    kept, made = Store(reconstructed).images("ea", row["capture"]), surface_images(surface)
    for name, channel in made.channels.items():
        np.testing.assert_array_equal(kept.channels[name], channel)
    assert Store(reconstructed).features("ea", ["seconds"])["seconds"].tolist()[0] > 0


def test_chunks_say_where_they_come_from(people: Path, reconstructed: Path) -> None:
    file = Store(reconstructed).files("features", "ea")[0]
    origin = read_origin(file)
    assert origin["software"] == "splitknit"
    assert origin["kind"] == "features"
    document = EA.cases[0].document()
    for name in ("preset", "settings_sha256"):
        assert origin["settings"][name] == document[name]
    assert origin["inputs"].keys() == set(read_chunk(file, ["capture"])["capture"].tolist())
    assert all(len(one) == 64 for one in origin["inputs"].values())


@pytest.mark.slow
def test_two_processes_leave_what_one_leaves(people: Path, reconstructed: Path, tmp_path: Path) -> None:
    run_batch(people, tmp_path / "other", EA, jobs=2)
    assert chunks(tmp_path / "other") == chunks(reconstructed)
    assert len(chunks(reconstructed)) == 2


def test_what_is_there_is_not_done_again(people: Path, store: Path) -> None:
    before = {file: file.stat().st_mtime_ns for file in store.rglob("*.npz")}
    facts = run_batch(people, store, EA, jobs=1)
    assert (facts["reconstructed"], facts["found"]) == (0, 4)
    assert {file: file.stat().st_mtime_ns for file in store.rglob("*.npz")} == before


def test_a_lost_chunk_alone_is_made_again_and_leftovers_go(people: Path, store: Path) -> None:
    before = chunks(store)
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
    facts = run_batch(people, store, EA, jobs=1)
    assert facts["reconstructed"] == 2
    assert chunks(store) == before
    assert not leftover.exists()
    assert mine.read_bytes() == b"mine"


@pytest.mark.slow
def test_nothing_is_written_or_read_through_a_link(people: Path, store: Path, tmp_path: Path) -> None:
    """A store or a population that came from someone else may hold links: to files of the user, or of the system."""
    ridge, away = replace(EA, matchers=("ridge",)), tmp_path / "away"
    away.mkdir()
    for name in ("ea_ridge.csv", ".0.tmp"):
        (away / name).write_text("mine")
    (store / "csv").mkdir()
    for link, target in (
        ("csv/ea_ridge.csv", away / "ea_ridge.csv"),
        ("csv", away),
        (".lock", away / "lock"),
        ("timings", away),
        ("scores", away),
    ):
        place = store / link
        kept = store.with_name("kept")
        place.rename(kept) if place.exists() else None
        place.symlink_to(target)
        if link == "timings":
            Store(store).files("features", "ea")[0].unlink()
        with pytest.raises(BadInput, match=r"is a link inside a folder|is not a score file"):
            run_batch(people, store, ridge, jobs=1)
        place.unlink()
        kept.rename(place) if kept.exists() else None
    assert {path.name: path.read_text() for path in away.iterdir()} == {"ea_ridge.csv": "mine", ".0.tmp": "mine"}
    linked = tmp_path / "people"
    shutil.copytree(people, linked)
    photo = linked / "S01" / "session_1" / "right_index" / "white_0.png"
    photo.symlink_to(photo.rename(photo.with_name("photo.png")))  # the link leads to the folder itself
    with pytest.raises(Refused, match=r"1 of 4 captures .*white_0.png' is a link inside a folder.*the others are done"):
        run_batch(linked, tmp_path / "new", EA, jobs=1)


def test_a_score_file_of_the_user_is_not_replaced(people: Path, store: Path, tmp_path: Path) -> None:
    ridge, file = replace(EA, matchers=("ridge",)), tmp_path / "scores" / "ea_ridge.csv"
    for _ in range(2):  # our own is replaced
        assert run_batch(people, store, ridge, jobs=1, csv=file.parent)["csv"] == [str(file)]
    file.write_text("label,score\n1,0.9\n")
    with pytest.raises(BadInput, match="exists and is not a score file of a batch; name another"):
        run_batch(people, store, ridge, jobs=1, csv=file.parent)
    assert file.read_text() == "label,score\n1,0.9\n"


def test_a_growing_population_is_taken_as_it_comes(people: Path, store: Path, tmp_path: Path) -> None:
    grown = tmp_path / "grown"
    shutil.copytree(people, grown)
    shutil.rmtree(grown / "S02" / "session_2" / "right_index")
    out = tmp_path / "out"
    facts = run_batch(grown, out, EA, jobs=1)
    assert (facts["captures"], facts["planned"], facts["reconstructed"]) == (3, 4, 3)
    shutil.copytree(people / "S02" / "session_2" / "right_index", grown / "S02" / "session_2" / "right_index")
    facts = run_batch(grown, out, EA, jobs=1)
    assert (facts["reconstructed"], facts["found"]) == (1, 3)
    assert rows_of(Store(out).features("ea")) == rows_of(Store(store).features("ea"))


def test_a_capture_without_a_finger_is_a_row(people: Path, tmp_path: Path) -> None:
    spoiled = tmp_path / "people"
    shutil.copytree(people, spoiled)
    image = spoiled / "S01" / "session_1" / "right_index" / "white_0.png"
    write_image(image, np.zeros_like(read_image(image)))
    small = replace(EA, matching=MatchingSettings(template=TemplateSettings(least_area_mm2=1e6)))
    facts = run_batch(spoiled, tmp_path / "out", small, jobs=1)
    assert len(facts["failures"]) == 4
    table = Store(tmp_path / "out").features("ea")
    assert table["acquired"].tolist() == [False] * 4
    assert table["failure"][0].startswith("white_0.png is black")
    assert "too small" in table["failure"][1]
    assert table["print"][0] == b""
    assert table["print"][1] != b""
    assert table["template"].tolist() == [b""] * 4


def test_comparisons_are_the_matchers_own(copies: tuple[Path, Path]) -> None:
    population, out = copies
    facts = run_batch(population, out, RIDGE, jobs=1)
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


def test_scores_go_to_everyone(copies: tuple[Path, Path], tmp_path: Path) -> None:
    population, out = copies
    run_batch(population, out, RIDGE, jobs=1, csv=tmp_path / "csv")
    scores = to_scores(Store(out).scores("ea", "ridge"))
    assert scores.label.sum() == 12
    assert np.isnan(scores.score).sum() == 8
    assert scores.genuine[~np.isnan(scores.genuine)].min() > scores.impostor[~np.isnan(scores.impostor)].max()
    assert scores.subject is not None
    assert scores.subject.names == ("S01", "S02")
    (read,) = read_scores(tmp_path / "csv" / "ea_ridge.csv").systems
    np.testing.assert_array_equal(read.score, scores.score)
    np.testing.assert_array_equal(read.label, scores.label)
    assert read.finger is not None and scores.finger is not None
    np.testing.assert_array_equal(read.finger.codes, scores.finger.codes)
    turned = to_scores(Store(out).scores("ea", "ridge"), "correlation")
    assert turned.score[0] == Store(out).scores("ea", "ridge")["correlation"][0]
    with pytest.raises(BadInput, match="no column 'colour'"):
        to_scores(Store(out).scores("ea", "ridge"), "colour")


def test_more_impostors_are_added_to_those_that_are_there(copies: tuple[Path, Path]) -> None:
    population, out = copies
    some = run_batch(population, out, replace(RIDGE, impostors=0.6), jobs=1)["scores"][0]["compared"]
    first = pairs_of(out, "ridge")
    rest = run_batch(population, out, RIDGE, jobs=1)["scores"][0]["compared"]
    assert 12 < some < 36
    assert some + rest == 48 == len(set(pairs_of(out, "ridge")))
    assert set(first) < set(pairs_of(out, "ridge"))
    assert json.loads((out / "store.json").read_text())["pairs"]["impostors"] == 1.0
    with pytest.raises(BadInput, match="seed 0, not 5"):
        run_batch(population, out, replace(RIDGE, seed=5), jobs=1)


def test_a_lost_chunk_of_scores_is_made_again(copies: tuple[Path, Path]) -> None:
    population, out = copies
    run_batch(population, out, RIDGE, jobs=1)
    before = chunks(out)
    next(iter(sorted((out / "scores" / "ea" / "ridge").iterdir()))).unlink()
    facts = run_batch(population, out, RIDGE, jobs=1)
    assert facts["scores"][0]["compared"] == 16
    assert chunks(out) == before


def test_the_thesis_and_minutiae_compare_what_is_kept(people: Path, store: Path) -> None:
    pytest.importorskip("nbis")
    settings = replace(EA, matchers=("thesis", "minutiae"))
    run_batch(people, store, settings, jobs=1)
    table = Store(store).scores("ea", "thesis")
    assert len(table["a"]) == 4
    row = rows_of(table)[1]
    sides = [Store(store).images("ea", row[side]) for side in "ab"]
    direct = thesis_match(sides[0], sides[1], ThesisSettings(gate=0.0))
    assert row["similarity"] == pytest.approx(direct.similarity, abs=1e-15)
    assert row["dissimilarity_relief"] == direct.dissimilarity["relief"]
    assert row["ratio"] == direct.ratio
    assert to_scores(table, "dissimilarity_relief").score[1] == 1.0 - direct.dissimilarity["relief"]
    found = Store(store).scores("ea", "minutiae")
    assert found["similarity"].tolist() == found["bozorth3"].tolist()
    scores = to_scores(found)
    assert scores.genuine.min() > scores.impostor.max()
    # made once: the second run reads them
    before = chunks(store)
    run_batch(people, store, settings, jobs=1)
    assert chunks(store) == before


def test_stores_without_surfaces_say_so(people: Path, tmp_path: Path) -> None:
    run_batch(people, tmp_path / "out", replace(EA, surfaces=False), jobs=1)
    with pytest.raises(BadInput, match="without them"):
        run_batch(people, tmp_path / "out", replace(EA, matchers=("thesis",)), jobs=1)


def test_other_settings_are_refused_by_name(people: Path, store: Path) -> None:
    case = Case("ea", "ea", {"height.method": "poisson"})
    with pytest.raises(BadInput, match=r"case 'ea' \(height\.method\)"):
        run_batch(people, store, replace(EA, cases=(case,)), jobs=1)
    coarse = MatchingSettings(template=TemplateSettings(least_area_mm2=31.0))
    with pytest.raises(BadInput, match=r"templates \(template\.least_area_mm2\)"):
        run_batch(people, store, replace(EA, matching=coarse), jobs=1)


def test_other_populations_versions_and_folders_are_refused(people: Path, store: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(people, other, ignore=shutil.ignore_patterns("*.png", "truth.npz"))
    document = json.loads((other / "population.json").read_text())
    (other / "population.json").write_text(json.dumps(document | {"settings_sha256": "0" * 64}))
    with pytest.raises(BadInput, match="another population"):
        run_batch(other, store, EA, jobs=1)
    kept = (store / "store.json").read_text()
    for change, words in (
        ({"format_version": 2}, "version 2, and this is a reader of version 3; run the batch again"),
        ({"version": "9.9"}, "made by splitknit 9.9"),
        ({"cases": 3}, "damaged"),
        ({"cases": {"ea": 3}}, "damaged"),
        ({"matchers": {"ridge": None}}, "damaged"),
        ({"pairs": []}, "damaged"),
        ({"pairs": {"impostors": "all"}}, "damaged"),
    ):
        (store / "store.json").write_text(json.dumps(json.loads(kept) | change))
        with pytest.raises(BadInput, match=words):
            run_batch(people, store, EA, jobs=1)
    (store / "store.json").write_text(kept[:100])
    with pytest.raises(BadInput, match="damaged"):
        run_batch(people, store, EA, jobs=1)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").touch()
    with pytest.raises(BadInput, match="not a store"):
        run_batch(people, tmp_path / "full", EA, jobs=1)
    assert (tmp_path / "full" / "thesis.txt").exists()


def test_no_captures_and_no_population(people: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="not a population"):
        run_batch(tmp_path / "nothing", tmp_path / "out", EA)
    empty = tmp_path / "empty"
    empty.mkdir()
    shutil.copy(people / "enrolment.json", empty)
    with pytest.raises(BadInput, match="no finished capture"):
        run_batch(empty, tmp_path / "out", EA)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("damage", [lambda data: data[:200], lambda data: b"PAR1" + data[4:-60] + b"\0" * 60])
def test_damaged_chunks_are_named(people: Path, store: Path, damage) -> None:
    file = Store(store).files("features", "ea")[0]
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(BadInput, match=f"{file.name}' is damaged; delete it"):
        run_batch(people, store, EA, jobs=1)
    file.unlink()
    assert run_batch(people, store, EA, jobs=1)["reconstructed"] == 2


def test_two_runs_into_one_store(people: Path, store: Path) -> None:
    before = chunks(store)
    with (store / ".lock").open("ab") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(BadInput, match="another run is writing"):
            run_batch(people, store, EA, jobs=1)
    assert chunks(store) == before
    assert run_batch(people, store, EA, jobs=1)["found"] == 4


def test_cases_and_matchers_that_cannot_be(people: Path) -> None:
    with pytest.raises(BadInput, match="name of a case"):
        Case("a/b", "ea")
    with pytest.raises(BadInput, match="no preset"):
        Case("mine", "eb")
    with pytest.raises(BadInput, match="did you mean"):
        Case("mine", "ea", {"height.metod": 3})
    with pytest.raises(BadInput, match="two cases"):
        BatchSettings(cases=(Case("a", "ea"), Case("a", "pr")))
    with pytest.raises(BadInput, match="no matcher 'eyes'"):
        BatchSettings(matchers=("eyes",))
    with pytest.raises(BadInput, match="impostors must be from 0 to 1"):
        BatchSettings(impostors=1.5)
