"""From score files to the facts of an evaluation: systems, fusion, exclusions, intervals, differences."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from splitknit import BadInput
from splitknit.errors import require
from splitknit.model import no_progress
from splitknit.settings import Checked
from splitknit.verbs import Progress
from splitknit_match.evaluation.facts import Result, notes_of
from splitknit_match.evaluation.fusion import Fused, FusionSettings, fuse
from splitknit_match.evaluation.intervals import BootstrapSettings, Interval, bootstrap, differences
from splitknit_match.evaluation.protocol import Exclusion, average_sessions, exclude, pair_up
from splitknit_match.evaluation.score_files import ScoreFile, read_exclusions, read_scores
from splitknit_match.evaluation.scores import Ids, Scores, contradiction

if TYPE_CHECKING:
    from splitknit_match.evaluation.gallery_scores import GalleryScores

SCORES_FILE = "scores.csv"  # where the scores of a gallery are written, beside the report
MAX_SYSTEMS = 12


@dataclass(frozen=True, slots=True)
class EvaluationSettings(Checked):
    """What is asked of an evaluation."""

    dissimilarity: bool = False
    """Whether a lower score means more similar; scores are then negated when they are read."""
    cluster: Literal["auto", "plain", "finger", "subject"] = "auto"
    """What intervals are drawn by: ``plain``, ``finger``, ``subject``; ``auto``: fingers, else subjects, else plain."""
    average: bool = False
    """Whether scores are averaged over sessions as well."""
    fuse: Literal["linear", "minmax", "llr", "trained", "all", None] = None
    """Whether the systems' fusion is one more, cross-validated by subject: ``linear`` (z-scores), ``minmax``, ``llr``
    (log-likelihood ratios), ``trained`` (logistic regression); ``all``: the first three, intervals by subject."""
    bootstrap: BootstrapSettings = field(default_factory=BootstrapSettings)


@dataclass(frozen=True, slots=True)
class Difference:
    """One system minus another."""

    first: str
    second: str
    method: str  # the scheme of drawing
    figures: Mapping[str, Interval]  # ``eer``, ``auc``, ``d_prime``, ``gar@0.01`` and so on


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """What an evaluation found."""

    results: tuple[Result, ...]  # scores, error rates and their intervals for every system and variant
    differences: tuple[Difference, ...]
    notes: tuple[str, ...]  # for the reader
    fused: Mapping[str, Fused]  # the systems' fusions that were asked for, by method
    settings: EvaluationSettings
    inputs_sha256: Mapping[str, str]
    tables: Mapping[str, bytes]  # files beside the report, by name
    timings_s: Mapping[str, float]


def evaluate_scores(
    files: Sequence[Path],
    settings: EvaluationSettings,
    *,
    exclusions: Path | None = None,
    gallery: GalleryScores | None = None,
    progress: Progress = no_progress,
) -> Evaluation:
    """Evaluate score files, or scores of the gallery that `files` names; BadInput if a file cannot be used."""
    started = time.perf_counter()
    progress("reading", 0.0)
    if gallery is None:
        systems, hashes, ignored = _read_systems(files, turn=settings.dissimilarity)
    else:
        systems, hashes, ignored = [gallery.scores], {str(files[0]): gallery.sha256}, []
    listed: list[Exclusion] = []
    if exclusions is not None:
        listed, hashes[str(exclusions)] = _read_exclusion_list(exclusions, systems[0])
    notes = [f"Columns that were not read: {', '.join(ignored)}."] if ignored else []
    notes += [] if gallery is None else gallery.notes
    if settings.fuse == "all" and settings.cluster == "auto":
        settings = replace(settings, cluster="subject")
    methods = {None: (), "all": _ALL}.get(settings.fuse, (settings.fuse,))
    fused = {str(one): _fused_system(systems, str(one), settings.bootstrap.seed) for one in methods}
    for method, one in fused.items():
        systems, notes = [*systems, one.scores], notes + _notes(one, method)
    groups, said = _variants(systems, listed, settings.average)
    count = sum(map(len, groups))
    fault = f"one report shows {MAX_SYSTEMS} systems and variants at most, but there are {count}"
    require(count <= MAX_SYSTEMS, f"{fault}; give fewer files.")
    notes += said
    read_s = time.perf_counter() - started
    results, compared = _figures(groups, settings, progress)
    for result in results:
        notes += notes_of(result, variant=all(result.scores is not one for one in systems))
    notes += [f"{a} and {b} did not score the same pairs, so that they are not compared." for a, b in compared[1]]
    return Evaluation(
        results=tuple(results),
        differences=tuple(compared[0]),
        notes=tuple(dict.fromkeys(notes)),
        fused=fused,
        settings=settings,
        inputs_sha256=dict(sorted(hashes.items())),
        tables={} if gallery is None else {SCORES_FILE: gallery.table},
        timings_s={"read": read_s, "total": time.perf_counter() - started},
    )


def _variants(systems: list[Scores], listed: list[Exclusion], average: bool) -> tuple[list[list[Scores]], list[str]]:
    """Groups to compare within: all comparisons, without the excluded ones, and both averaged over sessions."""
    groups, notes = [systems], []
    if listed:
        left = [exclude(one, listed) for one in systems]
        groups.append([kept for kept, _, _ in left])
        for before, (_, gone, unknown) in zip(systems, left, strict=True):
            went = f"{gone} of {before.label.size} comparisons of {before.name}"
            notes.append(f"{len(listed) - len(unknown)} entries of the list of exclusions left out {went}.")
            if unknown:
                shown = ", ".join(entry.finger for entry in unknown[:5])
                notes.append(f"{len(unknown)} entries of the list are in no comparison of {before.name}: {shown}.")
        reasons = sorted({entry.reason for entry in listed if entry.reason})
        notes += [f"{sum(entry.reason == why for entry in listed)} entries were listed for '{why}'." for why in reasons]
    if average:
        groups += [[average_sessions(one) for one in group] for group in groups]
    return groups, notes


def _figures(
    groups: list[list[Scores]], settings: EvaluationSettings, progress: Progress
) -> tuple[list[Result], tuple[list[Difference], list[tuple[str, str]]]]:
    """All intervals, and all differences between systems of a group (of many: to the first)."""
    results: list[Result] = []
    found: list[Difference] = []
    apart: list[tuple[str, str]] = []
    steps = sum(len(_methods(one)) + len(group) - 1 for group in groups for one in group)
    done = 0

    def step(fraction: float) -> None:
        progress("resampling", (done + fraction) / max(steps, 1))

    for group in groups:
        for one in group:
            methods = _methods(one)
            wanted = settings.cluster
            fault = f"`cluster` {wanted} needs columns {wanted}_a and {wanted}_b with three of them at least,"
            require(wanted == "auto" or wanted in methods, f"{fault} which {one.name} does not have.")
            by_method = {}
            for method in methods:
                by_method[method] = bootstrap(one, method, settings.bootstrap, step)
                done += 1
            primary = wanted if wanted != "auto" else ([*methods[1:], "plain"])[0]
            results.append(Result(one, primary, by_method))
        pairs = list(combinations(group, 2)) if len(group) <= 4 else [(group[0], other) for other in group[1:]]
        for first, second in pairs:
            paired = pair_up(first, second)
            if paired is None:
                apart.append((first.name, second.name))
                continue
            method = next(result.primary for result in results if result.scores is first)
            settings_of = replace(settings.bootstrap, curve_points=0)
            found.append(Difference(first.name, second.name, method, differences(first, paired, method, settings_of)))
            done += 1
            step(0.0)
    return results, (found, apart)


def _methods(scores: Scores) -> list[str]:
    """Schemes of drawing that the ids allow, the plain one first."""
    allowed = ["plain"]
    for method, ids in (("finger", scores.finger), ("subject", scores.subject)):
        if ids is not None and len(set(ids.codes.ravel().tolist())) >= 3:
            allowed.append(method)
    return allowed


# The systems of a report, fused: one system more, and what a reader has to know of it.

_ALL = ("minmax", "linear", "llr")
_MISSING = {
    "linear": "its weight goes to the others",
    "minmax": "its weight goes to the others",
    "llr": "the others' ratios are added up",
    "trained": "it counts as the mean, and that it is missing as a feature of its own",
}


def _fused_system(systems: Sequence[Scores], method: str, seed: int) -> Fused:
    """Fuse all systems; BadInput if there is one only, or as :func:`splitknit_match.evaluation.fusion.fuse`."""
    cure = "give several score files, or one with a column system."
    require(len(systems) >= 2, f"`fuse` needs two systems at least; {cure}")
    minmax = {"method": "linear", "normalisation": "minmax"}
    how: Mapping[str, Any] = minmax if method == "minmax" else {"method": method}
    return fuse(systems, FusionSettings(**how, seed=seed), name=f"fused, {method}")


def _notes(fused: Fused, method: str) -> list[str]:
    weights, folds = fused.mean_weights(), fused.folds
    fractions = ", ".join(f"{name} {weight:.2f}" for name, weight in weights.items())
    notes = [
        f"'{fused.scores.name}' joins {len(fused.systems)} systems. Each {fused.by} belongs to one of {folds} folds; "
        "every comparison was scored by a model that saw nothing of the folds of its two sides. Mean weights of the "
        f"normalised scores: {fractions}."
    ]
    if fused.by == "finger":
        learned = "fusion may have learned from other fingers of who it was tested on."
        notes.append(f"Subjects are not named, so that {learned}")
    if any(fused.missing):
        counts = ", ".join(f"{name} {count}" for name, count in zip(fused.systems, fused.missing, strict=True))
        notes.append(f"Missing scores in the fusion ({counts}): where one is missing, {_MISSING[method]}.")
    return notes


# Score files as systems: one for each file, or for each name in its ``system`` column.


def _read_systems(files: Sequence[Path], *, turn: bool) -> tuple[list[Scores], dict[str, str], list[str]]:
    """Read score files: systems, SHA-256s, and columns not read; `turn`: negate scores, as of dissimilarities."""
    require(len(set(files)) == len(files), "a score file is named twice; name each once.")
    systems: list[Scores] = []
    hashes: dict[str, str] = {}
    ignored: list[str] = []
    for path in files:
        table = read_scores(path)
        hashes[str(path)] = table.sha256
        ignored += [column for column in table.ignored if column not in ignored]
        systems += _systems_of(path, table, turn)
    twice = {name for name, count in Counter(one.name for one in systems).items() if count > 1}
    counted: Counter[str] = Counter()
    for k, one in enumerate(systems):
        if one.name in twice:
            counted[one.name] += 1
            systems[k] = replace(one, name=f"{one.name} ({counted[one.name]})")
    return systems, hashes, ignored


def _read_exclusion_list(path: Path, scores: Scores) -> tuple[list[Exclusion], str]:
    """Read a list of fingers to leave out, named as in `scores`, and its SHA-256."""
    entries, sha256 = read_exclusions(path)
    listed = []
    for entry in entries:
        name = entry["finger"]
        if scores.subject is not None and scores.finger is not None:
            subject = entry.get("subject", "")
            fitting = [one for one in scores.finger.names if one.endswith(f"/{name}")]
            fault = f"{path}: several subjects have a finger '{name}',"
            require(bool(subject) or len(fitting) < 2, f"{fault} so that the list needs its subject.")
            name = f"{subject}/{name}" if subject else (fitting or [name])[0]
        listed.append(Exclusion(name, entry.get("session") or None, entry.get("reason", "")))
    return listed, sha256


def _systems_of(path: Path, table: ScoreFile, turn: bool) -> list[Scores]:
    finger, subject, session = (Ids(*table.ids[kind]) if kind in table.ids else None for kind in _KINDS)
    if finger is not None and subject is not None:
        finger = _fingers_of_subjects(finger, subject)
    wrong = contradiction(table.label, finger, subject)
    if wrong is not None:
        said = "genuine (label 1), but its ids differ" if table.label[wrong] else "an impostor's (label 0), but its "
        said += "" if table.label[wrong] else "two fingers are one"
        raise BadInput(f"{path}, line {table.line[wrong]}: the comparison is {said}; correct label or ids.")
    score = -table.score if turn else table.score
    codes, names = table.system if table.system is not None else (np.zeros(score.size, dtype=np.int64), (path.stem,))
    systems = []
    for k, name in enumerate(names):
        chosen = codes == k
        whose, who, when = (None if one is None else one.taken(chosen) for one in (finger, subject, session))
        try:
            systems.append(Scores(table.label[chosen], score[chosen], whose, who, when, name))
        except BadInput as error:
            where = f"{path}: " if table.system is not None else f"{path}, as system "
            raise BadInput(f"{where}{error}") from error
    return systems


_KINDS = ("finger", "subject", "session")


def _fingers_of_subjects(finger: Ids, subject: Ids) -> Ids:
    """Fingers named with their subject, so that everybody's ``right_index`` is a finger of its own."""
    pairs = subject.codes.astype(np.int64) * len(finger.names) + finger.codes
    used, codes = np.unique(pairs, return_inverse=True)
    names = [f"{subject.names[k // len(finger.names)]}/{finger.names[k % len(finger.names)]}" for k in used]
    return Ids(codes.reshape(pairs.shape).astype(np.int64), tuple(names))
