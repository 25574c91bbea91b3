"""The experiments: each reads a store, judges its trials and writes its tables and plots."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from compared import Way, compare_all
from fusion import MINUTIAE_SET, OF_THESIS, fused
from measure import Work, difference_rows, rate_rows
from plots import bins_figure, roc_figure, save
from sensitivity import FACTORS, sensitivity_rows
from trials import ATTRIBUTES, Captures, Table, Trial, read_captures, read_table
from variants import (
    GATED,
    PASSING,
    PLAIN,
    THESIS,
    THESIS_WHOLE,
    VARIANTS,
    WHOLE,
    Variant,
    judged,
    known_of,
    passing_everywhere,
    refused_by_gate,
    spreads,
)

from splitknit_match.evaluation.intervals import BootstrapSettings
from tables import Row, write_csv

COMPARED = (THESIS, THESIS_WHOLE, PLAIN, WHOLE, PASSING)
"""How differences between cases are judged."""
FUSION_VARIANTS = (*COMPARED, Variant("none", "averaged", "all"))

PUBLISHED = {
    "figure-3-21": (("thesis, n = 3", 0.001, 0.905),),
    "figure-5-3": (("thesis, all three", 0.01, 0.953),),
    "figure-5-4": (
        ("thesis, SnK", 0.01, 0.92),
        ("thesis, PR", 0.01, 0.90),
        ("thesis, EA", 0.01, 0.86),
    ),
    "figure-5-5": (
        ("thesis, SnK", 0.01, 0.95),
        ("thesis, EA", 0.01, 0.93),
        ("thesis, SnK", 0.001, 0.905),
        ("thesis, EA", 0.001, 0.788),
    ),
}
"""The thesis's points on its ROC curves: name, FAR, GAR; PR and EA of 5.4 read off the plot."""


def run_fusion(options: argparse.Namespace, store: Any, truth: Mapping[str, Row]) -> Row:
    """Figure 5.3: attributes and their fusion; with minutiae on the comparisons that they made
    too."""
    cases = [case for case in ("snk", "metric") if case in options.cases]
    captures = read_captures(store, cases)
    table = read_table(store, captures, cases, ("thesis",))
    work = _work(options, table, truth)
    trials, groups = [], []
    for case in cases:
        single = [
            trial for name in ATTRIBUTES if (trial := table.trial(case, "thesis", name)) is not None
        ]
        joined = [trial for name in OF_THESIS for trial in fused(table, case, name, options.seed)]
        trials += [*single, *joined]
        groups += _against("all three, mean", case, [*single, *joined])
    rows = rate_rows(work, trials, options.jobs, FUSION_VARIANTS)
    differences = difference_rows(work, groups, (THESIS_WHOLE, WHOLE), options.jobs)
    _write(options, "fusion", rows, differences)
    drawn = [trial for trial in trials if trial.case == cases[0] and _in_figure(trial)]
    _rocs(options, work, "figure-5-3", drawn, lambda trial: trial.attribute.replace("_", " "))
    return _facts(table, trials) | {
        "with_minutiae": _fusion_with_minutiae(options, store, truth, captures, cases)
    }


def _fusion_with_minutiae(
    options: argparse.Namespace,
    store: Any,
    truth: Mapping[str, Row],
    captures: Captures,
    cases: list[str],
) -> Row:
    table = read_table(store, captures, cases, ("thesis", "minutiae"))
    rows, differences = [], []
    work = _work(options, table, truth)
    trials: list[Trial] = []
    for case in cases:
        alone = table.trial(case, "minutiae")
        if alone is None:
            continue
        mine = [replace(alone, attribute="minutiae")]
        mine += [
            trial
            for name in ("all three", MINUTIAE_SET)
            for trial in fused(table, case, name, options.seed)
        ]
        rows += rate_rows(work, mine, options.jobs, FUSION_VARIANTS)
        differences += difference_rows(
            work, _against("minutiae", case, mine), (THESIS_WHOLE, WHOLE), options.jobs
        )
        trials += mine
    _write(options, "fusion_minutiae", rows, differences)
    return _facts(table, trials)


def _against(first: str, case: str, trials: Sequence[Trial]) -> list[tuple[Trial, Trial]]:
    """One trial and each other, labelled."""
    named = {
        trial.attribute: trial.labelled(f"{case}: {trial.attribute.replace('_', ' ')}")
        for trial in trials
    }
    return [(named[first], named[name]) for name in named if first in named and name != first]


@dataclass(frozen=True, slots=True)
class Compared:
    """A part that compares cases, matcher by matcher."""

    systems: Mapping[str, Mapping[str, str]]
    """By matcher, its attributes with the figure of each; no figure where that is empty."""
    cases: tuple[str, ...] = ()
    """Cases beside those of the options."""
    variants: Sequence[Variant] = VARIANTS
    compared: Sequence[Variant] = COMPARED
    with_ea: bool = False
    """Differences from the first of :data:`BASES` alone, instead of all with each other."""


BASES = ("ea", "ea-split")


OF_CASES: Mapping[str, Compared] = {
    "cases": Compared({"thesis": {"normals": "figure-5-4", "relief": "figure-5-5"}}),
    "matchers": Compared({"ridge": {"": "ridge"}, "minutiae": {"": "minutiae"}}),
    "family": Compared(
        {"ridge": {"": ""}, "minutiae": {"": ""}},
        cases=("kumar", "zheng", "lin"),
        variants=(PLAIN, WHOLE),
        compared=(WHOLE,),
        with_ea=True,
    ),
    "people": Compared(
        {"ridge": {"": ""}, "minutiae": {"": ""}, "thesis": {"relief": ""}},
        variants=(PLAIN, WHOLE),
        compared=(WHOLE,),
        with_ea=True,
    ),
}
"""Figures 5.4 and 5.5; the same by matchers of today; systems that SnK is measured against; one
finger each of many people."""


def run_compared(
    part: str, options: argparse.Namespace, store: Any, truth: Mapping[str, Row]
) -> Row:
    """A part of :data:`OF_CASES`."""
    asked = OF_CASES[part]
    cases = tuple(dict.fromkeys([*options.cases, *asked.cases]))
    captures = read_captures(store, cases)
    facts: Row = {}
    rows, differences = [], []
    for matcher, attributes in asked.systems.items():
        try:
            table = read_table(store, captures, cases, (matcher,))
        except SystemExit as nothing:
            facts[matcher] = {"missing": [str(nothing)]}
            continue
        work = _work(options, table, truth)
        for attribute, figure in attributes.items():
            trials = _of(table, matcher, attribute)
            groups = [trials]
            if asked.with_ea:
                trials = [trial.labelled(f"{trial.case}, {matcher}") for trial in trials]
                base = [trial for name in BASES for trial in trials if trial.case == name][:1]
                groups = [[trial, *base] for trial in trials if trial not in base]
            rows += rate_rows(work, trials, options.jobs, asked.variants)
            differences += difference_rows(work, groups, asked.compared, options.jobs)
            if figure:
                _rocs(options, work, figure, trials, lambda trial: trial.case)
        facts[matcher] = _facts(table, table.trials)
    if rows:
        _write(options, part, rows, differences)
    return facts


def run_sensitivity(options: argparse.Namespace, store: Any, truth: Mapping[str, Row]) -> Row:
    """Genuine scores against roll, glare, moisture and partial views."""
    captures = read_captures(store, options.cases)
    rows: list[Row] = []
    facts: Row = {}
    for matcher, attributes in (
        ("thesis", ("normals", "relief")),
        ("ridge", ("",)),
        ("minutiae", ("",)),
    ):
        try:
            table = read_table(store, captures, options.cases, (matcher,))
        except SystemExit:
            continue
        known = known_of(table.pairs, truth)
        chosen = tuple(trial for name in attributes for trial in _of(table, matcher, name))
        rows += sensitivity_rows(table, chosen, truth, known, options.replicates, options.seed)
        facts[matcher] = _facts(table, chosen)
    write_csv(options.out / "sensitivity.csv", rows)
    for factor, (matcher, attribute) in (
        (name, system)
        for name in ("roll", "glare")
        for system in (("thesis", "relief"), ("ridge", ""))
    ):
        series = [
            (case, [row for row in rows if _key(row) == (case, matcher, attribute, factor)])
            for case in options.cases
        ]
        words = ", ".join(part for part in (FACTORS[factor].words, FACTORS[factor].unit) if part)
        chart = bins_figure(series, "gar@0.01", words, "GAR at FAR 1 %")
        if chart:
            save(chart, options.out / f"{factor}-{matcher}.svg")
    return facts


def run_failures(options: argparse.Namespace, store: Any, truth: Mapping[str, Row]) -> Row:
    """Failures to acquire of each case, and how many fingers and comparisons each rule of roll,
    and the gate, discards."""
    rows = []
    for case in options.cases:
        try:
            table = store.features(case, ["capture", "acquired", "failure", "area_mm2"])
        except ValueError:
            continue
        acquired = np.asarray(table["acquired"], dtype=bool)
        reasons: dict[str, int] = {}
        for words, good in zip(table["failure"].tolist(), acquired.tolist(), strict=True):
            if not good:
                reasons[str(words)] = reasons.get(str(words), 0) + 1
        names = [str(name) for name in table["capture"].tolist()]
        partial = np.array([bool(truth.get(name, {}).get("partial", False)) for name in names])
        area = np.asarray(table["area_mm2"], dtype=float)
        rows.append(
            {
                "case": case,
                "captures": acquired.size,
                "failures": int((~acquired).sum()),
                "failures_partial": int((~acquired & partial).sum()),
                "partial": int(partial.sum()),
                "median_area_mm2": float(np.median(area[acquired])) if acquired.any() else None,
                "reasons": "; ".join(
                    f"{count} x {words}" for words, count in sorted(reasons.items())
                ),
            }
        )
    write_csv(options.out / "failures.csv", rows)
    captures = read_captures(store, options.cases)
    facts = {
        "failures": {row["case"]: row["failures"] for row in rows},
        "roll": discarded_by_roll(captures, truth),
    }
    try:
        table = read_table(store, captures, options.cases, ("thesis",))
    except SystemExit:  # the thesis's matcher did not run
        return facts
    return facts | {"refused_by_gate": refused_by_gate(table)}


def run_scales(options: argparse.Namespace, truth: Mapping[str, Row]) -> Row:
    """Figure 3.21: scales of shapelets."""
    from scales import WAYS  # the others need no reconstruction

    return _on_images(options, truth, "scales", WAYS, "n = 3", {"relief": "figure-3-21"})


def run_descriptors(options: argparse.Namespace, truth: Mapping[str, Row]) -> Row:
    """Section 5.2: local binary patterns beside HOG, Gabor energies and shape contexts."""
    from descriptors import MATCHED, WAYS  # the others need no images

    return _on_images(
        options,
        truth,
        "descriptors",
        WAYS,
        "lbp",
        {name: f"descriptors-{name}" for name in MATCHED},
    )


def _on_images(  # noqa: PLR0917
    options: argparse.Namespace,
    truth: Mapping[str, Row],
    part: str,
    ways: Sequence[Way],
    first: str,
    figures: Mapping[str, str],
) -> Row:
    """Rates of `ways` on images made anew, and what `first` has more than each of the others: with
    the gate on all comparisons, without it on those that are made without it.
    """
    from scales import keep_all

    people = sorted({name.split("/")[0] for name in truth})[: options.people]
    names = [name for name in truth if name.split("/")[0] in people]
    read, place = keep_all(options.population, names, _scratch(options, "images"), options.jobs)
    every, ungated = compare_all(names, read, ways, place / part, options.jobs)
    some = Table(
        every.pairs.taken(ungated),
        tuple(trial.at(ungated) for trial in every.trials),
        every.missing,
    )
    rows, differences, facts = [], [], {}
    for table in (some, every):
        work = _work(options, table, truth)
        judging, compared = (
            [variant for variant in known if (variant.gate == "none") == (table is some)]
            for known in (VARIANTS, (*COMPARED, GATED))
        )
        rows += rate_rows(work, table.trials, options.jobs, judging)
        for attribute, figure in figures.items():
            trials = _of(table, "thesis", attribute)
            base = next(trial for trial in trials if trial.case == first)
            groups = [(base, trial) for trial in trials if trial is not base]
            differences += difference_rows(work, groups, compared, options.jobs)
            _rocs(options, work, figure, trials, lambda trial: trial.label, compared)
        facts = _facts(table, table.trials) | ({} if table is some else {"no_gate": facts})
    _write(options, part, rows, differences)
    return facts | {"people": options.people}


def run_normals(options: argparse.Namespace, store: Any, truth: Mapping[str, Row]) -> Row:
    """Normals of the surface, which the store has, and normals as measured, by case."""
    from normals import MEASURED_AS, normals_table

    table = normals_table(store, read_captures(store, tuple(MEASURED_AS)), options)
    work = _work(options, table, truth)
    groups = list(zip(table.trials[::2], table.trials[1::2], strict=True))
    groups += [(table.trials[k], table.trials[k + 2]) for k in range(len(table.trials) - 2)]
    rows = rate_rows(work, table.trials, options.jobs, (PLAIN, THESIS))
    _write(options, "normals", rows, difference_rows(work, groups, (PLAIN,), options.jobs))
    return _facts(table, table.trials)


def run_figures(options: argparse.Namespace, truth: Mapping[str, Row]) -> Row:
    """Figures 3.1, 3.20, 3.22, 5.6 and 5.9, measured."""
    from figures import choose, run

    whole = sorted(
        name for name, facts in truth.items() if not facts.get("partial") and not facts.get("print")
    )
    chosen = choose(whole, options.seed)[: options.captures]
    return run(
        options.population,
        chosen,
        options.out,
        _scratch(options, "figures"),
        options.seed,
        options.jobs,
    )


def run_part(part: str, options: argparse.Namespace, store: Any, truth: Mapping[str, Row]) -> Row:
    """Make the tables and plots of one part; `store` is None for those of :data:`WITHOUT_STORE`."""
    return (
        WITHOUT_STORE[part](options, truth)
        if part in WITHOUT_STORE
        else PART_OF[part](options, store, truth)
    )


PARTS = (
    "fusion",
    "cases",
    "matchers",
    "sensitivity",
    "failures",
    "descriptors",
    "figures",
    "scales",
    "normals",
)
"""What ``all`` makes; ``family`` and ``people`` have populations and stores of their own."""
WITHOUT_STORE = {
    "scales": run_scales,
    "descriptors": run_descriptors,
    "figures": run_figures,
}
PART_OF = {
    "fusion": run_fusion,
    "sensitivity": run_sensitivity,
    "failures": run_failures,
    "normals": run_normals,
    **{name: partial(run_compared, name) for name in OF_CASES},
}


def discarded_by_roll(captures: Captures, truth: Mapping[str, Row]) -> Row:
    """Fractions of the fingers, and of the genuine comparisons, that several limits discard."""
    rolls = np.array([_rolls(truth).get(str(name), np.nan) for name in captures.names])
    spread = np.array(list(spreads(captures.finger, rolls).values()))
    same = [rolls[captures.finger == name] for name in np.unique(captures.finger)]
    pairs = np.concatenate(
        [
            np.abs(np.subtract.outer(values, values))[np.triu_indices(values.size, 1)]
            for values in same
        ]
    )
    limits = (8.0, 10.0, 15.0, 20.0)
    return {
        "fingers": int(spread.size),
        "genuine_pairs": int(pairs.size),
        "fingers_discarded": {f"{limit:g}": int((spread > limit).sum()) for limit in limits},
        "pairs_discarded": {f"{limit:g}": int((pairs > limit).sum()) for limit in limits},
    }


def _scratch(options: argparse.Namespace, part: str) -> Path:
    """Folder of what a part keeps of a population."""
    population = json.loads((options.population / "population.json").read_text(encoding="utf-8"))[
        "settings_sha256"
    ]
    return Path(options.scratch / part / population[:12])


def _of(table: Table, matcher: str, attribute: str) -> list[Trial]:
    return [
        trial for trial in table.trials if (trial.matcher, trial.attribute) == (matcher, attribute)
    ]


def _in_figure(trial: Trial) -> bool:
    return trial.attribute in ATTRIBUTES or trial.attribute.startswith("all three,")


def _key(row: Row) -> tuple[str, str, str, str]:
    return row["case"], row["matcher"], row["attribute"], row["factor"]


def _work(options: argparse.Namespace, table: Table, truth: Mapping[str, Row]) -> Work:
    settings = BootstrapSettings(replicates=options.replicates, seed=options.seed, curve_points=0)
    return Work(table, known_of(table.pairs, truth), passing_everywhere(table), settings)


def _rolls(truth: Mapping[str, Row]) -> dict[str, float]:
    return {name: float(row["roll_deg"]) for name, row in truth.items()}


def _rocs(  # noqa: PLR0917
    options: argparse.Namespace,
    work: Work,
    name: str,
    trials: Sequence[Trial],
    label: Any,
    variants: Sequence[Variant] = COMPARED,
) -> None:
    """As the thesis judges, and with neither gate nor averaging; where there are partial views,
    without them, too."""
    settings = BootstrapSettings(
        replicates=options.replicates, seed=options.seed, curve_points=31, targets=(0.01,)
    )
    for ending, variant in (("", THESIS), ("-plain", PLAIN), ("-whole", WHOLE)):
        if variant not in variants or (variant == WHOLE and not work.known.partial.any()):
            continue
        scores = [
            (label(trial), judged(work.table.pairs, trial, variant, work.known, work.passing))
            for trial in trials
        ]
        curves = [(words, curve) for words, curve in scores if curve is not None]
        if curves:
            published = PUBLISHED.get(name, ()) if variant != PLAIN else ()
            picture = roc_figure(curves, settings, published)
            save(picture, options.out / f"{name}{ending}.svg")


def _write(
    options: argparse.Namespace, name: str, rows: Sequence[Row], differences: Sequence[Row]
) -> None:
    write_csv(options.out / f"{name}.csv", rows)
    write_csv(options.out / f"{name}_differences.csv", differences)


def _facts(table: Table, trials: Sequence[Trial]) -> Row:
    genuine = table.pairs.genuine
    return {
        "genuine": int(genuine.sum()),
        "impostors": int((~genuine).sum()),
        "impostors_passing_everywhere": int((passing_everywhere(table) & ~genuine).sum()),
        "fingers": int(np.unique(table.pairs.captures.finger[table.pairs.a]).size),
        "trials": len(trials),
        "missing": list(table.missing),
    }
