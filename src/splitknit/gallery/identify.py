"""Identification: one finger against a gallery, or against what one person claims (verification)."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, naming, require
from splitknit.gallery.enrol import MINUTIAE_HASH, known_finger, templates_hash
from splitknit.gallery.entry import Enrolled, check_person, session_order
from splitknit.gallery.gallery import Gallery
from splitknit.gallery.key import Key
from splitknit.gallery.shards import Shards
from splitknit.matching.code import CODE_VERSION, code_of
from splitknit.matching.fusion import fused_match, with_fusion
from splitknit.matching.inputs import read_side
from splitknit.matching.methods import (
    ComparedSide,
    FmrBasis,
    MatchDecision,
    as_calibrated,
    false_match_rate,
    fmr_basis,
    side_minutiae,
    similarity_at,
)
from splitknit.matching.minutiae import minutiae_match
from splitknit.matching.minutiae_record import Minutiae, unpack_minutiae
from splitknit.matching.ridge import RidgeMatchSettings, prepared, ridge_match
from splitknit.matching.ridge_band import RidgeBandSettings
from splitknit.matching.search import EXHAUSTIVE, CodeIndex, SearchSettings, glance
from splitknit.matching.surface import MatchingSettings
from splitknit.matching.template import Template, TemplateSettings, unpack
from splitknit.model import Capture, Progress, Reconstruction, no_progress

MERGES = ("person", "finger", "none")
SEARCHES = ("auto", "exhaustive", "codes")


@dataclass(frozen=True, slots=True)
class IdentifySettings:
    """All that ``splitknit identify --set`` can change."""

    band: RidgeBandSettings = field(default_factory=RidgeBandSettings)
    template: TemplateSettings = field(default_factory=TemplateSettings)
    ridge: RidgeMatchSettings = field(default_factory=RidgeMatchSettings)
    search: SearchSettings = field(default_factory=SearchSettings)

    @property
    def matching(self) -> MatchingSettings:
        """Of templates and comparisons."""
        return MatchingSettings(band=self.band, template=self.template, ridge=self.ridge)


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked."""

    top: int = 10
    """Candidates that are reported."""
    merge: str = "person"
    """One candidate for each ``person``, for each ``finger`` of a person, or ``none``: each enrolled capture."""
    fmr: float = 1e-4
    """False match rate of one comparison at which is decided."""
    search: str = "auto"
    """``exhaustive``: all are compared by their ridges; ``codes``: those whose codes are similar; ``auto``: by size.
    Where a person or finger is named, all of theirs are compared."""
    person: str | None = None
    """Whose finger it is said to be (verification)."""
    finger: str | None = None
    """Which finger it is, where that is known; others are not compared."""

    def __post_init__(self) -> None:
        require(self.top >= 1, f"`top` must be at least 1, but it is {self.top}.")
        require(self.merge in MERGES, f"`merge` is one of {', '.join(MERGES)}, but it is '{self.merge}'.")
        require(self.search in SEARCHES, f"`search` is one of {', '.join(SEARCHES)}, but it is '{self.search}'.")
        require(0 < self.fmr < 1, f"`fmr` must lie between 0 and 1, but it is {self.fmr:g}.")


@dataclass(frozen=True, slots=True)
class Searched:
    """What a search went through."""

    method: str
    """``exhaustive``, ``codes`` or ``shards``."""
    compared_by: str
    """``ridge``, ``fusion`` or ``minutiae``."""
    without_code: int
    """Captures whose codes had to be made, or that the shards lack."""
    fingers: int | None
    """Of which the captures are; None where not all rows were read, so `people`."""
    people: int | None
    failures: int
    """Failures to acquire in the gallery, which match nobody."""
    captures: int
    compared: int
    """How many of them were compared, the others were left out by their codes."""
    note: str | None = None
    """Which were compared by less than the others."""


@dataclass(frozen=True, slots=True)
class RankedCandidate:
    """One who may have left the finger."""

    rank: int
    person: str
    finger: str
    session: str
    similarity: float
    code_similarity: float | None
    fmr: float | None
    """False match rate at this similarity, None where it is not known."""
    expected_false_matches: float | None
    """Captures of other fingers, among those searched, that are as similar by chance."""


@dataclass(frozen=True, slots=True)
class SearchDecision(MatchDecision):
    """Whether the best candidate is the finger's owner."""

    expected_false_matches: float


@dataclass(frozen=True, slots=True)
class Identification:
    """What a search found; that nobody is found is no error."""

    gallery: str
    probe: ComparedSide
    mode: str
    """``identification``, or ``verification`` where a person was claimed."""
    person: str | None
    finger: str | None
    by: str
    """``ridges`` or ``minutiae``: what the gallery keeps."""
    searched: Searched
    merge: str
    candidates: tuple[RankedCandidate, ...]
    """Best first."""
    fmr_basis: FmrBasis | None
    decision: SearchDecision | None
    """None where false match rates are not known for the settings."""
    timings_s: Mapping[str, float]


def identify_file(
    gallery: Path,
    probe: Path | Reconstruction | Capture,
    question: Question,
    settings: IdentifySettings,
    *,
    key: Key | None = None,
    preset: str = "metric",
    progress: Progress = no_progress,
    input_ppi: float | None = None,
    shards: Path | None = None,
) -> Identification:
    """Who is it? That nobody is found is a result, no error.

    `probe`: capture folder, result folder, template (``.skt``), print or record of minutiae; a gallery that keeps
    minutiae is searched by minutiae, one that keeps ridges by ridges. `input_ppi`: resolution of a print whose file
    does not state it; `shards`: folder of the gallery's shards (:func:`splitknit.gallery.manage.index_gallery`), where
    codes are compared. Raises BadInput if a file cannot be used, the gallery's templates were made otherwise, the
    claimed person or finger is not in it, or the rate was not measured.
    """
    person = None if question.person is None else check_person(question.person)
    finger = None if question.finger is None else known_finger(question.finger)
    mapped = None if shards is None else Shards(shards, key)
    require(
        mapped is None or (person is None and finger is None and question.search != "exhaustive"),
        "`shards` is for a search of the whole gallery by codes; leave out `person`, `finger` and `search`.",
    )
    with Gallery.open(gallery, key) as opened:
        of_minutiae = opened.settings_sha256 == MINUTIAE_HASH
        opened.require_comparable(MINUTIAE_HASH if of_minutiae else templates_hash(settings.matching))
        require(
            mapped is None or not of_minutiae, f"'{gallery}' keeps minutiae, which have no codes; leave out `shards`."
        )
        calibrated = of_minutiae or as_calibrated(settings.matching)
        if calibrated:
            # refused here, before anything is made, where no such rate was measured
            similarity_at(question.fmr, "minutiae_of_prints" if of_minutiae else "ridge")
        pool = _pool(opened, person, finger, "exhaustive" if of_minutiae else "codes" if mapped else question.search)
        side = read_side(
            probe, preset, settings.matching, lambda stage, fraction: progress(stage, 0.5 * fraction), input_ppi
        )
        made = side_minutiae(side) if of_minutiae else side.template
        if made is None:
            raise BadInput(
                f"{side.path} holds minutiae, but '{gallery}' keeps ridges; name a print, or enrol minutiae."
            )
        acquired = made.acquired if isinstance(made, Minutiae) else not made.empty
        area_mm2 = 0.0 if isinstance(made, Minutiae) else made.area_mm2
        started = time.perf_counter()
        found, facts = _search(opened, made, pool if mapped is None else mapped, settings=settings, progress=progress)
        seconds = time.perf_counter() - started
    by = {"minutiae": "minutiae_of_prints"}.get(facts.compared_by, facts.compared_by)
    by = "fingerphotos" if (side.kind, by) == ("photo", "fusion") else by
    threshold = similarity_at(question.fmr, by) if calibrated else None
    candidates = _merged(found, question.merge)[: question.top]
    rated = by if calibrated else None
    reported = (_candidate(rank, one, facts.captures, rated) for rank, one in enumerate(candidates, start=1))
    decision = None
    if threshold is not None:
        match = bool(candidates and candidates[0][0] >= threshold)
        decision = SearchDecision(match, question.fmr, threshold, facts.captures * question.fmr)
    progress("done", 1.0)
    return Identification(
        gallery=str(gallery),
        probe=ComparedSide(str(side.path), side.kind, area_mm2, acquired),
        mode="identification" if person is None else "verification",
        person=person,
        finger=finger,
        by="minutiae" if of_minutiae else "ridges",
        searched=facts,
        merge=question.merge,
        candidates=tuple(reported),
        fmr_basis=fmr_basis(by) if calibrated else None,
        decision=decision,
        timings_s={"search": seconds},
    )


_Found = tuple[float, float | None, Enrolled]
"""Similarity of ridges (or of ridges and minutiae), of codes, and what was compared."""


def _pool(gallery: Gallery, person: str | None, finger: str | None, search: str) -> list[Enrolled] | None:
    """Rows to search; None for all of a gallery so large that only codes are looked at first."""
    if (
        person is None
        and finger is None
        and search != "exhaustive"
        and (search == "codes" or len(gallery) > EXHAUSTIVE)
    ):
        return None
    rows = gallery.entries(person, finger)
    who = " and ".join(word for word in (person and f"person '{person}'", finger and f"finger '{finger}'") if word)
    require(
        len(rows) > 0 or not who,
        f"'{gallery.path}' holds nothing of {who}; 'splitknit gallery list' shows who is in it.",
    )
    return rows


def _search(
    gallery: Gallery,
    probe: Template | Minutiae,
    pool: list[Enrolled] | Shards | None,
    *,
    settings: IdentifySettings,
    progress: Progress,
) -> tuple[list[_Found], Searched]:
    """Compare these, or those that codes (of shards, or of the gallery) choose.

    By ridges and minutiae where the probe and one of them at least have both, on the same scale where one has not.
    """
    codes: dict[int, NDArray[np.int8]] = {}
    fingers, people = None, None
    score: dict[int, float] = {}
    if isinstance(pool, Shards):
        assert isinstance(probe, Template)
        rest = gallery.entries_at(gallery.without_code(CODE_VERSION))
        failures = sum(one.template_bytes == 0 for one in rest.values())
        without_code = max(0, len(gallery) - failures - len(pool))
        acquired, score = _by_shards(gallery, probe, pool, settings)
    elif pool is None:
        codes, without_code, failures = _codes(gallery, progress)
        acquired = list(codes)
    else:
        names = [one.entry for one in pool if one.template_bytes > 0]
        fingers, people = len({(one.person, one.finger) for one in names}), len({one.person for one in names})
        without_code, failures = 0, len(pool) - len(names)
        acquired = [one.row for one in pool if one.template_bytes > 0]
    captures = len(pool) if isinstance(pool, Shards) else len(acquired)
    method = "shards" if isinstance(pool, Shards) else "exhaustive"
    facts = Searched(method, "ridge", without_code, fingers, people, failures, captures, 0)
    if isinstance(probe, Minutiae):
        assert isinstance(pool, list)
        found = _by_minutiae(gallery, probe, {one.row: one for one in pool}, acquired)
        return found, replace(facts, compared_by="minutiae", compared=len(found))
    if probe.empty or not acquired:
        return [], facts
    if pool is None and len(acquired) > settings.search.candidates:
        index = CodeIndex([str(row) for row in codes], np.stack(list(codes.values())))
        best, scores = index.search(probe, settings.search.candidates, settings.search.variants_of(probe))
        score = {int(row): value for row, value in zip(best, scores.tolist(), strict=True)}
        acquired, facts = list(score), replace(facts, method="codes")
    rows = {one.row: one for one in pool} if isinstance(pool, list) else gallery.entries_at(acquired)
    ready = prepared(probe, settings.ridge)
    found = []
    payloads = gallery.templates(acquired)
    fused, note = with_fusion((_unpacked(gallery, *one) for one in payloads.items()), probe)
    for k, (row, payload) in enumerate(payloads.items()):
        progress("comparing", 0.5 + 0.5 * k / len(acquired))
        if row in rows:  # else removed just now
            other = prepared(_unpacked(gallery, row, payload), settings.ridge)
            match = (fused_match if fused else ridge_match)(ready, other)
            found.append((match.similarity, score.get(row), rows[row]))
    by = "fusion" if fused else "ridge"
    return sorted(found, key=_order), replace(facts, compared_by=by, compared=len(found), note=note)


def _by_shards(
    gallery: Gallery, probe: Template, shards: Shards, settings: IdentifySettings
) -> tuple[list[int], dict[int, float]]:
    """Rows that codes, and of their best a glance at the ridges, let through; and the similarities of codes."""
    if probe.empty:
        return [], {}
    hits = shards.search(probe, settings.search.shortlist, settings.search.variants_of(probe))
    score = dict(zip(hits.rows.tolist(), hits.similarity.tolist(), strict=True))
    ready, ranks = prepared(probe, settings.ridge), {}
    for row, variant in zip(hits.rows.tolist(), hits.variant.tolist(), strict=True):
        for payload in gallery.templates([row]).values():  # none if it was removed since the shards were made
            other = prepared(_unpacked(gallery, row, payload), settings.ridge)
            ranks[row] = glance(ready, other, settings.search.variants_of(probe), variant)
    return sorted(ranks, key=lambda row: (-ranks[row], row))[: settings.search.candidates], score


def _by_minutiae(gallery: Gallery, probe: Minutiae, rows: dict[int, Enrolled], acquired: list[int]) -> list[_Found]:
    """Compare with every row of a gallery of minutiae."""
    found: list[_Found] = []
    if probe.acquired:
        for row, payload in gallery.templates(acquired).items():
            try:
                found.append((minutiae_match(probe, unpack_minutiae(payload)), None, rows[row]))
            except BadInput as error:
                raise BadInput(f"row {row} of '{gallery.path}': {error}") from error
    return sorted(found, key=_order)


def _codes(gallery: Gallery, progress: Progress) -> tuple[dict[int, NDArray[np.int8]], int, int]:
    """Codes of all rows, how many of them had to be made just now, and the number of failures to acquire."""
    codes = {row: np.frombuffer(code, dtype=np.int8) for row, code in gallery.codes(CODE_VERSION).items()}
    rest = gallery.entries_at(gallery.without_code(CODE_VERSION))
    missing = [row for row, one in rest.items() if one.template_bytes > 0]
    for k, (row, payload) in enumerate(gallery.templates(missing).items()):
        progress("coding", 0.5 * k / len(missing))
        codes[row] = code_of(_unpacked(gallery, row, payload))
    return codes, len(missing), len(rest) - len(missing)


def _unpacked(gallery: Gallery, row: int, payload: bytes) -> Template:
    return naming(f"row {row} of '{gallery.path}'", lambda: unpack(payload))


def _order(one: _Found) -> tuple[Any, ...]:
    entry = one[2].entry
    return -one[0], entry.person, entry.finger, session_order(entry.session)


def _merged(found: Sequence[_Found], merge: str) -> list[_Found]:
    """The best of each person or finger, best first."""
    seen, kept = set(), []
    for one in found:
        entry = one[2].entry
        name = {"person": (entry.person,), "finger": (entry.person, entry.finger), "none": (one[2].row,)}[merge]
        if name not in seen:
            seen.add(name)
            kept.append(one)
    return kept


def _candidate(rank: int, one: _Found, searched: int, rated: str | None) -> RankedCandidate:
    similarity, code_similarity, row = one
    fmr = false_match_rate(similarity, rated) if rated else None
    expected = None if fmr is None else searched * fmr
    who = row.entry
    return RankedCandidate(rank, who.person, who.finger, who.session, similarity, code_similarity, fmr, expected)
