"""``splitknit identify``: the right one first, what that means, and nobody where it is nobody."""

import shutil
from pathlib import Path

import pytest

from enrolled import facts_of, refusal_of, words_of
from splitknit.cli.main import main
from splitknit_match.matching.methods import fmr_table, rate


@pytest.fixture(scope="module")
def gallery(people_folder, tmp_path_factory):
    """First sessions of three fingers, second of one, and a failure to acquire; not to be
    changed."""
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
        assert main([*f"enroll {file} {source} --person".split(), person, "--finger", finger]) == 0
    return file


@pytest.fixture
def probe(people_folder):
    """Bob comes back."""
    return people_folder / "S02/session_2/right_index"


def test_the_right_one_is_first(gallery, probe, capsys):
    facts = facts_of(capsys, f"identify {gallery} {probe}")
    first, second = facts["candidates"]
    assert (first["rank"], first["person"], first["finger"], first["session"]) == (
        1,
        "Bob",
        "right_index",
        "1",
    )
    assert second["person"] == "Ann"
    assert first["similarity"] > 0.7 > 0.5 > second["similarity"]  # noqa: PLR0133
    assert first["fmr"] == rate(first["similarity"], "ridge", None).fmr
    assert first["expected_false_matches"] == pytest.approx(4 * first["fmr"])
    assert second["expected_false_matches"] == pytest.approx(4 * second["fmr"])
    assert (
        facts["searched"] | {"captures": 4, "failures": 1, "fingers": 3, "people": 2}
        == facts["searched"]
    )
    assert facts["searched"]["compared"] == 4
    assert facts["mode"] == "identification"
    decision = facts["decision"]
    assert decision["match"]
    assert decision["threshold"] == fmr_table().threshold(1e-4)
    assert decision["expected_false_matches"] == pytest.approx(4e-4)
    # similarities are those of `splitknit match`
    match = facts_of(capsys, f"match {probe} {probe.parents[1]}/session_1/right_index")
    assert first["similarity"] == pytest.approx(match["similarity"], abs=1e-9)


def test_nobody_is_a_fact(gallery, probe, tmp_path, capsys):
    file = Path(shutil.copy(gallery, tmp_path / "g.skg"))
    facts_of(capsys, f"gallery remove {file} --person Bob")
    facts = facts_of(capsys, f"identify {file} {probe}")
    assert not facts["decision"]["match"]
    assert [candidate["person"] for candidate in facts["candidates"]] == ["Ann"]
    assert words_of(capsys, f"identify {file} {probe}").startswith(
        "No match: nobody is similar enough (decided at a false"
    )
    for person in ("Ann", "Cid"):
        facts_of(capsys, f"gallery remove {file} --person {person}")
    empty = facts_of(capsys, f"identify {file} {probe}")
    assert empty["candidates"] == []
    assert not empty["decision"]["match"]
    assert "nothing to compare with" in words_of(capsys, f"identify {file} {probe}")


def test_one_candidate_for_a_person_a_finger_or_a_capture(gallery, people_folder, capsys):
    probe = people_folder / "S01/session_1/left_thumb"

    def names_of(*more):
        candidates = facts_of(capsys, f"identify {gallery} {probe}", *more)["candidates"]
        assert [candidate["rank"] for candidate in candidates] == list(
            range(1, len(candidates) + 1)
        )
        assert sorted((candidate["similarity"] for candidate in candidates), reverse=True) == [
            candidate["similarity"] for candidate in candidates
        ]
        return [
            f"{candidate['person']} {candidate['finger']} {candidate['session']}"
            for candidate in candidates
        ]

    assert names_of() == ["Ann left_thumb 1", "Bob right_index 1"]
    by_finger = names_of("--merge", "finger")
    assert by_finger[0] == "Ann left_thumb 1"
    assert sorted(by_finger[1:]) == ["Ann right_index 1", "Bob right_index 1"]
    every = names_of("--merge", "none")
    assert every[:2] == ["Ann left_thumb 1", "Ann left_thumb 2"]
    assert len(every) == 4
    assert names_of("--merge", "none", "--top", 2) == every[:2]
    assert names_of("--finger", "right_index", "--merge", "finger") == by_finger[1:]


def test_verification(gallery, probe, capsys):
    claim = ("--person", "Bob", "--finger", "right_index")
    facts = facts_of(capsys, f"identify {gallery} {probe}", *claim)
    assert facts["mode"] == "verification"
    assert facts["searched"]["captures"] == 1
    assert facts["decision"]["match"]
    assert words_of(capsys, f"identify {gallery} {probe}", *claim).startswith("Verified: Bob")
    false = ("--person", "Ann")
    assert words_of(capsys, f"identify {gallery} {probe}", *false).startswith("Not verified: Ann")
    assert facts_of(capsys, f"identify {gallery} {probe}", *false)["searched"]["compared"] == 3


def test_decisions_at_other_rates(gallery, probe, tmp_path, capsys):
    file = Path(shutil.copy(gallery, tmp_path / "g.skg"))
    facts_of(capsys, f"gallery remove {file} --person Bob")
    best = facts_of(capsys, f"identify {file} {probe}")["candidates"][0]
    lenient = facts_of(capsys, f"identify {file} {probe} --fmr", min(0.9, 1.01 * best["fmr"]))
    assert lenient["decision"]["match"]  # as many other fingers are accepted as was asked for
    strict = facts_of(capsys, f"identify {file} {probe} --fmr", 0.9 * best["fmr"])
    assert not strict["decision"]["match"]
    assert strict["decision"]["threshold"] > best["similarity"] >= lenient["decision"]["threshold"]


def test_failures_to_acquire_match_nobody(gallery, tmp_path, capsys):
    (tmp_path / "none.skt").write_bytes(b"")
    facts = facts_of(capsys, f"identify {gallery} {tmp_path}/none.skt")
    assert facts["candidates"] == []
    assert not facts["decision"]["match"]
    assert not facts["probe"]["acquired"]
    assert "failure to acquire" in words_of(capsys, f"identify {gallery} {tmp_path}/none.skt")
    claim = facts_of(capsys, f"identify {gallery} {tmp_path}/none.skt --person Cid")
    assert not claim["decision"]["match"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("NOWHERE PROBE", "there is no gallery"),
        ("GALLERY NOWHERE", "there is no"),
        ("PROBE GALLERY", "is not a file"),
        ("GALLERY PROBE --person Nobody", "holds nothing of person 'Nobody'"),
        ("GALLERY PROBE --person Bob --finger left_thumb", "person 'Bob' and finger 'left_thumb'"),
        ("GALLERY PROBE --finger nose", "is not a finger"),
        ("GALLERY PROBE --fmr 0", "--fmr must lie"),
        ("GALLERY PROBE --fmr nan", "--fmr must lie"),
        ("GALLERY PROBE --fmr 1e-9", "rates below"),
        ("GALLERY PROBE --top 0", "--top must be at least 1"),
        ("GALLERY PROBE --set search.candidates=0", "--set"),
    ],
)
def test_bad_input_is_one_sentence(gallery, probe, tmp_path, capsys, *, arguments, words):
    names = {"GALLERY": gallery, "PROBE": probe, "NOWHERE": tmp_path / "NOWHERE"}
    assert words in refusal_of(
        capsys, "identify", *(names.get(word, word) for word in arguments.split())
    )
