"""``splitknit match --method minutiae``: results and prints by their minutiae."""

import numpy as np
import pytest

from enrolled import facts_of, words_of
from splitknit.errors import BadInput
from splitknit.io.prints import write_print_png
from splitknit_match.evaluation.gallery_scores import gallery_scores
from splitknit_match.matching.methods import rate
from splitknit_match.records.minutiae_record import no_minutiae
from splitknit_match.records.pictures import read_print_png


def report_of(capsys, *arguments, method="minutiae"):
    return facts_of(capsys, "match", *arguments, "--method", method)


@pytest.mark.slow
def test_one_finger_is_told_from_another(impressions, capsys):
    same = report_of(capsys, impressions / "a", impressions / "again")
    impostor = report_of(capsys, impressions / "a", impressions / "other")
    assert same["similarity"] > 3 > 2 > impostor["similarity"]  # noqa: PLR0133
    assert same["compared"]
    assert same["a"]["minutiae"] > 20
    assert "sides" not in same


@pytest.mark.slow
def test_the_similarity_is_that_of_the_records(impressions, tmp_path, capsys):
    """Whichever side comes first, and of a template as of what it was made of."""
    pair = impressions / "a", impressions / "again"
    report = report_of(capsys, *pair)
    template = tmp_path / "a.skt"
    facts_of(capsys, f"match {impressions}/a --template {template}")
    for sides in (pair[::-1], (template, pair[1])):
        assert report_of(capsys, *sides)["similarity"] == report["similarity"]


def test_rates_are_of_the_shipped_table(impressions, capsys):
    same, impostor = (
        report_of(capsys, impressions / "a", impressions / name / "print.png")
        for name in ("again", "other")
    )
    low, high = (rate(similarity, "minutiae_of_prints", None).fmr for similarity in (0.5, 8.0))
    assert same["fmr"] == rate(same["similarity"], "minutiae_of_prints", None).fmr
    assert high == same["fmr"] < 1e-3 < impostor["fmr"] <= 1
    assert high < low


def test_words_for_people(impressions, capsys):
    pair = (impressions / name / "print.png" for name in ("a", "again"))
    command = "match", *pair, "--method", "minutiae"
    words = words_of(capsys, *command)
    assert words.startswith("Match, decided at a false match rate of 1 in ")
    assert " minutiae\n" in words
    assert "agreeing minutiae" in words_of(capsys, *command, "--raw")


def test_an_empty_print_is_a_failure_to_acquire(impressions, tmp_path, capsys):
    write_print_png(tmp_path / "empty.png", np.full((300, 300), 255, np.uint8), 500.0)
    pair = tmp_path / "empty.png", impressions / "a"
    report = report_of(capsys, *pair)
    assert report["similarity"] == 0
    assert not report["compared"]
    assert not report["a"]["acquired"]
    assert report["fmr"] is None
    words = words_of(capsys, "match", *pair, "--method", "minutiae")
    assert "fewer than ten minutiae (failure to acquire)" in words


@pytest.mark.slow
def test_two_prints_are_fused_by_default(impressions, tmp_path, capsys):
    prints = {name: impressions / name / "print.png" for name in ("a", "again", "other")}
    same = report_of(capsys, prints["a"], prints["again"], method="auto")
    impostor = report_of(capsys, prints["a"], prints["other"], method="auto")
    assert same["method"] == impostor["method"] == "fusion"
    assert same["similarity"] > 3 > 0 > impostor["similarity"]  # noqa: PLR0133
    assert same["fmr"] < 1e-3 < impostor["fmr"]
    assert same["similarity_of_ridges"] > 0.5 > impostor["similarity_of_ridges"]
    template = tmp_path / "a.skt"
    facts_of(capsys, "match", prints["a"], "--template", template)
    stored = report_of(capsys, template, prints["again"], method="auto")
    assert stored["similarity"] == same["similarity"]
    # a surface is printed before it meets a print
    for method in ("auto", "fusion"):
        surface = report_of(capsys, impressions / "a", prints["again"], method=method)
        assert surface["method"] == "fusion" and surface["answer"] == "match"
    assert "(method fusion)" in words_of(capsys, "match", prints["a"], prints["again"])


@pytest.mark.parametrize("method", ["auto", "minutiae"])
def test_prints_are_compared_without_nbis(impressions, capsys, monkeypatch, method):
    def missing():
        raise BadInput("minutiae need nbis-py")

    monkeypatch.setattr("splitknit_match.prints.minutiae._module", missing)
    prints = [impressions / name / "print.png" for name in ("a", "again")]
    assert report_of(capsys, *prints, method=method)["answer"] == "match"


def holds(scores, person):
    """(N,) comparisons of a person."""
    assert scores.subject is not None
    return (scores.subject.codes == scores.subject.names.index(person)).any(axis=1)


@pytest.mark.slow
def test_a_gallery_of_prints_is_searched_and_evaluated_by_both(
    impressions, tmp_path, capsys, monkeypatch
):
    gallery = tmp_path / "prints.skg"
    turned = tmp_path / "turned.png"
    write_print_png(
        turned, np.rot90(read_print_png(impressions / "other" / "print.png").image, 1).copy(), 500.0
    )
    for person, sources in (("Ada", ("a", "again")), ("Bo", ("other", None))):
        files = [turned if name is None else impressions / name / "print.png" for name in sources]
        owner = ("--person", person, "--finger", "left_index")
        facts_of(capsys, "enroll", gallery, *files, *owner)
    report = facts_of(capsys, f"identify {gallery} {turned} --merge none")
    assert report["searched"]["compared_by"] == "fusion"
    assert [candidate["person"] for candidate in report["candidates"]] == ["Bo", "Bo", "Ada", "Ada"]
    assert report["decision"]["match"]
    scores = gallery_scores(gallery).scores
    assert scores.genuine.min() > 3 > 1 > scores.impostor.max()  # noqa: PLR0133
    # a template in which no minutiae were found counts by its ridges, on the same scale
    with monkeypatch.context() as patched:
        patched.setattr(
            "splitknit_match.matching.inputs.MINUTIAE_PER_MM2", (-1.0, 1.0)
        )  # too few minutiae are no print otherwise
        patched.setattr(
            "splitknit_match.prints.make.minutiae_by_phase",
            lambda flat_print, *_: no_minutiae(flat_print.image.shape),
        )
        owner = ("--person", "Cy", "--finger", "left_index")
        facts_of(capsys, f"enroll {gallery} {impressions}/again/print.png", *owner)
    mixed = gallery_scores(gallery)
    assert np.array_equal(
        np.sort(scores.score), np.sort(mixed.scores.score[~holds(mixed.scores, "Cy")])
    )
    assert abs(mixed.scores.impostor).max() > 1
    report = facts_of(capsys, f"identify {gallery} {turned}")
    assert report["candidates"][0]["person"] == "Bo"
    report = facts_of(capsys, f"identify {gallery} {impressions}/a")
    assert report["searched"]["compared_by"] == "fusion"  # with the surface's print
