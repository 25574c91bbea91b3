"""``splitknit identify``: the right one first, what that means, and nobody where it is nobody."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from enrolled import facts_of, refusal_of, words_of
from splitknit.cli.main import main
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.matching.methods import rate, similarity_at


@pytest.fixture(scope="module")
def gallery(people_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """First sessions of three fingers, second of one, and a failure to acquire; not to be changed."""
    folder = tmp_path_factory.mktemp("identify")
    file, none = folder / "g.skg", folder / "none.skt"
    none.write_bytes(b"")
    for source, person, finger in (
        (people_folder / "S01/session_1/left_thumb", "Ann", "left_thumb"),
        (people_folder / "S01/session_2/left_thumb", "Ann", "left_thumb"),
        (people_folder / "S01/session_1/right_index", "Ann", "right_index"),
        (people_folder / "S02/session_1/right_index", "Bob", "right_index"),
        (none, "Cid", "right_index"),
    ):
        assert main(["enroll", str(file), str(source), "--person", person, "--finger", finger]) == 0
    return file


@pytest.fixture
def probe(people_folder: Path) -> Path:
    """Bob comes back."""
    return people_folder / "S02/session_2/right_index"


def test_the_right_one_is_first(gallery: Path, probe: Path, capsys) -> None:
    facts = facts_of(capsys, "identify", gallery, probe)
    first, second = facts["candidates"]
    assert (first["rank"], first["person"], first["finger"], first["session"]) == (1, "Bob", "right_index", "1")
    assert second["person"] == "Ann"
    assert first["similarity"] > 0.7 > 0.5 > second["similarity"]  # noqa: PLR0133
    assert first["fmr"] == rate(first["similarity"], "ridge", None).fmr
    assert first["expected_false_matches"] == pytest.approx(4 * first["fmr"])
    assert second["expected_false_matches"] == pytest.approx(4 * second["fmr"])
    assert facts["searched"] | {"captures": 4, "failures": 1, "fingers": 3, "people": 2} == facts["searched"]
    assert facts["searched"]["compared"] == 4
    assert facts["mode"] == "identification"
    decision = facts["decision"]
    assert decision["match"]
    assert decision["threshold"] == similarity_at(1e-4)
    assert decision["expected_false_matches"] == pytest.approx(4e-4)
    # similarities are those of `splitknit match`
    match = facts_of(capsys, "match", probe, probe.parents[1] / "session_1/right_index")
    assert first["similarity"] == pytest.approx(match["similarity"], abs=1e-9)


def test_nobody_is_a_fact(gallery: Path, probe: Path, tmp_path: Path, capsys) -> None:
    file = Path(shutil.copy(gallery, tmp_path / "g.skg"))
    facts_of(capsys, "gallery", "remove", file, "--person", "Bob")
    facts = facts_of(capsys, "identify", file, probe)
    assert not facts["decision"]["match"]
    assert [one["person"] for one in facts["candidates"]] == ["Ann"]
    assert words_of(capsys, "identify", file, probe).startswith(
        "No match: nobody is similar enough (decided at a false"
    )
    for person in ("Ann", "Cid"):
        facts_of(capsys, "gallery", "remove", file, "--person", person)
    empty = facts_of(capsys, "identify", file, probe)
    assert empty["candidates"] == []
    assert not empty["decision"]["match"]
    assert "nothing to compare with" in words_of(capsys, "identify", file, probe)


def test_one_candidate_for_a_person_a_finger_or_a_capture(gallery: Path, people_folder: Path, capsys) -> None:
    probe = people_folder / "S01/session_1/left_thumb"

    def found(*more: object) -> list[str]:
        candidates = facts_of(capsys, "identify", gallery, probe, *more)["candidates"]
        assert [one["rank"] for one in candidates] == list(range(1, len(candidates) + 1))
        assert sorted((one["similarity"] for one in candidates), reverse=True) == [
            one["similarity"] for one in candidates
        ]
        return [f"{one['person']} {one['finger']} {one['session']}" for one in candidates]

    assert found() == ["Ann left_thumb 1", "Bob right_index 1"]
    by_finger = found("--merge", "finger")
    assert by_finger[0] == "Ann left_thumb 1"
    assert sorted(by_finger[1:]) == ["Ann right_index 1", "Bob right_index 1"]
    every = found("--merge", "none")
    assert every[:2] == ["Ann left_thumb 1", "Ann left_thumb 2"]
    assert len(every) == 4
    assert found("--merge", "none", "--top", 2) == every[:2]
    assert found("--finger", "right_index", "--merge", "finger") == by_finger[1:]


def test_verification(gallery: Path, probe: Path, capsys) -> None:
    claim = ("--person", "Bob", "--finger", "right_index")
    facts = facts_of(capsys, "identify", gallery, probe, *claim)
    assert facts["mode"] == "verification"
    assert facts["searched"]["captures"] == 1
    assert facts["decision"]["match"]
    assert words_of(capsys, "identify", gallery, probe, *claim).startswith("Verified: Bob")
    false = ("--person", "Ann")
    assert words_of(capsys, "identify", gallery, probe, *false).startswith("Not verified: Ann")
    assert facts_of(capsys, "identify", gallery, probe, *false)["searched"]["compared"] == 3


def test_decisions_at_other_rates(gallery: Path, probe: Path, tmp_path: Path, capsys) -> None:
    file = Path(shutil.copy(gallery, tmp_path / "g.skg"))
    facts_of(capsys, "gallery", "remove", file, "--person", "Bob")
    best = facts_of(capsys, "identify", file, probe)["candidates"][0]
    lenient = facts_of(capsys, "identify", file, probe, "--fmr", min(0.9, 1.01 * best["fmr"]))
    assert lenient["decision"]["match"]  # as many other fingers are accepted as was asked for
    strict = facts_of(capsys, "identify", file, probe, "--fmr", 0.9 * best["fmr"])
    assert not strict["decision"]["match"]
    assert strict["decision"]["threshold"] > best["similarity"] >= lenient["decision"]["threshold"]


def test_other_settings_have_no_rates(gallery: Path, probe: Path, capsys) -> None:
    facts = facts_of(capsys, "identify", gallery, probe, "--set", "ridge.patches.search_mm=0.5")
    assert facts["decision"] is None
    assert facts["candidates"][0]["fmr"] is None
    words = words_of(capsys, "identify", gallery, probe, "--set", "ridge.patches.search_mm=0.5")
    assert words.startswith("Undecided")
    assert "fmr" not in words


def test_a_search_by_codes(gallery: Path, probe: Path, tmp_path: Path, capsys) -> None:
    """With two candidates of four the codes have to choose; what they let through is compared as ever."""
    few = ("--search", "codes", "--set", "search.candidates=2", "--merge", "none")
    facts = facts_of(capsys, "identify", gallery, probe, *few)
    assert facts["searched"]["method"] == "codes"
    assert (facts["searched"]["captures"], facts["searched"]["compared"]) == (4, 2)
    all_ = facts_of(capsys, "identify", gallery, probe, "--search", "exhaustive", "--merge", "none")
    by_name = {(one["person"], one["finger"], one["session"]): one for one in all_["candidates"]}
    first = facts["candidates"][0]
    assert first["person"] == "Bob"
    assert -1 <= first["code_similarity"] <= 1.1
    for one in facts["candidates"]:
        assert one["similarity"] == by_name[one["person"], one["finger"], one["session"]]["similarity"]
        # of all that were searched, not of those that were compared
        assert one["expected_false_matches"] == pytest.approx(4 * one["fmr"])
    # codes that are missing or of another version are made for the search, and said to be
    file = Path(shutil.copy(gallery, tmp_path / "g.skg"))
    with Gallery.open(file) as opened:
        opened.set_codes({1: b"an older one", 4: b"another"}, 99)
    again = facts_of(capsys, "identify", file, probe, *few)
    assert again["candidates"] == facts["candidates"]
    assert again["searched"]["without_code"] == 2
    assert "gallery index" in words_of(capsys, "identify", file, probe, *few)


def test_failures_to_acquire_match_nobody(gallery: Path, tmp_path: Path, capsys) -> None:
    (tmp_path / "none.skt").write_bytes(b"")
    facts = facts_of(capsys, "identify", gallery, tmp_path / "none.skt")
    assert facts["candidates"] == []
    assert not facts["decision"]["match"]
    assert not facts["probe"]["acquired"]
    assert "failure to acquire" in words_of(capsys, "identify", gallery, tmp_path / "none.skt")
    claim = facts_of(capsys, "identify", gallery, tmp_path / "none.skt", "--person", "Cid")
    assert not claim["decision"]["match"]


def test_an_encrypted_gallery_finds_the_same(gallery: Path, probe: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    file = Path(shutil.copy(gallery, tmp_path / "g.skg"))
    monkeypatch.setenv("SPLITKNIT_GALLERY_NEW_KEY", "0a" * 32)
    facts_of(capsys, "gallery", "rekey", file)
    assert "is encrypted" in refusal_of(capsys, "identify", file, probe)
    plain = facts_of(capsys, "identify", gallery, probe)["candidates"]
    monkeypatch.setenv("SPLITKNIT_GALLERY_KEY", "0a" * 32)
    assert facts_of(capsys, "identify", file, probe)["candidates"] == plain


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["NOWHERE", "PROBE"], "there is no gallery"),
        (["GALLERY", "NOWHERE"], "there is no"),
        (["PROBE", "GALLERY"], "is a folder"),
        (["GALLERY", "PROBE", "--person", "Nobody"], "holds nothing of person 'Nobody'"),
        (["GALLERY", "PROBE", "--person", "Bob", "--finger", "left_thumb"], "person 'Bob' and finger 'left_thumb'"),
        (["GALLERY", "PROBE", "--finger", "nose"], "is not a finger"),
        (["GALLERY", "PROBE", "--fmr", "0"], "--fmr must lie"),
        (["GALLERY", "PROBE", "--fmr", "nan"], "--fmr must lie"),
        (["GALLERY", "PROBE", "--fmr", "1e-9"], "none below"),
        (["GALLERY", "PROBE", "--top", "0"], "--top must be at least 1"),
        (["GALLERY", "PROBE", "--set", "band.window_mm=0.7"], "made with other settings"),
        (["GALLERY", "PROBE", "--set", "search.candidates=0"], "search.candidates"),
        (["GALLERY", "PROBE", "--set", "thesis.gate=0"], "thesis"),
    ],
)
def test_bad_input_is_one_sentence(gallery: Path, probe: Path, tmp_path: Path, capsys, *, arguments, words) -> None:
    names = {"GALLERY": gallery, "PROBE": probe, "NOWHERE": tmp_path / "NOWHERE"}
    assert words in refusal_of(capsys, "identify", *(names.get(word, word) for word in arguments))


def test_codes_in_shards_under_a_key_that_is_renewed(gallery: Path, probe: Path, tmp_path: Path, capsys) -> None:
    key, shards = tmp_path / "key", tmp_path / "shards"
    key.write_text("ab" * 32)
    key.chmod(0o600)
    file = Path(shutil.copy(gallery, tmp_path / "g.skg"))
    facts_of(capsys, "gallery", "rekey", file, "--new-key-file", key)
    with_key = ("--key-file", key, "--shards", shards)
    facts = facts_of(capsys, "gallery", "index", file, *with_key)
    assert facts["shards"] | {"fingers": 4, "written": 1, "kept": 0, "keyed": True} == facts["shards"]
    plain = facts_of(capsys, "identify", file, probe, "--key-file", key)
    facts = facts_of(capsys, "identify", file, probe, *with_key)
    assert facts["searched"]["method"] == "shards"
    assert facts["searched"] | {"captures": 4, "failures": 1, "without_code": 0, "compared": 4} == facts["searched"]
    named = ("person", "finger", "session", "similarity")
    assert [[one[name] for name in named] for one in facts["candidates"]] == [
        [one[name] for name in named] for one in plain["candidates"]
    ]
    # nothing changed: nothing is written; renewed: everything is another
    own = tmp_path / "mine.skc"
    next(shards.iterdir()).rename(own)
    (shards / "codes-000000.skc").symlink_to(own)  # in a folder that came from someone else
    content = own.read_bytes()
    for words in (("index", file), ("index", file, "--renew")):
        assert "is a link, through which nothing is written" in refusal_of(capsys, "gallery", *words, *with_key)
    assert own.read_bytes() == content
    own.replace(shards / "codes-000000.skc")
    before = {one.name: one.read_bytes() for one in shards.iterdir()}
    assert facts_of(capsys, "gallery", "index", file, *with_key)["shards"]["kept"] == 1
    assert "wrote 1 shard" in words_of(capsys, "gallery", "index", file, *with_key, "--renew")
    assert {one.name for one in shards.iterdir()} == before.keys()
    assert all(one.read_bytes() != before[one.name] for one in shards.iterdir())
    again = facts_of(capsys, "identify", file, probe, *with_key)["candidates"]
    assert [[one[name] for name in named] for one in again] == [
        [one[name] for name in named] for one in plain["candidates"]
    ]
    # who left is not found, though the shards still hold the code
    facts_of(capsys, "gallery", "remove", file, "--person", "Bob", "--key-file", key)
    assert [one["person"] for one in facts_of(capsys, "identify", file, probe, *with_key)["candidates"]] == ["Ann"]
    assert facts_of(capsys, "gallery", "index", file, *with_key)["shards"]["fingers"] == 3
    # what cannot be
    for person in ("Ann", "Cid"):
        facts_of(capsys, "gallery", "remove", file, "--person", person, "--key-file", key)
    assert "there is no code to keep" in refusal_of(capsys, "gallery", "index", file, *with_key)
    assert "--renew is for shards" in refusal_of(capsys, "gallery", "index", file, "--key-file", key, "--renew")
    refused = refusal_of(capsys, "identify", file, probe, *with_key, "--person", "Ann")
    assert "--shards is for a search of the whole gallery" in refused
    assert "were made with a key" in refusal_of(capsys, "identify", gallery, probe, "--shards", shards)
    assert "without a key anyone" in words_of(capsys, "gallery", "index", gallery, "--shards", tmp_path / "plain")


def test_rows_that_the_shards_lack_are_counted(gallery: Path, probe: Path, tmp_path: Path, capsys) -> None:
    file = Path(shutil.copy(gallery, tmp_path / "g.skg"))
    facts_of(capsys, "gallery", "index", file, "--shards", tmp_path / "shards")
    facts_of(capsys, "enroll", file, probe, "--person", "Dan", "--finger", "right_index")
    facts = facts_of(capsys, "identify", file, probe, "--shards", tmp_path / "shards")
    assert facts["searched"]["without_code"] == 1
    assert facts["candidates"][0]["person"] == "Bob"
