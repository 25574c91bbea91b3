"""Templates that another program keeps, searched in memory as a gallery is."""

import importlib.util
import logging
from pathlib import Path

import pytest

import splitknit_match
from refusals import bad_input

from test_open_gallery import PPI, press  # isort: skip

PEOPLE = {"ann": 1, "bob": 2, "cid": 3}


@pytest.fixture(scope="module")
def templates():
    return {
        name: splitknit_match.make_template(press(seed), resolution_ppi=PPI).payload or b""
        for name, seed in PEOPLE.items()
    }


def test_candidates_are_found_as_in_a_gallery(templates, tmp_path, monkeypatch):
    gallery = splitknit_match.Gallery(tmp_path / "g.skg")
    for name, template in templates.items():
        gallery.enroll(template, name, "right_index")
    candidates = splitknit_match.Candidates(templates)
    probe = press(2, -7, 12.0)
    for most in (200, 1):  # all, and by the index of minutiae
        monkeypatch.setattr("splitknit_match.gallery.identify.ALL_PRINTS", most)
        own = candidates.search(probe, resolution_ppi=PPI, top=1)
        expected = gallery.identify(probe, resolution_ppi=PPI, top=1)
        assert own.answer == expected.answer == "match"
        assert own.candidates[0].person == "bob"
        assert own.candidates[0].similarity == expected.candidates[0].similarity
        assert own.searched == expected.searched
    candidates.remove("bob")
    assert candidates.search(probe, resolution_ppi=PPI).answer == "no match"
    candidates.add({"ann": templates["bob"]})  # replaces
    assert len(candidates) == 2
    assert candidates.search(probe, resolution_ppi=PPI).candidates[0].person == "ann"


def test_what_cannot_be_searched_is_refused(templates):
    candidates = splitknit_match.Candidates()
    assert candidates.search(press(1), resolution_ppi=PPI).answer == "no match"
    damaged = {"x": templates["ann"][:-9]}
    for bad, words in ((damaged, "^x: .* does not fit its header"), ({"x": "a"}, "bytes")):
        with bad_input(words):
            candidates.add(bad)
    with bad_input("there is no template 'x' among the candidates"):
        candidates.remove("x")
    assert len(candidates) == 0


def test_saved_candidates_are_loaded_with_their_minutiae(templates, tmp_path):
    candidates = splitknit_match.Candidates(templates)
    stages = []
    candidates.prepare(lambda stage, fraction: stages.append(stage))
    assert set(stages) == {"finding minutiae"}
    candidates.save(tmp_path / "c.skg")
    assert (tmp_path / "c.skg").stat().st_mode & 0o077 == 0
    loaded = splitknit_match.Candidates.load(tmp_path / "c.skg")
    probe = press(2, -7, 12.0)
    own, again = (each.search(probe, resolution_ppi=PPI) for each in (candidates, loaded))
    assert again.candidates == own.candidates
    stages.clear()
    loaded.prepare(lambda stage, fraction: stages.append(stage))
    assert not stages  # nothing is found anew
    loaded.add({"dan": templates["ann"]})
    assert len(loaded) == 4
    with bad_input(r"there is a file '.*' already"):
        candidates.save(tmp_path / "c.skg")


def test_files_of_candidates_are_refused_as_galleries_are(templates, tmp_path):
    with bad_input("no templates to save"):
        splitknit_match.Candidates().save(tmp_path / "none.skg")
    assert not (tmp_path / "none.skg").exists()
    with bad_input("there is no gallery"):
        splitknit_match.Candidates.load(tmp_path / "none.skg")
    damaged = tmp_path / "damaged.skg"
    splitknit_match.Candidates(templates).save(damaged)
    data = bytearray(damaged.read_bytes())
    place = data.find(templates["bob"][-300:-200])
    data[place : place + 50] = bytes(50)
    damaged.write_bytes(data)
    with bad_input("bob"):
        splitknit_match.Candidates.load(damaged)
    gallery = splitknit_match.Gallery(tmp_path / "g.skg")
    for name in ("ann", "bob"):
        gallery.enroll(templates[name], "Ann", "right_index", duplicates="allow")
    with bad_input("several captures of one person"):
        splitknit_match.Candidates.load(tmp_path / "g.skg")


def test_raising_in_progress_leaves_nothing(templates, tmp_path, caplog):
    def stopped(stage, fraction):
        if fraction == 1.0:
            raise KeyboardInterrupt

    gallery = splitknit_match.Gallery(tmp_path / "g.skg")
    with pytest.raises(KeyboardInterrupt):
        gallery.enroll(templates["ann"], "Ann", "right_index", progress=stopped)
    assert not (tmp_path / "g.skg").exists()
    with pytest.raises(KeyboardInterrupt):
        splitknit_match.make_template(templates["ann"], tmp_path / "a.skt", progress=stopped)
    assert not (tmp_path / "a.skt").exists()
    with caplog.at_level(logging.INFO, "splitknit_match"):
        gallery.enroll(templates["ann"], "Ann", "right_index")
        gallery.identify(templates["ann"])
        assert gallery.check().people == 1
        gallery.remove("Ann")
    words = " ".join(caplog.messages)
    assert "enrolled 1 captures" in words and "match" in words and "removed 1" in words
    assert "Ann" not in words


def test_the_example_of_an_own_database(capsys):
    """Against SQLite in memory; PostgreSQL differs in the URL alone."""
    pytest.importorskip("sqlalchemy")
    path = Path(__file__).parents[4] / "examples" / "own_database.py"
    spec = importlib.util.spec_from_file_location("own_database", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.main(["sqlite://"]) == 0
    assert capsys.readouterr().out == "Bob of 2 customers\n"
