"""Score files in, error rates with their intervals out: systems, their fusion, and how they
differ."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Literal

import numpy as np

from splitknit import BadInput
from splitknit.errors import require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.model import Progress, no_progress
from splitknit_match.evaluation.fusion import Fused
from splitknit_match.evaluation.fusion import fuse as fuse_systems
from splitknit_match.evaluation.intervals import (
    DEFAULTS,
    BootstrapSettings,
    Interval,
    Intervals,
    differences,
)
from splitknit_match.evaluation.intervals import bootstrap as resample
from splitknit_match.evaluation.protocol import average_sessions, pair_up
from splitknit_match.evaluation.rates import error_bound, roc
from splitknit_match.evaluation.scores import Scores, read_scores

Cluster = Literal["auto", "plain", "finger", "subject"]
Fusion = Literal["linear", "minmax", "trained", "all"]
Source = str | os.PathLike[str] | Scores


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """One system with its intervals."""

    scores: Scores
    intervals: Intervals

    @property
    def eer(self) -> Interval:
        """Equal error rate; failures to acquire count as rejections."""
        return self.intervals.figures["eer"]

    @property
    def auc(self) -> Interval:
        """Area under the ROC curve."""
        return self.intervals.figures["auc"]

    def gar_at(self, far: float) -> Interval:
        """Genuine accept rate at a FAR: 0.01, 0.001, 0.0001, or those that the bootstrap's settings
        name."""
        return self.intervals.figures[f"gar@{far:g}"]


@dataclass(frozen=True, slots=True)
class Difference:
    """One system minus another."""

    first: str
    second: str
    method: str  # what was drawn
    figures: Mapping[str, Interval]  # ``eer``, ``auc``, ``d_prime``, ``gar@0.01`` and so on


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Error rates of systems."""

    # scores, error rates and their intervals for every system and variant
    results: tuple[Result, ...]
    differences: tuple[Difference, ...]
    findings: tuple[Finding, ...]  # what a reader has to know, worst first
    fused: Mapping[str, Fused]  # the systems' fusions that were asked for, by method
    bootstrap: BootstrapSettings
    inputs_sha256: Mapping[str, str]


_MAX_SYSTEMS = 12  # systems and variants on one page, at most


def evaluate(
    files: Source | Sequence[Source],
    *,
    dissimilarity: bool = False,
    cluster: Cluster = "auto",
    average: bool = False,
    fuse: Fusion | None = None,
    bootstrap: BootstrapSettings = DEFAULTS,
    progress: Progress = no_progress,
) -> Evaluation:
    """Error rates with their intervals from score files.

    Parameters
    ----------
    files : path or Scores, or several
        One a system. Files are CSV with genuine and impostor comparisons, see
        ``docs/guide/evaluation.md``.
    dissimilarity : bool
        Whether the scores are distances: lower is more similar.
    cluster : ``auto``, ``plain``, ``finger`` or ``subject``
        What the bootstrap draws for the intervals; ``auto``: fingers where they are named, else
        subjects, else comparisons.
    average : bool
        Whether figures of scores averaged over sessions are given as well.
    fuse : ``linear``, ``minmax``, ``trained`` or ``all``, optional
        Whether the systems' fusion is one more: of z-scores, of min-max scores, by logistic
        regression, or the first two with intervals by subject.
    bootstrap : BootstrapSettings
        Replicates, seed and FARs of
        :class:`splitknit_match.evaluation.intervals.BootstrapSettings`.
    progress : callable
        Called with a stage and the fraction that is done.

    Returns
    -------
    Evaluation
        ``results``: of every system and variant ``eer``, ``gar_at(far)``, ``auc``, each with its
        confidence interval; ``differences`` between systems; ``findings``.

    Raises
    ------
    BadInput
        If a file cannot be used.

    Examples
    --------
    >>> import splitknit_match
    >>> splitknit_match.evaluate("scores.csv").results[0].eer.value  # doctest: +SKIP
    """
    sources = [files] if isinstance(files, str | os.PathLike | Scores) else list(files)
    paths = [Path(source) for source in sources if not isinstance(source, Scores)]
    require(len(set(paths)) == len(paths), "a score file is named twice; name each once.")
    progress("reading", 0.0)
    tables = {str(path): read_scores(path, dissimilarity=dissimilarity) for path in paths}
    named = [source for source in sources if isinstance(source, Scores)] + [
        table.scores for table in tables.values()
    ]
    names = [system.name for system in named]
    systems = []
    for place, system in enumerate(named):
        number = (
            f" ({names[: place + 1].count(system.name)})" if names.count(system.name) > 1 else ""
        )
        systems.append(replace(system, name=system.name + number))
    ignored = dict.fromkeys(column for table in tables.values() for column in table.ignored)
    findings = []
    if ignored:
        words = f"Columns that were not read: {', '.join(ignored)}."
        findings.append(Finding("ignored-columns", words))
    if fuse == "all" and cluster == "auto":
        cluster = "subject"
    methods = ("minmax", "linear") if fuse == "all" else (fuse,) if fuse else ()
    fused = {method: fuse_systems(systems, method, bootstrap.seed) for method in methods}
    groups = [[*systems, *(fusion.scores for fusion in fused.values())]]
    if average:
        groups.append([average_sessions(system) for system in groups[0]])
    count = sum(map(len, groups))
    require(
        count <= _MAX_SYSTEMS,
        f"one report shows {_MAX_SYSTEMS} systems and variants at most, but there are {count}; give"
        " fewer files.",
    )
    for method, fusion in fused.items():
        findings += _fusion_findings(fusion, method)
    results: list[Result] = []
    differing: list[Difference] = []
    for group in groups:
        for system in group:
            progress("resampling", len(results) / count)
            units = _units(system)
            method = units[0] if cluster == "auto" else cluster
            require(
                method in units,
                f"`cluster` {method} needs columns {method}_a and {method}_b with three of them at"
                f" least, which {system.name} does not have.",
            )
            results.append(Result(system, resample(system, method, bootstrap)))
            if method == "finger" and "subject" in units:
                by_subject = resample(system, "subject", replace(bootstrap, curve_points=0))
                findings += _wider(results[-1], by_subject)
        pairs = (
            combinations(group, 2)
            if len(group) <= 4
            else ((group[0], system) for system in group[1:])
        )
        for first, second in pairs:
            method = next(result.intervals.method for result in results if result.scores is first)
            try:
                figures = differences(
                    first, pair_up(first, second), method, replace(bootstrap, curve_points=0)
                )
                differing.append(Difference(first.name, second.name, method, figures))
            except BadInput as error:
                findings.append(Finding("not-compared", f"Not compared: {error}"))
    for result in results:
        findings += _findings(result)
    hashes = {path: tables[path].sha256 for path in sorted(tables)}
    return Evaluation(
        tuple(results), tuple(differing), worst_first(findings), fused, bootstrap, hashes
    )


def _units(scores: Scores) -> list[str]:
    """What the bootstrap can draw, best first: fingers and subjects where three are named,
    comparisons."""
    named = {"finger": scores.finger, "subject": scores.subject}
    units = [
        unit for unit, ids in named.items() if ids is not None and np.unique(ids.codes).size >= 3
    ]
    return [*units, "plain"]


def _wider(result: Result, by_subject: Intervals) -> list[Finding]:
    """Whether fingers of one subject hang together, so that intervals drawn by finger are too
    narrow."""
    width, wide = (
        part.figures["eer"].high - part.figures["eer"].low
        for part in (result.intervals, by_subject)
    )
    if result.eer.value == 0 or not wide >= 1.3 * width > 0:
        return []
    words = (
        f"{result.scores.name}: drawn by subject the interval of the EER is {wide / width:.1f}"
        " times as wide, so that fingers of one subject are similarly hard; trust the wider one."
    )
    return [Finding("narrow-intervals", words, Severity.DOUBT)]


def _findings(result: Result) -> list[Finding]:
    """What a reader of a system's figures has to know."""
    scores = result.scores
    name = scores.name
    findings = []
    curve, impostors = roc(scores.genuine, scores.impostor), scores.impostor.size
    targets = [
        float(key[4:])
        for key in result.intervals.figures
        if key.startswith("gar@") and "_" not in key
    ]
    unresolved = [target for target in targets if not curve.at_far(target).resolved]
    if unresolved:
        fars = " or ".join(f"{100 * target:g} %" for target in unresolved)
        needed = " or ".join(f"{int(np.ceil(1 / target)):,}" for target in unresolved)
        words = (
            f"{name}: {impostors} impostor comparisons cannot resolve a FAR of {fars} ({needed} are"
            " needed for one false accept). The GAR is that at FAR 0, where the FAR may in truth"
            f" be up to {100 * error_bound(0.0, impostors):.2g} % (95 %, rule of three)."
        )
        findings.append(Finding("unresolved-far", words))
    missing = int(np.isnan(scores.score).sum())
    if missing:
        words = (
            f"{name}: {missing} of {scores.score.size} comparisons gave no score. FAR and GAR count"
            " them as rejections, FMR and FNMR leave them out."
        )
        findings.append(Finding("missing-scores", words))
    if curve.auc() < 0.5:
        words = (
            f"{name}: genuine scores are lower than impostor ones; if they are distances, use"
            " `dissimilarity`."
        )
        findings.append(Finding("reversed-scores", words, Severity.DOUBT))
    if result.intervals.drawn < 20:
        words = (
            f"{name}: only {result.intervals.drawn} to draw from ({result.intervals.method}), so"
            " that its intervals are rough."
        )
        findings.append(Finding("rough-intervals", words))
    return findings


def _fusion_findings(fused: Fused, method: str) -> list[Finding]:
    weights = ", ".join(
        f"{name} {weight:.2f}" for name, weight in zip(fused.systems, fused.weights, strict=True)
    )
    words = (
        f"'{fused.scores.name}' joins {len(fused.systems)} systems. Each {fused.by} belongs to one"
        f" of {fused.folds} folds; every comparison was scored by a model that saw nothing of the"
        f" folds of its two sides. Mean weights of the normalised scores: {weights}."
    )
    findings = [Finding("fused-systems", words)]
    if fused.by == "finger":
        words = (
            "Subjects are not named, so that fusion may have learned from other fingers of who it"
            " was tested on."
        )
        findings.append(Finding("unnamed-subjects", words, Severity.DOUBT))
    if any(fused.missing):
        instead = (
            "it counts as the mean" if method == "trained" else "its weight goes to the others"
        )
        words = f"Scores are missing in the fusion ({sum(fused.missing)}): where one is, {instead}."
        findings.append(Finding("missing-in-fusion", words))
    return findings
