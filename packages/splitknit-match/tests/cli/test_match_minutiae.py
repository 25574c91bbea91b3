"""``splitknit match --method minutiae``: results and prints by their minutiae."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.prints import read_print_png, write_print_png
from splitknit_match.evaluation.gallery_scores import gallery_scores
from splitknit_match.evaluation.scores import Scores
from splitknit_match.matching.methods import rate
from splitknit_match.prints.minutiae import extract, minutiae_match
from splitknit_match.prints.minutiae_record import no_minutiae


def facts_of(
    capsys: pytest.CaptureFixture[str], *arguments: object, method: str = "minutiae"
) -> dict:
    assert main(["match", *map(str, arguments), "--method", method, "--json"]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    return json.loads(printed.out)


@pytest.mark.slow
def test_one_finger_is_told_from_another(impressions: Path, capsys) -> None:
    same = facts_of(capsys, impressions / "a", impressions / "again")
    stranger = facts_of(capsys, impressions / "a", impressions / "other")
    assert same["similarity"] > 80 > 40 > stranger["similarity"]  # noqa: PLR0133
    assert same["compared"]
    assert same["a"]["minutiae"] > 20
    assert 0 <= same["a"]["nfiq2"] <= 100
    assert not same["a"]["enhanced"]
    assert "sides" not in same


@pytest.mark.slow
def test_the_similarity_is_that_of_the_prints(impressions: Path, capsys) -> None:
    """What a result's print.png gives, taken as it is."""
    facts = facts_of(capsys, impressions / "a", impressions / "again")
    sides = [
        extract(read_print_png(impressions / name / "print.png").image) for name in ("a", "again")
    ]
    assert facts["similarity"] == minutiae_match(*sides)
    assert (
        facts["similarity"]
        == facts_of(capsys, impressions / "again", impressions / "a")["similarity"]
    )


def test_prints_match_their_surfaces(impressions: Path, capsys) -> None:
    facts = facts_of(capsys, impressions / "a", impressions / "again" / "print.png")
    assert facts["similarity"] > 60
    assert facts["b"]["enhanced"]
    assert facts["decision"]["match"]
    assert facts["fmr_basis"]["population"] == "presses of 150 simulated fingers"


def test_rates_are_of_the_shipped_table(impressions: Path, capsys) -> None:
    same, stranger = (
        facts_of(capsys, impressions / "a", impressions / name) for name in ("again", "other")
    )
    low, high = (rate(similarity, "minutiae", None).fmr for similarity in (5.0, 200.0))
    assert same["fmr"] == rate(same["similarity"], "minutiae", None).fmr
    assert high == same["fmr"] < 1e-3 < stranger["fmr"] <= 1
    assert high < low


def test_words_for_people(impressions: Path, capsys) -> None:
    assert (
        main(["match", str(impressions / "a"), str(impressions / "again"), "--method", "minutiae"])
        == 0
    )
    words = capsys.readouterr().out
    assert words.startswith(
        "Match, decided at a false match rate of 1 in 10,000 (method minutiae)."
    )
    assert "quality (NFIQ 2)" in words
    assert (
        main(
            [
                "match",
                str(impressions / "a"),
                str(impressions / "again"),
                "--method",
                "minutiae",
                "--raw",
            ]
        )
        == 0
    )
    words = capsys.readouterr().out
    assert "pairs of minutiae fit together" in words


def test_an_empty_print_is_a_failure_to_acquire(impressions: Path, tmp_path: Path, capsys) -> None:
    write_print_png(tmp_path / "empty.png", np.full((300, 300), 255, np.uint8), 500.0)
    facts = facts_of(capsys, tmp_path / "empty.png", impressions / "a")
    assert facts["similarity"] == 0
    assert not facts["compared"]
    assert not facts["a"]["acquired"]
    assert facts["a"]["nfiq2"] is None
    assert facts["fmr"] is None
    assert (
        main(["match", str(tmp_path / "empty.png"), str(impressions / "a"), "--method", "minutiae"])
        == 0
    )
    assert "fewer than ten minutiae (failure to acquire)" in capsys.readouterr().out


def test_templates_of_ridges_are_refused(impressions: Path, tmp_path: Path, capsys) -> None:
    assert main(["match", str(impressions / "a"), "--template", str(tmp_path / "a.skt")]) == 0
    capsys.readouterr()
    assert (
        main(["match", str(tmp_path / "a.skt"), str(impressions / "a"), "--method", "minutiae"])
        == 2
    )
    refusal = capsys.readouterr().err
    assert "keeps no minutiae" in refusal
    assert refusal.count("\n") == 1


@pytest.mark.slow
def test_two_prints_are_fused_by_default(impressions: Path, tmp_path: Path, capsys) -> None:
    prints = {name: impressions / name / "print.png" for name in ("a", "again", "other")}
    same = facts_of(capsys, prints["a"], prints["again"], method="auto")
    stranger = facts_of(capsys, prints["a"], prints["other"], method="auto")
    assert same["method"] == stranger["method"] == "fusion"
    assert same["similarity"] > 3 > 0 > stranger["similarity"]  # noqa: PLR0133
    assert same["fmr"] < 1e-3 < stranger["fmr"]
    assert same["similarity_of_ridges"] > 0.5 > stranger["similarity_of_ridges"]
    template = tmp_path / "a.skt"
    assert main(["match", str(prints["a"]), "--template", str(template)]) == 0
    capsys.readouterr()
    assert (
        facts_of(capsys, template, prints["again"], method="auto")["similarity"]
        == same["similarity"]
    )
    assert facts_of(capsys, impressions / "a", prints["again"], method="auto")["method"] == "ridge"
    assert main(["match", *map(str, prints.values())][:3]) == 0
    assert "(method fusion)" in capsys.readouterr().out
    assert main(["match", str(impressions / "a"), str(prints["a"]), "--method", "fusion"]) == 2
    assert "without minutiae of a print" in capsys.readouterr().err


def test_prints_are_fused_without_nbis(impressions: Path, capsys, monkeypatch) -> None:
    def missing() -> None:
        raise BadInput("minutiae need nbis-py")

    monkeypatch.setattr("splitknit_match.prints.minutiae._module", missing)
    prints = [impressions / name / "print.png" for name in ("a", "again")]
    assert facts_of(capsys, *prints, method="auto")["method"] == "fusion"


def holds(scores: Scores, person: str) -> np.ndarray:
    """(N,) comparisons of a person."""
    assert scores.subject is not None
    return (scores.subject.codes == scores.subject.names.index(person)).any(axis=1)


@pytest.mark.slow
def test_a_gallery_of_prints_is_searched_and_evaluated_by_both(
    impressions: Path, tmp_path: Path, capsys, monkeypatch
) -> None:
    gallery = tmp_path / "prints.skg"
    turned = tmp_path / "turned.png"
    write_print_png(
        turned, np.rot90(read_print_png(impressions / "other" / "print.png").image, 1).copy(), 500.0
    )
    for person, sources in (("Ada", ("a", "again")), ("Bo", ("other", None))):
        files = [turned if name is None else impressions / name / "print.png" for name in sources]
        assert (
            main(
                [
                    "enroll",
                    str(gallery),
                    *map(str, files),
                    "--person",
                    person,
                    "--finger",
                    "left_index",
                ]
            )
            == 0
        )
    capsys.readouterr()
    assert main(["identify", str(gallery), str(turned), "--merge", "none", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["searched"]["compared_by"] == "fusion"
    assert [candidate["person"] for candidate in facts["candidates"]] == ["Bo", "Bo", "Ada", "Ada"]
    assert facts["decision"]["match"]
    scores = gallery_scores(gallery).scores
    assert scores.genuine.min() > 3 > 0 > scores.impostor.max()  # noqa: PLR0133
    # a template in which no minutiae were found counts by its ridges, on the same scale
    with monkeypatch.context() as patched:
        patched.setattr(
            "splitknit_match.matching.inputs.MINUTIAE_PER_MM2", (-1.0, 1.0)
        )  # too few minutiae are no print otherwise
        patched.setattr(
            "splitknit_match.prints.make.minutiae_by_phase",
            lambda source, *_: no_minutiae(source.image.shape),
        )
        more = [
            gallery,
            impressions / "again" / "print.png",
            "--person",
            "Cy",
            "--finger",
            "left_index",
        ]
        assert main(["enroll", *map(str, more)]) == 0
    capsys.readouterr()
    mixed = gallery_scores(gallery)
    assert np.array_equal(
        np.sort(scores.score), np.sort(mixed.scores.score[~holds(mixed.scores, "Cy")])
    )
    assert abs(mixed.scores.impostor).max() > 1
    assert main(["identify", str(gallery), str(turned), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["candidates"][0]["person"] == "Bo"
    assert main(["identify", str(gallery), str(impressions / "a"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["searched"]["compared_by"] == "ridge"
