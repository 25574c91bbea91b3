"""Answers and rates of comparisons, and the lines that people read."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.stats import chi2

from refusals import bad_input
from splitknit.findings import Finding, Severity
from splitknit_match.matching import methods
from splitknit_match.matching.inputs import Side
from splitknit_match.matching.results import (
    ComparedSide,
    FmrBasis,
    Match,
    MatchDecision,
    MatchOfImages,
    MatchOfPrints,
    MatchOfRidges,
    PlaneAlignment,
    TemplateFile,
    TemplateMade,
    match_lines,
    noted,
    one_in,
)
from splitknit_match.matching.score import (
    TAIL,
    FmrTable,
    calibrate_scores,
    own_rates_document,
    read_own_rates,
)
from splitknit_match.matching.template import failed_template
from splitknit_match.records.minutiae_record import no_minutiae

LEFT = ComparedSide("a.png", "print", 120.0, True)
RIGHT = ComparedSide("b.png", "print", 110.0, True)
BASIS = FmrBasis(12345, "of a test", 1e-4)
TABLE = FmrTable(
    np.array([0.0, 0.25, 0.5, 0.75]),
    np.array([1.0, 0.1, 0.01, 0.001]),
    999,
    "of a test",
    rated_mm2=20.0,
    excluded_mm2=50.0,
    method="ridge",
)


def ridges(**changes):
    match = MatchOfRidges(
        method="ridge",
        a=LEFT,
        b=RIGHT,
        similarity=0.61234,
        compared=True,
        overlap_mm2=87.6,
        correlation=0.6,
        alignment=PlaneAlignment(-3.25, 1.5, -0.25),
        fmr=0.00123,
        fmr_basis=BASIS,
        decision=MatchDecision(False, 1e-4, 0.7),
        answer="no match",
    )
    return replace(match, **changes)


HOW = (
    "overlap 88 mm² of skin; A turned by -3.2 deg, its middle +1.50 mm right and -0.25 mm up of B's"
)


def test_lines_of_a_comparison_by_ridges():
    assert match_lines(ridges()) == [
        "No match, decided at a false match rate of 1 in 10,000 (method ridge).",
        "Estimated false match rate: 1 in 810 (measured on 12,345 impostor comparisons, of a"
        " test).",
        HOW,
    ]
    lines = match_lines(ridges(template=TemplateFile("x.skt", 321)), scores=True)
    assert lines[2:] == [
        "Score 0.6123 (1 = the same picture), a match from 0.7000 on.",
        HOW,
        "Template of 321 bytes (version 2) written to x.skt.",
    ]
    undecided = ridges(decision=None, undecided="too small", fmr=None, fmr_basis=None)
    assert match_lines(undecided, scores=True) == [
        "Undecided: too small; its score is 0.6123 (1 = the same picture).",
        "Score 0.6123 (1 = the same picture).",
        HOW,
    ]
    assert match_lines(ridges(decision=None, undecided="too small"))[0] == "Undecided: too small."


def test_lines_of_what_was_not_compared():
    failed = replace(LEFT, acquired=False)
    nothing = ridges(compared=False, fmr=None, fmr_basis=None, decision=None, undecided="nothing")
    for sides in ({"a": failed}, {"b": failed}):
        assert match_lines(replace(nothing, **sides)) == [
            "Not acquired, not compared: failure to acquire."
        ]
    assert match_lines(nothing) == ["Undecided, not compared: failure to acquire."]
    for method in ("thesis", "fusion"):
        assert match_lines(replace(nothing, method=method)) == [
            "Undecided, not compared: too little overlap."
        ]
    doubt = Finding("low-contrast", "x.", Severity.DOUBT)
    doubted = replace(nothing, findings=(doubt,))
    assert match_lines(doubted)[0] == (
        "Undecided: nothing; its score is 0.6123 (1 = the same picture)."
    )


def test_lines_of_prints_and_their_parts():
    prints = MatchOfPrints(
        **{name: getattr(ridges(), name) for name in ridges().__dataclass_fields__}
        | {"method": "fusion"},
        similarity_of_ridges=0.45678,
        similarity_of_minutiae=12.34,
    )
    lines = match_lines(prints, scores=True)
    assert lines[2:4] == [
        "Score 0.61 (log-likelihood ratio of ridges and minutiae, natural logarithm), a match from"
        " 0.70 on.",
        "Its parts: ridges 0.4568, minutiae 12.3.",
    ]
    few = replace(prints, similarity_of_minutiae=None)
    assert match_lines(few, scores=True)[3] == "Its parts: ridges 0.4568, minutiae too few."
    assert not any("parts" in line for line in match_lines(few))
    assert not any(
        "parts" in line for line in match_lines(replace(few, compared=False), scores=True)
    )
    assert few.facts["similarity_of_minutiae"] is None


def test_lines_of_images_and_of_minutiae():
    images = MatchOfImages(
        method="thesis",
        a=LEFT,
        b=RIGHT,
        similarity=0.5,
        compared=True,
        overlap=0.91234,
        distances={},
        alignment=PlaneAlignment(right_mm=-0.456),
        undecided="x",
    )
    overlap = "overlap 0.912 of both outlines (intersection over union), B shifted"
    assert match_lines(images)[-1] == f"{overlap} 0.46 mm to the left"
    right = replace(images, alignment=PlaneAlignment(right_mm=0.0))
    assert match_lines(right)[-1] == f"{overlap} 0.00 mm to the right"
    unknown = replace(images, alignment=PlaneAlignment())
    assert match_lines(unknown)[-1] == f"{overlap} 0.00 mm to the right"
    minutiae = Match(
        method="minutiae",
        a=replace(LEFT, minutiae=31),
        b=replace(RIGHT, minutiae=30),
        similarity=2.5,
        compared=True,
        undecided="x",
    )
    assert match_lines(minutiae) == [
        "Undecided: x; its score is 2.50 (agreeing minutiae over the root of those that could"
        " agree).",
        "a.png: 31 minutiae",
        "b.png: 30 minutiae",
    ]
    record = replace(minutiae, b=replace(RIGHT, kind="minutiae", minutiae=7))
    assert match_lines(record)[-1] == "b.png: 7 minutiae"
    facts = record.facts
    assert {"fmr", "fmr_missing", "fmr_basis", "decision", "undecided"} <= facts.keys()


def test_notes_stand_in_lines_and_doubts_do_not():
    note = Finding("resampled", "it was resampled.")
    doubt = Finding("low-contrast", "x.", Severity.DOUBT)
    assert noted([note, doubt]) == [f"Please note: {note}"]
    assert match_lines(ridges(findings=(note, doubt)))[-1] == f"Please note: {note}"
    template = TemplateMade(LEFT, TemplateFile("x.skt", 5), b"12345", (note,))
    assert (
        str(template) == f"Please note: {note}\nTemplate of 5 bytes (version 2) written to x.skt."
    )
    assert str(replace(template, template=None)) == f"Please note: {note}"
    assert "payload" not in template.facts
    assert template.facts["a"]["path"] == "a.png"


@pytest.mark.parametrize(
    ("rate", "words"),
    [
        (0.51, "more than 1 in 2"),
        (0.5, "1 in 2"),
        (1 / 99, "1 in 99"),
        (1 / 129, "1 in 120"),
        (1e-7, "1 in 10,000,000"),
    ],
)
def test_rates_are_rounded_up_to_two_digits(rate, words):
    assert one_in(rate) == words
    assert one_in(rate, BASIS) == ("below " if rate <= 1e-4 else "") + words


def test_a_rate_is_looked_up_below_its_similarity():
    rated = methods.rate(0.6, "ridge", 60.0, 0.01, TABLE)
    assert rated.fmr == 0.01
    assert rated.fmr_basis == FmrBasis(999, "of a test", 0.001)
    assert rated.answer == "match"
    assert rated.undecided is None
    assert rated.fmr_missing is None
    assert rated.decision.fmr == 0.01
    assert rated.decision.match
    assert rated.decision.expected_fmr is None
    # the next step of 1e-5 above the measured similarity
    assert rated.decision.threshold == pytest.approx(0.50001, abs=1e-9)
    assert methods.rate(0.500005, "ridge", 60.0, 0.01, TABLE).fmr == 0.1
    assert methods.rate(rated.decision.threshold, "ridge", 60.0, 0.01, TABLE).answer == "match"
    no_match = methods.rate(0.5, "ridge", 50.0, 0.01, TABLE)
    assert (no_match.answer, no_match.decision.match) == ("no match", False)
    default = methods.rate(0.8, "ridge", None, None, TABLE)
    assert default.decision.fmr == 0.001  # the smallest that can be stated
    assert default.answer == "match"


def test_little_overlap_is_not_rated_and_excludes_nothing():
    unrated = methods.rate(0.9, "ridge", 19.9, 0.01, TABLE)
    assert unrated.undecided == "only 20 mm² of skin overlap; it takes 20 mm² or more"
    assert (unrated.fmr, unrated.fmr_missing) == (None, unrated.undecided)
    assert methods.rate(0.9, "ridge", 20.0, 0.01, TABLE).answer == "match"
    open_ = methods.rate(0.3, "ridge", 49.0, 0.01, TABLE)
    assert (open_.answer, open_.fmr, open_.decision) == ("undecided", 0.1, None)
    assert open_.undecided == (
        "the ridges agree too little for a match, but 49 mm² are too few to exclude one: it takes"
        " 50 mm² or more"
    )
    assert methods.rate(0.3, "ridge", None, 0.01, TABLE).answer == "no match"
    assert methods.rate(0.9, "ridge", 49.0, 0.01, TABLE).answer == "match"


@pytest.mark.parametrize("scores", ["windows", "fingerphotos alone"])
def test_smaller_rates_are_extrapolated_but_not_of_small_prints_and_photographs(scores):
    rated = methods.rate(3.0, "ridge", None, 1e-4, TABLE)
    assert rated.decision.threshold == pytest.approx(TABLE.beyond(1e-4)[0], abs=2e-5)
    assert rated.decision.expected_fmr == TABLE.beyond(1e-4)[1]
    few = methods.rate(3.0, scores, None, 1e-4, TABLE)
    assert few.undecided == (
        "of such pairs false match rates below 0.001 were not measured; leave `fmr` out, or give"
        " a larger one"
    )
    assert (few.fmr, few.decision) == (0.001, None)
    assert methods.rate(3.0, scores, None, 1e-3, TABLE).answer == "match"
    with bad_input(r"rates below 1e-05 cannot .* 999 .*>= 1e-05.*gave 9e-06"):
        methods.rate(3.0, "ridge", None, 9e-6, TABLE)


def test_methods_without_rates_are_undecided():
    words = "false match rates of the method thesis were not measured"
    assert methods.rate(1.0, "thesis", None).undecided == words
    words = "false match rates of the method ridge were measured on 100 mm² of skin or more"
    assert methods.rate(1.0, "ridge small", 90.0).undecided == words


@pytest.mark.parametrize(
    ("method", "areas_mm2", "minutiae", "table"),
    [
        ("fusion", (100.0, 100.0), 3.0, "fusion"),
        ("fusion", (99.0, 100.0), 3.0, "windows"),
        ("fusion", (100.0, 100.0), None, "windows"),
        ("ridge", (100.0, 99.0), None, "ridge small"),
        ("ridge", (100.0, 100.0), None, "ridge"),
        ("fingerphotos alone", (9.0, 99.0), 4.0, "fingerphotos alone small"),
        ("minutiae", (9.0, 9.0), None, "minutiae"),
    ],
)
def test_each_comparison_has_its_table(method, areas_mm2, minutiae, table):
    assert methods.scores_of(method, areas_mm2, minutiae) == table


@pytest.mark.parametrize("method", methods.TABLES)
def test_shipped_rates_fall_as_similarities_rise(method):
    table = methods.fmr_table(method)
    assert (np.diff(table.fmr) <= 0).all()
    assert (np.diff(table.similarity) >= 0).all()
    assert table.fmr.max() <= 1
    assert table.smallest * (table.impostors + 1) >= 0.99
    assert methods.fmr_table(method).basis == table.basis
    assert methods.fmr_table(method).threshold(0.01) == table.threshold(0.01)
    shipped = json.loads(
        (Path(methods.__file__).parent / methods.TABLES[method]).read_text("utf-8")
    )
    assert table.rated_mm2 == shipped.get("rated_mm2", 0.0)
    assert table.excluded_mm2 == shipped.get("excluded_mm2", 0.0)


@pytest.mark.parametrize("method", ["contactless alone", "contactless and prints"])
def test_rates_of_surfaces_are_those_of_real_prints_at_least(method):
    table, real = (methods.fmr_table(name) for name in (method, "fusion"))
    assert all(table(each) >= real(each) for each in np.linspace(-8, 5, 200))
    assert table.population.startswith("of them")


def test_rates_beyond_the_measured_follow_an_exponential_tail():
    scores = np.sort(np.random.default_rng(1).exponential(1.0, 2000))
    table = calibrate_scores(scores)
    assert table.impostors == 2000
    assert table.smallest == pytest.approx(1 / 2001)
    first = next(k for k, rate in enumerate(table.fmr) if rate * 2001 <= TAIL + 1)
    count = table.fmr[first] * 2001 - 1
    area = sum(
        table.fmr[k] * (table.similarity[k + 1] - table.similarity[k])
        for k in range(first, len(table.fmr) - 1)
    )
    mean = area / table.fmr[first]
    high = 2 * count * mean / chi2.ppf(0.025, 2 * count)
    limit = 1 - 0.025 ** (1 / 2000)
    similarity, expected = table.beyond(1e-5)
    assert similarity == pytest.approx(table.similarity[-1] + high * math.log(limit / 1e-5))
    assert expected == pytest.approx(
        table.smallest * math.exp((table.similarity[-1] - similarity) / mean)
    )
    # the limit of 95 % of no impostor at all is above the smallest rate
    assert table.beyond(0.01)[0] == table.similarity[-1]


def test_calibrated_rates_are_counted():
    scores = np.random.default_rng(1).normal(size=(10, 30)).round(2)
    table = calibrate_scores(scores)
    for similarity, rate in zip(table.similarity, table.fmr, strict=True):
        assert rate == ((scores >= similarity).sum() + 1) / 301
    assert table.similarity[0] == scores.min()
    assert table.similarity[-1] == np.nextafter(scores.max(), np.inf)
    assert table(scores.min() - 1) == 1
    assert table(table.similarity[3]) == table.fmr[3]
    assert len(calibrate_scores(np.arange(1e4)).fmr) > 50
    few = calibrate_scores(np.arange(100.0))
    assert few.impostors == 100
    assert few.basis == FmrBasis(100, "", 1 / 101)
    assert few.fmr[-2:].tolist() == [2 / 101, 1 / 101]
    assert few.similarity[-2] == 99
    with bad_input("at least 100 impostor scores, but there are 99"):
        calibrate_scores(np.arange(99.0))
    with bad_input("NaN or infinite"):
        calibrate_scores(np.append(np.arange(100.0), np.inf))


def test_own_rates_come_back_from_their_file(tmp_path):
    scores = np.append(np.random.default_rng(1).normal(size=300), np.nan)
    document = own_rates_document(scores, "of mine", "fusion", 40.0)
    assert document["impostors"] == 300
    path = tmp_path / "rates.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    table = read_own_rates(path)
    assert_array_equal(table.fmr, document["fmr"])
    assert_array_equal(table.similarity, document["similarity"])
    assert (table.impostors, table.population, table.method) == (300, "of mine", "fusion")
    assert (table.rated_mm2, table.excluded_mm2) == (40.0, 0.0)
    rates = document["fmr"]
    wrongs = [
        {"format": "other"},
        {"similarity": document["similarity"][:-1]},
        {"similarity": document["similarity"][::-1]},
        {"fmr": rates[::-1]},
        {"fmr": [*rates[:-1], 0.0]},
        {"fmr": [1.1, *rates[1:]]},
        {"similarity": [1.0], "fmr": [0.5]},
        {"similarity": [[1.0, 2.0]], "fmr": [[0.5, 0.1]]},
        {"least_mm2": -1.0},
        {"impostors": 1e12},
        {"impostors": 100},
        {"impostors": 299},
        {"impostors": -1},
        {"impostors": 10**400},
        {"fmr": {"a": 1}},
        {"least_mm2": 10**400},
        {"similarity": [*document["similarity"][:-1], 10**400]},
        {"similarity": "x"},
        {"what": None, "impostors": None},
    ]
    words = (
        f"'{path}' is not a file of false match rates; name one that 'splitknit evaluate"
        " --calibrate' wrote."
    )
    for wrong in wrongs:
        path.write_text(json.dumps(document | wrong), encoding="utf-8")
        with bad_input() as caught:
            read_own_rates(path)
        assert str(caught.value) == words
    path.write_text(json.dumps(document | {"version": 2}), encoding="utf-8")
    with bad_input("of a version that this program does not know"):
        read_own_rates(path)
    equal = document | {"fmr": [*rates[:-2], rates[-1], rates[-1]], "least_mm2": 0}
    path.write_text(json.dumps(equal), encoding="utf-8")
    assert read_own_rates(path).rated_mm2 == 0


def side_of(kind, lacks=""):
    return Side(Path("x.png"), kind, template=replace(failed_template(), lacks=lacks))


@pytest.mark.parametrize(
    ("side", "method", "code", "lacks"),
    [
        (
            side_of("print"),
            "fusion",
            "failure-to-acquire",
            "less than 10 mm² of ridges, which a print must show",
        ),
        (side_of("print"), "minutiae", "failure-to-acquire", "fewer than ten minutiae"),
        (side_of("result"), "ridge", "failure-to-acquire", "no ridges"),
        (
            side_of("print", "no print of a finger"),
            "minutiae",
            "not-a-print",
            "no print of a finger",
        ),
    ],
)  # fmt: skip
def test_a_failure_to_acquire_has_its_reason(side, method, code, lacks):
    compared = methods.compared_side(side)
    assert not compared.acquired
    (finding,) = methods._failure(method, side, compared)
    assert (finding.code, finding.files) == (code, ("x.png",))
    assert str(finding).endswith(f"x.png holds {lacks} (failure to acquire).")
    assert methods._failure(method, side, replace(compared, acquired=True)) == []


def test_sides_of_minutiae_are_compared_by_minutiae():
    record = Side(Path("x.fmr"), "minutiae", minutiae=no_minutiae())
    template = side_of("template")
    assert methods.auto_method(record, template) == "minutiae"
    assert methods.auto_method(template, record) == "minutiae"
    assert methods.auto_method(template, template) == "ridge"
    prints = replace(template, template=replace(template.template, minutiae=no_minutiae()))
    assert methods.auto_method(prints, prints) == "fusion"
    assert methods.auto_method(prints, template) == "ridge"
    compared = methods.compared_side(record)
    assert compared == ComparedSide("x.fmr", "minutiae", 0.0, record.minutiae.acquired)
    with bad_input(r"x\.fmr holds minutiae, no ridges; compare by .* minutiae"):
        methods._template(record)
    with bad_input(r"x\.png is a template without minutiae of a print; the method minutiae"):
        methods.side_minutiae(template)


def test_own_answers_wait_for_a_doubted_resolution():
    doubt = Finding("low-contrast", "its resolution cannot be right.", Severity.DOUBT)
    match = ridges(similarity=0.9)
    assert methods._rated(match, "ridge", 0.01, TABLE, []).answer == "match"
    assert methods._rated(match, "ridge", 0.01, TABLE, [doubt]).answer == "match"
    both = methods._rated(match, "ridge", 0.01, TABLE, [doubt, doubt])
    assert (both.answer, both.undecided) == ("undecided", methods.reason(doubt))
    lower = replace(match, similarity=0.3)
    assert methods._rated(lower, "ridge", 0.01, TABLE, []).answer == "no match"
    assert methods._rated(lower, "ridge", 0.01, TABLE, [doubt]).answer == "undecided"
    small = replace(match, overlap_mm2=19.0)
    assert methods._rated(small, "ridge", 0.01, TABLE, []).answer == "undecided"
    nothing = replace(match, compared=False)
    assert methods._rated(nothing, "ridge", 0.01, TABLE, []).undecided == "nothing was compared"
    failed = replace(nothing, b=replace(RIGHT, acquired=False))
    rated = methods._rated(failed, "ridge", 0.01, TABLE, [])
    assert (rated.answer, rated.undecided) == ("not acquired", "failure to acquire")
    assert rated.fmr_missing == "nothing was compared"
    doubted = methods._rated(failed, "ridge", 0.01, TABLE, [doubt])
    assert (doubted.answer, doubted.undecided) == ("undecided", methods.reason(doubt))
