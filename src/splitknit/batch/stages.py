"""What the store lacks, as tasks: captures to reconstruct, prints whose minutiae are wanted, comparisons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from splitknit.batch.chunks import read_chunk
from splitknit.batch.features import FeatureTask
from splitknit.batch.matchers import Matcher
from splitknit.batch.matchers import matcher as matcher_named
from splitknit.batch.pairs import Pairs, all_pairs, blocks_of, missing_pairs
from splitknit.batch.population import CaptureRef, Population
from splitknit.batch.prints import MinutiaeTask
from splitknit.batch.reading import Place, places_of
from splitknit.batch.scores import ScoreTask
from splitknit.batch.settings import BatchSettings, Case
from splitknit.batch.solids import SOLIDS, SolidTask
from splitknit.batch.store import Store
from splitknit.batch.voted import VotedTask


def feature_tasks(store: Store, population: Population, settings: BatchSettings) -> list[FeatureTask]:
    """Captures that a case lacks, in groups that do not depend on what is there already."""
    lacking = [(case, store.captures(case.name)) for case in settings.cases]
    groups: dict[int, list[CaptureRef]] = {}
    for capture in population.captures:
        groups.setdefault(capture.place // settings.chunk_captures, []).append(capture)
    tasks = []
    for group, captures in sorted(groups.items()):
        wanted = [
            (case, tuple(capture.name for capture in captures if capture.name not in found)) for case, found in lacking
        ]
        missing = tuple((case, names) for case, names in wanted if names)
        if missing:
            named = {name for _, names in missing for name in names}
            tasks.append(
                FeatureTask(
                    group,
                    population.folder.resolve(),
                    population.sha256,
                    store.folder,
                    tuple(capture for capture in captures if capture.name in named),
                    missing,
                    settings.matching,
                    images=settings.surfaces,
                    solids=wanted_solids(settings),
                )
            )
    return tasks


def minutiae_tasks(store: Store, case: Case) -> list[MinutiaeTask]:
    """Chunks of features without their minutiae."""
    return [MinutiaeTask(store.folder, case.name, chunk) for chunk in _without(store, case, "minutiae")]


def voted_tasks(store: Store, population: Population, case: Case, settings: BatchSettings) -> list[VotedTask]:
    """Chunks of features without their voted minutiae."""
    folder = population.folder.resolve()
    return [VotedTask(store.folder, folder, case, chunk, settings.matching) for chunk in _without(store, case, "voted")]


def wanted_solids(settings: BatchSettings) -> tuple[str, ...]:
    """Features in space that the matchers read."""
    sources = {matcher_named(name, settings.matching).source for name in settings.matchers}
    return tuple(sorted(sources & set(SOLIDS)))


def solid_tasks(store: Store, case: Case, kind: str, settings: BatchSettings) -> list[SolidTask]:
    """Chunks of features without their features in space of one kind."""
    return [SolidTask(store.folder, case.name, chunk, kind, settings.matching) for chunk in _without(store, case, kind)]


def _without(store: Store, case: Case, kind: str) -> list[str]:
    """Names of the chunks of features beside which there is none of `kind`."""
    there = {file.stem for file in store.files(kind, case.name)}
    return [file.stem for file in store.files("features", case.name) if file.stem not in there]


def score_tasks(
    store: Store, population: Population, settings: BatchSettings, case: Case, matcher: Matcher
) -> list[ScoreTask]:
    """Comparisons that are not in the store.

    Raises
    ------
    BadInput
        If there are captures of one session only.
    """
    features = places_of(store.files("features", case.name))
    places = features if matcher.source == "features" else places_of(store.files(matcher.source, case.name))
    captures = [capture for capture in population.captures if capture.name in places]
    pairs = missing_pairs(
        all_pairs(captures, settings.impostors, settings.seed),
        len(captures),
        _done(store, case.name, matcher.name, captures),
    )
    blocks = matcher.blocks_for(settings.impostors)
    return [
        ScoreTask(
            store=store.folder,
            case=case.name,
            case_sha256=case.document()["settings_sha256"],
            population_sha256=population.sha256,
            matcher=matcher.name,
            matching=settings.matching,
            block=block.number,
            database=f"{case.name}, {captures[int(block.pairs.a[0])].session}, {block.number // 10_000 % 10_000}",
            pairs=_named(block.pairs, captures),
            places=_used(block.pairs, captures, places),
            origins=_used(block.pairs, captures, features),
            seed=settings.seed,
        )
        for block in blocks_of(pairs, captures, blocks)
    ]


def _done(store: Store, case: str, matcher: str, captures: list[CaptureRef]) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Comparisons in the store, as ``a * count + b``."""
    number = {capture.name: k for k, capture in enumerate(captures)}
    found: list[int] = []
    for file in store.files(f"scores/{case}", matcher):
        table = read_chunk(file, ["a", "b"])
        for a, b in zip(table.column("a").to_pylist(), table.column("b").to_pylist(), strict=True):
            if a in number and b in number:
                found.append(number[a] * len(captures) + number[b])
    return np.array(found, dtype=np.int64)


def _named(pairs: Pairs, captures: list[CaptureRef]) -> tuple[tuple[str, str, bool], ...]:
    return tuple(
        (captures[a].name, captures[b].name, genuine)
        for a, b, genuine in zip(pairs.a.tolist(), pairs.b.tolist(), pairs.genuine.tolist(), strict=True)
    )


def _used(pairs: Pairs, captures: list[CaptureRef], places: Mapping[str, Place]) -> dict[str, Place]:
    names = [captures[k].name for k in np.unique(np.concatenate([pairs.a, pairs.b])).tolist()]
    return {name: places[name] for name in names}
